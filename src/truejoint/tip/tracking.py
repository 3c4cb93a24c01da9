"""Truth of the joints from a tracker or a camera: where it stands, and what its points then say.

The pose of the tracker in the robot's base, the marker's place on the tool, smooth corrections of
the joints and the delay of the tracker are estimated together, by robust least squares over the
rows of `tip_rows`. What no motion can tell apart is named, and taken from what a person states.
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
from truejoint.tip.registration import Registered, Registration, Stretch
from truejoint.tip.tip_rows import GATE, MARKER, POSE, TipRows, TipState
from truejoint.tip.tracked_motion import TrackedMotion
from truejoint.tip.tracker_fit import (
    NORM_MEDIAN,
    Known,
    TrackFit,
    brought,
    equations,
    fit_track,
)

_UNSEEN: Final = 0.3  # share of what a zero may be that is left open: the motion did not show it
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

    The delay is found coarsely as in `join_truth`, by the path of the tool, whatever frame it is
    seen in. Then the tracker's pose, the marker's place, the delay and corrections of the joints
    (zero, slopes and squares in all of them, two plays of its own) are fitted together; readings
    further off than 4.5 deviations are left out, and all of a stretch of time in which most are:
    another marker that the tracker took for this one. The truth of each reading that is left is
    the position of the joints that puts the marker there.

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
    moving = TrackedMotion.of(recording, chain, names)
    begins = 0.0 if math.isnan(recording.provenance.start) else recording.provenance.start
    start = _coarse_offset(moving, track, near, begins) if offset is None else offset - begins
    known = Known.of(registration, robot, moving, track, start, delayed=offset is None)
    fit = fit_track(moving, track, known)
    _check_seen(track.source, fit, moving, names)
    found = _judged(moving, track, known, fit)
    truth, deviations = _solve(moving, found.rows, fit)
    columns = {f"truth/{name}": truth[:, k] for k, name in enumerate(names)}
    clock = _clock(fit, begins, is_stated=offset is not None)
    joined, _ = join_truth(recording, Stream(track.t[found.fits], columns), clock.seconds)
    registered = _registered(robot, link, names, known, fit, found, clock, deviations)
    return _described(joined, registered, track), registered


def _checked_joints(source: str, robot: Robot, joints: Sequence[str]) -> tuple[str, ...]:
    """Joints whose truth is sought; refuses what a point cannot tell."""
    names = tuple(joints) or robot.positioning[:3]
    robot.index(names)
    if not 1 <= len(names) <= 3 or len(set(names)) < len(names):
        raise CalibrationError(
            f"{source}: the place of a marker tells 1 to 3 joints, each named once, not "
            f"{', '.join(names)}"
        )
    return names


def _clock(fit: TrackFit, begins: float, *, is_stated: bool) -> ClockOffset:
    """Offset of the clocks where a recording `begins` at a time of day [s], or at 0."""
    sd, by = (math.nan, ()) if is_stated else (fit.sd_of("delay"), ("the tool",))
    return ClockOffset(fit.offset + begins, sd, by)


def _registered(
    robot: Robot,
    link: str,
    names: tuple[str, ...],
    known: Known,
    fit: TrackFit,
    found: _Judged,
    clock: ClockOffset,
    deviations: tuple[Array, Array],
) -> Registered:
    """Say where a fit puts tracker and marker, and what of the readings fits."""
    base, marker = np.eye(4), np.eye(4)
    base[:3, :3], base[:3, 3] = fit.state.rotation, fit.state.translation
    marker[:3, :3], marker[:3, 3] = fit.turn, fit.state.marker
    return Registered(
        base_from_tracker=base @ known.base_from_tracker,
        base_sd=fit.sds(POSE),
        link=link,
        link_from_marker=marker,
        marker_sd=fit.sds(MARKER),
        clock=clock,
        noise=float(fit.noise[0]),
        joints=names,
        units=tuple(robot.joint(name).unit for name in names),
        noise_deviation=deviations[0],
        pose_deviation=deviations[1],
        readings=int(found.fits.sum()),
        strays=found.strays,
        stretches=found.stretches,
    )


def _described(joined: Recording, registered: Registered, track: Track) -> Recording:
    """Say in a recording's provenance whose its truth is, and what was left out."""
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
        "tracker: off for a while": sum(one.readings for one in registered.stretches),
    }
    text = "; ".join(filter(None, notes))
    return replace(joined, provenance=replace(joined.provenance, notes=text, dropped=dropped))


def carrier(robot: Robot, link: str) -> tuple[Kinematics, str]:
    """Kinematics of what carries a marker, and the joint that moves it; the tool without a `link`.

    Raises CalibrationError where kinematics are not known, or are not those of a chain.
    """
    kinematics = robot.kinematics
    if kinematics is None:
        raise CalibrationError(
            f"{robot.title} has no kinematics, without which points say nothing of its joints; "
            "state them in a robot file (docs/robots.md)"
        )
    if not link:
        return kinematics, robot.joint_names[-1]
    if not isinstance(kinematics, SerialChain):
        raise CalibrationError(f"{robot.title}: only the tool of its kinematics can carry a marker")
    return kinematics.up_to(robot.index([link])[0]), link


def _coarse_offset(motion: TrackedMotion, track: Track, near: float | None, begins: float) -> float:
    """Offset of the track's clock from a recording's that `begins` at a time of day [s].

    By the path of the tool, `near` one of the clocks themselves; refuses points that are hardly in
    m.
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


def _check_seen(source: str, fit: TrackFit, motion: TrackedMotion, names: Sequence[str]) -> None:
    """Refuse what leaves the zero of a joint open, saying what it is mixed up with."""
    state = fit.state
    terms = (len(state.coefficients) - 1) // len(names)
    sds = np.sqrt(np.diag(fit.covariance))
    k = len(state.coefficients)
    others = {**{name: k + i for i, name in enumerate(POSE)},
              **{name: k + 6 + i for i, name in enumerate(MARKER)}}  # fmt: skip
    open_ = []
    for j, name in enumerate(names):
        zero = j * terms
        if sds[zero] > _UNSEEN * motion.sd[zero]:
            alike = {
                what: abs(fit.covariance[zero, i]) / max(sds[zero] * sds[i], 1e-300)
                for what, i in others.items()
            }
            open_.append(f"the zero of {name} from {_WORDS[max(alike, key=alike.__getitem__)]}")
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
class _Judged:
    """Which readings fit, and what the others are."""

    rows: TipRows  # of those that fit
    fits: Mask  # (n,)
    strays: int  # one by one
    stretches: tuple[Stretch, ...]
    jumps: Array  # (k,) times at which those that fit go on elsewhere [s]

    @property
    def share(self) -> float:
        """Share of the readings that are left out."""
        out = self.strays + sum(stretch.readings for stretch in self.stretches)
        return out / (out + int(self.fits.sum()))


def _judged(motion: TrackedMotion, track: Track, known: Known, fit: TrackFit) -> _Judged:
    """Tell readings that fit from strays, and from stretches of time in which most are off.

    Refuses points that do not follow the tool.
    """
    stamps, noise = track.t + fit.offset, max(float(fit.noise[0]), _FINEST)
    rows = motion.rows(stamps, brought(known, track)[0])
    state = _stamped(fit)
    off = -rows.residual(state) @ state.rotation.T  # in the base's axes
    inside = motion.inside(stamps)
    stray = inside & (np.linalg.norm(off, axis=1) >= GATE * noise)
    frame, _ = rows.moves(state)
    on_link = (frame[:, :3, :3].transpose(0, 2, 1) @ off[:, :, None])[:, :, 0]
    stretches, within = _stretches(stamps, inside, stray, on_link, noise)
    fits = inside & ~stray & ~within
    jumps = _jumps(stamps[fits], on_link[fits], noise)
    found = _Judged(rows.rows(fits), fits, int((stray & ~within).sum()), stretches, jumps)
    _check_followed(track.source, found, fit, motion)
    return found


def _jumps(t: Array, shift: Array, noise: float) -> Array:
    """Tell times (k,) [s] at which readings that fit are off by another `shift` (n, 3) [m].

    A fit that lies between two markers finds no reading to be far off; but all are further off
    than one is from the next, except where the tracker goes from one marker to the other.
    """
    step = np.linalg.norm(np.diff(shift, axis=0), axis=1)
    single = max(float(np.median(step)) / (NORM_MEDIAN * math.sqrt(2.0)), _FINEST)
    if noise < _SMOOTH * single or len(t) <= _RUN:
        return np.empty(0)
    level = medfilt(shift, (_RUN, 1))
    jump = np.linalg.norm(np.diff(level, axis=0), axis=1) > _JUMP * single
    whole = slice(_RUN // 2, -(_RUN // 2))  # at its ends a median is of what lies beyond
    return np.asarray(t[1:][whole][jump[whole]])


def _stamped(fit: TrackFit) -> TipState:
    """State of a fit without the delay, which is in the stamps."""
    coefficients = fit.state.coefficients.copy()
    coefficients[-1] = 0.0
    return replace(fit.state, coefficients=coefficients)


def _stretches(
    t: Array, inside: Mask, stray: Mask, shift: Array, noise: float
) -> tuple[tuple[Stretch, ...], Mask]:
    """Stretches of the time `t` (n,) [s] in which most readings stray, and what is in them (n,).

    Of those readings the ones `inside` (n,) the recording count.
    Where all of a stretch are off by the same `shift` (n, 3) [m] on the marker's link, another
    marker is seen; and so it is between two of them that are off alike, even where a fit that bends
    to them finds nothing odd.
    """
    found: list[_Off] = []
    most = medfilt(stray.astype(np.float64), _RUN)
    for first, end in runs(np.convolve(most, np.ones(_RUN), "same") > 0.0):
        own = first + np.flatnonzero(stray[first:end])
        one = _Off.of(own, shift, noise)
        if found and one.is_as(found[-1]):
            one = _Off.of(np.concatenate([found.pop().rows, own]), shift, noise)
        found.append(one)
    within = np.zeros(len(t), dtype=np.bool_)
    told = []
    for one in found:
        begin, end = one.rows[0], one.rows[-1]
        within[begin : end + 1] = True
        many = int(inside[begin : end + 1].sum())
        told.append(Stretch(float(t[begin]), float(t[end]), many, one.distance, alike=one.is_alike))
    return tuple(told), within


@dataclass(frozen=True, eq=False)
class _Off:
    """Readings of a stretch that stray."""

    rows: Integers
    middle: Array  # (3,) by which they are off on the marker's link [m]
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
        apart = float(np.linalg.norm(self.middle - before.middle))
        return bool(near and self.is_alike and before.is_alike and apart < self.limit)


def _check_followed(source: str, found: _Judged, fit: TrackFit, motion: TrackedMotion) -> None:
    """Refuse points that do not follow the tool, and say when they leave it."""
    off, way = float(fit.noise[0]), float(np.linalg.norm(np.std(motion.path, axis=0)))
    if found.share > _MOST_STRAYS or off > _MOST_NOISE * way or len(found.jumps):
        told = [str(stretch) for stretch in found.stretches[:_SHOWN]]
        if len(found.jumps):
            told.append(f"they jump at {', '.join(f'{t:.1f}' for t in found.jumps[:_SHOWN])} s")
        when = f" ({'; '.join(told)})" if told else ""
        raise CalibrationError(
            f"{source}: the points follow the tool, which moves {1e3 * way:.0f} mm, to no better "
            f"than {1e3 * off:.1f} mm, and {100 * found.share:.0f} % are further off than "
            f"{GATE:g} times that{when}; does the tracker confuse two markers, or is it another "
            "motion? Look at them, and leave such stretches out"
        )


def _solve(
    motion: TrackedMotion, rows: TipRows, fit: TrackFit
) -> tuple[Array, tuple[Array, Array]]:
    """Joints (n, n_joints) at every reading that fits, and their deviations.

    From the point alone, which tells more than an orientation.
    """
    noise, columns = float(fit.noise[0]), list(motion.columns)
    state = _stamped(fit)
    joint = rows.corrected(state)
    bare = replace(state, coefficients=np.zeros_like(state.coefficients))
    for _ in range(_SOLVES):
        found = equations(motion, replace(rows, joint=joint), None, bare, fit.turn)
        back = np.linalg.pinv(found.by_joint)
        joint[:, columns] -= (back @ found.residual[:, :, None])[:, :, 0]
    k = len(state.coefficients)
    moved = back @ found.by_parameter[:, :, k:]
    together = np.einsum("mia,ab,mib->mi", moved, fit.covariance[k:, k:], moved)
    single = noise**2 * (back**2).sum(axis=2)
    deviations = [np.sqrt(variance.mean(axis=0)) for variance in (single, together)]
    return joint[:, columns], (deviations[0], deviations[1])
