"""Touched dimples of a block: when, where the block stands, and the zero that they give."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Final

import numpy as np

from truejoint.array_types import Array, floats
from truejoint.calibration.compatibility import check_columns, source_of
from truejoint.calibration.zero import Zero
from truejoint.errors import CalibrationError, other_kind
from truejoint.robots.robot import Robot
from truejoint.tip.block import TOUCH_SD, Block, BlockPose
from truejoint.tip.fit import TipFit, TipPrior, TipRows, TipState, align, fit_rows
from truejoint.units import shown

if TYPE_CHECKING:
    from truejoint.calibration.calibration import Calibration
    from truejoint.recordings import Recording

FEWEST: Final = 3
"""Touches that re-zero a calibration."""
FEWEST_OF_BLOCK: Final = 2 * FEWEST
"""Touches that find a block's pose."""
_MISFIT: Final = 3.0
"""Squares of residuals, as a multiple of what is expected, beyond which nothing fits. Where block,
arm and day are right they stay below two on ten arms whose errors are 2.5 times as stated."""
_FARTHEST: Final = {"rad": np.deg2rad(3.0), "m": 3e-3}
"""No homing moves a zero further; a block that has moved may look like one that does."""
_FACTORS: Final = (1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0)
"""By which errors of another motion are larger than the training's."""
_ROUNDS: Final = 5  # of moving the inputs of a model until its output fits
REST: Final = 0.3
"""Time before a touch's stamp over which positions are averaged [s]."""
_SLACK: Final = {"rad": 5e-4, "m": 5e-5}  # by which positions may move within `REST`


@dataclass(frozen=True)
class Touches:
    """When the tip rested in which dimple.

    Attributes
    ----------
    t : tuple of float
        End of each rest, on the clock of the recording [s].
    dimple : tuple of str
        Its number on the block.
    source : str
        File of the touches, for messages.

    Raises
    ------
    CalibrationError
        If there are none, or time does not advance.

    Examples
    --------
    >>> len(Touches((4.0, 9.5), ("3", "17")))
    2
    """

    t: tuple[float, ...]
    dimple: tuple[str, ...]
    source: str = "touches"

    def __post_init__(self) -> None:
        t = floats(self.t, f"{self.source}: times", CalibrationError)
        if not t.size or t.shape != (len(self.dimple),):
            raise CalibrationError(
                f"{self.source}: no dimples; write a line for each: a time and a name"
            )
        if not (np.isfinite(t).all() and (np.diff(t) > 0.0).all()):
            raise CalibrationError(f"{self.source}: the times must go up")

    def __len__(self) -> int:
        return len(self.t)


def resting(recording: Recording, touches: Touches) -> list[slice]:
    """Rows of a recording in which the tip rests, of each touch.

    Raises CalibrationError if there is no row, or the arm moves.
    """
    stamps, rests = np.array(recording.t), []
    joints = [j for j in recording.robot.positioning if f"measured/{j}" in recording.units]
    measured = recording.columns("measured", joints)
    units = [recording.robot.joint(joint).unit for joint in joints]
    slack = np.array([_SLACK[unit] for unit in units])
    for t, dimple in zip(touches.t, touches.dimple, strict=True):
        first, last = np.searchsorted(stamps, [t - REST, t], side="right")
        if last - first < 2:
            raise CalibrationError(
                f"{touches.source}: dimple {dimple} is of {t:g} s, but "
                f"{source_of(recording)} runs from {stamps[0]:.1f} to {stamps[-1]:.1f} s with "
                f"{last - first} rows there; is it their recording?"
            )
        span = np.ptp(measured[first:last], axis=0)
        if (span > slack).any():
            k = int(np.argmax(span / slack))
            raise CalibrationError(
                f"{touches.source}: {joints[k]} moves by {shown(float(span[k]), units[k])} while "
                f"dimple {dimple} is taken, at {t:g} s; rest for {REST:g} s before the "
                "stamp"
            )
        rests.append(slice(int(first), int(last)))
    return rests


def at_rest(recording: Recording, touches: Touches, values: Array) -> Array:
    """Means (m, ...) of `values` (n, ...), a row of the recording each, at each rest."""
    return np.array([values[rows].mean(axis=0) for rows in resting(recording, touches)])


def check_count(touches: Touches, fewest: int, what: str) -> None:
    """Refuse touches of fewer dimples, or fewer shots; `what` they are for, in the message."""
    if not isinstance(touches, Touches):
        raise CalibrationError(other_kind(touches, "Touches", "read_touches(path) gives them"))
    different = len(set(touches.dimple))
    if different < fewest:
        raise CalibrationError(
            f"{touches.source}: {different} different dimples; to {what} it takes {fewest} or more"
        )


def tip_rows(
    calibration: Calibration,
    recording: Recording,
    touches: Touches,
    block: Block,
    *,
    touch_sd: float = TOUCH_SD,
    offsets: bool = True,
) -> TipRows:
    """Rows of touches with corrected positions, in an offset a joint, or in none.

    `touch_sd` [m] is the standard deviation of a tip from its dimple, per axis. Raises
    CalibrationError if the robot's kinematics are not known, columns are missing, or touches and
    recording do not go together.
    """
    if calibration.effort_baseline is None:
        raise CalibrationError(
            f"the calibration of {calibration.title} does not say how large its errors are; "
            "calibrate it again"
        )
    robot, n = recording.robot, len(calibration.joints)
    check_columns(
        recording, [f"measured/{name}" for name in robot.joint_names], "tip's place takes"
    )
    joint = recording.columns("measured", robot.joint_names)
    joint[:, robot.index(calibration.joints)] = calibration.correct(recording)
    basis = np.tile(np.eye(n) if offsets else np.zeros((n, 0)), (len(touches), 1, 1))
    return TipRows.of(
        robot, at_rest(recording, touches, joint), calibration.joints, basis,
        block.at(touches.dimple), touch_sd, calibration.effort_baseline.residual,
    )  # fmt: skip


def find_block(
    calibration: Calibration,
    recording: Recording,
    touches: Touches,
    block: Block,
    *,
    touch_sd: float = TOUCH_SD,
) -> tuple[BlockPose, TipFit]:
    """Find where a bolted block stands, by touches on the day of the full calibration.

    The size of the print is estimated too, about what the calliper says. Returns the pose, and the
    fit, which names the outliers.

    Raises
    ------
    CalibrationError
        If there are too few touches, they lie in a line, or do not fit.

    Examples
    --------
    >>> find_block(model, test, Touches((1.0,), ("1",)), None)
    Traceback (most recent call last):
    truejoint.errors.CalibrationError: ...
    """
    check_count(touches, FEWEST_OF_BLOCK, "find a block's pose")
    rows = tip_rows(calibration, recording, touches, block, touch_sd=touch_sd, offsets=False)
    fit, rows = fit_block(rows, block)
    _check_misfit(fit, touches)
    robot, state = recording.robot, fit.state
    pose = BlockPose(
        block,
        robot.name,
        robot.arm,
        state.rotation,
        state.translation,
        fit.covariance[:6, :6],
        state.scale,
        float(fit.sd[9]),
        rows.corrected_sd,
        datetime.now(UTC).isoformat(timespec="seconds"),
        recording.provenance.homing_id,
        str(calibration.metadata.get("data_sha256", "")),
    )
    return pose, fit


def fit_block(rows: TipRows, block: Block) -> tuple[TipFit, TipRows]:
    """Fit pose and size of a block to touches with known joints; raises as `fit_rows`.

    It takes three rows or more, of points that do not lie in a line. The errors that the joints
    keep are estimated too, as those of the training are smaller than those of another motion; the
    returned rows state them.
    """
    tip = rows.kinematics.forward(rows.joint)[:, :3, 3]
    rotation, translation = align(tip, rows.point * block.scale)
    start = TipState(np.zeros(rows.basis.shape[2]), rotation, translation, scale=block.scale)
    prior = TipPrior.of(start, 0.0, scale=block.scale_sd)
    rows = with_estimated_errors(rows, prior)
    return fit_rows(rows, prior), rows


def with_estimated_errors(rows: TipRows, prior: TipPrior) -> TipRows:
    """Enlarge `joint_sd` by the factor that makes the points likeliest (restricted likelihood).

    By 1 to 8, judged by the points that fit with the errors enlarged fourfold.
    """
    enlarged = [replace(rows, joint_sd=factor * rows.joint_sd) for factor in _FACTORS]
    first = fit_rows(enlarged[len(_FACTORS) // 2], prior)
    return enlarged[int(np.argmax([likelihood(each, prior, first) for each in enlarged]))]


def likelihood(rows: TipRows, prior: TipPrior, first: TipFit) -> float:
    """Logarithm of the restricted likelihood of the inliers of a `first` fit."""
    inliers = rows.rows(~first.left_out)
    return fit_rows(inliers, prior, gate=np.inf, start=first.state).evidence


def zero_prior(pose: BlockPose, offset_sd: Array) -> TipPrior:
    """Prior of offsets, `offset_sd` (n_joints,) [rad or m] about 0, and of a block's pose."""
    start = TipState(np.zeros(len(offset_sd)), pose.rotation, pose.translation, scale=pose.scale)
    precision = np.asarray(np.linalg.inv(pose.covariance))
    return TipPrior.of(start, offset_sd, scale=pose.scale_sd, pose_precision=precision)


def zero_by_touch(
    calibration: Calibration,
    recording: Recording,
    touches: Touches,
    pose: BlockPose,
    *,
    touch_sd: float = TOUCH_SD,
) -> tuple[Zero, TipFit]:
    """Zero of a calibration by touches, for `Calibration.at`, and the fit that it is of.

    An offset of each joint is fitted to touches of a block whose pose is known, with its own
    uncertainty. What the calibration leaves of each joint, by the touches of the pose, counts by
    what it does to the tip. The baselines move by the same offset.

    Raises
    ------
    CalibrationError
        If there are fewer than three touches, robot or arm are not those of the pose, or the
        touches fit neither offset nor pose.

    Examples
    --------
    >>> zero_by_touch(model, test, Touches((1.0,), ("1",)), None)
    Traceback (most recent call last):
    truejoint.errors.CalibrationError: ...
    """
    check_count(touches, FEWEST, "re-zero")
    check_pose(calibration, pose)
    rezeroed = calibration.for_rezeroing
    before = rezeroed.offset
    for _ in range(_ROUNDS):
        fit = fit_zero(rezeroed, recording, touches, pose, np.inf, touch_sd)
        _check_misfit(fit, touches)
        moved = fit.state.coefficients
        _check_offsets(recording.robot, dict(zip(calibration.joints, moved, strict=True)), touches)
        rezeroed = rezeroed.shifted(moved)
        # Outputs whose inputs are moved go about as far, but not just as far.
        if rezeroed.moves is None or (np.abs(moved) < 0.1 * fit.sd[: len(moved)]).all():
            break
    offset = rezeroed.offset - before
    zero = Zero(
        offset,
        fit.sd[: len(offset)],
        source="touch",
        file=recording.provenance.source,
        homing_id=recording.provenance.homing_id,
        rows=len(touches),
        duration=touches.t[-1] - touches.t[0],
        baselines=dict.fromkeys(rezeroed.fitted_baselines, offset),
        details={
            "block": pose.title,
            "left_out": [touches.dimple[i] for i in np.flatnonzero(fit.left_out)],
        },
    )
    return zero, fit


def fit_zero(
    calibration: Calibration,
    recording: Recording,
    touches: Touches,
    pose: BlockPose,
    offset_sd: Array | float,
    touch_sd: float = TOUCH_SD,
) -> TipFit:
    """Fit the offset of each joint, expected within `offset_sd` [rad or m], to touches of a block.

    Raises as `tip_rows` and `fit_rows`.
    """
    rows = tip_rows(calibration, recording, touches, pose.block, touch_sd=touch_sd)
    n = len(rows.columns)
    if len(pose.joint_sd) == n:
        rows = rows.with_joint_sd(pose.joint_sd)
    return fit_rows(rows, zero_prior(pose, np.broadcast_to(offset_sd, n)))


def _check_offsets(robot: Robot, offsets: Mapping[str, float], touches: Touches) -> None:
    """Refuse offsets [rad or m] by joint that no homing makes."""
    for joint, offset in offsets.items():
        unit = robot.joint(joint).unit
        if abs(offset) > _FARTHEST[unit]:
            raise CalibrationError(
                f"{touches.source}: the zero of {joint} would move by {shown(offset, unit)}, more "
                "than a homing does; has the block moved since its pose was found, or is the model "
                "of another arm?"
            )


def check_pose(calibration: Calibration, pose: BlockPose) -> None:
    """Refuse a block's pose in another arm's base, or one that another calibration found."""
    if (calibration.robot, calibration.arm) != (pose.robot, pose.arm):
        raise CalibrationError(
            f"the model is of {calibration.title}, the block's pose {pose.title}; find the pose "
            "with this model"
        )
    sha = str(calibration.metadata.get("data_sha256", ""))
    if pose.model_sha256 and sha != pose.model_sha256:
        raise CalibrationError(
            f"the pose of {pose.title} was found with another calibration than this model; find it "
            "with this one, on the day of its full calibration"
        )


def _check_misfit(fit: TipFit, touches: Touches) -> None:
    """Refuse a fit whose residuals are beyond what touches and model leave."""
    if fit.misfit > _MISFIT * max(fit.freedom, 1):
        rms = np.sqrt((fit.residual[~fit.left_out] ** 2).sum(axis=1).mean())
        raise CalibrationError(
            f"{touches.source}: the touches stay {1e3 * rms:.2f} mm off whatever the zero; has the "
            "block moved since its pose was found, or is the model of another arm?"
        )
