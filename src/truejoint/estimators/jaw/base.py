"""What the estimators of the forceps' jaw have in common."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Final, Self

import numpy as np

from truejoint.array_types import Array, Integers
from truejoint.errors import CalibrationError
from truejoint.estimators.base import Arrays, Flags, JointRegressor, Progress
from truejoint.recordings import Recording
from truejoint.robots.cable_mechanism import Forceps

TABLE_1: Final = Forceps()
MIN_ROWS: Final = 400  # rows that a fit needs at least: two seconds at 200 Hz
_REVERSAL: Final = 0.05  # of the range that the jaw must come back to count as a reversal
_APART: Final = 10  # times as many rows as usual between two with truth: these are no neighbours


class JawEstimator(JointRegressor):
    """Base of the estimators of one jaw from motor angle and cable displacements.

    Calibrated as the paper does, on an unloaded motion with reversals, which show friction.
    """

    least_rows: ClassVar[int] = MIN_ROWS

    def for_recordings(self, recordings: Sequence[Recording]) -> Self:
        """Unfitted copy for the mechanism that was recorded.

        A parameter that was set to other than Table 1's value stays. Raises CalibrationError for a
        load on the jaw, a sensor that is not installed, and mechanisms that differ, and RobotError
        for one that cannot be.
        """
        inputs = self.family.inputs(self.model_params()) if self.family.inputs else ()
        for recording in recordings:
            if recording.provenance.load > 0.0:
                raise CalibrationError(
                    f"{recording.provenance.source or 'recording'}: a load of "
                    f"{1e3 * recording.provenance.load:g} g on the jaw; {self.name} learns how "
                    "motor and cables relate without one: record the calibration unloaded"
                )
            missing = [name for name in inputs if name not in recording.units]
            if missing:
                raise CalibrationError(
                    f"{recording.provenance.source or 'recording'}: no {' and no '.join(missing)}; "
                    f"{self.name} reads {' and '.join(inputs)}: install the sensor, or choose an "
                    "estimator that does without"
                )
        robots = (recording.robot.mechanism for recording in recordings)
        mechanism, *others = dict.fromkeys(TABLE_1 if m is None else Forceps.of(m) for m in robots)
        if others:
            raise CalibrationError(
                f"the recordings are of {1 + len(others)} different mechanisms; calibrate each by "
                "itself"
            )
        recorded, parameters = mechanism._asdict(), self.get_params(deep=False)
        usual = {n: v for n, v in recorded.items() if parameters.get(n) == getattr(TABLE_1, n)}
        return self.with_params(**usual)

    def _learn(self, X: Array, y: Array, dt: Array, progress: Progress) -> Arrays:
        if y.shape[1] != 1:
            raise CalibrationError(f"{self.name} estimates one jaw; y has {y.shape[1]} columns")
        has_truth = self._known(y)
        rows = np.flatnonzero(has_truth)
        apart = np.diff(rows, prepend=rows[0])  # far where a part of the truth is hidden
        history = np.cumsum(dt == 0.0)[rows] + np.cumsum(apart > _APART * np.median(apart))
        self._check_motion(X[rows], y[rows, 0], history)
        arrays = self._learn_jaw(X, y[:, 0], dt, has_truth, progress)
        progress(1.0)
        return arrays

    @abstractmethod
    def _learn_jaw(
        self, X: Array, y: Array, dt: Array, has_truth: Flags, progress: Progress
    ) -> Arrays:
        """Learn from rows `X` (n, k) and jaw angles `y` (n,), NaN where not `has_truth` (n,)."""

    def _check_motion(self, X: Array, y: Array, history: Integers) -> None:
        inputs = self.family.inputs(self.model_params()) if self.family.inputs else ()
        for name, column in (*zip(inputs, X.T, strict=True), ("the jaw's truth", y)):
            check_changes(self.name, name, column)
            check_jumps(self.name, name, column, history)
            longest = longest_standstill(column, X, inputs.index(name) if name in inputs else None)
            if longest > 0.2:
                raise CalibrationError(
                    f"{self.name}: {name} stands still for {100 * longest:.0f} % of the rows while "
                    "the others move on; its sensor is stuck: record the calibration again"
                )
        check_reversals(self.name, "jaw", reversals(y))


@dataclass(eq=False, repr=False, kw_only=True)
class MechanismEstimator(JawEstimator):
    """Base of those that know the mechanism; `calibrate` takes it from the recordings.

    Parameters
    ----------
    gear_ratio, spring_stiffness, wheel_radius, jaw_radius : float
        ``z_i``, ``K_sp`` [N/m], ``R`` [m] and ``r`` [m]; by default those of yan2020, Table 1.
    """

    gear_ratio: float = TABLE_1.gear_ratio
    spring_stiffness: float = TABLE_1.spring_stiffness
    wheel_radius: float = TABLE_1.wheel_radius
    jaw_radius: float = TABLE_1.jaw_radius


def check_changes(estimator: str, name: str, column: Array, how: str = "") -> None:
    """Raise CalibrationError when a signal (n,) stands still all the time."""
    if not np.ptp(column) > 0.0:
        raise CalibrationError(
            f"{estimator}: {name} never changes; move the jaw over its range{how}, and check that "
            "the sensor is connected"
        )


def check_jumps(estimator: str, name: str, column: Array, history: Integers) -> None:
    """Raise CalibrationError when a signal (n,) changes between two rows far more than usual.

    Far more is thirty times what it exceeds in one row of a hundred, and a fiftieth of its range.
    Between rows that differ in their number of `history` (n,) it may: the robot was homed.
    """
    moves = np.abs(np.diff(column)) * (np.diff(history) == 0)
    usual = float(np.quantile(moves, 0.99))
    if moves.max() > max(30.0 * usual, 0.02 * float(np.ptp(column))):
        raise CalibrationError(
            f"{estimator}: {name} jumps between two rows further than it ever moves; check its "
            "sensor and cut the recording before the jump"
        )


def check_reversals(estimator: str, what: str, count: int) -> None:
    """Raise CalibrationError for fewer than two reversals."""
    if count < 2:
        raise CalibrationError(
            f"{estimator}: the {what} reverses {count} times in the training rows; friction shows "
            "only where the motion turns: record a motion there and back, twice"
        )


def median_dt(dt: Array) -> float:
    """Median of the time between rows [s] within histories; 5 ms where there is only one row."""
    moved = dt[dt > 0.0]
    return float(np.median(moved)) if len(moved) else 5e-3


def reversals(y: Array) -> int:
    """Count the turns of a motion (n,), ignoring those below a twentieth of its range."""
    band = _REVERSAL * float(np.ptp(y))
    count, direction, extreme = 0, 0, float(y[0])
    for value in y[:: max(1, len(y) // 5000)]:
        if direction >= 0 and value > extreme:
            extreme = float(value)
            direction = direction or (1 if value > y[0] + band else 0)
        elif direction <= 0 and value < extreme:
            extreme = float(value)
            direction = direction or (-1 if value < y[0] - band else 0)
        elif direction != 0 and abs(value - extreme) > band:
            count, direction, extreme = count + 1, -direction, float(value)
    return count


def longest_standstill(column: Array, X: Array, place: int | None) -> float:
    """Longest stretch, of the rows, in which `column` (n,) repeats a value while others move.

    Another signal of `X` (n, k) than its `place` must move by a fifth of its range within it.
    """
    edges = np.concatenate([[0], np.flatnonzero(np.diff(column)) + 1, [len(column)]])
    others = X if place is None else np.delete(X, place, axis=1)
    least = 0.2 * np.ptp(others, axis=0)
    for i in np.argsort(np.diff(edges))[::-1][:20]:
        if (np.ptp(others[edges[i] : edges[i + 1]], axis=0) > least).any():
            return int(edges[i + 1] - edges[i]) / len(column)
    return 0.0
