"""The fit of a tracker's place, a marker's and the joints' corrections to what the tracker saw."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Final, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from truejoint import schema
from truejoint.array_types import Array, Mask
from truejoint.errors import CalibrationError
from truejoint.recordings.read.track import Track
from truejoint.recordings.table.recording import Recording
from truejoint.recordings.table.stream import GAP_STEPS
from truejoint.robots import Robot
from truejoint.robots.parts import Kinematics
from truejoint.schema import Bounds, Key, Positive, Shape
from truejoint.tip.fit import (
    GATE,
    NORM_MEDIAN,
    Settled,
    TipPrior,
    TipRows,
    TipState,
    Whitened,
    align,
    cross_matrix,
    gauss_newton,
    huber,
    inverted,
    pose_matrix,
)
from truejoint.tip.terms import TRACKED, TRACKED_ZERO, Terms
from truejoint.toml_file import read_toml
from truejoint.units import display_unit

# A joint that moves less is held: its motor shows its cable, and no motion of the tool.
_HELD: Final = {"rad": 0.1, "m": 5e-3}
_OTHER_SD: Final = {"rad": 0.02, "m": 1e-3}  # of a joint that is not to be found, on its motor
_DELAY_SD: Final = 10.0  # s
_FEWEST: Final = 50  # readings of the recording's time
_MOST_READINGS: Final = 4000  # that the fit takes, spread over the motion
_STEPS: Final = 40
_SETTLED: Final = 1e-2  # of a parameter's standard deviation
_STRETCHES: Final = 20  # of the motion, whose differences give the covariance
_MARKER_SD: Final = 0.05  # m, of a marker of which nothing is stated
_MIRROR: Final = 0.25  # share of the residual that is left when the points are mirrored


@dataclass(frozen=True, eq=False)
class Registration:
    """What a person knows of a tracker beside a robot.

    Attributes
    ----------
    base : ndarray, shape (4, 4), optional
        Pose of the robot's base frame in the tracker's [m]; None where it is to be found.
    base_sd : ndarray, shape (6,)
        Standard deviations of it about and along the axes of the base [rad, then m].
    touched : ndarray, shape (n, 2, 3)
        Points of the base that the tracker has seen, in the base's frame and in the tracker's [m].
    touched_sd : float
        Per axis [m].
    link : str
        Joint whose link carries the marker; empty for the tool behind the last one.
    marker : ndarray, shape (3,), optional
        Place of the marker in the frame of that link [m].
    marker_sd : ndarray, shape (3,)
        [m].
    stops : mapping
        By joint, its measured and its true position where that is known, at a hard stop or in a
        fixture, and the standard deviation [rad or m].

    Examples
    --------
    >>> Registration(marker=np.zeros(3), stops={"shoulder": (0.01, 0.0, 0.001)}).base is None
    True
    """

    base: Array | None = None
    base_sd: Array = field(default_factory=lambda: np.full(6, np.inf))
    touched: Array = field(default_factory=lambda: np.empty((0, 2, 3)))
    touched_sd: float = 1e-3
    link: str = ""
    marker: Array | None = None
    marker_sd: Array = field(default_factory=lambda: np.full(3, _MARKER_SD))
    stops: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        shapes = {"base": (4, 4), "base_sd": (6,), "marker": (3,), "marker_sd": (3,)}
        for name, shape in shapes.items():
            if (value := getattr(self, name)) is not None and np.shape(value) != shape:
                raise CalibrationError(
                    f"registration: {name} is of shape {np.shape(value)}; it must be {shape}"
                )
        if len(self.touched) and self.base is not None:
            raise CalibrationError(
                "registration: it states the base's pose and touched points; leave one of them out"
            )

    def known_base(self) -> tuple[Array | None, Array]:
        """Pose (4, 4) of the tracker in the robot's base [m], None where nothing says it.

        And what is known of it, the inverse covariance (6, 6) of a turn about and a shift along the
        axes of the base. Raises CalibrationError if touched points lie in a line.
        """
        if self.base is not None:
            return np.asarray(np.linalg.inv(self.base)), np.diag(self.base_sd**-2.0)
        if not len(self.touched):
            return None, np.zeros((6, 6))
        ours, theirs = self.touched[:, 0], self.touched[:, 1]
        pose = pose_matrix(*align(ours, theirs))
        rows = np.concatenate([cross_matrix(ours), -np.tile(np.eye(3), (len(ours), 1, 1))], axis=2)
        return pose, np.einsum("mia,mib->ab", rows, rows) / self.touched_sd**2


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
    sd: Array  # (k + 1,), prior deviations of the terms' coefficients, and of the delay [s]
    # (n_joints,), errors of the joints that are not sought [rad or m]; 0 of the others
    joint_sd: Array

    @classmethod
    def of(
        cls, recording: Recording, kinematics: Kinematics, joints: Sequence[str]
    ) -> TrackedMotion:
        """Motion of a recording; raises CalibrationError if one of the `joints` stands still."""
        robot, measured = recording.robot, recording.joints_of("measured")
        joint = np.tile(robot.home, (len(recording), 1))
        for k, name in enumerate(robot.joint_names):
            if name in measured:
                joint[:, k] = recording.column(f"measured/{name}")
                if name not in joints and np.ptp(joint[:, k]) < _HELD[robot.joint(name).unit]:
                    joint[:, k] = joint[:, k].mean()
        terms = Terms.of_motion(recording, joints)
        shared, plays = terms.columns(terms.features.compute(recording))
        sd = terms.sds({"zero": 0.0, **TRACKED})
        sd[terms.zeros] = [TRACKED_ZERO[robot.joint(name).unit] for name in joints] / terms.scale
        return cls(
            recording.t,
            kinematics,
            terms,
            tuple(robot.index(joints)),
            joint,
            shared,
            plays,
            np.gradient(recording.columns("measured", joints), recording.t, axis=0),
            np.append(sd, _DELAY_SD),
            np.array([0.0 if j.name in joints else _OTHER_SD[j.unit] for j in robot.joints]),
        )

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

    def rows(self, stamps: Array, points: Array, orientation: Array | None = None) -> TipRows:
        """Rows of points (m, 3) [m], and orientations (m, 3, 3), seen at stamps (m,) [s]."""
        shared, plays, velocity, joint = (
            _at_stamps(stamps, self.t, values)
            for values in (self.shared, self.plays, self.velocity, self.joint)
        )
        basis = np.dstack([self.terms.basis(shared, plays), velocity])
        return TipRows(
            self.kinematics, joint, self.columns, basis, points, 1.0, self.joint_sd, orientation
        )


def _at_stamps(stamps: Array, t: Array, values: Array) -> Array:
    """Values (n, ...) at stamps `t` (n,) [s], interpolated at others (m,): (m, ...)."""
    flat = values.reshape(len(values), -1)
    columns = np.column_stack([np.interp(stamps, t, column) for column in flat.T])
    return columns.reshape(len(stamps), *values.shape[1:])


@dataclass(frozen=True, eq=False)
class TrackStart:
    """Start of a fit, in a frame near to the robot's base."""

    base_from_tracker: Array  # (4, 4), brought the points to that frame [m]
    prior: TipPrior  # The last coefficient is the delay [s]
    offset: float  # Of the clocks [s]
    point: Array  # (n, 3), all readings in that frame [m]
    orientation: Array | None  # (n, 3, 3)

    @classmethod
    def of(
        cls,
        registration: Registration,
        motion: TrackedMotion,
        track: Track,
        offset: float,
        *,
        delayed: bool,
    ) -> TrackStart:
        """Start of a fit at an `offset` of the clocks [s], which counts as stated if not `delayed`.

        Raises CalibrationError if the readings are of another time or of a left-handed frame, or
        the registration states one thing twice.
        """
        stamps = track.t + offset
        inside = motion.inside(stamps)
        if inside.sum() < _FEWEST:
            raise CalibrationError(
                f"{track.source}: {int(inside.sum())} of {len(track)} readings are of the "
                "recording's time; is it the same motion? State the offset of the clocks "
                "(--offset-s), or about (--near-s)"
            )
        marker = np.zeros(3) if registration.marker is None else registration.marker
        poses = motion.kinematics.forward(_at_stamps(stamps[inside], motion.t, motion.joint))
        tip = poses[:, :3, 3] + poses[:, :3, :3] @ marker
        _check_hand(track.source, tip, track.position[inside])
        base, pose_precision = registration.known_base()
        if base is None:
            base = pose_matrix(*align(tip, track.position[inside]))
        orientation, turn = None, np.eye(3)
        if track.orientation is not None:
            orientation = base[:3, :3] @ Rotation.from_quat(track.orientation).as_matrix()
            on_link = poses[:, :3, :3].transpose(0, 2, 1) @ orientation[inside]
            turn = Rotation.from_matrix(on_link).mean().as_matrix()
        coefficients, precision = _with_stops(registration, motion)
        prior = TipPrior.of(
            TipState(coefficients, marker=marker, turn=turn),
            motion.sd,
            marker=registration.marker_sd,
            pose_precision=pose_precision,
        )
        n, free = len(coefficients), prior.free.copy()
        prior.precision[:n, :n] = precision
        free[n - 1], free[-3:] = delayed, orientation is not None
        point = track.position @ base[:3, :3].T + base[:3, 3]
        return cls(base, replace(prior, free=free), offset, point, orientation)


def _check_hand(source: str, tip: Array, point: Array) -> None:
    """Refuse points of a left-handed frame."""
    ours, theirs = tip - tip.mean(axis=0), point - point.mean(axis=0)
    sizes = np.linalg.svd(ours.T @ theirs, compute_uv=False)
    side = np.sign(np.linalg.det(ours.T @ theirs))
    total = float(np.sum(ours**2) + np.sum(theirs**2))
    as_it_is, mirrored = (
        total - 2.0 * (sizes[0] + sizes[1] + sign * side * sizes[2]) for sign in (1.0, -1.0)
    )
    if mirrored < _MIRROR * as_it_is:
        raise CalibrationError(
            f"{source}: the points fit the tool only when mirrored: the tracker's frame is "
            "left-handed; change the sign of one of its axes"
        )


def _with_stops(registration: Registration, motion: TrackedMotion) -> tuple[Array, Array]:
    """Coefficients that cables and stops make one expect, and their precision."""
    precision, terms = np.diag(motion.sd**-2.0), motion.terms
    pull = np.zeros(len(precision))
    each = (len(precision) - 1) // len(terms.joints)
    for name, (measured, true, sd) in registration.stops.items():
        if name not in terms.joints:
            raise CalibrationError(
                f"registration: a stop of {name}, which is none of the joints to be found: "
                f"{', '.join(terms.joints)}; leave it out"
            )
        k = terms.joints.index(name)
        stop = terms.centre.copy()
        stop[k] = measured
        shared = terms.scale[k] * terms.normalised(stop[None])[0]
        row = np.zeros(len(precision))
        row[k * each : k * each + len(shared)] = shared
        precision += np.outer(row, row) / sd**2
        pull += row * (true - measured) / sd**2
    return np.asarray(np.linalg.solve(precision, pull), dtype=np.float64), precision


@dataclass(frozen=True, eq=False)
class TrackFit:
    """Parameters that fit the readings."""

    state: TipState  # The last coefficient is the delay [s]
    offset: float  # Of the clocks, the delay included [s]
    noise: float  # Standard deviation of the points, per axis [m]
    covariance: Array  # (n, n), of the state's parameters

    def sds(self, *names: str) -> Array:
        """Give standard deviations of parameters by name; the last coefficient is the delay."""
        parameters = list(self.state.names)
        parameters[len(self.state.coefficients) - 1] = "delay"
        return np.sqrt(np.diag(self.covariance))[[parameters.index(name) for name in names]]

    @property
    def without_delay(self) -> TipState:
        """State whose delay is in the stamps."""
        return replace(self.state, coefficients=np.append(self.state.coefficients[:-1], 0.0))


def fit_track(motion: TrackedMotion, track: Track, start: TrackStart) -> TrackFit:
    """Fit to readings spread over the motion; rows are taken anew after the delay is estimated."""
    offset, state = start.offset, start.prior.state
    for _ in range(3):
        inside = np.flatnonzero(motion.inside(track.t + offset))
        chosen = inside[:: -(-len(inside) // _MOST_READINGS)]
        turns = None if start.orientation is None else start.orientation[chosen]
        rows = motion.rows(track.t[chosen] + offset, start.point[chosen], turns)
        fit = _fit(motion, rows, start.prior, state)
        delay = float(fit.state.coefficients[-1])
        fit = replace(fit, offset=offset + delay)
        if abs(delay) < 0.1 * fit.sds("delay")[0] or abs(delay) < 1e-5:
            break
        offset += delay
        state = fit.without_delay
    return fit


def _fit(motion: TrackedMotion, rows: TipRows, prior: TipPrior, state: TipState) -> TrackFit:
    """Fit to rows whose noise is estimated from their residuals.

    Neighbouring residuals share what the terms cannot follow, so several count as one: by the
    variance of stretches of time against that of single readings. At first no outlier is dropped,
    as all may be far off.
    """
    alike = np.ones(1 if rows.orientation is None else 2)
    for gate in (math.inf, GATE, GATE):
        whiten = partial(_whiten, rows, alike, gate)
        settled = gauss_newton(prior, state, whiten, most_steps=_STEPS, tolerance=_SETTLED)
        state, residual = settled.state, settled.whitened.equations.residual
        noise = _noise(residual)
        alike = _alike(residual, noise)
    covariance = _covariance(settled, prior)
    # Friction may pass for a delay: as much as the plays explain would be taken for one.
    free = np.flatnonzero(prior.free)
    delay = len(state.coefficients) - 1
    if prior.free[delay]:
        plays = np.flatnonzero(np.array(motion.terms.kinds) == "play")
        rest = np.setdiff1d(free, plays)
        effect = settled.normal[np.ix_(rest, plays)] @ state.coefficients[plays]
        passed = inverted(settled.normal[np.ix_(rest, rest)], prior, rest) @ effect
        covariance[delay, delay] += float(passed[np.searchsorted(rest, delay)]) ** 2
    return TrackFit(state, 0.0, float(noise[0]), covariance)


def _lengths(residual: Array) -> Array:
    """Lengths (m, 1 or 2) of the residuals of the points, and of the turns."""
    return np.asarray(np.linalg.norm(residual.reshape(len(residual), -1, 3), axis=2))


def _noise(residual: Array) -> Array:
    """Estimate standard deviations per axis (1 or 2,) of points and turns, robust to outliers."""
    return np.asarray(np.maximum(np.median(_lengths(residual), axis=0) / NORM_MEDIAN, 1e-12))


def _whiten(rows: TipRows, alike: Array, gate: float, state: TipState) -> Whitened:
    """Equations in deviations, of which so many `alike` count as one; outliers weigh nothing."""
    equations = rows.equations(state)
    noise = _noise(equations.residual)
    distance = (_lengths(equations.residual) / noise).max(axis=1)
    sd = np.repeat(noise * np.sqrt(alike), 3)
    weight = huber(distance) * (distance <= gate)
    return Whitened.of(equations, equations.whitening(rows.joint_sd, sd), weight)


def _alike(residual: Array, noise: Array) -> Array:
    """How many residuals of points, and of turns, count as one, as neighbours are alike."""
    near = (_lengths(residual) / noise).max(axis=1) <= GATE
    parts = residual[near].reshape(int(near.sum()), -1, 3)
    means = np.array([parts[rows].mean(axis=0) for rows in _stretches(len(parts))])
    size = len(parts) / _STRETCHES
    share = size * np.mean(means**2, axis=(0, 2)) / np.mean(parts**2, axis=(0, 2))
    return np.asarray(np.maximum(1.0, share))


def _stretches(m: int) -> list[slice]:
    """Rows of consecutive stretches of the motion."""
    bounds = np.linspace(0, m, _STRETCHES + 1).astype(int)
    return [slice(a, b) for a, b in pairwise(bounds)]


def _covariance(settled: Settled, prior: TipPrior) -> Array:
    """Covariance (n, n) of the parameters, by how much stretches of the motion differ.

    Delete-a-group jackknife (Efron and Tibshirani, An Introduction to the Bootstrap, 1993, ch. 11)
    in linear form, and what the prior's own uncertainty adds.
    """
    free, white = np.flatnonzero(prior.free), settled.whitened
    block = np.ix_(free, free)
    root = np.sqrt(white.weight)
    residual, jacobian = root[:, None] * white.residual, root[:, None, None] * white.jacobian
    steps = []
    for rows in _stretches(len(residual)):
        flat = jacobian[rows].reshape(-1, len(prior.free))
        pull = flat.T @ residual[rows].ravel()
        steps.append(np.linalg.solve((settled.normal - flat.T @ flat)[block], pull[free]))
    off = np.array(steps) - np.mean(steps, axis=0)
    inverse = inverted(settled.normal[block], prior, free)
    covariance = np.zeros_like(settled.normal)
    covariance[block] = (_STRETCHES - 1) / _STRETCHES * off.T @ off
    covariance[block] += inverse @ prior.precision[block] @ inverse
    return covariance


_Point = Annotated[Array, Shape((3,))]
_Above = Bounds(0.0, above=True)


class _Base(NamedTuple):
    position: Annotated[_Point, Key("position_mm", 1e-3)]
    quaternion: Annotated[Array, Shape((4,))]
    sd: Annotated[float, _Above, Key("sd_mm", 1e-3)]
    turn_sd: Annotated[float, _Above, Key("sd_deg", math.pi / 180.0)]


class _Marker(NamedTuple):
    link: str = ""
    position: Annotated[Array | None, Shape((3,)), Key("position_mm", 1e-3)] = None
    sd: Annotated[float | None, _Above, Key("sd_mm", 1e-3)] = None


class _Touched(NamedTuple):
    base: Annotated[_Point, Key("base_mm", 1e-3)]
    tracker: Annotated[_Point, Key("tracker_mm", 1e-3)]


class _Stop(NamedTuple):
    joint: str
    measured: float
    true: float
    sd: Positive


class _File(NamedTuple):
    base: _Base | None = None
    marker: _Marker = _Marker()
    touched: tuple[_Touched, ...] = ()
    touched_sd: Annotated[float | None, _Above, Key("touched_sd_mm", 1e-3)] = None
    stops: tuple[_Stop, ...] = ()


def read_registration(path: str | os.PathLike[str], robot: Robot) -> Registration:
    r"""Registration of a TOML file (docs/tracker.md), whose numbers are in mm and deg.

    Raises CalibrationError naming the key and the rule that it breaks, RobotError for a joint that
    `robot` does not have.

    Examples
    --------
    >>> text = '[marker]\nlink = "roll"\nposition_mm = [0, 0, 8]\nsd_mm = 0.2'
    >>> _ = Path("tracker.toml").write_text(text)
    >>> read_registration(Path("tracker.toml"), get_robot("raven2")).marker
    array([0.   , 0.   , 0.008])
    """
    values = read_toml(Path(path), CalibrationError)
    file = schema.read(_File, values, str(path), CalibrationError)
    stated: dict[str, Any] = {"link": file.marker.link}
    if file.marker.link:
        robot.joint(file.marker.link)
    if file.base is not None:
        length = np.linalg.norm(file.base.quaternion)
        if not abs(length - 1.0) < 1e-2:
            raise CalibrationError(
                f"{path}: base.quaternion is of length {length:.3g}; give x, y, z, w of a unit "
                "quaternion"
            )
        turn = Rotation.from_quat(file.base.quaternion).as_matrix()
        stated["base"] = pose_matrix(turn, file.base.position)
        stated["base_sd"] = np.repeat([file.base.turn_sd, file.base.sd], 3)
    if file.marker.position is not None:
        if file.marker.sd is None:
            raise CalibrationError(f"{path}: marker.sd_mm is missing; state its deviation")
        stated |= {"marker": file.marker.position, "marker_sd": np.full(3, file.marker.sd)}
    if (file.touched_sd is None) != (not file.touched):
        raise CalibrationError(
            f"{path}: touched_sd_mm and touched points belong together; give both, [[touched]] "
            "for each point, or neither"
        )
    if file.touched:
        stated["touched"] = np.array([[row.base, row.tracker] for row in file.touched])
        stated["touched_sd"] = file.touched_sd
    stops: dict[str, tuple[float, float, float]] = {}
    for stop in file.stops:
        joint = robot.joint(stop.joint)
        if joint.name in stops:
            raise CalibrationError(f"{path}: two stops of {joint.name}; state one of each joint")
        scale = display_unit(joint.unit).scale
        stops[joint.name] = stop.measured / scale, stop.true / scale, stop.sd / scale
    return Registration(**stated, stops=stops)
