"""An arm that speaks CRTK's names, over interchangeable back ends."""

from truejoint.crtk.arm import Arm
from truejoint.crtk.backends.paced import LoopTiming, PacedBackend
from truejoint.crtk.backends.ros import RosBackend
from truejoint.crtk.backends.simulated import SimulatedBackend, simulated_arm
from truejoint.crtk.handle import Motion
from truejoint.crtk.planning import BLEND, TimeLaw, time_law
from truejoint.crtk.protocol import BLOCK_DURATION, Backend, Listener
from truejoint.crtk.ros import open_transport
from truejoint.crtk.states import STATE_COMMANDS, JointState, OperatingState
from truejoint.crtk.topics import TOPICS, check_topics
from truejoint.robots.blocks import StateBlock, TruthBlock

__all__ = [
    "BLEND",
    "BLOCK_DURATION",
    "STATE_COMMANDS",
    "TOPICS",
    "Arm",
    "Backend",
    "JointState",
    "Listener",
    "LoopTiming",
    "Motion",
    "OperatingState",
    "PacedBackend",
    "RosBackend",
    "SimulatedBackend",
    "StateBlock",
    "TimeLaw",
    "TruthBlock",
    "check_topics",
    "open_transport",
    "simulated_arm",
    "time_law",
]
