"""Truth of the joints from a tracker or a camera: where it stands, and what its points then say.

The pose of the tracker in the robot's base, the marker's place on the tool, smooth corrections of
the joints and the delay of the tracker are estimated together, by robust least squares over the
rows of `tip_rows`. What no motion can tell apart is named, and taken from what a person states.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np
from scipy.signal import medfilt
from scipy.spatial.transform import Rotation

from truejoint.array_types import Array, Mask
from truejoint.calibration.registration import Registered, Registration
from truejoint.calibration.tip_rows import (
    GATE,
    HUBER,
    MARKER,
    POSE,
    TipPrior,
    TipRows,
    TipState,
    align,
)
from truejoint.errors import CalibrationError
from truejoint.models.features import Feature, FeatureSet
from truejoint.recordings.joining import ClockOffset, find_path_offset, join_truth
from truejoint.recordings.recording import Recording
from truejoint.recordings.signals import GAP_STEPS
from truejoint.recordings.synchronise import Stream
from truejoint.recordings.tracker import Track
from truejoint.robots import Robot
from truejoint.robots.chain import SerialChain
from truejoint.robots.robot import Kinematics

# What cables may do, as standard deviations: a zero, then shares of half a joint's way that a
# slope and a square of any joint's position may be worth at its end, then a play's height.
_ZERO_SD: Final = {"rad": 0.2, "m": 0.02}
_SLOPE_SD, _SQUARE_SD, _PLAY_SD = 0.15, 0.05, 0.03
# A joint that moves less is held: what its motor shows is its cable, and no motion of the tool.
_HELD: Final = {"rad": 0.1, "m": 5e-3}
_OTHER_SD: Final = {"rad": 0.02, "m": 1e-3}  # of a joint that is not to be found, on its motor
# Half-widths of a joint's plays, as shares of half its way: friction turns at once, cables later.
_PLAYS: Final = (0.002, 0.02)
_DELAY_SD: Final = 10.0  # s
_UNSEEN: Final = 0.3  # share of what a zero may be that is left open: the motion did not show it

_MOST_READINGS: Final = 4000  # that the fit takes, spread over the motion
_NORM_MEDIAN: Final = 1.538  # of the length of three standard normal numbers
_STEPS: Final = 40
_SETTLED: Final = 1e-2  # of a parameter's standard deviation
_BLOCKS: Final = 20  # of the motion, whose differences tell how sure the fit is
_SOLVES: Final = 3  # Newton steps from a corrected position to that of a point
_MOST_STRAYS: Final = 1 / 3
_MOST_NOISE: Final = 0.1  # share of the tool's way
_LIKE: Final = 30.0  # the tool's way and the points' are at most this many times each other
_MIRROR: Final = 0.25  # share of the residual that is left when the points are mirrored


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
    further off than 4.5 deviations are left out. The truth of each reading that is left is the
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
        Of the clocks [s], as in `join_truth`.

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
    robot, source = recording.robot, track.source
    chain, link = carrier(robot, registration.link)
    names = tuple(joints) or robot.positioning[:3]
    robot.index(names)
    if not 1 <= len(names) <= 3 or len(set(names)) < len(names):
        raise CalibrationError(
            f"{source}: the place of a marker tells 1 to 3 joints, each named once, not "
            f"{', '.join(names)}"
        )
    moving = _Motion.of(recording, chain, names)
    begins = 0.0 if math.isnan(recording.provenance.start) else recording.provenance.start
    if offset is None:
        _check_size(source, moving.path, track.position)
        coarse = find_path_offset(
            moving.t,
            moving.path,
            track.t,
            medfilt(track.position, (5, 1)),
            None if near is None else near - begins,
        )
    else:
        coarse = offset - begins
    known = _Known.of(registration, robot, moving, track, coarse, delayed=offset is None)
    fit = _fit(moving, track, known)
    _check_seen(source, fit, moving, names)
    truth, deviations, fits = _solve(moving, track, known, fit)
    inside = int(moving.inside(track.t + fit.offset).sum())
    strays = inside - int(fits.sum())
    off, way = float(fit.noise[0]), float(np.linalg.norm(np.std(moving.path, axis=0)))
    if strays > _MOST_STRAYS * inside or off > _MOST_NOISE * way:
        raise CalibrationError(
            f"{source}: the points follow the tool, which moves {1e3 * way:.0f} mm, to no better "
            f"than {1e3 * off:.1f} mm, and {100 * strays / inside:.0f} % are further off than "
            f"{GATE:g} times that; does the tracker confuse two markers, or is it another motion? "
            "Look at them, and leave such stretches out"
        )
    stream = Stream(
        track.t[fits], {f"truth/{name}": truth[fits, k] for k, name in enumerate(names)}
    )
    clock = ClockOffset(fit.offset + begins, fit.sd_of("delay"), ("the tool",))
    clock = ClockOffset(clock.seconds) if offset is not None else clock
    joined, _ = join_truth(recording, stream, clock.seconds)
    unit_of = [robot.joint(name).unit for name in names]
    base = np.eye(4)
    base[:3, :3], base[:3, 3] = fit.state.rotation, fit.state.translation
    marker = np.eye(4)
    marker[:3, :3], marker[:3, 3] = fit.turn, fit.state.marker
    registered = Registered(
        base @ known.base_from_tracker,
        fit.sds(POSE),
        link,
        marker,
        fit.sds(MARKER),
        clock,
        float(fit.noise[0]),
        names,
        tuple(unit_of),
        *deviations,
        int(fits.sum()),
        strays,
    )
    about = registered.summary()
    notes = (
        f"truth of a tracker, {source}: registered {about['± (1 sd)']}; truth ± {about['truth ±']}"
    )
    provenance = joined.provenance
    dropped = {**provenance.dropped, **track.dropped, "tracker: strays": strays}
    notes = "; ".join(filter(None, (provenance.notes, notes)))
    return replace(joined, provenance=replace(provenance, notes=notes, dropped=dropped)), registered


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


def _check_size(source: str, path: Array, points: Array) -> None:
    """Refuse points that are hardly in metres."""
    ratio = float(np.linalg.norm(np.std(points, axis=0)) / np.linalg.norm(np.std(path, axis=0)))
    if not 1.0 / _LIKE < ratio < _LIKE:
        raise CalibrationError(
            f"{source}: the points spread {ratio:.3g} times as wide as the tool moves; are they in "
            "m (--unit mm), and of this motion?"
        )


@dataclass(frozen=True, eq=False)
class _Motion:
    """What a recording says of the tool, and the terms of the joints' corrections, by row."""

    t: Array
    kinematics: Kinematics
    columns: tuple[int, ...]
    units: tuple[str, ...]
    joint: Array  # (n, all joints of the kinematics)
    common: Array  # (n, k) terms that every joint has
    plays: Array  # (n, plays of each joint)
    velocity: Array  # (n, n_joints)
    others_sd: Array  # (all joints,) of those that are not to be found; 0 of the others
    centre: Array  # (n_joints,)
    half: Array

    @classmethod
    def of(cls, recording: Recording, kinematics: Kinematics, joints: Sequence[str]) -> _Motion:
        robot = recording.robot
        known = recording.joints_of("measured")
        joint = np.tile(robot.home, (len(recording), 1))
        for k, name in enumerate(robot.joint_names):
            if name in known:
                joint[:, k] = recording.column(f"measured/{name}")
                if name not in joints and np.ptp(joint[:, k]) < _HELD[robot.joint(name).unit]:
                    joint[:, k] = joint[:, k].mean()
        columns = tuple(robot.index(joints))
        q = recording.columns("measured", joints)
        lower, upper = q.min(axis=0), q.max(axis=0)
        centre, half = (lower + upper) / 2, (upper - lower) / 2
        still = [name for name, way in zip(joints, half, strict=True) if not way > 0.0]
        if still:
            raise CalibrationError(
                f"{', '.join(still)} stand still: nothing tells their truth; move them, or name "
                "the joints to be found"
            )
        # Each from -1 to 1, a joint's one after the other.
        widths = np.outer(half, _PLAYS).ravel()
        signals = [f"measured/{name}" for name in joints for _ in _PLAYS]
        own = [Feature(s, "play", float(w)) for s, w in zip(signals, widths, strict=True)]
        plays = FeatureSet(tuple(own)).compute(recording)
        return cls(
            recording.t,
            kinematics,
            columns,
            tuple(robot.joint(name).unit for name in joints),
            joint,
            _polynomial((q - centre) / half),
            (plays - np.repeat(q, len(_PLAYS), axis=1)) / widths,
            np.gradient(q, recording.t, axis=0),
            np.array([0.0 if j.name in joints else _OTHER_SD[j.unit] for j in robot.joints]),
            centre,
            half,
        )

    @property
    def path(self) -> Array:
        """Where the tool is by the measured joints (n, 3) [m]."""
        return np.asarray(self.kinematics.forward(self.joint)[:, :3, 3])

    @property
    def sd(self) -> Array:
        """What cables may do to the coefficients of the terms, and the delay [s], (k,)."""
        count = len(self.half)
        shares = np.full(self.common.shape[1], _SQUARE_SD)
        shares[1 : 1 + count] = _SLOPE_SD
        rows = []
        for k, unit in enumerate(self.units):
            row = shares * self.half[k]
            row[0] = _ZERO_SD[unit]
            rows.append([*row, *[_PLAY_SD * self.half[k]] * len(_PLAYS)])
        return np.append(np.ravel(rows), _DELAY_SD)

    @property
    def is_play(self) -> Mask:
        """Which coefficients, the delay left out, are plays' (k,)."""
        own = np.zeros(self.common.shape[1] + len(_PLAYS), dtype=np.bool_)
        own[-len(_PLAYS) :] = True
        return np.tile(own, len(self.half))

    def basis(self, stamps: Array) -> Array:
        """Correction per coefficient (m, n_joints, k) at stamps (m,) [s]."""
        count, shared = len(self.half), self.common.shape[1]
        terms = shared + len(_PLAYS)
        basis = np.zeros((len(stamps), count, count * terms + 1))
        common = _at(stamps, self.t, self.common)
        plays, velocity = _at(stamps, self.t, self.plays), _at(stamps, self.t, self.velocity)
        for k in range(count):
            own = k * terms
            basis[:, k, own : own + shared] = common
            basis[:, k, own + shared : own + terms] = plays[:, k * len(_PLAYS) :][:, : len(_PLAYS)]
        basis[:, :, -1] = velocity
        return basis

    def inside(self, stamps: Array) -> Mask:
        """Which stamps (m,) lie within the recording, and in no gap of it."""
        after = np.clip(np.searchsorted(self.t, stamps), 1, len(self.t) - 1)
        step = self.t[after] - self.t[after - 1]
        within = (stamps >= self.t[0]) & (stamps <= self.t[-1])
        return np.asarray(within & (step <= GAP_STEPS * np.median(np.diff(self.t))))

    def rows(self, stamps: Array, points: Array) -> TipRows:
        """Rows of points (m, 3) [m] that were seen at stamps (m,) [s]."""
        return TipRows(
            self.kinematics,
            _at(stamps, self.t, self.joint),
            self.columns,
            self.basis(stamps),
            points,
            np.ones(len(stamps)),
            np.zeros(len(self.columns)),
        )


def _at(stamps: Array, t: Array, values: Array) -> Array:
    return np.column_stack([np.interp(stamps, t, column) for column in values.T])


def _polynomial(u: Array) -> Array:
    """One, positions (n, k) and their products by two."""
    first, second = np.triu_indices(u.shape[1])
    return np.column_stack([np.ones(len(u)), u, u[:, first] * u[:, second]])


@dataclass(frozen=True, eq=False)
class _Known:
    """Where a fit starts, and what is known before: in a frame near to the robot's base."""

    base_from_tracker: Array  # (4, 4) by which the points were brought there
    prior: TipPrior
    turn: Array  # (3, 3) of the marker on its link
    offset: float

    @classmethod
    def of(
        cls,
        registration: Registration,
        robot: Robot,
        motion: _Motion,
        track: Track,
        offset: float,
        *,
        delayed: bool,
    ) -> _Known:
        stamps = track.t + offset
        inside = motion.inside(stamps)
        if inside.sum() < 50:
            raise CalibrationError(
                f"{track.source}: {int(inside.sum())} of {len(track)} readings are of the "
                "recording's time; is it the same motion? State the offset of the clocks "
                "(--offset-s), or about (--near-s)"
            )
        marker = np.zeros(3) if registration.marker is None else registration.marker
        poses = motion.kinematics.forward(_at(stamps[inside], motion.t, motion.joint))
        tip = poses[:, :3, 3] + poses[:, :3, :3] @ marker
        seen = track.position[inside]
        _check_hand(track.source, tip, seen)
        base, precision = registration.known_base()
        if base is None:
            base = np.eye(4)
            base[:3, :3], base[:3, 3] = align(tip, seen)
        coefficients, stated = _stops(registration, robot, motion)
        n = len(coefficients)
        whole = np.zeros((n + 10, n + 10))
        whole[:n, :n], whole[n : n + 6, n : n + 6] = stated, precision
        whole[n + 6 : n + 9, n + 6 : n + 9] = np.diag(registration.marker_sd**-2.0)
        free = np.ones(n + 10, dtype=np.bool_)
        free[n - 1], free[-1] = delayed, False
        state = TipState(coefficients, marker=marker)
        turn = np.eye(3)
        if track.orientation is not None:
            found = Rotation.from_quat(track.orientation[inside]).as_matrix()
            between = poses[:, :3, :3].transpose(0, 2, 1) @ base[:3, :3] @ found
            turn = Rotation.from_matrix(between).mean().as_matrix()
        return cls(base, TipPrior(state, whole, free), turn, offset)


def _check_hand(source: str, tip: Array, seen: Array) -> None:
    """Refuse points of a left-handed frame."""
    ours, theirs = tip - tip.mean(axis=0), seen - seen.mean(axis=0)
    sizes = np.linalg.svd(ours.T @ theirs, compute_uv=False)
    side = np.sign(np.linalg.det(ours.T @ theirs))
    total = float(np.sum(ours**2) + np.sum(theirs**2))
    as_it_is = total - 2.0 * (sizes[0] + sizes[1] + side * sizes[2])
    mirrored = total - 2.0 * (sizes[0] + sizes[1] - side * sizes[2])
    if mirrored < _MIRROR * as_it_is:
        raise CalibrationError(
            f"{source}: the points fit the tool only when mirrored: the tracker's frame is "
            "left-handed; change the sign of one of its axes"
        )


def _stops(registration: Registration, robot: Robot, motion: _Motion) -> tuple[Array, Array]:
    """Coefficients that are expected, and their precision, of what cables do and stops say."""
    precision = np.diag(motion.sd**-2.0)
    pull = np.zeros(len(precision))
    names = [robot.joint_names[c] for c in motion.columns]
    shared = motion.common.shape[1]
    terms = shared + len(_PLAYS)
    for name, (measured, true, sd) in registration.stops.items():
        if name not in names:
            raise CalibrationError(
                f"registration: a stop of {name}, which is none of the joints to be found: "
                f"{', '.join(names)}; leave it out"
            )
        k = names.index(name)
        u = np.zeros(len(names))
        u[k] = (measured - motion.centre[k]) / motion.half[k]
        row = np.zeros(len(precision))
        row[k * terms : k * terms + shared] = _polynomial(u[None])[0]
        precision += np.outer(row, row) / sd**2
        pull += row * (true - measured) / sd**2
    return np.asarray(np.linalg.solve(precision, pull), dtype=np.float64), precision


@dataclass(frozen=True, eq=False)
class _Fit:
    """What fits the readings."""

    state: TipState
    turn: Array
    offset: float
    noise: Array  # (1 or 2,) of points [m] and of turns [rad], where they are seen
    covariance: Array  # of the state's parameters, then the marker's turn

    def sd_of(self, name: str) -> float:
        return float(self.sds((name,))[0])

    def sds(self, names: Sequence[str]) -> Array:
        """Give standard deviations of parameters by name; the last coefficient is the delay."""
        known = list(self.state.names)
        known[len(self.state.coefficients) - 1] = "delay"
        return np.sqrt(np.diag(self.covariance))[[known.index(name) for name in names]]


def _fit(motion: _Motion, track: Track, known: _Known) -> _Fit:
    """Fit to readings spread over the motion; the rows are taken anew as the delay is found."""
    points, turns = _brought(known, track)
    offset, state, turn = known.offset, known.prior.state, known.turn
    delay = len(state.coefficients) - 1
    for _ in range(3):
        inside = np.flatnonzero(motion.inside(track.t + offset))
        chosen = inside[:: -(-len(inside) // _MOST_READINGS)]
        rows = motion.rows(track.t[chosen] + offset, points[chosen])
        seen = None if turns is None else turns[chosen]
        fit = _settle(motion, rows, seen, known.prior, state, turn)
        late = float(fit.state.coefficients[delay])
        fit = replace(fit, offset=offset + late)
        if abs(late) < 0.1 * fit.sd_of("delay") or abs(late) < 1e-5:
            break
        coefficients = fit.state.coefficients.copy()
        coefficients[delay] = 0.0
        offset += late
        state, turn = replace(fit.state, coefficients=coefficients), fit.turn
    return fit


def _settle(
    motion: _Motion,
    rows: TipRows,
    seen: Array | None,
    prior: TipPrior,
    state: TipState,
    turn: Array,
) -> _Fit:
    """Gauss-Newton; noise is found from the residuals, which follow one another alike.

    Neighbouring residuals share what the terms cannot follow, so that all of them together count
    as fewer: by the variance of blocks of time against that of single readings. At first nothing
    is left out, as all may be far off.
    """
    n = len(prior.free)
    free = np.append(prior.free, np.full(3, seen is not None))
    precision = np.zeros((n + 3, n + 3))
    precision[:n, :n] = prior.precision
    own = np.ix_(free, free)
    fewer = np.ones(1 if seen is None else 2)
    for gate in (math.inf, GATE, GATE):
        for _ in range(_STEPS):
            found = _equations(motion, rows, seen, state, turn)
            noise = found.noise
            residual, jacobian = found.whitened(noise, fewer, gate)
            flat = jacobian.reshape(-1, n + 3)
            normal = precision + flat.T @ flat
            pull = flat.T @ residual.ravel()
            pull[:n] += prior.precision @ state.minus(prior.state)
            inverse = _inverse(normal[own])
            step = np.zeros(n + 3)
            step[free] = -inverse @ pull[free]
            state = state.moved(step[:n])
            turn = turn @ Rotation.from_rotvec(step[n:]).as_matrix()
            if (np.abs(step[free]) <= _SETTLED * np.sqrt(np.diag(inverse))).all():
                break
        fewer = found.fewer(noise)
    covariance = np.zeros((n + 3, n + 3))
    covariance[own] = _covariance(residual, jacobian, normal, precision, own, free)
    # Friction may pass for a delay: so much of it would be taken for one without the plays.
    plays = np.flatnonzero(np.append(motion.is_play, np.zeros(n + 4 - len(state.coefficients))))
    rest = np.setdiff1d(np.flatnonzero(free), plays)
    delay = len(state.coefficients) - 1
    if free[delay]:
        taken = normal[np.ix_(rest, plays)] @ state.coefficients[plays]
        passed = _inverse(normal[np.ix_(rest, rest)]) @ taken
        covariance[delay, delay] += float(passed[np.searchsorted(rest, delay)]) ** 2
    return _Fit(state, turn, 0.0, noise, covariance)


@dataclass(frozen=True, eq=False)
class _Equations:
    """Residuals (m, 3) of points [m], or (m, 6) of poses [m, rad], and what moves them."""

    residual: Array
    by_parameter: Array  # (m, 3 or 6, n + 3) the state's, then the marker's turn
    by_joint: Array  # (m, 3 or 6, n_joints) of those to be found
    by_other: Array  # (m, 3 or 6, k) of those that also carry the marker, in their deviations

    @property
    def lengths(self) -> Array:
        """Lengths (m, 1 or 2) of the residuals of the point, and of the turn."""
        parts = self.residual.reshape(len(self.residual), -1, 3)
        return np.asarray(np.linalg.norm(parts, axis=2))

    @property
    def noise(self) -> Array:
        """Standard deviations per axis (1 or 2,), whatever a few residuals are."""
        return np.asarray(np.maximum(np.median(self.lengths, axis=0) / _NORM_MEDIAN, 1e-12))

    def whitening(self, noise: Array) -> Array:
        """Matrices (m, 3 or 6, 3 or 6) that turn residuals into numbers of deviation 1."""
        covariance = self.by_other @ self.by_other.transpose(0, 2, 1)
        covariance = covariance + np.diag(np.repeat(noise, 3) ** 2)
        return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)))

    def whitened(self, noise: Array, fewer: Array, gate: float) -> tuple[Array, Array]:
        """Residuals and Jacobian in deviations; what is far off weighs less (Huber) or nothing."""
        distance = (self.lengths / noise).max(axis=1)
        weight = np.minimum(1.0, HUBER / np.maximum(distance, 1e-12)) * (distance <= gate)
        root = self.whitening(noise * np.sqrt(fewer)) * np.sqrt(weight)[:, None, None]
        return (root @ self.residual[:, :, None])[:, :, 0], root @ self.by_parameter

    def fewer(self, noise: Array) -> Array:
        """How many residuals of points, and of turns, count as one, as neighbours are alike."""
        near = (self.lengths / noise).max(axis=1) <= GATE
        residual = self.residual[near].reshape(int(near.sum()), -1, 3)
        means = np.array([residual[rows].mean(axis=0) for rows in _blocks(len(residual))])
        size = len(residual) / _BLOCKS
        alike = size * np.mean(means**2, axis=(0, 2)) / np.mean(residual**2, axis=(0, 2))
        return np.asarray(np.maximum(1.0, alike))


def _equations(
    motion: _Motion, rows: TipRows, seen: Array | None, state: TipState, turn: Array
) -> _Equations:
    """Equations of points, and of orientations `seen` (m, 3, 3) where there are any."""
    by_parameter, _ = rows.jacobian(state)
    m, _, n = by_parameter.shape
    k, back = len(state.coefficients), state.rotation.T
    columns = list(rows.columns)
    frame, geometric = rows.moves(state)
    residual, moves = rows.residual(state), back @ geometric[:, :3]
    by_parameter = np.concatenate([by_parameter, np.zeros((m, 3, 3))], axis=2)
    if seen is not None:
        predicted, turns = back @ frame[:, :3, :3] @ turn, back @ geometric[:, 3:]
        off = Rotation.from_matrix(predicted @ seen.transpose(0, 2, 1)).as_rotvec()
        by_turn = np.zeros((m, 3, n + 3))
        by_turn[:, :, :k] = turns[:, :, columns] @ rows.basis
        by_turn[:, :, k : k + 3] = -np.eye(3)
        by_turn[:, :, n:] = predicted
        residual, moves = np.hstack([residual, off]), np.concatenate([moves, turns], axis=1)
        by_parameter = np.concatenate([by_parameter, by_turn], axis=1)
    others = moves * motion.others_sd
    return _Equations(residual, by_parameter, moves[:, :, columns], others)


def _blocks(m: int) -> list[slice]:
    """Rows of consecutive stretches of the motion."""
    bounds = np.linspace(0, m, _BLOCKS + 1).astype(int)
    return [slice(a, b) for a, b in pairwise(bounds)]


def _covariance(
    residual: Array, jacobian: Array, normal: Array, precision: Array,
    own: tuple[Array, ...], free: Mask,
) -> Array:  # fmt: skip
    """Covariance of the free parameters, by how much stretches of the motion differ.

    Delete-a-group jackknife (Efron and Tibshirani, An Introduction to the Bootstrap, 1993, ch. 11)
    in linear form, and what the prior's own uncertainty adds.
    """
    steps = []
    for rows in _blocks(len(residual)):
        flat = jacobian[rows].reshape(-1, len(normal))
        pull = flat.T @ residual[rows].ravel()
        steps.append(np.linalg.solve((normal - flat.T @ flat)[own], pull[free]))
    off = np.array(steps) - np.mean(steps, axis=0)
    inverse = _inverse(normal[own])
    return np.asarray((_BLOCKS - 1) / _BLOCKS * off.T @ off + inverse @ precision[own] @ inverse)


def _inverse(normal: Array) -> Array:
    """Inverse of a normal matrix, whose parameters are of very different size."""
    size = np.sqrt(np.diag(normal))
    scale = np.outer(size, size)
    return np.asarray(np.linalg.pinv(normal / scale, hermitian=True) / scale)


def _check_seen(source: str, fit: _Fit, motion: _Motion, names: Sequence[str]) -> None:
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


def _solve(
    motion: _Motion, track: Track, known: _Known, fit: _Fit
) -> tuple[Array, tuple[Array, Array], Mask]:
    """Joints (n, n_joints) at every reading, their deviations, and which readings fit.

    From the point alone, which tells more than an orientation.
    """
    stamps, noise = track.t + fit.offset, float(fit.noise[0])
    points, _ = _brought(known, track)
    still = fit.state.coefficients.copy()
    still[-1] = 0.0  # the stamps have it
    state = replace(fit.state, coefficients=still)
    rows = motion.rows(stamps, points)
    distance = np.linalg.norm(rows.residual(state), axis=1) / noise
    fits = motion.inside(stamps) & (distance < GATE)
    columns = list(motion.columns)
    joint = rows.corrected(state)
    bare = replace(state, coefficients=np.zeros_like(still))
    for _ in range(_SOLVES):
        found = _equations(motion, replace(rows, joint=joint), None, bare, fit.turn)
        back = np.linalg.pinv(found.by_joint)
        joint[:, columns] -= (back @ found.residual[:, :, None])[:, :, 0]
    k = len(still)
    moved = back[fits] @ found.by_parameter[fits][:, :, k:]
    together = np.einsum("mia,ab,mib->mi", moved, fit.covariance[k:, k:], moved)
    single = noise**2 * (back[fits] ** 2).sum(axis=2)
    deviations = [np.sqrt(variance.mean(axis=0)) for variance in (single, together)]
    return joint[:, columns], (deviations[0], deviations[1]), fits


def _brought(known: _Known, track: Track) -> tuple[Array, Array | None]:
    """Points (n, 3) [m] and orientations (n, 3, 3) in the frame near to the robot's base."""
    pose = known.base_from_tracker
    points = track.position @ pose[:3, :3].T + pose[:3, 3]
    if track.orientation is None:
        return points, None
    turns = Rotation.from_matrix(pose[:3, :3]) * Rotation.from_quat(track.orientation)
    return points, turns.as_matrix()
