"""Fixed offset, the baseline of peng2024, II-C."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from truejoint.estimators.base import JointRegressor, Progress
from truejoint.models import offset
from truejoint.models.family import Family

Array = NDArray[np.float64]


class FixedOffset(JointRegressor):
    """Mean of the target, whatever the features.

    Examples
    --------
    >>> FixedOffset().fit([[0.0], [1.0]], [1.0, 2.0]).predict([[5.0]])
    array([1.5])
    """

    family: ClassVar[Family] = offset.FAMILY

    def minimum_rows(self, n_features: int) -> int:
        """Ten rows."""
        return 10

    def _learn(self, X: Array, y: Array, dt: Array, progress: Progress) -> dict[str, Array]:
        progress(1.0)
        return {"offset": y.mean(axis=0)}

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.regressor_tags.poor_score = True
        return tags
