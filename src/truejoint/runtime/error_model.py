"""Joints as a robot would report them, for a simulator that knows where they truly are."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from truejoint.array_types import Array, floats
from truejoint.calibration.calibration import Calibration, as_calibration
from truejoint.errors import CalibrationError
from truejoint.runtime.corrector import Corrector


class ErrorModel:
    """Reports joint positions as a robot would that is at true ones, step by step, with noise.

    Parameters
    ----------
    model : Calibration
        The one that `truejoint.calibration.learn_error_model` gave.
    seed : int
        Seed of the noise.
    noisy : bool
        Whether to add what the model could not tell of held-out rows: normal noise of the same size
        and correlation time for each joint.

    Attributes
    ----------
    joints : tuple of str
        Joints that go in and come out.
    inputs : list of int
        Which of them the model takes, in its order.
    noise_size, noise_time : ndarray, shape (n_joints,)
        Standard deviations [rad or m] and correlation times [s].

    Raises
    ------
    CalibrationError
        If the model is a correction, and no error model.

    Examples
    --------
    >>> learnt = truejoint.calibration.learn_error_model(training, "linear")
    >>> ErrorModel(learnt, seed=1).step(0.0, [0.2]).shape
    (1,)
    """

    def __init__(self, model: Calibration, *, seed: int = 0, noisy: bool = True) -> None:
        noise = as_calibration(model).metadata.get("noise")
        if noise is None:
            raise CalibrationError(
                f"{model.title} is no error model; make one with learn_error_model(recordings)"
            )
        self.joints = model.joints
        self.noise_size, self.noise_time = np.array([noise[joint] for joint in model.joints]).T
        self._corrector = Corrector(model)
        self._corrector.set_homing(True)
        named = [signal.partition("/")[2] for signal in self._corrector.signals]
        self.inputs = [self.joints.index(name) for name in named]
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
        self._corrector.step(t, position[self.inputs])
        if np.isfinite(self._corrector.correction).all():
            self._error = self._corrector.correction.copy()
        if self._noisy:
            keep = np.exp(-max(t - self._t, 0.0) / self.noise_time)
            fresh = self.noise_size * self._rng.standard_normal(len(keep))
            self._noise = keep * self._noise + np.sqrt(1.0 - keep * keep) * fresh
            self._t = t
        return np.asarray(position + self._error + self._noise)
