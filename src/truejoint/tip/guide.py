"""A guided run over a block's dimples: what to touch next, and whether the last touch fits."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Final

import numpy as np

from truejoint.array_types import Array
from truejoint.errors import CalibrationError
from truejoint.robots import get_robot
from truejoint.robots.reach import reach
from truejoint.robots.robot import Robot
from truejoint.tip.block import TOUCH_SD, Block, BlockPose
from truejoint.tip.fit import TipFit, fit_rows
from truejoint.tip.rows import TipPrior, TipRows
from truejoint.tip.terms import LEFT, Terms, check_priors, wide_priors
from truejoint.tip.touch import (
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
from truejoint.tip.touch_calibration import features_of, fewest_touches, fit_terms, terms_prior
from truejoint.tip.touch_plan import approach_sides, choose_touches, shortest_order

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
    """Judgement of a touch; None where nothing can be said yet.

    Attributes
    ----------
    count : int
        Touches so far, less those that are to be made once more.
    off : float or None
        Distance of this one from what the others expect [m], if it does not fit.
    tip_sd : float or None
        Standard deviation of the tip now [m].
    """

    count: int
    off: float | None
    tip_sd: float | None


@dataclass(frozen=True, eq=False)
class Task:
    """What touches are made for: the unknowns that they are to tell.

    Attributes
    ----------
    robot : Robot
    pose : BlockPose
        Where the block stands or, to find it, is meant to stand.
    fewest : int
        Touches that it takes at least.
    unknowns : callable
        Rows of dimples that could be touched, and the prior, of positions (m, n_joints) of all
        joints there [rad or m] and points (m, 3) as designed [m].
    fit : callable
        Fit to a recording and all touches so far; raises CalibrationError as `fit_rows`.
    is_zero_alone : bool
        Whether the zeros alone count in the stated deviation of the tip, and not the block's pose.
    """

    robot: Robot
    pose: BlockPose
    fewest: int
    unknowns: Callable[[Array, Array], tuple[TipRows, TipPrior]]
    fit: Callable[[Recording, Touches], TipFit]
    is_zero_alone: bool = False

    def tip_sd(self, rows: TipRows, fit: TipFit) -> float:
        """Deviation of the tip [m] over all dimples, by what the touches leave open."""
        k = len(fit.state.coefficients)
        chosen = slice(0, k) if self.is_zero_alone else slice(None)
        equations = replace(rows, basis=rows.basis[:, :, :k]).equations(fit.state)
        jacobian = equations.by_parameter[:, :, chosen]
        spread = jacobian @ fit.covariance[chosen, chosen] @ jacobian.transpose(0, 2, 1)
        return float(np.sqrt(np.einsum("mii->m", spread).mean()))


def rezeroing(calibration: Calibration, pose: BlockPose) -> Task:
    """Touches that find the zeros of a calibration, by a block whose pose is known."""
    check_pose(calibration, pose)
    robot = get_robot(calibration.robot, calibration.arm)
    homing = np.array([HOMING_SD[robot.joint(name).unit] for name in calibration.joints])

    def fit(recording: Recording, touches: Touches) -> TipFit:
        rows = tip_rows(calibration, recording, touches, pose.block)
        if len(pose.joint_sd) == len(homing):
            rows = rows.with_joint_sd(pose.joint_sd)
        return fit_rows(rows, zero_prior(pose, homing))

    return Task(
        robot, pose, FEWEST, partial(_zero_unknowns, calibration, robot, pose, homing), fit, True
    )


def finding_block(calibration: Calibration, pose: BlockPose) -> Task:
    """Touches that find where a block stands, which is meant to stand at `pose`."""
    check_pose(calibration, pose)
    robot = get_robot(calibration.robot, calibration.arm)
    homing = np.array([HOMING_SD[robot.joint(name).unit] for name in calibration.joints])

    def fit(recording: Recording, touches: Touches) -> TipFit:
        rows = tip_rows(calibration, recording, touches, pose.block, offsets=False)
        return fit_block(rows, pose.block)[0]

    unknowns = partial(_zero_unknowns, calibration, robot, pose, homing)
    return Task(robot, pose, FEWEST_OF_BLOCK, unknowns, fit)


def _zero_unknowns(
    calibration: Calibration, robot: Robot, pose: BlockPose, homing: Array, joint: Array,
    point: Array,
) -> tuple[TipRows, TipPrior]:  # fmt: skip
    """Rows with an offset of each joint that a calibration corrects."""
    columns = tuple(robot.index(calibration.joints))
    basis = np.tile(np.eye(len(homing)), (len(joint), 1, 1))
    nothing = np.zeros(joint.shape[1])
    rows = TipRows(known_kinematics(robot), joint, columns, basis, point, TOUCH_SD, nothing)
    joint_sd = pose.joint_sd if len(pose.joint_sd) == len(homing) else homing / 10.0
    return rows.with_joint_sd(joint_sd), zero_prior(pose, homing)


def learning(robot: Robot, pose: BlockPose, priors: Sequence[Calibration] = ()) -> Task:
    """Touches that calibrate an arm without a joint sensor, and find the block with it.

    `priors` are calibrations as `calibrate_by_touch` takes them.
    """
    check_priors(priors, robot)
    terms, block = Terms.of_workspace(robot), pose.block

    def unknowns(joint: Array, point: Array) -> tuple[TipRows, TipPrior]:
        """Take all terms; no play has been gone through yet."""
        columns = tuple(robot.index(terms.joints))
        own = joint[:, columns]
        plays = np.zeros((len(joint), *terms.widths.shape))
        rows = TipRows(
            known_kinematics(robot),
            joint,
            columns,
            terms.basis(terms.normalised(own), plays),
            point,
            TOUCH_SD,
            np.zeros(joint.shape[1]),
        ).with_joint_sd(LEFT * terms.scale)
        return rows, terms_prior(rows, block, *wide_priors(terms)[0])

    def fit(recording: Recording, touches: Touches) -> TipFit:
        features = features_of(recording, terms)
        return fit_terms(recording, touches, block, terms, features, priors).fit

    return Task(robot, pose, fewest_touches(priors), unknowns, fit)


def design_pose(block: Block, robot: Robot) -> BlockPose:
    """Pose in which a block is meant to stand, known within a hand's breadth.

    Raises CalibrationError if it is a block for another robot.
    """
    if block.robot != robot.name:
        raise CalibrationError(
            f"block {block.name} is for {block.robot}, the model is of {robot.title}; design one "
            "for it"
        )
    spread = np.diag(np.repeat(np.square(STAND_SD), 3))
    where = block.rotation, block.translation, spread
    return BlockPose(block, robot.name, robot.arm, *where, block.scale, block.scale_sd)


class Guide:
    """Plans touches of a block, and judges each by those before it.

    Parameters
    ----------
    task : Task
    count : int
        How many dimples.
    seed : int
        Of the sides.

    Raises
    ------
    CalibrationError
        If fewer dimples can be reached than asked for.
    """

    def __init__(self, task: Task, count: int, *, seed: int = 0) -> None:
        self._task = task
        robot, block = task.robot, task.pose.block
        names, joint = reachable(robot, task.pose)
        self._rows, prior = task.unknowns(joint, block.at(names))
        chosen = choose_touches(self._rows, prior, count)
        space = robot.workspace
        moving = robot.index(robot.positioning if space is None else space.joints)
        speed = np.ones(len(moving)) if space is None else space.speed
        chosen = chosen[shortest_order(joint[chosen][:, moving], speed)]
        sides = approach_sides(count, len(robot.positioning), seed)
        self._stops = [
            Stop(names[k], block.points[names[k]], side, _words(robot, side))
            for k, side in zip(chosen, sides, strict=True)
        ]
        self._made: list[tuple[float, str]] = []

    def next_stop(self) -> Stop | None:
        """Dimple to touch next; None when all are touched."""
        return self._stops[0] if self._stops else None

    def skip(self, stop: Stop) -> None:
        """Leave a stop out."""
        self._stops.remove(stop)

    def touches(self) -> Touches:
        """Touches that were made and fit, on the recording's clock."""
        t, dimples = zip(*self._made, strict=True)
        return Touches(t, dimples)

    def take(self, stop: Stop, t: float, recording: Recording) -> Verdict:
        """Take a touch at `t` [s, the arm's clock] with what was recorded until now.

        A touch that does not fit is asked for once more, at the end of the run; the second one is
        believed. Raises CalibrationError if the arm moved meanwhile, and then the stop is still
        to come, or if the touches so far do not fit each other, and then it is kept.
        """
        start = recording.provenance.start
        stamp = t - (0.0 if np.isnan(start) else start)
        resting(recording, Touches((stamp,), (stop.dimple,)))
        self._stops.remove(stop)
        self._made.append((stamp, stop.dimple))
        if len(self._made) <= FEWEST:
            return Verdict(len(self._made), None, None)
        fit = self._task.fit(recording, self.touches())
        off = None
        if fit.left_out[-1] and not stop.is_again:
            off = float(np.linalg.norm(fit.residual[-1]))
            self._made.pop()
            self._stops.append(replace(stop, is_again=True))
        return Verdict(len(self._made), off, self._task.tip_sd(self._rows, fit))


def _words(robot: Robot, side: Array) -> str:
    """From which side each joint comes, for a person."""
    pairs = zip(robot.positioning, side, strict=True)
    return ", ".join(f"{name} {'rising' if sign < 0 else 'falling'}" for name, sign in pairs)


def reachable(robot: Robot, pose: BlockPose) -> tuple[tuple[str, ...], Array]:
    """Dimples that the tip reaches within the joints' limits, and all joints there (m, n_joints).

    Raises CalibrationError if there are none.
    """
    names = tuple(pose.block.points)
    goal = pose.scale * pose.block.at(names) @ pose.rotation.T + pose.translation
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
