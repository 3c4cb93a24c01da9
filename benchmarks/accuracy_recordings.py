"""Held-out accuracy on recordings of real instruments: raw, offset, linear, polynomial, network.

    python -m benchmarks.accuracy_recordings [--datasets NAME ...] [--seeds 3]

Each data set is split as it recommends: whole recordings, or the last part by time; the features
and settings are those of the data set. All features are causal. Prints a Markdown table.
"""

from __future__ import annotations

import argparse
import math
import time

import numpy as np

from truejoint import calibrate, evaluate
from truejoint.errors import RecordingError
from truejoint.estimators import NeuralNetwork
from truejoint.evaluation import split_by_time
from truejoint.recordings import Recording
from truejoint.recordings.datasets import DATASETS, Dataset, HeldOut, read_dataset
from truejoint.units import display_unit

METHODS = ("raw", "offset", "linear", "poly2", "dnn")


def sides(dataset: Dataset, split: HeldOut) -> tuple[list[Recording], list[Recording]]:
    """Training and held-out recordings of a recommended split."""
    recordings = read_dataset(dataset.name, split.files)
    if split.test:
        held_out = [split.holds_out(r.provenance.session) for r in recordings]
        pairs = list(zip(recordings, held_out, strict=True))
        return [r for r, out in pairs if not out], [r for r, out in pairs if out]
    parts = [split_by_time(r, 1.0 - split.test_fraction) for r in recordings]
    return [train for train, _ in parts], [test for _, test in parts]


def rows(dataset: Dataset, split: HeldOut, seeds: int, features: list[str] | None) -> list[str]:
    """Table rows of one split, one a joint."""
    training, testing = sides(dataset, split)
    began = time.perf_counter()
    models = [
        calibrate(
            training,
            NeuralNetwork(**dataset.settings.get("dnn", {}), random_state=seed),
            features=features,
            fit_rate=dataset.fit_rate,
        )
        for seed in range(seeds)
    ]
    took = (time.perf_counter() - began) / seeds
    result = evaluate({"dnn": models}, testing)
    lines = []
    for joint, unit in zip(result.joints, result.units, strict=True):
        shown = display_unit(unit)
        cells = []
        for method in METHODS:
            try:
                score = result.score(method, joint)
            except KeyError:
                cells.append("-")
                continue
            value = score.rmse * shown.scale
            decimals = max(0, 2 - math.floor(math.log10(value)))  # three digits
            spread = score.spread * shown.scale
            after = f" ± {spread:.{decimals}f}" if np.isfinite(spread) else ""
            cells.append(f"{value:.{decimals}f}{after}")
        lines.append(
            f"| {dataset.name}, {split.name} | {joint} [{shown.name}] | "
            + " | ".join(cells)
            + f" | {len(testing)} | {took:.0f} |"
        )
    return lines


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--datasets", nargs="+", default=list(DATASETS), choices=list(DATASETS))
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--plain", action="store_true", help="default features, no history")
    options = parser.parse_args()
    print("| data set, split | joint | " + " | ".join(METHODS) + " | held out | fit [s] |")
    print("|---|---|" + "---|" * (len(METHODS) + 2))
    for name in options.datasets:
        dataset = DATASETS[name]
        features = None if options.plain else list(dataset.features)
        for split in dataset.splits:
            try:
                print("\n".join(rows(dataset, split, options.seeds, features)), flush=True)
            except RecordingError as error:
                print(f"| {name}, {split.name} | {error} |", flush=True)


if __name__ == "__main__":
    main()
