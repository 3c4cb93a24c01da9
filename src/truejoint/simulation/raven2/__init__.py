"""The digital twin of a RAVEN-II arm."""

from truejoint.simulation.raven2.twin import Raven2Parameters, Raven2Twin

__all__ = ["Raven2Parameters", "Raven2Twin"]
