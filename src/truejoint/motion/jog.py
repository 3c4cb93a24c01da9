"""Jogging: velocities that may change at any moment become a steady stream of set-points."""

import math
from collections.abc import Callable, Iterator
from typing import Final, Self

import numpy as np
from numpy.typing import ArrayLike

from truejoint.array_types import Array
from truejoint.crtk import Arm, Motion
from truejoint.crtk.arm import as_arm
from truejoint.crtk.cartesian import jacobian
from truejoint.crtk.limits import move_speed
from truejoint.errors import CommandRefused
from truejoint.robots.blocks import checked_vector

RAMP: Final = 0.1
"""Time in which a joint reaches its speed cap from rest [s]."""
_DAMPING: Final = 1e-3  # of the inverse of the Jacobian: near a singular pose joints stay slow


class Jog:
    """Moves an arm at velocities that change while it moves, from entering to leaving.

    A velocity holds until the next one. Speeds are kept below the caps, the change of speed below
    that which reaches a cap in 0.1 s, and a joint comes to rest before its limit. A new velocity
    takes effect within the arm's grain, 10 ms. The arm must run in real time (`PacedBackend`, a
    robot).

    Parameters
    ----------
    arm : Arm
        Enabled and homed.
    speed : array_like, shape (n_joints,), optional
        Speed caps [rad/s or m/s]; by default those of a move.

    Raises
    ------
    CommandRefused
        If the arm is not ready, or a cap is not positive or above the joint's top speed.

    Examples
    --------
    >>> with Jog(arm) as jog:
    ...     jog.joints(np.zeros(7))
    >>> jog.motion.is_busy()
    False
    """

    def __init__(self, arm: Arm, speed: ArrayLike | None = None) -> None:
        self.arm: Final = as_arm(arm)
        self.speed = move_speed(arm.robot, speed, "jog")
        self.motion: Motion
        self.stop()

    def __enter__(self) -> Self:
        start = self.arm.setpoint_js(math.inf).position
        self.motion = self.arm.stream(self._pieces(start), math.inf, "jog")
        return self

    def __exit__(self, *_: object) -> None:
        self.motion.cancel()

    def joints(self, velocity: ArrayLike) -> None:
        """Go on at joint velocities (n_joints,) [rad/s or m/s], each cut to its cap."""
        wanted = np.clip(checked_vector(self.arm.robot, velocity, "jog"), -self.speed, self.speed)
        # Joint velocities (n_joints,) that are asked for at a position; the arm's thread calls it.
        self._wanted: Callable[[Array], Array] = lambda _: wanted

    def tool(self, twist: ArrayLike) -> None:
        """Go on at a twist (6,) of the tool [m/s, rad/s] in the frame of the CRTK topics.

        If a joint would be faster than its cap, all are slowed, so that the direction is kept.
        Raises RobotError if the robot's kinematics are not known.
        """
        kinematics = self.arm.robot.known_kinematics("jog")
        wanted = np.asarray(twist, dtype=float)
        if wanted.shape != (6,) or not np.isfinite(wanted).all():
            raise CommandRefused("jog refused: a twist is 6 finite values [m/s] and [rad/s]")

        def from_twist(position: Array) -> Array:
            # In shares of the caps, so that radians and metres compare.
            scaled = jacobian(kinematics, position) * self.speed
            square = scaled @ scaled.T
            square = square + _DAMPING**2 * np.eye(6) * np.trace(square) / 6
            shares = scaled.T @ np.linalg.solve(square, wanted)
            return np.asarray(self.speed * shares / max(1.0, float(np.abs(shares).max())))

        self._wanted = from_twist

    def stop(self) -> None:
        """Come to rest and hold."""
        self.joints(np.zeros(len(self.arm.robot.joints)))

    def _pieces(self, start: Array) -> Iterator[Array]:
        robot, position = self.arm.robot, start.copy()
        n = round(self.arm.grain * self.arm.rate)
        piece = n / self.arm.rate  # [s]
        velocity, change = np.zeros(len(start)), self.speed / RAMP * piece
        share = np.arange(1, n + 1)[:, None] / n
        while True:
            wanted = self._wanted(position)
            # What still can be braked before a limit, at the deceleration that is allowed.
            room = np.stack([position - robot.lower, robot.upper - position]).clip(0.0)
            # Speeds change evenly over a piece, also over that in which the joint comes to rest.
            left = 2.0 * room * self.speed / RAMP + np.stack([velocity, -velocity]) * change
            edge = (np.sqrt(left.clip(0.0)) - 0.5 * change).clip(0.0)
            wanted = np.clip(wanted, -edge[0], edge[1])
            after = np.clip(wanted, velocity - change, velocity + change)
            # The mean speed up to each row of the piece, over which the speed changes evenly.
            rows = position + piece * share * (velocity + 0.5 * share * (after - velocity))
            rows = np.clip(rows, robot.lower, robot.upper)
            position, velocity = rows[-1], after
            yield rows
