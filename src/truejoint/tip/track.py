"""Truth of the joints from a tracker or a camera: where it stands, and the joints at its points.

The pose of the tracker in the robot's base, the marker's place on the tool, smooth corrections of
the joints and the delay of the tracker are estimated together, by robust least squares over
`TipRows`. A zero that no motion can tell from them is named, and must be stated by a person.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.signal import medfilt

from truejoint.array_types import Array, Integers, Mask
from truejoint.errors import CalibrationError, RecordingError, other_kind
from truejoint.recordings.join.joining import (
    ClockOffset,
    cover_same_time,
    find_path_offset,
    join_truth,
)
from truejoint.recordings.read.track import Track
from truejoint.recordings.table.recording import EPOCH, Recording, as_recording, runs
from truejoint.recordings.table.stream import Stream
from truejoint.robots import Robot
from truejoint.robots.chain import SerialChain
from truejoint.robots.parts import Kinematics
from truejoint.tip.fit import GATE
from truejoint.tip.registration import Registered, Registration, Stretch
from truejoint.tip.rows import MARKER, POSE, TipRows, known_kinematics
from truejoint.tip.track_fit import NORM_MEDIAN, TrackedMotion, TrackFit, TrackStart, fit_track

_UNSEEN: Final = 0.3  # share of a zero's prior deviation, above which the motion did not show it
_SOLVES: Final = 3  # Newton steps from a corrected position to that of a point
_MOST_STRAYS: Final = 1 / 3
_FINEST: Final = 1e-4  # m, noise below which what no correction follows would pass for strays
_MOST_NOISE: Final = 0.1  # share of the tool's way
_RUN: Final = 11  # readings, of which six stray where a stretch does
_ALIKE: Final = 0.1  # of their distance by which readings of another marker may differ
_SHOWN: Final = 3  # stretches or jumps in a message
_JUMP: Final = 10.0  # deviations of a single reading, by which the next ones are elsewhere
_SMOOTH: Final = 2.0  # times that deviation, by which they are off where a fit is no good
_LIKE: Final = 30.0  # the tool's way and the points' are at most this many times each other


def tracked_truth(
    recording: Recording,
    track: Track,
    registration: Registration | None = None,
    joints: Sequence[str] = (),
    *,
    offset: float | None = None,
    near: float | None = None,
) -> tuple[Recording, Registered]:
    """Give a recording the truth of its joints that a tracker saw from outside.

    The delay is estimated coarsely as in `join_truth`, by the path of the tool in any frame. Then
    the tracker's pose, the marker's place, the delay and corrections of the joints (zero, slopes
    and squares in all of them, two plays of its own) are fitted together. Readings further off
    than 4.5 deviations are dropped as outliers. So is a whole stretch of time in which most are
    outliers: there the tracker took another marker for this one. The truth of each inlier is the
    position of the joints that puts the marker there.

    Parameters
    ----------
    recording : Recording
        Without a truth.
    track : Track
    registration : Registration, optional
        What is known of the tracker.
    joints : sequence of str
        Up to three; by default the first of those that mainly place the tool.
    offset, near : float, optional
        Of the clocks [s], as in `join_truth`. Where both have the time of day, as in one bag, and
        cover the same time, it is near 0 unless stated.

    Returns
    -------
    recording : Recording
        With ``truth/<joint>``; its notes say where that is from.
    registered : Registered

    Raises
    ------
    CalibrationError
        If the motion and the registration leave a joint's zero open, the points do not follow the
        robot, or are too many strays.
    RecordingError
        As `join_truth`.

    Examples
    --------
    >>> robot = get_robot("raven2")
    >>> t = np.arange(0.0, 60.0, 0.05)
    >>> way = np.sin(t[:, None] * [0.5, 0.37, 0.61, 0, 0, 0, 0]) * [0.3, 0.4, 0.04, 0, 0, 0, 0]
    >>> names = [f"measured/{name}" for name in robot.joint_names]
    >>> moved = dict(zip(names, (robot.home + way).T))
    >>> recording = Recording.from_columns({"t": t, **moved}, "raven2")
    >>> points = robot.kinematics.forward(robot.home + way)[:, :3, 3]
    >>> points += 2e-4 * np.random.default_rng(0).standard_normal(points.shape)
    >>> small = np.full(3, 1e-4)
    >>> known = Registration(np.eye(4), np.full(6, 1e-3), marker=np.zeros(3), marker_sd=small)
    >>> tracked, found = tracked_truth(recording, truejoint.recordings.Track(t, points), known)
    >>> tracked.joints_of("truth"), bool(abs(found.clock.seconds) < 0.01)
    (('shoulder', 'elbow', 'insertion'), True)
    """
    registration = registration or Registration()
    robot = as_recording(recording).robot
    if not isinstance(track, Track):
        raise RecordingError(other_kind(track, "Track", "read_track(path) reads one"))
    chain, link = carrier(robot, registration.link)
    names = _checked_joints(track.source, robot, joints)
    motion = TrackedMotion.of(recording, chain, names)
    begins = 0.0 if math.isnan(recording.provenance.start) else recording.provenance.start
    about = _coarse_offset(motion, track, near, begins) if offset is None else offset - begins
    start = TrackStart.of(registration, motion, track, about, delayed=offset is None)
    fit = fit_track(motion, track, start)
    _check_seen(track.source, fit, motion)
    readings = _judge(motion, track, start, fit)
    truth, deviations = _solve(readings.rows, fit)
    columns = {f"truth/{name}": truth[:, k] for k, name in enumerate(names)}
    sd, by = (math.nan, ()) if offset is not None else (float(fit.sds("delay")[0]), ("the tool",))
    clock = ClockOffset(fit.offset + begins, sd, by)
    joined, _ = join_truth(recording, Stream(track.t[readings.inlier], columns), clock.seconds)
    base, marker = np.eye(4), np.eye(4)
    base[:3, :3], base[:3, 3] = fit.state.rotation, fit.state.translation
    marker[:3, :3], marker[:3, 3] = fit.state.turn, fit.state.marker
    registered = Registered(
        base_from_tracker=base @ start.base_from_tracker,
        base_sd=fit.sds(*POSE),
        link=link,
        link_from_marker=marker,
        marker_sd=fit.sds(*MARKER),
        clock=clock,
        noise=fit.noise,
        joints=names,
        units=tuple(robot.joint(name).unit for name in names),
        noise_deviation=deviations[0],
        pose_deviation=deviations[1],
        readings=int(readings.inlier.sum()),
        strays=readings.strays,
        stretches=readings.stretches,
    )
    return _described(joined, registered, track), registered


def carrier(robot: Robot, link: str) -> tuple[Kinematics, str]:
    """Kinematics of what carries a marker, and the joint that moves it; the tool without a `link`.

    Raises CalibrationError where kinematics are not known, or are not those of a chain.
    """
    kinematics = known_kinematics(robot)
    if not link:
        return kinematics, robot.joint_names[-1]
    if not isinstance(kinematics, SerialChain):
        raise CalibrationError(f"{robot.title}: only the tool of its kinematics can carry a marker")
    return kinematics.up_to(robot.index([link])[0]), link


def _checked_joints(source: str, robot: Robot, joints: Sequence[str]) -> tuple[str, ...]:
    """Joints whose truth is sought; refuses more than a point can tell."""
    names = tuple(joints) or robot.positioning[:3]
    robot.index(names)
    if not 1 <= len(names) <= 3 or len(set(names)) < len(names):
        raise CalibrationError(
            f"{source}: the place of a marker tells 1 to 3 joints, each named once, not "
            f"{', '.join(names)}"
        )
    return names


def _described(joined: Recording, registered: Registered, track: Track) -> Recording:
    """Note in a recording's provenance where its truth is from, and what was dropped."""
    about = registered.summary()
    notes = [
        joined.provenance.notes,
        f"truth of a tracker, {track.source}: registered {about['± (1 sd)']}; truth ± "
        f"{about['truth ±']}",
        *(f"left out: {stretch}" for stretch in registered.stretches),
    ]
    dropped = {
        **joined.provenance.dropped,
        **track.dropped,
        "tracker: strays": registered.strays,
        "tracker: off for a while": sum(stretch.readings for stretch in registered.stretches),
    }
    text = "; ".join(filter(None, notes))
    return replace(joined, provenance=replace(joined.provenance, notes=text, dropped=dropped))


def _coarse_offset(motion: TrackedMotion, track: Track, near: float | None, begins: float) -> float:
    """Offset of the track's clock from a recording's that `begins` at a time of day [s].

    By the path of the tool, within reach of `near`, an offset of the clocks themselves [s].
    Refuses points that are hardly in m.
    """
    if near is None and begins > EPOCH and cover_same_time(motion.t + begins, track.t):
        near = 0.0  # both have the time of day
    path, points = motion.path, track.position
    ratio = float(np.linalg.norm(np.std(points, axis=0)) / np.linalg.norm(np.std(path, axis=0)))
    if not 1.0 / _LIKE < ratio < _LIKE:
        raise CalibrationError(
            f"{track.source}: the points spread {ratio:.3g} times as wide as the tool moves; are "
            "they in m (--unit mm), and of this motion?"
        )
    about = None if near is None else near - begins
    return find_path_offset(motion.t, path, track.t, medfilt(points, (5, 1)), about)


def _check_seen(source: str, fit: TrackFit, motion: TrackedMotion) -> None:
    """Refuse a motion that leaves the zero of a joint open; say what it is mixed up with."""
    zeros, state = motion.terms.zeros, fit.state
    sds = np.sqrt(np.diag(fit.covariance))
    open_ = []
    for name, zero in zip(motion.terms.joints, zeros, strict=True):
        if sds[zero] > _UNSEEN * motion.sd[zero]:
            places = [state.names.index(parameter) for parameter in _WORDS]
            scale = np.maximum(sds[zero] * sds[places], 1e-300)
            alike = int(np.argmax(np.abs(fit.covariance[zero, places]) / scale))
            open_.append(f"the zero of {name} from {list(_WORDS.values())[alike]}")
    if open_:
        raise CalibrationError(
            f"{source}: the motion does not tell {', nor '.join(open_)}; state what is known in a "
            "registration: the base's pose, touched points of it, a stop of the joint, the "
            "marker's place (--registration, docs/tracker.md)"
        )


_WORDS: Final = {
    **{f"turn {axis}": f"a turn of the base about its {axis} axis" for axis in "xyz"},
    **{f"shift {axis}": f"a shift of the base along {axis}" for axis in "xyz"},
    **{f"marker {axis}": f"the marker's place along {axis} of its link" for axis in "xyz"},
}


@dataclass(frozen=True, eq=False)
class _Readings:
    """Which readings fit, and what the others are."""

    rows: TipRows  # inliers
    inlier: Mask  # (n,)
    strays: int  # outliers one by one
    stretches: tuple[Stretch, ...]
    jumps: Array  # (k,) times at which the inliers jump elsewhere [s]

    @property
    def share(self) -> float:
        """Share of the outliers."""
        out = self.strays + sum(stretch.readings for stretch in self.stretches)
        return out / (out + int(self.inlier.sum()))


def _judge(motion: TrackedMotion, track: Track, start: TrackStart, fit: TrackFit) -> _Readings:
    """Tell inliers from strays, and from stretches of time in which most readings stray.

    Refuses points that do not follow the tool.
    """
    stamps, noise = track.t + fit.offset, max(fit.noise, _FINEST)
    rows, state = motion.rows(stamps, start.point), fit.without_delay
    off = -rows.residual(state) @ state.rotation.T  # in the base's axes
    inside = motion.inside(stamps)
    stray = inside & (np.linalg.norm(off, axis=1) >= GATE * noise)
    turn, _ = rows.tool_points(state)
    on_link = (turn.transpose(0, 2, 1) @ off[:, :, None])[:, :, 0]
    stretches, within = _stretches(stamps, inside, stray, on_link, noise)
    inlier = inside & ~stray & ~within
    jumps = _jumps(stamps[inlier], on_link[inlier], noise)
    strays = int((stray & ~within).sum())
    readings = _Readings(rows.rows(inlier), inlier, strays, stretches, jumps)
    _check_followed(track.source, readings, fit, motion)
    return readings


def _jumps(t: Array, shift: Array, noise: float) -> Array:
    """Find the times (k,) [s] at which the inliers' `shift` (n, 3) [m] jumps to another one.

    A fit that lies between two markers has no outlier. But then all readings are further off than
    one is from the next, except where the tracker goes from one marker to the other.
    """
    step = np.linalg.norm(np.diff(shift, axis=0), axis=1)
    single = max(float(np.median(step)) / (NORM_MEDIAN * math.sqrt(2.0)), _FINEST)
    if noise < _SMOOTH * single or len(t) <= _RUN:
        return np.empty(0)
    level = medfilt(shift, (_RUN, 1))
    jump = np.linalg.norm(np.diff(level, axis=0), axis=1) > _JUMP * single
    whole = slice(_RUN // 2, -(_RUN // 2))  # at its ends a median is of what lies beyond
    return np.asarray(t[1:][whole][jump[whole]])


def _stretches(
    t: Array, inside: Mask, stray: Mask, shift: Array, noise: float
) -> tuple[tuple[Stretch, ...], Mask]:
    """Stretches of the time `t` (n,) [s] in which most readings stray, and their readings (n,).

    Readings `inside` (n,) the recording are counted. Where all of a stretch are off by the same
    `shift` (n, 3) [m] on the marker's link, another marker is seen. Two such stretches that follow
    each other are one, even if a fit that bends to them has no outlier between.
    """
    merged: list[_Off] = []
    most = medfilt(stray.astype(np.float64), _RUN)
    for first, end in runs(np.convolve(most, np.ones(_RUN), "same") > 0.0):
        off = _Off.of(first + np.flatnonzero(stray[first:end]), shift, noise)
        if merged and off.is_as(merged[-1]):
            off = _Off.of(np.concatenate([merged.pop().rows, off.rows]), shift, noise)
        merged.append(off)
    within, stretches = np.zeros(len(t), dtype=np.bool_), []
    for off in merged:
        begin, end = off.rows[0], off.rows[-1]
        within[begin : end + 1] = True
        count = int(inside[begin : end + 1].sum())
        times = float(t[begin]), float(t[end])
        stretches.append(Stretch(*times, count, off.distance, alike=off.is_alike))
    return tuple(stretches), within


@dataclass(frozen=True, eq=False)
class _Off:
    """Readings of a stretch that stray."""

    rows: Integers
    middle: Array  # (3,) of their shift on the marker's link [m]
    distance: float  # [m]
    spread: float  # of the shift about its middle, in the median [m]
    limit: float  # within which two shifts are the same [m]

    @classmethod
    def of(cls, rows: Integers, shift: Array, noise: float) -> _Off:
        middle = np.median(shift[rows], axis=0)
        distance, spread = (
            float(np.median(np.linalg.norm(off, axis=1)))
            for off in (shift[rows], shift[rows] - middle)
        )
        return cls(rows, middle, distance, spread, max(GATE * noise, _ALIKE * distance))

    @property
    def is_alike(self) -> bool:
        return self.spread < self.limit

    def is_as(self, before: _Off) -> bool:
        """Whether this and another one, not long before, are off by the same."""
        between = self.rows[0] - before.rows[-1]
        near = between < max(np.ptp(self.rows), np.ptp(before.rows))
        distance = float(np.linalg.norm(self.middle - before.middle))
        return bool(near and self.is_alike and before.is_alike and distance < self.limit)


def _check_followed(source: str, readings: _Readings, fit: TrackFit, motion: TrackedMotion) -> None:
    """Refuse points that do not follow the tool, and say when they leave it."""
    way = float(np.linalg.norm(np.std(motion.path, axis=0)))
    share, jumps = readings.share, readings.jumps
    if share > _MOST_STRAYS or fit.noise > _MOST_NOISE * way or len(jumps):
        words = [str(stretch) for stretch in readings.stretches[:_SHOWN]]
        if len(jumps):
            words.append(f"they jump at {', '.join(f'{t:.1f}' for t in jumps[:_SHOWN])} s")
        when = f" ({'; '.join(words)})" if words else ""
        raise CalibrationError(
            f"{source}: the points follow the tool, which moves {1e3 * way:.0f} mm, to no better "
            f"than {1e3 * fit.noise:.1f} mm, and {100 * share:.0f} % are further off than "
            f"{GATE:g} times that{when}; does the tracker confuse two markers, or is it another "
            "motion? Look at them, and leave such stretches out"
        )


def _solve(rows: TipRows, fit: TrackFit) -> tuple[Array, tuple[Array, Array]]:
    """Joints (n, n_joints) at every inlier, and their deviations by noise and by the transforms.

    From the point alone, which tells more than an orientation.
    """
    columns, state = list(rows.columns), fit.without_delay
    joint = rows.corrected(state)
    bare = replace(state, coefficients=np.zeros_like(state.coefficients))
    for _ in range(_SOLVES):
        equations = replace(rows, joint=joint).equations(bare)
        back = np.linalg.pinv(equations.by_joint[:, :, columns])
        joint[:, columns] -= (back @ equations.residual[:, :, None])[:, :, 0]
    k = len(state.coefficients)
    moved = back @ equations.by_parameter[:, :, k:]
    together = np.einsum("mia,ab,mib->mi", moved, fit.covariance[k:, k:], moved)
    single = fit.noise**2 * (back**2).sum(axis=2)
    deviations = [np.sqrt(variance.mean(axis=0)) for variance in (single, together)]
    return joint[:, columns], (deviations[0], deviations[1])
