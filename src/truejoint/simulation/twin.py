"""Interface of every digital twin, and what twins share."""

import math
from collections.abc import Callable, Generator, Iterator, Sequence
from copy import deepcopy
from dataclasses import dataclass
from numbers import Integral
from typing import Any, ClassVar, Final

import numpy as np
from numpy.typing import ArrayLike

from truejoint.array_types import Array
from truejoint.errors import TruejointError
from truejoint.robots import Robot, blocks, get_robot
from truejoint.robots.blocks import SETPOINT_DT, StateBlock, TruthBlock
from truejoint.simulation.parameter_file import Parameters


@dataclass(frozen=True, eq=False, kw_only=True)
class TwinOutput(StateBlock):
    """Reports of a robot over a stretch of time, with the truth that no robot knows.

    Attributes
    ----------
    truth : TruthBlock
        Readings of the temporary joint encoders, on their own clock.
    joint : ndarray, shape (n, n_positioning)
        True positions of the positioning joints [rad or m].

    Examples
    --------
    >>> truejoint.simulation.make_twin("forceps", seed=1).home().t.size > 0
    True
    """

    truth: TruthBlock
    joint: Array

    def every(self, ticks: int) -> "TwinOutput":
        """Keep of `ticks` rows the last one, and all that the joint encoders read."""
        states = self.rows(slice(ticks - 1, None, ticks))
        joint = self.joint[ticks - 1 :: ticks].copy()
        return TwinOutput(**vars(states), truth=self.truth, joint=joint)


class Twin:
    """A virtual robot; its time passes only while `home`, `run` or `idle` run.

    The same seed and the same calls give the same numbers, bit for bit, and however a motion is
    cut into calls of `run`, it is the same motion. Inside, a twin integrates as finely as it
    needs. What else may act on it (a force at the tip over time, a grip) is an attribute of its
    own, set between calls, and what only a simulation can report goes into `StateBlock.extra`;
    so a twin with more joints, motors, sensors or loads needs nothing else from the arm.

    `parameters` are of its `PARAMETERS`, the nominal ones by default, `arm` and `robot` as in
    `truejoint.robots.get_robot`; `load` [kg] hangs on the tool. `truejoint.simulation.catalogue`
    lists the classes. Each has `_build`, `homing` and `_follow`, and counts set-points in `_ticks`.

    Raises TruejointError unless `seed` is a whole number of 63 bits and the load in range, or if
    the step cannot follow the parameters, and RobotError if the arm is unknown.

    Examples
    --------
    >>> truejoint.simulation.make_twin("forceps", seed=1).time
    0.0
    """

    ROBOT: ClassVar[str]
    PARAMETERS: ClassVar[type[Parameters]]
    MAX_LOAD: ClassVar[float]
    """Heaviest load [kg]."""
    _NOTED: ClassVar[tuple[str, ...]]
    """Attributes that `run` changes."""

    def __init__(
        self,
        parameters: Any = None,
        *,
        arm: str = "",
        seed: int = 0,
        load: float = 0.0,
        robot: str | Robot = "",
    ) -> None:
        if isinstance(seed, bool) or not (isinstance(seed, Integral) and 0 <= seed < 2**63):
            raise TruejointError(f"seed is {seed!r}; give a whole number from 0 to 2**63 - 1")
        self.parameters = self.PARAMETERS.read() if parameters is None else parameters
        self.robot: Robot = get_robot(robot or self.ROBOT, arm)
        self.seed: Final[int] = seed  # of everything random
        self.homing_count: int = 0
        self._ticks: int = 0
        self._streams: Sequence[np.random.Generator] = ()  # of the sensors
        self._reach: tuple[Array, Array] | None = None  # lowest and highest set-points (n_joints,)
        self._build()
        self.load = load

    def _build(self) -> None:
        """Make the plant and its sensors, of `parameters`, `robot` and `seed`."""
        raise NotImplementedError

    @property
    def load(self) -> float:
        """Mass that hangs on the tool [kg]; TruejointError beyond `MAX_LOAD`."""
        return self._load

    @load.setter
    def load(self, mass: float) -> None:
        self._load = self._checked_load(mass)

    def _checked_load(self, mass: float) -> float:
        if not 0.0 <= mass <= self.MAX_LOAD:  # also false for NaN
            raise TruejointError(f"load is {mass} kg; it must lie in [0, {self.MAX_LOAD:g}] kg")
        return float(mass)

    @property
    def time(self) -> float:
        """Time since the robot was switched on [s]."""
        return self._ticks * SETPOINT_DT

    def homing(self) -> Generator[TwinOutput]:
        """Register the encoders anew and go to the home pose; only the last rows mean something.

        In pieces of at most `GRAIN`, each run as it is asked for: one who asks for no more leaves
        the robot where it is, and not homed.
        """
        raise NotImplementedError

    def home(self) -> TwinOutput:
        """Give all of `homing` in one piece."""
        return TwinOutput.joined(list(self.homing()))

    def run(self, setpoint: ArrayLike) -> TwinOutput:
        """Follow set-points (n, n_joints) [rad or m], one every `SETPOINT_DT`; a row for each.

        Raises CommandRefused if the shape is wrong, or a value is not finite or beyond what the
        twin reaches, and TruejointError if the plant leaves the finite numbers.
        """
        return self._follow(self._checked(setpoint, "run"))

    def _checked(self, setpoint: ArrayLike, command: str) -> Array:
        rows = blocks.checked_rows(self.robot, setpoint, command)
        if self._reach is not None:
            blocks.check_range(self.robot, rows, command, self._reach)
        return rows

    def _follow(self, rows: Array) -> TwinOutput:
        """Follow checked set-points (n, n_joints) [rad or m]; gives a row for each."""
        raise NotImplementedError

    def idle(self, duration: float) -> None:
        """Let `duration` [s] pass with the brakes on; TruejointError if it is no time."""
        if not (math.isfinite(duration) and duration >= 0.0):
            raise TruejointError(f"duration is {duration}; give a finite number of seconds >= 0")
        self._ticks += round(duration / SETPOINT_DT)

    def saved(self) -> Callable[[], None]:
        """Note all that `run` changes; what is returned takes the twin back there, once."""
        values = {name: deepcopy(getattr(self, name)) for name in self._NOTED}
        states = [stream.bit_generator.state for stream in self._streams]

        def back() -> None:
            vars(self).update(values)
            for stream, state in zip(self._streams, states, strict=True):
                stream.bit_generator.state = state

        return back

    def _go(self, *paths: Array) -> Iterator[TwinOutput]:
        """Run set-points (n, n_joints), one path after the other, in pieces of at most `GRAIN`."""
        yield from map(self._follow, blocks.in_grains(np.vstack(paths)))

    def _times(self, rows: int) -> Array:
        """Give times (rows + 1,) [s]: now, and those of the next set-points."""
        return np.arange(self._ticks, self._ticks + rows + 1, dtype=np.float64) * SETPOINT_DT

    def _check_finite(self, log: Array, t: Array, step: str) -> None:
        """Refuse a plant whose rows (n, k) at times (n,) left the finite numbers."""
        if not np.isfinite(log).all():
            row = int(np.argmax(~np.isfinite(log).all(axis=1)))
            raise TruejointError(
                f"the simulated {self.robot.name} diverged at {t[row]:.3f} s; its parameters or "
                f"the force at the tip are beyond what {step} can follow"
            )


def shaped(values: ArrayLike, shape: tuple[int, ...], name: str) -> Array:
    """Return what a caller's function gave; TruejointError where it has another shape."""
    array = np.asarray(values, dtype=np.float64)
    if array.shape != shape:
        raise TruejointError(f"{name} gave shape {array.shape}; want {shape}, a row for each time")
    return array


def glide(start: Array, end: Array, duration: float) -> Array:
    """Set-points (n, n_joints) from `start` to `end` (n_joints,) in `duration` [s], half a cosine.

    This is how a homed robot leaves its stops (uw-biorobotics/raven2:src/raven/homing.cpp).
    """
    steps = round(duration / SETPOINT_DT)
    blend = 0.5 * (1.0 - np.cos(np.pi * np.arange(1, steps + 1) / steps))
    return np.asarray(start + blend[:, None] * (end - start))


def glide_at(speed: float, start: Array, end: Array) -> Array:
    """Set-points of `glide` in which no joint is faster than `speed` [rad/s or m/s]."""
    return glide(start, end, 0.1 + math.pi / 2 * float(abs(end - start).max()) / speed)


def hold(position: Array, duration: float) -> Array:
    """Set-points (n, n_joints) that stay at `position` (n_joints,) for `duration` [s]."""
    return np.tile(position, (round(duration / SETPOINT_DT), 1))
