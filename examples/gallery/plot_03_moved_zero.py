"""
A moved zero: how it is noticed, and how it is mended
=====================================================

After another homing the elbow's zero is elsewhere. The corrector says so, and ten seconds of truth
re-zero the model.
"""

import matplotlib.pyplot as plt
import numpy as np

import truejoint
from truejoint.calibration import find_zero
from truejoint.motion import follow, random_motion, zigzag
from truejoint.recordings import Recorder
from truejoint.runtime import Corrector, Status, check_calibration

arm = truejoint.crtk.simulated_arm("raven2", seed=5)
arm.enable()
arm.home()


def record(trajectory):
    """Follow a trajectory and keep the arm's state, with the joints' true positions."""
    with Recorder(arm, state_rate=30.0) as recorder:
        follow(arm, trajectory)
    return recorder.recording()


model = truejoint.calibrate(record(zigzag(arm.robot, "J1-J2-J3", 0.5)), "linear")

# %%
# The next morning
# ----------------
# The loop names its homing. A model that has not seen it does not correct: it holds what it
# believed last, and states no half-width.

arm.home()
corrector = Corrector(model)
print(Status(corrector.set_homing(True, arm.homing_id)).name)

# %%
# Ten seconds of truth
# --------------------
# `check_calibration` says how far off the model is; `find_zero` gives the zero, and
# `Calibration.at` moves the model.

brief = record(random_motion(arm.robot, 10.0, seed=1))
for joint in check_calibration(model, brief).joints:
    print(f"{joint.joint}: {joint.offset:.5f} +- {joint.offset_sd:.5f} {joint.unit}")
today = model.at(find_zero(model, brief))

# %%
# Before and after
# ----------------

test = record(random_motion(arm.robot, 60.0, seed=2))
joint = list(model.joints).index("elbow")
truth = test.columns("truth", model.joints)[:, joint]
figure, axis = plt.subplots(figsize=(8, 4))
for calibration, name in ((model, "yesterday's zero"), (today, "re-zeroed from 10 s")):
    error = np.degrees(calibration.correct(test)[:, joint] - truth)
    axis.plot(test.t - test.t[0], error, label=f"{name}: {np.sqrt(np.mean(error**2)):.3f} deg RMS")
axis.set_xlabel("time [s]")
axis.set_ylabel("error of the elbow [deg]")
axis.grid(alpha=0.3)
axis.legend()
plt.show()
