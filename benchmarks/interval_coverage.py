"""Coverage of the stated 90 % interval on fresh sessions of the digital twin.

    python -m benchmarks.interval_coverage [--sessions 60] [--minutes 5] [--estimators linear dnn]
    python -m benchmarks.interval_coverage --few
    python -m benchmarks.interval_coverage --held-out [--estimators NAME ...] [--only PATTERN ...]
        [--draws 2]

One calibration session (one homing; zig-zags in direction J2-J3 of sparsity 1/4, 1/5 and 1/6)
trains each estimator. Every other session is an arm of its own: cold, freshly homed, a random
motion of a few minutes. One half of the sessions makes the interval, the other judges it, and the
other way round, so that every session is judged once. Prints Markdown tables: coverage with its
sampling error over sessions, and the width beside that of the fixed offset's interval, for three
uses: as homed, re-zeroed from ten seconds of truth, and an interval that saw one homing only. The
last row of each estimator is a warning, not a claim. Then two calibrations of different homings are
compared with what they state.

With ``--few`` it prints what an interval of few recordings covers in simulation. With
``--held-out`` it prints another table: the interval of the recordings that are fitted to
(`cross_interval`), of every estimator as it comes, on default features at 100 Hz, judged on other
recordings. Files of the grasper drawn at random, from twenty to two, are judged on ten others,
which are exchangeable with them. Then what is not: a frequency and loads that are not among those
fitted to, the end of a motion of the dVRK, BROS's other file, a sheath of the K-FLEX at an angle of
its own, and the twin after other homings, re-zeroed from ten seconds. Each draw is kept in a file
under ``--out`` and is not run again while that is there.
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

from benchmarks.automatic_choice import Split, harder, kept, recommended
from truejoint import calibrate
from truejoint.calibration import (
    Calibration,
    compare_calibrations,
    cross_interval,
    measure_coverage,
    with_interval,
)
from truejoint.calibration.conformal import conformal_threshold
from truejoint.calibration.zero import judged_error
from truejoint.crtk import Arm, SimulatedBackend, simulated_arm
from truejoint.errors import CalibrationError
from truejoint.estimators.registry import AUTO
from truejoint.motion import Trajectory, follow, random_motion, zigzag
from truejoint.recordings import Recorder, Recording
from truejoint.recordings.datasets import DATASETS
from truejoint.simulation import make_twin
from truejoint.units import DisplayUnit, display_unit

Array = NDArray[np.float64]

LEVEL = 0.9
REZERO = 10.0  # s
SAME_HOMING = 12  # motions after the training's homing
DRAWS = 2
FILES = (20, 5, 3, 2)  # of the grasper's fifty, drawn at random
JUDGED = 10  # others
MOTION = 60.0  # [s] after each homing
ESTIMATORS = (
    "linear", "poly2", "dnn", "linear_trees", "rich_play",
    "rich_trees", "coupled_play", "run_out", "gp", "gp_lowpass", "gru", "tcn",
    "ukf_elastic", "hybrid", AUTO,
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


def units(calibration: Calibration) -> list[DisplayUnit]:
    """Units that a person reads the joints' positions in."""
    return [display_unit(calibration.units[f"measured/{joint}"]) for joint in calibration.joints]


def lengths(values: Array, shown: Sequence[DisplayUnit]) -> str:
    """Values of the joints [rad or m], for a cell."""
    pairs = zip(values, shown, strict=True)
    return ", ".join(f"{value * unit.scale:.3f} {unit.name}" for value, unit in pairs)


def print_rows(calibration: Calibration, rows: dict[str, Row]) -> None:
    """Markdown rows of one estimator, in each cell the joints one after the other."""
    for use, row in rows.items():
        error = row.shares.std(axis=0, ddof=1) / np.sqrt(len(row.shares))
        pairs = zip(100 * row.shares.mean(axis=0), 100 * error, strict=True)
        inside = ", ".join(f"{mean:.1f} ± {by:.1f}" for mean, by in pairs)
        ratios = ", ".join(f"{ratio:.2f}" for ratio in row.half_width / row.offset_half_width)
        print(
            f"| {calibration.estimator} | {use} | {inside} "
            f"| {lengths(row.half_width, units(calibration))} | {ratios} |",
            flush=True,
        )


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


Sides = tuple[list[Recording], list[Recording], dict[str, Any]]


def of_split(split: Split) -> Sides:
    """Both sides of a split, thinned, and the rate that is fitted to."""
    return *split.sides(RATE), {"fit_rate": DATASETS[split.dataset].fit_rate}


def alike(count: int, seed: int) -> Sides:
    """So many files of the grasper's fifty, drawn at random, and ten others."""
    split = next(one for one in recommended() if one.dataset == "davinci_grasper_umn")
    found = [recording for side in split.sides(RATE) for recording in side]
    order = np.random.default_rng(seed).permutation(len(found))
    training, testing = order[:count], order[count : count + JUDGED]
    how = {"fit_rate": DATASETS[split.dataset].fit_rate}
    return [found[i] for i in training], [found[i] for i in testing], how


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


def sides(draws: int) -> dict[str, list[Callable[[], Sides]]]:
    """Give what is fitted to and what is judged, by title; where it is drawn, so many times."""
    known = {split.title: split for split in (*recommended(), *harder())}
    sheaths = [split for title, split in known.items() if ", sheath at" in title]
    seeds = range(draws)
    return {
        **{f"grasper, {n} files": [partial(alike, n, seed) for seed in seeds] for n in FILES},
        "grasper, frequency": [partial(of_split, known["davinci_grasper_umn, frequency"])],
        "grasper, loads": [partial(of_split, known["davinci_grasper_umn, load"])],
        "dVRK, random": [partial(of_split, known["dvrk_psm_berkeley, random"])],
        "BROS": [partial(of_split, known["bros_dual_encoder, part"])],
        "K-FLEX, sheath": [partial(of_split, split) for split in sheaths],
        "RAVEN twin": [partial(homings, seed) for seed in seeds],
    }


def held_out(name: str, make: Callable[[], Sides]) -> dict[str, Any]:
    """Coverage of an estimator as it comes on what is held out; the reason if there is none.

    A level that too few trajectories can state is none either. And the RMSE, and CPU seconds: of
    the fit that is used, and of all that the interval takes.
    """
    training, testing, how = make()
    began, marks = time.process_time(), list[tuple[float, float]]()
    try:
        model = cross_interval(
            training, name, progress=lambda done: marks.append((done, time.process_time())), **how
        )
    except CalibrationError as reason:
        return {"reason": str(reason)}
    took = time.process_time() - began
    interval = model.required_interval()
    first = 1.0 / (interval.folds + 1)  # of the progress: the fit that is used
    squares = [
        np.mean(judged_error(model, one, interval.rezero)[0] ** 2, axis=0) for one in testing
    ]
    return judged(model, testing) | {
        "rmse": np.sqrt(np.mean(squares, axis=0)).tolist(),
        "fit": next(t for done, t in marks if done >= first - 1e-9) - began,
        "seconds": took,
    }


def cell(found: Sequence[dict[str, Any]]) -> str:
    """Coverage, that of the worst joint and of the worst recording; half-width to the RMSE.

    Means over draws, with their standard deviation where there are several; the last of the joints
    the range.
    """
    shares = [100.0 * np.array(one["shares"]) for one in found]
    by_joint = np.mean([own.mean(axis=0) for own in shares], axis=0)
    least = min(own.mean(axis=1).min() for own in shares)
    means = [own.mean() for own in shares]
    spread = f" ± {np.std(means, ddof=1):.0f}" if len(means) > 1 else ""
    widths = np.mean([np.divide(one["half_width"], one["rmse"]) for one in found], axis=0)
    ends = dict.fromkeys((f"{widths.min():.1f}", f"{widths.max():.1f}"))
    worst = f"{by_joint.min():.0f}, {least:.0f}"
    return f"{np.mean(means):.0f}{spread} %, {worst}; {' to '.join(ends)}"


def held_out_table(names: Sequence[str], only: Sequence[str], draws: int, out: Path) -> None:
    """Print the table of every estimator's interval on held-out recordings, as `cell` has it."""
    made = {
        title: makes
        for title, makes in sides(draws).items()
        if any(fnmatch(title, pattern) for pattern in only)
    }
    print(f"| estimator | {' | '.join(made)} | CPU: fit, with interval [s] |")
    print("|---" * (2 + len(made)) + "|")
    for name in names:
        cells, took = [], np.zeros(2)
        for title, makes in made.items():
            found = [
                kept(out, f"{name}, {title}, {number}", partial(held_out, name, make))
                for number, make in enumerate(makes)
            ]
            for reason in {one["reason"] for one in found if "reason" in one}:
                print(f"{name}, {title}: {reason}", file=sys.stderr)
            good = [one for one in found if "reason" not in one]
            cells.append(cell(good) if good else "-")
            took += np.mean([(one["fit"], one["seconds"]) for one in good] or [(0.0, 0.0)], axis=0)
        print(f"| {name} | {' | '.join(cells)} | {took[0]:.0f}, {took[1]:.0f} |", flush=True)


def few_table(tries: int = 400) -> None:
    """Print what parts of few recordings cover of another, and the half-width to the RMSE.

    And the same of the largest error seen. Errors are normal, about a mean of each recording's own,
    whose deviation heads the column, in those within one.
    """
    rng, deviations = np.random.default_rng(0), (0.0, 1.0, 3.0)
    print(f"| recordings | {' | '.join(f'{own:g}' for own in deviations)} |")
    print("|---" * (1 + len(deviations)) + "|")
    for count in (2, 3, 5, 8):
        cells = []
        for own in deviations:
            found = np.empty((tries, 2, 2))
            for row in found:
                means = own * rng.normal(size=(count + 1, 1))
                *seen, new = np.abs(means + rng.normal(size=(count + 1, 150)))
                each = max(5, -(-15 // count))
                parts = [part for one in seen for part in np.array_split(one, each)]
                widths = np.array([conformal_threshold(parts, LEVEL), np.max(seen)])
                row[:] = (new[:, None] <= widths).mean(axis=0), widths / np.hypot(own, 1.0)
            both = [f"{100 * share:.0f} %; {width:.1f}" for share, width in found.mean(axis=0).T]
            cells.append(" / ".join(both))
        print(f"| {count} | {' | '.join(cells)} |", flush=True)


def sessions_tables(names: Sequence[str], count: int, minutes: float) -> None:
    """Print the tables of fresh sessions, and of calibrations of two homings."""
    arm = homed_arm(TRAINING_SEED)
    training = training_session(arm, TRAINING_SEED)
    same = [
        record(arm, random_motion(arm.robot, 60.0 * minutes, i), f"h{TRAINING_SEED}", 10.0)
        for i in range(SAME_HOMING)
    ]
    other = training_session(homed_arm(OTHER_SEED), OTHER_SEED)
    sessions = [fresh_session(SESSION_SEED + k, minutes) for k in range(count)]
    print(f"{count} sessions of {minutes:g} min, level {100 * LEVEL:g} %\n")
    print("| estimator | interval | coverage [%] | half-width | to the fixed offset's |")
    print("|---|---|---|---|---|")
    pairs = []
    for name in names:
        calibration = calibrate(training, name, random_state=0)
        uses = {
            "as homed": two_fold(calibration, sessions, 0.0),
            f"re-zeroed from {REZERO:g} s": two_fold(calibration, sessions, REZERO),
            "saw one homing (do not do this)": one_homing(calibration, same, sessions),
        }
        print_rows(calibration, uses)
        pairs.append((calibration, calibrate(other, name, random_state=1)))
    print("\n| two of | RMS difference | both intervals | inside [%] |")
    print("|---|---|---|---|")
    for first, second in pairs:
        both = [with_interval(one, sessions) for one in (first, second)]
        found = compare_calibrations(*both, sessions[0], LEVEL)
        shown = units(first)
        inside = ", ".join(f"{100 * share:.0f}" for share in found.inside)
        print(
            f"| {first.estimator} | {lengths(found.difference, shown)} "
            f"| {lengths(found.allowed, shown)} | {inside} |"
        )


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sessions", type=int, default=60)
    parser.add_argument("--minutes", type=float, default=5.0)
    parser.add_argument("--estimators", nargs="+")
    parser.add_argument("--few", action="store_true", help="of few recordings, simulated")
    parser.add_argument("--held-out", action="store_true", help="of the recordings fitted to")
    parser.add_argument("--draws", type=int, default=DRAWS, help="of files, and of twins")
    parser.add_argument("--only", nargs="+", default=["*"], help="patterns of what is held out")
    parser.add_argument("--out", type=Path, default=Path("bench/interval_coverage"))
    options = parser.parse_args()
    if options.few:
        few_table()
    elif options.held_out:
        names = options.estimators or ESTIMATORS
        held_out_table(names, options.only, options.draws, options.out)
    else:
        names = options.estimators or ["linear", "dnn"]
        sessions_tables(names, options.sessions, options.minutes)


if __name__ == "__main__":
    main()
