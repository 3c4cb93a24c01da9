"""What the unscented filter costs: a step from Python and a step in a whole record, one core.

Run with ``python benchmarks/filter_speed.py``. The model is the one of yan2020, (13): 4 states, 2
measurements, 1 control input. Where filterpy is installed it runs the same filter in the same run.
"""

from __future__ import annotations

import importlib.util
import itertools
import time

import numpy as np

from truejoint.estimators.state_space import StateSpaceModel, discretise, linear_model, van_loan
from truejoint.estimators.unscented import UnscentedFilter

ROWS = 20_000
RECORD = 10_000  # rows: short enough to be timed between two interruptions
REPEATS = 60
FILTERPY_ROWS = 1_000
DT = 1e-3
PRIOR = {"x0": np.zeros(4), "P0": np.diag([1e-2, 1e-2, 1e-8, 1e-4])}


def forceps() -> StateSpaceModel:
    """Spring-coupled jaw and slider with stiffnesses of the order of yan2020's Table 1."""
    A = np.array(
        [
            [0.0, 1.0, 0.0, 0.0],
            [-4.0e5, 0.0, 1.5e8, 0.0],
            [0.0, 0.0, 0.0, 1.0],
            [1.0e3, 0.0, -4.5e5, 0.0],
        ]
    )
    B = np.array([[0.0], [2.0e5], [0.0], [0.0]])
    F, G = discretise(A, B, DT)
    _, Q = van_loan(A, np.diag([0.0, 2e3, 0.0, 1e-2]), DT)
    C = np.array([[0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    return linear_model(
        F,
        G,
        C,
        np.zeros((2, 1)),
        Q,
        np.diag([1.6e-13, 1e-8]),
        states=("jaw", "jaw rate", "slider", "slider rate"),
        measurements=("slider", "slider rate"),
        inputs=("motor",),
    )


def time_steps(estimator: UnscentedFilter, z: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Time of each single step from Python [us]."""
    state = estimator.initial_state(**PRIOR)
    laps = np.empty(len(z))
    for k in range(len(z)):
        start = time.perf_counter_ns()
        estimator.step(state, z[k], u[k], DT)
        laps[k] = time.perf_counter_ns() - start
    return laps * 1e-3


def time_record(estimator: UnscentedFilter, z: np.ndarray, u: np.ndarray) -> tuple[float, float]:
    """Median and least time per row of a whole record [us]."""
    laps = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        estimator.run(z[:RECORD], u[:RECORD], **PRIOR, dt=DT)
        laps.append(time.perf_counter() - start)
    return float(np.median(laps)) / RECORD * 1e6, min(laps) / RECORD * 1e6


def time_filterpy(model: StateSpaceModel, z: np.ndarray, u: np.ndarray) -> float:
    """Median time of filterpy's predict and update [us]."""
    from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter  # noqa: PLC0415

    parameters = np.asarray(model.parameters)
    F, G = parameters[:16].reshape(4, 4), parameters[16:20]
    points = MerweScaledSigmaPoints(4, alpha=1.0, beta=2.0, kappa=0.0)

    def transition(x: np.ndarray, _dt: float, u: float) -> np.ndarray:
        return F @ x + G * u

    theirs = UnscentedKalmanFilter(4, 2, DT, hx=lambda x: x[2:], fx=transition, points=points)
    theirs.x, theirs.P = PRIOR["x0"].copy(), PRIOR["P0"].copy()
    theirs.Q, theirs.R = np.asarray(model.process_noise), np.asarray(model.measurement_noise)
    laps = np.empty(FILTERPY_ROWS)
    for k in range(FILTERPY_ROWS):
        start = time.perf_counter_ns()
        theirs.predict(u=u[k, 0])
        theirs.update(z[k])
        laps[k] = time.perf_counter_ns() - start
    return float(np.median(laps)) * 1e-3


def main() -> None:
    """Print a table."""
    model = forceps()
    rng = np.random.default_rng(0)
    u = 0.5 * np.sin(2 * np.pi * 0.5 * DT * np.arange(ROWS))[:, None]
    z = rng.normal(size=(ROWS, 2)) * [4e-7, 1e-4]
    print("yan2020's model: 4 states, 2 measurements, 1 input; times in us per step")
    print(
        f"{'form':<34}{'step: median':>14}{'p99':>8}{'p99.9':>8}{'record: median':>16}{'least':>8}"
    )
    best = np.inf
    for root, second in itertools.product((False, True), (True, False)):
        estimator = UnscentedFilter(model, second_generation=second, square_root=root)
        laps = time_steps(estimator, z, u)
        median, p99, p999 = np.percentile(laps, [50, 99, 99.9])
        form = (
            f"{'square-root' if root else 'standard'}, {'second' if second else 'first'} generation"
        )
        print(f"{form:<34}{median:>14.2f}{p99:>8.2f}{p999:>8.2f}", end="")
        typical, least = time_record(estimator, z, u)
        print(f"{typical:>16.3f}{least:>8.3f}")
        best = min(best, median)
    if importlib.util.find_spec("filterpy") is None:
        print("filterpy is not installed: no comparison")
        return
    theirs = time_filterpy(model, z, u)
    print(f"filterpy, predict and update: {theirs:.1f}; our step is {theirs / best:.0f} x faster")


if __name__ == "__main__":
    main()
