"""Held-out error of estimators with a history, on default features, on recordings of real joints.

    python -m benchmarks.histories [--estimators NAME ...] [--only PATTERN ...]

Splits are those of `benchmarks.automatic_choice`, recommended and harder; nothing is set for a data
set but the rate of the rows that are fitted to. Prints, for each split and estimator, the RMSE of
each joint in degrees or millimetres, the same after the zero of each recording was taken from its
first two seconds (KUKA: one), and the processor time of the fit; or a dash, as of a filter for
another robot, and why on standard error.
"""

from __future__ import annotations

import argparse
import sys
import time
from fnmatch import fnmatch

from benchmarks.automatic_choice import REZERO, harder, left, recommended
from truejoint import calibrate
from truejoint.errors import CalibrationError
from truejoint.recordings.datasets import DATASETS
from truejoint.units import display_unit

SHORT = {"kuka_kr300_dual_encoder": 1.0}  # [s] to re-zero from, where a recording takes ten
RATE = 100.0  # [Hz] that recordings are thinned to


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--estimators", nargs="+", default=["linear", "rich_play", "rich_trees"])
    parser.add_argument("--only", nargs="+", default=["*"], help="patterns of titles, in turn")
    options = parser.parse_args()
    print("| data set, held out | estimator | RMSE | re-zeroed | CPU [s] |\n" + "|---" * 5 + "|")
    splits = [*recommended(), *harder()]
    for split in (one for only in options.only for one in splits if fnmatch(one.title, only)):
        training, testing = split.sides(RATE)
        for name in options.estimators:
            began = time.process_time()
            rate = DATASETS[split.dataset].fit_rate
            try:
                model = calibrate(training, name, fit_rate=rate)
            except CalibrationError as reason:
                print(f"{split.title}, {name}: {reason}", file=sys.stderr)
                print(f"| {split.title} | {name} | - | - | - |", flush=True)
                continue
            took = time.process_time() - began
            scales = [
                display_unit(model.units[f"measured/{joint}"]).scale for joint in model.joints
            ]
            cells = [
                " ".join(f"{value:.3g}" for value in left(model, testing, rezero) * scales)
                for rezero in (0.0, SHORT.get(split.dataset, REZERO))
            ]
            print(f"| {split.title} | {name} | {' | '.join(cells)} | {took:.0f} |", flush=True)


if __name__ == "__main__":
    main()
