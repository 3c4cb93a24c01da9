"""Sigma points: how far they stand from the mean and what they weigh.

The kernels place 2 L points at plus and minus `reach` times the columns of a covariance factor and
let each weigh 1 / (2 reach^2). The centre's weights follow from that, because mean weights sum to
one; in terms of differences d_i from the centre's image and their weighted sum mu,

    mean = centre + mu,        covariance = sum_i w d_i d_i' + centre_correction mu mu'.

This is the usual weighted sum, rearranged: the centre's weight, about -1e6 for a small alpha,
never appears, and neither do the digits that it would cost.
"""

import math
from dataclasses import dataclass

from truejoint.errors import TruejointError


class FilterError(TruejointError):
    """A filter, a state-space model or a record for one that breaks a rule.

    Examples
    --------
    >>> issubclass(FilterError, ValueError)
    True
    """


@dataclass(frozen=True)
class ScaledSigmaPoints:
    """Scaled unscented transform (Wan and van der Merwe, 2000).

    With an `alpha` of 1 and a `beta` of 0 it is the plain form, where `kappa` is the ``lambda`` of
    yan2020, (15) and (18): the centre weighs ``kappa / (L + kappa)`` in mean and covariance alike.
    With ``kappa < 0`` a strongly curved model can make that covariance indefinite; the filter then
    leaves the offending term out and says so in its status.

    Parameters
    ----------
    alpha : float
        Spread of the points around the mean, 0 < alpha <= 1 as a rule.
    beta : float
        Knowledge of the distribution; 2 is best for a Gaussian.
    kappa : float
        Secondary scaling, kappa > -L for L dimensions.

    Examples
    --------
    >>> ScaledSigmaPoints().reach(4) > 0.0
    True
    """

    alpha: float = 1.0
    beta: float = 2.0
    kappa: float = 0.0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.alpha) and 1e-4 <= self.alpha <= 1e3):
            raise FilterError(f"alpha is {self.alpha}: give a number in 1e-4 .. 1e3")
        if not (math.isfinite(self.beta) and math.isfinite(self.kappa)):
            raise FilterError(f"beta {self.beta} and kappa {self.kappa} must be finite numbers")

    def reach(self, dimensions: int) -> float:
        """Distance of the points from the mean in deviations, alpha sqrt(L + kappa), L > -kappa."""
        if not dimensions + self.kappa > 0.0:
            raise FilterError(f"kappa is {self.kappa}: it must be above -{dimensions}")
        return self.alpha * math.sqrt(dimensions + self.kappa)

    @property
    def centre_correction(self) -> float:
        """Factor of mu mu' in the covariance: beta - alpha^2, not negative for alpha^2 <= beta."""
        return self.beta - self.alpha**2
