"""
A simulated RAVEN-II, from homing to a corrected position
==========================================================

Home an arm, record a zig-zag with temporary joint sensors, calibrate, and correct a motion that the
model never saw.
"""

import matplotlib.pyplot as plt
import numpy as np

import truejoint
from truejoint.motion import follow, random_motion, zigzag
from truejoint.recordings import Recorder

# %%
# Record
# ------
# The twin behaves as the paper's robot (peng2024). It computes faster than real time.

arm = truejoint.crtk.simulated_arm("raven2", seed=1, parameters="peng2024")
arm.enable()
arm.home()


def record(trajectory):
    """Follow a trajectory and keep the arm's state, with the joints' true positions."""
    with Recorder(arm, state_rate=30.0) as recorder:
        follow(arm, trajectory)
    return recorder.recording()


training = record(zigzag(arm.robot, "J1-J2-J3", 0.25))
test = record(random_motion(arm.robot, 300.0, seed=7))
training.table.head(3)

# %%
# Calibrate and judge
# -------------------
# Raw position, fixed offset, linear and polynomial model always stand in the table.

model = truejoint.calibrate(training, "linear")
evaluation = truejoint.evaluate(model, test)
print(evaluation)

# %%
# Look at it
# ----------

joint = list(model.joints).index("elbow")
truth = test.columns("truth", model.joints)[:, joint]
reported = test.columns("measured", model.joints)[:, joint] - truth
corrected = model.correct(test)[:, joint] - truth
figure, axes = plt.subplots(2, sharex=True, figsize=(8, 5))
for axis, error, name in zip(axes, (reported, corrected), ("reported", "corrected"), strict=True):
    axis.plot(test.t - test.t[0], np.degrees(error))
    axis.set_ylabel(f"{name} [deg]")
    axis.grid(alpha=0.3)
axes[0].set_title("Error of the elbow")
axes[1].set_xlabel("time [s]")
plt.show()
