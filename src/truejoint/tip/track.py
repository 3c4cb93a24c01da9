"""Truth of the joints from a tracker or a camera: where it stands, and the joints at its points.

The pose of the tracker in the robot's base, the marker's place on the tool, smooth corrections of
the joints and the delay of the tracker are estimated together, by robust least squares over
`TipRows`. A zero that no motion can tell from them is named, and must be stated by a person.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple

import numpy as np
from scipy.signal import medfilt
from scipy.spatial.transform import Rotation

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
from truejoint.summary import Summarised, json_values
from truejoint.tip.fit import (
    GATE,
    MARKER,
    NORM_MEDIAN,
    POSE,
    TipRows,
    known_kinematics,
    pose_matrix,
)
from truejoint.tip.track_fit import (
    Registration,
    TrackedMotion,
    TrackFit,
    TrackStart,
    fit_track,
)
from truejoint.units import display_unit

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


class Stretch(NamedTuple):
    """A time [s] in which most readings are off, by a distance in the median [m], all left out."""

    begin: float
    end: float
    readings: int
    distance: float
    alike: bool  # Whether all are off by the same on the marker's link, as another marker would be

    def __str__(self) -> str:
        what = "all alike: another marker" if self.alike else "each otherwise"
        return (
            f"{self.begin:.1f} to {self.end:.1f} s: {self.readings} readings "
            f"{1e3 * self.distance:.1f} mm off, {what}"
        )


@dataclass(frozen=True, eq=False, repr=False)
class Registered(Summarised):
    """Where a tracker stands, what it sees, and how sure that is.

    Attributes
    ----------
    base_from_tracker : ndarray, shape (4, 4)
        Pose of the tracker's frame in the robot's base [m].
    base_sd : ndarray, shape (6,)
        Standard deviations of the turn about and the shift along the base's axes at its origin
        [rad, then m].
    link : str
        Joint whose link carries the marker.
    link_from_marker : ndarray, shape (4, 4)
        Pose of the marker on it [m]; its turn is the identity for points.
    marker_sd : ndarray, shape (3,)
        [m].
    clock : ClockOffset
        What to add to the tracker's stamps to have the robot's; its delay is part of it.
    noise : float
        Standard deviation per axis of the points about the fit [m].
    joints : tuple of str
        Whose truth was found.
    noise_deviation : ndarray, shape (n_joints,)
        What that noise makes of a single truth, root mean square over the motion [rad or m].
    pose_deviation : ndarray, shape (n_joints,)
        What all truths may be off by together, as the transforms are known no better [rad or m].
    readings, strays : int
        Readings that fit, and those that were left out one by one as they do not.
    stretches : tuple of Stretch
        Times that were left out whole.

    Examples
    --------
    >>> one, place = np.ones(1), np.eye(4)
    >>> known = place, np.ones(6), "roll", place, np.ones(3), truejoint.recordings.ClockOffset(0.0)
    >>> Registered(*known, 3e-4, ("elbow",), ("rad",), one, one, 90, 2).summary()["readings"]
    '90, 2 strays left out, noise 0.3 mm per axis'
    """

    base_from_tracker: Array
    base_sd: Array
    link: str
    link_from_marker: Array
    marker_sd: Array
    clock: ClockOffset
    noise: float
    joints: tuple[str, ...]
    units: tuple[str, ...]
    noise_deviation: Array
    pose_deviation: Array
    readings: int
    strays: int
    stretches: tuple[Stretch, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        clock = {"seconds": self.clock.seconds, "sd": self.clock.sd}
        stretches = [stretch._asdict() for stretch in self.stretches]
        plain: dict[str, Any] = json_values(vars(self) | {"clock": clock, "stretches": stretches})
        return plain

    def summary(self) -> dict[str, str]:
        """Give transforms with their deviations, delay, noise, and the deviation of each truth."""
        turn = Rotation.from_matrix(self.base_from_tracker[:3, :3]).as_rotvec(degrees=True)
        rows = zip(self.joints, self.units, self.noise_deviation, self.pose_deviation, strict=True)
        deviations = [
            f"{joint} {noise * shown.scale:.2g} and {pose * shown.scale:.2g} {shown.name}"
            for joint, unit, noise, pose in rows
            for shown in [display_unit(unit)]
        ]
        return {
            "tracker": f"at {_listed(1e3 * self.base_from_tracker[:3, 3], '.2f')} mm of the base, "
            f"turned {_listed(turn, '.3f')} deg",
            "± (1 sd)": f"{_listed(1e3 * self.base_sd[3:], '.2g')} mm, "
            f"{_listed(np.rad2deg(self.base_sd[:3]), '.2g')} deg",
            "marker": f"at {_listed(1e3 * self.link_from_marker[:3, 3], '.2f')} mm ± "
            f"{_listed(1e3 * self.marker_sd, '.2g')} mm of the link that {self.link} moves",
            "clock": repr(self.clock).partition("(")[2].removesuffix(")"),
            "readings": f"{self.readings}, {self.strays} strays left out, noise "
            f"{1e3 * self.noise:.2g} mm per axis",
            **({"left out": "; ".join(map(str, self.stretches))} if self.stretches else {}),
            "truth ±": "; ".join(deviations) + " (of one reading, and of all together)",
        }


def _listed(values: Array, form: str) -> str:
    return f"({', '.join(format(float(v), form) for v in values)})"


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
    names = tuple(joints) or robot.positioning[:3]
    robot.index(names)
    if not 1 <= len(names) <= 3 or len(set(names)) < len(names):
        raise CalibrationError(
            f"{track.source}: the place of a marker tells 1 to 3 joints, each named once, not "
            f"{', '.join(names)}"
        )
    motion = TrackedMotion.of(recording, chain, names)
    begins = 0.0 if math.isnan(recording.provenance.start) else recording.provenance.start
    about = _coarse_offset(motion, track, near, begins) if offset is None else offset - begins
    start = TrackStart.of(registration, motion, track, about, delayed=offset is None)
    fit = fit_track(motion, track, start)
    _check_seen(track.source, fit, motion)
    rows, inlier, strays, stretches = _judge(motion, track, start, fit)
    truth, noise_sd, pose_sd = _solve(rows, fit)
    columns = {f"truth/{name}": truth[:, k] for k, name in enumerate(names)}
    sd, by = (math.nan, ()) if offset is not None else (float(fit.sds("delay")[0]), ("the tool",))
    clock = ClockOffset(fit.offset + begins, sd, by)
    joined, _ = join_truth(recording, Stream(track.t[inlier], columns), clock.seconds)
    registered = Registered(
        base_from_tracker=pose_matrix(fit.state.rotation, fit.state.translation)
        @ start.base_from_tracker,
        base_sd=fit.sds(*POSE),
        link=link,
        link_from_marker=pose_matrix(fit.state.turn, fit.state.marker),
        marker_sd=fit.sds(*MARKER),
        clock=clock,
        noise=fit.noise,
        joints=names,
        units=tuple(robot.joint(name).unit for name in names),
        noise_deviation=noise_sd,
        pose_deviation=pose_sd,
        readings=len(rows),
        strays=strays,
        stretches=stretches,
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


def _described(joined: Recording, registered: Registered, track: Track) -> Recording:
    """Note in a recording's provenance where its truth is from, and what was dropped."""
    about, stretches = registered.summary(), registered.stretches
    notes = [
        joined.provenance.notes,
        f"truth of a tracker, {track.source}: registered {about['± (1 sd)']}; truth ± "
        f"{about['truth ±']}",
        *(f"left out: {stretch}" for stretch in stretches),
    ]
    dropped = {
        **joined.provenance.dropped,
        **track.dropped,
        "tracker: strays": registered.strays,
        "tracker: off for a while": sum(stretch.readings for stretch in stretches),
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


_WORDS: Final = {
    **{f"turn {axis}": f"a turn of the base about its {axis} axis" for axis in "xyz"},
    **{f"shift {axis}": f"a shift of the base along {axis}" for axis in "xyz"},
    **{f"marker {axis}": f"the marker's place along {axis} of its link" for axis in "xyz"},
}


def _check_seen(source: str, fit: TrackFit, motion: TrackedMotion) -> None:
    """Refuse a motion that leaves the zero of a joint open; say what it is mixed up with."""
    sds, open_ = np.sqrt(np.diag(fit.covariance)), []
    places = [fit.state.names.index(parameter) for parameter in _WORDS]
    for name, zero in zip(motion.terms.joints, motion.terms.zeros, strict=True):
        if sds[zero] > _UNSEEN * motion.sd[zero]:
            scale = np.maximum(sds[zero] * sds[places], 1e-300)
            alike = int(np.argmax(np.abs(fit.covariance[zero, places]) / scale))
            open_.append(f"the zero of {name} from {list(_WORDS.values())[alike]}")
    if open_:
        raise CalibrationError(
            f"{source}: the motion does not tell {', nor '.join(open_)}; state what is known in a "
            "registration: the base's pose, touched points of it, a stop of the joint, the "
            "marker's place (--registration, docs/tracker.md)"
        )


def _judge(
    motion: TrackedMotion, track: Track, start: TrackStart, fit: TrackFit
) -> tuple[TipRows, Mask, int, tuple[Stretch, ...]]:
    """Tell inliers from strays, and from stretches of time in which most readings stray.

    Gives the rows of the inliers, which readings (n,) these are, the number of strays, and the
    stretches. Refuses points that do not follow the tool, and says when they leave it.
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
    out = strays + sum(stretch.readings for stretch in stretches)
    share = out / (out + int(inlier.sum()))
    way = float(np.linalg.norm(np.std(motion.path, axis=0)))
    if share > _MOST_STRAYS or fit.noise > _MOST_NOISE * way or len(jumps):
        words = [str(stretch) for stretch in stretches[:_SHOWN]]
        if len(jumps):
            words.append(f"they jump at {', '.join(f'{t:.1f}' for t in jumps[:_SHOWN])} s")
        when = f" ({'; '.join(words)})" if words else ""
        raise CalibrationError(
            f"{track.source}: the points follow the tool, which moves {1e3 * way:.0f} mm, to no "
            f"better than {1e3 * fit.noise:.1f} mm, and {100 * share:.0f} % are further off than "
            f"{GATE:g} times that{when}; does the tracker confuse two markers, or is it another "
            "motion? Look at them, and leave such stretches out"
        )
    return rows.rows(inlier), inlier, strays, stretches


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
    parts: list[Integers] = []
    most = medfilt(stray.astype(np.float64), _RUN)
    for first, end in runs(np.convolve(most, np.ones(_RUN), "same") > 0.0):
        rows = first + np.flatnonzero(stray[first:end])
        if parts and _is_one(parts[-1], rows, shift, noise):
            rows = np.concatenate([parts.pop(), rows])
        parts.append(rows)
    within, stretches = np.zeros(len(t), dtype=np.bool_), []
    for rows in parts:
        whole = slice(rows[0], rows[-1] + 1)
        within[whole] = True
        begin, end = t[rows[[0, -1]]].tolist()
        count = int(inside[whole].sum())
        _, distance, is_alike = _off(shift[rows], noise)
        stretches.append(Stretch(begin, end, count, distance, is_alike))
    return tuple(stretches), within


def _off(shift: Array, noise: float) -> tuple[Array, float, bool]:
    """Median (3,) of shifts (n, 3) [m], their median length, and whether all are alike."""
    middle = np.median(shift, axis=0)
    distance, spread = (
        float(np.median(np.linalg.norm(off, axis=1))) for off in (shift, shift - middle)
    )
    return middle, distance, spread < max(GATE * noise, _ALIKE * distance)


def _is_one(before: Integers, rows: Integers, shift: Array, noise: float) -> bool:
    """Whether two stretches, the second not long after the first, are off by the same."""
    first, second = _off(shift[before], noise), _off(shift[rows], noise)
    is_near = rows[0] - before[-1] < max(np.ptp(rows), np.ptp(before))
    between = np.linalg.norm(second[0] - first[0])
    is_same = between < max(GATE * noise, _ALIKE * second[1])
    return bool(is_near and first[2] and second[2] and is_same)


def _solve(rows: TipRows, fit: TrackFit) -> tuple[Array, Array, Array]:
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
    sds = [np.sqrt(variance.mean(axis=0)) for variance in (single, together)]
    return joint[:, columns], sds[0], sds[1]
