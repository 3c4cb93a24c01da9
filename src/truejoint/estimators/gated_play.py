"""The project's best for a jaw: both sides while they agree, the reset cable alone under a load."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from truejoint.estimators.base import Progress
from truejoint.estimators.jaw import JawEstimator
from truejoint.estimators.play import Play
from truejoint.models import gated_play
from truejoint.models.family import Family
from truejoint.robots.forceps_mechanism import TABLE_1

Array = NDArray[np.float64]


@dataclass(eq=False, repr=False)
class GatedPlay(JawEstimator):
    """`Play` on the reset cable, corrected by `Play` on both sides as far as the two agree.

    Without a load both see the same jaw, and their difference stays within a few times what it was
    in calibration; the estimate from both sides is then the better one. A load stretches the drive
    cable, which only that one mistakes for a motion of the jaw: the difference grows, and the
    estimate goes over, without a jump, to the reset cable's.

    Parameters
    ----------
    gate : float
        How many times the difference's RMS in calibration still counts as agreement.
    smallest_gate : float
        Difference that always does [rad].
    gear_ratio, wheel_radius : float
        As for `Play`.

    Examples
    --------
    >>> GatedPlay(gate=4.0).name
    'play_gated'
    """

    family: ClassVar[Family] = gated_play.FAMILY
    gate: float = 5.0
    smallest_gate: float = 9e-4
    gear_ratio: float = TABLE_1.gear_ratio
    wheel_radius: float = TABLE_1.wheel_radius

    def _learn_jaw(
        self, X: Array, y: Array, dt: Array, known: NDArray[np.bool_], progress: Progress
    ) -> dict[str, Array]:
        params = self.model_params()
        reset = Play(**gated_play.side_params(params, "reset")).fit(X[:, 1:], y, dt=dt)
        progress(0.4)
        both = Play(**gated_play.side_params(params, "both")).fit(X, y, dt=dt)
        progress(0.8)
        difference = both.evaluate(X, dt) - reset.evaluate(X[:, 1:], dt)
        spread = float(np.sqrt(np.mean(difference[known, 0] ** 2)))
        return {
            **{f"reset_{name}": array for name, array in reset.arrays_.items()},
            **{f"both_{name}": array for name, array in both.arrays_.items()},
            "gate": np.array([max(self.gate * spread, self.smallest_gate)]),
            "constant": np.zeros(1),
        }
