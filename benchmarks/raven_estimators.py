"""Every causal estimator, and the automatic choice, on the RAVEN twin like peng2024.

    python -m benchmarks.raven_estimators [--estimators NAME ...] [--sessions 3] [--first-seed 0]
        [--minutes 10]

Direction J2-J3 of `truejoint study directions`: in each session an arm of its own is homed, trained
on by zig-zags of sparsity 1/4, 1/5 and 1/6, and judged on a random motion with the laboratory's
speed profile. Prints a Markdown table of the RMSE of each session, and its mean over that of the
network, which is fitted besides, with the processor time of the fits.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from truejoint.evaluation.metrics import rmse
from truejoint.recordings import Recording
from truejoint.studies.raven2 import sessions as s

NETWORK = "dnn"
SPECIMEN = "peng2024"
USUAL = (
    "linear", "poly2_ridge", "run_out", "rich_play", "rich_trees", "coupled_play", "linear_trees",
    "gp", "gru", "auto",
)  # fmt: skip


def sessions(first: int, count: int, minutes: float) -> list[tuple[list[Recording], Recording]]:
    """Training and test of arms of seeds from `first` on, each after a homing of its own."""
    raven = s.specimens([SPECIMEN])[SPECIMEN]
    recorded = []
    for seed in range(first, first + count):
        arm, _ = s.homed(raven, seed)
        training = s.training_sets(arm, ("4+5+6",))["4+5+6"]
        test = s.random_test(arm, 60.0 * minutes, s.TEST_SEED + seed)
        recorded.append((training, test.with_truth(s.JOINTS)))
    return recorded


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--estimators", nargs="+", default=USUAL)
    parser.add_argument("--sessions", type=int, default=3)
    parser.add_argument("--first-seed", type=int, default=0, help="of the arms")
    parser.add_argument("--minutes", type=float, default=10.0)
    options = parser.parse_args()
    recorded = sessions(options.first_seed, options.sessions, options.minutes)
    print(f"| estimator | {' | '.join(s.TITLES)} | to the network | CPU [s] |\n" + "|---" * 6 + "|")
    base = None
    for name in dict.fromkeys((NETWORK, *options.estimators)):
        began = time.process_time()
        errors = []
        for training, test in recorded:
            model = s.model_of(training, name)
            errors.append(rmse(model.correct(test) - test.columns("truth", s.JOINTS)))
        took = time.process_time() - began
        found = np.array(errors) * s.SCALES
        base = found.mean(axis=0) if base is None else base
        cells = [" ".join(f"{value:.3f}" for value in column) for column in found.T]
        share = " ".join(f"{value:.2f}" for value in found.mean(axis=0) / base)
        print(f"| {name} | {' | '.join(cells)} | {share} | {took:.0f} |", flush=True)


if __name__ == "__main__":
    main()
