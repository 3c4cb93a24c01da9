"""The digital twin of a RAVEN-II arm."""

from truejoint.simulation.raven2.parameters import TwinParameters
from truejoint.simulation.raven2.twin import Raven2Twin, TwinOutput

__all__ = ["Raven2Twin", "TwinOutput", "TwinParameters"]
