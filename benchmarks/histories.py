"""Held-out error of estimators with a history, on default features, on recordings of real joints.

    python -m benchmarks.histories [--estimators NAME ...] [--only PATTERN ...] [--development]
        [--zeros shared recording]

Splits are those of `benchmarks.automatic_choice`, recommended and harder; nothing is set for a data
set but the rate of the rows that are fitted to. Prints, for each split and estimator, the RMSE of
each joint in degrees or millimetres, the same after each recording was re-zeroed from its first two
seconds (KUKA: one), and the processor time of the fit; or a dash, as of a filter for another robot,
and why on standard error. The splits of ``--development`` are of recordings of the grasper that no
row of the table in docs/results.md holds out: what is tried for it is settled there. With
``--zeros shared recording`` each estimator is fitted a second time, with a zero of its own for each
recording of the training; what is held out, whose zero is not known, is predicted with their mean.
Where nothing is said of zeros, a choice judges them, and what it fitted for re-zeroing makes the
second figure alone.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator
from fnmatch import fnmatch
from itertools import product
from typing import get_args

from benchmarks.automatic_choice import REZERO, Split, harder, left, recommended
from truejoint import calibrate
from truejoint.calibration import Calibration
from truejoint.calibration.origin import ZeroOf
from truejoint.errors import CalibrationError
from truejoint.recordings import Recording
from truejoint.recordings.datasets import DATASETS
from truejoint.units import display_unit

SHORT = {"kuka_kr300_dual_encoder": 1.0}  # [s] to re-zero from, where a recording takes ten
RATE = 100.0  # [Hz] that recordings are thinned to


def development() -> Iterator[Split]:
    """Give splits of the grasper's recordings that no row of docs/results.md's table holds out.

    Frequency indices, loads and stops of the reported set, of the roll and of three pitches.
    """
    tool = "Tool_4_Maryland_L_"
    parts = {
        "4/[0124][01245689]": ("1?", "2?", "4?", "?[16]", "?[58]"),
        "Pitch_2/*": ("?1?", "??2"),
        "Pitch_3/*": ("??1", "?0?"),
        "Pitch_4/*": ("1??", "??2"),
        "Roll_3/[0124]0[013]": ("2??", "??1"),
    }
    for files, held_out in parts.items():
        for test in held_out:
            folder = files.split("/")[0]
            title = f"{folder}, {test}"
            yield Split("davinci_grasper_umn", title, tool + files, f"{tool}{folder}/{test}")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--estimators", nargs="+", default=["linear", "rich_play", "rich_trees"])
    parser.add_argument("--only", nargs="+", default=["*"], help="patterns of titles, in turn")
    parser.add_argument("--development", action="store_true", help="those of the grasper instead")
    parser.add_argument("--zeros", nargs="+", choices=get_args(ZeroOf), default=[None])
    options = parser.parse_args()
    print("| data set, held out | estimator | RMSE | re-zeroed | CPU [s] |\n" + "|---" * 5 + "|")
    splits = [*(development() if options.development else (*recommended(), *harder()))]
    for split in (one for only in options.only for one in splits if fnmatch(one.title, only)):
        training, testing = split.sides(RATE)
        rate = DATASETS[split.dataset].fit_rate
        for name, zero in product(options.estimators, options.zeros):
            title = name if zero in (None, "shared") else f"{name}, a zero for each {zero}"
            began = time.process_time()
            try:
                model = calibrate(training, name, fit_rate=rate, zero=zero)
            except CalibrationError as reason:
                print(f"{split.title}, {title}: {reason}", file=sys.stderr)
                print(f"| {split.title} | {title} | - | - | - |", flush=True)
                continue
            took = time.process_time() - began
            plain = model if zero is None else model.for_rezeroing
            used = {0.0: plain, SHORT.get(split.dataset, REZERO): model.for_rezeroing}
            cells = " | ".join(_cell(one, testing, rezero) for rezero, one in used.items())
            judged = model.metadata.get("choice", {}).get("zero")
            if judged is not None:
                print(f"{split.title}: {judged}", file=sys.stderr)
            print(f"| {split.title} | {title} | {cells} | {took:.0f} |", flush=True)


def _cell(model: Calibration, testing: list[Recording], rezero: float) -> str:
    """RMSE of each joint, in the unit that a person reads."""
    scales = [display_unit(model.units[f"measured/{joint}"]).scale for joint in model.joints]
    return " ".join(f"{value:.3g}" for value in left(model, testing, rezero) * scales)


if __name__ == "__main__":
    main()
