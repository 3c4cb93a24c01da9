"""What the unscented filter costs: a step from Python and a step in a whole record, one core.

    python -m benchmarks.filter_speed

The model is the one of yan2020, (13): 4 states, 2 measurements, 1 control input. filterpy, pykalman
and Stone Soup run an unscented filter of the same size in the same run, where they are installed.
"""

from __future__ import annotations

import datetime as dt
import importlib.util
import itertools
import time
from collections.abc import Callable

import numpy as np

from truejoint.estimators.cables import loops as cable_loops
from truejoint.estimators.cables.learn import STARTS, constants, filter_inputs
from truejoint.estimators.cables.run import cable_filter, cable_prior
from truejoint.filters import UnscentedFilter
from truejoint.filters.linear import discretise, linear_model, van_loan
from truejoint.filters.state_space import StateSpaceModel
from truejoint.simulation.wrist.twin import WristTwin
from truejoint.studies.wrist import motions

ROWS = 20_000
RECORD = 10_000  # rows: short enough to be timed between two interruptions
REPEATS = 60
PEER_ROWS = 1_000
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


def time_filterpy(model: StateSpaceModel, z: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Time of each of filterpy's predictions and updates [us]."""
    from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter  # noqa: PLC0415

    F, G = _matrices(model)
    points = MerweScaledSigmaPoints(4, alpha=1.0, beta=2.0, kappa=0.0)

    def transition(x: np.ndarray, _dt: float, u: float) -> np.ndarray:
        return F @ x + G * u

    theirs = UnscentedKalmanFilter(4, 2, DT, hx=lambda x: x[2:], fx=transition, points=points)
    theirs.x, theirs.P = PRIOR["x0"].copy(), PRIOR["P0"].copy()
    theirs.Q, theirs.R = np.asarray(model.process_noise), np.asarray(model.measurement_noise)

    def step(k: int) -> None:
        theirs.predict(u=u[k, 0])
        theirs.update(z[k])

    return _laps(step)


def time_pykalman(model: StateSpaceModel, z: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Time of each of pykalman's updates [us]."""
    from pykalman import AdditiveUnscentedKalmanFilter  # noqa: PLC0415

    F, G = _matrices(model)
    theirs = AdditiveUnscentedKalmanFilter(
        transition_covariance=np.asarray(model.process_noise),
        observation_functions=lambda x: x[2:],
        observation_covariance=np.asarray(model.measurement_noise),
    )
    state = [PRIOR["x0"], PRIOR["P0"]]

    def step(k: int) -> None:
        state[:] = theirs.filter_update(
            *state, z[k], transition_function=lambda x: F @ x + G * u[k, 0]
        )

    return _laps(step)


def time_stonesoup(model: StateSpaceModel, z: np.ndarray, _u: np.ndarray) -> np.ndarray:
    """Time of each of Stone Soup's predictions and updates [us]; it gets no control input."""
    from stonesoup.models.measurement.linear import LinearGaussian  # noqa: PLC0415
    from stonesoup.models.transition.linear import LinearGaussianTimeInvariantTransitionModel  # noqa: PLC0415
    from stonesoup.predictor.kalman import UnscentedKalmanPredictor  # noqa: PLC0415
    from stonesoup.types.detection import Detection  # noqa: PLC0415
    from stonesoup.types.hypothesis import SingleHypothesis  # noqa: PLC0415
    from stonesoup.types.state import GaussianState  # noqa: PLC0415
    from stonesoup.updater.kalman import UnscentedKalmanUpdater  # noqa: PLC0415

    F, _ = _matrices(model)
    predictor = UnscentedKalmanPredictor(
        LinearGaussianTimeInvariantTransitionModel(
            transition_matrix=F, covariance_matrix=np.asarray(model.process_noise)
        )
    )
    updater = UnscentedKalmanUpdater(LinearGaussian(4, (2, 3), np.asarray(model.measurement_noise)))
    start = dt.datetime(2024, 1, 1, tzinfo=dt.UTC)
    state = [GaussianState(PRIOR["x0"][:, None], PRIOR["P0"], timestamp=start)]

    def step(k: int) -> None:
        now = start + dt.timedelta(seconds=DT * (k + 1))
        prediction = predictor.predict(state[0], timestamp=now)
        detection = Detection(z[k][:, None], timestamp=now)
        state[0] = updater.update(SingleHypothesis(prediction, detection))

    return _laps(step)


PEERS: dict[str, Callable[[StateSpaceModel, np.ndarray, np.ndarray], np.ndarray]] = {
    "filterpy": time_filterpy,
    "pykalman": time_pykalman,
    "stonesoup": time_stonesoup,
}


def _matrices(model: StateSpaceModel) -> tuple[np.ndarray, np.ndarray]:
    parameters = np.asarray(model.parameters)
    return parameters[:16].reshape(4, 4), parameters[16:20]


def _laps(step: Callable[[int], None]) -> np.ndarray:
    laps = np.empty(PEER_ROWS)
    for k in range(PEER_ROWS):
        start = time.perf_counter_ns()
        step(k)
        laps[k] = time.perf_counter_ns() - start
    return laps * 1e-3


def main() -> None:
    """Print a table."""
    model = forceps()
    rng = np.random.default_rng(0)
    u = 0.5 * np.sin(2 * np.pi * 0.5 * DT * np.arange(ROWS))[:, None]
    z = rng.normal(size=(ROWS, 2)) * [4e-7, 1e-4]
    print(
        "One step, us | median | p99 | p99.9 | over 1 ms | a row of a whole record: median, least"
    )
    print("---|---|---|---|---|---")
    best = np.inf
    for root, second in itertools.product((False, True), (True, False)):
        estimator = UnscentedFilter(model, second_generation=second, square_root=root)
        laps = time_steps(estimator, z, u)
        form = (
            f"{'square-root' if root else 'standard'}, {'second' if second else 'first'} generation"
        )
        typical, least = time_record(estimator, z, u)
        print(f"ours, {form} | {_percentiles(laps)} | {typical:.2f}, {least:.2f}", flush=True)
        best = min(best, float(np.median(laps)))
    estimator, (x0, p0), efforts, inputs = wrist()
    state, laps = estimator.initial_state(x0, p0), np.empty(len(efforts))
    for k, (effort, given) in enumerate(zip(efforts, inputs, strict=True)):
        start = time.perf_counter_ns()
        estimator.step(state, effort, given, 5e-3)
        laps[k] = time.perf_counter_ns() - start
    print(f"ours, a wrist: 15 states, 3 efforts | {_percentiles(laps * 1e-3)} |", flush=True)
    for name, peer in PEERS.items():
        if importlib.util.find_spec(name) is None:
            print(f"{name} is not installed | | | | |")
            continue
        laps = peer(model, z, u)
        print(f"{name} ({np.median(laps) / best:.0f} x ours) | {_percentiles(laps)} |", flush=True)
    print(
        "\nyan2020's model (13): 4 states, 2 measurements, 1 input. The floor in C is measured by"
    )
    print("benchmarks.exported_c_speed, beside the same filter in Python.")


def wrist() -> tuple[UnscentedFilter, tuple[np.ndarray, np.ndarray], np.ndarray, np.ndarray]:
    """Filter of a wristed instrument, its prior, and efforts and inputs of half a minute."""
    twin = WristTwin(seed=1)
    twin.home()
    recording = motions.record(twin, motions.paused_sines, 30.0, 1, load=True)
    X = np.hstack([recording.columns(kind, twin.robot.joint_names) for kind in ("motor", "effort")])
    parameters = constants(twin.robot.mechanism, STARTS)  # type: ignore[arg-type]
    parameters[cable_loops.LOAD_RATE : cable_loops.LOAD_RATE + cable_loops.N] = 1e-3
    arrays = {"parameters": parameters, "effort_misfit": np.full(3, 3e-3), "dt": np.array([5e-3])}
    inputs = filter_inputs(X, np.diff(recording.t, prepend=recording.t[0]))
    return cable_filter(arrays), cable_prior(parameters), X[:, cable_loops.N :], inputs


def _percentiles(laps: np.ndarray) -> str:
    median, p99, p999 = np.percentile(laps, [50, 99, 99.9])
    return f"{median:.2f} | {p99:.2f} | {p999:.2f} | {100 * np.mean(laps > 1e3):.2f} %"


if __name__ == "__main__":
    main()
