"""Touched dimples of a block: find where the block stands, and re-zero a calibration by it."""

from __future__ import annotations

import csv
import os
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from truejoint.array_types import Array, floats
from truejoint.calibration.compatibility import check_columns, source_of
from truejoint.calibration.zero import moved
from truejoint.errors import CalibrationError, other_kind
from truejoint.files import read_small
from truejoint.robots.parts import Kinematics
from truejoint.robots.robot import Robot
from truejoint.tip.plate import TOUCH_SD, BlockPose, Plate
from truejoint.tip.tip_rows import TipFit, TipPrior, TipRows, TipState, align, fit_tip
from truejoint.units import shown

if TYPE_CHECKING:
    from truejoint.calibration.calibration import Calibration
    from truejoint.recordings import Recording

REST: Final = 0.3
"""Time before a touch's stamp over which positions are averaged [s]."""
FEWEST: Final = 3
"""Touches that re-zero a calibration."""
FEWEST_OF_BLOCK: Final = 2 * FEWEST
"""Touches that find a block's pose."""
_SLACK: Final = 5e-4
"""How far positions may stray within `REST` of a touch [rad, and a tenth of it in m]."""
_MISFIT: Final = 3.0
"""Squares of residuals, as a multiple of what is expected, beyond which nothing fits. Where block,
arm and day are right they stay below two on ten arms whose errors are 2.5 times as stated."""
_FARTHEST: Final = {"rad": np.deg2rad(3.0), "m": 3e-3}
"""What no homing moves a zero by; a block that has moved may look like one that does."""
_FACTORS: Final = (1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0)
"""By which errors of another motion are larger than the training's."""
_MAX_BYTES: Final = 1 << 20
_ROUNDS: Final = 5  # of moving the inputs of a model until its output fits


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
        File that says so.
    kind : str
        What is counted, for a person: ``dimple``, or ``shot`` of a tracker.

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
    kind: str = "dimple"

    def __post_init__(self) -> None:
        t = floats(self.t, f"{self.source}: times", CalibrationError)
        if not t.size or t.shape != (len(self.dimple),):
            raise CalibrationError(
                f"{self.source}: no {self.kind}s; write a line for each: a time and a name"
            )
        if not (np.isfinite(t).all() and (np.diff(t) > 0.0).all()):
            raise CalibrationError(f"{self.source}: the times must go up")

    def __len__(self) -> int:
        return len(self.t)

    @property
    def doubt(self) -> str:
        """What may be wrong with one that does not fit, for a person."""
        if self.kind == "dimple":
            return "badly seated, or another number?"
        return "moved meanwhile, or another marker?"


def read_touches(path: str | os.PathLike[str]) -> Touches:
    r"""Touches of a CSV file with a header: ``t`` [s], ``dimple`` and whatever else.

    Raises CalibrationError naming line and value.

    Examples
    --------
    >>> _ = Path("touches.csv").write_text("t,dimple\n4.0,3\n9.5,17\n")
    >>> read_touches(Path("touches.csv")).dimple
    ('3', '17')
    """
    t: list[float] = []
    dimple: list[str] = []
    columns, want = ("t", "dimple"), "a time [s] and a dimple"
    for stamp, number in read_rows(Path(path), columns, "touches", want, 1):
        t.append(float(stamp))
        dimple.append(number)
    return Touches(tuple(t), tuple(dimple), str(path))


def read_rows(
    path: Path, names: tuple[str, ...], what: str, want: str, numbers: int | None = None
) -> list[tuple[str, ...]]:
    """Columns of a CSV file by name, a row each: `what` it holds, and what a line is to give.

    The first `numbers` of them are numbers, by default all. Raises CalibrationError naming line and
    value.
    """
    text = read_small(path, CalibrationError, _MAX_BYTES, what).decode("utf-8", "replace")
    try:
        rows = list(csv.reader(text.splitlines()))
    except csv.Error as error:  # a file of something else: a field of 100 kB
        raise CalibrationError(f"{path}: is no CSV file of {what} ({error})") from None
    header = [name.strip() for name in rows[0]] if rows else []
    if not set(names) <= set(header):
        listed = ",".join(names)
        raise CalibrationError(f"{path}: its first line names {header!r:.60}; want {listed}")
    found = []
    for number, row in enumerate(rows[1:], 2):
        fields = dict(zip(header, row, strict=False))
        try:
            values = tuple(fields[name].strip() for name in names) if row else ()
            [float(value) for value in values[:numbers]]
        except (KeyError, ValueError):
            raise CalibrationError(
                f"{path}, line {number}: {','.join(row)!r:.60}; want {want}"
            ) from None
        found += [values] if row else []
    return found


def resting(recording: Recording, touches: Touches) -> list[slice]:
    """Rows of a recording in which the tip rests, of each touch.

    Raises CalibrationError if there is no row, or the arm moves.
    """
    stamps, found = np.array(recording.t), []
    joints = [j for j in recording.robot.positioning if f"measured/{j}" in recording.units]
    measured = recording.columns("measured", joints)
    slack = [_SLACK * (1.0 if recording.robot.joint(j).unit == "rad" else 0.1) for j in joints]
    for t, dimple in zip(touches.t, touches.dimple, strict=True):
        first, last = np.searchsorted(stamps, [t - REST, t], side="right")
        if last - first < 2:
            raise CalibrationError(
                f"{touches.source}: {touches.kind} {dimple} is of {t:g} s, but "
                f"{source_of(recording)} runs from {stamps[0]:.1f} to {stamps[-1]:.1f} s with "
                f"{last - first} rows there; is it their recording?"
            )
        span = np.ptp(measured[first:last], axis=0)
        if (span > slack).any():
            k = int(np.argmax(span / slack))
            way = shown(float(span[k]), recording.robot.joint(joints[k]).unit)
            raise CalibrationError(
                f"{touches.source}: {joints[k]} moves by {way} while {touches.kind} {dimple} is "
                f"taken, at {t:g} s; rest for {REST:g} s before the stamp"
            )
        found.append(slice(int(first), int(last)))
    return found


def tip_rows(
    calibration: Calibration,
    recording: Recording,
    touches: Touches,
    plate: Plate,
    *,
    touch_sd: float = TOUCH_SD,
    offsets: bool = True,
) -> TipRows:
    """Rows of touches with corrected positions, in an offset a joint, or in none.

    `touch_sd` [m] is how far off its dimple a tip rests, per axis. Raises CalibrationError if the
    robot's kinematics are not known, columns are missing, or touches and recording do not go
    together.
    """
    if not (np.isfinite(touch_sd) and touch_sd > 0.0):
        raise CalibrationError(f"touches rest within {touch_sd} m; give a number above 0")
    if calibration.effort_baseline is None:
        raise CalibrationError(
            f"the calibration of {calibration.title} does not say how large its errors are; "
            "calibrate it again"
        )
    kinematics, robot = known_kinematics(recording.robot), recording.robot
    check_columns(recording, [f"measured/{n}" for n in robot.joint_names], "tip's place takes")
    joint = recording.columns("measured", robot.joint_names)
    columns = tuple(robot.index(calibration.joints))
    joint[:, columns] = calibration.correct(recording)
    place = np.array([joint[rows].mean(axis=0) for rows in resting(recording, touches)])
    m, n = len(touches), len(columns)
    basis = np.tile(np.eye(n), (m, 1, 1)) if offsets else np.zeros((m, n, 0))
    residual = calibration.effort_baseline.residual
    spread = np.full(m, touch_sd)
    return TipRows(
        kinematics, place, columns, basis, plate.at(touches.dimple), spread, np.array(residual)
    )


def find_block(
    calibration: Calibration,
    recording: Recording,
    touches: Touches,
    plate: Plate,
    *,
    touch_sd: float = TOUCH_SD,
) -> tuple[BlockPose, TipFit]:
    """Find where a bolted block stands, by touches on the day of the full calibration.

    The size of the print is found with it, from what the calliper says. Gives the pose, and the
    fit that says which touches were left out.

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
    rows = tip_rows(calibration, recording, touches, plate, touch_sd=touch_sd, offsets=False)
    found, rows = fit_block(rows, plate)
    _check_misfit(found, touches)
    sha = str(calibration.metadata.get("data_sha256", ""))
    robot = recording.robot
    pose = BlockPose(
        plate, robot.name, robot.arm, found.state.rotation, found.state.translation,
        found.covariance[:6, :6], found.state.scale, float(found.sd[9]), rows.joint_sd,
        datetime.now(UTC).isoformat(timespec="seconds"), recording.provenance.homing_id, sha,
    )  # fmt: skip
    return pose, found


def fit_block(rows: TipRows, plate: Plate) -> tuple[TipFit, TipRows]:
    """Fit pose and size of a block to touches with known joints, a row each; raises as `fit_tip`.

    Three rows or more, of points that do not lie in a line. What the joints keep of their errors
    is estimated too: those of the training are smaller than those of another motion. The rows that
    are given back say it.
    """
    tip = rows.kinematics.forward(rows.joint)[:, :3, 3]
    rotation, translation = align(tip, rows.point * plate.scale)
    start = TipState(np.zeros(rows.basis.shape[2]), rotation, translation, scale=plate.scale)
    held = [0.0] * rows.basis.shape[2]
    prior = TipPrior.of(start, [*held, *[np.inf] * 6, 0.0, 0.0, 0.0, plate.scale_sd])
    rows = with_estimated_errors(rows, prior)
    return fit_tip(rows, prior), rows


def with_estimated_errors(rows: TipRows, prior: TipPrior) -> TipRows:
    """Enlarge `joint_sd` by the factor that makes the points likeliest (restricted likelihood).

    By 1 to 8, judged by the points that fit with the errors enlarged fourfold.
    """
    grown = [replace(rows, joint_sd=factor * rows.joint_sd) for factor in _FACTORS]
    first = fit_tip(grown[len(_FACTORS) // 2], prior)
    likely = [likelihood(one, prior, first) for one in grown]
    return grown[int(np.argmax(likely))]


def likelihood(rows: TipRows, prior: TipPrior, first: TipFit) -> float:
    """Logarithm of the restricted likelihood of the points that a `first` fit has not left out."""
    kept = rows.rows(~first.left_out)
    return fit_tip(kept, prior, gate=np.inf, start=first.state).evidence


def zero_prior(pose: BlockPose, offset_sd: Array) -> TipPrior:
    """Prior of offsets, `offset_sd` (n_joints,) [rad or m] about 0, and of a block's pose."""
    n = len(offset_sd)
    start = TipState(np.zeros(n), pose.rotation, pose.translation, scale=pose.scale)
    prior = TipPrior.of(start, [*offset_sd, *[1.0] * 6, 0.0, 0.0, 0.0, pose.scale_sd])
    return prior.with_pose(np.asarray(np.linalg.inv(pose.covariance)))


def touched_zero(
    calibration: Calibration,
    recording: Recording,
    touches: Touches,
    pose: BlockPose,
    *,
    touch_sd: float = TOUCH_SD,
) -> TipFit:
    """Fit the offset of each joint to touches of a block whose pose is known.

    The pose keeps its own uncertainty, and what the calibration leaves, as the pose's touches saw
    it, counts by what it does to the tip.

    Raises
    ------
    CalibrationError
        If there are fewer than three touches, robot or arm are not those of the pose, or the
        touches fit neither offset nor pose.
    """
    check_count(touches, FEWEST, "re-zero")
    check_pose(calibration, pose)
    rows = tip_rows(calibration, recording, touches, pose.plate, touch_sd=touch_sd)
    if len(pose.joint_sd) == len(rows.columns):
        rows = replace(rows, joint_sd=pose.joint_sd)
    found = fit_tip(rows, zero_prior(pose, np.full(len(rows.columns), np.inf)))
    _check_misfit(found, touches)
    for joint, offset in zip(calibration.joints, found.state.coefficients.tolist(), strict=True):
        unit = recording.robot.joint(joint).unit
        if abs(offset) > _FARTHEST[unit]:
            raise CalibrationError(
                f"{touches.source}: the zero of {joint} would move by {shown(offset, unit)}, more "
                "than a homing does; has the block moved since its pose was found, or is the model "
                "of another arm?"
            )
    return found


def rezeroed_by_touch(
    calibration: Calibration,
    recording: Recording,
    touches: Touches,
    pose: BlockPose,
    *,
    touch_sd: float = TOUCH_SD,
) -> tuple[Calibration, TipFit]:
    """Give the calibration whose zero is that of touches, and the fit that found it.

    Where zeros were fitted (`calibrate`, `zero`), it is the fit with these. The baselines move by
    the same offset. The metadata say so under ``rezeroed``, and of the new homing. Raises
    CalibrationError as `touched_zero`.

    Examples
    --------
    >>> rezeroed_by_touch(model, test, Touches((1.0,), ("1",)), None)
    Traceback (most recent call last):
    truejoint.errors.CalibrationError: ...
    """
    own = calibration.fitted_for(rezeroing=True)
    before = own.offset
    for _ in range(_ROUNDS):
        found = touched_zero(own, recording, touches, pose, touch_sd=touch_sd)
        own = moved(own, found.state.coefficients)
        # Outputs whose inputs are moved go about as far, but not just as far.
        if own.moves is None or (
            (np.abs(found.state.coefficients) < 0.1 * found.sd[: len(own.joints)]).all()
        ):
            break
    offset = own.offset - before
    names = own.baseline_models
    shifted = {name: own.offsets.get(name, np.zeros(len(offset))) + offset for name in names}
    own = replace(own, offsets={**own.offsets, **shifted})
    origin = recording.provenance
    facts = {
        "source": origin.source,
        "homing_id": origin.homing_id,
        "offset": offset.tolist(),
        "sd": found.sd[: len(offset)].tolist(),
        "rows": len(touches),
        "duration": touches.t[-1] - touches.t[0],
        "truth": "touch",
        "block": pose.title,
        "left_out": [touches.dimple[i] for i in np.flatnonzero(found.left_out)],
    }
    if origin.homing_id:
        own = own.with_metadata(homing_ids=[origin.homing_id])
    return own.with_metadata(rezeroed=facts), found


def known_kinematics(robot: Robot) -> Kinematics:
    """Kinematics of a robot; raises CalibrationError where they are not known."""
    if robot.kinematics is None:
        raise CalibrationError(
            f"the kinematics of {robot.title} are not known, so a touch says nothing of its "
            "joints; give its robot file a table [kinematics]"
        )
    return robot.kinematics


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


def check_count(touches: Touches, fewest: int, what: str) -> None:
    """Refuse touches of fewer dimples, or fewer shots; `what` they are for, in the message."""
    if not hasattr(touches, "dimple"):
        raise CalibrationError(other_kind(touches, "Touches", "read_touches(path) gives them"))
    different = len(set(touches.dimple))
    if different < fewest:
        raise CalibrationError(
            f"{touches.source}: {different} different {touches.kind}s; to {what} it takes {fewest} "
            "or more"
        )


def _check_misfit(found: TipFit, touches: Touches) -> None:
    """Refuse a fit whose residuals are beyond what touches and model leave."""
    if found.misfit > _MISFIT * max(found.freedom, 1):
        rms = np.sqrt((found.residual[~found.left_out] ** 2).sum(axis=1).mean())
        raise CalibrationError(
            f"{touches.source}: the touches stay {1e3 * rms:.2f} mm off whatever the zero; has the "
            "block moved since its pose was found, or is the model of another arm?"
        )
