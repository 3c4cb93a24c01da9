"""A guided run over a block's dimples: what to touch next, and whether the last touch fits."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from truejoint.array_types import Array
from truejoint.calibration.plate import TOUCH_SD, BlockPose, Plate
from truejoint.calibration.tip_rows import TipFit, TipRows, fit_tip
from truejoint.calibration.touch_plan import approach_sides, choose_touches, shortest_order
from truejoint.calibration.touches import (
    FEWEST,
    Touches,
    check_pose,
    fit_block,
    known_kinematics,
    resting,
    tip_rows,
    zero_prior,
)
from truejoint.errors import CalibrationError
from truejoint.robots.reach import reach
from truejoint.robots.robot import Robot

if TYPE_CHECKING:
    from truejoint.calibration.calibration import Calibration
    from truejoint.recordings import Recording

HOMING_SD: Final = {"rad": np.deg2rad(1.0), "m": 1e-3}
"""By how much a homing moves a zero, widely."""
STAND_SD: Final = (0.1, 0.02)
"""How far a block stands from where it is meant to [rad, m]."""


@dataclass(frozen=True, eq=False)
class Stop:
    """One touch to come.

    Attributes
    ----------
    dimple : str
    point : ndarray, shape (3,)
        Of the dimple, in the block's frame as designed [m].
    side : ndarray, shape (n_positioning,)
        Of -1 and 1: from which side each positioning joint comes.
    words : str
        The same for a person.
    is_again : bool
        Whether it did not fit the first time.
    """

    dimple: str
    point: Array
    side: Array
    words: str
    is_again: bool = False


@dataclass(frozen=True)
class Verdict:
    """What a touch is worth; None where nothing can be said yet.

    Attributes
    ----------
    count : int
        Touches so far, but for those that are to be made once more.
    off : float or None
        How far off this one is [m], where it does not fit.
    tip_sd : float or None
        Standard deviation of the tip now [m].
    """

    count: int
    off: float | None
    tip_sd: float | None


def design_pose(plate: Plate, robot: Robot) -> BlockPose:
    """Pose in which a plate is meant to stand, known within a hand's breadth.

    Raises CalibrationError if it is a plate for another robot.
    """
    if plate.robot != robot.name:
        raise CalibrationError(
            f"plate {plate.name} is for {plate.robot}, the model is of {robot.title}; design one "
            "for it"
        )
    spread = np.diag(np.repeat(np.square(STAND_SD), 3))
    return BlockPose(
        plate, robot.name, robot.arm, plate.rotation, plate.translation, spread, plate.scale,
        plate.scale_sd,
    )  # fmt: skip


class Guide:
    """Plans touches of a block, and judges each by those before it.

    Parameters
    ----------
    calibration : Calibration
        Of the arm; its corrected positions say where the tip is.
    robot : Robot
    pose : BlockPose
        Where the block stands or, to find it, is meant to stand.
    count : int
        How many dimples.
    finds_block : bool
        Whether the block's pose is to be found, rather than the zero of the joints.
    seed : int
        Of the sides.

    Raises
    ------
    CalibrationError
        If fewer dimples can be reached than asked for, or the block's pose is in another arm's base
        or was found with another calibration.
    """

    def __init__(
        self, calibration: Calibration, robot: Robot, pose: BlockPose, count: int, *,
        finds_block: bool, seed: int = 0,
    ) -> None:  # fmt: skip
        check_pose(calibration, pose)
        self._calibration, self._pose, self._finds_block = calibration, pose, finds_block
        names, joint = reachable(robot, pose)
        columns = tuple(robot.index(calibration.joints))
        units = [robot.joint(name).unit for name in calibration.joints]
        homing = np.array([HOMING_SD[unit] for unit in units])
        residual = homing / 10.0  # plans hardly depend on it
        if len(pose.joint_sd) == len(columns):
            residual = pose.joint_sd
        m, n = len(names), len(columns)
        self._rows = TipRows(
            known_kinematics(robot), joint, columns, np.tile(np.eye(n), (m, 1, 1)),
            pose.plate.at(names), np.full(m, TOUCH_SD), residual,
        )  # fmt: skip
        self._prior = zero_prior(pose, homing)
        chosen = choose_touches(self._rows, self._prior, count)
        space = robot.workspace
        moving = robot.index(robot.positioning if space is None else space.joints)
        speed = np.ones(len(moving)) if space is None else space.speed
        chosen = chosen[shortest_order(joint[chosen][:, moving], speed)]
        sides = approach_sides(count, len(robot.positioning), seed)
        words = [
            ", ".join(
                f"{name} {'rising' if side < 0 else 'falling'}"
                for name, side in zip(robot.positioning, row, strict=True)
            )
            for row in sides
        ]
        points = pose.plate.points
        self._left = [
            Stop(names[k], points[names[k]], side, text)
            for k, side, text in zip(chosen, sides, words, strict=True)
        ]
        self._made: list[tuple[float, str]] = []
        self._source = "touches"

    def next_stop(self) -> Stop | None:
        """Tell what to touch next; None when all is touched."""
        return self._left[0] if self._left else None

    def skip(self, stop: Stop) -> None:
        """Leave a stop out."""
        self._left.remove(stop)

    def touches(self) -> Touches:
        """Touches that were made and fit, on the recording's clock."""
        t, dimples = zip(*self._made, strict=True)
        return Touches(t, dimples, self._source)

    def take(self, stop: Stop, t: float, recording: Recording) -> Verdict:
        """Take a touch at `t` [s, the arm's clock] with what was recorded until now.

        One that does not fit is asked for once more, at the end of the run; what is seated twice
        is believed. Raises CalibrationError if the arm moved meanwhile, and then the stop is still
        to come, or if the touches so far do not fit each other, and then it is kept.
        """
        start = recording.provenance.start
        stamp = t - (0.0 if np.isnan(start) else start)
        resting(recording, Touches((stamp,), (stop.dimple,), self._source))
        self._left.remove(stop)
        self._made.append((stamp, stop.dimple))
        found = self._fit(recording)
        if found is None:
            return Verdict(len(self._made), None, None)
        off = None
        if found.left_out[-1] and not stop.is_again:
            off = float(np.linalg.norm(found.residual[-1]))
            self._made.pop()
            self._left.append(replace(stop, is_again=True))
        return Verdict(len(self._made), off, self._tip_sd(found))

    def _fit(self, recording: Recording) -> TipFit | None:
        """Fit to all touches so far; None while they are too few."""
        if len(self._made) <= FEWEST:
            return None
        plate = self._pose.plate
        rows = tip_rows(
            self._calibration, recording, self.touches(), plate, offsets=not self._finds_block
        )
        if self._finds_block:
            return fit_block(rows, plate)[0]
        if len(self._pose.joint_sd) == len(rows.columns):
            rows = replace(rows, joint_sd=self._pose.joint_sd)
        return fit_tip(rows, self._prior)

    def _tip_sd(self, found: TipFit) -> float:
        """Deviation of the tip [m], over all dimples, by what is not known of zeros or block."""
        rows = self._rows
        if self._finds_block:
            rows = replace(rows, basis=rows.basis[:, :, :0])
        by_parameter, _ = rows.jacobian(found.state)
        n = rows.basis.shape[2]
        known = slice(0, n) if n else slice(None)
        jacobian = by_parameter[:, :, known]
        spread = jacobian @ found.covariance[known, known] @ jacobian.transpose(0, 2, 1)
        return float(np.sqrt(np.einsum("mii->m", spread).mean()))


def reachable(robot: Robot, pose: BlockPose) -> tuple[tuple[str, ...], Array]:
    """Dimples that the tip reaches within the joints' limits, and all joints there (m, n_joints).

    Raises CalibrationError if there are none.
    """
    names = tuple(pose.plate.points)
    goal = pose.scale * pose.plate.at(names) @ pose.rotation.T + pose.translation
    seed = robot.home.copy()
    if robot.workspace is not None:
        seed[robot.index(robot.workspace.joints)] = robot.workspace.centre
    joint, there = reach(robot, goal, seed)
    there &= ((joint >= robot.lower) & (joint <= robot.upper)).all(axis=1)
    if not there.any():
        raise CalibrationError(
            f"{robot.title} reaches none of {len(names)} dimples of {pose.title}: the block is out "
            "of reach"
        )
    return tuple(n for n, good in zip(names, there, strict=True) if good), joint[there]
