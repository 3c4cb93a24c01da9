"""Truth of the joints from a tracker or a camera: where it stands, and the joints at its points.

The pose of the tracker in the robot's base, the marker's place on the tool, smooth corrections of
the joints and the delay of the tracker are estimated together, by the fit of `TipRows`. A zero that
no motion can tell from them is named, and must be stated by a person.
"""

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Final, NamedTuple

import numpy as np
from scipy.signal import medfilt
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from truejoint import schema
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
from truejoint.recordings.table.stream import GAP_STEPS, Stream
from truejoint.robots import Robot
from truejoint.robots.chain import SerialChain
from truejoint.robots.parts import Kinematics
from truejoint.schema import Bounds, Key, Shape
from truejoint.summary import Summarised
from truejoint.tip.fit import (
    GATE,
    NORM_MEDIAN,
    TipFit,
    TipPrior,
    TipRows,
    TipState,
    align,
    cross_matrix,
    fit_rows,
    inverted,
    noise_of,
    normal_equations,
    pose_matrix,
    whiten_rows,
)
from truejoint.tip.terms import TRACKED, TRACKED_ZERO, Terms
from truejoint.toml_file import read_toml
from truejoint.units import display_unit, with_unit

# A joint that moves less is held: its motor shows its cable, and no motion of the tool.
_HELD: Final = {"rad": 0.1, "m": 5e-3}
_OTHER_SD: Final = {"rad": 0.02, "m": 1e-3}  # of a joint that is not to be found, on its motor
_DELAY_SD: Final = 10.0  # s
_MARKER_SD: Final = 0.05  # m, of a marker of which nothing is stated
_FEWEST: Final = 50  # readings of the recording's time
_MOST_READINGS: Final = 4000  # that the fit takes, spread over the motion
_ROUNDS: Final = 3  # of taking rows anew after the delay is estimated
_PARTS: Final = 20  # of the motion, whose differences give the covariance
_BY_CHANCE: Final = 1e-4  # that touched points lie so far off each other
_MIRROR: Final = 0.25  # share of the residual that is left when the points are mirrored
_UNSEEN: Final = 0.3  # share of a zero's prior deviation, above which the motion did not show it
_SOLVES: Final = 3  # Newton steps from a corrected position to that of a point
_MOST_STRAYS: Final = 1 / 3
_FARTHEST: Final = 4.0  # of a zero's prior deviation
_FINEST: Final = 1e-4  # m, noise below which what no correction follows would pass for strays
_MOST_NOISE: Final = 0.1  # share of the tool's way
_RUN: Final = 11  # readings, of which six stray where a stretch does
_ALIKE: Final = 0.1  # of their distance by which readings of another marker may differ
_SHOWN: Final = 3  # stretches or jumps in a message
_JUMP: Final = 10.0  # deviations of a reading or of parts, by which later ones are elsewhere
_SMOOTH: Final = 2.0  # times that deviation, by which they are off where a fit is no good
_LIKE: Final = 30.0  # the tool's way and the points' are at most this many times each other
_WORDS: Final = (
    *(f"a turn of the base about its {axis} axis" for axis in "xyz"),
    *(f"a shift of the base along {axis}" for axis in "xyz"),
    *(f"the marker's place along {axis} of its link" for axis in "xyz"),
)
"""A frame's pose and a marker's place, in the order of `TipState.names`."""
_Point = Annotated[Array, Shape((3,))]
_ABOVE: Final = Bounds(0.0, above=True)


class Base(NamedTuple):
    """Pose of the robot's base frame in the tracker's, and its deviations per axis.

    Examples
    --------
    >>> Base(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), sd=2e-4, turn_sd=5e-4).sd
    0.0002
    """

    position: Annotated[_Point, Key("position_mm", 1e-3)]  # [m]
    quaternion: Annotated[Array, Shape((4,))]  # x, y, z, w
    sd: Annotated[float, _ABOVE, Key("sd_mm", 1e-3)]  # [m]
    turn_sd: Annotated[float, _ABOVE, Key("sd_deg", math.pi / 180.0)]  # [rad]


class Marker(NamedTuple):
    """Joint whose link carries a marker, by default the tool; and its place there.

    Examples
    --------
    >>> Marker("roll").position is None
    True
    """

    link: str = ""
    position: Annotated[Array | None, Shape((3,)), Key("position_mm", 1e-3)] = None  # [m]
    sd: Annotated[float | None, _ABOVE, Key("sd_mm", 1e-3)] = None  # per axis [m]


class Touched(NamedTuple):
    """Point of the base that the tracker's pointer touched, in both frames [m].

    Examples
    --------
    >>> Touched(np.zeros(3), np.array([0.8, 0.0, 0.3])).base
    array([0., 0., 0.])
    """

    base: Annotated[_Point, Key("base_mm", 1e-3)]
    tracker: Annotated[_Point, Key("tracker_mm", 1e-3)]


@dataclass(frozen=True, eq=False)
class Registration:
    """A tracker beside a robot, as its file describes it (docs/tracker.md).

    Attributes
    ----------
    base : Base, optional
        Pose of the robot's base frame in the tracker's; None where it is to be found.
    marker : Marker
    touched : tuple of Touched
        Points of the base that the tracker has seen.
    touched_sd : float, optional
        Deviation of these, per axis [m].

    Raises
    ------
    CalibrationError
        If things that belong together are stated apart, or one thing twice, or touched points lie
        in a line or do not fit.

    Examples
    --------
    >>> Registration(marker=Marker("roll", np.zeros(3), 2e-4)).base is None
    True
    """

    base: Base | None = None
    marker: Marker = field(default_factory=Marker)
    touched: tuple[Touched, ...] = ()
    touched_sd: Annotated[float | None, _ABOVE, Key("touched_sd_mm", 1e-3)] = None

    def __post_init__(self) -> None:
        if not isinstance(self.base, Base | None):
            raise CalibrationError(other_kind(self.base, "Base", "Registration(Base(...)) takes"))
        if self.base is not None and not abs(np.linalg.norm(self.base.quaternion) - 1.0) < 1e-2:
            raise CalibrationError("base.quaternion: give x, y, z, w of a unit quaternion")
        if self.base is not None and self.touched:
            raise CalibrationError("base and touched points state one thing; leave one of them out")
        if self.marker.position is not None and self.marker.sd is None:
            raise CalibrationError("marker.sd_mm is missing; state its deviation")
        if (self.touched_sd is None) != (not self.touched):
            raise CalibrationError(
                "touched_sd_mm and touched points belong together; give both, or neither"
            )
        self.known_base()

    def known_base(self) -> tuple[Array | None, Array]:
        """Pose (4, 4) of the tracker in the robot's base [m], None where nothing says it.

        And what is known of it, the inverse covariance (6, 6) of a turn about and a shift along the
        axes of the base. Raises CalibrationError if touched points lie in a line or do not fit.
        """
        if self.base is not None:
            turn = Rotation.from_quat(self.base.quaternion).as_matrix()
            pose = np.asarray(np.linalg.inv(pose_matrix(turn, self.base.position)))
            return pose, np.diag(np.repeat([self.base.turn_sd, self.base.sd], 3) ** -2.0)
        if self.touched_sd is None:
            return None, np.zeros((6, 6))
        ours, theirs = np.array(self.touched).transpose(1, 0, 2)
        turn, shift = align(ours, theirs)
        square, m = float(((theirs @ turn.T + shift - ours) ** 2).sum()), len(ours)
        if square > self.touched_sd**2 * chi2.isf(_BY_CHANCE, 3 * m - 6):
            far, sd = (with_unit(v, "m") for v in (math.sqrt(square / m), self.touched_sd))
            raise CalibrationError(
                f"touched points: base and tracker, laid over each other, are {far} apart (RMS), "
                f"and touched_sd_mm says {sd}; is a point mistyped, another one, or the frame "
                "scaled or left-handed?"
            )
        rows = np.concatenate([cross_matrix(ours), -np.tile(np.eye(3), (m, 1, 1))], axis=2)
        precision = np.einsum("mia,mib->ab", rows, rows) / self.touched_sd**2
        return pose_matrix(turn, shift), precision


def read_registration(path: str | os.PathLike[str]) -> Registration:
    r"""Registration of a TOML file (docs/formats.md), whose numbers are in mm and deg.

    Raises CalibrationError naming the key and the rule that it breaks.

    Examples
    --------
    >>> text = '[marker]\nlink = "roll"\nposition_mm = [0, 0, 8]\nsd_mm = 0.2'
    >>> _ = Path("tracker.toml").write_text(text)
    >>> read_registration(Path("tracker.toml")).marker.position
    array([0.   , 0.   , 0.008])
    """
    values = read_toml(Path(path), CalibrationError)
    return schema.read(Registration, values, str(path), CalibrationError)


@dataclass(frozen=True)
class Stretch:
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
    """Pose and marker of a tracker, and how sure they are.

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
        Time to add to the tracker's stamps to have the robot's; its delay is part of it.
    noise : float
        Standard deviation per axis of the points about the fit [m].
    joints : tuple of str
        Joints whose truth was found.
    noise_deviation : ndarray, shape (n_joints,)
        Effect of that noise on a single truth, root mean square over the motion [rad or m].
    pose_deviation : ndarray, shape (n_joints,)
        Common error of all truths, as the transforms are known no better [rad or m].
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
    recording: Recording, track: Track, registration: Registration | None = None,
    joints: Sequence[str] = (), *, offset: float | None = None, near: float | None = None,
) -> tuple[Recording, Registered]:  # fmt: skip
    """Give a recording the truth of its joints that a tracker saw from outside.

    The delay is estimated coarsely as in `join_truth`, by the path of the tool in any frame. Then
    the tracker's pose, the marker's place, the delay and corrections of the joints (zero, slopes
    and squares in all of them, two plays each) are fitted together. Readings further off
    than 4.5 deviations are dropped as outliers. So is a whole stretch of time in which most are
    outliers: there the tracker took another marker for this one. The truth of each inlier is the
    position of the joints that puts the marker there.

    Parameters
    ----------
    recording : Recording
        Without a truth.
    track : Track
    registration : Registration, optional
        Registration of the tracker.
    joints : sequence of str
        Up to three; by default the first of those that mainly place the tool.
    offset, near : float, optional
        Offset of the clocks [s], as in `join_truth`. If both have the time of day, as in one bag,
        and cover the same time, it is near 0 unless stated.

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
    >>> base = Base(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), 1e-3, 1e-3)
    >>> known = Registration(base, Marker("", np.zeros(3), 1e-4))
    >>> tracked, found = tracked_truth(recording, truejoint.recordings.Track(t, points), known)
    >>> tracked.joints_of("truth"), bool(abs(found.clock.seconds) < 0.01)
    (('shoulder', 'elbow', 'insertion'), True)
    """
    registration = registration or Registration()
    robot = as_recording(recording).robot
    if not isinstance(track, Track):
        raise RecordingError(other_kind(track, "Track", "read_track(path) reads one"))
    chain, link = carrier(robot, registration.marker.link)
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
    base, prior, near_track = _start_of(registration, motion, track, about, delayed=offset is None)
    fit, about = fit_track(motion, near_track, prior, about)
    _check_seen(track.source, fit, motion)
    rows, inlier, strays, stretches = _judge(motion, near_track, fit, about)
    truth, noise_sd, pose_sd = _solve(rows, fit)
    columns = {f"truth/{name}": truth[:, k] for k, name in enumerate(names)}
    delay_sd, *sds = fit.sd[len(fit.state.coefficients) - 1 :]
    sd, by = (math.nan, ()) if offset is not None else (float(delay_sd), ("the tool",))
    clock = ClockOffset(about + begins, sd, by)
    joined, _ = join_truth(recording, Stream(track.t[inlier], columns), clock.seconds)
    registered = Registered(
        base_from_tracker=pose_matrix(fit.state.rotation, fit.state.translation) @ base,
        base_sd=np.array(sds[:6]), link=link,
        link_from_marker=pose_matrix(fit.state.turn, fit.state.marker),
        marker_sd=np.array(sds[6:9]), clock=clock, noise=fit.rows.point_sd, joints=names,
        units=tuple(robot.joint(name).unit for name in names), noise_deviation=noise_sd,
        pose_deviation=pose_sd, readings=len(rows), strays=strays, stretches=stretches,
    )  # fmt: skip
    return _described(joined, registered, track), registered


def carrier(robot: Robot, link: str) -> tuple[Kinematics, str]:
    """Kinematics of what carries a marker, and the joint that moves it; the tool without a `link`.

    Raises RobotError where kinematics are not known, CalibrationError if they are of no chain.
    """
    kinematics = robot.known_kinematics("a marker on the tool")
    if not link:
        return kinematics, robot.joint_names[-1]
    if not isinstance(kinematics, SerialChain):
        raise CalibrationError(f"{robot.title}: only the tool of its kinematics can carry a marker")
    return kinematics.up_to(robot.index([link])[0]), link


def _described(joined: Recording, registered: Registered, track: Track) -> Recording:
    """Note in a recording's provenance where its truth is from, and what was dropped."""
    about, origin, stretches = registered.summary(), joined.provenance, registered.stretches
    found = f"registered {about['± (1 sd)']}; truth ± {about['truth ±']}"
    left_out = [f"left out: {stretch}" for stretch in stretches]
    notes = [origin.notes, f"truth of a tracker, {track.source}: {found}", *left_out]
    off = sum(stretch.readings for stretch in stretches)
    tracker = {"tracker: strays": registered.strays, "tracker: off for a while": off}
    dropped = {**origin.dropped, **track.dropped, **tracker}
    text = "; ".join(filter(None, notes))
    return replace(joined, provenance=replace(origin, notes=text, dropped=dropped))


def _coarse_offset(
    motion: "TrackedMotion", track: Track, near: float | None, begins: float
) -> float:
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


def _check_seen(source: str, fit: TipFit, motion: "TrackedMotion") -> None:
    """Refuse a motion that leaves a joint's zero open, by what it is mixed up with, or far off."""
    k, sd, open_ = len(fit.state.coefficients), fit.sd, []
    places = slice(k, k + len(_WORDS))
    for name, zero in zip(motion.terms.joints, motion.terms.zeros, strict=True):
        if sd[zero] > _UNSEEN * motion.sd[zero]:
            scale = np.maximum(sd[zero] * sd[places], 1e-300)
            alike = int(np.argmax(np.abs(fit.covariance[zero, places]) / scale))
            open_.append(f"the zero of {name} from {_WORDS[alike]}")
    if open_:
        raise CalibrationError(
            f"{source}: the motion does not tell {', nor '.join(open_)}; state the base's pose, "
            "touched points of it, or the marker's place (--registration, docs/tracker.md)"
        )
    zeros = fit.state.coefficients[motion.terms.zeros] / motion.sd[motion.terms.zeros]
    if np.abs(zeros).max() > _FARTHEST:
        name = motion.terms.joints[int(np.abs(zeros).argmax())]
        raise CalibrationError(
            f"{source}: the zero of {name} would be further off than any arm's; is the base in the "
            "registration that of the kinematics, and its quaternion x, y, z, w?"
        )


def _judge(
    motion: "TrackedMotion", track: Track, fit: TipFit, offset: float
) -> tuple[TipRows, Mask, int, tuple[Stretch, ...]]:
    """Tell inliers from strays, and from stretches of time in which most readings stray.

    Gives the rows of the inliers, which readings (n,) these are, the number of strays, and the
    stretches. Refuses points that do not follow the tool, and says when they leave it.
    """
    stamps, noise, state = track.t + offset, max(fit.rows.point_sd, _FINEST), fit.state
    rows, inside = motion.rows(stamps, track.position), motion.inside(stamps)
    off = -rows.residual(state) @ state.rotation.T  # in the base's axes
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
    if share > _MOST_STRAYS or noise > _MOST_NOISE * way or len(jumps):
        words = [str(stretch) for stretch in stretches[:_SHOWN]]
        if len(jumps):
            words.append(f"they jump at {', '.join(f'{t:.1f}' for t in jumps[:_SHOWN])} s")
        when = f" ({'; '.join(words)})" if words else ""
        raise CalibrationError(
            f"{track.source}: the points follow the tool, which moves {1e3 * way:.0f} mm, to no "
            f"better than {1e3 * noise:.1f} mm, and {100 * share:.0f} % are further off than "
            f"{GATE:g} times that{when}; does the tracker confuse two markers, or is it another "
            "motion? Leave such stretches out"
        )
    if slip := _slip(stamps[inlier], on_link[inlier], noise):
        raise CalibrationError(f"{track.source}: {slip}; leave out what is before, or after")
    return rows.rows(inlier), inlier, strays, stretches


def _slip(t: Array, shift: Array, noise: float) -> str:
    """Say when the inliers' `shift` (n, 3) [m] goes to another level, and stays; empty if never.

    At the largest cumulative sum. Unlike drift it is sudden, beyond a reading's `noise` [m] and how
    parts of the motion differ.
    """
    n, edge = len(t), max(_RUN, len(t) // _PARTS)
    after = np.arange(edge, n - edge)
    sums = np.cumsum(shift - shift.mean(axis=0), axis=0)[after - 1]
    k = int(after[np.argmax((sums**2).sum(axis=1) / (after * (n - after)))])
    step = shift[k:].mean(axis=0) - shift[:k].mean(axis=0)
    level = shift - step * (np.arange(n) >= k)[:, None]
    parts = np.array([level[part].mean(axis=0) for part in _parts(n)]) - level.mean(axis=0)
    sd = n * math.sqrt(float((parts**2).mean()) / (_PARTS * k * (n - k)))
    far = float(np.linalg.norm(step))
    sudden = shift[k : k + _RUN].mean(axis=0) - shift[k - _RUN : k].mean(axis=0)
    if far < max(noise, _JUMP * sd) or sudden @ step < 0.5 * far**2:
        return ""
    return f"the marker slips at {t[k]:.1f} s, by {with_unit(far, 'm')} or more"


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
    `shift` (n, 3) [m] on the marker's link, another marker is seen. Two stretches with less between
    them than the longer one has are one: a fit may bend to them.
    """
    parts: list[Integers] = []
    most = medfilt(stray.astype(np.float64), _RUN)
    for first, end in runs(np.convolve(most, np.ones(_RUN), "same") > 0.0):
        rows = first + np.flatnonzero(stray[first:end])
        if parts and rows[0] - parts[-1][-1] < max(np.ptp(rows), np.ptp(parts[-1])):
            rows = np.concatenate([parts.pop(), rows])
        parts.append(rows)
    within, stretches = np.zeros(len(t), dtype=np.bool_), []
    for rows in parts:
        whole = slice(rows[0], rows[-1] + 1)
        within[whole] = True
        begin, end = t[rows[[0, -1]]].tolist()
        distance, spread = (
            float(np.median(np.linalg.norm(shift[rows] - origin, axis=1)))
            for origin in (0.0, np.median(shift[rows], axis=0))
        )
        alike = spread < max(GATE * noise, _ALIKE * distance)
        stretches.append(Stretch(begin, end, int(inside[whole].sum()), distance, alike))
    return tuple(stretches), within


def _solve(rows: TipRows, fit: TipFit) -> tuple[Array, Array, Array]:
    """Joints (n, n_joints) at every inlier, and their deviations by noise and by the transforms.

    From the point alone, which tells more than an orientation.
    """
    columns, k = list(rows.columns), len(fit.state.coefficients)
    joint, bare = rows.corrected(fit.state), replace(fit.state, coefficients=np.zeros(k))
    for _ in range(_SOLVES):
        equations = replace(rows, joint=joint).equations(bare)
        back = np.linalg.pinv(equations.by_joint[:, :, columns])
        joint[:, columns] -= (back @ equations.residual[:, :, None])[:, :, 0]
    moved = back @ equations.by_parameter[:, :, k:]
    together = np.einsum("mia,ab,mib->mi", moved, fit.covariance[k:, k:], moved)
    single = fit.rows.point_sd**2 * (back**2).sum(axis=2)
    noise_sd, pose_sd = (np.sqrt(variance.mean(axis=0)) for variance in (single, together))
    return joint[:, columns], noise_sd, pose_sd


@dataclass(frozen=True, eq=False)
class TrackedMotion:
    """Motion of the tool by a recording, and the terms of the joints' corrections, by row."""

    t: Array  # (n,), [s]
    kinematics: Kinematics  # Of what carries the marker
    terms: Terms
    columns: tuple[int, ...]  # Joints whose truth is sought
    joint: Array  # (n, n_joints), all joints [rad or m]
    shared: Array  # Columns of the terms
    plays: Array  # Columns of the terms
    velocity: Array  # Of the joints that are sought [rad/s or m/s]
    sd: Array  # (k,), prior deviations of the terms' coefficients
    joint_sd: Array  # (n_joints,), of the joints that are not sought [rad or m]; 0 of the others

    @classmethod
    def of(
        cls, recording: Recording, kinematics: Kinematics, joints: Sequence[str]
    ) -> "TrackedMotion":
        """Motion of a recording; raises CalibrationError if one of the `joints` stands still."""
        robot, measured = recording.robot, recording.joints_of("measured")
        joint = np.tile(robot.home, (len(recording), 1))
        for k, name in enumerate(robot.joint_names):
            if name in measured:
                joint[:, k] = recording.column(f"measured/{name}")
                if name not in joints and np.ptp(joint[:, k]) < _HELD[robot.joint(name).unit]:
                    joint[:, k] = joint[:, k].mean()
        terms, columns = Terms.of_motion(recording, joints), robot.index(joints)
        shared, plays = terms.columns(terms.features.compute(recording))
        sd = terms.sds({"zero": 0.0, **TRACKED})
        sd[terms.zeros] = [TRACKED_ZERO[robot.joint(name).unit] for name in joints] / terms.scale
        velocity = np.gradient(joint[:, columns], recording.t, axis=0)
        joint_sd = np.array([0.0 if j.name in joints else _OTHER_SD[j.unit] for j in robot.joints])
        return cls(
            recording.t, kinematics, terms, tuple(columns), joint, shared, plays, velocity,
            sd, joint_sd,
        )  # fmt: skip

    @property
    def path(self) -> Array:
        """Place of the tool by the measured joints (n, 3) [m]."""
        return np.asarray(self.kinematics.forward(self.joint)[:, :3, 3])

    def inside(self, stamps: Array) -> Mask:
        """Which stamps (m,) lie within the recording, and in no gap of it."""
        after = np.clip(np.searchsorted(self.t, stamps), 1, len(self.t) - 1)
        step = self.t[after] - self.t[after - 1]
        within = (stamps >= self.t[0]) & (stamps <= self.t[-1])
        return np.asarray(within & (step <= GAP_STEPS * np.median(np.diff(self.t))))

    def at(self, stamps: Array, values: Array) -> Array:
        """Values (n, ...) of the rows, interpolated at stamps (m,) [s]: (m, ...)."""
        flat = values.reshape(len(values), -1).T
        columns = np.column_stack([np.interp(stamps, self.t, column) for column in flat])
        return columns.reshape(len(stamps), *values.shape[1:])

    def rows(self, stamps: Array, points: Array, quaternion: Array | None = None) -> TipRows:
        """Rows of points (m, 3) [m], and orientations (m, 4), seen at stamps (m,) [s].

        The last coefficient is the delay [s].
        """
        basis = self.terms.basis(self.at(stamps, self.shared), self.at(stamps, self.plays))
        basis = np.dstack([basis, self.at(stamps, self.velocity)])
        turns = None if quaternion is None else Rotation.from_quat(quaternion).as_matrix()
        joint, alike = self.at(stamps, self.joint), np.ones(1 if turns is None else 2)
        return TipRows(
            self.kinematics, joint, self.columns, basis, points, 1.0, self.joint_sd, turns, alike
        )


def _start_of(
    registration: Registration, motion: TrackedMotion, track: Track, offset: float, *, delayed: bool
) -> tuple[Array, TipPrior, Track]:
    """Give the tracker's pose (4, 4), nearly, the prior of a fit, and the track in that base.

    The `offset` of the clocks [s] counts as stated if not `delayed`. Raises CalibrationError if the
    readings are of another time or of a left-handed frame.
    """
    stamps = track.t + offset
    inside = motion.inside(stamps)
    if inside.sum() < _FEWEST:
        raise CalibrationError(
            f"{track.source}: {int(inside.sum())} of {len(track)} readings are of the recording's "
            "time; is it the same motion? State the clocks' offset (--offset-s, or --near-s)"
        )
    stated = registration.marker
    marker = np.zeros(3) if stated.position is None else stated.position
    poses = motion.kinematics.forward(motion.at(stamps[inside], motion.joint))
    tip, point = poses[:, :3, 3] + poses[:, :3, :3] @ marker, track.position[inside]
    as_it_is, mirrored = (
        Rotation.align_vectors(tip - tip.mean(axis=0), sign * (point - point.mean(axis=0)))[1]
        for sign in (1.0, -1.0)
    )
    if mirrored**2 < _MIRROR * as_it_is**2:
        raise CalibrationError(
            f"{track.source}: the points fit only mirrored: the frame is left-handed; change the "
            "sign of one axis"
        )
    base, pose_precision = registration.known_base()
    if base is None:
        base = pose_matrix(*align(tip, point))
    turned, turn = None, np.eye(3)
    if track.orientation is not None:
        rotation = Rotation.from_matrix(base[:3, :3]) * Rotation.from_quat(track.orientation)
        turned, on_link = rotation.as_quat(), Rotation.from_matrix(poses[:, :3, :3]).inv()
        turn = (on_link * rotation[inside]).mean().as_matrix()
    prior = TipPrior.of(
        TipState(np.zeros(len(motion.sd) + 1), marker=marker, turn=turn),
        np.append(motion.sd, _DELAY_SD if delayed else 0.0),
        marker=_MARKER_SD if stated.sd is None else stated.sd,
        turn=0.0 if turned is None else np.inf,
        pose_precision=pose_precision,
    )
    moved = track.position @ base[:3, :3].T + base[:3, 3]
    return base, prior, replace(track, position=moved, orientation=turned)


def fit_track(
    motion: TrackedMotion, track: Track, prior: TipPrior, offset: float
) -> tuple[TipFit, float]:
    """Fit to readings spread over the motion, and find the offset of the clocks [s], delay and all.

    Rows are taken anew after the delay is estimated. Neighbouring residuals share what the terms
    cannot follow, so several count as one: by the variance of parts of the motion against that of
    single readings. At first no outlier is dropped, as all may be far off. The fit states the noise
    of the readings, and the covariance of the parameters by how much parts of the motion differ;
    its last coefficient, the delay, is 0.
    """
    state = prior.state
    for _ in range(_ROUNDS):
        inside = np.flatnonzero(motion.inside(track.t + offset))
        seen = track.rows(inside[:: -(-len(inside) // _MOST_READINGS)])
        rows = motion.rows(seen.t + offset, seen.position, seen.orientation)
        for gate in (math.inf, GATE, GATE):
            fit = fit_rows(rows, prior, gate=gate, start=state)
            state, (length, noise) = fit.state, noise_of(fit.residual)
            near = fit.residual[(length / noise).max(axis=1) <= GATE].reshape(-1, len(noise), 3)
            means = np.array([near[part].mean(axis=0) for part in _parts(len(near))])
            share = np.mean(means**2, axis=(0, 2)) / np.mean(near**2, axis=(0, 2))
            several = np.maximum(1.0, len(near) / _PARTS * share)
            rows = replace(rows, alike=several, point_sd=float(noise[0]))
        covariance, delay = _covariance(fit, motion.terms), float(state.coefficients[-1])
        offset += delay
        state = replace(state, coefficients=np.append(state.coefficients[:-1], 0.0))
        sd = float(np.sqrt(covariance[len(state.coefficients) - 1, len(state.coefficients) - 1]))
        if abs(delay) < max(0.1 * sd, 1e-5):
            break
    return replace(fit, rows=rows, state=state, covariance=covariance), offset


def _parts(m: int) -> list[slice]:
    """Rows of consecutive parts of the motion."""
    return [slice(a, b) for a, b in pairwise(np.linspace(0, m, _PARTS + 1).astype(int))]


def _covariance(fit: TipFit, terms: Terms) -> Array:
    """Covariance (n, n) of the parameters, by how much parts of the motion differ.

    Delete-a-group jackknife (Efron and Tibshirani, An Introduction to the Bootstrap, 1993, ch. 11)
    in linear form, and what the prior's own uncertainty adds.
    """
    prior, names, free = fit.prior, fit.state.names, fit.prior.free
    block = np.ix_(free, free)
    white = whiten_rows(fit.rows, ~fit.left_out, fit.state)
    normal, _ = normal_equations(prior, fit.state, white)
    root = np.sqrt(white.weight)
    residual, jacobian = root[:, None] * white.residual, root[:, None, None] * white.jacobian
    steps = []
    for rows in _parts(len(residual)):
        flat = jacobian[rows].reshape(-1, len(prior.free))
        pull = flat.T @ residual[rows].ravel()
        steps.append(np.linalg.solve((normal - flat.T @ flat)[block], pull[free]))
    off = np.array(steps) - np.mean(steps, axis=0)
    inverse = inverted(normal, names, free)
    covariance = inverse @ prior.precision @ inverse
    covariance[block] += (_PARTS - 1) / _PARTS * off.T @ off
    # Friction may pass for a delay: as much as the plays explain would be taken for one.
    delay = len(fit.state.coefficients) - 1
    if prior.free[delay]:
        plays = np.flatnonzero(np.array(terms.kinds) == "play")
        rest = free.copy()
        rest[plays] = False
        effect = normal[:, plays] @ fit.state.coefficients[plays]
        covariance[delay, delay] += float(inverted(normal, names, rest)[delay] @ effect) ** 2
    return covariance
