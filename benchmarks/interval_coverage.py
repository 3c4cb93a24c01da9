"""Coverage of the stated 90 % interval on fresh sessions of the digital twin.

    python -m benchmarks.interval_coverage [--sessions 60] [--minutes 5] [--estimators linear dnn]
    python -m benchmarks.interval_coverage --cross [--draws 20] [--estimators linear dnn]
    python -m benchmarks.interval_coverage --held-out [--estimators NAME ...] [--only PATTERN ...]

One calibration session (one homing; zig-zags in direction J2-J3 of sparsity 1/4, 1/5 and 1/6)
trains each estimator. Every other session is an arm of its own: cold, freshly homed, a random
motion of a few minutes. One half of the sessions makes the interval, the other judges it, and the
other way round, so that every session is judged once. Prints Markdown tables: coverage with its
sampling error over sessions, and the width beside that of the fixed offset's interval, for three
uses: as homed, re-zeroed from ten seconds of truth, and an interval that saw one homing only. The
last row of each estimator is a warning, not a claim. Then two calibrations of different homings are
compared with what they state.

With ``--cross`` it prints another table, of recordings of real joints: an interval of the very
recordings that are fitted to (`cross_interval`), judged on others. Fifteen files of the grasper's
fifty, drawn at random, on the other thirty-five: those are exchangeable. Then what is not, as the
data sets are split: a frequency and loads never seen, the end of a recording, another motion. With
``--held-out`` such an interval of every estimator, on default features at 100 Hz, is judged on
files of the grasper that are like those fitted to, on a frequency and on loads that are not among
them, on the end of a motion of the dVRK, on BROS's other file, and on the twin after other homings,
re-zeroed from ten seconds. Each draw and split is kept in a file under ``--out`` and is not run
again while that is there.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatch
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.automatic_choice import Split, kept, recommended
from truejoint import calibrate
from truejoint.calibration import (
    Calibration,
    compare_calibrations,
    cross_interval,
    measure_coverage,
    with_interval,
)
from truejoint.calibration.zero import judged_error
from truejoint.crtk import Arm, SimulatedBackend, simulated_arm
from truejoint.errors import CalibrationError
from truejoint.estimators import get_estimator
from truejoint.estimators.registry import AUTO
from truejoint.evaluation.splits import recommended_sides
from truejoint.motion import Trajectory, follow, random_motion, zigzag
from truejoint.recordings import Recorder, Recording
from truejoint.recordings.datasets import DATASETS, Dataset, HeldOut, read_dataset
from truejoint.simulation import make_twin
from truejoint.units import display_unit

Array = NDArray[np.float64]

LEVEL = 0.9
REZERO = 10.0  # s
SAME_HOMING = 12  # motions after the training's homing
HELD_OUT = (
    "davinci_grasper_umn, frequency",
    "davinci_grasper_umn, load",
    "dvrk_psm_berkeley, random",
    "bros_dual_encoder, part",
)
DRAWS = (0, 1)
MOTION = 60.0  # [s] after each homing
ESTIMATORS = (
    "linear", "poly2", "dnn", "pose_network", "linear_trees", "network_forest", "rich_play",
    "rich_trees", "coupled_play", "run_out", "gp", "gp_lowpass", "gru", "lstm", "tcn",
    "ukf_elastic", "ukf_two_mass", "hybrid", AUTO,
)  # fmt: skip
RATE = 100.0  # [Hz] that these are thinned to
TRAINING_SEED, OTHER_SEED, SESSION_SEED = 0, 1, 100


def homed_arm(seed: int, load: float = 0.0) -> Arm:
    """Freshly homed arm on the twin."""
    arm = simulated_arm("raven2", "left", seed=seed, load=load)
    arm.enable()
    arm.home()
    return arm


def record(arm: Arm, trajectory: Trajectory, homing: str, rate: float = 30.0) -> Recording:
    """Record a motion."""
    with Recorder(arm, rate, session=trajectory.name, homing_id=homing) as recorder:
        follow(arm, trajectory)
    return recorder.recording(f"twin, homing {homing}, {trajectory.name}")


def training_session(arm: Arm, seed: int) -> list[Recording]:
    """Zig-zags that a calibration is fitted to."""
    return [record(arm, zigzag(arm.robot, "J2-J3", 1 / n), f"h{seed}") for n in (4, 5, 6)]


def fresh_session(seed: int, minutes: float) -> Recording:
    """Random motion after a homing of its own."""
    arm = homed_arm(seed)
    return record(arm, random_motion(arm.robot, 60.0 * minutes, seed), f"h{seed}", rate=10.0)


@dataclass(frozen=True)
class Row:
    """Coverage over all sessions, each judged by an interval that it had no part in."""

    shares: Array
    half_width: Array
    offset_half_width: Array


def two_fold(calibration: Calibration, sessions: Sequence[Recording], rezero: float) -> Row:
    """Interval from one half of the sessions, judged on the other, both ways."""
    halves = [sessions[0::2], sessions[1::2]]
    found = [
        measure_coverage(with_interval(calibration, halves[i], rezero=rezero), halves[1 - i], LEVEL)
        for i in (0, 1)
    ]
    return Row(
        np.concatenate([coverage.shares for coverage in found]),
        np.mean([coverage.half_width for coverage in found], axis=0),
        np.mean([coverage.offset_half_width for coverage in found], axis=0),
    )


def one_homing(
    calibration: Calibration, same: Sequence[Recording], sessions: Sequence[Recording]
) -> Row:
    """Interval from motions after the training's own homing, judged on fresh homings."""
    found = measure_coverage(with_interval(calibration, same), sessions, LEVEL)
    return Row(found.shares, found.half_width, found.offset_half_width)


def print_rows(calibration: Calibration, rows: dict[str, Row]) -> None:
    """Markdown rows of one estimator."""
    for use, row in rows.items():
        n = len(row.shares)
        error = row.shares.std(axis=0, ddof=1) / np.sqrt(n)
        for k, joint in enumerate(calibration.joints):
            shown = display_unit(calibration.units[f"measured/{joint}"])
            own, offset = row.half_width[k] * shown.scale, row.offset_half_width[k] * shown.scale
            print(
                f"| {calibration.estimator} | {use} | {joint} "
                f"| {100 * row.shares[:, k].mean():.1f} ± {100 * error[k]:.1f} % "
                f"| {own:.3f} {shown.name} | {offset:.3f} {shown.name} | {own / offset:.2f} |",
                flush=True,
            )
        mean = row.shares.mean(axis=1)
        print(
            f"| {calibration.estimator} | {use} | all "
            f"| {100 * mean.mean():.1f} ± {100 * mean.std(ddof=1) / np.sqrt(n):.1f} % | | | |"
        )


def crossed(
    name: str, dataset: Dataset, training: Sequence[Recording], testing: Sequence[Recording]
) -> dict[str, Any]:
    """Coverage of an estimator with the settings and features of a data set, see `judged`."""
    estimator = get_estimator(name).set_params(**dataset.settings.get(name, {}))
    how = {"features": list(dataset.features), "fit_rate": dataset.fit_rate}
    return judged(cross_interval(training, estimator, **how), testing)


def judged(model: Calibration, testing: Sequence[Recording]) -> dict[str, Any]:
    """Coverage (n_recordings, n_joints) of a calibration's interval, and half-widths."""
    found = measure_coverage(model, testing, LEVEL)
    ratio = found.half_width / found.offset_half_width
    return {
        "shares": found.shares.tolist(),
        "ratio": ratio.tolist(),
        "half_width": found.half_width.tolist(),
        "trajectories": model.required_interval().trajectories,
    }


def drawn(name: str, seed: int) -> dict[str, Any]:
    """Fifteen files of the grasper's fifty, drawn at random, judged on the others."""
    dataset = DATASETS["davinci_grasper_umn"]
    recordings = read_dataset(dataset.name, dataset.splits[0].files)
    order = np.random.default_rng(seed).permutation(len(recordings))
    chosen = [recordings[i] for i in order]
    return crossed(name, dataset, chosen[:15], chosen[15:])


def split_apart(name: str, dataset: Dataset, split: HeldOut) -> dict[str, Any]:
    """Training side of a recommended split, judged on the other."""
    return crossed(name, dataset, *recommended_sides(dataset, split))


def cross_table(names: Sequence[str], draws: int, out: Path) -> None:
    """Print the table of intervals of what is fitted to."""
    print("| estimator | recordings | trajectories | coverage | least | width to the offset's |")
    print("|---|---|---|---|---|---|")
    for name in names:
        pieces: dict[str, list[dict[str, Any]]] = {}
        for seed in range(draws):
            title = "grasper, 15 of 50 files, on the others"
            made = kept(out, f"{name}, drawn {seed}", partial(drawn, name, seed))
            pieces.setdefault(title, []).append(made)
        for dataset in DATASETS.values():
            for split in dataset.splits:
                title = f"{dataset.name}, {split.name}"
                make = partial(split_apart, name, dataset, split)
                pieces[title] = [kept(out, f"{name}, {title}", make)]
        for title, found in pieces.items():
            means = np.array([np.mean(piece["shares"]) for piece in found])
            least = min(np.min(piece["shares"]) for piece in found)
            ratio = np.mean([np.mean(piece["ratio"]) for piece in found])
            spread = f" ± {100 * means.std(ddof=1):.1f}" if len(means) > 1 else ""
            print(
                f"| {name} | {title} | {found[0]['trajectories']} "
                f"| {100 * means.mean():.1f}{spread} % | {100 * least:.0f} % | {ratio:.2f} |",
                flush=True,
            )


Sides = tuple[list[Recording], list[Recording], dict[str, Any]]


def of_split(split: Split) -> Sides:
    """Both sides of a split, thinned, and the rate that is fitted to."""
    return *split.sides(RATE), {"fit_rate": DATASETS[split.dataset].fit_rate}


def alike(seed: int) -> Sides:
    """Twenty files of the grasper's fifty, drawn at random, and ten others."""
    split = next(one for one in recommended() if one.dataset == "davinci_grasper_umn")
    found = [recording for side in split.sides(RATE) for recording in side]
    order = np.random.default_rng(seed).permutation(len(found))
    training, testing = ([found[i] for i in part] for part in (order[:20], order[20:30]))
    return training, testing, {"fit_rate": DATASETS[split.dataset].fit_rate}


@cache
def homings(seed: int) -> Sides:
    """Random motions of the twin like peng2024's, each after a homing, re-zeroed from 10 s."""
    twin = make_twin("raven2", "left", parameters="peng2024", seed=seed)
    arm = Arm(SimulatedBackend(twin))
    arm.enable()
    found = []
    for k in range(2 * SAME_HOMING):
        arm.home()
        motion = random_motion(arm.robot, MOTION, 1000 * seed + k, profile="laboratory")
        found.append(record(arm, motion, f"h{k}"))
    return found[:SAME_HOMING], found[SAME_HOMING:], {"rezero": REZERO}


def sides() -> dict[str, Callable[[], Sides]]:
    """Give what is fitted to and what is judged, by title."""
    splits = {one.title: partial(of_split, one) for one in recommended() if one.title in HELD_OUT}
    drawn_ = {f"davinci_grasper_umn, drawn {seed}": partial(alike, seed) for seed in DRAWS}
    return drawn_ | splits | {f"RAVEN twin {seed}": partial(homings, seed) for seed in DRAWS}


def held_out(name: str, make: Callable[[], Sides]) -> dict[str, Any]:
    """Coverage of an estimator as it comes on what is held out; the reason if there is none.

    A level that too few trajectories can state is none either.
    """
    training, testing, how = make()
    began = time.process_time()
    try:
        model = cross_interval(training, name, **how)
    except CalibrationError as reason:
        return {"reason": str(reason)}
    took = time.process_time() - began
    squares = [
        np.mean(judged_error(model, one, model.required_interval().rezero)[0] ** 2, axis=0)
        for one in testing
    ]
    rmse = np.sqrt(np.mean(squares, axis=0))
    return judged(model, testing) | {"rmse": rmse.tolist(), "seconds": took}


def held_out_table(names: Sequence[str], only: Sequence[str], out: Path) -> None:
    """Print the table of every estimator's interval on held-out recordings.

    In a cell coverage, that of the worst joint and of the worst recording, and the half-width to
    the RMSE, of the joints the range.
    """
    made = {
        title: make
        for title, make in sides().items()
        if any(fnmatch(title, pattern) for pattern in only)
    }
    print(f"| estimator | {' | '.join(made)} | CPU [s] |")
    print("|---" * (2 + len(made)) + "|")
    for name in names:
        cells, took = [], 0.0
        for title, make in made.items():
            found = kept(out, f"{name}, {title}, held out", partial(held_out, name, make))
            if "reason" in found:
                print(f"{name}, {title}: {found['reason']}", file=sys.stderr)
                cells.append("-")
                continue
            shares = 100.0 * np.array(found["shares"])
            widths = np.divide(found["half_width"], found["rmse"])
            ends = dict.fromkeys((f"{widths.min():.1f}", f"{widths.max():.1f}"))
            worst = f"{shares.mean(axis=0).min():.0f}, {shares.mean(axis=1).min():.0f}"
            cells.append(f"{shares.mean():.0f} %, {worst}; {' to '.join(ends)}")
            took += found["seconds"]
        print(f"| {name} | {' | '.join(cells)} | {took:.0f} |", flush=True)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sessions", type=int, default=60)
    parser.add_argument("--minutes", type=float, default=5.0)
    parser.add_argument("--estimators", nargs="+")
    kinds = parser.add_mutually_exclusive_group()
    kinds.add_argument("--cross", action="store_true", help="of the recordings fitted to")
    kinds.add_argument("--held-out", action="store_true", help="the same, of every estimator")
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("--only", nargs="+", default=["*"], help="patterns of what is held out")
    parser.add_argument("--out", type=Path, default=Path("bench/interval_coverage"))
    options = parser.parse_args()
    if options.held_out:
        held_out_table(options.estimators or ESTIMATORS, options.only, options.out)
        return
    names = options.estimators or ["linear", "dnn"]
    if options.cross:
        cross_table(names, options.draws, options.out)
        return
    arm = homed_arm(TRAINING_SEED)
    training = training_session(arm, TRAINING_SEED)
    same = [
        record(arm, random_motion(arm.robot, 60.0 * options.minutes, i), f"h{TRAINING_SEED}", 10.0)
        for i in range(SAME_HOMING)
    ]
    other = training_session(homed_arm(OTHER_SEED), OTHER_SEED)
    seeds = range(SESSION_SEED, SESSION_SEED + options.sessions)
    sessions = [fresh_session(seed, options.minutes) for seed in seeds]
    print(f"{options.sessions} sessions of {options.minutes:g} min, level {100 * LEVEL:g} %\n")
    print("| estimator | interval | joint | coverage | half-width | fixed offset's | ratio |")
    print("|---|---|---|---|---|---|---|")
    pairs = []
    for name in names:
        calibration = calibrate(training, name, random_state=0)
        print_rows(
            calibration,
            {
                "as homed": two_fold(calibration, sessions, 0.0),
                f"re-zeroed from {REZERO:g} s": two_fold(calibration, sessions, REZERO),
                "saw one homing (do not do this)": one_homing(calibration, same, sessions),
            },
        )
        pairs.append((calibration, calibrate(other, name, random_state=1)))
    print("\n| calibrations of two homings | joint | RMS difference | both intervals | inside |")
    print("|---|---|---|---|---|")
    for pair in pairs:
        first, second = (with_interval(one, sessions) for one in pair)
        found = compare_calibrations(first, second, sessions[0], LEVEL)
        for k, joint in enumerate(first.joints):
            shown = display_unit(first.units[f"measured/{joint}"])
            print(
                f"| {first.estimator} | {joint} | {found.difference[k] * shown.scale:.3f} "
                f"{shown.name} | ± {found.allowed[k] * shown.scale:.3f} {shown.name} "
                f"| {100 * found.inside[k]:.0f} % |"
            )


if __name__ == "__main__":
    main()
