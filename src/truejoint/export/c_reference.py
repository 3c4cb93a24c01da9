"""What `Corrector` makes of samples where the estimator remembers, by its own `step`."""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from truejoint.calibration import Calibration
from truejoint.calibration.encoding import decode, encode
from truejoint.estimators import FixedOffset
from truejoint.estimators.sequence import SequenceRegressor
from truejoint.filters import FilterState, UnscentedFilter
from truejoint.runtime import layout as lay
from truejoint.runtime.corrector import Corrector
from truejoint.runtime.limits import limits_of
from truejoint.runtime.status import Status


class SteppingCorrector(Corrector):
    """Corrector of a `SequenceRegressor` that is not built for the loop: it calls `step`.

    Parameters
    ----------
    calibration : Calibration
        Of a `SequenceRegressor`.
    level, range_margin : float
        As for `Corrector`.

    Attributes
    ----------
    filter_status : int
        Bits of `FilterStatus` of the last sample that was used; 0 for an estimator without filter.
    """

    def __init__(self, calibration: Calibration, *, level: float, range_margin: float) -> None:
        n_joints = len(calibration.joints)
        nothing = FixedOffset.from_arrays(
            {}, {"offset": np.zeros(n_joints)},
            n_features=len(calibration.feature_set), n_outputs=n_joints,
        )  # fmt: skip
        super().__init__(
            replace(calibration, model=nothing), level=level, range_margin=range_margin
        )
        limits = limits_of(decode(*encode(calibration)), range_margin)
        self._longest = limits.longest_step
        self._memory[lay.SHORTEST] = limits.shortest_step
        self._plausible = limits.correction_lower, limits.correction_upper
        model: Any = copy.copy(calibration.model)
        assert isinstance(model, SequenceRegressor)  # noqa: S101  # it was chosen for that
        self._filter: _WatchedFilter | None = None
        if hasattr(model, "_filter"):
            self._filter = model._filter = _WatchedFilter(model._filter)
        self._model = model
        self._kept = model.start()
        self.filter_status = 0

    def step(self, t: float, sample: ArrayLike) -> Status:
        """Correct one sample, as `Corrector.step` does."""
        seen, last = self._block(lay.CLOCK, 2)
        judged = super().step(t, sample)
        if np.isnan(self.correction).any():  # the sample was not used
            return judged
        elapsed = t - last
        fresh = not (seen and 0.0 < elapsed <= self._longest)
        measured = np.asarray(sample, dtype=np.float64)[self._measured()]
        predicted = self._model.step(self._kept, 0.0 if fresh else elapsed, self.features.copy())
        self.filter_status = 0 if self._filter is None else self._filter.status
        self.correction[:] = predicted - measured
        lower, upper = self._plausible
        plausible = bool(np.all((self.correction >= lower) & (self.correction <= upper)))
        status = (judged & ~Status.IMPLAUSIBLE) | (Status.OK if plausible else Status.IMPLAUSIBLE)
        good = status == Status.OK
        self.position[:] = predicted + self.offset if good else measured
        width = self._block(lay.PREDICTED_WIDTH, len(self.joints))
        self.half_width[:] = width if good else np.inf
        return status

    def _measured(self) -> list[int]:
        return [self.signals.index(f"measured/{joint}") for joint in self.joints]


class _WatchedFilter:
    """Filter whose last status is kept; an estimator's `step` gives the angle alone."""

    def __init__(self, estimator: UnscentedFilter) -> None:
        self._estimator = estimator
        self.status = 0

    def initial_state(self, x0: ArrayLike, P0: ArrayLike) -> FilterState:
        """State of the filter itself."""
        return self._estimator.initial_state(x0, P0)

    def step(self, state: FilterState, z: ArrayLike, u: ArrayLike | None, dt: float) -> int:
        """Step of the filter itself."""
        self.status = self._estimator.step(state, z, u, dt)
        return self.status
