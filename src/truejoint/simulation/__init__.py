"""Digital twins: robots that err the way the real ones do, compiled and deterministic."""

from truejoint.simulation.catalogue import make_twin
from truejoint.simulation.twin import Twin, TwinOutput

__all__ = ["Twin", "TwinOutput", "make_twin"]
