"""Touching the dimples of a block with a simulated arm, as a person who steers it would."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from truejoint.array_types import Array
from truejoint.crtk import Arm, StateBlock, TruthBlock
from truejoint.errors import CommandRefused, RobotError
from truejoint.robots import Robot
from truejoint.robots.chain import reach
from truejoint.simulation import TwinOutput

AWAY: Final = 2.0
"""How far off its dimple a tip waits, in seconds of the workspace's speed."""
REST: Final = 1.0
"""For how long the tip rests in its dimple [s]."""
_HASTE: Final = 1.5  # between dimples, times the laboratory's speeds
_SHORT: Final = 0.15  # of the way in that is left until the tip is looked at
_LOOKS: Final = 4
_SETTLING: Final = 0.3  # [s] before a look, with it
_LOOK: Final = 0.01  # [s]; a twin is slow while each of its blocks is looked at


def joints_at(robot: Robot, point: Array, seed: Array) -> Array:
    """Positions (n_joints,) [rad or m] that take the tool's tip to a `point` (3,) [m] of the base.

    The positioning joints go there, the others stay as in `seed` (n_joints,). Raises RobotError if
    they cannot, or not within their limits.
    """
    chain, columns = robot.known_kinematics("points of the tool"), robot.index(robot.positioning)
    angles, there = reach(chain, columns, point[None], seed)
    joint: Array = angles[0]
    inside = (joint >= robot.lower) & (joint <= robot.upper)
    if not (there.all() and inside.all()):
        x, y, z = 1e3 * point
        names = [n for n, good in zip(robot.joint_names, inside, strict=True) if not good]
        raise RobotError(
            f"the tip cannot reach ({x:.1f}, {y:.1f}, {z:.1f}) mm"
            + (f": {', '.join(names)} beyond the limits" if names else "")
        )
    return joint


@dataclass(eq=False)
class SimulatedHand:
    """Steers a simulated arm's tip into dimples, by looking where its joints really are.

    The arm is enabled and homed. Raises CommandRefused if it does not say where its joints really
    are: only a twin does.
    """

    arm: Arm
    rotation: Array  # (3, 3), of the block in the arm's base
    translation: Array  # (3,), likewise [m]
    seat_sd: float = 2e-4  # how far off its dimple a tip rests, per axis [m]
    seed: int = 0

    def __post_init__(self) -> None:
        self._rng = np.random.default_rng([self.seed, 29])
        self._columns = self.arm.robot.index(self.arm.robot.positioning)
        self._look()

    def touch(self, point: Array, side: Array) -> float:
        """Rest in the dimple at `point` (3,) [m] of the block; gives the rest's end [s].

        `side` (n_positioning,) of -1 and 1 is where each joint comes from. The tip rests where a
        hand seats it. The time is on the arm's clock. Raises RobotError if the dimple is out of
        reach.
        """
        robot, columns = self.arm.robot, self._columns
        seat = self.rotation @ point + self.translation
        seat = seat + self.seat_sd * self._rng.standard_normal(3)
        pose = self.arm.setpoint_js(np.inf).position.copy()
        speed, haste = np.full(len(columns), 0.02), None
        if robot.workspace is not None:
            # From the middle, as touches are planned: more than three joints reach in many ways.
            pose[robot.index(robot.workspace.joints)] = robot.workspace.centre
            speed = robot.workspace.speed
            haste = np.array([min(joint.max_speed, 0.17) for joint in robot.joints])
            haste[columns] = _HASTE * speed  # the tool's as ever
        goal = joints_at(robot, seat, pose)
        away = np.zeros(len(goal))
        away[columns] = side * AWAY * speed
        for share, cap in ((1.0, haste), (_SHORT, None), *[(0.0, None)] * _LOOKS):
            target = goal - self._lost() + share * away
            self.arm.move_jp(np.clip(target, robot.lower, robot.upper), cap).wait()
        self.arm.wait(REST)
        return self.arm.time

    def _lost(self) -> Array:
        """By how much the joints (n_joints,) are ahead of their set-points, once settled."""
        self.arm.wait(_SETTLING - _LOOK)
        true, now = self._look(), self.arm.setpoint_js().position
        lost = np.zeros(len(now))
        lost[self._columns] = true - now[self._columns]
        return lost

    def _look(self) -> Array:
        """See where the positioning joints (n_positioning,) really are."""
        blocks: list[StateBlock | TruthBlock] = []
        self.arm.subscribe(blocks.append)
        self.arm.wait(_LOOK)
        self.arm.unsubscribe(blocks.append)
        outputs = [block for block in blocks if isinstance(block, TwinOutput)]
        if not outputs:
            raise CommandRefused(
                f"{self.arm.robot.title} does not say where its joints really are; touch by hand"
            )
        true: Array = outputs[-1].joint[-1]
        return true
