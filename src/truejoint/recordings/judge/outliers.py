"""Rows that step away from what the robot's signals explain, and come back, or stay."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from truejoint.array_types import Array, Integers, Mask
from truejoint.recordings.join.explained import SLOW, Explained, explain
from truejoint.recordings.table.recording import Recording
from truejoint.recordings.table.signals import gaps
from truejoint.threads import one_thread

_STEP: Final = 5.0  # spreads of the residual
_STEP_OF_SLOW: Final = 8.0  # where rows are far apart, honest ones step too
_BACK: Final = 0.7  # of that step, from where it left
_NEAR: Final = 10  # rows that show the level on either side of a step that stays
_LONGEST: Final = 60  # rows for which a burst lasts at most, or 1 s, and a step that stays at least
FEWEST: Final = 50  # rows with truth of which something can be said


@dataclass(frozen=True, eq=False)
class Steps:
    """Rows of one recording that do not belong to their neighbours."""

    outliers: Integers  # (m,), rising
    size: Array  # (m,), how far those are off, of either sign [unit of the column]
    stays: Integers  # (k,), rows from which on the level is another
    rise: Array  # (k,), by how much


def find_steps(recording: Recording, explained: Explained, share: float = 1.0) -> Steps:
    """Outliers, rows between two opposite steps of the residual, and steps without a way back.

    What steps away and creeps back, as friction does, is no outlier. `share` scales the step that
    counts.
    """
    residual = explained.residual(recording)
    finite = np.flatnonzero(np.isfinite(residual))
    t, level = recording.t[finite], residual[finite]
    dt = float(np.median(np.diff(t)))
    limit = share * explained.spread * (_STEP_OF_SLOW if dt > SLOW else _STEP)
    longest = max(_LONGEST, round(1.0 / dt))
    step = np.diff(level)
    step[gaps(t)] = 0.0
    far = np.abs(step) > limit
    bad = np.zeros(len(level), dtype=np.bool_)
    stays = []
    judged = 0
    for before in np.flatnonzero(far).tolist():
        if before < judged:
            continue
        behind = level[before + 1 : before + 2 + longest]
        back = np.flatnonzero(np.abs(behind - level[before]) < _BACK * limit)
        if len(back) and far[before + back[0]]:
            judged = before + int(back[0]) + 1
            bad[before + 1 : judged] = True
        elif (len(back) == 0 or back[0] >= _LONGEST) and before + 1 + _LONGEST < len(level):
            near = level[max(0, before + 1 - _NEAR) : before + 1], behind[:_NEAR]
            if abs(np.median(near[0]) - np.median(near[1])) < _BACK * limit:
                continue
            stays.append(before + 1)
            judged = before + 1 + _LONGEST
    rows, good = np.flatnonzero(bad), np.flatnonzero(~bad)
    size = level[rows] - np.interp(rows, good, level[good])
    rise = np.array([level[k : k + _LONGEST].mean() - level[k - 1] for k in stays])
    return Steps(finite[rows], size, finite[np.array(stays, dtype=np.int64)], rise)


def gross_outliers(recordings: Sequence[Recording], joint: str) -> list[Mask]:
    """Rows (n,) of each recording whose truth minus measured of `joint` is grossly off."""
    enough = [r for r in recordings if np.isfinite(r.column(f"truth/{joint}")).sum() >= FEWEST]
    with one_thread():  # of a few thousand rows
        explained = explain(enough, joint) if enough else None
    masks = []
    for recording in recordings:
        mask = np.zeros(len(recording), dtype=np.bool_)
        if explained is not None and recording in enough:
            mask[find_steps(recording, explained).outliers] = True
        masks.append(mask)
    return masks
