"""What an arm reports over a stretch of time, and the joint vectors that it is sent, checked."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, Final, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from truejoint.array_types import Array
from truejoint.errors import CommandRefused
from truejoint.robots.robot import Robot
from truejoint.units import shown, shown_range

QUANTITIES: Final = ("measured", "velocity", "effort", "setpoint", "motor", "motor_velocity")
"""Quantities of every channel in a state message, as far as the arm measures them."""
SETPOINT_DT: Final = 1e-3  # [s] between set-points: RAVEN's servo period (peng2024 IV-A)
ROUNDING: Final = 1e-9
"""Of a planned set-point that lies on a limit [rad or m]; far below any encoder's step."""
GRAIN: Final = 0.01
"""Longest piece of a motion [s]: what is asked meanwhile takes effect after it."""


@dataclass(frozen=True, eq=False)
class Block:
    """Consecutive rows of several things over time."""

    @classmethod
    def joined(cls, blocks: "Sequence[Block]") -> Self:
        """Put blocks of the same channels, one or more, one after the other."""
        parts = {each.name: [getattr(b, each.name) for b in blocks] for each in fields(cls)}
        return cls(**{name: _joined(values) for name, values in parts.items()})


def _joined(parts: Sequence[Any]) -> Any:
    """Join arrays, mappings of them and blocks; names are those of the first."""
    first = parts[0]
    if isinstance(first, Block):
        return type(first).joined(parts)
    if isinstance(first, Mapping):
        return {key: np.concatenate([part[key] for part in parts]) for key in first}
    return first if len(parts) == 1 or isinstance(first, tuple) else np.concatenate(parts)


@dataclass(frozen=True, eq=False)
class StateBlock(Block):
    """Consecutive state messages of an arm; every array is (n, n_channels) unless said.

    Attributes
    ----------
    t : ndarray, shape (n,)
        Time stamps on the robot's clock [s], strictly increasing.
    name : tuple of str
        The channels (`Robot.channels`); an unused channel is zero.
    measured, setpoint, velocity : ndarray
        Positions [rad or m] and speed [rad/s or m/s].
    effort : ndarray
        Torque command at the motor capstan [Nm]; (n, 0) where the robot measures none.
    motor, motor_velocity : ndarray
        Motor-shaft angle [rad] and speed [rad/s].
    extra : mapping of str to ndarray, shape (n,)
        Whatever else is read with the state, by its column in a recording: ``cable/drive``, a
        simulation's ``truth_load/jaw``.

    Examples
    --------
    >>> arm.measured_js().position.shape
    (7,)
    """

    t: Array
    name: tuple[str, ...]
    measured: Array
    velocity: Array
    effort: Array
    setpoint: Array
    motor: Array
    motor_velocity: Array
    extra: Mapping[str, Array] = field(default_factory=dict)

    def columns(self) -> dict[str, Array]:
        """Give what was measured, (n,) each, by its column in a recording: ``measured/<joint>``."""
        measured = {q: getattr(self, q) for q in QUANTITIES if getattr(self, q).shape[1]}
        by_name = {
            f"{q}/{c}": v[:, k] for q, v in measured.items() for k, c in enumerate(self.name)
        }
        return {**by_name, **self.extra}

    def rows(self, selection: slice | NDArray[np.bool_]) -> "StateBlock":
        """Copy of some rows, which keeps no other row alive."""
        return StateBlock(
            name=self.name,
            extra={name: values[selection].copy() for name, values in self.extra.items()},
            **{name: getattr(self, name)[selection].copy() for name in ("t", *QUANTITIES)},
        )


@dataclass(frozen=True, eq=False)
class TruthBlock(Block):
    """Consecutive readings of temporary joint encoders, with stamps of their own.

    Attributes
    ----------
    t : ndarray, shape (m,)
        Time stamps on the robot's clock [s], strictly increasing.
    name : tuple of str
        The joints that carry an encoder.
    position : ndarray, shape (m, len(name))
        [rad or m].

    Examples
    --------
    >>> TruthBlock(np.zeros(1), ("elbow",), np.zeros((1, 1))).name
    ('elbow',)
    """

    t: Array
    name: tuple[str, ...]
    position: Array


def in_grains(rows: Array, size: int = round(GRAIN / SETPOINT_DT)) -> Iterator[Array]:
    """Pieces of set-points (n, n_joints), at most `size` long: by default `GRAIN` of a twin's."""
    for start in range(0, len(rows), size):
        yield rows[start : start + size]


def checked_vector(robot: Robot, value: ArrayLike, command: str) -> Array:
    """Joint vector (n_joints,) as floats; raises CommandRefused on wrong shape or NaN."""
    return np.asarray(checked_rows(robot, np.asarray(value, dtype=float)[None], command)[0])


def checked_rows(robot: Robot, value: ArrayLike, command: str) -> Array:
    """Joint vectors (n, n_joints) as floats; raises CommandRefused on wrong shape or NaN."""
    rows = np.ascontiguousarray(value, dtype=float)
    if rows.ndim != 2 or rows.shape[1] != len(robot.joints):
        raise CommandRefused(
            f"{command} refused: got shape {rows.shape[1:]} per sample, want "
            f"{len(robot.joints)} values, one for each of {', '.join(robot.joint_names)}"
        )
    if not np.isfinite(rows).all():
        row, column = np.argwhere(~np.isfinite(rows))[0]
        raise CommandRefused(
            f"{command} refused: {robot.joints[column].name} is {rows[row, column]}"
            f"{at_sample(row, rows)}; send finite values in rad and m"
        )
    return rows


def check_range(
    robot: Robot, rows: Array, command: str, reach: tuple[Array, Array] | None = None
) -> None:
    """Raise CommandRefused if a position in `rows` (n, n_joints) is outside its joint's range.

    `reach` are the lower and upper ends of the ranges (n_joints,), by default the robot's limits.
    """
    lower, upper = (robot.lower, robot.upper) if reach is None else reach
    outside = (rows < lower - ROUNDING) | (rows > upper + ROUNDING)
    if outside.any():
        row, column = np.argwhere(outside)[0]
        joint = robot.joints[column]
        raise CommandRefused(
            f"{command} refused: {joint.name} at {shown(rows[row, column], joint.unit)}"
            f"{at_sample(row, rows)} is outside its range "
            f"{shown_range(lower[column], upper[column], joint.unit)}; stay inside, in rad and m"
        )


def at_sample(row: int, rows: Array) -> str:
    """Name the sample of a stream; nothing for a single command."""
    return f" at sample {row} of {len(rows)}" if len(rows) > 1 else ""
