"""What `-e auto` makes of recordings as a laboratory may bring them.

    python -m benchmarks.lab_recordings [--only PATTERN ...]

Random motion of the RAVEN twin like peng2024 at 30 Hz, three recordings of two minutes unless a row
says otherwise, each row with one thing different; and cut recordings of real joints, where there
are any. Everything is judged on recordings that no fit saw. Each row is a process and, of the twin,
an arm of its own, so that it is the same whichever others are asked for. Prints a Markdown table:
what was chosen, the largest ratio over the joints of its error to that of a linear model and of a
fixed offset on the same features, the processor time of the whole fit, and the most memory that the
process took, before the fit and in all; or the one line with which it was refused.
"""

from __future__ import annotations

import argparse
import resource
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from fnmatch import fnmatch
from multiprocessing import get_context

import numpy as np

from benchmarks.automatic_choice import Split
from truejoint import calibrate
from truejoint.calibration import Calibration
from truejoint.errors import CalibrationError
from truejoint.evaluation.metrics import rmse
from truejoint.recordings import Recording
from truejoint.studies.raven2 import sessions as s

MINUTES = (120.0, 120.0, 120.0)  # [s] of the usual recordings
JUDGED = 120.0  # [s] of the recording that it is judged on
MISSING = 0.01  # share of the truth
Sides = tuple[list[Recording], list[Recording]]  # training and test


def twin(seconds: Sequence[float] = MINUTES, rate: float = s.STATE_RATE) -> Sides:
    """Record so many seconds each with an arm that was just homed, and what is judged on."""
    name = "peng2024"
    arm, _ = s.homed(s.specimens([name])[name], seed=0)
    seeds = [*enumerate(seconds), (s.TEST_SEED, JUDGED)]
    found = [s.random_test(arm, own, seed, rate).with_truth(s.JOINTS) for seed, own in seeds]
    return found[:-1], found[-1:]


def changed(one: Callable[[Recording], Recording], count: int = len(MINUTES)) -> Sides:
    """Give the usual recordings, of which the last `count` are changed."""
    training, test = twin()
    return training[: len(training) - count] + [one(r) for r in training[-count:]], test


def without(recording: Recording, *columns: str) -> Recording:
    """Leave columns out of a recording."""
    units = {name: unit for name, unit in recording.units.items() if name not in columns}
    return replace(recording, table=recording.table.drop(columns=list(columns)), units=units)


def unmoved(recording: Recording) -> Recording:
    """Have the elbow report the same effort all the time."""
    return replace(recording, table=recording.table.assign(**{"effort/elbow": 0.1}))


def gapped(recording: Recording) -> Recording:
    """Leave single values of the truth out, of each joint by itself."""
    random, table = np.random.default_rng(0), recording.table.copy()
    for joint in s.JOINTS:
        table.loc[random.random(len(table)) < MISSING, f"truth/{joint}"] = np.nan
    return replace(recording, table=table)


def twice() -> Sides:
    """Give each of the usual recordings two times."""
    training, test = twin()
    return 2 * training, test


def efforts(recording: Recording) -> list[str]:
    """Names of its columns of effort."""
    return [f"effort/{channel}" for channel in recording.joints_of("effort")]


def short_second() -> Sides:
    """One long motion of the dVRK and a minute of another, judged on the rest of that."""
    long, _ = Split("dvrk_psm_berkeley", "", "random", "", (0.0, 0.7), (0.7, 1.0)).sides()
    short, test = Split(
        "dvrk_psm_berkeley", "", "peg_transfer", "", (0.0, 0.02), (0.7, 1.0)
    ).sides()
    return long + short, test


GRASPER = "davinci_grasper_umn", "", "Tool_4_Maryland_L_Pitch_2/*"
CASES: dict[str, Callable[[], Sides]] = {
    "one recording of 20 s": lambda: twin((20.0,)),
    "one recording of 3 min": lambda: twin((180.0,)),
    "three of 20, 45 and 180 s": lambda: twin((20.0, 45.0, 180.0)),
    "three of 20 s, 20 s and 10 min": lambda: twin((20.0, 20.0, 600.0)),
    "as usual": twin,
    "each recording twice": twice,
    "effort of the elbow constant in one": lambda: changed(unmoved, 1),
    "effort of the elbow lacks in one": lambda: changed(lambda r: without(r, "effort/elbow"), 1),
    "no efforts": lambda: changed(lambda r: without(r, *efforts(r))),
    "1 % of the truth missing": lambda: changed(gapped),
    "truth of the elbow only": lambda: changed(
        lambda r: without(r, "truth/shoulder", "truth/insertion")
    ),
    "truth of the elbow only in one": lambda: changed(
        lambda r: without(r, "truth/shoulder", "truth/insertion"), 1
    ),
    "100 Hz": lambda: twin(rate=100.0),
    "1 kHz, three of 30 s": lambda: twin((30.0, 30.0, 30.0), 1000.0),
    "dVRK, six joints, five minutes": Split(
        "dvrk_psm_berkeley", "", "random", "", (0.0, 0.13), (0.7, 1.0)
    ).sides,
    "dVRK, two of its recordings, the second short": short_second,
    "grasper, slow ones for fast ones": Split(*GRASPER, "*/?1?").sides,
    "grasper, one load for others": Split(*GRASPER, "*/??[123]").sides,
    "100 Hz, ten of 1000 s, a million rows": lambda: twin(10 * (1000.0,), 100.0),
}


def chosen(model: Calibration) -> str:
    """Estimators that have a weight, with the joints that they have it in."""
    told = model.metadata["choice"]["tried"]
    return ", ".join(
        f"{one['estimator']} ({' '.join(f'{w:.2f}' for w in one['weights'].values())})"
        for one in told
        if any(one["weights"].values())
    )


def errors(model: Calibration, test: Sequence[Recording]) -> dict[str, np.ndarray]:
    """RMSE (n_joints,) of the model and of its baselines."""
    models = {"auto": model, **model.baselines}
    return {
        name: rmse(
            np.concatenate([one.correct(r) - r.columns("truth", model.joints) for r in test])
        )
        for name, one in models.items()
    }


def row(title: str) -> str:
    """One row of the table."""
    training, test = CASES[title]()
    n, before, began = sum(map(len, training)), peak(), time.process_time()
    try:
        model = calibrate(training, "auto", progress=shown(title))
    except CalibrationError as reason:
        return f"| {title} | {n} | refused: {reason} | - | - | - | - |"
    took = time.process_time() - began
    found = errors(model, test)
    ratios = [(found["auto"] / found[name]).max() for name in ("linear", "offset")]
    cells = " | ".join(f"{ratio:.2f}" for ratio in ratios)
    memory = f"{before:.0f}, {peak():.0f}"
    return f"| {title} | {n} | {chosen(model)} | {cells} | {took:.0f} | {memory} |"


def peak() -> float:
    """Most memory that this process has taken so far [MiB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def shown(title: str) -> Callable[[float], None]:
    """Show how much of a fit is done, where somebody looks."""

    def show(fraction: float) -> None:
        if sys.stderr.isatty():
            print(f"\r{title}: {fraction:4.0%}", end="\r", file=sys.stderr, flush=True)

    return show


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="+", default=["*"], help="patterns of rows")
    options = parser.parse_args()
    print(
        "| recordings | rows | chosen | to linear | to the offset | CPU [s] | memory [MiB] |\n"
        + "|---" * 7
        + "|"
    )
    titles = [t for t in CASES if any(fnmatch(t, only) for only in options.only)]
    with ProcessPoolExecutor(1, get_context("spawn"), max_tasks_per_child=1) as processes:
        for told in processes.map(row, titles):
            print(told, flush=True)


if __name__ == "__main__":
    main()
