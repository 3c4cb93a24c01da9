"""
A regressor of yours
====================

Any object with scikit-learn's `fit` and `predict` goes where an estimator's name goes. Trees and
linear models even run in the loop and in C.
"""

from pathlib import Path
from tempfile import mkdtemp

import matplotlib.pyplot as plt
import numpy as np
from sklearn.ensemble import ExtraTreesRegressor

import truejoint
from truejoint.motion import follow, random_motion, zigzag
from truejoint.recordings import Recorder
from truejoint.runtime import Corrector

arm = truejoint.crtk.simulated_arm("raven2", seed=2, parameters="peng2024")
arm.enable()
arm.home()


def record(trajectory):
    """Follow a trajectory and keep the arm's state, with the joints' true positions."""
    with Recorder(arm, state_rate=30.0) as recorder:
        follow(arm, trajectory)
    return recorder.recording()


training = record(zigzag(arm.robot, "J1-J2-J3", 0.25))
test = record(random_motion(arm.robot, 120.0, seed=3))

# %%
# Fit, write, read
# ----------------

regressor = ExtraTreesRegressor(40, min_samples_leaf=5)
model = truejoint.calibrate(training, regressor, random_state=0)
path = Path(mkdtemp()) / "trees.safetensors"
truejoint.write_calibration(model, path)
again = truejoint.read_calibration(path)
print(again.estimator, f"{path.stat().st_size / 1e6:.1f} MB")

# %%
# In the loop
# -----------
# A step takes microseconds, where scikit-learn's `predict` takes milliseconds. The bits are those
# of the recording.

corrector = Corrector(again)
corrector.set_homing(True, test.provenance.homing_id)
trace = corrector.run(test)
used = trace.status == 0
print(f"{used.mean():.1%} of the samples corrected")
print("same bits:", np.array_equal(trace.position[used], again.correct(test)[used]))

# %%
# Beside the linear model
# -----------------------

truth = test.columns("truth", model.joints)
figure, axis = plt.subplots(figsize=(7, 4))
for name, calibration in (("linear", truejoint.calibrate(training, "linear")), ("trees", again)):
    error = np.sort(np.abs(np.degrees(calibration.correct(test)[:, 1] - truth[:, 1])))
    axis.plot(error, np.linspace(0.0, 100.0, len(error)), label=name)
axis.set_xlabel("error of the elbow [deg]")
axis.set_ylabel("samples within [%]")
axis.legend()
axis.grid(alpha=0.3)
plt.show()
