"""Estimators of a cable-driven jaw from motor angle and cable displacements: yan2020, and past."""

from truejoint.estimators.forceps.base import JawEstimator
from truejoint.estimators.forceps.filter import CompensatedJawFilter, JawFilter
from truejoint.estimators.forceps.friction_filter import FrictionFilter, JawStates
from truejoint.estimators.forceps.gated import GatedPlay
from truejoint.estimators.forceps.least_squares import (
    CompensatedJawLeastSquares,
    JawLeastSquares,
    JawLeastSquaresIntercept,
)
from truejoint.estimators.forceps.load import JawLoad, Stiffness, identify_stiffness
from truejoint.estimators.forceps.model import ForcepsModel
from truejoint.estimators.forceps.play import BothPlay, CablesPlay, MotorPlay, ResetPlay
from truejoint.estimators.forceps.rational import RationalModel, fit_rational
from truejoint.estimators.forceps.rezero import Zero, find_zero
from truejoint.estimators.forceps.smoothing import SmoothedFrictionFilter

JAW_CLASSES: tuple[type[JawEstimator], ...] = (
    JawLeastSquares,
    JawLeastSquaresIntercept,
    CompensatedJawLeastSquares,
    JawFilter,
    CompensatedJawFilter,
    MotorPlay,
    ResetPlay,
    BothPlay,
    CablesPlay,
    GatedPlay,
    FrictionFilter,
    SmoothedFrictionFilter,
)

__all__ = [
    "JAW_CLASSES",
    "BothPlay",
    "CablesPlay",
    "CompensatedJawFilter",
    "CompensatedJawLeastSquares",
    "ForcepsModel",
    "FrictionFilter",
    "GatedPlay",
    "JawEstimator",
    "JawFilter",
    "JawLeastSquares",
    "JawLeastSquaresIntercept",
    "JawLoad",
    "JawStates",
    "MotorPlay",
    "RationalModel",
    "ResetPlay",
    "SmoothedFrictionFilter",
    "Stiffness",
    "Zero",
    "find_zero",
    "fit_rational",
    "identify_stiffness",
]
