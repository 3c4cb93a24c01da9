"""How long fitting takes: 30 000 rows of 16 features and 3 joints, beside scikit-learn's network.

    python -m benchmarks.speed_training [--repeats 3]

Prints a Markdown table of wall times; the ratio is against `sklearn.neural_network.MLPRegressor`
with the same layers, epochs and batches, in the same run.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable

import numpy as np
from sklearn.neural_network import MLPRegressor
from sklearn.preprocessing import StandardScaler

from truejoint.estimators import LinearRegressor, NeuralNetwork, PolynomialRegressor

ROWS, FEATURES, JOINTS = 30_000, 16, 3


def rows(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Features and targets of a smooth function with noise."""
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(ROWS, FEATURES))
    mixed = X @ rng.normal(size=(FEATURES, JOINTS)) / 4
    return X, np.sin(mixed) + 0.1 * mixed**2 + rng.normal(0, 0.05, mixed.shape)


def peer(X: np.ndarray, y: np.ndarray) -> None:
    """scikit-learn's network, as peng2024 sets it up."""
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
    network.fit(
        StandardScaler().fit_transform(X).astype(np.float32),
        StandardScaler().fit_transform(y).astype(np.float32),
    )


def median_time(call: Callable[[], object], repeats: int) -> float:
    """Median wall time [s] of a call."""
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        call()
        times.append(time.perf_counter() - began)
    return statistics.median(times)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=3)
    repeats = parser.parse_args().repeats
    X, y = rows()
    NeuralNetwork(epochs=1).fit(X[:2048], y[:2048])  # libraries loaded, kernels compiled
    calls: dict[str, Callable[[], object]] = {
        "linear": lambda: LinearRegressor().fit(X, y),
        "poly2": lambda: PolynomialRegressor().fit(X, y),
        "dnn, 200 epochs": lambda: NeuralNetwork().fit(X, y),
        "scikit-learn MLPRegressor, 200 epochs": lambda: peer(X, y),
    }
    times = {name: median_time(call, repeats) for name, call in calls.items()}
    base = times["scikit-learn MLPRegressor, 200 epochs"]
    print(
        f"| fit to {ROWS} x {FEATURES} | median of {repeats} [s] | of scikit-learn |\n|---|---|---|"
    )
    for name, value in times.items():
        print(f"| {name} | {value:.2f} | {value / base:.3f} |")


if __name__ == "__main__":
    main()
