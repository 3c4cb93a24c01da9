"""What a calibration was made from: its recordings, its zeros, the rate of its samples."""

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Final, Literal

import numpy as np

from truejoint.array_types import Array
from truejoint.calibration.conditions import Condition
from truejoint.schema import Bounds, Shape

if TYPE_CHECKING:
    from truejoint.recordings import Recording

ZeroOf = Literal["shared", "recording"]
_Number = Annotated[float, Bounds(-1e15, 1e15)]
_PROBES: Final = 32
"""Rows, spread evenly, by which a recording without a file is known again."""
_SAME: Final = 0.01  # of the spread of the probes, by which they may differ in a thinned copy


@dataclass(frozen=True)
class Session:
    """A recording, or a part of one, as a calibration remembers it.

    Counts are of its rows: those that the fit uses, those without truth, and outliers.
    """

    sha256: str  # of the file; empty where there is none
    first: _Number  # time stamp of the first row [s]
    last: _Number
    source: str = ""
    session: str = ""
    homing_id: str = ""
    start: str = ""
    load: _Number = math.nan  # mass on the tool [kg]; NaN where it is not stated
    rows: int = 0
    rows_without_truth: int = 0
    outliers: int = 0
    duration: _Number = 0.0  # [s]
    conditions: tuple[Condition, ...] = ()  # of each joint
    probes: tuple[tuple[_Number, _Number], ...] = ()
    """Stamps [s] of some rows, and sums of their positions; none where `sha256` tells."""

    @classmethod
    def of(cls, recording: "Recording", **others: object) -> "Session":
        """Remember a recording; `others` are other fields."""
        origin = recording.provenance.to_dict()
        names = ("source", "sha256", "session", "homing_id", "start")
        some = np.linspace(0, len(recording) - 1, 0 if origin["sha256"] else _PROBES).astype(int)
        rows = zip(recording.t[some].tolist(), _positions(recording)[some].tolist(), strict=True)
        return cls(
            **{name: str(origin[name] or "") for name in names},  # type: ignore[arg-type]
            load=recording.provenance.load,
            first=float(recording.t[0]),
            last=float(recording.t[-1]),
            probes=tuple(rows),
            **others,  # type: ignore[arg-type]
        )

    def overlaps(self, recording: "Recording") -> bool:
        """Whether rows of a recording are rows of this session.

        Two recordings are the same if their hashes are equal or, where neither has one, source,
        session, homing, start, and the positions where both have any.
        """
        other = Session.of(recording)
        if self.sha256 or other.sha256:
            same = self.sha256 == other.sha256
        else:
            names = ("source", "session", "homing_id", "start")
            same = all(getattr(self, name) == getattr(other, name) for name in names)
            probes = np.array([p for p in self.probes if other.first <= p[0] <= other.last])
            if same and len(probes):
                there = np.interp(probes[:, 0], recording.t, _positions(recording))
                spread = np.ptp(np.array(self.probes)[:, 1])
                same = bool(np.median(np.abs(there - probes[:, 1])) <= _SAME * spread)
        return same and other.first <= self.last and other.last >= self.first


def _positions(recording: "Recording") -> Array:
    """Sum (n,) of the measured positions of each row."""
    return np.asarray(recording.columns("measured", recording.joints_of("measured")).sum(axis=1))


@dataclass(frozen=True, eq=False)
class Origin:
    """What a calibration was made from, as far as the product reads it again."""

    estimator: str = ""  # name of the one that was asked for
    sample_dt: Annotated[float, Bounds(0.0, 1e9)] = 0.0  # median time between rows [s]; 0: unknown
    sessions: tuple[Session, ...] = ()  # recordings that the fit used
    homing_ids: tuple[str, ...] = ()  # that its zero holds for: of the training, or of its `zero`
    interval_sessions: tuple[Session, ...] = ()  # recordings that the interval was made of
    accepted: tuple[str, ...] = ()  # failures of the data check that the user accepted
    baseline_notes: Mapping[str, str] = field(default_factory=dict)  # why one is absent or weak
    zeros: Annotated[Array, Shape((None, None))] | None = None
    """(n_recordings, n_joints) [rad or m] about their mean, where those fitted to share none."""

    def includes(self, recording: "Recording", *, in_interval: bool = False) -> bool:
        """Whether the fit used rows of a recording, or the interval was made of them."""
        sessions = self.interval_sessions if in_interval else self.sessions
        return any(session.overlaps(recording) for session in sessions)


def distinct(recordings: "Sequence[Recording]") -> "list[Recording]":
    """Leave out copies of recordings: a fit without one would still have the other."""
    first: dict[str, Recording] = {}
    for recording in recordings:
        digest = hashlib.sha256()
        for name in ("t", *recording.units):
            digest.update(np.ascontiguousarray(recording.table[name]).tobytes())
        first.setdefault(digest.hexdigest(), recording)
    return list(first.values())
