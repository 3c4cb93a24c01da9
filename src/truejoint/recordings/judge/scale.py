"""Sign, unit and limits of the truth and of the measured position."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Final

import numpy as np
from scipy.stats import rankdata

from truejoint.array_types import Array
from truejoint.recordings.judge.finding import Defect
from truejoint.recordings.table.recording import Recording
from truejoint.robots import Joint
from truejoint.units import display_unit, shown

# Between what healthy joints show (a sixth to 1.1) and degrees for radians.
_RATIO: Final = 7.6
_OPPOSITE: Final = -0.4  # rank correlation; right signs are far above 0, wrong ones far below
_MOST_ROWS: Final = 2000
_FARTHEST: Final = {"rad": 4.0 * math.pi, "m": 2.0}  # that a joint without limits moves
_SLACK: Final = 0.1  # of the travel between limits


def judge_scale(recording: Recording, joint: str) -> Iterable[Defect]:
    """Judge unit, sign and limits, the first only that is wrong: each upsets the next."""
    measured, with_truth = recording.robot.joint(joint), recording.joints_of("truth")
    reported = recording.column(f"measured/{joint}")
    low, high = _range(reported)
    if joint in with_truth:
        truth = recording.column(f"truth/{joint}")
        rows = np.flatnonzero(np.isfinite(truth))
        rows = rows[:: max(1, len(rows) // _MOST_ROWS)]
        if len(rows) > 2:
            span = float(np.ptp(_range(truth[rows])))
            ratio = span / max(float(np.ptp(_range(reported[rows]))), 1e-12)
            if ratio > _RATIO or 0.0 < ratio < 1.0 / _RATIO:
                yield _unit(joint, measured.unit, ratio)
                return
            same = _rank_correlation(truth[rows], reported[rows])
            if same < _OPPOSITE:
                what = f"the truth falls where the measured position rises (correlation {same:.2f})"
                yield Defect("fail", "sign", what, f"truth/{joint}", size=-same)
                return
    yield from _limits(measured, low, high)


def _unit(joint: str, unit: str, ratio: float) -> Defect:
    display = display_unit(unit)
    wrong = max(ratio, 1.0 / ratio)
    name, side = ("truth", "measured position") if ratio > 1.0 else ("measured", "truth")
    guess = f" (1 {unit} = {display.scale:.4g} {display.name})"
    what = f"{'it' if name else ''} spans {wrong:.3g} times what the {side} does{guess}"
    advice = f"give both in {unit}: state the column's unit, as {display.name}, or its scale"
    return Defect("fail", "unit", what, f"{name}/{joint}", advice, size=wrong)


def _limits(joint: Joint, low: float, high: float) -> Iterable[Defect]:
    """Positions far outside the limits are in another unit; a little outside, limits are wrong."""
    travel = joint.upper - joint.lower
    name, unit = f"measured/{joint.name}", joint.unit
    display = display_unit(unit)
    if not math.isfinite(travel):
        if high - low > _FARTHEST.get(unit, math.inf):
            what = f"it spans {high - low:.4g} {unit}, more than a joint moves"
            advice = f"is it in {display.name}? state the unit of its column"
            yield Defect("fail", "unit", what, name, advice, size=high - low)
        return
    beyond = max(low - joint.upper, joint.lower - high, high - joint.upper, joint.lower - low)
    span = f"{shown(low, unit)} to {shown(high, unit)}"
    limits = f"the limits are {shown(joint.lower, unit)} to {shown(joint.upper, unit)}"
    if high - low > 1.5 * travel or beyond > 2.0 * travel:
        advice = f"is it in {display.name}? state the unit of its column"
        yield Defect("fail", "unit", f"it runs from {span}; {limits}", name, advice, size=beyond)
    elif beyond > _SLACK * travel:
        yield Defect("warn", "limits", f"it runs from {span}; {limits}", name, size=beyond)


def _range(values: Array) -> tuple[float, float]:
    """Range without the farthest 2 % at either end."""
    low, high = np.quantile(values, [0.02, 0.98])
    return float(low), float(high)


def _rank_correlation(a: Array, b: Array) -> float:
    """Spearman's; 0 where one does not change."""
    if np.ptp(a) == 0.0 or np.ptp(b) == 0.0:
        return 0.0
    return float(np.corrcoef(rankdata(a), rankdata(b))[0, 1])
