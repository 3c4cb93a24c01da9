"""Signals of a recording moved by a wrong zero, and how far each moves with it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from truejoint.array_types import Array

if TYPE_CHECKING:
    from truejoint.recordings import Recording

_SAME_SENSOR: Final = 1e-5  # of its range that a signal may be off a line through another


def shift_signals(recording: Recording, signals: Sequence[str], shift: Array) -> Recording:
    """Add to each of the `signals` its `shift` (n_signals,) in the signal's unit."""
    changed = {
        signal: recording.column(signal) + by
        for signal, by in zip(signals, shift, strict=True)
        if by
    }
    if not changed:
        return recording
    return replace(recording, table=recording.table.assign(**changed))


def signal_moves(
    recordings: Sequence[Recording], signals: Sequence[str], joints: Sequence[str]
) -> Array:
    """How far each signal moves with a joint's measured position (n_signals, n_joints).

    The measured position itself, and signals of its channel that are the same sensor's in another
    unit: on a straight line with it in all recordings.
    """
    moves = np.zeros((len(signals), len(joints)))
    for j, joint in enumerate(joints):
        measured = np.concatenate([r.column(f"measured/{joint}") for r in recordings])
        columns = np.column_stack([measured, np.ones_like(measured)])
        for i, signal in enumerate(signals):
            if signal.partition("/")[2] != joint:
                continue
            own = np.concatenate([recording.column(signal) for recording in recordings])
            line = np.linalg.lstsq(columns, own)[0]
            if np.abs(own - columns @ line).max() <= _SAME_SENSOR * np.ptp(own):
                moves[i, j] = 1.0 if signal == f"measured/{joint}" else line[0]
    return moves
