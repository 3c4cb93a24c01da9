"""The fit of a tracker's place, a marker's and the joints' corrections to what the tracker saw."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from truejoint.array_types import Array, Mask
from truejoint.errors import CalibrationError
from truejoint.recordings.read.track import Track
from truejoint.robots import Robot
from truejoint.tip.registration import Registration
from truejoint.tip.tip_rows import (
    GATE,
    HUBER,
    TipPrior,
    TipRows,
    TipState,
    align,
)
from truejoint.tip.tracked_motion import PLAYS, TrackedMotion, at_stamps, polynomial

_FEWEST: Final = 50  # readings of the recording's time
_MOST_READINGS: Final = 4000  # that the fit takes, spread over the motion
NORM_MEDIAN: Final = 1.538
"""Median of the length of three standard normal numbers."""
_STEPS: Final = 40
_SETTLED: Final = 1e-2  # of a parameter's standard deviation
_BLOCKS: Final = 20  # of the motion, whose differences tell how sure the fit is
_MIRROR: Final = 0.25  # share of the residual that is left when the points are mirrored


@dataclass(frozen=True, eq=False)
class Known:
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
        motion: TrackedMotion,
        track: Track,
        offset: float,
        *,
        delayed: bool,
    ) -> Known:
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
        poses = motion.kinematics.forward(at_stamps(stamps[inside], motion.t, motion.joint))
        tip = poses[:, :3, 3] + poses[:, :3, :3] @ marker
        _check_hand(track.source, tip, track.position[inside])
        base, precision = _base(registration, tip, track.position[inside])
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


def _base(registration: Registration, tip: Array, seen: Array) -> tuple[Array, Array]:
    """Pose (4, 4) of the tracker in the base as it is stated, and its precision (6, 6).

    Where nothing is stated, that which lays the points `seen` (n, 3) onto the `tip` (n, 3) [m].
    """
    base, precision = registration.known_base()
    if base is None:
        base = np.eye(4)
        base[:3, :3], base[:3, 3] = align(tip, seen)
    return base, precision


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


def _stops(registration: Registration, robot: Robot, motion: TrackedMotion) -> tuple[Array, Array]:
    """Coefficients that are expected, and their precision, of what cables do and stops say."""
    precision = np.diag(motion.sd**-2.0)
    pull = np.zeros(len(precision))
    names = [robot.joint_names[c] for c in motion.columns]
    shared = motion.common.shape[1]
    terms = shared + len(PLAYS)
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
        row[k * terms : k * terms + shared] = polynomial(u[None])[0]
        precision += np.outer(row, row) / sd**2
        pull += row * (true - measured) / sd**2
    return np.asarray(np.linalg.solve(precision, pull), dtype=np.float64), precision


@dataclass(frozen=True, eq=False)
class TrackFit:
    """What fits the readings."""

    state: TipState
    turn: Array
    offset: float
    noise: Array  # (1 or 2,) of points [m] and of turns [rad], where they are seen
    covariance: Array  # of the state's parameters, then the marker's turn

    def sd_of(self, name: str) -> float:
        """Give the standard deviation of one parameter."""
        return float(self.sds((name,))[0])

    def sds(self, names: Sequence[str]) -> Array:
        """Give standard deviations of parameters by name; the last coefficient is the delay."""
        known = list(self.state.names)
        known[len(self.state.coefficients) - 1] = "delay"
        return np.sqrt(np.diag(self.covariance))[[known.index(name) for name in names]]


def fit_track(motion: TrackedMotion, track: Track, known: Known) -> TrackFit:
    """Fit to readings spread over the motion; the rows are taken anew as the delay is found."""
    points, turns = brought(known, track)
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
    motion: TrackedMotion,
    rows: TipRows,
    seen: Array | None,
    prior: TipPrior,
    state: TipState,
    turn: Array,
) -> TrackFit:
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
            found = equations(motion, rows, seen, state, turn)
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
    return TrackFit(state, turn, 0.0, noise, covariance)


@dataclass(frozen=True, eq=False)
class Equations:
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
        return np.asarray(np.maximum(np.median(self.lengths, axis=0) / NORM_MEDIAN, 1e-12))

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


def equations(
    motion: TrackedMotion, rows: TipRows, seen: Array | None, state: TipState, turn: Array
) -> Equations:
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
    return Equations(residual, by_parameter, moves[:, :, columns], others)


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


def brought(known: Known, track: Track) -> tuple[Array, Array | None]:
    """Points (n, 3) [m] and orientations (n, 3, 3) in the frame near to the robot's base."""
    pose = known.base_from_tracker
    points = track.position @ pose[:3, :3].T + pose[:3, 3]
    if track.orientation is None:
        return points, None
    turns = Rotation.from_matrix(pose[:3, :3]) * Rotation.from_quat(track.orientation)
    return points, turns.as_matrix()
