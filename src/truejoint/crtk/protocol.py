"""Interface between an `Arm` and a robot, simulated or real."""

from collections.abc import Callable
from typing import Final, Protocol

from truejoint.array_types import Array
from truejoint.crtk.states import OperatingState, StateCommand
from truejoint.robots import Robot
from truejoint.robots.blocks import StateBlock as StateBlock  # noqa: PLC0414  # a name of the package
from truejoint.robots.blocks import TruthBlock as TruthBlock  # noqa: PLC0414

BLOCK_DURATION: Final = 10.0
"""Longest stretch that a back end executes or reports in one block [s]."""

STRETCH: Final = 0.5  # [s], piece of a motion that a robot in real time is sent at once
ARRIVAL: Final = 2.0  # [s] that joints may take to come to the last set-point
SILENCE: Final = 1.0  # [s] without a message, after which an arm, or a topic, counts as silent

Listener = Callable[[StateBlock | TruthBlock], None]


class Backend(Protocol):
    """A robot arm that executes what an `Arm` has already checked.

    Calls block until the robot has done what they ask, in the robot's own time: a simulation
    returns as soon as it is computed, a real arm when it is over. While the arm is homed, its
    measurements reach the connected listener as blocks in time order, none longer than
    `BLOCK_DURATION`; a back end with threads delivers them one at a time.

    ``pause`` and ``disable`` may come from another thread while a call blocks; `state_command` and
    `servo_jp` are then over within `grain`, and say so by CommandRefused. As soon is `servo_jp`
    over when ``go_on()`` is false, which may also be asked for by another thread.

    An `Arm` refuses a `rate` that is no finite number above 0, and a `grain` shorter than a period
    of it or longer than 20 ms: an arm must be stopped sooner.
    """

    @property
    def robot(self) -> Robot:
        """The arm behind."""

    @property
    def rate(self) -> float:
        """Set-points that the robot takes a second [Hz], and the most state messages it sends."""

    @property
    def grain(self) -> float:
        """Longest time that `servo_jp` goes on without asking whether it shall [s]."""

    @property
    def stretch(self) -> float:
        """Longest piece of a motion [s] to send at once; its state is looked at in between."""

    @property
    def time(self) -> float:
        """Now, on the robot's clock [s]."""

    @property
    def homing_id(self) -> str:
        """Name of the homing that positions count from; empty where the robot knows none."""

    def connect(self, listener: Listener) -> None:
        """Deliver all blocks from now on to `listener`.

        Raises CommandRefused while there is another: one arm has one controller.
        """

    def disconnect(self) -> None:
        """Deliver no more blocks, so that another may connect."""

    def operating_state(self) -> OperatingState:
        """State as the robot reports it."""

    def state_command(self, command: StateCommand, timeout: float) -> None:
        """Carry out a state command; returns once the robot reports the new state.

        Raises CommandRefused, saying why, if the robot does not get there within `timeout` [s] of
        its clock.
        """

    def servo_jp(self, position: Array, go_on: Callable[[], bool]) -> int:
        """Stream set-points (n, n_joints) [rad or m] at `rate`; returns when more may come.

        Checked against state and limits by the arm. While ``go_on()``, asked at least every
        `grain` of the robot's clock, and before any of it passes unseen by other threads; gives
        how many set-points were taken until then. Without more the arm holds the last one.
        """

    def flush(self, timeout: float = ARRIVAL, go_on: Callable[[], bool] = lambda: True) -> str:
        """Return once the last set-point has been executed, or after `timeout` [s].

        Gives in words what has not arrived by then; empty where all has, or once ``go_on()``, asked
        as often as by `servo_jp`, is false.
        """

    def wait(self, duration: float) -> None:
        """Let `duration` [s] pass with the brakes on; the arm holds its position."""
