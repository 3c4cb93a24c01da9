"""Networks trained on the tool and on each joint, of several sizes, on the RAVEN twin.

    python -m benchmarks.pose_network [--sessions 2] [--minutes 10]

An arm like peng2024's and a homing for each session; zig-zags of sparsity 1/4, 1/5 and 1/6 to train
on, a random motion to be judged by. Prints a Markdown table with a figure for each session.
"""

from __future__ import annotations

import argparse

import numpy as np

from benchmarks.raven_estimators import sessions
from truejoint.estimators import NeuralNetwork, PoseNetwork
from truejoint.studies.raven2 import sessions as s
from truejoint.studies.raven2.rivals import errors_of

SIZES = ((4,), (12, 12), (100, 100))
FIRST_SEED = 50  # of the arms


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sessions", type=int, default=2)
    parser.add_argument("--minutes", type=float, default=10.0)
    options = parser.parse_args()
    recorded = sessions(FIRST_SEED, options.sessions, options.minutes)
    print(f"| hidden units | estimator | {' | '.join(s.TITLES)} | tool [mm] |\n" + "|---" * 6 + "|")
    for size in SIZES:
        for kind in (NeuralNetwork, PoseNetwork):
            rows = []
            for training, test in recorded:
                model = s.model_of(training, kind(hidden_layer_sizes=size))
                found = errors_of(model.correct(test), test)
                rows.append([*np.array(found["joint"]) * s.SCALES, 1e3 * found["tool"][-1]])
            cells = [" ".join(f"{value:.3f}" for value in column) for column in np.transpose(rows)]
            units = " ".join(map(str, size))
            print(f"| {units} | `{kind().name}` | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
