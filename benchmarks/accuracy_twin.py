"""Table I of peng2024 on the digital twin: seven directions, three sparsities, random test.

    python -m benchmarks.accuracy_twin [--directions J2-J3 ...] [--seeds 5] [--twin-seed 0]

Each direction is a session of its own: one homing, zig-zags of sparsity 1/4, 1/5 and 1/6 for
training, then 20 minutes of random motion as the test. Prints a Markdown table beside the
paper's numbers.
"""

from __future__ import annotations

import argparse

import numpy as np

from truejoint import calibrate, evaluate
from truejoint.crtk import Arm, simulated_arm
from truejoint.evaluation import Evaluation
from truejoint.motion import DIRECTIONS, Trajectory, follow, random_motion, zigzag
from truejoint.recordings import Recorder, Recording
from truejoint.units import display_unit

# peng2024, Table I: RMSE of DNN, 2nd-order polynomial, linear, fixed offset, raw.
PAPER = {
    "J1": ((0.215, 0.193, 0.214, 0.857, 1.930), (0.248, 0.311, 0.288, 1.106, 7.927),
           (0.179, 0.406, 0.239, 0.486, 11.723)),
    "J2": ((0.186, 0.156, 0.214, 0.911, 2.015), (0.313, 0.242, 0.250, 1.135, 8.016),
           (0.216, 0.357, 0.257, 0.628, 11.737)),
    "J3": ((0.115, 0.144, 0.198, 0.877, 2.061), (0.241, 0.203, 0.294, 1.160, 8.115),
           (0.111, 0.141, 0.134, 0.498, 11.754)),
    "J1-J2": ((0.209, 0.169, 0.231, 0.908, 2.095), (0.234, 0.276, 0.221, 1.168, 8.064),
              (0.183, 0.416, 0.253, 0.584, 11.773)),
    "J2-J3": ((0.104, 0.118, 0.174, 0.859, 2.103), (0.120, 0.222, 0.186, 1.095, 7.963),
              (0.118, 0.173, 0.166, 0.492, 11.715)),
    "J1-J3": ((0.120, 0.114, 0.257, 0.932, 2.125), (0.265, 0.294, 0.266, 1.168, 7.985),
              (0.161, 0.178, 0.179, 0.557, 11.778)),
    "J1-J2-J3": ((0.143, 0.145, 0.221, 0.866, 2.219), (0.130, 0.148, 0.169, 1.038, 7.945),
                 (0.164, 0.274, 0.168, 0.469, 11.703)),
}  # fmt: skip
METHODS = ("dnn", "poly2", "linear", "offset", "raw")


def record_motion(arm: Arm, trajectory: Trajectory, homing_id: str) -> Recording:
    """Record an arm that follows a trajectory."""
    with Recorder(arm, session=trajectory.name, homing_id=homing_id) as recorder:
        follow(arm, trajectory)
    return recorder.recording()


def session(direction: str, twin_seed: int) -> tuple[list[Recording], Recording]:
    """Training and test recordings of one homing."""
    arm = simulated_arm("raven2", "left", seed=twin_seed)
    arm.enable()
    arm.home()
    paths = [zigzag(arm.robot, direction, 1 / n) for n in (4, 5, 6)]
    paths.append(random_motion(arm.robot, seed=1000 + twin_seed))
    *training, test = (record_motion(arm, path, str(twin_seed)) for path in paths)
    return training, test


def direction_row(direction: str, seeds: int, twin_seed: int) -> Evaluation:
    """Evaluate one direction."""
    training, test = session(direction, twin_seed)
    models = [calibrate(training, "dnn", random_state=seed) for seed in range(seeds)]
    return evaluate({"dnn": models}, [test])


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--directions", nargs="+", default=list(DIRECTIONS), choices=DIRECTIONS)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--twin-seed", type=int, default=0)
    options = parser.parse_args()
    print("| direction | joint | " + " | ".join(f"{m} (paper)" for m in METHODS) + " |")
    print("|---|---|" + "---|" * len(METHODS))
    for direction in options.directions:
        result = direction_row(direction, options.seeds, options.twin_seed)
        for row, joint in enumerate(result.joints):
            shown = display_unit(result.units[row])
            cells = []
            for column, method in enumerate(METHODS):
                score = result.score(method, joint)
                spread = f" ± {score.spread * shown.scale:.3f}" if np.isfinite(score.spread) else ""
                paper = PAPER[direction][row][column]
                cells.append(f"{score.rmse * shown.scale:.3f}{spread} ({paper:.3f})")
            print(
                f"| {direction} | {joint} [{shown.name}] | " + " | ".join(cells) + " |", flush=True
            )


if __name__ == "__main__":
    main()
