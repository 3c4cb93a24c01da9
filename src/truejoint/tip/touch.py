"""Touched dimples of a block: when, where the block stands, and what they calibrate."""

from __future__ import annotations

import csv
import math
import os
from collections.abc import Container, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from itertools import chain
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from truejoint.array_types import Array, Integers, floats
from truejoint.calibration.calibration import Calibration
from truejoint.calibration.compatibility import check_columns, source_of
from truejoint.calibration.fit import calibrate
from truejoint.calibration.zero import Zero
from truejoint.errors import CalibrationError, other_kind
from truejoint.estimators.family import EstimatorData
from truejoint.estimators.polynomial.learn import Polynomial
from truejoint.estimators.polynomial.run import of_degree
from truejoint.files import read_small
from truejoint.recordings import Recording
from truejoint.robots import Robot
from truejoint.tip import accuracy
from truejoint.tip.accuracy import Split, TipError, Trial
from truejoint.tip.block import TOUCH_SD, Block, BlockPose
from truejoint.tip.fit import (
    SCALE,
    TipFit,
    TipPrior,
    TipRows,
    TipState,
    align,
    fit_rows,
    whiten_rows,
)
from truejoint.tip.terms import (
    LEFT,
    SPREAD,
    Terms,
    TermsPrior,
    learned_priors,
    spread_of,
    wide_priors,
)
from truejoint.units import shown, with_unit

_NOTHING: Final = np.empty(0)
FEWEST: Final = 3
"""Touches that re-zero a calibration."""
FEWEST_OF_BLOCK: Final = 2 * FEWEST
"""Touches that find a block's pose."""
_MISFIT: Final = 3.0
"""Squares of residuals, as a multiple of what is expected, beyond which nothing fits. Where block,
arm and day are right they stay below two on ten arms whose errors are 2.5 times as stated."""
_MOVES: Final = 11.3  # chi-square of three freedoms that one block in a hundred exceeds at rest
_MOVED: Final = (0.02, 3e-3)  # rad and m per axis by which a block is looked for elsewhere
_UNNOTICED: Final = (3e-3, 3e-4)  # the same of a move that touches may not show
_PASSES: Final = 0.5  # of a homing, which may be a move of the block
_FARTHEST: Final = 3.0
"""No homing moves a zero by more, in `SPREAD`, but a block that has moved may seem to."""
_ENLARGED: Final = 3.0  # times the training's errors, with which a block is first fitted
_SPLITS: Final = 2  # rounds of choosing a prior and splitting the residuals
_ROUNDS: Final = 5  # of moving the inputs of a model until its output fits
REST: Final = 0.3
"""Time before a touch's stamp over which positions are averaged [s]."""
_SLACK: Final = {"rad": 5e-4, "m": 5e-5}  # by which positions may move within `REST`
_CALIBRATING: Final = 12  # touches of an unknown arm; half as many with a prior
_FOLDS: Final = 6
_FLAT: Final = 0.05  # of the touches' extent, below which they lie in a plane
_SIDED: Final = 0.15  # of the touches that come from either side of each joint
_SEEN: Final = 0.5  # of the prior deviation, above which a zero was not seen
_SIZED: Final = 0.8  # the same of the size of a print
_WORTH: Final = 5e-5  # effect of an unmeasured print's size on the tip that is reported [m]
_STEEP: Final = 3.5  # deviations of a slope from what its prior expects that are refused
_ODD: Final = 1.6  # of the noise that is stated
_MEASURED: Final = 9  # degrees of freedom of repeats that measure a noise
_STILL: Final = 0.1  # rad, way of a joint that counts as held
_UNSURE: Final = 0.2  # deviation of a zero that is reported, in `SPREAD`
_MAX_BYTES: Final = 1 << 20
SHOT_SD: Final = 2.5e-4
"""Standard deviation of a marker at rest that a tracker sees, per axis [m]."""
_TRACKER: Final = 0.99  # m, a length that a tracker measures as it is


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

    def among(self, dimples: Container[str], *, are_in: bool = True) -> Touches:
        """Touches of some dimples, or of all others; raises CalibrationError if there are none."""
        rows = zip(self.t, self.dimple, strict=True)
        chosen = [(t, name) for t, name in rows if (name in dimples) is are_in]
        return Touches(tuple(t for t, _ in chosen), tuple(n for _, n in chosen), self.source)


def read_touches(path: str | os.PathLike[str]) -> Touches:
    r"""Touches of a CSV file with a header: ``t`` [s], ``dimple`` and whatever else.

    Raises CalibrationError naming line and value.

    Examples
    --------
    >>> _ = Path("touches.csv").write_text("t,dimple\n4.0,3\n9.5,17\n")
    >>> read_touches(Path("touches.csv")).dimple
    ('3', '17')
    """
    rows = _read_rows(Path(path), ("t", "dimple"), "touches", "a time [s] and a dimple")
    return Touches(tuple(float(t) for t, _ in rows), tuple(name for _, name in rows), str(path))


def read_shots(path: str | os.PathLike[str]) -> tuple[Touches, Block]:
    r"""Single shots of a tracker at rest: a CSV file with ``t`` [s], ``x_mm``, ``y_mm``, ``z_mm``.

    They are touches of a block of those points, each numbered by its place in the file. Raises
    CalibrationError naming line and value.

    Examples
    --------
    >>> _ = Path("shots.csv").write_text("t,x_mm,y_mm,z_mm\n4.0,1,2,800\n9.5,1,3,800\n")
    >>> read_shots(Path("shots.csv"))[1].points["2"]
    array([0.001, 0.003, 0.8  ])
    """
    columns = ("t", "x_mm", "y_mm", "z_mm")
    rows = _read_rows(Path(path), columns, "shots", "a time [s] and three numbers")
    table = np.array(rows, dtype=np.float64).reshape(-1, 4)
    points = {str(k): point / 1e3 for k, point in enumerate(table[:, 1:], 1)}
    touches = Touches(tuple(table[:, 0].tolist()), tuple(points), str(path))
    return touches, Block(str(path)[-200:], "", points, _TRACKER, _TRACKER)


def _read_rows(path: Path, names: Sequence[str], content: str, want: str) -> list[list[str]]:
    """Columns of a CSV file by name, a row each; all but ``dimple`` are numbers.

    `content` is what the file holds, and `want` what a line is to give, for the errors. Raises
    CalibrationError naming line and value.
    """
    text = read_small(path, CalibrationError, _MAX_BYTES, content).decode("utf-8", "replace")
    try:
        lines = list(csv.reader(text.splitlines()))
    except csv.Error as error:  # a file of something else: a field of 100 kB
        raise CalibrationError(f"{path}: is not a CSV file of {content} ({error})") from None
    header = [name.strip() for name in lines[0]] if lines else []
    if not set(names) <= set(header):
        listed = ",".join(names)
        raise CalibrationError(f"{path}: its first line names {header!r:.60}; want {listed}")
    rows = []
    for number, line in enumerate(lines[1:], 2):
        try:
            if line:
                rows.append([line[header.index(name)].strip() for name in names])
                [float(value) for value in rows[-1][: len(names) - ("dimple" in names)]]
        except (IndexError, ValueError):
            raise CalibrationError(
                f"{path}, line {number}: {','.join(line)!r:.60}; want {want}"
            ) from None
    return rows


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
    joint_sd: Array = _NOTHING,
) -> TipRows:
    """Rows of touches with corrected positions, in an offset a joint.

    `touch_sd` [m] is the standard deviation of a tip from its dimple, per axis; `joint_sd`
    (n_joints,) [rad or m] is what the calibration leaves of each joint, by default the errors of
    its training. Raises CalibrationError if columns are missing, or touches and recording do not go
    together.
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
    basis = np.tile(np.eye(n), (len(touches), 1, 1))
    return TipRows.of(
        robot, at_rest(recording, touches, joint), calibration.joints, basis,
        block.at(touches.dimple), touch_sd,
        joint_sd if len(joint_sd) == n else calibration.effort_baseline.residual,
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
    working = touches.among(block.references, are_in=False)
    check_count(working, FEWEST_OF_BLOCK, "find a block's pose")
    rows = tip_rows(calibration, recording, touches, block, touch_sd=touch_sd)
    dimple = np.array(touches.dimple)
    fit = fit_block(rows.rows(~np.isin(dimple, list(block.references))), block)
    _check_misfit(fit, working)
    robot, state, k = recording.robot, fit.state, len(fit.state.coefficients)
    found = rows.point + rows.residual(state) / state.scale
    references = {
        name: found[dimple == name].mean(axis=0)
        for name in dict.fromkeys(touches.dimple)
        if name in block.references
    }
    pose = BlockPose(
        replace(block, references=references), robot.name, robot.arm, state.rotation,
        state.translation, fit.covariance[k : k + 6, k : k + 6], state.scale, float(fit.sd[k + 9]),
        fit.rows.corrected_sd, datetime.now(UTC).isoformat(timespec="seconds"),
        recording.provenance.homing_id, str(calibration.metadata.get("data_sha256", "")),
    )  # fmt: skip
    return pose, fit


def fit_block(rows: TipRows, block: Block) -> TipFit:
    """Fit pose and size of a block to touches with known joints; raises as `fit_rows`.

    It takes three rows or more, of points that do not lie in a line. The errors that the joints
    keep are estimated too, as those of the training are smaller than those of another motion; the
    rows of the fit state them.
    """
    held = np.zeros(rows.basis.shape[2])
    prior = terms_prior(rows, block, held, held)
    loose = accuracy.fit_loosely(rows.with_joint_sd(_ENLARGED * rows.corrected_sd), prior)
    splits = accuracy.split_residuals(loose, rows, np.arange(len(rows)), least=1.0)
    return accuracy.refitted(loose, rows, splits)


def zero_prior(pose: BlockPose, offset_sd: Array, moved: Array | float = 0.0) -> TipPrior:
    """Prior of offsets, `offset_sd` (n_joints,) [rad or m] about 0, and of a block's pose.

    The block may have `moved` since that was found: the covariance (6, 6) of a move.
    """
    start = TipState(np.zeros(len(offset_sd)), pose.rotation, pose.translation, scale=pose.scale)
    precision = np.asarray(np.linalg.inv(pose.covariance + moved))
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
    before, homing = rezeroed.offset, spread_of(calibration.machine, calibration.joints)
    for _ in range(_ROUNDS):
        rows = tip_rows(
            rezeroed, recording, touches, pose.block, touch_sd=touch_sd, joint_sd=pose.joint_sd
        )
        fit = _fit_bolted(rows, pose, touches, homing)
        moved = fit.state.coefficients
        k = int(np.argmax(np.abs(moved) / homing))
        if abs(moved[k]) > _FARTHEST * homing[k]:
            joint = recording.robot.joint(calibration.joints[k])
            raise CalibrationError(
                f"{touches.source}: the zero of {joint.name} would move by "
                f"{shown(float(moved[k]), joint.unit)}, more than a homing does; has the block "
                "moved since its pose was found, or is the model of another arm?"
            )
        rezeroed = rezeroed.shifted(moved)
        # Outputs whose inputs are moved go about as far, but not just as far.
        if rezeroed.moves is None or (np.abs(moved) < 0.1 * fit.sd[: len(moved)]).all():
            break
    offset = rezeroed.offset - before
    move = _unnoticed_move(fit, pose, touches, offset)
    loose = zero_prior(pose, np.full(len(offset), np.inf), move)
    zero = Zero(
        offset,
        fit_rows(rows, loose, start=fit.state).sd[: len(offset)],
        source="touch",
        file=recording.provenance.source,
        homing_id=recording.provenance.homing_id,
        rows=len(touches),
        duration=touches.t[-1] - touches.t[0],
        baselines=dict.fromkeys(rezeroed.fitted_baselines, offset),
        details={
            "block": pose.title,
            "left_out": [touches.dimple[i] for i in np.flatnonzero(fit.left_out)],
            "unnoticed_move": float(np.sqrt(np.trace(move[3:, 3:]))),
        },
    )
    return zero, fit


def _fit_bolted(rows: TipRows, pose: BlockPose, touches: Touches, homing: Array) -> TipFit:
    """Fit offsets to touches of a bolted block; refuse them, by name, if it has moved."""
    point, since = pose.scale * rows.point.mean(axis=0), np.repeat(np.square(_MOVED), 3)
    still = zero_prior(pose, homing)

    def words(fit: TipFit) -> str:
        now, then = (at.rotation @ point + at.translation for at in (fit.state, pose))
        far = with_unit(float(np.linalg.norm(now - then)), "m")
        return (
            f"when the block has moved by {far} since its pose was found: bolt it down, and find "
            "its pose anew with a fresh calibration"
        )

    working = ~np.isin(touches.dimple, list(pose.block.references))
    against = [] if working.all() else [("against its references", working)]
    trials = chain(
        [Trial(rows, zero_prior(pose, homing, np.diag(since)), words)],
        accuracy.renumbered(rows, pose.block, touches.dimple, lambda _: still),
        accuracy.moved(rows, still, "the block", against),
    )
    trouble = None
    try:
        fit = fit_rows(rows, zero_prior(pose, np.full(len(homing), np.inf)))
        _check_misfit(fit, touches)
    except CalibrationError as error:
        trouble = error
    accuracy.check_faults(touches.source, rows, still, trials, np.arange(len(rows)))
    if trouble is not None:
        raise trouble
    return fit


def _unnoticed_move(fit: TipFit, pose: BlockPose, touches: Touches, offset: Array) -> Array:
    """Covariance (6, 6) of a move of the block that would pass for a homing by `offset` (n,).

    Half a millimetre, and half of what the offset does to the tip, unless touched references
    say less. Refuses a block that has moved against them.
    """
    equations = fit.rows.equations(fit.state)
    way = (equations.by_joint[:, :, list(fit.rows.columns)] @ offset).mean(axis=0)
    seen = np.eye(3) * _UNNOTICED[1] ** 2 + np.outer(way, way) * _PASSES**2
    still = np.isin(touches.dimple, list(pose.block.references))
    if still.any() and not still.all():
        off, information = accuracy.shift_of(fit, ~still)
        # The references' own places were found by as many touches.
        white = whiten_rows(fit.rows, still, fit.state)
        turned = white.whitening.transpose(0, 2, 1) * white.weight[:, None, None]
        spread = np.linalg.inv(information) + np.linalg.inv((turned @ white.whitening).sum(axis=0))
        if off @ np.linalg.solve(spread, off) > _MOVES:
            raise CalibrationError(
                f"{touches.source}: the points fit only when the block has moved by "
                f"{with_unit(float(np.linalg.norm(off)), 'm')} against its references since its "
                "pose was found: bolt it down, and find its pose anew with a fresh calibration"
            )
        seen = np.linalg.inv(np.linalg.inv(spread) + np.linalg.inv(seen))
    share = np.trace(seen) / (3.0 * _UNNOTICED[1] ** 2)
    covariance = np.diag(np.repeat([share * _UNNOTICED[0] ** 2, 0.0], 3))
    covariance[3:, 3:] = pose.rotation @ seen @ pose.rotation.T
    return covariance


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


def fewest_touches(prior: Calibration | None) -> int:
    """Different touches that it takes at least to calibrate an arm with such a prior."""
    return _CALIBRATING // 2 if prior else _CALIBRATING


@dataclass(frozen=True, eq=False)
class TouchReport:
    """Accuracy of a calibration by touch, and what the touches did not show.

    Attributes
    ----------
    touches : Touches
    fit : TipFit
    left_out_rms : float
        RMS distance [m] of points from where a fit without them expects them, as it is: the points'
        own noise is in it.
    tip, workspace : TipError
        Error of the tip [m] in the block's frame, near the touches and over the workspace, by what
        the fit leaves open and what joints keep.
    reach : float
        Share of the workspace that lies amid the touches.
    is_measured : bool
        Whether repeats measured the noise; else it is between what was stated and what residuals
        allow.
    stated_noise : float
        Per axis [m].
    zero_sd : ndarray, shape (n_joints,)
        Standard deviation of each joint's zero amid the workspace [rad or m].
    not_seen : tuple of str
        In words, what only the prior holds.
    point, before, left_out : ndarray, shape (m, 3)
        Of each touch its point in the block; the error of the tip by the measured positions, with
        the block laid over them as well as it can be; and the error by a fit without this touch
        [m].

    Examples
    --------
    >>> TouchReport.__dataclass_fields__["zero_sd"].type
    'Array'
    """

    touches: Touches
    fit: TipFit
    left_out_rms: float
    tip: TipError
    workspace: TipError
    reach: float
    is_measured: bool
    stated_noise: float
    zero_sd: Array
    not_seen: tuple[str, ...]
    point: Array
    before: Array
    left_out: Array

    @property
    def statement(self) -> tuple[str, ...]:
        """How far off the tip is, for a person: the raw error first."""
        raw, noise = with_unit(self.left_out_rms, "m"), with_unit(self.fit.rows.point_sd, "m")
        near = f"{with_unit(self.tip.rms, 'm')} ± {with_unit(self.tip.sd, 'm')}"
        first = f"points left out in turn are {raw} off (RMS), their own noise in it"
        if self.is_measured:
            second = f"the tip is {near} off near the touches (noise {noise} per axis, by repeats)"
        else:
            stated = with_unit(math.sqrt(3.0) * self.stated_noise, "m")
            second = (
                f"the tip is at most {raw} off near the touches, of which the noise that you "
                f"stated may be {stated}; by what the fit leaves open {near}"
            )
        far = with_unit(self.workspace.rms, "m")
        third = f"over the workspace, {self.reach:.0%} of which lies amid the touches, {far}"
        return first, second, third


def calibrate_by_touch(
    recording: Recording,
    touches: Touches,
    block: Block,
    *,
    touch_sd: float = TOUCH_SD,
    prior: Calibration | None = None,
) -> tuple[Calibration, TouchReport]:
    """Fit joints and a block's pose together to touches of its dimples.

    Of each positioning joint a constant, slopes and squares of all of them, and plays of its own:
    with three joints 39 numbers. The tip is then right in the block's frame, and joints as far as
    `TouchReport.not_seen` leaves them. The prior of the terms is the one under which the touches
    are likeliest, among wide ones and those that an older calibration gives.

    Parameters
    ----------
    recording : Recording
        Continuous, from before the first touch on: plays need to know where a joint came from.
    touches : Touches
    block : Block
    touch_sd : float
        Standard deviation of a tip from its dimple, per axis [m].
    prior : Calibration, optional
        An older one of this arm.

    Returns
    -------
    calibration : Calibration
        An ordinary one, of a polynomial of degree 2, without an interval; its metadata have
        ``truth`` ``"touch"`` and what `TouchReport` says.
    report : TouchReport

    Raises
    ------
    CalibrationError
        If the workspace is not known, touches are fewer than twelve (with a prior, six), lie in a
        plane and there is no prior, come from one side, or do not fit, or the prior is of another
        arm.
    RobotError
        If the kinematics are not known.

    Examples
    --------
    >>> calibrate_by_touch(test, Touches((1.0,), ("1",)), None)
    Traceback (most recent call last):
    truejoint.errors.CalibrationError: ...
    """
    check_count(touches, fewest_touches(prior), "calibrate")
    touches = touches.among(block.points)
    check_count(touches, fewest_touches(prior), "calibrate")
    terms = Terms.of_workspace(recording.robot)
    shared, plays = terms.columns_of(recording)
    _check_spread(touches, block, terms, at_rest(recording, touches, plays), prior)
    fitting = fit_terms(recording, touches, block, terms, (shared, plays), prior, touch_sd)
    fit = fitting.fit
    report = _report(touches, block, fitting, terms, recording.robot)
    state, corrected_sd = fit.state, fit.rows.corrected_sd
    correction = terms.basis(shared, plays) @ state.coefficients
    table = {"t": recording.t} | {c: recording.column(c) for c in recording.units}
    for k, joint in enumerate(terms.joints):
        table[f"truth/{joint}"] = recording.column(f"measured/{joint}") + correction[:, k]
    robot = recording.robot
    whole = Recording.from_columns(table, recording.provenance, recording.units, robot=robot)
    # Domain, units and baselines are fitted; the touches alone give the model.
    joints = terms.joints
    fitted = calibrate([whole], "linear", features=terms.features, joints=joints, redundant=[])
    data = EstimatorData("polynomial", of_degree(2), terms.arrays(state.coefficients))
    model = Polynomial.from_data(data, len(terms.features), len(terms.joints))
    if (baseline := fitted.effort_baseline) is not None:
        residual = np.hypot(corrected_sd, report.zero_sd)
        baseline = replace(baseline, residual=residual)
    calibration = replace(
        fitted,
        fitted=data,
        learnt=None,
        effort_baseline=baseline,
        origin=replace(fitted.origin, estimator=model.name),
    ).with_metadata(
        settings=" ".join(repr(model).split()),
        truth="touch",
        touch={
            "touches": len(touches),
            "prior": [prior.title] if prior and fitting.is_learned else [],
            "left_out": [touches.dimple[i] for i in np.flatnonzero(fit.left_out)],
            "left_out_rms": report.left_out_rms,
            "tip_error": report.tip.rms,
            "tip_error_sd": report.tip.sd,
            "tip_error_workspace": report.workspace.rms,
            "reach": report.reach,
            "noise": fit.rows.point_sd,
            "noise_is_measured": report.is_measured,
            "zero_sd": report.zero_sd.tolist(),
            "joint_sd": corrected_sd.tolist(),
            "scale": state.scale,
            "rotation": state.rotation.tolist(),
            "translation": state.translation.tolist(),
            "not_seen": list(report.not_seen),
        },
    )
    return calibration, report


class TermsFit(NamedTuple):
    """Terms and a block's pose that fit touches, and what the residuals are made of."""

    fit: TipFit
    splits: list[Split]
    place: Integers  # (m,), repeats of one place share a number
    noise: float  # Stated standard deviation of a touch, per axis [m]
    has_prior: bool
    is_learned: bool  # Whether the likeliest prior is of an older calibration


def fit_terms(
    recording: Recording,
    touches: Touches,
    block: Block,
    terms: Terms,
    columns: tuple[Array, Array],
    prior: Calibration | None,
    touch_sd: float = TOUCH_SD,
) -> TermsFit:
    """Fit terms and a block's pose to touches, under the likeliest prior.

    `columns` are the terms', of the recording. The points themselves choose the prior, the errors
    that joints keep and what a touch errs (empirical Bayes). Raises as `fit_rows` and `resting`,
    and CalibrationError for a prior of another arm, and for points that fit only if
    something is wrong with them, which is named.
    """
    robot = recording.robot
    measured = recording.columns("measured", robot.joint_names)
    rows = TipRows.of(
        robot, at_rest(recording, touches, measured), terms.joints,
        at_rest(recording, touches, terms.basis(*columns)),
        block.at(touches.dimple), touch_sd, LEFT * terms.scale,
    )  # fmt: skip
    place = accuracy.repeated(rows, at_rest(recording, touches, columns[1]))
    learned = learned_priors(terms, prior, recording) if prior else []
    expected = [*learned, *wide_priors(terms)]
    candidates = [terms_prior(rows, block, *each) for each in expected]
    widest = len(learned)
    try:
        fit = accuracy.fit_loosely(rows, candidates[widest])
        for _ in range(_SPLITS):
            best = accuracy.likeliest(fit, candidates)
            fit = fit_rows(fit.rows, candidates[best], start=fit.state)
            splits = accuracy.split_residuals(fit, rows, place)
            fit = accuracy.refitted(fit, rows, splits)
    except CalibrationError as error:
        _check_points(rows, touches, block, expected[widest], place, str(error))
        raise
    is_learned = best < len(learned)
    likely = expected[best if is_learned else widest]
    steep = _steep_slope(fit, terms, likely)
    is_odd = bool(steep) or fit.rows.point_sd > _ODD * touch_sd
    how = {"is_odd": is_odd, "is_sized": is_learned}
    _check_points(rows, touches, block, likely, place, steep, **how)
    return TermsFit(fit, splits, place, touch_sd, prior is not None, is_learned)


def _steep_slope(fit: TipFit, terms: Terms, expected: TermsPrior) -> str:
    """Say which joint's own slope is away from 1 by more than its prior allows; empty if none."""
    own = [k for k, kind in enumerate(terms.kinds) if kind == "slope"][:: len(terms.joints) + 1]
    off = (fit.state.coefficients - expected.mean)[own] / expected.sd[own]
    k = int(np.argmax(np.abs(off)))
    if abs(off[k]) < _STEEP:
        return ""
    per = terms.scale[k] / terms.half[k]
    middle, reach = 1.0 + per * expected.mean[own[k]], _STEEP * per * expected.sd[own[k]]
    return (
        f"the slope of {terms.joints[k]} would be {1 + per * fit.state.coefficients[own[k]]:.2f}, "
        f"where {middle - reach:.2f} to {middle + reach:.2f} is allowed; are the points of this "
        "arm?"
    )


def _check_points(
    rows: TipRows, touches: Touches, block: Block, expected: TermsPrior, place: Integers,
    trouble: str, *, is_odd: bool = True, is_sized: bool = False,
) -> None:  # fmt: skip
    """Refuse points that fit only if mirrored, scaled, moved, renumbered or not of the tip.

    Where none of that is found, refuse them for their `trouble` if there is one. Mirrors and
    numbers are tried if the fit `is_odd`, and another size where what is `expected` tells it.
    """

    def prior_of(each: TipRows) -> TipPrior:
        return terms_prior(each, block, *expected)

    prior = prior_of(rows)
    advice = "measure the print and enter measured_mm" if block.robot else "check the tracker"
    what = "the block" if block.robot else "the tracker"
    moves = accuracy.moved(rows, prior, what, accuracy.halves(touches.t))
    trials = [accuracy.off_the_tip(rows, prior), *moves]
    if is_sized:
        trials.append(accuracy.scaled(rows, prior, advice))
    if is_odd:
        trials.append(accuracy.mirrored(rows, block, prior_of))
    if is_odd and block.robot:
        trials += accuracy.renumbered(rows, block, touches.dimple, prior_of)
    accuracy.check_faults(touches.source, rows, prior, trials, place)
    if trouble:
        raise CalibrationError(f"{touches.source}: {trouble}")


def terms_prior(rows: TipRows, block: Block, mean: Array, sd: Array) -> TipPrior:
    """Prior of coefficients, `mean` and `sd` (k,), and of a block that may stand anywhere.

    The fit starts where the tool, as it is measured, meets the points. Raises CalibrationError if
    they lie in a line.
    """
    tip = rows.kinematics.forward(rows.joint)[:, :3, 3]
    start = TipState(mean, *align(tip, rows.point * block.scale), scale=block.scale)
    return TipPrior.of(start, sd, scale=block.scale_sd)


def _check_spread(
    touches: Touches, block: Block, terms: Terms, plays: Array, prior: Calibration | None
) -> None:
    """Refuse touches in one plane, unless there is a `prior`, and those that come from one side.

    `plays` (m, n_joints, n_widths) are as of `Terms.columns`.
    """
    point = block.at(touches.dimple)
    extent = np.linalg.svd(point - point.mean(axis=0), compute_uv=False)
    if extent[2] < _FLAT * extent[0] and prior is None:
        raise CalibrationError(
            f"{touches.source}: all touches lie in one plane, which leaves slopes and a turn open; "
            "touch stairs (truejoint touch block), or give a prior (--prior)"
        )
    for joint, rising in zip(terms.joints, (plays < 0.0).mean(axis=(0, 2)), strict=True):
        if not _SIDED <= rising <= 1.0 - _SIDED:
            raise CalibrationError(
                f"{touches.source}: {joint} comes from one side in {max(rising, 1 - rising):.0%} "
                "of the touches, which hides what its cable loses; come from both"
            )


def _report(
    touches: Touches, block: Block, fitting: TermsFit, terms: Terms, robot: Robot
) -> TouchReport:
    fit, splits = fitting.fit, fitting.splits
    rows, off, inlier = fit.rows, _held_out_errors(fit, fitting.place), ~fit.left_out
    uncorrected = replace(fit.state, coefficients=np.zeros(len(fit.state.coefficients)))
    tip = rows.tool_points(uncorrected)[1]
    turn, shift = align(tip[inlier], rows.point[inlier] * block.scale)
    everywhere, reach = accuracy.over_workspace(fit, robot)
    near = np.repeat(rows.joint[inlier], 4, axis=0)
    return TouchReport(
        touches=touches,
        fit=fit,
        left_out_rms=float(np.sqrt((off[inlier] ** 2).sum(axis=1).mean())),
        tip=accuracy.tip_error(fit, splits, terms, near),
        workspace=accuracy.tip_error(fit, splits, terms, everywhere),
        reach=reach,
        is_measured=accuracy.repeat_noise(fit, fitting.place)[1] >= _MEASURED,
        stated_noise=fitting.noise,
        zero_sd=fit.sd[terms.zeros] * terms.scale,
        not_seen=tuple(_unseen(block, fitting, terms)),
        point=rows.point,
        before=(tip - shift) @ turn - rows.point * block.scale,
        left_out=off,
    )


def _held_out_errors(fit: TipFit, place: Integers) -> Array:
    """Error of each touch (m, 3) [m] by a fit without it, its repeats and a few others."""
    rows, inlier = fit.rows, ~fit.left_out
    fold = np.full(len(rows), _FOLDS)
    fold[inlier] = np.unique(place[inlier], return_inverse=True)[1] % _FOLDS
    errors = fit.residual.copy()
    for number in range(_FOLDS):
        train = rows.rows(inlier & (fold != number))
        other = fit_rows(train, fit.prior, gate=np.inf, start=fit.state)
        errors[fold == number] = rows.residual(other.state)[fold == number]
    return errors


def _unseen(block: Block, fitting: TermsFit, terms: Terms) -> list[str]:
    """Say in words what the touches did not show, and how far off it may be."""
    fit = fitting.fit
    words = []
    prior_sd = 1.0 / np.sqrt(np.diag(fit.prior.precision)[terms.zeros])
    rows = zip(terms.joints, fit.sd[terms.zeros], prior_sd, terms.scale, strict=True)
    for joint, sd, before, scale in rows:
        within = with_unit(float(sd * scale), "rad" if scale == SPREAD["rad"] else "m")
        if sd > _SEEN * before:
            words.append(f"zero of {joint}: not seen, assumed within {within}")
        elif sd > _UNSURE:
            words.append(f"zero of {joint}: ± {within}")
    point = fit.rows.point
    size = float(np.sqrt(((point - point.mean(axis=0)) ** 2).sum(axis=1).mean()))
    if block.scale_sd * size > _WORTH:  # nobody has measured it
        size_sd = float(fit.sd[fit.state.names.index(SCALE)])
        share = f"{100 * (fit.state.scale / block.scale - 1.0):+.2f} % ± {100 * size_sd:.2f} %"
        if size_sd > _SIZED * block.scale_sd:
            share = f"not seen, assumed within {100 * size_sd:.1f} %"
        words.append(
            f"size of the print: {share}, which is {with_unit(size_sd * size, 'm')} of the tip: "
            "measure it, and enter measured_mm"
        )
    elif not fitting.is_learned:
        words.append(
            f"size of the {'print' if block.robot else 'frame'}: not seen, taken as stated; 1 % of "
            f"it is {with_unit(0.01 * size, 'm')} of the tip"
        )
    held = np.delete(fit.rows.joint, fit.rows.columns, axis=1)
    if not block.robot and (np.ptp(held, axis=0) < _STILL).all():
        words.append(
            "the marker: whether it sits at the tip is not seen, as roll and wrist stand still"
        )
    noise = fit.rows.point_sd
    if not 1.0 / _ODD < noise / fitting.noise < _ODD:
        words.append(
            f"noise: the residuals say {with_unit(noise, 'm')} per axis, not "
            f"{with_unit(fitting.noise, 'm')} as stated"
        )
    if fitting.has_prior and not fitting.is_learned:
        words.append("the prior: the touches are likelier without it, so it was not used")
    return words
