"""Adam, as in peng2024, IV-B, and what ends a training that diverges."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from truejoint.compiled import compiled
from truejoint.errors import CalibrationError
from truejoint.estimators.network.layers import Floats

FIRST_DECAY: Final = 0.9
SECOND_DECAY: Final = 0.999
EPSILON: Final = 1e-7  # the default of Keras, which the paper does not state


class Adam:
    """Adam (Kingma and Ba, 2014) on one flat vector, in place."""

    def __init__(self, values: Floats, learning_rate: float) -> None:
        self._values = values.reshape(-1, copy=False)  # raises where it would be a copy
        self.learning_rate = learning_rate
        self._first, self._second = np.zeros((2, values.size), values.dtype)
        self._steps = 0

    def step(self, gradient: Floats) -> None:
        """Move the values one step down `gradient`."""
        self._steps += 1
        # With the bias corrections folded into the step and epsilon beside the uncorrected root, as
        # in section 2 of the paper on Adam, in Keras and in scikit-learn.
        root = math.sqrt(1.0 - SECOND_DECAY**self._steps)
        rate = self.learning_rate * root / (1.0 - FIRST_DECAY**self._steps)
        factors = np.array(  # of the values' precision, which each step keeps
            [FIRST_DECAY, 1.0 - FIRST_DECAY, SECOND_DECAY, 1.0 - SECOND_DECAY, EPSILON, rate],
            self._values.dtype,
        )
        _descend(self._values, gradient.ravel(), self._first, self._second, factors)


@compiled
def _descend(
    values: Floats, gradient: Floats, first: Floats, second: Floats, factors: Floats
) -> None:
    """Take a step of Adam: both decays, each with what is left to 1, epsilon and the rate."""
    for i in range(values.shape[0]):
        first[i] = factors[0] * first[i] + factors[1] * gradient[i]
        second[i] = factors[2] * second[i] + factors[3] * (gradient[i] * gradient[i])
        values[i] -= factors[5] * (first[i] / (np.sqrt(second[i]) + factors[4]))


def check_loss(history: list[float], epochs: int, learning_rate: float) -> None:
    """Raise CalibrationError if the loss of the last of the epochs so far is out of bounds."""
    if not math.isfinite(history[-1]):
        raise CalibrationError(
            f"training diverged in epoch {len(history)} of {epochs} at learning rate "
            f"{learning_rate:g}; lower the learning rate"
        )
