"""Conditions of a recording, such as how fast each joint moves."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Final

import numpy as np

from truejoint.array_types import Array
from truejoint.schema import Bounds

if TYPE_CHECKING:
    from truejoint.recordings import Recording

SPEED_TIME: Final = 0.1  # [s], over which speed is taken: an encoder's counts make it noise else
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


def conditions_of(recording: "Recording", joints: Sequence[str]) -> tuple[Condition, ...]:
    """Conditions of a recording, for each of `joints`."""
    every = max(1, round(SPEED_TIME / float(np.median(np.diff(recording.t)))))
    conditions = []
    for joint in joints:
        q = recording.column(f"measured/{joint}")
        effort, truth = (
            recording.column(f"{name}/{joint}") if joint in recording.joints_of(name) else q[:0]
            for name in ("effort", "truth")
        )
        slope, low, high = math.nan, float(q.min()), float(q.max())
        x, y = (values[np.flatnonzero(np.isfinite(truth))] for values in (q, truth))
        if len(x) >= _LEAST_ROWS and np.ptp(x) > 0.0:
            slope = float(np.polyfit(x - x.mean(), y, 1)[0])
        speed = _rms(np.diff(q[::every]) / np.diff(recording.t[::every]))
        shape = high - low, 0.5 * (low + high)
        conditions.append(Condition(joint, speed, *shape, _rms(effort), slope))
    return tuple(conditions)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else math.nan
