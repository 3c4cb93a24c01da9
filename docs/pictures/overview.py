"""Draw README's picture: where an elbow is reported to be, where it is, and where truejoint says.

Run ``python docs/pictures/overview.py``; it needs the extra ``plots`` and half a minute.
"""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib import pyplot as plt

import truejoint

JOINT = "elbow"
FROM, SECONDS = 10.0, 45.0  # s of a motion that the model has not seen
REPORTED, TRUE, OFFSET, CORRECTED = "#b3541e", "#1a1a1a", "#8a8a8a", "#1f6fb2"


def draw(target: Path) -> None:
    """Collect from the digital twin, calibrate on one motion, correct another, draw that."""
    twin = truejoint.simulation.make_twin("raven2", "left", parameters="peng2024", seed=0)
    arm = truejoint.crtk.Arm(truejoint.crtk.SimulatedBackend(twin))
    arm.enable()
    arm.home()

    def recorded(motion: truejoint.motion.Trajectory) -> truejoint.Recording:
        with truejoint.recordings.Recorder(arm) as recorder:
            truejoint.motion.follow(arm, motion)
        return recorder.recording()

    training = [
        recorded(truejoint.motion.random_motion(arm.robot, 240.0, k, profile="laboratory"))
        for k in range(3)
    ]
    test = recorded(truejoint.motion.random_motion(arm.robot, 60.0, 9, profile="laboratory"))
    models = [truejoint.calibrate(training, name) for name in ("offset", "rich_trees")]
    shown = (test.t >= FROM) & (test.t < FROM + SECONDS)
    t = test.t[shown] - FROM
    truth = np.degrees(test.column(f"truth/{JOINT}"))[shown]
    reported = np.degrees(test.column(f"measured/{JOINT}"))[shown]
    shifted, corrected = (
        np.degrees(model.correct(test)[:, model.joints.index(JOINT)])[shown] for model in models
    )
    lines = (
        ("reported by the robot", reported, REPORTED),
        ("less a fixed offset", shifted, OFFSET),
        ("true", truth, TRUE),
        ("corrected by truejoint", corrected, CORRECTED),
    )
    mpl.rcParams |= {"svg.hashsalt": "truejoint", "font.size": 10, "svg.fonttype": "none"}
    figure, (above, below) = plt.subplots(
        2, 1, figsize=(8, 3.8), sharex=True, height_ratios=(3, 2), layout="constrained"
    )
    for name, values, colour in lines:
        above.plot(t, values, color=colour, lw=1.4, label=name, ls=":" if name == "true" else "-")
        if name != "true":
            below.plot(t, values - truth, color=colour, lw=1.2)
    above.set_ylabel("elbow [deg]")
    below.set_ylabel("error [deg]")
    below.set_xlabel("time [s]")
    below.axhline(0.0, color=TRUE, lw=0.8, ls=":")
    above.legend(loc="upper center", bbox_to_anchor=(0.5, 1.22), ncols=4, frameon=False)
    for axes in (above, below):
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(target, metadata={"Date": None}, facecolor="white")
    rms = [np.sqrt(np.mean((v - truth) ** 2)) for v in (reported, corrected)]
    print(f"{target}: RMSE {rms[0]:.3f} deg reported, {rms[1]:.3f} deg corrected")  # noqa: T201


if __name__ == "__main__":
    draw(Path(__file__).with_suffix(".svg"))
