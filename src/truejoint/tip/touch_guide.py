"""A guided run over a block's dimples: what to touch next, and whether the last touch fits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final, Protocol

import numpy as np

from truejoint.array_types import Array
from truejoint.errors import CalibrationError
from truejoint.robots import get_robot
from truejoint.robots.reach import reach
from truejoint.robots.robot import Robot
from truejoint.tip.plate import TOUCH_SD, BlockPose, Plate
from truejoint.tip.sighted import touched
from truejoint.tip.tip_rows import TipFit, TipPrior, TipRows, fit_tip
from truejoint.tip.touch_calibration import features_of, fewest_touches, fit_terms
from truejoint.tip.touch_plan import approach_sides, choose_touches, shortest_order
from truejoint.tip.touch_terms import LEFT, WIDTHS, Terms, check_known, wide_priors
from truejoint.tip.touches import (
    FEWEST,
    FEWEST_OF_BLOCK,
    Touches,
    check_pose,
    fit_block,
    known_kinematics,
    resting,
    tip_rows,
    zero_prior,
)

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


class Purpose(Protocol):
    """What touches are made for: what they are to tell, and what those so far do."""

    @property
    def fewest(self) -> int:
        """How many it takes at least."""

    def unknowns(self, joint: Array, point: Array) -> tuple[TipRows, TipPrior]:
        """Rows of dimples that could be touched, and what is known before.

        Of positions (m, n_joints) of all joints there [rad or m], and points (m, 3) as designed
        [m].
        """

    def fit(self, recording: Recording, touches: Touches) -> TipFit:
        """Fit to all touches so far; raises CalibrationError as `fit_tip`."""

    def tip_sd(self, rows: TipRows, found: TipFit) -> float:
        """Deviation of the tip [m], over all dimples, by what touches have left open."""


@dataclass(frozen=True, eq=False)
class Rezeroing:
    """Touches that find the zeros of a calibration, by a block whose pose is known."""

    calibration: Calibration
    pose: BlockPose

    def __post_init__(self) -> None:
        check_pose(self.calibration, self.pose)

    @property
    def fewest(self) -> int:
        """How many it takes at least."""
        return FEWEST

    def unknowns(self, joint: Array, point: Array) -> tuple[TipRows, TipPrior]:
        """Take an offset of each joint."""
        robot = get_robot(self.calibration.robot, self.calibration.arm)
        homing = self._homing(robot)
        m, n = len(joint), len(homing)
        rows = TipRows(
            known_kinematics(robot), joint, tuple(robot.index(self.calibration.joints)),
            np.tile(np.eye(n), (m, 1, 1)), point, np.full(m, TOUCH_SD), self._left(homing / 10.0),
        )  # fmt: skip
        return rows, zero_prior(self.pose, homing)

    def fit(self, recording: Recording, touches: Touches) -> TipFit:
        """Fit the offsets."""
        rows = tip_rows(self.calibration, recording, touches, self.pose.plate)
        homing = self._homing(recording.robot)
        return fit_tip(
            replace(rows, joint_sd=self._left(rows.joint_sd)), zero_prior(self.pose, homing)
        )

    def tip_sd(self, rows: TipRows, found: TipFit) -> float:
        """Of the zeros, in a block that stands where it did."""
        return _tip_sd(rows, found, slice(0, rows.basis.shape[2]))

    def _homing(self, robot: Robot) -> Array:
        units = [robot.joint(name).unit for name in self.calibration.joints]
        return np.array([HOMING_SD[unit] for unit in units])

    def _left(self, otherwise: Array) -> Array:
        """Tell what the calibration leaves of each joint, as the pose's touches saw it."""
        return self.pose.joint_sd if len(self.pose.joint_sd) == len(otherwise) else otherwise


class FindingBlock(Rezeroing):
    """Touches that find where a block stands, which is meant to stand at `pose`."""

    @property
    def fewest(self) -> int:
        """How many it takes at least."""
        return FEWEST_OF_BLOCK

    def fit(self, recording: Recording, touches: Touches) -> TipFit:
        """Fit pose and size."""
        plate = self.pose.plate
        rows = tip_rows(self.calibration, recording, touches, plate, offsets=False)
        return fit_block(rows, plate)[0]

    def tip_sd(self, rows: TipRows, found: TipFit) -> float:
        """Of the block."""
        return _tip_sd(replace(rows, basis=rows.basis[:, :, :0]), found, slice(None))


@dataclass(frozen=True, eq=False)
class Learning:
    """Touches that calibrate an arm without a joint sensor, and find the block with it.

    Attributes
    ----------
    robot : Robot
    plate : Plate
    known : sequence of Calibration
        Prior, as `calibrate_by_touch` takes it.
    """

    robot: Robot
    plate: Plate
    known: Sequence[Calibration] = ()

    def __post_init__(self) -> None:
        check_known(self.known, self.robot)

    @property
    def fewest(self) -> int:
        """How many it takes at least."""
        return fewest_touches(self.known)

    def unknowns(self, joint: Array, point: Array) -> tuple[TipRows, TipPrior]:
        """Take all terms; no play has been gone through yet."""
        robot, terms = self.robot, Terms.of(self.robot)
        columns = tuple(robot.index(terms.joints))
        own, m = joint[:, columns], len(joint)
        rows = TipRows(
            known_kinematics(robot), joint, columns,
            terms.basis(np.hstack([own, np.repeat(own, len(WIDTHS), axis=1)])), point,
            np.full(m, TOUCH_SD), LEFT * terms.scale,
        )  # fmt: skip
        seen = touched(Touches((0.0,), tuple(self.plate.points)[:1]), self.plate, robot, TOUCH_SD)
        prior = wide_priors(terms)[0]
        return rows, seen.prior(rows, prior.mean, prior.sd)

    def fit(self, recording: Recording, touches: Touches) -> TipFit:
        """Fit joints and block together."""
        terms = Terms.of(self.robot)
        seen = touched(touches, self.plate, self.robot, TOUCH_SD)
        features = features_of(recording, terms)
        return fit_terms(recording, seen, terms, features, self.known).found

    def tip_sd(self, rows: TipRows, found: TipFit) -> float:
        """Of all, in the block's frame."""
        return _tip_sd(rows, found, slice(None))


def _tip_sd(rows: TipRows, found: TipFit, chosen: slice) -> float:
    jacobian = rows.jacobian(found.state)[0][:, :, chosen]
    spread = jacobian @ found.covariance[chosen, chosen] @ jacobian.transpose(0, 2, 1)
    return float(np.sqrt(np.einsum("mii->m", spread).mean()))


class Guide:
    """Plans touches of a block, and judges each by those before it.

    Parameters
    ----------
    purpose : Purpose
    robot : Robot
    pose : BlockPose
        Where the block stands or, to find it, is meant to stand.
    count : int
        How many dimples.
    seed : int
        Of the sides.

    Raises
    ------
    CalibrationError
        If fewer dimples can be reached than asked for.
    """

    def __init__(
        self, purpose: Purpose, robot: Robot, pose: BlockPose, count: int, *, seed: int = 0
    ) -> None:
        self._purpose = purpose
        names, joint = reachable(robot, pose)
        self._rows, prior = purpose.unknowns(joint, pose.plate.at(names))
        chosen = choose_touches(self._rows, prior, count)
        space = robot.workspace
        moving = robot.index(robot.positioning if space is None else space.joints)
        speed = np.ones(len(moving)) if space is None else space.speed
        chosen = chosen[shortest_order(joint[chosen][:, moving], speed)]
        sides = approach_sides(count, len(robot.positioning), seed)
        points = pose.plate.points
        self._left = [
            Stop(names[k], points[names[k]], side, _words(robot, side))
            for k, side in zip(chosen, sides, strict=True)
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
        if len(self._made) <= FEWEST:
            return Verdict(len(self._made), None, None)
        found = self._purpose.fit(recording, self.touches())
        off = None
        if found.left_out[-1] and not stop.is_again:
            off = float(np.linalg.norm(found.residual[-1]))
            self._made.pop()
            self._left.append(replace(stop, is_again=True))
        return Verdict(len(self._made), off, self._purpose.tip_sd(self._rows, found))


def _words(robot: Robot, side: Array) -> str:
    """From which side each joint comes, for a person."""
    pairs = zip(robot.positioning, side, strict=True)
    return ", ".join(f"{name} {'rising' if one < 0 else 'falling'}" for name, one in pairs)


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
