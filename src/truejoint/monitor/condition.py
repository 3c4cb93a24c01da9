"""How an arm, or the recording of one, stands, in words for the page."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Self

from truejoint.crtk.arm import Arm
from truejoint.crtk.states import check_ready
from truejoint.errors import TruejointError


@dataclass(frozen=True)
class Condition:
    """How an arm, or the recording of one, stands.

    Examples
    --------
    >>> Condition.of(arm).state
    'ENABLED'
    """

    state: str  # in a word or two: ``"ENABLED"``, ``"no answer"``
    reason: str = ""  # why it takes no commands, or reports nothing new; empty where all is well
    is_fresh: bool = True  # whether the latest sample is of now
    t: float = math.nan  # now, on the robot's clock [s]; NaN if it does not say

    @classmethod
    def of(cls, arm: Arm) -> Self:
        """Ask an arm; one that does not answer is in a condition as well, never an error."""
        try:
            now = arm.operating_state()
        except Exception as error:  # noqa: BLE001  # whatever a back end raises is told
            return cls("no answer", " ".join(str(error).split()) or type(error).__name__, False)
        if now.is_busy and not now.is_homed:
            return cls("homing", "positions mean nothing before it is homed", False, now.t)
        reasons = []
        try:
            check_ready(replace(now, is_busy=False), "motion")
        except TruejointError as error:
            reasons.append(_without_command(error).removeprefix(f"the arm is {now.state}; "))
        try:
            arm.measured_js()
        except Exception as error:  # noqa: BLE001
            reasons.append(_without_command(error))
            return cls(now.state, reasons[0], False, now.t)
        state = f"{now.state}, moving" if now.is_busy else now.state
        return cls(state, "".join(reasons[:1]), True, now.t)


def _without_command(error: Exception) -> str:
    """Give what an arm says, without the name of the command that it refused."""
    text = " ".join(str(error).split()) or type(error).__name__
    return text.partition(" refused: ")[2] or text
