"""CRTK's state machine: which command is allowed in which state, and where it leads."""

from __future__ import annotations

from dataclasses import replace
from typing import Final, Literal, get_args

from truejoint.crtk.messages import OperatingState, State
from truejoint.errors import CommandRefused

StateCommand = Literal["enable", "disable", "pause", "resume", "home", "unhome"]
STATE_COMMANDS: Final[tuple[StateCommand, ...]] = get_args(StateCommand)

# Commands that change `state`: the states they are allowed in, and the state they lead to.
# Repeating a command that already took effect is allowed and changes nothing. A fault is the
# robot's to raise; `disable` is the one way out of it that an application has.
_LEADS_TO: Final[dict[str, tuple[frozenset[State], State]]] = {
    "enable": (frozenset({"DISABLED", "ENABLED"}), "ENABLED"),
    "disable": (frozenset({"DISABLED", "ENABLED", "PAUSED", "FAULT"}), "DISABLED"),
    "pause": (frozenset({"ENABLED", "PAUSED"}), "PAUSED"),
    "resume": (frozenset({"PAUSED", "ENABLED"}), "ENABLED"),
}
_WAY_OUT: Final[dict[State, str]] = {
    "DISABLED": "send 'enable' first",
    "ENABLED": "no command is needed",
    "PAUSED": "send 'resume' first",
    "FAULT": "clear the fault on the robot, then send 'disable' and 'enable'",
}


def next_state(now: OperatingState, command: str) -> OperatingState:
    """State that `command` leads to once it has been carried out.

    Parameters
    ----------
    now : OperatingState
    command : str
        One of `STATE_COMMANDS`.

    Returns
    -------
    OperatingState
        With the time stamp of `now`.

    Raises
    ------
    CommandRefused
        If the command is unknown or not allowed now; the message says what to send first.

    References
    ----------
    collaborative-robotics/documentation:docs/pages/api-operating-state.rst
    """
    if command in _LEADS_TO:
        allowed, target = _LEADS_TO[command]
        if now.state not in allowed:
            raise CommandRefused(
                f"{command!r} refused: the arm is {now.state}; {_WAY_OUT[now.state]}"
            )
        return replace(now, state=target)
    if command == "home":
        if now.state != "ENABLED":
            raise CommandRefused(f"'home' refused: the arm is {now.state}; {_WAY_OUT[now.state]}")
        if now.is_busy:
            raise CommandRefused("'home' refused: the arm is busy; wait for the move to end")
        return replace(now, is_homed=True)
    if command == "unhome":
        if now.is_busy:
            raise CommandRefused("'unhome' refused: the arm is busy; wait for the move to end")
        return replace(now, is_homed=False)
    raise CommandRefused(
        f"state command {command!r} refused: unknown; send one of {', '.join(STATE_COMMANDS)}"
    )


def check_ready(now: OperatingState, command: str) -> None:
    """Raise CommandRefused unless a motion command may be sent now."""
    if now.state != "ENABLED":
        raise CommandRefused(f"{command} refused: the arm is {now.state}; {_WAY_OUT[now.state]}")
    if not now.is_homed:
        raise CommandRefused(f"{command} refused: the arm is not homed; send 'home' first")
    if now.is_busy:
        raise CommandRefused(f"{command} refused: the arm is busy; wait for the move to end")
