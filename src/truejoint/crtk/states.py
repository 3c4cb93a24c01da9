"""States of an arm, and CRTK's state machine: the commands allowed in each, and the next state."""

from dataclasses import dataclass, replace
from typing import Final, Literal, get_args

from truejoint.array_types import Array
from truejoint.errors import CommandRefused

State = Literal["DISABLED", "ENABLED", "PAUSED", "FAULT"]
StateCommand = Literal["enable", "disable", "pause", "resume", "home", "unhome"]
STATE_COMMANDS: Final[tuple[StateCommand, ...]] = get_args(StateCommand)

# Commands that change `state`: the states they are allowed in, and the state they lead to.
# Repeating a command that already took effect is allowed and changes nothing. A fault is the
# robot's to raise; `disable` is the one way out of it that an application has.
LEADS_TO: Final[dict[str, tuple[frozenset[State], State]]] = {
    "enable": (frozenset({"DISABLED", "ENABLED"}), "ENABLED"),
    "disable": (frozenset({"DISABLED", "ENABLED", "PAUSED", "FAULT"}), "DISABLED"),
    "pause": (frozenset({"ENABLED", "PAUSED"}), "PAUSED"),
    "resume": (frozenset({"PAUSED", "ENABLED"}), "ENABLED"),
}
_ENABLED: Final = frozenset[State]({"ENABLED"})
_WAY_OUT: Final[dict[State, str]] = {
    "DISABLED": "send 'enable' first",
    "ENABLED": "no command is needed",
    "PAUSED": "send 'resume' first",
    "FAULT": "clear the fault on the robot, then send 'disable' and 'enable'",
}


@dataclass(frozen=True)
class OperatingState:
    """CRTK's operating state: api-operating-state.rst of collaborative-robotics/documentation.

    Attributes
    ----------
    state : {"DISABLED", "ENABLED", "PAUSED", "FAULT"}
    is_homed : bool
        The motor encoders are registered to the joints: positions mean something.
    is_busy : bool
        A move or the homing is under way.
    t : float
        Time stamp on the robot's clock [s].

    Examples
    --------
    >>> arm.operating_state().is_homed
    True
    """

    state: State
    is_homed: bool
    is_busy: bool
    t: float

    @property
    def is_ready(self) -> bool:
        """Whether the arm takes motion commands: enabled and homed."""
        return self.state == "ENABLED" and self.is_homed


@dataclass(frozen=True, eq=False)
class JointState:
    """Joint state at one instant, in the robot's joint order.

    Attributes
    ----------
    t : float
        Time stamp on the robot's clock [s].
    name : tuple of str
    position, velocity : ndarray, shape (n_joints,)
        [rad or m], [rad/s or m/s].
    effort : ndarray, shape (n_joints,)
        Torque or force on the joint itself that the motors are commanded [Nm or N], as CRTK means
        it; empty where the robot states none.

    Examples
    --------
    >>> arm.measured_js().name[:2]
    ('shoulder', 'elbow')
    """

    t: float
    name: tuple[str, ...]
    position: Array
    velocity: Array
    effort: Array


def next_state(now: OperatingState, command: str) -> OperatingState:
    """State that one of `STATE_COMMANDS` leads to once carried out, with the time stamp of `now`.

    Raises CommandRefused if the command is unknown or not allowed now, saying what to send first;
    as in collaborative-robotics/documentation:docs/pages/api-operating-state.rst.
    """
    if command in LEADS_TO:
        allowed, target = LEADS_TO[command]
        _check(now, f"{command!r}", allowed)
        return replace(now, state=target)
    if command not in STATE_COMMANDS:
        raise CommandRefused(
            f"state command {command!r} refused: unknown; send one of {', '.join(STATE_COMMANDS)}"
        )
    if command == "home":
        _check(now, f"{command!r}", _ENABLED)
    _check_idle(now, f"{command!r}")
    return replace(now, is_homed=command == "home")


def check_ready(now: OperatingState, command: str) -> None:
    """Raise CommandRefused unless a motion command may be sent now."""
    _check(now, command, _ENABLED)
    if not now.is_homed:
        raise CommandRefused(f"{command} refused: the arm is not homed; send 'home' first")
    _check_idle(now, command)


def _check(now: OperatingState, command: str, allowed: frozenset[State]) -> None:
    if now.state not in allowed:
        raise CommandRefused(f"{command} refused: the arm is {now.state}; {_WAY_OUT[now.state]}")


def _check_idle(now: OperatingState, command: str) -> None:
    if now.is_busy:
        raise CommandRefused(f"{command} refused: the arm is busy; wait for the move to end")
