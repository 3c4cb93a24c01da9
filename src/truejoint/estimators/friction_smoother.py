"""The friction filter, smoothed: for records that are complete, never for a loop."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from truejoint.errors import CalibrationError
from truejoint.estimators.friction_filter import FrictionFilter, FrictionMemory
from truejoint.estimators.sequence import regular_steps

Array = NDArray[np.float64]


class SmoothedFrictionFilter(FrictionFilter):
    """`FrictionFilter` with a Rauch-Tung-Striebel smoother: each row from all rows of the record.

    Not causal. Parameters as `FrictionFilter`.
    """

    family: ClassVar[str] = "ukf_friction_smoothed"
    causal: ClassVar[bool] = False

    def evaluate(self, X: Array, steps: Array | None = None) -> Array:
        """Jaw angle (n, 1) [rad] for rows `X` (n, 2), each from all of them."""
        return self.smoothed(X, regular_steps(len(X)) if steps is None else steps).angle[:, None]

    def start(self) -> FrictionMemory:
        """Refuse: what smooths needs the rows to come; raises CalibrationError."""
        raise CalibrationError(
            f"{self.family} uses later rows and cannot run in a loop; calibrate "
            f"{FrictionFilter.family} for that"
        )
