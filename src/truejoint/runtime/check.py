"""Check with a brief truth whether a calibration still holds."""

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from truejoint.calibration.calibration import Calibration, as_calibration
from truejoint.calibration.truth_zero import find_zero, known_error
from truejoint.runtime.monitor import Alarm, Monitor, Reason
from truejoint.summary import json_values

if TYPE_CHECKING:
    from truejoint.recordings import Recording


@dataclass(frozen=True)
class JointCheck:
    """How far off one joint is now; lengths in its unit."""

    joint: str
    unit: str  # ``"rad"`` or ``"m"``
    rmse: float  # of the corrected position against the truth
    largest: float
    offset: float  # median of truth minus corrected position
    offset_sd: float  # its standard deviation (`Zero`); NaN if errors are of unknown size
    rezeroed_rmse: float  # RMSE that would be left after re-zeroing
    half_width: float  # of the stated interval, mean over the readings; NaN when there is none
    inside: float  # share of the readings inside; NaN when there is none

    @property
    def holds(self) -> bool | None:
        """Whether at least half of the readings lie inside the interval; None without one.

        Readings of one brief motion resemble each other, so that their share inside is far from
        the stated level by chance alone; most of them outside is what rarely happens by chance:
        to less than one in ten brief motions at 90 %, if errors last as long as the motion.
        """
        return None if math.isnan(self.inside) else self.inside >= 0.5


@dataclass(frozen=True)
class CalibrationCheck:
    """Result of `check_calibration`.

    Attributes
    ----------
    joints : tuple of JointCheck
    rows : int
        Readings of the truth.
    duration : float
        Time from the first to the last of them [s].
    level : float
        Level of the interval.
    alarm : Alarm
        Highest that the monitor raised along the recording; NONE where it has no effort baseline.
    reasons : Reason
        Advice of all its alarms.

    Examples
    --------
    >>> truejoint.runtime.check_calibration(model, test).holds
    True
    """

    joints: tuple[JointCheck, ...]
    rows: int
    duration: float
    level: float
    alarm: Alarm
    reasons: Reason

    @property
    def holds(self) -> bool | None:
        """Whether the interval holds in every joint; None without one."""
        verdicts = [joint.holds for joint in self.joints]
        return None if None in verdicts else all(verdicts)

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON, SI units; None stands for what is not known."""
        judged = {
            "joints": [vars(joint) | {"holds": joint.holds} for joint in self.joints],
            "holds": self.holds, "alarm": self.alarm.name.lower(),
            "reasons": [str(r.name).lower() for r in Reason if r in self.reasons],
        }  # fmt: skip
        plain: dict[str, Any] = json_values(vars(self) | judged)
        return plain


def check_calibration(
    calibration: Calibration, recording: "Recording", level: float | None = None
) -> CalibrationCheck:
    """Compare a calibration with a brief truth.

    Parameters
    ----------
    calibration : Calibration
    recording : Recording
        Short, of the arm as it is now; truth may be missing in most rows (one short motion with a
        sensor, a touched stop, a marker seen now and then).
    level : float, optional
        Which interval to judge by; by default 0.9, or the nearest that the calibration states.

    Raises
    ------
    CalibrationError
        If the recording does not fit, holds no truth, or the calibration does not state that level.

    Examples
    --------
    >>> check_calibration(model, test).rows
    400
    """
    if level is not None:
        as_calibration(calibration).required_interval().index(level)
    rows = as_calibration(calibration).rows(recording)
    level = calibration.usual_level if level is None else level
    error, has_truth = known_error(calibration, rows)
    t, error = rows.t[has_truth], error[has_truth]
    zero = find_zero(replace(calibration, rezeroed_fit=None), rows)  # of positions as they come
    rezeroed = known_error(calibration.at(find_zero(calibration, rows)), rows)[0][has_truth]
    allowed = np.full_like(error, math.nan)
    inside = np.full(error.shape[1], math.nan)
    if calibration.interval is not None:
        allowed = calibration.half_widths(rows, level)[has_truth]
        inside = np.mean(np.abs(error) <= allowed, axis=0)
    error, rezeroed, allowed = (np.ascontiguousarray(a.T) for a in (error, rezeroed, allowed))
    rmse, rezeroed_rmse = (np.sqrt(np.mean(off**2, axis=1)) for off in (error, rezeroed))
    units = [calibration.units[f"measured/{joint}"] for joint in calibration.joints]
    columns = (
        rmse, np.abs(error).max(axis=1), zero.offset, zero.deviation, rezeroed_rmse,
        allowed.mean(axis=1), inside,
    )  # fmt: skip
    of_joints = zip(calibration.joints, units, *(c.tolist() for c in columns), strict=True)
    joints = tuple(JointCheck(*row) for row in of_joints)
    alarm, reasons = Alarm.NONE, Reason.NOTHING
    if calibration.effort_baseline is not None:
        trace = Monitor(calibration).run(recording)
        alarm = Alarm(int(trace.alarm.max()))
        reasons = Reason(int(np.bitwise_or.reduce(trace.reasons)))
    return CalibrationCheck(joints, len(t), float(t[-1] - t[0]), level, alarm, reasons)
