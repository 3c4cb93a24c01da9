"""Touched dimples of a block: when, where the block stands, and what they calibrate."""

from __future__ import annotations

import csv
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

import numpy as np

from truejoint.array_types import Array, floats
from truejoint.calibration.calibration import Calibration
from truejoint.calibration.compatibility import check_columns, source_of
from truejoint.calibration.fit import calibrate
from truejoint.calibration.zero import Zero
from truejoint.errors import CalibrationError, other_kind
from truejoint.estimators.family import EstimatorData
from truejoint.estimators.polynomial.learn import Polynomial
from truejoint.estimators.polynomial.run import of_degree
from truejoint.features.feature_set import default_gap_limit
from truejoint.files import read_small
from truejoint.recordings import Recording
from truejoint.tip.block import TOUCH_SD, Block, BlockPose
from truejoint.tip.fit import SCALE, TipFit, TipPrior, TipRows, TipState, align, fit_rows
from truejoint.tip.terms import LEFT, SPREAD, Terms, check_priors, learned_priors, wide_priors
from truejoint.units import shown, with_unit

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


_CALIBRATING: Final = 12  # touches of an unknown arm; half as many with a prior
_FOLDS: Final = 6
_FLAT: Final = 0.05  # of the touches' extent, below which they lie in a plane
_SIDED: Final = 0.15  # of the touches that come from either side of each joint
_SEEN: Final = 0.5  # of the prior deviation, above which a zero was not seen
_SIZED: Final = 0.8  # the same of the size of a print
_WORTH: Final = 5e-5  # effect of an unmeasured print's size on the tip that is reported [m]
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
    fit = fit_block(rows, block)
    _check_misfit(fit, touches)
    robot, state = recording.robot, fit.state
    pose = BlockPose(
        block, robot.name, robot.arm, state.rotation, state.translation, fit.covariance[:6, :6],
        state.scale, float(fit.sd[9]), fit.rows.corrected_sd,
        datetime.now(UTC).isoformat(timespec="seconds"), recording.provenance.homing_id,
        str(calibration.metadata.get("data_sha256", "")),
    )  # fmt: skip
    return pose, fit


def fit_block(rows: TipRows, block: Block) -> TipFit:
    """Fit pose and size of a block to touches with known joints; raises as `fit_rows`.

    It takes three rows or more, of points that do not lie in a line. The errors that the joints
    keep are estimated too, as those of the training are smaller than those of another motion; the
    rows of the fit state them.
    """
    prior = terms_prior(rows, block, np.empty(0), np.empty(0))
    return fit_rows(with_estimated_errors(rows, prior), prior)


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
        for joint, offset in zip(calibration.joints, moved.tolist(), strict=True):
            unit = recording.robot.joint(joint).unit
            if abs(offset) > _FARTHEST[unit]:
                raise CalibrationError(
                    f"{touches.source}: the zero of {joint} would move by {shown(offset, unit)}, "
                    "more than a homing does; has the block moved since its pose was found, or is "
                    "the model of another arm?"
                )
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


def fewest_touches(priors: Sequence[Calibration]) -> int:
    """Different touches that it takes at least to calibrate an arm with such priors."""
    return _CALIBRATING // 2 if priors else _CALIBRATING


@dataclass(frozen=True, eq=False)
class TouchReport:
    """Accuracy of a calibration by touch, and what the touches did not show.

    Attributes
    ----------
    touches : Touches
    fit : TipFit
    left_out_error : float
        RMS distance [m] of the tip, in the block's frame, from points that a fit without them
        expects, less the touches' own noise: the cross-validated error.
    left_out_sd : float
        Standard deviation of that [m].
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
    left_out_error: float
    left_out_sd: float
    zero_sd: Array
    not_seen: tuple[str, ...]
    point: Array
    before: Array
    left_out: Array


def calibrate_by_touch(
    recording: Recording,
    touches: Touches,
    block: Block,
    *,
    touch_sd: float = TOUCH_SD,
    priors: Sequence[Calibration] = (),
) -> tuple[Calibration, TouchReport]:
    """Fit joints and a block's pose together to touches of its dimples.

    Of each positioning joint a constant, slopes and squares of all of them, and plays of its own:
    with three joints 39 numbers. The tip is then right in the block's frame, and joints as far as
    `TouchReport.not_seen` leaves them. The prior of the terms is the one under which the touches
    are likeliest, among wide ones and those that other calibrations give.

    Parameters
    ----------
    recording : Recording
        Continuous, from before the first touch on: plays need to know where a joint came from.
    touches : Touches
    block : Block
    touch_sd : float
        Standard deviation of a tip from its dimple, per axis [m].
    priors : sequence of Calibration
        An older one of this arm, or three or more of other arms of the robot, as a prior.

    Returns
    -------
    calibration : Calibration
        An ordinary one, of a polynomial of degree 2, without an interval; its metadata have
        ``truth`` ``"touch"`` and what `TouchReport` says.
    report : TouchReport

    Raises
    ------
    CalibrationError
        If kinematics or workspace are not known, touches are fewer than twelve (with a prior, six),
        lie in a plane and there is no prior, come from one side, or do not fit, or the prior is of
        another robot or of two arms.

    Examples
    --------
    >>> calibrate_by_touch(test, Touches((1.0,), ("1",)), None)
    Traceback (most recent call last):
    truejoint.errors.CalibrationError: ...
    """
    check_count(touches, fewest_touches(priors), "calibrate")
    terms = Terms.of_workspace(recording.robot)
    features = features_of(recording, terms)
    _check_spread(recording, touches, block, terms, features, is_flat_fine=bool(priors))
    fit, is_learned = fit_terms(recording, touches, block, terms, features, priors, touch_sd)
    unused = ["the prior: the touches are likelier without it, so it was not used"]
    report = _report(touches, block, fit, terms, unused if priors and not is_learned else [])
    state, corrected_sd = fit.state, fit.rows.corrected_sd
    correction = terms.basis(*terms.columns(features)) @ state.coefficients
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
            "prior": [prior.title for prior in priors] if is_learned else [],
            "left_out": [touches.dimple[i] for i in np.flatnonzero(fit.left_out)],
            "left_out_error": report.left_out_error,
            "left_out_sd": report.left_out_sd,
            "zero_sd": report.zero_sd.tolist(),
            "joint_sd": corrected_sd.tolist(),
            "scale": state.scale,
            "rotation": state.rotation.tolist(),
            "translation": state.translation.tolist(),
            "not_seen": list(report.not_seen),
        },
    )
    return calibration, report


def features_of(recording: Recording, terms: Terms) -> Array:
    """Features (n, k) of the terms; raises CalibrationError where columns are missing."""
    names = recording.robot.joint_names
    check_columns(recording, [f"measured/{n}" for n in names], "tip's place takes")
    return terms.features.compute(recording, default_gap_limit([recording]))


def fit_terms(
    recording: Recording,
    touches: Touches,
    block: Block,
    terms: Terms,
    features: Array,
    priors: Sequence[Calibration],
    touch_sd: float = TOUCH_SD,
) -> tuple[TipFit, bool]:
    """Fit terms and a block's pose to touches, under the likeliest prior.

    Also says whether that prior is of other calibrations.

    `features` (n, k) are the terms', of the recording. The points themselves choose the prior and
    the errors that joints keep (empirical Bayes). Raises as `fit_rows` and `resting`, and
    CalibrationError for a prior of another robot or arm.
    """
    robot = recording.robot
    check_priors(priors, robot)
    measured = recording.columns("measured", robot.joint_names)
    rows = TipRows.of(
        robot, at_rest(recording, touches, measured), terms.joints,
        at_rest(recording, touches, terms.basis(*terms.columns(features))),
        block.at(touches.dimple), touch_sd, LEFT * terms.scale,
    )  # fmt: skip
    learned = learned_priors(terms, priors, recording) if priors else []
    candidates = [terms_prior(rows, block, *each) for each in [*learned, *wide_priors(terms)]]
    first = fit_rows(rows, candidates[len(learned)])
    best = int(np.argmax([likelihood(rows, prior, first) for prior in candidates]))
    rows = with_estimated_errors(rows, candidates[best])
    return fit_rows(rows, candidates[best], start=first.state), best < len(learned)


def terms_prior(rows: TipRows, block: Block, mean: Array, sd: Array) -> TipPrior:
    """Prior of coefficients, `mean` and `sd` (k,), and of a block that may stand anywhere.

    The fit starts where the tool, as it is measured, meets the points. Raises CalibrationError if
    they lie in a line.
    """
    tip = rows.kinematics.forward(rows.joint)[:, :3, 3]
    start = TipState(mean, *align(tip, rows.point * block.scale), scale=block.scale)
    return TipPrior.of(start, sd, scale=block.scale_sd)


def _check_spread(
    recording: Recording,
    touches: Touches,
    block: Block,
    terms: Terms,
    features: Array,
    *,
    is_flat_fine: bool,
) -> None:
    """Refuse touches in one plane, unless `is_flat_fine`, and those that come from one side."""
    source, point = touches.source, block.at(touches.dimple)
    plays = terms.columns(at_rest(recording, touches, features))[1]
    extent = np.linalg.svd(point - point.mean(axis=0), compute_uv=False)
    if extent[2] < _FLAT * extent[0] and not is_flat_fine:
        raise CalibrationError(
            f"{source}: all touches lie in one plane, which leaves slopes and a turn open; "
            "touch stairs (truejoint touch block), or give a prior (--prior)"
        )
    for joint, rising in zip(terms.joints, (plays < 0.0).mean(axis=(0, 2)), strict=True):
        if not _SIDED <= rising <= 1.0 - _SIDED:
            raise CalibrationError(
                f"{source}: {joint} comes from one side in {max(rising, 1 - rising):.0%} of the "
                "touches, which hides what its cable loses; come from both"
            )


def _report(
    touches: Touches, block: Block, fit: TipFit, terms: Terms, unused: Sequence[str]
) -> TouchReport:
    rows, off, inlier = fit.rows, _held_out_errors(fit), ~fit.left_out
    squares = (off[inlier] ** 2).sum(axis=1)
    error = math.sqrt(max(float(squares.mean()) - 3.0 * rows.point_sd**2, 0.0))
    spread = float(squares.std(ddof=1)) / math.sqrt(len(squares))
    error_sd = spread / (2.0 * max(error, math.sqrt(spread)))
    uncorrected = replace(fit.state, coefficients=np.zeros(len(fit.state.coefficients)))
    tip = rows.tool_points(uncorrected)[1]
    turn, shift = align(tip[inlier], rows.point[inlier] * block.scale)
    zero_sd = fit.sd[terms.zeros] * terms.scale
    before = (tip - shift) @ turn - rows.point * block.scale
    not_seen = (*_unseen(block, fit, terms), *unused)
    return TouchReport(touches, fit, error, error_sd, zero_sd, not_seen, rows.point, before, off)


def _held_out_errors(fit: TipFit) -> Array:
    """Error of each touch (m, 3) [m] by a fit without it and a few others."""
    rows, inlier = fit.rows, ~fit.left_out
    fold = np.full(len(rows), _FOLDS)
    fold[inlier] = np.arange(inlier.sum()) % _FOLDS
    errors = fit.residual.copy()
    for number in range(_FOLDS):
        train = rows.rows(inlier & (fold != number))
        other = fit_rows(train, fit.prior, gate=np.inf, start=fit.state)
        errors[fold == number] = rows.residual(other.state)[fold == number]
    return errors


def _unseen(block: Block, fit: TipFit, terms: Terms) -> list[str]:
    """Say in words what the touches did not show, and how far off it may be."""
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
    return words
