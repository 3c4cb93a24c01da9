"""The estimators that the experiments on the forceps compare, with their titles and sensors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from truejoint.errors import CalibrationError
from truejoint.estimators.base import JointRegressor
from truejoint.estimators.registry import get_estimator
from truejoint.estimators.sequence import SequenceRegressor
from truejoint.simulation.forceps.twin import ForcepsRun

Array = NDArray[np.float64]

SETTLED: Final = 2.2
"""Time from which errors count [s]: the motion swells for the first 2 s."""


@dataclass(frozen=True)
class Method:
    """One row of the tables.

    Attributes
    ----------
    key : str
        Name here and in JSON.
    title : str
        For a person.
    estimator : str
        Name in the registry of estimators.
    inputs : tuple of str
        Columns that it takes.
    strategy : int
        Of yan2020, II-B: 1 no sensor on a cable, 2 one, 3 both.
    origin : {"yan2020", "baseline", "ours"}
    """

    key: str
    title: str
    estimator: str
    inputs: tuple[str, ...]
    strategy: int
    origin: str


_MOTOR, _DRIVE, _RESET = "motor/jaw", "cable/drive", "cable/reset"

METHODS: Final = {
    method.key: method
    for method in (
        Method("rigid", "rigid cables, offset", "offset", (_MOTOR,), 1, "baseline"),
        Method("poly2_motor", "quadratic in motor angle", "poly2", (_MOTOR,), 1, "baseline"),
        Method("play_motor", "plays on motor angle", "play_motor", (_MOTOR,), 1, "ours"),
        Method("lsm", "least squares (29)", "lsm", (_DRIVE, _RESET), 3, "yan2020"),
        Method(
            "lsm_intercept", "(29) with intercept", "lsm_intercept", (_DRIVE, _RESET), 3, "baseline"
        ),
        Method(
            "lsm_compensated", "compensated least squares (30)", "lsm_compensated",
            (_MOTOR, _DRIVE, _RESET), 3, "yan2020",
        ),
        Method("poly2", "quadratic in motor angle, x2", "poly2", (_MOTOR, _RESET), 2, "baseline"),
        Method("ukf", "UKF (23), constant only", "ukf", (_MOTOR, _RESET), 2, "yan2020"),
        Method(
            "ukf_compensated", "UKF with compensation (26)", "ukf_compensated",
            (_MOTOR, _RESET), 2, "yan2020",
        ),
        Method("play_reset", "plays on x2", "play_reset", (_RESET,), 2, "ours"),
        Method("play_both", "plays on motor angle, x2", "play_both", (_MOTOR, _RESET), 2, "ours"),
        Method("play_cables", "plays on x1, x2", "play_cables", (_DRIVE, _RESET), 3, "ours"),
        Method("play_gated", "gated plays (our best)", "play_gated", (_MOTOR, _RESET), 2, "ours"),
        Method(
            "ukf_friction", "UKF with friction and load", "ukf_friction",
            (_MOTOR, _RESET), 2, "ours",
        ),
        Method(
            "ukf_friction_smoothed", "the same, smoothed (not causal)", "ukf_friction_smoothed",
            (_MOTOR, _RESET), 2, "ours",
        ),
    )
}  # fmt: skip
"""By key, in the order of the tables."""

BEST: Final = "play_gated"
PAPERS_BEST: Final = "ukf_compensated"


@dataclass(frozen=True, eq=False)
class Fitted:
    """A method fitted to one specimen."""

    method: Method
    model: JointRegressor

    def estimate(self, run: ForcepsRun, reset_zero: float = 0.0) -> Array:
        """Jaw angle (n,) [rad] in every row of a run, with ``x2`` less a known zero [m]."""
        X = columns(run, self.method.inputs)
        if _RESET in self.method.inputs:
            X[:, self.method.inputs.index(_RESET)] -= reset_zero
        if isinstance(self.model, SequenceRegressor):
            return np.asarray(self.model.predict(X, _steps(run)))
        estimate = np.asarray(self.model.predict(X))
        if self.method.key == "rigid":
            return estimate + rigid(run)
        return estimate


def columns(run: ForcepsRun, names: Sequence[str]) -> Array:
    """Columns (n, k) of a run by the names that its recording would have."""
    signals = {_MOTOR: run.motor, _DRIVE: run.drive, _RESET: run.reset}
    return np.column_stack([signals[name] for name in names])


def rigid(run: ForcepsRun) -> Array:
    """Jaw angle (n,) [rad] that rigid cables would have."""
    return np.asarray(run.parameters.mechanism.jaw_from_motor(run.motor))


def fit_methods(run: ForcepsRun, keys: Sequence[str]) -> dict[str, Fitted]:
    """Fit methods to a calibration run, to its reference encoder after the motion has swollen.

    Parameters
    ----------
    run : ForcepsRun
    keys : sequence of str
        In `METHODS`.

    Raises
    ------
    CalibrationError
        If a method is unknown or cannot be fitted.
    """
    unknown = [key for key in keys if key not in METHODS]
    if unknown:
        raise CalibrationError(f"no method {', '.join(unknown)}; known: {', '.join(METHODS)}")
    counted = run.t > SETTLED
    fitted = {}
    for key in keys:
        method = METHODS[key]
        model = get_estimator(method.estimator)
        X = columns(run, method.inputs)
        if isinstance(model, SequenceRegressor):
            model.fit(X, np.where(counted, run.reference, np.nan), steps=_steps(run))
        else:
            target = run.reference - rigid(run) if key == "rigid" else run.reference
            model.fit(X[counted], target[counted])
        fitted[key] = Fitted(method, model)
    return fitted


def _steps(run: ForcepsRun) -> Array:
    return np.diff(run.t, prepend=run.t[0])
