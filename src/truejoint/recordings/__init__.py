"""Recordings of an arm: one table with named columns, units and provenance."""

from truejoint.recordings.recording import Provenance, Recording

__all__ = ["Provenance", "Recording"]
