"""Fits to recordings with gross outliers of the truth, against fits to the same without.

    python -m benchmarks.training_outliers [--datasets NAME ...] [--estimators linear dnn]
                                           [--seeds FROM:TO]

Two percent of the training rows of each joint are off by 10 to 60 spreads of what the robot's
signals leave unexplained. Prints the held-out RMSE as a multiple of that of the clean fit, joint by
joint, the spread of the clean fit over seeds, and how many honest rows a clean fit leaves out.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from truejoint import Calibration, calibrate, evaluate
from truejoint.array_types import Array
from truejoint.estimators import get_estimator
from truejoint.evaluation.splits import recommended_sides
from truejoint.recordings import Recording
from truejoint.recordings.datasets import DATASETS, Dataset, HeldOut
from truejoint.recordings.join.explained import explain


def spoiled(recordings: Sequence[Recording], seed: int) -> list[Recording]:
    """Put outliers into two percent of the rows of each truth column."""
    random = np.random.default_rng(seed)
    new = list(recordings)
    for joint in recordings[0].joints_of("truth"):
        spread = explain(recordings, joint).spread
        for k, recording in enumerate(new):
            truth = recording.column(f"truth/{joint}").copy()
            chosen = random.choice(len(truth), len(truth) // 50, replace=False)
            size = random.uniform(10.0, 60.0, len(chosen))
            truth[chosen] += spread * size * random.choice([-1.0, 1.0], len(chosen))
            table = recording.table.assign(**{f"truth/{joint}": truth})
            new[k] = replace(recording, table=table)
    return new


def fitted(dataset: Dataset, training: Sequence[Recording], name: str, seed: int) -> Calibration:
    """Fit as the data set recommends."""
    estimator = get_estimator(name).set_params(**dataset.settings.get(name, {}))
    how = {"features": dataset.features, "fit_rate": dataset.fit_rate}
    return calibrate(training, estimator, **how, random_state=seed)


def rows(dataset: Dataset, split: HeldOut, name: str, seeds: Sequence[int]) -> Iterator[str]:
    """Table rows of one split and estimator, one a joint."""
    training, testing = recommended_sides(dataset, split)
    clean = [fitted(dataset, training, name, seed) for seed in seeds]
    lost = clean[0].metadata["outliers"] / sum(len(r) for r in training)
    dirty = [fitted(dataset, spoiled(training, seed), name, seed) for seed in seeds]

    def errors(models: Sequence[Calibration]) -> Array:
        scores = (evaluate(model, testing) for model in models)
        return np.array([[s.score(name, joint).rmse for joint in s.joints] for s in scores])

    before, after = errors(clean), errors(dirty)
    ratio = after.mean(axis=0) / before.mean(axis=0)
    spread = before.std(axis=0, ddof=1) / before.mean(axis=0) if len(seeds) > 1 else 0 * ratio
    for joint, times, share in zip(clean[0].joints, ratio, spread, strict=True):
        label = f"{dataset.name}, {split.name}"
        yield f"| {label} | {joint} | {name} | {times:.3f} | {share:.3f} | {100 * lost:.3f} % |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    known = [name for name, dataset in DATASETS.items() if dataset.splits]
    parser.add_argument("--datasets", nargs="+", default=known, choices=known)
    parser.add_argument("--estimators", nargs="+", default=["linear"])
    parser.add_argument("--seeds", default="0:3", metavar="FROM:TO")
    options = parser.parse_args()
    first, _, last = options.seeds.partition(":")
    print("| data set, split | joint | estimator | of clean | clean, seeds | honest rows lost |")
    print("|---|---|---|---|---|---|")
    for name in options.datasets:
        dataset = DATASETS[name]
        for split in dataset.splits:
            for estimator in options.estimators:
                for row in rows(dataset, split, estimator, range(int(first), int(last))):
                    print(row, flush=True)


if __name__ == "__main__":
    main()
