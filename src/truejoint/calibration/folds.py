"""What a fit does not see in turn: whole recordings, or parts of one with a gap around them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from truejoint.array_types import Array, Integers, Mask
from truejoint.calibration.compatibility import source_of
from truejoint.calibration.conditions import SPEED_TIME, conditions_of
from truejoint.calibration.rows import Rows
from truejoint.errors import CalibrationError
from truejoint.estimators.polynomial.learn import levels
from truejoint.features.feature_set import sample_dt
from truejoint.recordings import Recording

FOLDS: Final = 5  # of one kind, at most
FEW: Final = 3  # recordings; fewer are not left out whole
SORTED_FROM: Final = 10  # recordings; so many tell fast from slow and light from heavy ones

GAP: Final = 0.1  # of the time of a part, that is left out on either side of it
_AT_REST: Final = 0.05  # of the RMS speed of a joint, below which it counts as standing still
_LEAST_ROWS: Final = 10  # of a part
_LEAST_LEFT: Final = 0.2  # of the time in all, that a fit sees beside a recording left out whole
_DIFFERENT: Final = 0.1  # logarithm of the largest speed or effort over the least
_RUNS: Final = 8  # of speeds or efforts that come in no levels
_EACH: Final = 2  # folds that a quantity is left out in, at least, where it has so many levels


@dataclass(frozen=True)
class Part:
    """Rows ``first:end`` of a recording, which is given by its index."""

    recording: int
    first: int
    end: int


@dataclass(frozen=True)
class Fold:
    """Parts that one fit does not see, and what they have in common."""

    name: str
    parts: tuple[Part, ...]
    is_inside: bool = False  # whether the fit sees other parts of the same recordings

    @property
    def recordings(self) -> list[int]:
        """Indices of the recordings that it has parts of."""
        return sorted({part.recording for part in self.parts})


def without(rows: Sequence[Rows], parts: Sequence[Part]) -> list[Rows]:
    """Hide the truth of `parts` of recordings, and of a gap around each.

    What they cover altogether is left out. Positions and efforts stay, so that features with a
    memory are as they were.
    """
    hidden = [hidden_rows(each.t, parts, index) for index, each in enumerate(rows)]
    pairs = zip(rows, hidden, strict=True)
    return [each.hide(mask) if mask.any() else each for each, mask in pairs if not mask.all()]


def hidden_rows(t: Array, parts: Sequence[Part], index: int, gap: float = GAP) -> Mask:
    """Rows (n,), at `t` (n,) [s], of the parts of one recording, and of a gap around each."""
    hidden = np.zeros(len(t), dtype=bool)
    for part in (part for part in parts if part.recording == index):
        first, last = t[part.first], t[part.end - 1]
        around = gap * (last - first)
        hidden |= (t >= first - around) & (t <= last + around)
    return hidden


def wholes(recordings: Sequence[Recording]) -> list[Part]:
    """Every recording as one part."""
    return [Part(index, 0, len(recording)) for index, recording in enumerate(recordings)]


def blocks(recordings: Sequence[Recording], count: int, *, in_motion: bool = False) -> list[Part]:
    """Every recording in `count` parts of equal time, one recording after the other.

    Or, `in_motion`, of equal time in which a joint moves, where each then holds ten rows. Raises
    CalibrationError if one would hold fewer than ten rows.
    """
    parts = []
    for index, recording in enumerate(recordings):
        marks = _marks(recording.t, count)
        if min(np.diff(marks)) < _LEAST_ROWS:
            raise CalibrationError(
                f"{source_of(recording)}: {len(recording)} rows are too few to leave out a "
                f"{count}th at a time; record for longer, or leave it out where there are others"
            )
        if in_motion:
            every = max(1, round(SPEED_TIME / sample_dt([recording])))
            rows = np.union1d(np.arange(0, len(recording), every), len(recording) - 1)
            q = recording.columns("measured", recording.joints_of("measured"))[rows]
            dt = np.diff(recording.t[rows])
            speeds = np.abs(np.diff(q, axis=0)) / dt[:, None]
            usual = np.sqrt(np.mean(speeds**2, axis=0))
            moves = ((speeds > _AT_REST * usual) & (usual > 0.0)).any(axis=1)
            moved = np.concatenate([[0.0], np.cumsum(np.where(moves, dt, 0.0))])
            by_motion = _marks(np.interp(np.arange(len(recording)), rows, moved), count)
            if min(np.diff(by_motion)) >= _LEAST_ROWS:
                marks = by_motion
        parts += [Part(index, *marks[i : i + 2]) for i in range(count)]
    return parts


def _marks(course: Array, count: int) -> list[int]:
    """First row of each of `count` equal parts of what never falls (n,), and the number of rows."""
    edges = course[0] + (course[-1] - course[0]) * np.arange(1, count) / count
    return [0, *np.searchsorted(course, edges).tolist(), len(course)]


def dealt(units: Sequence[Sequence[Part]], name: str) -> list[Fold]:
    """Deal units of parts out to `FOLDS` folds at most: the first to the first, and so on."""
    count = min(FOLDS, len(units))
    return [
        Fold(f"{name} {k + 1}", tuple(part for unit in units[k::count] for part in unit))
        for k in range(count)
    ]


def inside(recordings: Sequence[Recording], numbers: Sequence[int]) -> list[Fold]:
    """Leave out fifths of the time in motion, of recordings of these numbers all at once."""
    shares = blocks([recordings[i] for i in numbers], FOLDS, in_motion=True)
    parts = [replace(share, recording=numbers[share.recording]) for share in shares]
    units = [tuple(parts[k::FOLDS]) for k in range(FOLDS)]
    return [Fold(f"time {k + 1}", unit, is_inside=True) for k, unit in enumerate(units)]


def enough_beside(recordings: Sequence[Recording], groups: Sequence[Sequence[int]]) -> Mask:
    """Beside which groups (n_groups,) of recordings a fit sees a fifth of the time in all."""
    times = np.array([recording.duration for recording in recordings])
    without = times.sum() - np.array([times[list(group)].sum() for group in groups])
    return np.asarray(without >= _LEAST_LEFT * times.sum())


def folds(recordings: Sequence[Recording]) -> list[Fold]:
    """Give what an automatic choice leaves out in turn: never single rows.

    One or two recordings lose a fifth of the time in which they move, so that no part is at rest;
    two or more are left out whole, but not one beside which less than a fifth of the time stays:
    what a fit to so little does, the one that is used will not. Of three or more that one loses
    fifths in their stead. Ten or more are left out by how fast they move and by how large their
    efforts are, a fifth at a time, so that an estimator shows what it does beyond them; those of
    one speed, or under one load, all at once (`truejoint.estimators.polynomial.learn.levels`).
    Where several homings, or masses on the tool, are stated, these are left out too.
    """
    parts, left_out = wholes(recordings), list[Fold]()
    enough = enough_beside(recordings, [[part.recording] for part in parts])
    if len(recordings) < FEW or not enough.all():
        cut = range(len(recordings)) if len(recordings) < FEW else np.flatnonzero(~enough).tolist()
        left_out = inside(recordings, cut)
    uncut = [part for part in parts if enough[part.recording]]
    if len(recordings) < FEW:
        return left_out + dealt([[part] for part in uncut], "recordings")
    by_kind = dict[str, list[list[Part]]]()
    if len(recordings) >= SORTED_FROM:
        for name, quantity in (("speed", "measured"), ("effort", "effort")):
            if np.ptp(sizes := _sizes(recordings, quantity)) > 0.0:
                by_kind[name] = [[parts[i] for i in group] for group in levels(sizes)]
    stated: dict[str, Sequence[str | float | None]] = {
        "homing": [recording.provenance.homing_id or None for recording in recordings],
        "load": [None if math.isnan(r.provenance.load) else r.provenance.load for r in recordings],
    }
    for name, values in stated.items():
        different = list(dict.fromkeys(value for value in values if value is not None))
        if 2 <= len(different) < len(parts):  # some have the same
            pairs = list(zip(parts, values, strict=True))
            by_kind[name] = [[part for part, v in pairs if v == value] for value in different]
    if not any(by_kind.values()):
        by_kind["recordings"] = [[part] for part in parts]
    for name, units in by_kind.items():
        usable = [[part for part in unit if enough[part.recording]] for unit in units]
        left_out += dealt([unit for unit in usable if unit], name)
    return left_out


def levels_by_quantity(recordings: Sequence[Recording]) -> list[list[Integers]]:
    """Places of the recordings of each level, from the least to the largest, of each quantity.

    Quantities are speed and the size of efforts, where these differ by a tenth or more, and a
    stated mass; levels are as `truejoint.estimators.polynomial.learn.levels` finds them, or eight
    runs of as many speeds or efforts. One that parts the recordings as another is none.
    """
    loads = np.array([recording.provenance.load for recording in recordings])
    by_groups: dict[frozenset[frozenset[int]], list[Integers]] = {}
    for sizes in (_sizes(recordings, "measured"), _sizes(recordings, "effort"), loads):
        if not np.isfinite(sizes).all() or (sizes is not loads and np.ptp(sizes) < _DIFFERENT):
            continue
        alike = levels(sizes, len(sizes))
        if len(alike) == len(sizes):
            if sizes is loads:
                continue
            alike = np.array_split(np.argsort(sizes, kind="stable"), _RUNS)
        by_groups.setdefault(frozenset(frozenset(level.tolist()) for level in alike), alike)
    return list(by_groups.values())


def without_levels(
    recordings: Sequence[Recording], kinds: Sequence[Sequence[Integers]]
) -> list[Fold]:
    """Leave out in turn the levels between others of each kind, as `levels_by_quantity` gives.

    Five folds, or six where all three quantities have levels, so that no fit knows the ends of one
    alone. A recording is so judged by a fit to which its level is new; one that lies between others
    in two of them is left out twice. The least and the largest levels, which no fit knows
    anything beyond, are left out a recording at a time, each with the smallest fold.
    """
    left_out, most = list[set[int]](), max(FOLDS, _EACH * len(kinds))
    for number, groups in enumerate(kinds):
        between = groups[1:-1]
        count = min(len(between), (most - len(left_out)) // (len(kinds) - number))
        left_out += [set(np.concatenate(between[k::count]).tolist()) for k in range(count)]
    left_out += [set() for _ in range(FOLDS - len(left_out))]
    for index in sorted(set(range(len(recordings))).difference(*left_out)):
        min(left_out, key=len).add(index)
    parts = wholes(recordings)
    return [
        Fold(f"levels {k + 1}", tuple(parts[i] for i in sorted(group)))
        for k, group in enumerate(left_out)
        if group
    ]


def _sizes(recordings: Sequence[Recording], quantity: str) -> Array:
    """How fast recordings (n,) are, or how large their efforts: mean logarithm of joints' squares.

    Of the measured joints whose `quantity`, ``measured`` or ``effort``, all recordings have.
    """
    kind = "speed" if quantity == "measured" else "effort"
    both = (set(r.joints_of(quantity)).intersection(r.joints_of("measured")) for r in recordings)
    joints = sorted(set.intersection(*both))
    sizes = np.array([[getattr(c, kind) for c in conditions_of(r, joints)] for r in recordings])
    usable = sizes[:, (sizes > 0.0).all(axis=0)]
    return 2.0 * np.log(usable).mean(axis=1) if usable.size else np.zeros(len(recordings))
