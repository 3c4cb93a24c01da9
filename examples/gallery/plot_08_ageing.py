"""
An arm ages over hours of work
==============================

Cables lengthen with travel, so a calibration of the morning gets worse over the day. Ten seconds of
truth re-zero the model.
"""

import matplotlib.pyplot as plt
import numpy as np

import truejoint
from truejoint.calibration import find_zero
from truejoint.motion import follow, random_motion, zigzag
from truejoint.recordings import Recorder

arm = truejoint.crtk.simulated_arm("raven2", seed=4)
arm.enable()
arm.home()


def record(trajectory):
    """Follow a trajectory and keep the arm's state, with the joints' true positions."""
    with Recorder(arm, state_rate=10.0) as recorder:
        follow(arm, trajectory)
    return recorder.recording()


# %%
# A calibration in the morning, then two hours of work
# ----------------------------------------------------

model = truejoint.calibrate(record(zigzag(arm.robot, "J1-J2-J3", 0.25)), "linear")
pieces = [record(random_motion(arm.robot, 600.0, seed=seed)) for seed in range(12)]

# %%
# Error over the day
# ------------------
# A second line is re-zeroed every half hour from ten seconds of truth.


def rms(calibration, recording):
    """RMS error of the shoulder [deg]."""
    error = calibration.correct(recording)[:, 0] - recording.columns("truth", model.joints)[:, 0]
    return np.degrees(np.sqrt(np.nanmean(error**2)))


rezeroed, errors = model, []
for k, piece in enumerate(pieces):
    if k % 3 == 0 and k > 0:
        rezeroed = model.at(find_zero(model, piece, duration=10.0))
    errors.append((rms(model, piece), rms(rezeroed, piece)))
hours = (np.arange(len(pieces)) + 1) / 6
figure, axis = plt.subplots(figsize=(8, 4))
for errors_of_one, name in zip(
    np.array(errors).T, ("as calibrated", "re-zeroed every half hour"), strict=True
):
    axis.plot(hours, errors_of_one, marker="o", label=name)
axis.set_xlabel("hours of work")
axis.set_ylabel("RMSE of the shoulder [deg]")
axis.legend()
axis.grid(alpha=0.3)
plt.show()
