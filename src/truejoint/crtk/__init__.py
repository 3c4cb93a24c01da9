"""An arm that speaks CRTK's names, over interchangeable back ends."""

from truejoint.crtk.arm import Arm
from truejoint.crtk.backend import BLOCK_DURATION, SERVO_RATE, Backend, Listener
from truejoint.crtk.messages import JointState, OperatingState, StateBlock, TruthBlock
from truejoint.crtk.planning import BLEND, TimeLaw, time_law
from truejoint.crtk.simulated import SimulatedBackend, simulated_arm
from truejoint.crtk.states import STATE_COMMANDS

__all__ = [
    "BLEND",
    "BLOCK_DURATION",
    "SERVO_RATE",
    "STATE_COMMANDS",
    "Arm",
    "Backend",
    "JointState",
    "Listener",
    "OperatingState",
    "SimulatedBackend",
    "StateBlock",
    "TimeLaw",
    "TruthBlock",
    "simulated_arm",
    "time_law",
]
