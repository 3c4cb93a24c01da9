"""Every estimator of a jaw from its cables, as a class."""

from __future__ import annotations

from typing import Final

from truejoint.estimators.cable_least_squares import (
    CompensatedJawLeastSquares,
    JawLeastSquares,
    JawLeastSquaresIntercept,
)
from truejoint.estimators.friction_filter import FrictionFilter
from truejoint.estimators.friction_smoother import SmoothedFrictionFilter
from truejoint.estimators.gated_play import GatedPlay
from truejoint.estimators.jaw import JawEstimator
from truejoint.estimators.jaw_filter import CompensatedJawFilter, JawFilter
from truejoint.estimators.play import BothPlay, CablesPlay, MotorPlay, ResetPlay

JAW_CLASSES: Final[tuple[type[JawEstimator], ...]] = (
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
"""In the order of `registry.JAW_ESTIMATORS`."""
