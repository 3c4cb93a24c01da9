"""How long fitting takes: 30 000 rows of 16 features and 3 joints, beside scikit-learn's network.

    python -m benchmarks.speed_training [--repeats 3]

Prints a Markdown table of wall times, with the error on 10 000 rows that no fit saw; the ratio is
against `sklearn.neural_network.MLPRegressor` with the same layers, epochs and batches, in the same
run.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from sklearn.compose import TransformedTargetRegressor
from sklearn.neural_network import MLPRegressor
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from truejoint.array_types import Array
from truejoint.estimators import NeuralNetwork, Polynomial

ROWS, UNSEEN, FEATURES, JOINTS = 30_000, 10_000, 16, 3
PEER = "scikit-learn MLPRegressor, 200 epochs"
NOISE = 0.05  # of the targets, which no model can know


def rows(seed: int = 0) -> tuple[Array, Array]:
    """Features and targets of a smooth function with noise, those that no fit sees last."""
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(ROWS + UNSEEN, FEATURES))
    mixed = X @ rng.normal(size=(FEATURES, JOINTS)) / 4
    return X, np.sin(mixed) + 0.1 * mixed**2 + rng.normal(0, NOISE, mixed.shape)


def peer(X: Array, y: Array) -> Any:
    """Fit scikit-learn's network, as peng2024 sets it up."""
    network = MLPRegressor(
        hidden_layer_sizes=(100, 100),
        activation="logistic",
        alpha=5e-4 * JOINTS * 1024,
        batch_size=1024,
        max_iter=200,
        tol=0.0,
        n_iter_no_change=10**6,
        random_state=0,
    )
    scaled = TransformedTargetRegressor(
        make_pipeline(StandardScaler(), network), transformer=StandardScaler(), check_inverse=False
    )
    return scaled.fit(X.astype(np.float32), y.astype(np.float32))


def timed(fit: Callable[[], Any], repeats: int) -> tuple[float, Any]:
    """Median wall time [s] of a fit, and what it gave."""
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        fitted = fit()
        times.append(time.perf_counter() - began)
    return statistics.median(times), fitted


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=3)
    repeats = parser.parse_args().repeats
    X, y = rows()
    seen, targets = X[:ROWS], y[:ROWS]
    NeuralNetwork(epochs=1).fit(X[:2048], y[:2048])  # libraries loaded, kernels compiled
    fits: dict[str, Callable[[], Any]] = {
        "linear": lambda: Polynomial(1).fit(seen, targets),
        "poly2": lambda: Polynomial().fit(seen, targets),
        "dnn, 200 epochs": lambda: NeuralNetwork(random_state=0).fit(seen, targets),
        PEER: lambda: peer(seen, targets),
    }
    found = {name: timed(fit, repeats) for name, fit in fits.items()}
    base = found[PEER][0]
    print(
        f"| fit to {ROWS} x {FEATURES} | median of {repeats} [s] | of scikit-learn "
        f"| RMSE on {UNSEEN} rows not seen (noise {NOISE}) |\n" + "|---" * 4 + "|"
    )
    for name, (seconds, fitted) in found.items():
        error = np.sqrt(np.mean((fitted.predict(X[ROWS:]) - y[ROWS:]) ** 2))
        print(f"| {name} | {seconds:.2f} | {seconds / base:.3f} | {error:.4f} |")


if __name__ == "__main__":
    main()
