"""Every estimator of a jaw from its cables, as a class."""

from __future__ import annotations

from typing import Final

from truejoint.estimators.forceps.base import JawEstimator
from truejoint.estimators.forceps.filter import CompensatedJawFilter, JawFilter
from truejoint.estimators.forceps.friction_filter import FrictionFilter
from truejoint.estimators.forceps.gated import GatedPlay
from truejoint.estimators.forceps.least_squares import (
    CompensatedJawLeastSquares,
    JawLeastSquares,
    JawLeastSquaresIntercept,
)
from truejoint.estimators.forceps.play import BothPlay, CablesPlay, MotorPlay, ResetPlay
from truejoint.estimators.forceps.smoothing import SmoothedFrictionFilter

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
"""In the order of `names.JAW_ESTIMATORS`."""
