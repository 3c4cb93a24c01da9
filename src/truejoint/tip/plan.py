"""What to touch of a block: the dimples that tell most, and from which sides."""

from dataclasses import dataclass
from itertools import product
from typing import Final, NamedTuple

import numpy as np

from truejoint.array_types import Array, Integers
from truejoint.calibration.calibration import Calibration
from truejoint.errors import CalibrationError
from truejoint.robots.chain import reach
from truejoint.robots.robot import Robot
from truejoint.tip import touch
from truejoint.tip.block import TOUCH_SD, Block, BlockPose
from truejoint.tip.fit import TipPrior, TipRows, whiten_rows
from truejoint.tip.terms import LEFT, Terms, spread_of, wide_priors

STAND_SD: Final = (0.1, 0.02)  # rad and m by which a block stands off where it is meant to
_REPEATED: Final = 5  # Each such touch is made twice


class Stop(NamedTuple):
    """One touch to come."""

    dimple: str
    point: Array  # (3,), of the dimple, in the block's frame as designed [m]
    side: Array  # (n_positioning,), of -1 and 1: from which side each positioning joint comes
    words: str  # The same for a person


@dataclass(frozen=True, eq=False)
class Task:
    """What touches are made for: the unknowns that they are to tell."""

    robot: Robot
    pose: BlockPose  # Where the block stands or, to find it, is meant to stand
    fewest: int  # Touches that it takes at least
    dimples: tuple[str, ...]  # Those in reach
    rows: TipRows  # Of these, were they touched
    prior: TipPrior
    # Whether every fifth touch is made twice, which measures what a touch errs; references of the
    # block are touched where it is not
    has_repeats: bool = False

    def plan(self, count: int, seed: int = 0) -> list[Stop]:
        """Plan `count` touches, the most telling first; the `seed` is of the sides.

        Raises CalibrationError if fewer dimples can be reached.
        """
        block, joints = self.pose.block, self.robot.positioning
        chosen = [self.dimples[k] for k in choose_touches(self.rows, self.prior, count)]
        names = chosen if self.has_repeats else [*block.references, *chosen]
        stops = []
        sides = approach_sides(len(names), len(joints), seed)
        for k, (name, side) in enumerate(zip(names, sides, strict=True)):
            ways = ("rising" if sign < 0 else "falling" for sign in side)
            words = ", ".join(map(" ".join, zip(joints, ways, strict=True)))
            times = 2 if self.has_repeats and k % _REPEATED == _REPEATED - 1 else 1
            stops += [Stop(name, block.at((name,))[0], side, words)] * times
        return stops


def of_model(calibration: Calibration, pose: BlockPose, *, finds_block: bool) -> Task:
    """Touches that find the zeros of a calibration, by a block whose `pose` is known.

    Where they find the block, that is where it is meant to stand. Raises CalibrationError if it is
    the pose of another arm, or another calibration found it.
    """
    touch.check_pose(calibration, pose)
    robot, n = calibration.machine, len(calibration.joints)
    homing, (names, joint) = spread_of(robot, calibration.joints), reachable(robot, pose)
    left = pose.joint_sd if len(pose.joint_sd) == n else homing / 10.0
    basis, point = np.tile(np.eye(n), (len(joint), 1, 1)), pose.block.at(names)
    rows = TipRows.of(robot, joint, calibration.joints, basis, point, TOUCH_SD, left)
    fewest = touch.FEWEST_OF_BLOCK if finds_block else touch.FEWEST
    return Task(robot, pose, fewest, names, rows, touch.zero_prior(pose, homing))


def learning(robot: Robot, pose: BlockPose, prior: Calibration | None = None) -> Task:
    """Touches that calibrate an arm without a joint sensor, and find the block with it.

    `prior` is a calibration as `calibrate_by_touch` takes it.
    """
    if prior is not None:
        prior.check_robot(robot)
    terms, (names, joint) = Terms.of_workspace(robot), reachable(robot, pose)
    basis, point = terms.basis_at(joint[:, robot.index(terms.joints)]), pose.block.at(names)
    rows = TipRows.of(robot, joint, terms.joints, basis, point, TOUCH_SD, LEFT * terms.scale)
    known = touch.terms_priors(rows, pose.block, wide_priors(terms))[0]
    return Task(robot, pose, touch.fewest_touches(prior), names, rows, known, has_repeats=True)


def design_pose(block: Block, robot: Robot) -> BlockPose:
    """Pose in which a block is meant to stand, known within a hand's breadth.

    Raises CalibrationError if it is a block for another robot.
    """
    block.check_robot(robot)
    spread = np.diag(np.repeat(np.square(STAND_SD), 3))
    where = block.rotation, block.translation, spread
    return BlockPose(block, robot.name, robot.arm, *where, block.scale, block.scale_sd)


def reachable(robot: Robot, pose: BlockPose) -> tuple[tuple[str, ...], Array]:
    """Dimples that the tip reaches within the joints' limits, and all joints there (m, n_joints).

    Raises CalibrationError if there are none.
    """
    names = tuple(pose.block.points)
    goal = pose.scale * pose.block.at(names) @ pose.rotation.T + pose.translation
    seed = robot.home.copy()
    if robot.workspace is not None:
        seed[robot.index(robot.workspace.joints)] = robot.workspace.centre
    chain, columns = robot.known_kinematics("points of the tool"), robot.index(robot.positioning)
    joint, there = reach(chain, columns, goal, seed)
    there &= ((joint >= robot.lower) & (joint <= robot.upper)).all(axis=1)
    if not there.any():
        raise CalibrationError(f"all dimples of {pose.title} are out of reach; move the block")
    return tuple(n for n, good in zip(names, there, strict=True) if good), joint[there]


def choose_touches(rows: TipRows, prior: TipPrior, count: int) -> Integers:
    """Choose `count` of the rows, one by one, whose points tell most of what is not known.

    Each adds most to the determinant of the parameters' information (D-optimal: Atkinson, Donev and
    Tobias, Optimum Experimental Designs, with SAS, 2007, ch. 12). Gives their places (count,), the
    most telling first. Raises CalibrationError if there are fewer rows.
    """
    if not 0 < count <= len(rows):
        raise CalibrationError(
            f"{count} touches of {len(rows)} dimples in reach; choose fewer, or print a larger one"
        )
    free, every = np.flatnonzero(prior.free), np.ones(len(rows), dtype=np.bool_)
    jacobian = whiten_rows(rows, every, prior.state).jacobian[:, :, free]
    # A little of everything is known, so that the first touches count for something.
    size = np.einsum("mia,mia->a", jacobian, jacobian) + np.diag(prior.precision)[free]
    information = prior.precision[np.ix_(free, free)] + 1e-6 * np.diag(size)
    remaining, chosen = list(range(len(rows))), []
    for _ in range(count):
        covariance = np.linalg.inv(information)
        spread = jacobian[remaining] @ covariance @ jacobian[remaining].transpose(0, 2, 1)
        gain = np.linalg.slogdet(np.eye(3) + spread)[1]
        chosen.append(remaining.pop(int(np.argmax(gain))))
        information = information + jacobian[chosen[-1]].T @ jacobian[chosen[-1]]
    return np.array(chosen)


def approach_sides(count: int, n_joints: int, seed: int = 0) -> Array:
    """Sides (count, n_joints) of -1 and 1 from which each joint comes: all combinations in turn.

    Each joint comes from either side half of the time, and no joint always with another.
    """
    every = np.array(list(product((-1.0, 1.0), repeat=n_joints)))
    rng = np.random.default_rng([seed, 61])
    turns = [rng.permutation(len(every)) for _ in range(-(-count // len(every)))]
    return np.asarray(every[np.concatenate(turns)[:count]])
