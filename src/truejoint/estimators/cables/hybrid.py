"""The filter of a wrist's cables, and plays that learn what it leaves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Final, Self

import numpy as np
from sklearn.base import clone

from truejoint.array_types import Array
from truejoint.estimators.base import Arrays, Progress
from truejoint.estimators.cables.learn import NO_LOAD, CableFilter, structure
from truejoint.estimators.cables.loops import N
from truejoint.estimators.cables.run import HYBRID_ROWS
from truejoint.estimators.family import EstimatorData, Family, Params
from truejoint.estimators.filtered import run_filter
from truejoint.estimators.hybrid import joined
from truejoint.estimators.plays.learn import Plays

WRIST_PLAYS: Final = Plays(
    plays=(0.002, 0.005, 0.01, 0.02, 0.04, 0.1, 0.25),
    time_constants=(0.02, 0.1),
    leading=1,
    squared=1,
    pairs=(),
)
"""Plays of a wrist's signals, pitch first, by which the loops of all cables grow and shrink.

Half-widths in half ranges: 0.1 deg and up of 55 deg of pitch, a few mNm and up of an effort.
Low-passes tell speed, for the motors' viscous friction, and take noise off the efforts.
"""
_FILTERED: Final = 0.8  # share of the fit's time that the filter takes


@dataclass(eq=False, repr=False)
class CableHybrid(CableFilter):
    """`CableFilter`, and a ridge regression on plays of what it says that learns what it leaves.

    Plays see the joints and loads that the filter estimates, friction of the pins, motors and
    efforts. They tell the joints, which the filter's model of the cables leaves off by some
    hundredths of a degree, and the loads. Half-widths are the filter's own, times what makes them
    as large as errors on blocks of the calibration that the plays did not see. What it needs is
    what the filter needs.

    Examples
    --------
    >>> CableHybrid().name
    'hybrid_cables'
    """

    family: ClassVar[Family] = HYBRID_ROWS

    def model_params(self) -> dict[str, object]:
        """Parameters of the family: the motors, and the plays'."""
        usual = (Plays.family.name, WRIST_PLAYS.model_params(), ())
        return {**super().model_params(), "model": vars(self).get("plays_", usual)}

    @classmethod
    def from_params(cls, params: Params) -> Self:
        """Make one of these parameters, to be run only."""
        made = cls(params["channels"])
        made.plays_ = params["model"]
        return made

    def _learn(self, X: Array, y: Array, dt: Array, progress: Progress) -> Arrays:
        arrays = self._identified(X, y, dt, lambda done: progress(_FILTERED * done))
        data = EstimatorData(self.family.name, self.model_params(), arrays)
        run = run_filter(self.family.memory(data, 2 * N, N), X, dt, n_outputs=N)
        # Of a load that calibration does not have, the filter's word is all there is.
        has_load, by_filter = np.ptp(self._loads, axis=0) > NO_LOAD, run.sighted[:, 4 * N : 5 * N]
        wanted = np.hstack([y - run.outputs, np.where(has_load, self._loads, by_filter)])
        plays = clone(WRIST_PLAYS).fit(run.sighted, wanted, dt=dt)
        self.plays_ = (Plays.family.name, plays.model_params(), ())
        arrays = joined(arrays, plays.arrays_)
        estimate = self._states(arrays, X, dt)
        errors = np.hstack([y - estimate.angle, self._loads - estimate.load])
        # Squares of errors are larger on blocks that plays were not fitted to.
        has_truth = np.isfinite(wanted).all(axis=1)
        blocks = np.square(plays.model_.errors_ * wanted[has_truth].std(axis=0))
        grown = np.maximum(blocks / np.mean(np.square(errors[has_truth]), axis=0), 1.0)
        unseen = np.repeat(grown.reshape(2, N), 2, axis=0)
        arrays["structure"] = structure(self._runs(X, y, dt), estimate) * unseen
        progress(1.0)
        return arrays
