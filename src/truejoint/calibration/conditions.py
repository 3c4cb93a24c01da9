"""Conditions of a recording, such as how fast each joint moves."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Final

import numpy as np

from truejoint.array_types import Array
from truejoint.schema import Bounds

if TYPE_CHECKING:
    from truejoint.recordings import Recording

_SPEED_TIME: Final = 0.1  # [s], over which speed is taken: an encoder's counts make it noise else
_LEAST_ROWS: Final = 10  # with truth, for a slope
_Number = Annotated[float, Bounds(-1e15, 1e15)]


@dataclass(frozen=True)
class Condition:
    """How a joint moves in a recording, in SI units; NaN where that cannot be said.

    Positions are measured. The slope is that of the true position over the measured one.
    """

    joint: str
    speed: _Number = math.nan  # RMS
    range: _Number = math.nan
    middle: _Number = math.nan  # of the range
    effort: _Number = math.nan  # RMS
    slope: _Number = math.nan


def conditions_of(recording: Recording, joints: Sequence[str]) -> tuple[Condition, ...]:
    """Conditions of a recording, for each of `joints`."""
    every = max(1, round(_SPEED_TIME / float(np.median(np.diff(recording.t)))))
    efforts, truths = recording.joints_of("effort"), recording.joints_of("truth")
    conditions = []
    for joint in joints:
        q = recording.column(f"measured/{joint}")
        speeds = np.diff(q[::every]) / np.diff(recording.t[::every])
        effort = recording.column(f"effort/{joint}") if joint in efforts else np.empty(0)
        truth = recording.column(f"truth/{joint}") if joint in truths else np.full(len(q), np.nan)
        known, slope = np.isfinite(truth), math.nan
        if known.sum() >= _LEAST_ROWS and np.ptp(q[known]) > 0.0:
            slope = float(np.polyfit(q[known] - q[known].mean(), truth[known], 1)[0])
        low, high = float(q.min()), float(q.max())
        middle = 0.5 * (low + high)
        conditions.append(Condition(joint, _rms(speeds), high - low, middle, _rms(effort), slope))
    return tuple(conditions)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else math.nan
