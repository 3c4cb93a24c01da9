"""Unscented filter of an elastic joint with friction, driven and measured at its motor side.

There is one with boosted trees that learn what it leaves, too.
"""

from dataclasses import dataclass
from typing import ClassVar, Final, cast

import numpy as np
from scipy.optimize import least_squares

from truejoint.array_types import Array, Integers, Mask
from truejoint.errors import CalibrationError
from truejoint.estimators import registry
from truejoint.estimators.base import Arrays, JointRegressor, Progress
from truejoint.estimators.family import EstimatorData, Family
from truejoint.estimators.filtered import histories, joined, run_filter
from truejoint.estimators.jaw import learn as jaw
from truejoint.estimators.motor_side import run as model
from truejoint.estimators.plays.learn import PLAYS, TIME_CONSTANTS, feature_scales
from truejoint.estimators.plays.run import follow_rows
from truejoint.estimators.polynomial.learn import blocks, cross_validated, levels, ridge
from truejoint.estimators.rules import Params
from truejoint.estimators.trees.learn import TreeSum, tree_sum, trees_data
from truejoint.estimators.trees.run import FAMILY as TREES

LEAST_LOAD_SPREAD: Final = 0.1  # of the loads, in standard deviations of the driver's torque
SETTLED: Final = 0.5  # travel after which friction has forgotten how it began, in half ranges
_FILTER_DT: Final = 0.02  # [s] between the rows that the fit filters
_PENALTY: Final = 1e-7  # on standardised terms
_BENDS: Final = (0.0, 0.03, 0.1, 0.3, 1.0)  # sizes tried of terms that bend with the load
_WIDTHS: Final = (0.003, 1.0)  # of a friction element, least and largest, in half ranges
_FIRST_WIDTHS: Final = (0.012, 0.5)  # where the search for widths starts
_ROUNDS: Final = 8  # of loads and torque response in turn
_PLAYS: Final[Params] = {"plays": PLAYS, "time_constants": TIME_CONSTANTS}
"""What the trees see of the signals, driver and torque."""
_TREE_ROWS: Final = 40_000  # that the trees are fitted to, at most
_ASKED: Final = 0.15  # share of what is seen that a split of the trees may ask for
_FILTERED: Final = 0.6  # share of the fit's time that the filter takes


@dataclass(eq=False, repr=False)
class ElasticJointFilter(JointRegressor):
    """Unscented filter for a cable-driven jaw whose driver alone is measured: angle and torque.

    State: deflections of friction elements in series with springs (Prandtl-Ishlinskii, Maxwell
    slip), which the driver drags along; the load, a random walk; and the friction that the elements
    do not explain, which fades with travel. Measured: the driver's torque, the sum of all three
    through a response that bends with travel and load. The jaw hangs on an elastic cable, so its
    angle is another such response. Inertia is left out: on the da Vinci grasper at 0.5 Hz it is
    below a thousandth of the torque.

    Learnt: widths, responses, and how large and how lasting the unexplained friction is. Each
    recording that it learns from is taken to have one load throughout, and the loads must differ.
    The jaw's torque is a third response, told beside the angle, where `fit` is given it as `loads`
    (n, 1) [Nm]: by `calibrate`, recordings that have ``truth_effort/jaw``.

    Parameters
    ----------
    elements : int
        Friction elements, 1 to 12.
    load_drift : float
        How far the load wanders in a second, in standard deviations of the loads calibrated with.
    torque_noise : float
        Standard deviation of the torque's mean over a second, in standard deviations of the torque.

    Examples
    --------
    >>> ElasticJointFilter(elements=3).name
    'ukf_elastic'
    """

    family: ClassVar[Family] = model.FAMILY
    least_rows: ClassVar[int] = jaw.MIN_ROWS
    elements: int = 5
    load_drift: float = 0.05
    torque_noise: float = 7e-3

    fitted_params: ClassVar[Params] = {"tells_torque": False}

    def truth_beside(self) -> tuple[str, ...]:
        """Column of the jaw's torque; of a history in which it is 0 throughout it is not known."""
        return (model.JAW_TORQUE,)

    def _targets(self, y: Array, dt: Array) -> Array:
        """Angle, of `y` (n, 1), and torque where it is known in enough rows, NaN elsewhere."""
        history, read = np.cumsum(dt == 0.0), np.isfinite(self._loads) & (self._loads != 0.0)
        is_read = np.bincount(history, read[:, 0])[history, None] > 0.0
        torque = np.where(np.isfinite(y) & is_read, self._loads, np.nan)
        return np.hstack([y, torque] if np.isfinite(torque).sum() >= self.least_rows else [y])

    def _learn(self, X: Array, y: Array, dt: Array, progress: Progress) -> Arrays:
        has_truth = self._known(y)
        self._check_motion(X, has_truth, dt)
        low, high = float(X[:, 0].min()), float(X[:, 0].max())
        scales = np.array(
            [0.5 * (low + high), 0.5 * (high - low), X[:, 1].std(), jaw.usual_dt(dt, np.mean)]
        )
        chosen = thinned(dt, has_truth)
        motion = Motion((X[:, 0] - scales[0]) / scales[1], X[:, 1] / scales[2], dt).pick(chosen)
        settled = np.flatnonzero(motion.travel > SETTLED)
        with_truth = has_truth[chosen][settled]
        if with_truth.sum() < jaw.MIN_ROWS:
            raise CalibrationError(
                f"{self.name}: {int(with_truth.sum())} rows with truth after a quarter of the "
                f"driver's range was travelled; it needs {jaw.MIN_ROWS}: record longer motions"
            )
        progress(0.05)
        static = _Static(motion, settled, with_truth, y[chosen][settled[with_truth], 0])
        identified = static.identify(
            int(self.elements), float(self.load_drift), float(self.torque_noise) ** 2
        )
        load_deviation = identified["noise"][-1]
        if load_deviation < LEAST_LOAD_SPREAD:
            raise CalibrationError(
                f"{self.name}: the load on the jaw varies by {load_deviation:.2g} of the "
                f"torque's own variation, less than {LEAST_LOAD_SPREAD:g}; load and friction cannot"
                " be told apart: add recordings under other loads"
            )
        progress(0.8)
        filtered = {
            **identified,
            "scales": np.append(scales[:3], jaw.usual_dt(motion.dt, np.mean)),
            "outputs": np.zeros((1, len(identified["torque"]) + 2)),
            "misfit": np.zeros(1),
        }
        data = EstimatorData(model.FAMILY.name, self.model_params(), filtered)
        run = run_filter(data, X[chosen], motion.dt)
        targets = self._targets(y, dt)[chosen]
        self.fitted_params_ = {**self.fitted_params, "tells_torque": targets.shape[1] > 1}
        responses = [_response(motion, run.x, run.P, target) for target in targets.T]
        progress(1.0)
        return {
            **filtered,
            "scales": scales,
            "outputs": np.array([coefficients for coefficients, _ in responses]),
            "misfit": np.array([misfit for _, misfit in responses]),
        }

    def _check_motion(self, X: Array, has_truth: Mask, dt: Array) -> None:
        for name, column in zip((model.DRIVER, model.TORQUE), X.T, strict=True):
            jaw.check_changes(self.name, name, column[has_truth], " under load")
        jaw.check_jumps(self.name, model.DRIVER, X[:, 0], np.cumsum(dt == 0.0))
        turns = sum(jaw.reversals(X[rows, 0]) for rows in histories(dt))
        jaw.check_reversals(self.name, "driver", turns)


def thinned(dt: Array, has_truth: Mask) -> Integers:
    """Rows that the fit filters: the first of each history, those with truth, some between."""
    stride = max(1, round(_FILTER_DT / jaw.usual_dt(dt, np.mean)))
    fresh = dt == 0.0
    count = np.arange(len(dt)) - np.flatnonzero(fresh)[np.cumsum(fresh) - 1]
    return np.flatnonzero(has_truth | (count % stride == 0))


@dataclass(frozen=True, eq=False)
class Motion:
    """Rows of one or more histories, in units of the calibration."""

    angle: Array  # (n,), of the driver, as is the torque
    torque: Array
    dt: Array  # (n,), time since the row before [s], 0 where a history starts

    @property
    def history(self) -> Integers:
        """Number of each row's history (n,), from 0."""
        return np.asarray(np.cumsum(self.dt == 0.0) - 1, dtype=np.int64)

    @property
    def moved(self) -> Array:
        """How far the driver went since the row before (n,), 0 where a history starts."""
        return np.where(self.dt > 0.0, np.diff(self.angle, prepend=self.angle[:1]), 0.0)

    @property
    def travel(self) -> Array:
        """Way that the driver went since its history started (n,)."""
        way = np.cumsum(np.abs(self.moved))
        return np.asarray(way - way[self.dt == 0.0][self.history])

    def deflections(self, widths: Array) -> Array:
        """Deflections (n, m) of friction elements that start in the middle of each history."""
        out = np.empty((len(self.angle), len(widths)))
        follow_rows(self.dt, self.angle, widths, out)
        return out

    def pick(self, rows: Integers) -> "Motion":
        """Take some of the rows, in order and with the first of each history among them."""
        clock = np.cumsum(self.dt)
        dt = np.diff(clock[rows], prepend=clock[rows[:1]])
        fresh = np.diff(self.history[rows], prepend=-1) > 0
        return Motion(self.angle[rows], self.torque[rows], np.where(fresh, 0.0, dt))


def _response(motion: Motion, states: Array, spread: Array, target: Array) -> tuple[Array, float]:
    """Response (k,) of an output to states (n, m + 2) of the filter, of covariance `spread`.

    Of its values `target` (n,), NaN where unknown; and the deviation of what it misses of them.
    """
    rows = np.flatnonzero(np.isfinite(target))
    angle, y = motion.angle[rows], target[rows]
    columns = model.output_terms(angle, states[rows])
    coefficients = respond(columns, y, states[rows, -2], motion.history[rows], motion.dt[rows])
    outputs, by_state = np.empty((2, len(rows), 1))
    model.output_rows(angle, states[rows], spread[rows], coefficients, outputs, by_state)
    mean_square = float(np.mean((y - outputs[:, 0]) ** 2))
    return coefficients[0], np.sqrt(max(mean_square - float(by_state.mean()), 0.1 * mean_square))


def respond(columns: Array, y: Array, load: Array, history: Integers, dt: Array) -> Array:
    """Responses (n_outputs, k) to `columns` (n, k), the first constant, of outputs `y` (n, ...).

    How much they may bend with the load, and the penalty, are those that err least on histories
    under loads that are left out in turn: three loads are no reason for a cubic. Of one history,
    on blocks of it.
    """
    _, place = np.unique(history, return_inverse=True)
    count = np.bincount(place)
    parts = levels(np.bincount(place, load) / count)
    rows = [np.isin(place, part) for part in parts] if len(parts) > 1 else blocks(dt)
    table = np.column_stack([columns, y])
    products = np.array([table[some].T @ table[some] for some in rows])
    elements = (columns.shape[1] - 2 - model.POLYNOMIAL) // model.PER_ELEMENT
    bent = [load > 1 for _, load in (*model.CUBIC, *model.QUADRATIC * elements)][1:]
    weights = [np.where([*bent, False, False], share, 1.0) for share in _BENDS]
    return np.ascontiguousarray(cross_validated(products, weights).coefficients.T)


def regress_torque(columns: Array, torque: Array, load: Array) -> tuple[Array, Array]:
    """Torque response (p,) of which the load is a part as it is, and what it leaves over (n,)."""
    free = [i for i in range(columns.shape[1]) if i not in model.LOAD_TERMS]
    coefficients = np.zeros(columns.shape[1])
    coefficients[free] = ridge(columns[:, free], torque - load, _PENALTY)[0]
    coefficients[model.LOAD_TERMS[1]] = 1.0
    return coefficients, torque - columns @ coefficients


class _Static:
    """Rows (k,) of a motion to fit the static responses to, with one load for each history.

    The torque's response needs no truth and is fitted to all `rows`, after friction has `SETTLED`;
    the jaw's to those `known` (k,), where its angle is `jaw`. Loads and the torque's response are
    found by turns, the elements' widths by variable projection on torque and jaw angle together.
    """

    def __init__(self, motion: Motion, rows: Integers, has_truth: Mask, jaw: Array) -> None:
        self.motion, self.rows, self.has_truth, self.jaw = motion, rows, has_truth, jaw
        self.angle, self.torque = motion.angle[rows], motion.torque[rows]
        _, self.history = np.unique(motion.history[rows], return_inverse=True)
        self.load = self._mean(self.torque)

    def columns(self, widths: Array) -> Array:
        """Terms (n, p) of the responses."""
        deflections = self.motion.deflections(widths)[self.rows]
        return model.terms(self.angle, self.load, deflections)

    def settle_loads(self, widths: Array) -> None:
        """Find the load of each row's history, and the torque response, by turns."""
        for _ in range(_ROUNDS):
            residual = regress_torque(self.columns(widths), self.torque, self.load)[1]
            self.load = self.load + self._mean(residual)

    def misfits(self, widths: Array) -> tuple[Array, Array]:
        """Find what the best responses leave of torque (n,) and jaw angle (k,)."""
        columns = self.columns(widths)
        residual = regress_torque(columns, self.torque, self.load)[1]
        columns = columns[self.has_truth]
        weights, constant = ridge(columns, self.jaw, _PENALTY)
        weights[0] = constant  # of the first column, which is constant
        return residual, self.jaw - columns @ weights

    def find_widths(self, elements: int) -> Array:
        """Widths by variable projection: the responses are solved for at every trial."""
        start = np.geomspace(*_FIRST_WIDTHS, elements)
        self.settle_loads(start)
        # As if both had independent errors of their own size: their likelihoods then add up.
        scales = [max(float(e.std()), 1e-12) * np.sqrt(len(e)) for e in self.misfits(start)]

        def residuals(logarithms: Array) -> Array:
            misfits = self.misfits(np.exp(logarithms))
            return np.concatenate([e / scale for e, scale in zip(misfits, scales, strict=True)])

        x0, bounds = np.log(start), (np.log(_WIDTHS[0]), np.log(_WIDTHS[1]))
        search = least_squares(residuals, x0, bounds=bounds, diff_step=[0.05], max_nfev=15)
        widths = np.sort(np.exp(search.x))
        self.settle_loads(widths)
        return widths

    def identify(self, elements: int, load_drift: float, noise_density: float) -> Arrays:
        """Identify widths, torque response and noise of a joint."""
        widths = self.find_widths(elements)
        torque, residual = regress_torque(self.columns(widths), self.torque, self.load)
        spread = max(float(self.load.std()), 1e-6)
        noise = {
            "load_density": (load_drift * spread) ** 2,
            "rest_deviation": max(float(residual.std()), 1e-6),
            "rest_travel": _memory(residual, self.motion.travel[self.rows]),
            "noise_density": noise_density,
            "load_mean": float(self.load.mean()),
            "load_deviation": spread,
        }
        in_order = np.array([noise[name] for name in model.NOISE])
        return {"noise": in_order, "widths": widths, "torque": torque}

    def _mean(self, values: Array) -> Array:
        """Mean of values (n,) in the history of each row."""
        return (np.bincount(self.history, values) / np.bincount(self.history))[self.history]


def _memory(residual: Array, travel: Array) -> float:
    """Travel over which `residual` (n,) forgets itself, from neighbours a small way apart."""
    distance = np.diff(travel, prepend=travel[:1])
    near = np.flatnonzero((distance > 0.02) & (distance < 0.1))
    if not len(near):
        return 0.05
    alike = float(
        np.mean(residual[near] * residual[near - 1]) / max(float(np.mean(residual**2)), 1e-300)
    )
    return float(-distance[near].mean() / np.log(min(max(alike, 0.05), 0.99)))


@dataclass(eq=False, repr=False)
class ElasticJointHybrid(ElasticJointFilter):
    """`ElasticJointFilter`, and boosted trees that learn what it leaves.

    They see plays and low-passes of driver and torque, and what the filter estimates besides, its
    friction and load included. Each split may ask for a few of these, drawn at random as in a
    random forest (Breiman, Machine Learning 45, 2001), since the load by itself would tell the
    recordings apart. It needs the same as the filter; loads and all deviations are the filter's
    own.

    Examples
    --------
    >>> ElasticJointHybrid(elements=3).name
    'hybrid'
    """

    family: ClassVar[Family] = model.HYBRID_ROWS

    fitted_params: ClassVar[Params] = {
        **ElasticJointFilter.fitted_params, **_PLAYS,
        "model": (TREES.name, dict.fromkeys(TREES.rules, 1), ()),
    }  # fmt: skip

    def _learn(self, X: Array, y: Array, dt: Array, progress: Progress) -> Arrays:
        filtered = super()._learn(X, y, dt, lambda done: progress(_FILTERED * done))
        with_truth = np.flatnonzero(self._known(y))
        chosen = with_truth[:: -(-len(with_truth) // _TREE_ROWS)]
        filtered |= feature_scales(X[with_truth])
        run = run_filter(EstimatorData(self.family.name, self.model_params(), filtered), X, dt)
        inputs, told = run.sighted[chosen], np.hstack([run.outputs, run.beside[:, 0]])[chosen]
        sums: list[TreeSum] = []
        for residual in (self._targets(y, dt)[chosen] - told).T:
            rows = np.isfinite(residual)
            unfitted = registry.member(registry.BOOSTED_TREES).set_params(max_features=_ASKED)
            fitted = tree_sum(unfitted.fit(inputs[rows], residual[rows]))
            sums.append(cast("TreeSum", fitted))
        progress(1.0)
        trees = trees_data(sums, np.zeros(inputs.shape[1]), np.ones(inputs.shape[1]))
        self.fitted_params_ |= {"model": (TREES.name, trees.params, ())}
        return joined(filtered, trees.arrays)
