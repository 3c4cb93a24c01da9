"""The unscented filter of yan2020 for the jaw, (15)-(24), without and with its compensation."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any, ClassVar, Final, Self

import numpy as np

from truejoint.array_types import Array
from truejoint.estimators.base import Arrays, Flags, Progress
from truejoint.estimators.jaw import JawEstimator, median_dt
from truejoint.estimators.rational import fit_rational
from truejoint.models import jaw_filter
from truejoint.models.family import Family, Params
from truejoint.models.jaw_dynamics import ForcepsModel, injection_gain, steady_gain
from truejoint.models.jaw_filter import MECHANISM_NAMES, NOISE_NAMES, FilterNoise

_OBSERVED: Final = np.array([[0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])


@dataclass(eq=False, repr=False)
class JawFilter(JawEstimator):
    """Unscented filter on the linear model (12): yan2020, (15)-(26).

    The measured speed is the difference of displacements. Friction, which (12) leaves out, is what
    the process noise stands for: it sets how far the filter trusts motor and slider. Since (12) is
    linear, this is a Kalman filter.

    What is left of the error is made up for by a constant, or by the error model (25), fitted to
    estimate minus truth (24). (26) adds that to the state; since it is the error, it must be
    subtracted, and since the next measurement takes part of it back, what is added must be divided
    by the loop's gain ``g`` for the whole of it to show.

    Parameters
    ----------
    compensation : {"constant", "output", "scaled", "signed", "literal"}
        A constant; or (25): subtracted from the output only; subtracted in the loop and divided by
        ``g``; subtracted in the loop; or added in the loop as (26) is printed.
    mechanism : ForcepsModel
        What the filter takes the forceps for; Table 1 by default.
    noise : FilterNoise
        What it does not know of it.
    lambda_ : float
        ``lambda`` of (15), above -4.
    fit_method : {"projection", "quasi_newton", "global"}
        How (25) is fitted: see `fit_rational`.

    Examples
    --------
    >>> JawFilter(compensation="output").set_params(gear_ratio=50.0).mechanism.gear_ratio
    50.0
    """

    family: ClassVar[Family] = jaw_filter.FAMILY
    compensation: str = "constant"
    mechanism: ForcepsModel = ForcepsModel()  # noqa: RUF009  # frozen
    noise: FilterNoise = FilterNoise()  # noqa: RUF009
    lambda_: float = -1.0
    fit_method: str = "projection"

    def set_params(self, **params: Any) -> Self:
        """Set parameters, those of mechanism and noise by their own names too."""
        own = {**params}
        for part, names in (("mechanism", MECHANISM_NAMES), ("noise", NOISE_NAMES)):
            given = {name: own.pop(name) for name in names if name in own}
            if given:
                own[part] = replace(own.get(part, getattr(self, part)), **given)
        super().set_params(**own)
        return self

    def model_params(self) -> Params:
        """Parameters as the family knows them: mechanism and noise by their own names."""
        own = {n: getattr(self, n) for n in ("compensation", "lambda_", "fit_method")}
        return {**asdict(self.mechanism), **asdict(self.noise), **own}

    @classmethod
    def from_params(cls, params: Params) -> Self:
        """Unfitted estimator of the parameters of its family."""
        own = {n: params[n] for n in ("compensation", "lambda_", "fit_method")}
        return cls(
            mechanism=jaw_filter.mechanism_of(params), noise=jaw_filter.noise_of(params), **own
        )

    def loop_gain(self, dt: float) -> float:
        """``g`` of `jaw_dynamics.injection_gain` for rows `dt` [s] apart."""
        noise = self.noise
        density = self.mechanism.noise_density(
            noise.jaw_friction, noise.slider_friction, noise.correlation_time
        )
        transition, _gain, covariance = self.mechanism.discrete(density, dt)
        kalman = steady_gain(transition, covariance, _OBSERVED, noise.sensor)
        return injection_gain(transition, _OBSERVED, kalman)

    def filtered(self, X: Array, dt: Array) -> Array:
        """Angle of the bare filter (n,) [rad]: (23) without any compensation."""
        bare = JawFilter.from_params({**self.model_params(), "compensation": "constant"})
        bare.arrays_ = {"constant": np.zeros(1)}
        bare.n_features_in_, bare.n_outputs_ = 2, 1
        return bare.evaluate(X, dt)[:, 0]

    def _learn_jaw(self, X: Array, y: Array, dt: Array, known: Flags, progress: Progress) -> Arrays:
        error = self.filtered(X, dt)[known] - y[known]
        progress(0.3)
        if self.compensation == "constant":
            return {"constant": np.array([-float(np.mean(error))])}
        arrays = fit_rational(X[known, 0], X[known, 1], error, self.fit_method)
        return arrays | {"loop_gain": np.array([self.loop_gain(median_dt(dt))])}
