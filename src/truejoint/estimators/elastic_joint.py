"""Unscented filter of an elastic joint with friction, driven and measured at its motor side."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from truejoint.errors import CalibrationError
from truejoint.estimators.base import Progress
from truejoint.estimators.elastic_joint_identification import (
    SETTLED,
    Motion,
    identify,
    mean_interval,
    regress,
    run,
)
from truejoint.estimators.jaw import has_jump, reversals
from truejoint.estimators.sequence import SequenceRegressor
from truejoint.filters import FilterState, UnscentedFilter
from truejoint.models import elastic_joint as model
from truejoint.models.elastic_joint import NOISE, ElasticJoint, output_terms

Array = NDArray[np.float64]

DRIVER: Final = "driver/jaw"
TORQUE: Final = "effort/jaw"
MIN_ROWS: Final = 400
"""Rows with truth that a fit needs at least."""
LEAST_LOAD_SPREAD: Final = 0.1
"""Least range of the loads calibrated with, in standard deviations of the driver's torque."""
_FILTER_INTERVAL: Final = 0.02  # [s] between the rows that the fit filters


@dataclass(frozen=True, eq=False)
class JointEstimate:
    """What the filter knows after each row.

    Attributes
    ----------
    outputs : ndarray, shape (n, n_outputs)
        The jaw's angle [rad], and its torque [Nm] if it was fitted to that as well.
    deviations : ndarray, shape (n, n_outputs)
        Their standard deviations: of the state, and of what the joint's model misses.
    load, load_deviation : ndarray, shape (n,)
        Torque that the driver would need to hold the load in the middle of its range if there were
        no friction, in the unit of the torque [Nm], and its standard deviation.
    """

    outputs: Array
    deviations: Array
    load: Array
    load_deviation: Array


@dataclass
class ElasticMemory:
    """What the filter remembers between rows: its state, and where the driver was."""

    state: FilterState | None = None
    angle: float = 0.0


class ElasticJointFilter(SequenceRegressor):
    """Unscented filter for a cable-driven jaw whose driver alone is measured: angle and torque.

    State: deflections of friction elements in series with springs (Prandtl-Ishlinskii, Maxwell
    slip), which the driver drags along; the load, a random walk; and the friction that the elements
    do not explain, which fades with travel. Measured: the driver's torque, the sum of all three
    through a response that bends with travel and load. The jaw hangs on an elastic cable, so its
    angle is another such response. Inertia is left out: on the da Vinci grasper at 0.5 Hz it is
    below a thousandth of the torque.

    Learnt: widths, responses, and how large and how lasting the unexplained friction is. Each
    recording that it learns from is taken to have one load throughout, and not all the same.

    Parameters
    ----------
    elements : int
        Friction elements, 1 to 12.
    load_drift : float
        How far the load wanders in a second, in standard deviations of the loads calibrated with.
    torque_noise : float
        Standard deviation of the torque's mean over a second, in standard deviations of the torque.
    """

    family: ClassVar[str] = "ukf_elastic"
    inputs: ClassVar[tuple[str, ...]] = (DRIVER, TORQUE)

    def __init__(
        self,
        elements: int = 5,
        load_drift: float = 0.05,
        torque_noise: float = 7e-3,
    ) -> None:
        self.elements = elements
        self.load_drift = load_drift
        self.torque_noise = torque_noise

    def minimum_rows(self, n_features: int) -> int:  # noqa: ARG002  # whatever they are
        """Four hundred rows."""
        return MIN_ROWS

    def to_arrays(self) -> dict[str, Array]:
        """Scales, noise, widths, and responses of torque and outputs; see `ElasticJoint`."""
        return {
            "scales": self.scales_,
            "noise": np.array([getattr(self.joint_, name) for name in NOISE]),
            "widths": self.joint_.widths,
            "torque": self.joint_.torque,
            "outputs": self.output_,
            "misfit": self.misfit_,
        }

    def _set_arrays(self, arrays: Mapping[str, Array]) -> None:
        self.joint_ = ElasticJoint.from_arrays(arrays)
        self.scales_ = arrays["scales"]
        self.output_ = np.ascontiguousarray(arrays["outputs"])
        self.misfit_ = arrays["misfit"]
        self._filter = UnscentedFilter(self.joint_.state_space(float(self.scales_[3])))

    def _fit_sequence(self, X: Array, y: Array, steps: Array, progress: Progress) -> None:
        if y.shape[1] > 2:
            raise CalibrationError(
                f"{self.name}: y has {y.shape[1]} columns; give the jaw's angle, or angle and "
                "torque"
            )
        known = np.asarray(np.isfinite(y).all(axis=1))
        self._check_motion(X, known, steps)
        angle, torque = X[:, 0], X[:, 1]
        low, high = float(angle.min()), float(angle.max())
        self.scales_ = np.array(
            [0.5 * (low + high), 0.5 * (high - low), torque.std(), mean_interval(steps)]
        )
        whole = self._motion(X, steps)
        kept = _thinned(steps, known)
        motion, targets = whole.pick(kept), y[kept]
        settled = np.flatnonzero(motion.travel > SETTLED)
        with_truth = known[kept][settled]
        if with_truth.sum() < MIN_ROWS:
            raise CalibrationError(
                f"{self.name}: {int(with_truth.sum())} rows with truth after a quarter of the "
                f"driver's range was travelled; it needs {MIN_ROWS}: record longer motions"
            )
        progress(0.05)
        joint = identify(
            motion,
            settled,
            with_truth,
            targets[settled[with_truth], 0],
            elements=int(self.elements),
            load_drift=float(self.load_drift),
            noise_density=float(self.torque_noise) ** 2,
        )
        self._check_loads(joint)
        progress(0.8)
        states, spread = run(joint, motion)
        rows = np.flatnonzero(known[kept])
        columns = output_terms(motion.angle[rows], states[rows])
        outputs = np.array([regress(columns, target) for target in targets[rows].T])
        left = np.mean((targets[rows] - columns @ outputs.T) ** 2, axis=0)
        by_state = _output_variance(motion.angle[rows], states[rows], spread[rows], outputs)
        arrays = {
            "scales": self.scales_,
            "noise": np.array([getattr(joint, name) for name in NOISE]),
            "widths": joint.widths,
            "torque": joint.torque,
            "outputs": outputs,
            "misfit": np.sqrt(np.maximum(left - by_state.mean(axis=0), 0.1 * left)),
        }
        self._set_arrays(arrays)
        progress(1.0)

    def _check_motion(self, X: Array, known: NDArray[np.bool_], steps: Array) -> None:
        if known.sum() < MIN_ROWS:
            raise CalibrationError(
                f"{self.name}: {int(known.sum())} rows with a known position; it needs {MIN_ROWS}"
            )
        for name, column in zip(self.inputs, X.T, strict=True):
            if not np.ptp(column[known]) > 0.0:
                raise CalibrationError(
                    f"{self.name}: {name} never changes; move the jaw over its range under load, "
                    "and check that the sensor is connected"
                )
        edges = [*np.flatnonzero(steps == 0.0).tolist(), len(X)]
        turns = 0
        for first, last in pairwise(edges):
            part = X[first:last, 0]
            if len(part) < 2 or not np.ptp(part) > 0.0:
                continue
            if has_jump(part):
                raise CalibrationError(
                    f"{self.name}: {self.inputs[0]} jumps between two rows further than it ever "
                    "moves; check its sensor and cut the recording before the jump"
                )
            turns += reversals(part)
        if turns < 2:
            raise CalibrationError(
                f"{self.name}: the driver reverses {turns} times in the training rows; friction "
                "shows only where the motion turns: record a motion there and back, twice"
            )

    def _check_loads(self, joint: ElasticJoint) -> None:
        if joint.load_deviation < LEAST_LOAD_SPREAD:
            raise CalibrationError(
                f"{self.name}: the load on the jaw varies by {joint.load_deviation:.2g} of the "
                f"torque's own variation, less than {LEAST_LOAD_SPREAD:g}; load and friction cannot"
                " be told apart: add recordings under other loads"
            )

    def evaluate(self, X: Array, steps: Array | None = None) -> Array:
        """Jaw angle (n, 1) [rad] for rows `X` (n, 2); with the torque (n, 2) if fitted to it."""
        motion = self._motion(X, _regular(X, steps))
        states, _ = run(self.joint_, motion, interval=float(self.scales_[3]))
        return self._outputs(motion.angle, states)

    def estimate(
        self, X: Array, steps: Array | None = None, *, smoothed: bool = False
    ) -> JointEstimate:
        """Angle, torque and load with their standard deviations.

        Parameters
        ----------
        X : ndarray, shape (n, 2)
            Driver angle [rad] and torque [Nm], in the order of time.
        steps : ndarray, shape (n,), optional
            Time since the row before [s], 0 where a history starts; rows 5 ms apart by default.
        smoothed : bool
            Use later rows as well, which no controller can.

        Returns
        -------
        JointEstimate
        """
        motion = self._motion(X, _regular(X, steps))
        states, spread = run(
            self.joint_, motion, smoothed=smoothed, interval=float(self.scales_[3])
        )
        load = int(self.elements)
        scale = float(self.scales_[2])
        variance = _output_variance(motion.angle, states, spread, self.output_) + self.misfit_**2
        return JointEstimate(
            outputs=self._outputs(motion.angle, states),
            deviations=np.sqrt(variance),
            load=states[:, load] * scale,
            load_deviation=np.sqrt(np.maximum(spread[:, load, load], 0.0)) * scale,
        )

    def start(self) -> ElasticMemory:
        """Memory before the first row."""
        return ElasticMemory()

    def step(self, state: ElasticMemory, interval: float, row: Array) -> Array:
        """Jaw angle (1,) [rad] of one row; see `SequenceRegressor.step`."""
        motion = self._motion(row[None], np.zeros(1))
        angle = float(motion.angle[0])
        if state.state is None or interval == 0.0:
            state.state = self._filter.initial_state(*self.joint_.prior())
            state.angle, interval = angle, 0.0
        self._filter.step(
            state.state, (float(motion.torque[0]),), (angle, angle - state.angle), interval
        )
        state.angle = angle
        return np.asarray(self._outputs(motion.angle, state.state.x[None])[0])

    def _motion(self, X: Array, steps: Array) -> Motion:
        middle, scale, torque, _interval = self.scales_
        return Motion(
            np.ascontiguousarray((X[:, 0] - middle) / scale),
            np.ascontiguousarray(X[:, 1] / torque),
            steps,
        )

    def _outputs(self, angle: Array, states: Array) -> Array:
        return _outputs(angle, states, self.output_)


def _outputs(angle: Array, states: Array, coefficients: Array) -> Array:
    out = np.empty((len(states), len(coefficients)))
    model.outputs(angle, states, states.shape[1] - 2, coefficients, out)
    return out


def _output_variance(angle: Array, states: Array, spread: Array, coefficients: Array) -> Array:
    """Variance (n, k) of the outputs for states (n, m + 2) with covariances `spread`."""
    slopes = []
    for i in range(states.shape[1]):
        width = np.sqrt(np.maximum(spread[:, i, i], 1e-12))
        ahead, behind = states.copy(), states.copy()
        ahead[:, i] += width
        behind[:, i] -= width
        difference = _outputs(angle, ahead, coefficients) - _outputs(angle, behind, coefficients)
        slopes.append(difference / (2.0 * width[:, None]))
    slope = np.stack(slopes, axis=2)
    return np.asarray(np.maximum(np.einsum("nki,nij,nkj->nk", slope, spread, slope), 0.0))


def _thinned(steps: Array, known: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Rows that the fit filters: the first of each history, those with truth, some between."""
    stride = max(1, round(_FILTER_INTERVAL / mean_interval(steps)))
    fresh = steps == 0.0
    count = np.arange(len(steps)) - np.flatnonzero(fresh)[np.cumsum(fresh) - 1]
    return np.flatnonzero(known | (count % stride == 0))


def _regular(X: Array, steps: Array | None) -> Array:
    if steps is not None:
        return steps
    regular = np.full(len(X), 5e-3)
    regular[:1] = 0.0
    return regular
