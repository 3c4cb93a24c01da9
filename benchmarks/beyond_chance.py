"""How often two models that are equally good are told apart: by stretches, and by samples.

    python -m benchmarks.beyond_chance [--pairs 200]

What a linear model leaves on held-out recordings is drawn anew as Gaussian noise of its spectrum,
twice: two series that are equally far off and keep their memory as the real one does. Of such pairs
5 % may be told apart. Beside it, how often half the error is told from the whole. Prints a Markdown
table.
"""

from __future__ import annotations

import argparse

import numpy as np

from truejoint import calibrate, evaluate
from truejoint.array_types import Array
from truejoint.errors import RecordingError
from truejoint.evaluation import compare
from truejoint.evaluation.splits import recommended_sides
from truejoint.recordings.datasets import DATASETS


def again(error: Array, random: np.random.Generator) -> Array:
    """Gaussian series (n,) of the mean and, on the average, the power spectrum of `error` (n,)."""
    spectrum = np.abs(np.fft.rfft(error - error.mean()))
    real, imaginary = random.normal(scale=np.sqrt(0.5), size=(2, len(spectrum)))
    return np.fft.irfft(spectrum * (real + 1j * imaginary), len(error)) + error.mean()


def told_by_samples(own: list[Array], other: list[Array]) -> bool:
    """Whether a paired t-test over rows claims a difference at 95 %."""
    loss = np.concatenate(own) ** 2 - np.concatenate(other) ** 2
    return bool(abs(loss.mean()) > 1.96 * loss.std() / np.sqrt(len(loss)))


def main() -> None:
    """Print a row for each joint of each recommended split."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pairs", type=int, default=200)
    pairs = parser.parse_args().pairs
    random = np.random.default_rng(0)
    columns = ("equal, by stretches", "equal, by samples", "half told", "stretches")
    print(f"| data set, split | joint | {' | '.join(columns)} |")
    print("|---|---|---|---|---|---|")
    for dataset in DATASETS.values():
        for split in dataset.splits:
            try:
                training, testing = recommended_sides(dataset, split)
            except RecordingError as error:
                print(f"{dataset.name}: {error}")
                continue
            model = calibrate(
                training, "linear", features=list(dataset.features), fit_rate=dataset.fit_rate
            )
            result = evaluate(model, testing)
            for column, joint in enumerate(result.joints):
                left = [trace.error("linear")[:, column] for trace in result.traces]
                told = np.zeros(3)
                stretches = []
                for _ in range(pairs):
                    own, other = ([again(e, random) for e in left] for _ in range(2))
                    found = compare(own, other)
                    stretches.append(found.stretches)
                    half = compare([0.5 * e for e in own], other)
                    told += (
                        found.outcome != "cannot be told",
                        told_by_samples(own, other),
                        half.outcome == "better",
                    )
                shares = " | ".join(f"{100 * share:.0f} %" for share in told / pairs)
                middle = int(np.median(stretches))
                print(
                    f"| {dataset.name}, {split.name} | {joint} | {shares} | {middle} |", flush=True
                )


if __name__ == "__main__":
    main()
