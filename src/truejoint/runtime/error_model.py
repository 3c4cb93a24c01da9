"""Joints as a robot would report them, for a simulator that knows where they truly are."""

import math
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from truejoint.array_types import Array, floats
from truejoint.calibration.calibration import Calibration, as_calibration
from truejoint.errors import CalibrationError
from truejoint.runtime.corrector import Corrector

NOISE: Final = "noise"  # in the metadata of an error model, and of no other calibration


def inputs_and_noise(model: Calibration) -> tuple[list[int], Array, Array]:
    """Give the joints that an error model takes, and sizes and times (n_joints,) of its noise.

    Raises CalibrationError unless its metadata state both of each joint, the time above 0.
    """
    names = [signal.partition("/")[2] for signal in model.loop_signals]
    noise = model.metadata[NOISE]
    try:
        table = np.array([noise[joint] for joint in model.joints], dtype=float)
        size, time = table.reshape(len(model.joints), 2).T
    except (KeyError, TypeError, ValueError):
        size, time = np.full((2, len(model.joints)), math.nan)
    if not ((size >= 0.0) & (size < math.inf) & (time > 0.0)).all():
        joints = ", ".join(model.joints)
        raise CalibrationError(
            f"noise {noise!r:.60} of {model.title}: want a size of at least 0 [rad or m] and a "
            f"time above 0 [s] for each of {joints}; make the model with learn_error_model"
        )
    return [model.joints.index(name) for name in names], size, time


class ErrorModel:
    """Reports joint positions as a robot would that is at true ones, step by step, with noise.

    `model` is what `truejoint.calibration.learn_error_model` gave. The noise, of that `seed`, has
    the size and the correlation time of what the model could not tell of held-out rows; an error
    model that is not `noisy` adds none. Raises CalibrationError if `model` is a correction.

    Examples
    --------
    >>> learnt = truejoint.calibration.learn_error_model(training, "linear")
    >>> ErrorModel(learnt, seed=1).step(0.0, [0.2]).shape
    (1,)
    """

    def __init__(self, model: Calibration, *, seed: int = 0, noisy: bool = True) -> None:
        if NOISE not in as_calibration(model).metadata:
            raise CalibrationError(
                f"{model.title} is no error model; make one with learn_error_model(recordings)"
            )
        self.joints = model.joints
        self._inputs, self._size, self._time = inputs_and_noise(model)
        self._corrector = Corrector(model)
        self._corrector.set_homing(True)
        self._rng, self._noisy, self._t = np.random.default_rng(seed), noisy, -math.inf
        self._error, self._noise = np.zeros((2, len(self.joints)))

    def step(self, t: float, true: ArrayLike) -> Array:
        """Positions (n_joints,) that are reported at `t` [s] of true ones (n_joints,) [rad or m].

        Raises CalibrationError unless there is one number for each of `joints`.
        """
        position = floats(true, "true positions", CalibrationError)
        if position.shape != (len(self.joints),):
            raise CalibrationError(
                f"true positions of shape {position.shape}; want one for each of "
                f"{', '.join(self.joints)}"
            )
        self._corrector.step(t, position[self._inputs])
        if np.isfinite(self._corrector.correction).all():
            self._error = self._corrector.correction.copy()
        if self._noisy:
            keep = np.exp(-np.fmax(t - self._t, 0.0) / self._time)  # of a stamp that is NaN all
            fresh = self._size * self._rng.standard_normal(len(keep))
            self._noise, self._t = keep * self._noise + np.sqrt(1.0 - keep * keep) * fresh, t
        return np.asarray(position + self._error + self._noise)
