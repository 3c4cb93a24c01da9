"""The digital twin of a dVRK PSM."""

from truejoint.simulation.dvrk_psm.twin import DvrkPsmParameters, DvrkPsmTwin

__all__ = ["DvrkPsmParameters", "DvrkPsmTwin"]
