"""Tests of truejoint.crtk.states."""

import pytest

from truejoint.crtk import STATE_COMMANDS, OperatingState
from truejoint.crtk.states import check_ready, next_state
from truejoint.errors import CommandRefused

STATES = ("DISABLED", "ENABLED", "PAUSED", "FAULT")

# The whole machine: state after each command, - where the command is refused.
ROWS = """
          enable   disable   pause   resume   home     unhome
DISABLED  ENABLED  DISABLED  -       -        -        DISABLED
ENABLED   ENABLED  DISABLED  PAUSED  ENABLED  ENABLED  ENABLED
PAUSED    -        DISABLED  PAUSED  ENABLED  -        PAUSED
FAULT     -        DISABLED  -       -        -        FAULT
"""
COMMANDS, *STATE_ROWS = (line.split() for line in ROWS.strip().splitlines())
TABLE = {
    (state, command): None if after == "-" else after
    for state, *row in STATE_ROWS
    for command, after in zip(COMMANDS, row, strict=True)
}


def test_table_is_complete():
    assert set(TABLE) == {(state, command) for state in STATES for command in STATE_COMMANDS}


@pytest.mark.parametrize("is_homed", [False, True])
@pytest.mark.parametrize(("state", "command"), TABLE)
def test_transitions(state, command, is_homed):
    now = OperatingState(state, is_homed, is_busy=False, t=3.0)
    target = TABLE[state, command]
    if target is None:
        with pytest.raises(CommandRefused, match=f"'{command}' refused: the arm is {state}; "):
            next_state(now, command)
        return
    after = next_state(now, command)
    assert after.state == target
    assert after.is_homed == {"home": True, "unhome": False}.get(command, is_homed)
    assert not after.is_busy
    assert after.t == 3.0


def test_a_busy_arm_may_be_stopped_and_not_homed():
    busy = OperatingState("ENABLED", is_homed=True, is_busy=True, t=0.0)
    for command in ("home", "unhome"):
        with pytest.raises(CommandRefused, match="busy"):
            next_state(busy, command)
    for command in ("pause", "disable"):
        assert next_state(busy, command).state != "ENABLED"


def test_unknown_command_names_the_known_ones():
    now = OperatingState("ENABLED", is_homed=True, is_busy=False, t=0.0)
    with pytest.raises(CommandRefused, match="'Enable' refused: unknown; send one of enable, dis"):
        next_state(now, "Enable")


@pytest.mark.parametrize(
    ("state", "is_homed", "is_busy", "advice"),
    [
        ("DISABLED", True, False, "send 'enable' first"),
        ("PAUSED", True, False, "send 'resume' first"),
        ("FAULT", True, False, "clear the fault"),
        ("ENABLED", False, False, "send 'home' first"),
        ("ENABLED", True, True, "wait for the move"),
    ],
)
def test_motion_needs_a_ready_arm(state, is_homed, is_busy, advice):
    now = OperatingState(state, is_homed, is_busy, t=0.0)
    with pytest.raises(CommandRefused, match=f"servo_jp refused: .*{advice}"):
        check_ready(now, "servo_jp")
