"""Digital twins: robots that err the way the real ones do, compiled and deterministic."""

from truejoint.simulation.raven2_twin import Raven2Twin, TwinOutput
from truejoint.simulation.twin_parameters import TwinParameters

__all__ = ["Raven2Twin", "TwinOutput", "TwinParameters"]
