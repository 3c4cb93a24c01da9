"""
What an interval means, and when it fails
=========================================

An interval holds for motions like those that made it. Here one interval is made of motions after
twelve homings, another of motions after a single homing. Both are judged after other homings.
"""

import matplotlib.pyplot as plt
import numpy as np

import truejoint
from truejoint.calibration import with_interval
from truejoint.motion import follow, random_motion, zigzag
from truejoint.recordings import Recorder

# %%
# Sessions
# --------
# Every homing leaves the zeros of the joints a little elsewhere.

arm = truejoint.crtk.simulated_arm("raven2", seed=3)
arm.enable()
arm.home()


def record(trajectory):
    """Follow a trajectory and keep the arm's state, with the joints' true positions."""
    with Recorder(arm, state_rate=30.0) as recorder:
        follow(arm, trajectory)
    return recorder.recording()


def after_homing(seed):
    """Home the arm, then record half a minute of random motion."""
    arm.home()
    return record(random_motion(arm.robot, 30.0, seed=seed))


training = record(zigzag(arm.robot, "J1-J2-J3", 0.5))
one_homing = [record(random_motion(arm.robot, 30.0, seed=seed)) for seed in range(12)]
twelve_homings = [after_homing(seed) for seed in range(12, 24)]
test = [after_homing(seed) for seed in range(24, 36)]

# %%
# Two intervals of one model
# --------------------------

model = truejoint.calibrate(training, "linear")
intervals = {
    "made after one homing": with_interval(model, one_homing),
    "made after twelve homings": with_interval(model, twelve_homings),
}
for name, calibration in intervals.items():
    print(f"{name}: {calibration.interval.meaning}")

# %%
# Coverage after other homings
# ----------------------------
# The first interval promises too much for the elbow, whose zero a homing moves most.


def coverage(calibration):
    """Share of the truth within the stated 90 %, joint by joint [%]."""
    shares = []
    for recording in test:
        truth = recording.columns("truth", model.joints)
        _, lower, upper = calibration.correct_with_interval(recording, level=0.9)
        shares.append(((lower <= truth) & (truth <= upper)).mean(axis=0))
    return 100.0 * np.mean(shares, axis=0)


figure, axis = plt.subplots(figsize=(7, 4))
for k, (name, calibration) in enumerate(intervals.items()):
    axis.bar(np.arange(3) + 0.4 * k - 0.2, coverage(calibration), 0.38, label=name)
axis.axhline(90, color="black", linestyle="--", linewidth=1)
axis.set_xticks(range(3), model.joints)
axis.set_ylabel("truth within the stated 90 % [%]")
axis.legend(loc="lower left")
plt.show()
