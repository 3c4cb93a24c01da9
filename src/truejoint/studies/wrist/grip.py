"""Loops around an instrument that foresee what is lost, and close its jaws until they grip."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from truejoint.array_types import Array
from truejoint.calibration import Calibration
from truejoint.features.feature_set import feature_row
from truejoint.robots import Robot
from truejoint.runtime import Compensator, Corrector
from truejoint.runtime.compensation import LAYOUT

_LEAD: Final = LAYOUT.fields["lead"].index
_DOUBTED: Final = LAYOUT.fields["doubted"].index
_GAIN: Final = 0.4  # share of what is missing that a foreseen set-point moves on by, at every step
_MEETING: Final = 0.1  # [s] time constant of the opening at which the jaws meet


class ForwardLoop(Compensator):
    """A compensator that makes up at once for what it foresees to be lost.

    At a reversal, motors run through play before a joint follows. The calibration `still`, of
    measured positions alone, says at each set-point how much; its plays remember the way of the
    set-points. A grip winds up cables by a way that the corrector knows (`Corrector.gives_way`).
    """

    def __init__(
        self, corrector: Corrector, robot: Robot, still: Calibration | None, **how: Any
    ) -> None:
        self._still = still
        super().__init__(corrector, robot, **how)
        if still is not None:
            self._signals = _signals(still, robot)

    def start(self, setpoint: ArrayLike) -> None:
        """Begin at rest from set-points (n_joints,) [rad or m] that the arm already has."""
        super().start(setpoint)
        self._ways = np.zeros((3, len(self.setpoint)))  # by a grip: now, ahead, as wanted last
        self._foreseen, self._lost_there = (
            np.array(setpoint, dtype=float),
            np.zeros(len(self.joints)),
        )
        self._last, self._t = np.full(len(self.joints), np.nan), 0.0
        if self._still is not None:
            self._now, self._ahead = _Play(self._still), _Play(self._still)

    def give_way(self, now: Array, wanted: Array) -> None:
        """Wind up, from now on, by how far joints (n_joints,) [rad or m] give way to a grip.

        `now` is the way by the grip that the corrector knows, `wanted` that by the next one.
        """
        lead = self.memory.memory[_LEAD] * (wanted - self._ways[2])  # as set-points do
        self._ways[:] = now, wanted + lead, wanted

    def step(self, t: float, sample: ArrayLike, wanted: ArrayLike) -> Array:
        """Set-points (n_joints,) for where the joints are `wanted` (n_joints,) at the next step."""
        goal, lost = np.asarray(wanted, dtype=float), np.zeros((2, len(self.joints)))
        if self._still is not None:
            last = np.where(np.isfinite(self._last), self._last, goal)
            there = goal + self.memory.memory[_LEAD] * (goal - last)
            here = np.asarray(sample, dtype=float)[self.measured]
            self._t += 1.0 / self.rate
            lost[0] = self._now.lost(self._t, self._signals @ here)
            if self._t > 1.0 / self.rate:
                self._foreseen += _GAIN * (there - self._foreseen - self._lost_there)
            lost[1] = self._lost_there = self._ahead.lost(self._t, self._signals @ self._foreseen)
            self._last = goal
        self.expected[:], self.forward[:] = self._ways[:2] + lost
        return super().step(t, sample, wanted)


class _Play:
    """A calibration that says of every sample what its joints lose, where a corrector doubts."""

    def __init__(self, still: Calibration) -> None:
        self._still, size = still, (len(still.feature_set), len(still.joints))
        self._memory, self._row = still.family.memory(still.fitted, *size), np.empty(size[0])
        self._history, self._clock = np.zeros(still.feature_set.memory_size), np.zeros(2)

    def lost(self, t: float, signals: Array) -> Array:
        """Give true less measured positions (n_joints,) of a sample at `t` [s]."""
        still, memory = self._still, self._memory
        last, error = float(self._clock[1]), np.empty(len(still.joints))
        values = signals + still.signal_shift
        fresh = feature_row(
            *still.feature_set.program, still.gap_limit, t, values, self._history, self._clock,
            self._row,
        )  # fmt: skip
        dt, half_widths = 0.0 if fresh else t - last, np.full(len(error), np.inf)
        still.family.row(memory.numbers, memory.memory, dt, self._row, error, half_widths)
        measured = signals[[still.signals.index(f"measured/{joint}") for joint in still.joints]]
        return measured + (error + still.output_shift) - measured


def _signals(still: Calibration, robot: Robot) -> Array:
    """Each signal of a calibration (n_signals, n_joints), measured or a motor's, per position."""
    quantities = [signal.split("/") for signal in still.signals]
    matrices = {"measured": np.eye(len(robot.joints))}
    if robot.transmission is not None:
        matrices["motor"] = robot.transmission.matrix
    rows = [matrices[kind][robot.joint_names.index(name)] for kind, name in quantities]
    return np.array(rows)[:, robot.index(still.joints)]


def gripping(
    loop: ForwardLoop, robot: Robot, rows: Array, torque: Array, rate: float
) -> Iterator[Array]:
    """Positions of all joints, a piece for each step of a loop, that close jaws until they grip.

    Jaws that give way by ``grip / stiffness`` beyond the opening at which they meet something are
    closed by that much: ``opening = met - wanted / stiffness``, where `met` follows ``known opening
    + known grip / stiffness``. An error of the opening is in both, and what remains is the error of
    the grip. Where no grip is wanted, the opening is that of the positions. All is held while the
    loop doubts its samples and for a time constant after that.

    `rows` (n, n_joints) [rad] and `torque` (n,) [Nm] are wanted at `rate` [Hz].
    """
    corrector, mechanism = loop.corrector, robot.mechanism
    assert isinstance(corrector, Corrector)  # noqa: S101
    assert mechanism is not None and mechanism.contact is not None  # noqa: S101, PT018
    way, stiffness = mechanism.row(mechanism.contact.opening), mechanism.contact.stiffness
    known_way, grips = way[robot.index(corrector.joints)], corrector.beside["grip"]
    gives = corrector.gives_way.get("grip", np.zeros(len(corrector.joints)))
    share, hold = 1.0 / (1.0 + _MEETING * loop.rate), round(_MEETING * loop.rate)
    speeds = np.array([joint.max_speed for joint in robot.joints])
    longest = float(np.abs(way) @ np.where(way, speeds, 0.0)) / loop.rate
    reach = np.array([way * robot.lower, way * robot.upper])
    lowest = float(np.nan_to_num(reach.min(axis=0)).sum())
    measured, correction = loop.memory.view("measured"), loop.memory.view("correction")
    last = loop.memory.view("last_wanted")
    opening_rows, unit = rows @ way, way / (way @ way)
    opening = met = float(opening_rows[0])
    held, period = 0, round(rate / loop.rate)
    for first in range(0, len(rows), period):
        piece, goal = rows[first : first + period], float(torque[first])
        wanted = float(opening_rows[first : first + period][-1])
        position = np.where(np.isnan(last), math.nan, measured + correction)
        opened, grip = float(position @ known_way), float(grips[0])
        is_doubted = int(loop.status) & int(loop.memory.numbers[_DOUBTED])
        is_believed = not is_doubted and bool(np.isfinite(correction).all())
        is_sure = is_believed and math.isfinite(opened + grip)
        held = max(held - 1, 0) if is_sure else hold
        if goal == 0.0:
            met = opened if is_sure else wanted
            loop.give_way(0.0 * gives, 0.0 * gives)
        elif held:
            wanted = opening
        else:
            met += share * (opened + grip / stiffness - met)
            wanted = max(met - goal / stiffness, lowest)
            loop.give_way(grip * gives, goal * gives)
        before = opening
        opening = min(max(wanted, before - longest), before + longest)
        between = np.linspace(before, opening, len(piece) + 1)[1:]
        yield piece + (between - opening_rows[first : first + period])[:, None] * unit
