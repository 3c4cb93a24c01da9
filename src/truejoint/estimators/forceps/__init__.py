"""Estimators of a cable-driven jaw from motor angle and cable displacements: yan2020, and past."""

from truejoint.estimators.forceps.base import JawEstimator
from truejoint.estimators.forceps.filter import CompensatedJawFilter, JawFilter
from truejoint.estimators.forceps.gated import GatedPlay
from truejoint.estimators.forceps.least_squares import (
    CompensatedJawLeastSquares,
    JawLeastSquares,
    JawLeastSquaresIntercept,
)
from truejoint.estimators.forceps.model import ForcepsModel
from truejoint.estimators.forceps.play import BothPlay, ResetPlay
from truejoint.estimators.forceps.rational import RationalModel, fit_rational

JAW_CLASSES: tuple[type[JawEstimator], ...] = (
    JawLeastSquares,
    JawLeastSquaresIntercept,
    CompensatedJawLeastSquares,
    JawFilter,
    CompensatedJawFilter,
    ResetPlay,
    BothPlay,
    GatedPlay,
)

__all__ = [
    "JAW_CLASSES",
    "BothPlay",
    "CompensatedJawFilter",
    "CompensatedJawLeastSquares",
    "ForcepsModel",
    "GatedPlay",
    "JawEstimator",
    "JawFilter",
    "JawLeastSquares",
    "JawLeastSquaresIntercept",
    "RationalModel",
    "ResetPlay",
    "fit_rational",
]
