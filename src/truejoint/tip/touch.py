"""Touched dimples of a block: when, where the block stands, and what they calibrate."""

import csv
import math
import os
from collections.abc import Container, Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import Any, Final

import numpy as np

from truejoint.array_types import Array, Integers, floats
from truejoint.calibration.calibration import Calibration
from truejoint.calibration.compatibility import source_of
from truejoint.calibration.fit import calibrate
from truejoint.calibration.zero import Zero
from truejoint.errors import CalibrationError, other_kind
from truejoint.estimators.family import EstimatorData
from truejoint.estimators.polynomial.learn import Polynomial
from truejoint.estimators.polynomial.run import of_degree
from truejoint.files import read_small
from truejoint.recordings import Recording
from truejoint.tip import accuracy
from truejoint.tip.accuracy import TipError, Trial
from truejoint.tip.block import TOUCH_SD, Block, BlockPose
from truejoint.tip.fit import MARKER, SCALE, TipFit, TipPrior, TipRows, TipState, align, fit_rows
from truejoint.tip.terms import (
    LEFT,
    SPREAD,
    Terms,
    TermsPrior,
    learned_priors,
    measured_joints,
    spread_of,
    wide_priors,
)
from truejoint.units import shown, with_unit

FEWEST: Final = 3  # touches that re-zero a calibration
FEWEST_OF_BLOCK: Final = 2 * FEWEST  # touches that find a block's pose
# Squares of residuals, as a multiple of what is expected, beyond which nothing fits. Where block,
# arm and day are right they stay below two on ten arms whose errors are 2.5 times as stated.
_MISFIT: Final = 3.0
_MOVES: Final = 11.3  # chi-square of three freedoms that one block in a hundred exceeds at rest
_MOVED: Final = (0.02, 3e-3)  # rad and m per axis by which a block is looked for elsewhere
_UNNOTICED: Final = (3e-3, 3e-4)  # the same of a move that touches may not show
_FARTHEST: Final = 3.0  # `SPREAD`; no homing moves a zero further, a moved block may seem to
_ENLARGED: Final = 3.0  # times the training's errors, with which a block is first fitted
_SPLITS: Final = 2  # rounds of choosing a prior and splitting the residuals
_ROUNDS: Final = 5  # of moving the inputs of a model until its output fits
REST: Final = 0.3  # s before a touch's stamp, over which positions are averaged
_OTHERWISE: Final = "has the block moved since its pose was found, or is the model of another arm?"
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
SHOT_SD: Final = 2.5e-4  # m, deviation per axis of a marker at rest that a tracker sees
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

    def among(self, dimples: Container[str], *, are_in: bool = True) -> "Touches":
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
    """Columns of a CSV file of some `content`, a row each; all but ``dimple`` are numbers.

    Raises CalibrationError naming line and value, and what a line is to give.
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
    rows, numbers = [], len(names) - ("dimple" in names)
    for number, line in enumerate(lines[1:], 2):
        try:
            if line:
                rows.append([line[header.index(name)].strip() for name in names])
                [float(value) for value in rows[-1][:numbers]]
        except (IndexError, ValueError):
            given = f"{path}, line {number}: {','.join(line)!r:.60}"
            raise CalibrationError(f"{given}; want {want}") from None
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
        first, last = np.searchsorted(stamps, [t - REST, t], side="right").tolist()
        if last - first < 2:
            raise CalibrationError(
                f"{touches.source}: {source_of(recording)}, of {stamps[0]:.1f} to {stamps[-1]:.1f} "
                f"s, has {last - first} rows at dimple {dimple}, {t:g} s; is it their recording?"
            )
        span = np.ptp(measured[first:last], axis=0)
        k = int(np.argmax(span / slack))
        if span[k] > slack[k]:
            raise CalibrationError(
                f"{touches.source}: {joints[k]} moves by {shown(float(span[k]), units[k])} while "
                f"dimple {dimple} is taken, at {t:g} s; rest for {REST:g} s before the stamp"
            )
        rests.append(slice(first, last))
    return rests


def at_rest(recording: Recording, touches: Touches, values: Array) -> Array:
    """Means (m, ...) of `values` (n, ...), a row of the recording each, at each rest."""
    return np.array([values[rows].mean(axis=0) for rows in resting(recording, touches)])


def enough(touches: Touches, fewest: int, what: str, block: Block | None = None) -> Touches:
    """Touches without those of references of a `block`; `what` they are for, in the message.

    Raises CalibrationError if they are of fewer dimples, or fewer shots.
    """
    if not isinstance(touches, Touches):
        raise CalibrationError(other_kind(touches, "Touches", "read_touches(path) gives them"))
    references = block.references if block else {}
    if (different := len({*touches.dimple} - {*references})) < fewest:
        raise CalibrationError(
            f"{touches.source}: {different} different dimples; to {what} it takes {fewest} or more"
        )
    return touches.among(references, are_in=False)


def tip_rows(
    calibration: Calibration, recording: Recording, touches: Touches, block: Block, *,
    touch_sd: float = TOUCH_SD, joint_sd: Array | None = None,
) -> TipRows:  # fmt: skip
    """Rows of touches with corrected positions, in an offset a joint.

    `touch_sd` [m] is the standard deviation of a tip from its dimple, per axis; `joint_sd`
    (n_joints,) [rad or m] is what the calibration leaves of each joint, by default the errors of
    its training. Raises CalibrationError if columns are missing, or touches and recording do not go
    together.
    """
    if calibration.effort_baseline is None:
        raise CalibrationError(
            f"{calibration.title}: the model does not say how large its errors are; make it again"
        )
    robot, n, joint = recording.robot, len(calibration.joints), measured_joints(recording)
    if joint_sd is None or len(joint_sd) != n:
        joint_sd = calibration.effort_baseline.residual
    joint[:, robot.index(calibration.joints)] = calibration.correct(recording)
    return TipRows.of(
        robot, at_rest(recording, touches, joint), calibration.joints,
        np.tile(np.eye(n), (len(touches), 1, 1)), block.at(touches.dimple), touch_sd, joint_sd,
    )  # fmt: skip


def find_block(
    calibration: Calibration, recording: Recording, touches: Touches, block: Block, *,
    touch_sd: float = TOUCH_SD,
) -> tuple[BlockPose, TipFit]:  # fmt: skip
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
    working = enough(touches, FEWEST_OF_BLOCK, "find a block's pose", block)
    block.check_robot(recording.robot)
    rows = tip_rows(calibration, recording, touches, block, touch_sd=touch_sd)
    dimple = np.array(touches.dimple)
    fit = fit_block(rows.rows(np.isin(dimple, working.dimple)), block)
    if words := _misfit(fit):
        raise CalibrationError(f"{working.source}: {words}")
    robot, state, k = recording.robot, fit.state, len(fit.state.coefficients)
    found = rows.point + rows.residual(state) / state.scale
    known = [name for name in dict.fromkeys(touches.dimple) if name in block.references]
    references = {name: found[dimple == name].mean(axis=0) for name in known}
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
    (prior,) = terms_priors(rows, block, [TermsPrior(held, held)])
    loose = accuracy.fit_loosely(replace(rows, joint_sd=_ENLARGED * rows.joint_sd), prior)
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
    calibration: Calibration, recording: Recording, touches: Touches, pose: BlockPose, *,
    touch_sd: float = TOUCH_SD,
) -> tuple[Zero, TipFit]:  # fmt: skip
    """Zero of a calibration by touches, for `Calibration.at`, and the fit that it is of.

    An offset of each joint is fitted to touches of a block whose pose is known, with its own
    uncertainty. Errors that the calibration leaves of each joint, by the touches of the pose, count
    by their effect on the tip. The baselines move by the same offset.

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
    enough(touches, FEWEST, "re-zero")
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
                f"{shown(float(moved[k]), joint.unit)}, more than a homing does; {_OTHERWISE}"
            )
        rezeroed = rezeroed.shifted(moved)
        # Outputs whose inputs are moved go about as far, but not just as far.
        if rezeroed.moves is None or (np.abs(moved) < 0.1 * fit.sd[: len(moved)]).all():
            break
    offset = rezeroed.offset - before
    move = _unnoticed_move(fit, pose, touches, offset)
    loose = zero_prior(pose, _loose(rows, homing), move)
    sd, origin = fit_rows(rows, loose, start=fit.state).sd[: len(offset)], recording.provenance
    # Touches that fit worse than stated, as of a block that has moved, tell less (Birge, 1932).
    sd *= math.sqrt(max(1.0, fit.misfit / max(fit.freedom, 1)))
    zero = Zero(
        offset, sd, source="touch", file=origin.source, homing_id=origin.homing_id,
        rows=len(touches), duration=touches.t[-1] - touches.t[0],
        baselines=dict.fromkeys(rezeroed.fitted_baselines, offset),
        details={
            "block": pose.title,
            "left_out": [touches.dimple[i] for i in np.flatnonzero(fit.left_out)],
            "unnoticed_move": float(np.sqrt(np.trace(move[3:, 3:]))),
        },
    )  # fmt: skip
    return zero, fit


def _fit_bolted(rows: TipRows, pose: BlockPose, touches: Touches, homing: Array) -> TipFit:
    """Fit offsets to touches of a bolted block; refuse them, by name, if it has moved."""
    point, since = pose.scale * rows.point.mean(axis=0), np.repeat(np.square(_MOVED), 3)
    still = zero_prior(pose, homing)

    def words(fit: TipFit) -> str:
        now, then = (at.rotation @ point + at.translation for at in (fit.state, pose))
        return _has_moved(now - then)

    working = ~np.isin(touches.dimple, list(pose.block.references))
    against = [] if working.all() else [("against its references", working)]
    trials = chain(
        [Trial(rows, zero_prior(pose, homing, np.diag(since)), words)],
        accuracy.renumbered(rows, pose.block, touches.dimple, lambda _: still),
        accuracy.moved(rows, still, "the block", against),
    )
    try:
        fit = fit_rows(rows, zero_prior(pose, _loose(rows, homing)))
        trouble = _misfit(fit)
    except CalibrationError as error:
        trouble = str(error)
    accuracy.check_faults(touches.source, rows, still, trials, np.arange(len(rows)), trouble)
    return fit


def _loose(rows: TipRows, homing: Array) -> Array:
    """Deviations (n,) of offsets that only touches tell; a homing's, where the tip hardly moves."""
    moves = rows.kinematics.jacobian(rows.joint)[:, :3, list(rows.columns)] * homing
    far = np.sqrt((moves**2).sum(axis=1).mean(axis=0))
    return np.where(far > rows.point_sd, np.inf, homing)


def _has_moved(step: Array, against: str = "") -> str:
    far = with_unit(float(np.linalg.norm(step)), "m")
    return (
        f"when the block has moved by {far}{against} since its pose was found: bolt it down, and "
        "find its pose anew with a fresh calibration"
    )


def _unnoticed_move(fit: TipFit, pose: BlockPose, touches: Touches, offset: Array) -> Array:
    """Covariance (6, 6) of a move of the block that would pass for a homing by `offset` (n,).

    Half a millimetre, and as far as the offset moves the tip, in any direction: a homing and a
    move may cancel. Touched references say less. Refuses a block that has moved against them.
    """
    equations = fit.rows.equations(fit.state)
    way = (equations.by_joint[:, :, list(fit.rows.columns)] @ offset).mean(axis=0)
    seen = np.eye(3) * (_UNNOTICED[1] ** 2 + float(way @ way))
    still = np.isin(touches.dimple, list(pose.block.references))
    if still.any() and not still.all():
        # The references' own places were found by as many touches.
        (*_, own), (off, information, _) = (accuracy.shift_of(fit, k) for k in (still, ~still))
        spread = np.linalg.inv(information) + np.linalg.inv(own)
        if off @ np.linalg.solve(spread, off) > _MOVES:
            words = _has_moved(off, " against its references")
            raise CalibrationError(f"{touches.source}: the points fit only {words}")
        seen = np.linalg.inv(np.linalg.inv(spread) + np.linalg.inv(seen))
    share = np.trace(seen) / (3.0 * _UNNOTICED[1] ** 2)
    covariance = np.diag(np.repeat([share * _UNNOTICED[0] ** 2, 0.0], 3))
    covariance[3:, 3:] = pose.rotation @ seen @ pose.rotation.T
    return covariance


def check_pose(calibration: Calibration, pose: BlockPose) -> None:
    """Refuse a block's pose in another arm's base, or one that another calibration found."""
    if (calibration.robot, calibration.arm) != (pose.robot, pose.arm):
        raise CalibrationError(
            f"the model is of {calibration.title}, the pose {pose.title}; find it with this model"
        )
    if pose.model_sha256 not in ("", str(calibration.metadata.get("data_sha256", ""))):
        raise CalibrationError(
            f"the pose of {pose.title} was found with another calibration; find it with this "
            "model, on the day of its full calibration"
        )


def _misfit(fit: TipFit) -> str:
    """Say how far residuals are beyond what touches and model leave; empty if they are not."""
    if fit.misfit <= _MISFIT * max(fit.freedom, 1):
        return ""
    rms = np.sqrt((fit.residual[~fit.left_out] ** 2).sum(axis=1).mean())
    return f"the touches stay {1e3 * rms:.2f} mm off whatever the zero; {_OTHERWISE}"


def fewest_touches(prior: Calibration | None) -> int:
    """Different touches that it takes at least to calibrate an arm with such a prior."""
    return _CALIBRATING // 2 if prior else _CALIBRATING


@dataclass(frozen=True, eq=False)
class TouchReport:
    """Result of a fit of touches: statement, metadata and page of a calibration are made of it.

    Attributes
    ----------
    touches : Touches
    block : Block
    terms : Terms
    fit : TipFit
    tip, workspace : TipError
        Error of the tip [m] in the block's frame, near the touches and over the workspace, by what
        the fit leaves open and what joints keep.
    reach : float
        Share of the workspace that lies amid the touches.
    place : ndarray of int, shape (m,)
        Repeats of one place share a number.
    stated_noise : float
        Per axis [m].
    prior : Calibration, optional
    is_learned : bool
        Whether the touches are likeliest under that.
    doubt : str
        Fault with which the points fit better, in words; empty without one.

    Examples
    --------
    >>> TouchReport.__dataclass_fields__["stated_noise"].type
    <class 'float'>
    """

    touches: Touches
    block: Block
    terms: Terms
    fit: TipFit
    tip: TipError
    workspace: TipError
    reach: float
    place: Integers
    stated_noise: float
    prior: Calibration | None
    is_learned: bool
    doubt: str

    @cached_property
    def before(self) -> Array:
        """Errors (m, 3) [m] of the tip as measured, with the block laid over it at its best."""
        fit, point = self.fit, self.fit.rows.point * self.block.scale
        tip = fit.rows.kinematics.forward(fit.rows.joint)[:, :3, 3]
        turn, shift = align(tip[~fit.left_out], point[~fit.left_out])
        return np.asarray((tip - shift) @ turn - point)

    @cached_property
    def left_out(self) -> Array:
        """Error (m, 3) [m] of each touch by a fit without it, its repeats and a few others."""
        fit, rows, inlier = self.fit, self.fit.rows, ~self.fit.left_out
        fold = np.full(len(rows), _FOLDS)
        fold[inlier] = np.unique(self.place[inlier], return_inverse=True)[1] % _FOLDS
        errors = fit.residual.copy()
        for number in range(_FOLDS):
            train = rows.rows(inlier & (fold != number))
            other = fit_rows(train, fit.prior, gate=np.inf, start=fit.state)
            errors[fold == number] = rows.residual(other.state)[fold == number]
        return errors

    @property
    def left_out_rms(self) -> float:
        """RMS of `left_out` without outliers [m]; the points' own noise is in it."""
        return float(np.sqrt((self.left_out[~self.fit.left_out] ** 2).sum(axis=1).mean()))

    @property
    def is_measured(self) -> bool:
        """Whether repeats measured the noise; else what was stated and residuals bound it."""
        return accuracy.repeat_noise(self.fit, self.place)[1] >= _MEASURED

    @property
    def zero_sd(self) -> Array:
        """Standard deviations (n_joints,) of the zeros amid the workspace [rad or m]."""
        return self.fit.sd[self.terms.zeros] * self.terms.scale

    @property
    def statement(self) -> tuple[str, str, str]:
        """How far off the tip is, for a person: the raw error first."""
        raw, noise = with_unit(self.left_out_rms, "m"), with_unit(self.fit.rows.point_sd, "m")
        near = f"{with_unit(self.tip.rms, 'm')} ± {with_unit(self.tip.sd, 'm')}"
        second = f"the tip is {near} off near the touches (noise {noise} per axis, by repeats)"
        if not self.is_measured:
            stated = with_unit(math.sqrt(3.0) * self.stated_noise, "m")
            second = (
                f"the tip is at most {raw} off near the touches, of which the noise that you "
                f"stated may be {stated}; by what the fit leaves open {near}"
            )
        far = with_unit(self.workspace.rms, "m")
        return (
            f"points left out in turn are {raw} off (RMS), their own noise in it",
            second,
            f"over the workspace, {self.reach:.0%} of which lies amid the touches, {far}",
        )

    @property
    def not_seen(self) -> tuple[str, ...]:
        """In words, what only the prior holds, and how far off it may be."""
        fit, block, zeros, words = self.fit, self.block, self.terms.zeros, list[str]()
        before = np.diag(fit.prior.precision)[zeros] ** -0.5
        for name, sd, prior_sd, scale in zip(
            self.terms.joints, fit.sd[zeros], before, self.terms.scale, strict=True
        ):
            unit = "rad" if scale == SPREAD["rad"] else "m"
            within = with_unit(float(sd * scale), unit)
            if sd > _SEEN * prior_sd:
                words.append(f"zero of {name}: not seen, assumed within {within}")
            elif sd > _UNSURE:
                words.append(f"zero of {name}: ± {within}")
        size = float(np.sqrt(fit.rows.point.var(axis=0).sum()))
        if block.scale_sd * size > _WORTH:  # nobody has measured it
            size_sd = float(fit.sd[fit.state.names.index(SCALE)])
            share, far = fit.state.scale / block.scale - 1.0, with_unit(size_sd * size, "m")
            size_text = f"{100 * share:+.2f} % ± {100 * size_sd:.2f} %"
            if size_sd > _SIZED * block.scale_sd:
                size_text = f"not seen, assumed within {100 * size_sd:.1f} %"
            size_text += f", which is {far} of the tip: measure it, and enter measured_mm"
            words.append(f"size of the print: {size_text}")
        elif not self.is_learned:
            what, far = "print" if block.robot else "frame", with_unit(0.01 * size, "m")
            size_text = f"not seen, taken as stated; 1 % of it is {far} of the tip"
            words.append(f"size of the {what}: {size_text}")
        words += [*self._marker(), *filter(None, [self.doubt])]
        noise = fit.rows.point_sd
        if not 1.0 / _ODD < noise / self.stated_noise < _ODD:
            residual, stated = (with_unit(sd, "m") for sd in (noise, self.stated_noise))
            words.append(f"noise: the residuals say {residual} per axis, not {stated} as stated")
        if self.prior and not self.is_learned:
            words.append("the prior: the touches are likelier without it, so it was not used")
        return tuple(words)

    def _marker(self) -> Iterator[str]:
        fit = self.fit
        at = [fit.state.names.index(name) for name in MARKER]
        held = np.delete(fit.rows.joint, fit.rows.columns, axis=1)
        if fit.prior.free[at].all():
            place = ", ".join(f"{1e3 * x:.1f}" for x in fit.state.marker)
            sd = with_unit(float(fit.sd[at].max()), "m")
            yield f"the points: of ({place}) mm off the tip in the tool's frame, ± {sd}"
        elif not self.block.robot and (np.ptp(held, axis=0) < _STILL).all():
            yield "the marker: whether it sits at the tip is not seen: roll and wrist stand still"

    @property
    def metadata(self) -> dict[str, Any]:
        """Values that a calibration keeps of it, for JSON."""
        state, rows = self.fit.state, self.fit.rows
        left_out = [self.touches.dimple[i] for i in np.flatnonzero(self.fit.left_out)]
        return {
            "touches": len(self.touches), "left_out": left_out, "left_out_rms": self.left_out_rms,
            "prior": [self.prior.title] if self.prior and self.is_learned else [],
            "tip_error": self.tip.rms, "tip_error_sd": self.tip.sd,
            "tip_error_workspace": self.workspace.rms, "reach": self.reach,
            "noise": rows.point_sd, "noise_is_measured": self.is_measured,
            "zero_sd": self.zero_sd.tolist(), "joint_sd": rows.corrected_sd.tolist(),
            "scale": state.scale, "marker": state.marker.tolist(),
            "rotation": state.rotation.tolist(), "translation": state.translation.tolist(),
            "not_seen": list(self.not_seen),
        }  # fmt: skip


def calibrate_by_touch(
    recording: Recording, touches: Touches, block: Block, *,
    touch_sd: float = TOUCH_SD, prior: Calibration | None = None,
) -> tuple[Calibration, TouchReport]:  # fmt: skip
    """Fit joints and a block's pose together to touches of its dimples.

    Each positioning joint gets a constant, slopes and squares of all of them, and its plays:
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
    touches = enough(touches, fewest_touches(prior), "calibrate", block)
    block.check_robot(recording.robot)
    terms = Terms.of_workspace(recording.robot)
    shared, plays = terms.columns_of(recording)
    _check_spread(touches, block, terms, at_rest(recording, touches, plays), prior)
    report = fit_terms(recording, touches, block, terms, (shared, plays), prior, touch_sd)
    fit, joints = report.fit, terms.joints
    truth = recording.columns("measured", joints)
    truth = truth + terms.basis(shared, plays) @ fit.state.coefficients
    columns = dict(zip((f"truth/{joint}" for joint in joints), truth.T, strict=True))
    whole = Recording.from_columns(
        {**recording.table, **columns}, recording.provenance, recording.units, robot=recording.robot
    )
    # Domain, units and baselines are fitted; the touches alone give the model.
    fitted = calibrate([whole], "linear", features=terms.features, joints=joints, redundant=[])
    data = EstimatorData("polynomial", of_degree(2), terms.arrays(fit.state.coefficients))
    model = Polynomial.from_data(data, len(terms.features), len(joints))
    baseline = fitted.effort_baseline
    if baseline is not None:
        baseline = replace(baseline, residual=np.hypot(fit.rows.corrected_sd, report.zero_sd))
    origin = replace(fitted.origin, estimator=model.name)
    made = replace(fitted, fitted=data, learnt=None, effort_baseline=baseline, origin=origin)
    settings = " ".join(repr(model).split())
    made = made.with_metadata(settings=settings, truth="touch", touch=report.metadata)
    return made, report


def fit_terms(
    recording: Recording, touches: Touches, block: Block, terms: Terms,
    columns: tuple[Array, Array], prior: Calibration | None, touch_sd: float = TOUCH_SD,
) -> TouchReport:  # fmt: skip
    """Fit terms and a block's pose to touches, under the likeliest prior.

    `columns` are the terms', of the recording. The points themselves choose the prior, the errors
    that joints keep, what a touch errs (empirical Bayes), and whether they are of another place
    than the tip. Raises as `fit_rows` and `resting`, and CalibrationError for a prior of another
    arm, and for points that fit only if mirrored, scaled, moved or renumbered, which is named.
    """
    robot = recording.robot
    rows = TipRows.of(
        robot, at_rest(recording, touches, measured_joints(recording)), terms.joints,
        at_rest(recording, touches, terms.basis(*columns)),
        block.at(touches.dimple), touch_sd, LEFT * terms.scale,
    )  # fmt: skip
    place = accuracy.repeated(rows, at_rest(recording, touches, columns[1]))
    learned = learned_priors(terms, prior, recording) if prior else []
    expected = [*learned, *wide_priors(terms)]
    widest, is_learned, is_odd = len(learned), False, True
    marker = accuracy.marker_sd(rows, terms_priors(rows, block, expected)[widest], place)
    candidates = terms_priors(rows, block, expected, marker)
    try:
        fit = accuracy.fit_loosely(rows, candidates[widest])
        for _ in range(_SPLITS):
            best = accuracy.likeliest(fit, candidates)
            prior_of_terms = candidates[best]
            for _ in range(_ROUNDS):
                fit = fit_rows(fit.rows, prior_of_terms, start=fit.state)
                prior_of_terms = accuracy.heavy_tailed(fit, candidates[best], terms.kinds)
            splits = accuracy.split_residuals(fit, rows, place)
            fit = accuracy.refitted(fit, rows, splits)
    except CalibrationError as error:
        trouble, likely = str(error), expected[widest]
    else:
        is_learned = best < widest
        likely = expected[best if is_learned else widest]
        trouble = _steep_slope(fit, terms, likely)
        is_odd = bool(trouble) or fit.rows.point_sd > _ODD * touch_sd

    def prior_of(each: TipRows) -> TipPrior:
        return terms_priors(each, block, [likely], marker)[0]

    known = prior_of(rows)
    what, advice = "the tracker", "check the tracker"
    if block.robot:
        what, advice = "the block", "measure the print and enter measured_mm"
    at = np.arange(len(rows))
    cuts = at[accuracy.EDGE : len(rows) - accuracy.EDGE + 1]
    halves = [(f"after {touches.t[k]:.1f} s", at >= k) for k in cuts]
    trials = [*accuracy.moved(rows, known, what, halves)]
    if is_learned:  # what is expected tells the size
        trials.append(accuracy.scaled(rows, known, advice))
    if is_odd:
        trials.append(accuracy.mirrored(rows, block, prior_of))
    if is_odd and block.robot:
        trials += accuracy.renumbered(rows, block, touches.dimple, prior_of)
    doubt = accuracy.check_faults(touches.source, rows, known, trials, place, trouble)
    everywhere, reach = accuracy.over_workspace(fit, robot)
    near = np.repeat(fit.rows.joint[~fit.left_out], 4, axis=0)
    tip, far = (accuracy.tip_error(fit, splits, terms, joint) for joint in (near, everywhere))
    about = place, touch_sd, prior, is_learned, doubt
    return TouchReport(touches, block, terms, fit, tip, far, reach, *about)


def _steep_slope(fit: TipFit, terms: Terms, expected: TermsPrior) -> str:
    """Say which joint's own slope is away from 1 by more than its prior allows; empty if none."""
    diagonal = np.flatnonzero(np.array(terms.kinds) == "slope")[:: len(terms.joints) + 1]
    slopes, mean, sd = (a[diagonal] for a in (fit.state.coefficients, expected.mean, expected.sd))
    k = int(np.argmax(np.abs(slopes - mean) / sd))
    if abs(slopes[k] - mean[k]) < _STEEP * sd[k]:
        return ""
    slope, middle = (1.0 + terms.scale[k] / terms.half[k] * c[k] for c in (slopes, mean))
    reach = _STEEP * terms.scale[k] / terms.half[k] * sd[k]
    return (
        f"the slope of {terms.joints[k]} would be {slope:.2f}, where {middle - reach:.2f} to "
        f"{middle + reach:.2f} is allowed; are the points of this arm?"
    )


def terms_priors(
    rows: TipRows, block: Block, expected: Sequence[TermsPrior], marker: float = 0.0
) -> list[TipPrior]:
    """Priors of coefficients as each is `expected`, and of a block that may stand anywhere.

    What is seen may be so far off the tip, `marker` [m]. The fit starts where the tool, as it is
    measured, meets the points. Raises CalibrationError if they lie in a line.
    """
    tip = rows.kinematics.forward(rows.joint)[:, :3, 3]
    start = TipState(np.empty(0), *align(tip, rows.point * block.scale), scale=block.scale)
    return [
        TipPrior.of(replace(start, coefficients=mean), sd, scale=block.scale_sd, marker=marker)
        for mean, sd in expected
    ]


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
