"""Table I of peng2024 on the digital twin: seven directions, three sparsities, random test.

    python -m benchmarks.accuracy_twin [--twin peng2024] [--directions J2-J3 ...] [--sessions 3]

A session is one homing of an arm with a seed of its own, zig-zags of sparsity 1/4, 1/5 and 1/6
for training, then 20 minutes of a random motion of its own as the test (`--profile`). Prints a
Markdown table, mean and standard deviation over sessions beside the paper's numbers, and what of
the paper it agrees with. `--json` keeps every session.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from truejoint import calibrate, evaluate
from truejoint.crtk import Arm, simulated_arm
from truejoint.motion import DIRECTIONS, PROFILES, Trajectory, follow, random_motion, zigzag
from truejoint.recordings import Recorder, Recording
from truejoint.simulation.raven2 import Raven2Parameters
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
PUBLISHED = "J1-J2-J3, published box"
NAMES = (*DIRECTIONS, PUBLISHED)
METHODS = ("dnn", "poly2", "linear", "offset", "raw")
FITTED_TO = ("J1", "J2-J3")  # directions that the specimen "peng2024" was fitted to


def record_motion(arm: Arm, trajectory: Trajectory, homing_id: str) -> Recording:
    """Record an arm that follows a trajectory."""
    with Recorder(arm, session=trajectory.name, homing_id=homing_id) as recorder:
        follow(arm, trajectory)
    return recorder.recording()


def paper(name: str) -> np.ndarray:
    """RMSE (3, 5) in the paper of a direction [deg, deg, mm]."""
    return np.array(PAPER[name.partition(",")[0]])


def session(name: str, twin: str, seed: int, profile: str) -> tuple[list[Recording], Recording]:
    """Training and test recordings of one homing."""
    arm = simulated_arm("raven2", "left", parameters=twin, seed=seed)
    arm.enable()
    arm.home()
    direction, published = name.partition(",")[0], name == PUBLISHED
    paths = [zigzag(arm.robot, direction, 1 / n, published=published) for n in (4, 5, 6)]
    paths.append(random_motion(arm.robot, seed=1000 + seed, profile=profile))
    *training, test = (record_motion(arm, path, str(seed)) for path in paths)
    return training, test


def errors(name: str, seed: int, options: argparse.Namespace) -> np.ndarray:
    """RMSE (3, 5) of the methods in one session [deg, deg, mm]."""
    training, test = session(name, options.twin, seed, options.profile)
    models = [calibrate(training, "dnn", random_state=seed + k) for k in range(options.repeats)]
    result = evaluate({"dnn": models}, [test])
    scale = [display_unit(unit).scale for unit in result.units]
    return np.array(
        [
            [result.score(method, joint).rmse * factor for method in METHODS]
            for joint, factor in zip(result.joints, scale, strict=True)
        ]
    )


def agreement(found: dict[str, np.ndarray]) -> str:
    """How the means (3, 5) of directions compare with the paper's: as one Markdown table."""
    rows = ["| directions | " + " | ".join(METHODS) + " | network against linear as in the paper |"]
    rows.append("|---|" + "---|" * (len(METHODS) + 1))
    others = [name for name in found if name in DIRECTIONS and name not in FITTED_TO]
    published = [name for name in found if name == PUBLISHED]
    for label, names in (("fitted to", FITTED_TO), ("the others", others), ("", published)):
        if not all(name in found for name in names) or not names:
            continue
        ours = np.concatenate([found[name] for name in names])
        theirs = np.concatenate([paper(name) for name in names])
        ratios = np.exp(np.log(ours / theirs).mean(axis=0))
        same = (ours[:, 0] < ours[:, 2]) == (theirs[:, 0] < theirs[:, 2])
        cells = " | ".join(f"{ratio:.2f}" for ratio in ratios)
        title = f"{label} ({', '.join(names)})" if label else names[0]
        rows.append(f"| {title} | {cells} | {same.sum()} of {len(same)} |")
    return "\n".join(rows)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    specimens = tuple(Raven2Parameters.SPECIMENS)
    parser.add_argument("--twin", default="peng2024", help=f"{', '.join(specimens)} or a file")
    parser.add_argument("--profile", default="laboratory", choices=PROFILES)
    parser.add_argument("--directions", nargs="+", default=list(NAMES), choices=NAMES)
    parser.add_argument("--sessions", type=int, default=3)
    parser.add_argument("--repeats", type=int, default=1, help="networks fitted in each session")
    parser.add_argument("--json", type=Path, help="file to keep every session's figures in")
    options = parser.parse_args()
    print("| direction | joint | " + " | ".join(f"{m} (paper)" for m in METHODS) + " |")
    print("|---|---|" + "---|" * len(METHODS))
    kept: dict[str, list[list[list[float]]]] = {}
    for name in options.directions:
        seeds = [NAMES.index(name) + len(NAMES) * k for k in range(options.sessions)]
        runs = np.array([errors(name, seed, options) for seed in seeds])
        kept[name] = runs.tolist()
        if options.json:
            options.json.write_text(json.dumps(kept))
        spread = runs.std(axis=0, ddof=1) if len(runs) > 1 else np.full_like(runs[0], np.nan)
        for row, joint in enumerate(("shoulder [deg]", "elbow [deg]", "insertion [mm]")):
            cells = [
                f"{mean:.3f} ± {sd:.3f} ({published:.3f})"
                for mean, sd, published in zip(
                    runs.mean(axis=0)[row], spread[row], paper(name)[row], strict=True
                )
            ]
            print(f"| {name} | {joint} | " + " | ".join(cells) + " |", flush=True)
    means = {name: np.mean(runs, axis=0) for name, runs in kept.items()}
    print("\nRatio to the paper, geometric mean over joints and directions\n")
    print(agreement(means))


if __name__ == "__main__":
    main()
