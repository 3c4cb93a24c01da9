"""A guided run over a block's dimples: what to touch next, and whether the last touch fits."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product
from typing import TYPE_CHECKING, Final

import numpy as np

from truejoint.array_types import Array, Integers
from truejoint.errors import CalibrationError
from truejoint.robots.chain import reach
from truejoint.robots.robot import Robot
from truejoint.tip import touch
from truejoint.tip.block import TOUCH_SD, Block, BlockPose
from truejoint.tip.fit import TipFit, TipPrior, TipRows, fit_rows
from truejoint.tip.terms import LEFT, Terms, check_priors, spread_of, wide_priors

if TYPE_CHECKING:
    from truejoint.calibration.calibration import Calibration
    from truejoint.recordings import Recording

STAND_SD: Final = (0.1, 0.02)
"""How far a block stands from where it is meant to [rad, m]."""
_REPEATED: Final = 5  # Each such touch is made twice
_IMPROVEMENTS: Final = 20  # passes of shortening the way


@dataclass(frozen=True, eq=False)
class Stop:
    """One touch to come."""

    dimple: str
    point: Array  # (3,), of the dimple, in the block's frame as designed [m]
    side: Array  # (n_positioning,), of -1 and 1: from which side each positioning joint comes
    words: str  # The same for a person
    is_again: bool = False  # Whether it did not fit the first time


@dataclass(frozen=True)
class Verdict:
    """Judgement of a touch; None where nothing can be said yet."""

    count: int  # Touches so far, less those that are to be made once more
    off: float | None  # Distance of this one from what the others expect [m], if it does not fit
    tip_sd: float | None  # Standard deviation of the tip now [m]


@dataclass(frozen=True, eq=False)
class Task:
    """What touches are made for: the unknowns that they are to tell."""

    robot: Robot
    pose: BlockPose  # Where the block stands or, to find it, is meant to stand
    fewest: int  # Touches that it takes at least
    # Rows of dimples that could be touched, and the prior, of positions (m, n_joints) of all joints
    # there [rad or m] and points (m, 3) as designed [m]
    unknowns: Callable[[Array, Array], tuple[TipRows, TipPrior]]
    # Fit to a recording and all touches so far; raises CalibrationError as `fit_rows`
    fit: Callable[[Recording, touch.Touches], TipFit]
    # Whether the zeros alone count in the stated deviation of the tip, and not the block's pose
    is_zero_alone: bool = False
    # Whether every fifth touch is made twice, which measures what a touch errs; references of the
    # block are touched where it is not
    has_repeats: bool = False

    def tip_sd(self, rows: TipRows, fit: TipFit) -> float:
        """Deviation of the tip [m] over all dimples, by what the touches leave open."""
        k = len(fit.state.coefficients)
        chosen = slice(0, k) if self.is_zero_alone else slice(None)
        equations = replace(rows, basis=rows.basis[:, :, :k]).equations(fit.state)
        jacobian = equations.by_parameter[:, :, chosen]
        spread = jacobian @ fit.covariance[chosen, chosen] @ jacobian.transpose(0, 2, 1)
        return float(np.sqrt(np.einsum("mii->m", spread).mean()))


def of_model(calibration: Calibration, pose: BlockPose, *, finds_block: bool) -> Task:
    """Touches that find the zeros of a calibration, by a block whose `pose` is known.

    Where they find the block, that is where it is meant to stand. Raises CalibrationError if it is
    the pose of another arm, or another calibration found it.
    """
    touch.check_pose(calibration, pose)
    robot, n = calibration.machine, len(calibration.joints)
    homing = spread_of(robot, calibration.joints)
    left = pose.joint_sd if len(pose.joint_sd) == n else homing / 10.0

    def unknowns(joint: Array, point: Array) -> tuple[TipRows, TipPrior]:
        basis = np.tile(np.eye(n), (len(joint), 1, 1))
        rows = TipRows.of(robot, joint, calibration.joints, basis, point, TOUCH_SD, left)
        return rows, touch.zero_prior(pose, homing)

    def fit(recording: Recording, touches: touch.Touches) -> TipFit:
        if not finds_block:
            asked = calibration, recording, touches, pose.block
            rows = touch.tip_rows(*asked, joint_sd=pose.joint_sd)
            return fit_rows(rows, touch.zero_prior(pose, homing))
        touches = touches.among(pose.block.references, are_in=False)
        rows = touch.tip_rows(calibration, recording, touches, pose.block, offsets=False)
        return touch.fit_block(rows, pose.block)

    fewest = touch.FEWEST_OF_BLOCK if finds_block else touch.FEWEST
    return Task(robot, pose, fewest, unknowns, fit, is_zero_alone=not finds_block)


def learning(robot: Robot, pose: BlockPose, priors: Sequence[Calibration] = ()) -> Task:
    """Touches that calibrate an arm without a joint sensor, and find the block with it.

    `priors` are calibrations as `calibrate_by_touch` takes them.
    """
    check_priors(priors, robot)
    terms, block = Terms.of_workspace(robot), pose.block

    def unknowns(joint: Array, point: Array) -> tuple[TipRows, TipPrior]:
        basis = terms.basis_at(joint[:, robot.index(terms.joints)])
        left = LEFT * terms.scale
        rows = TipRows.of(robot, joint, terms.joints, basis, point, TOUCH_SD, left)
        return rows, touch.terms_prior(rows, block, *wide_priors(terms)[0])

    def fit(recording: Recording, touches: touch.Touches) -> TipFit:
        asked = recording, touches, block, terms, terms.columns_of(recording), priors
        return touch.fit_terms(*asked, is_checked=False).fit

    return Task(robot, pose, touch.fewest_touches(priors), unknowns, fit, has_repeats=True)


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
    """Plans `count` touches of a block, and judges each by those before it.

    The `seed` is of the sides. Raises CalibrationError if fewer dimples can be reached.
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
        self._references = {} if task.has_repeats else block.references
        planned = [*self._references, *(names[k] for k in chosen)]
        sides = approach_sides(len(planned), len(robot.positioning), seed)
        self._stops: list[Stop] = []
        for k, (name, side) in enumerate(zip(planned, sides, strict=True)):
            ways = ("rising" if sign < 0 else "falling" for sign in side)
            words = ", ".join(map(" ".join, zip(robot.positioning, ways, strict=True)))
            times = 2 if task.has_repeats and k % _REPEATED == _REPEATED - 1 else 1
            stop = Stop(name, block.at((name,))[0], side, words)
            self._stops += [replace(stop) for _ in range(times)]
        self._made: list[tuple[float, str]] = []

    def next_stop(self) -> Stop | None:
        """Dimple to touch next; None when all are touched."""
        return self._stops[0] if self._stops else None

    def skip(self, stop: Stop) -> None:
        """Leave a stop out."""
        self._stops.remove(stop)

    def touches(self) -> touch.Touches:
        """Touches that were made and fit, on the recording's clock."""
        t, dimples = zip(*self._made, strict=True)
        return touch.Touches(t, dimples)

    def take(self, stop: Stop, t: float, recording: Recording) -> Verdict:
        """Take a touch at `t` [s, the arm's clock] with what was recorded until now.

        A touch that does not fit is asked for once more, at the end of the run; the second one is
        believed. Raises CalibrationError if the arm moved meanwhile, and then the stop is still
        to come, or if the touches so far do not fit each other, and then it is kept.
        """
        start = recording.provenance.start
        stamp = t - (0.0 if np.isnan(start) else start)
        touch.resting(recording, touch.Touches((stamp,), (stop.dimple,)))
        self._stops.remove(stop)
        self._made.append((stamp, stop.dimple))
        working = [name for _, name in self._made if name not in self._references]
        if stop.dimple in self._references or len(working) <= touch.FEWEST:
            return Verdict(len(self._made), None, None)
        fit = self._task.fit(recording, self.touches())
        off = None
        if fit.left_out[-1] and not stop.is_again:
            off = float(np.linalg.norm(fit.residual[-1]))
            self._made.pop()
            self._stops.append(replace(stop, is_again=True))
        return Verdict(len(self._made), off, self._task.tip_sd(self._rows, fit))


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
    free = np.flatnonzero(prior.free)
    equations = rows.equations(prior.state)
    whitening = equations.whitening(rows.joint_sd, np.array(rows.point_sd))
    jacobian = (whitening @ equations.by_parameter)[:, :, free]
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


def shortest_order(joint: Array, speed: Array, first: int = 0) -> Integers:
    """Order (m,) in which positions (m, n) are gone through in little time, beginning with `first`.

    The slowest joint decides how long a way takes, at its `speed` (n,) [rad/s or m/s]. The nearest
    next, then parts of the way turned round and single stops moved while that shortens it (2-opt
    and or-opt: Croes, Operations Research 6(6), 1958; Or, thesis, Northwestern University, 1976).
    """
    duration = (np.abs(joint[:, None] - joint[None]) / speed).max(axis=2)

    def way(order: list[int]) -> float:
        return float(duration[order[:-1], order[1:]].sum())

    remaining, order = set(range(len(joint))) - {first}, [first]
    while remaining:
        order.append(min(remaining, key=lambda k: (duration[order[-1], k], k)))
        remaining.remove(order[-1])
    for _ in range(_IMPROVEMENTS):
        before = way(order)
        for i, j in combinations(range(1, len(order)), 2):
            part = order[i : j + 1]
            for other in (part[::-1], [*part[1:], part[0]], [part[-1], *part[:-1]]):
                changed = [*order[:i], *other, *order[j + 1 :]]
                if way(changed) < way(order) - 1e-9:
                    order = changed
        if not way(order) < before:
            break
    return np.array(order)


def approach_sides(count: int, n_joints: int, seed: int = 0) -> Array:
    """Sides (count, n_joints) of -1 and 1 from which each joint comes: all combinations in turn.

    Each joint comes from either side half of the time, and no joint always with another.
    """
    every = np.array(list(product((-1.0, 1.0), repeat=n_joints)))
    rng = np.random.default_rng([seed, 61])
    turns = [rng.permutation(len(every)) for _ in range(-(-count // len(every)))]
    return np.asarray(every[np.concatenate(turns)[:count]])
