"""Estimators of a cable-driven jaw from motor angle and cable displacements: yan2020, and past."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from truejoint.estimators.forceps.base import JawEstimator
    from truejoint.estimators.forceps.classes import JAW_CLASSES
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

# Which module each public name lives in; imported on first use, so that a control loop gets the
# kernels in this package without what fits them.
_HOMES = {
    "JAW_CLASSES": "classes",
    "BothPlay": "play",
    "CablesPlay": "play",
    "CompensatedJawFilter": "filter",
    "CompensatedJawLeastSquares": "least_squares",
    "ForcepsModel": "model",
    "FrictionFilter": "friction_filter",
    "GatedPlay": "gated",
    "JawEstimator": "base",
    "JawFilter": "filter",
    "JawLeastSquares": "least_squares",
    "JawLeastSquaresIntercept": "least_squares",
    "JawLoad": "load",
    "JawStates": "friction_filter",
    "MotorPlay": "play",
    "RationalModel": "rational",
    "ResetPlay": "play",
    "SmoothedFrictionFilter": "smoothing",
    "Stiffness": "load",
    "Zero": "rezero",
    "find_zero": "rezero",
    "fit_rational": "rational",
    "identify_stiffness": "load",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'truejoint.estimators.forceps' has no attribute {name!r}")
    return getattr(import_module(f"truejoint.estimators.forceps.{_HOMES[name]}"), name)
