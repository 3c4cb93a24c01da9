"""What a tracker or a camera saw of a marker on the tool: a file of points or poses, or a topic."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Self

import numpy as np

from truejoint.array_types import Array, Integers, Mask, floats
from truejoint.crtk.messages import crtk_name
from truejoint.errors import RecordingError, unknown
from truejoint.files import is_folder
from truejoint.recordings.bounded_file import Head
from truejoint.recordings.read.bags import assembling
from truejoint.recordings.read.bags.container import is_bag
from truejoint.recordings.read.numeric_text import read_numbers, text_layout
from truejoint.recordings.table.recording import Recording
from truejoint.recordings.table.stream import forward_rows
from truejoint.toml_file import shipped_table
from truejoint.units import FACTORS

_COLUMNS: Final = ("t", "x", "y", "z")
QUATERNION: Final = ("qx", "qy", "qz", "qw")
UNITS: Final = FACTORS["m"]
"""Units that the points of a file may be in, and how many m each is."""

LOST: Final = "tracker: marker lost"
FROZEN: Final = "tracker: repeats its last reading"
BACK: Final = "tracker: time stamp not after the one before"

_FEWEST: Final = 50  # readings that can tell a tracker's place
_MOST_LOST: Final = 0.9  # share of the readings
_FIELDS: Final[Mapping[str, tuple[str, str]]] = shipped_table(__package__, "layouts.toml")["poses"]
# What an arm says of itself is no tracker's.
_POSE: Final = "measured_cp"
_OWN: Final = (_POSE, "setpoint_cp", "goal_cp", "servo_cp", "move_cp", "interpolate_cp")


@dataclass(frozen=True, eq=False)
class Track:
    """Points or poses of a marker on the tool, in the tracker's own frame and on its own clock.

    Attributes
    ----------
    t : ndarray, shape (n,)
        Time stamps [s], strictly increasing.
    position : ndarray, shape (n, 3)
        [m].
    orientation : ndarray, shape (n, 4), optional
        Unit quaternions x, y, z, w that turn the marker's frame into the tracker's; None of a
        tracker that sees points.
    source : str
    dropped : mapping
        How many readings were left out, by reason.

    Raises
    ------
    RecordingError
        If the shapes do not fit, or fewer than 50 readings are left.

    Examples
    --------
    >>> t = np.arange(100.0)
    >>> Track(t, np.column_stack([t, t, t])).position.shape
    (100, 3)
    """

    t: Array
    position: Array
    orientation: Array | None = None
    source: str = "tracker"
    dropped: Mapping[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("t", "position", "orientation"):
            if (values := getattr(self, name)) is not None:
                object.__setattr__(
                    self, name, floats(values, f"{self.source}: {name}", RecordingError)
                )
        n = self.t.size
        turns = (n, 4) if self.orientation is None else self.orientation.shape
        if self.t.shape != (n,) or self.position.shape != (n, 3) or turns != (n, 4):
            raise RecordingError(
                f"{self.source}: stamps {self.t.shape}, points {self.position.shape} and "
                f"orientations {turns} must be (n,), (n, 3) and (n, 4)"
            )
        if n < _FEWEST:
            raise RecordingError(
                f"{self.source}: {n} readings in which the marker is seen; at least {_FEWEST} are "
                "needed: track for longer, with the marker in sight"
            )

    def __len__(self) -> int:
        return self.t.size

    def rows(self, selection: Mask | Integers | slice) -> "Track":
        """Keep the selected readings only."""
        turns = None if self.orientation is None else self.orientation[selection]
        return Track(self.t[selection], self.position[selection], turns, self.source, self.dropped)

    @classmethod
    def of_readings(
        cls, t: Array, position: Array, orientation: Array | None = None, source: str = "tracker"
    ) -> Self:
        """Track of all that a tracker reports, in which the marker may be lost at times.

        A marker is lost where a value is NaN, the quaternion is zero or the point is the origin; a
        reading that repeats the one before to the last bit does not count, as every reading has
        noise. Raises RecordingError as the class does, and if nine of ten readings are lost.

        Examples
        --------
        >>> t = np.arange(100.0)
        >>> seen = np.where(t < 60, t, np.nan)
        >>> len(Track.of_readings(t, np.column_stack([seen, seen + 1, seen])))
        60
        """
        raw = cls(t, position, orientation, source)
        t, position, turns = raw.t, raw.position, raw.orientation
        values = position if turns is None else np.hstack([position, turns])
        visible = np.isfinite(values).all(axis=1) & (position != 0.0).any(axis=1)
        if turns is not None:
            with np.errstate(invalid="ignore", divide="ignore"):
                length = np.linalg.norm(turns, axis=1, keepdims=True)
                visible &= np.abs(length[:, 0] - 1.0) < 0.1  # rounded to a few digits, or none
                turns = turns / length
        before = np.flatnonzero(visible)
        fresh = np.append([True], (np.diff(values[before], axis=0) != 0.0).any(axis=1))
        usable = before[fresh[: len(before)]]
        forward = forward_rows(t[usable])
        counts = int((~visible).sum()), len(before) - len(usable), int((~forward).sum())
        dropped = {r: n for r, n in zip((LOST, FROZEN, BACK), counts, strict=True) if n}
        usable = usable[forward]
        if len(usable) < (1.0 - _MOST_LOST) * len(t):
            worst = max(dropped, key=dropped.__getitem__)
            raise RecordingError(
                f"{source}: only {len(usable)} of {len(t)} readings can be used "
                f"({worst.removeprefix('tracker: ')}: {dropped[worst]}); bring the marker into "
                "sight and record again"
            )
        turned = None if turns is None else turns[usable]
        return cls(t[usable], position[usable], turned, source, dropped)


def read_track(path: assembling.Bags, topic: str = "", unit: str = "m") -> Track:
    """Read the points or poses of a marker on the tool from a file, or the bags of a session.

    Parameters
    ----------
    path : path-like or sequence of path-like
        Text with columns ``t`` [s], ``x``, ``y``, ``z`` and, of poses, ``qx``, ``qy``, ``qz``,
        ``qw``; others are passed over. Or bags with a topic of ``geometry_msgs``: ``PointStamped``,
        ``PoseStamped``, ``PoseWithCovarianceStamped``, ``TransformStamped``.
    topic : str
        Topic of a bag; by default the only one of these types that is not the arm's own.
    unit : {"m", "mm"}
        Unit of the points in a file; a bag's are in m.

    Raises
    ------
    RecordingError
        If it is no such file, or the marker is hardly ever seen.

    Examples
    --------
    >>> t = np.arange(100) / 30
    >>> points = {"t": t, "x": np.sin(t), "y": np.cos(t), "z": t}
    >>> pd.DataFrame(points).to_csv("points.csv", index=False)
    >>> len(read_track("points.csv"))
    100
    """
    sources = assembling.as_paths(path)
    source = sources[0]
    if unit not in UNITS:
        raise RecordingError(f"{source}: {unknown('unit', unit, UNITS)}")
    head, name = Head(source, b"") if is_folder(source) else Head.of(source), source.name
    if len(sources) > 1 or is_bag(source, head.data):
        if unit != "m":
            raise RecordingError(f"{source}: a bag's points are in m; leave the unit out")
        values, name = _read_bags(sources, topic)
    elif topic:
        raise RecordingError(f"{source}: is no bag, so it has no topic; leave {topic!r} out")
    else:
        values = _read_text(head)
    turns = values[:, 4:] if values.shape[1] > 4 else None
    return Track.of_readings(values[:, 0], values[:, 1:4] * UNITS[unit], turns, name)


def read_tool_poses(
    bags: assembling.Bags, recording: Recording, profile: str = "", state: str = ""
) -> Track | None:
    """Read what the arm of a recording says in its bags of its tool's pose; None if nothing."""
    paths, robot = assembling.as_paths(bags), recording.robot
    topics = assembling.bag_topics(paths)
    wiring = assembling.find_wiring(paths[0], topics, robot, profile, state, truth=None)
    space = wiring.state.rpartition("/")[0]
    for name, (kind, count) in topics.items():
        arm = wiring.profile.arm_of(name)
        is_of_arm = arm == robot.arm if arm else name.rpartition("/")[0] == space
        if crtk_name(name) == _POSE and kind in _FIELDS and count >= _FEWEST and is_of_arm:
            return read_track(paths, name)
    return None


def _read_text(head: Head) -> Array:
    """Columns of a text file: stamps, points, of poses also orientations."""
    layout, header, named = text_layout(head)
    names = [*_COLUMNS, *(name for name in QUATERNION if name in header)]
    if not (named and {*names} <= {*header} and len(names) in (4, 8)):
        raise RecordingError(
            f"{head.path}: is no file of points: it begins with {', '.join(header)[:200]}, and "
            f"needs columns {', '.join(_COLUMNS)} [s, m], of poses also {', '.join(QUATERNION)}"
        )
    return read_numbers(head.path, layout, [header.index(name) for name in names]).values


def _read_bags(sources: Sequence[Path], topic: str) -> tuple[Array, str]:
    """Stamps [s], points and orientations of a topic as columns, and what they come from."""
    source = ", ".join(path.name for path in sources)
    topics = assembling.bag_topics(sources)
    kinds = {name: kind for name, (kind, count) in topics.items() if kind in _FIELDS and count}
    if not kinds:
        raise RecordingError(
            f"{source}: no topic has points or poses; give the bag that has the tracker's too"
        )
    candidates = [topic] if topic else [name for name in kinds if crtk_name(name) not in _OWN]
    if len(candidates) != 1 or candidates[0] not in kinds:
        listed = ", ".join(f"{name} ({kind})" for name, kind in sorted(kinds.items()))
        what = f"no points or poses on {topic!r}." if topic else "which topic is the tracker's?"
        raise RecordingError(
            f"{source}: {what} Name it (--tracker, of track --topic); of points or poses there are "
            f"{listed}"
        )
    point, turn = _FIELDS[kinds[candidates[0]]]
    fields = [f"{point}.{axis}" for axis in "xyz"]
    fields += [f"{turn}.{axis}" for axis in "xyzw"] if turn else []
    stamps, values = assembling.read_topic(sources, candidates[0], fields)
    columns = [values[name][:, 0].astype(np.float64) for name in fields]
    return np.column_stack([stamps / 1e9, *columns]), f"{source}: {candidates[0]}"
