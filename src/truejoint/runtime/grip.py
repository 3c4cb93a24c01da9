"""Jaws that close until they grip as wanted, by what the corrector says of their grip."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike

from truejoint.array_types import Array, floats
from truejoint.errors import CommandRefused, other_kind
from truejoint.robots import Robot
from truejoint.robots.joint_rows import checked_rows
from truejoint.runtime.compensator import Compensator


class GripControl:
    """Wanted joint positions for a `Compensator` that make two jaws grip as wanted.

    Jaws that give way by ``grip / stiffness`` beyond the opening at which they meet something are
    closed by that much: ``opening = met - wanted / stiffness``, where `met` follows ``known opening
    + known grip / stiffness``. An estimate that is off in the opening is off in both, and what is
    left is how far the grip is off. Jaws that hold nothing close at ``wanted / stiffness`` in each
    time constant until they do. Where no grip is wanted, the opening is that of the positions.

    Where the corrector knows how far its joints give way to a grip (`Corrector.gives_way`), motors
    wind up their cables by that at once, and the loop makes up for the rest. While the compensator
    does not believe its samples or the grip is not finite, and for a time constant after that, all
    is held: a filter that begins anew says for a moment that nothing is gripped.

    Parameters
    ----------
    compensator : Compensator
        Whose corrector tells the grip beside the joints (`Corrector.beside`).
    robot : Robot
        Whose cable mechanism says which joints open the jaws and how stiff they meet.
    load : str
        Name of the grip in `Corrector.beside`.
    time_constant : float
        With which the opening where jaws meet is followed [s], and for which all is held after
        samples that were not believed.

    Attributes
    ----------
    opening : float
        Wanted at the last step [rad].

    Raises
    ------
    CommandRefused
        If the robot states no jaws that meet, the corrector tells no grip or does not correct the
        jaws, or the time constant is shorter than two steps of the loop.

    Examples
    --------
    >>> robot = truejoint.get_robot("wrist")
    >>> from truejoint.runtime.uncorrected import Uncorrected  # joints as the motors say,
    >>> motors = Uncorrected(robot)  # and a gauge between the jaws
    >>> motors.beside["grip"] = np.array([0.02, 0.001])  # [Nm], kept up to date; its half-width
    >>> control = GripControl(Compensator(motors, robot), robot)
    >>> pieces = control.pieces(np.zeros((8, 3)), np.full(8, 0.05), rate=1000.0)
    >>> [len(piece) for piece in pieces]
    [4, 4]
    """

    def __init__(
        self,
        compensator: Compensator,
        robot: Robot,
        *,
        load: str = "grip",
        time_constant: float = 0.1,
    ) -> None:
        if not hasattr(compensator, "corrector"):
            advice = "Compensator(corrector, robot) makes one"
            raise CommandRefused(f"grip: {other_kind(compensator, 'Compensator', advice)}")
        corrector, mechanism = compensator.corrector, robot.mechanism
        if mechanism is None or mechanism.contact is None:
            raise CommandRefused(
                f"grip: {robot.title} states no jaws that meet; add [mechanism.contact]"
            )
        if load not in corrector.beside:
            known = ", ".join(corrector.beside) or "no load"
            raise CommandRefused(
                f"grip: the model tells {known}, not {load!r:.40}; calibrate one that is fitted to "
                "loads as well"
            )
        way = mechanism.row(mechanism.contact.opening)
        jaws = [name for name, part in zip(robot.joint_names, way, strict=True) if part]
        if missing := [name for name in jaws if name not in corrector.joints]:
            raise CommandRefused(f"grip: the model does not correct {', '.join(missing)}")
        if not 2.0 / compensator.rate <= time_constant < math.inf:
            raise CommandRefused(
                f"grip: a time constant of {time_constant} s; give {2.0 / compensator.rate:g} s, "
                "two steps of the loop, or more"
            )
        self._compensator, self._robot = compensator, robot
        self._grip = corrector.beside[load]
        self._gives = corrector.gives_way.get(load, np.zeros(len(corrector.joints)))
        self._way = way
        self._known_way = way[robot.index(corrector.joints)]
        self._stiffness = mechanism.contact.stiffness
        self._share = 1.0 / (1.0 + time_constant * compensator.rate)
        self._hold = round(time_constant * compensator.rate)  # steps after one not believed
        speeds = np.array([joint.max_speed for joint in robot.joints])
        self._step = float(np.abs(way) @ np.where(way, speeds, 0.0)) / compensator.rate
        reach = np.array([way * robot.lower, way * robot.upper])
        self._lowest = float(np.nan_to_num(reach.min(axis=0)).sum())
        self.opening = math.nan

    def pieces(self, wanted: ArrayLike, grip: ArrayLike, rate: float) -> Iterator[Array]:
        """Positions of all joints, a piece for each step, for `Compensator.setpoints`.

        Each is made when it is asked for, of what is known then of jaws and grip.

        Parameters
        ----------
        wanted : array_like, shape (n, n_joints)
            Positions [rad or m].
        grip : array_like, shape (n,)
            Torque of the jaws [Nm]; 0 where their opening shall be that of the positions.
        rate : float
            Of the rows, `Arm.rate` [Hz].

        Raises
        ------
        CommandRefused
            If there is no row, a row is not finite or of other joints, a torque is not finite or
            below 0, there is not one a row, or the rate is below that of the compensator.
        """
        rows = checked_rows(self._robot, floats(wanted, "grip", CommandRefused), "grip")
        torque = floats(grip, "grip", CommandRefused)
        if not len(rows) or torque.shape != rows.shape[:1]:
            raise CommandRefused(
                f"grip: torques of shape {torque.shape} for {len(rows)} rows of positions; give a "
                "row or more, and a torque for each"
            )
        if not ((torque >= 0.0) & (torque < math.inf)).all():
            raise CommandRefused("grip: a torque is not finite or below 0 Nm; give 0 Nm for none")
        period = round(rate / self._compensator.rate)
        if period < 1:
            raise CommandRefused(
                f"grip: {rate:g} rows a second for a loop at {self._compensator.rate:g} Hz; give "
                "rows at the arm's rate"
            )
        return self._pieces(rows, torque, period)

    def _pieces(self, rows: Array, torque: Array, period: int) -> Iterator[Array]:
        loop, gives, stiffness = self._compensator, self._gives, self._stiffness
        apart, unit = rows @ self._way, self._way / (self._way @ self._way)
        self.opening = met = float(apart[0])
        held = 0  # for so many steps more
        for first in range(0, len(rows), period):
            piece, goal = rows[first : first + period], float(torque[first])
            own = float(apart[first : first + period][-1])
            known, grip = float(loop.known @ self._known_way), float(self._grip[0])
            told = loop.believes and math.isfinite(known + grip)
            held = max(held - 1, 0) if told else self._hold
            if goal == 0.0:
                met = known if told else own
                loop.give_way(0.0 * gives, 0.0 * gives)
            elif held:
                own = self.opening
            else:
                met += self._share * (known + grip / stiffness - met)
                own = max(met - goal / stiffness, self._lowest)
                loop.give_way(grip * gives, goal * gives)
            before = self.opening
            self.opening = min(max(own, before - self._step), before + self._step)
            between = np.linspace(before, self.opening, len(piece) + 1)[1:]
            yield piece + (between - apart[first : first + period])[:, None] * unit
