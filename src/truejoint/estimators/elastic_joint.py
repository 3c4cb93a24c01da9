"""Unscented filter of an elastic joint with friction, driven and measured at its motor side."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from truejoint.array_types import Array
from truejoint.errors import CalibrationError
from truejoint.estimators.base import Arrays, Flags, JointRegressor, Progress
from truejoint.estimators.elastic_joint_identification import (
    SETTLED,
    Motion,
    identify,
    mean_dt,
    regress,
    run,
)
from truejoint.estimators.jaw import MIN_ROWS, has_jump, reversals
from truejoint.models import elastic_joint as model
from truejoint.models.elastic_joint import DRIVER, NOISE, TORQUE, ElasticJoint, output_terms
from truejoint.models.family import Family
from truejoint.models.filtered import histories

LEAST_LOAD_SPREAD: Final = 0.1
"""Least range of the loads calibrated with, in standard deviations of the driver's torque."""
_FILTER_DT: Final = 0.02  # [s] between the rows that the fit filters


@dataclass(frozen=True, eq=False)
class JointEstimate:
    """What the filter knows after each row."""

    outputs: Array  # (n, n_outputs), jaw's angle [rad] and, if fitted to that as well, torque [Nm]
    deviations: Array  # (n, n_outputs), of the state, and of what the joint's model misses
    load: Array  # (n,), torque that would hold it in the middle without friction [Nm]
    load_deviation: Array  # (n,)


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
    recording that it learns from is taken to have one load throughout, and not all the same.

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
    least_rows: ClassVar[int] = MIN_ROWS
    elements: int = 5
    load_drift: float = 0.05
    torque_noise: float = 7e-3

    def _learn(self, X: Array, y: Array, dt: Array, progress: Progress) -> Arrays:
        if y.shape[1] > 2:
            raise CalibrationError(
                f"{self.name}: y has {y.shape[1]} columns; give the jaw's angle, or angle and "
                "torque"
            )
        known = self._known(y)
        self._check_motion(X, known, dt)
        angle, torque = X[:, 0], X[:, 1]
        low, high = float(angle.min()), float(angle.max())
        scales = np.array([0.5 * (low + high), 0.5 * (high - low), torque.std(), mean_dt(dt)])
        whole = _motion(X, scales, dt)
        kept = _thinned(dt, known)
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
        if joint.load_deviation < LEAST_LOAD_SPREAD:
            raise CalibrationError(
                f"{self.name}: the load on the jaw varies by {joint.load_deviation:.2g} of the "
                f"torque's own variation, less than {LEAST_LOAD_SPREAD:g}; load and friction cannot"
                " be told apart: add recordings under other loads"
            )
        progress(0.8)
        states, spread = run(joint, motion)
        rows = np.flatnonzero(known[kept])
        columns = output_terms(motion.angle[rows], states[rows])
        outputs = np.array([regress(columns, target) for target in targets[rows].T])
        left = np.mean((targets[rows] - columns @ outputs.T) ** 2, axis=0)
        given = motion.angle[rows], states[rows], spread[rows], outputs
        found, by_state = np.empty((2, len(rows), len(outputs)))
        model.output_rows(*given, found, by_state)
        progress(1.0)
        return {
            "scales": scales,
            "noise": np.array([getattr(joint, name) for name in NOISE]),
            "widths": joint.widths,
            "torque": joint.torque,
            "outputs": outputs,
            "misfit": np.sqrt(np.maximum(left - by_state.mean(axis=0), 0.1 * left)),
        }

    def _check_motion(self, X: Array, known: Flags, dt: Array) -> None:
        for name, column in zip((DRIVER, TORQUE), X.T, strict=True):
            if not np.ptp(column[known]) > 0.0:
                raise CalibrationError(
                    f"{self.name}: {name} never changes; move the jaw over its range under load, "
                    "and check that the sensor is connected"
                )
        turns = 0
        for rows in histories(dt):
            part = X[rows, 0]
            if len(part) < 2 or not np.ptp(part) > 0.0:
                continue
            if has_jump(part):
                raise CalibrationError(
                    f"{self.name}: {DRIVER} jumps between two rows further than it ever "
                    "moves; check its sensor and cut the recording before the jump"
                )
            turns += reversals(part)
        if turns < 2:
            raise CalibrationError(
                f"{self.name}: the driver reverses {turns} times in the training rows; friction "
                "shows only where the motion turns: record a motion there and back, twice"
            )

    def estimate(
        self, X: Array, dt: ArrayLike | None = None, *, smoothed: bool = False
    ) -> JointEstimate:
        """Angle, torque and load, with their deviations, of rows `X` (n, 2) in the order of time.

        `dt` (n,) is as for `fit`; `smoothed` uses later rows as well, which no controller can.
        """
        times = self.time_steps(dt, len(X))
        arrays = self.arrays_
        motion = _motion(X, arrays["scales"], times)
        states, spread = run(
            ElasticJoint.from_arrays(arrays),
            motion,
            smoothed=smoothed,
            dt=float(arrays["scales"][3]),
        )
        outputs, variance = np.empty((2, len(X), len(arrays["outputs"])))
        model.output_rows(motion.angle, states, spread, arrays["outputs"], outputs, variance)
        elements, scale = int(self.elements), float(arrays["scales"][2])
        return JointEstimate(
            outputs=outputs,
            deviations=np.sqrt(variance + arrays["misfit"] ** 2),
            load=states[:, elements] * scale,
            load_deviation=np.sqrt(np.maximum(spread[:, elements, elements], 0.0)) * scale,
        )


def _motion(X: Array, scales: Array, dt: Array) -> Motion:
    middle, half_range, torque, _dt = scales
    return Motion(
        np.ascontiguousarray((X[:, 0] - middle) / half_range),
        np.ascontiguousarray(X[:, 1] / torque),
        dt,
    )


def _thinned(dt: Array, known: Flags) -> NDArray[np.int64]:
    """Rows that the fit filters: the first of each history, those with truth, some between."""
    stride = max(1, round(_FILTER_DT / mean_dt(dt)))
    fresh = dt == 0.0
    count = np.arange(len(dt)) - np.flatnonzero(fresh)[np.cumsum(fresh) - 1]
    return np.flatnonzero(known | (count % stride == 0))
