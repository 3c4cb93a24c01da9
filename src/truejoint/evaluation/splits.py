"""Held-out splits: whole recordings, or blocks of time with a gap; never shuffled samples.

Neighbouring samples of a motion are almost copies of each other. A split that shuffles them
puts the copies on both sides and measures memory rather than accuracy.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from truejoint.errors import RecordingError
from truejoint.recordings.datasets import Dataset, HeldOut
from truejoint.recordings.table.recording import Recording, as_recording

_GAP: Final = 1.0  # s between the two sides, so that no row of one has a neighbour on the other


def part_by_time(recording: Recording, begin: float, end: float) -> Recording:
    """Part of a recording between two fractions of its duration.

    Parameters
    ----------
    recording : Recording
    begin, end : float
        Fractions with ``0 <= begin < end <= 1``; a row at `begin` belongs to the part, a row at
        `end` only if `end` is 1, so that parts that meet share no row.

    Raises
    ------
    RecordingError
        If the fractions are out of range or the part would hold fewer than 2 rows.

    Examples
    --------
    >>> part_by_time(test, 0.0, 0.25).duration
    0.99
    """
    name = as_recording(recording).provenance.source or "recording"
    if not 0.0 <= begin < end <= 1.0:
        raise RecordingError(
            f"{name}: part {begin:g} to {end:g} is not within 0 to 1, in this order; choose other "
            "fractions of the duration"
        )
    done = (recording.t - recording.t[0]) / recording.duration
    rows = (done >= begin) & ((done < end) if end < 1.0 else True)
    if rows.sum() < 2:
        raise RecordingError(
            f"{name}: the part from {begin:g} to {end:g} of {recording.duration:.1f} s holds "
            f"{int(rows.sum())} rows; choose a longer part"
        )
    return recording.rows(rows)


def split_sides(
    recordings: Sequence[Recording], dataset: Dataset, split: HeldOut
) -> tuple[list[Recording], list[Recording]]:
    """Training and held-out side of all recordings of a data set's split, in its order.

    Examples
    --------
    >>> kuka = DATASETS["kuka_kr300_dual_encoder"]
    >>> training, testing = split_sides(recordings, kuka, kuka.split())  # doctest: +SKIP
    """
    if split.test:
        out = [split.holds_out(recording.name) for recording in dataset.match(split.files)]
        pairs = list(zip(recordings, out, strict=True))
        return [r for r, held in pairs if not held], [r for r, held in pairs if held]
    training, testing = [], []
    for recording in recordings:
        boundary = recording.t[0] + (1.0 - split.test_fraction) * recording.duration
        training.append(recording.rows(recording.t < boundary))
        testing.append(recording.rows(recording.t >= boundary + _GAP))
    return training, testing
