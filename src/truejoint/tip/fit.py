"""Points of the tool that a frame of unknown pose sees, and the fit of corrections to them.

A tip that rests in a dimple of a printed block, or a marker that a tracker sees, gives three
equations in the corrections of the joints and the pose of that frame:
``R' (tip(joint + correction) - t) = s p`` with the pose ``R, t`` of the frame in the robot's base,
the point ``p`` in the frame and the frame's scale ``s``. An orientation of the marker gives three
more. The Jacobian of the tip is the kinematics' own.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from truejoint.array_types import Array, Mask
from truejoint.errors import CalibrationError
from truejoint.robots import Robot
from truejoint.robots.parts import Kinematics

POSE: Final = ("turn x", "turn y", "turn z", "shift x", "shift y", "shift z")
"""Parameters of a frame's pose: turn about its own axes [rad], shift along the base's [m]."""
MARKER: Final = ("marker x", "marker y", "marker z")
SCALE: Final = "scale"
TURN: Final = ("marker turn x", "marker turn y", "marker turn z")
HUBER: Final = 2.8  # whitened residuals longer than this get Huber's weight; one in twenty is
# Points further than this from what the others expect [deviations] are outliers. In sets of 30 good
# points, one set in two hundred has such a point.
GATE: Final = 4.5
NORM_MEDIAN: Final = 1.538  # of the length of three standard normal numbers
_MOST_STEPS: Final = 50
_SETTLED: Final = 1e-4  # of a parameter's standard deviation
_NEARLY: Final = 1e-2  # the same where the noise is what residuals say
_OPEN: Final = 1e-13  # eigenvalue of the scaled normal equations below which a direction is open


@dataclass(frozen=True, eq=False)
class TipState:
    """Parameters of the rows: correction, the frame's pose in the base, the marker's on a tool."""

    coefficients: Array  # (k,), of the correction's terms
    rotation: Array = field(default_factory=lambda: np.eye(3))  # (3, 3), of the frame
    translation: Array = field(default_factory=lambda: np.zeros(3))  # (3,), of its origin [m]
    marker: Array = field(default_factory=lambda: np.zeros(3))  # (3,), point that is seen [m]
    scale: float = 1.0  # By which the frame's points are larger than stated
    turn: Array = field(default_factory=lambda: np.eye(3))  # (3, 3), of the marker

    @property
    def names(self) -> tuple[str, ...]:
        """Parameters, in the order of every Jacobian and covariance."""
        terms = tuple(f"term {k}" for k in range(len(self.coefficients)))
        return (*terms, *POSE, *MARKER, SCALE, *TURN)

    def moved(self, step: Array) -> "TipState":
        """State after a step (n,) of all parameters; turns are about the frames' own axes."""
        k = len(self.coefficients)
        return TipState(
            self.coefficients + step[:k],
            self.rotation @ Rotation.from_rotvec(step[k : k + 3]).as_matrix(),
            self.translation + step[k + 3 : k + 6],
            self.marker + step[k + 6 : k + 9],
            self.scale + float(step[k + 9]),
            self.turn @ Rotation.from_rotvec(step[k + 10 :]).as_matrix(),
        )

    def minus(self, other: "TipState") -> Array:
        """Step (n,) that leads from `other` here."""
        turns = np.stack([other.rotation.T @ self.rotation, other.turn.T @ self.turn])
        frame, marker = Rotation.from_matrix(turns).as_rotvec()
        shifts = self.translation - other.translation, self.marker - other.marker
        scale = [self.scale - other.scale]
        return np.concatenate(
            [self.coefficients - other.coefficients, frame, *shifts, scale, marker]
        )


@dataclass(frozen=True, eq=False)
class TipPrior:
    """What is known before any point is seen."""

    state: TipState  # Expected parameters, where the fit starts
    precision: Array  # (n, n), inverse of their covariance; zero where nothing is known
    free: Mask  # (n,), what is estimated; the rest stays as it is in `state`

    @classmethod
    def of(
        cls, state: TipState, terms: ArrayLike, *, pose: ArrayLike = np.inf,
        marker: ArrayLike = 0.0, scale: float = 0.0, turn: float = 0.0,
        pose_precision: Array | None = None,
    ) -> "TipPrior":  # fmt: skip
        """Prior of independent parameters by their standard deviations.

        A deviation is infinite where nothing is known, and 0 where the parameter is held.
        `pose_precision` (6, 6) is the inverse covariance of a pose that is known, in place of
        `pose`.
        """
        sizes = len(state.coefficients), 6, 3, 1, 3
        parts = zip((terms, pose, marker, scale, turn), sizes, strict=True)
        sd = np.concatenate([np.broadcast_to(np.asarray(part, np.float64), n) for part, n in parts])
        free = sd > 0.0
        precision = np.diag(np.where(free, 1.0 / np.where(free, sd, 1.0) ** 2, 0.0))
        if pose_precision is not None:
            k = sizes[0]
            precision[k : k + 6, k : k + 6] = pose_precision
        return cls(state, precision, free)


class Equations(NamedTuple):
    """Residuals of rows at one state, and their Jacobians; d is 3, or 6 with orientations."""

    residual: Array  # (m, d), predicted less stated points, then turns [m, rad]
    by_parameter: Array  # (m, d, n)
    by_joint: Array  # (m, d, n_joints), by all joints of the kinematics

    def whitened(self, joint_sd: Array, sd: Array) -> "Whitened":
        """Give the equations in standard deviations; all rows weigh alike.

        Of independent errors `joint_sd` (n_joints,) [rad or m] of the joints and `sd` (d,), or of
        all alike, of what is seen [m, rad].
        """
        spread = self.by_joint * joint_sd
        covariance = spread @ spread.transpose(0, 2, 1)
        diagonal = range(self.residual.shape[1])
        covariance[:, diagonal, diagonal] += sd**2
        whitening = np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)))
        residual = np.einsum("mij,mj->mi", whitening, self.residual)
        weight = np.ones(len(residual))
        return Whitened(self, whitening, residual, whitening @ self.by_parameter, weight)


class Whitened(NamedTuple):
    """Equations in standard deviations, with a weight for each row."""

    equations: Equations
    whitening: Array  # (m, d, d)
    residual: Array  # (m, d)
    jacobian: Array  # (m, d, n)
    weight: Array  # (m,)


@dataclass(frozen=True, eq=False)
class TipRows:
    """Points of a tool, a row each.

    Raises CalibrationError if a number is not finite, or a deviation not above 0.
    """

    kinematics: Kinematics
    joint: Array  # (m, n_joints), all that the kinematics take, measured or corrected [rad or m]
    columns: tuple[int, ...]  # Which of these the terms correct
    basis: Array  # (m, n_corrected, k), correction per coefficient [rad or m]
    point: Array  # (m, 3), where the frame has the tool's point [m]
    point_sd: float  # Standard deviation of that, per axis [m]
    # (n_joints,), standard deviation of what the best correction leaves of each joint, independent
    # from row to row [rad or m]
    joint_sd: Array
    orientation: Array | None = None  # (m, 3, 3), of the marker in the frame
    # (1 or 2,), how many neighbouring rows count as one, of points and of orientations, as they
    # share what the terms cannot follow; the noise is then what residuals say, and not `point_sd`
    alike: Array | None = None

    def __post_init__(self) -> None:
        arrays = self.joint, self.basis, self.point, self.joint_sd
        if not all(np.isfinite(array).all() for array in arrays):
            raise CalibrationError("positions and points must be finite; leave out rows")
        if not 0.0 < self.point_sd < np.inf:
            raise CalibrationError(f"points err by {self.point_sd} m; give a deviation above 0")

    @classmethod
    def of(
        cls, robot: Robot, joint: Array, corrected: Sequence[str], basis: Array, point: Array,
        point_sd: float, corrected_sd: Array,
    ) -> "TipRows":  # fmt: skip
        """Rows of a robot's tool, where deviations `corrected_sd` stay of the joints `corrected`.

        Raises RobotError where its kinematics are not known.
        """
        columns, joint_sd = robot.index(corrected), np.zeros(joint.shape[1])
        joint_sd[columns] = corrected_sd
        chain = robot.known_kinematics("a point of the tool")
        return cls(chain, joint, tuple(columns), basis, point, point_sd, joint_sd)

    def __len__(self) -> int:
        return len(self.joint)

    def rows(self, chosen: Mask) -> "TipRows":
        """Give some of the rows."""
        names = ["joint", "basis", "point", *["orientation"] * (self.orientation is not None)]
        return replace(self, **{name: getattr(self, name)[chosen] for name in names})

    @property
    def corrected_sd(self) -> Array:
        """Part (n_corrected,) of `joint_sd` that is of the joints that the terms correct."""
        return self.joint_sd[list(self.columns)]

    def corrected(self, state: TipState) -> Array:
        """Positions (m, n_joints) of all joints with the correction [rad or m]."""
        joint = self.joint.copy()
        joint[:, self.columns] += self.basis @ state.coefficients
        return joint

    def tool_points(self, state: TipState) -> tuple[Array, Array]:
        """Rotations (m, 3, 3) of the tool, and points (m, 3) of the marker, in the base [m]."""
        tool = self.kinematics.forward(self.corrected(state))
        return tool[:, :3, :3], tool[:, :3, 3] + tool[:, :3, :3] @ state.marker

    def residual(self, state: TipState) -> Array:
        """Predicted less stated points (m, 3), of the tool in the frame [m]."""
        seen = (self.tool_points(state)[1] - state.translation) @ state.rotation
        return np.asarray(seen - state.scale * self.point)

    def equations(self, state: TipState) -> Equations:
        """Residuals and Jacobians at a state, the latter by parameters and by joints."""
        k, back = len(state.coefficients), state.rotation.T
        turn, place = self.tool_points(state)
        moves = self.kinematics.jacobian(self.corrected(state))
        moves[:, :3] += np.cross(moves[:, 3:], (turn @ state.marker)[:, :, None], axis=1)
        by_joint = back @ moves[:, :3]
        point = (place - state.translation) @ state.rotation
        residual = point - state.scale * self.point
        by_parameter = np.zeros((len(self), 3 if self.orientation is None else 6, k + 13))
        by_parameter[:, :3, :k] = by_joint[:, :, self.columns] @ self.basis
        by_parameter[:, :3, k : k + 3] = cross_matrix(point)
        by_parameter[:, :3, k + 3 : k + 6] = -back
        by_parameter[:, :3, k + 6 : k + 9] = back @ turn
        by_parameter[:, :3, k + 9] = -self.point
        if self.orientation is None:
            return Equations(residual, by_parameter, by_joint)
        predicted, turns = back @ turn @ state.turn, back @ moves[:, 3:]
        off = Rotation.from_matrix(predicted @ self.orientation.transpose(0, 2, 1)).as_rotvec()
        by_parameter[:, 3:, :k] = turns[:, :, self.columns] @ self.basis
        by_parameter[:, 3:, k : k + 3] = -np.eye(3)
        by_parameter[:, 3:, k + 10 :] = predicted
        by_joint = np.concatenate([by_joint, turns], axis=1)
        return Equations(np.hstack([residual, off]), by_parameter, by_joint)


def align(tip: Array, point: Array) -> tuple[Array, Array]:
    """Rotation (3, 3) and translation (3,) [m] that lay points (m, 3) over the tip's (m, 3).

    Least squares (Kabsch, Acta Cryst. A32, 1976). Raises CalibrationError for fewer than three
    points or points in one line, which leave a turn open.
    """
    there, about = tip.mean(axis=0), point.mean(axis=0)
    spread = np.linalg.svd(point - about, compute_uv=False)
    if len(point) < 3 or not spread[1] > 1e-3 * spread[0] > 0.0:
        raise CalibrationError(
            f"{len(point)} points leave the pose of their frame open; give three, not in one line"
        )
    turn = Rotation.align_vectors(tip - there, point - about)[0].as_matrix()
    return turn, there - turn @ about


def pose_matrix(rotation: Array, translation: Array) -> Array:
    """Pose (4, 4) of a rotation (3, 3) and a translation (3,)."""
    return np.block([[rotation, translation[:, None]], [np.zeros(3), 1.0]])


def cross_matrix(vectors: Array) -> Array:
    """Matrices (m, 3, 3) with ``M w = v x w`` of vectors (m, 3)."""
    return np.asarray(np.cross(vectors[:, None], np.eye(3)).transpose(0, 2, 1))


@dataclass(frozen=True, eq=False)
class TipFit:
    """Parameters that fit the points, and how surely."""

    rows: TipRows  # What it was fitted to
    prior: TipPrior
    state: TipState
    covariance: Array  # (n, n), of all parameters; zero for those that were held
    residual: Array  # (m, 3), predicted less stated points [m]
    distance: Array  # (m,), of each point from what the others expect, in standard deviations
    weight: Array  # (m,), with which each point counted; 0 for an outlier
    misfit: float  # Squares of whitened residuals, the prior's too; expected to be `freedom`
    freedom: int  # Residuals less parameters that are estimated

    @property
    def sd(self) -> Array:
        """Standard deviations (n,) of the parameters."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def left_out(self) -> Mask:
        """Which points (m,) are outliers."""
        return np.asarray(self.weight == 0.0)


def normal_equations(prior: TipPrior, state: TipState, whitened: Whitened) -> tuple[Array, Array]:
    """Give the normal matrix (n, n) and gradient (n,) of the weighted rows and the prior."""
    jacobian = whitened.jacobian
    flat = jacobian.reshape(-1, jacobian.shape[2])
    weighted = (whitened.weight[:, None, None] * jacobian).reshape(flat.shape).T
    gradient = prior.precision @ state.minus(prior.state) + weighted @ whitened.residual.ravel()
    return prior.precision + weighted @ flat, gradient


def inverted(normal: Array, names: Sequence[str], free: Mask) -> Array:
    """Invert the normal matrix of the `free` parameters (n,), of very different size; 0 elsewhere.

    Raises CalibrationError with the `names` of parameters that stay open.
    """
    block, names = np.ix_(free, free), np.array(names)[free].tolist()
    size = np.sqrt(np.diag(normal)[free])
    if not (size > 0.0).all():
        raise CalibrationError(f"the points say nothing of {names[int(np.argmin(size))]}")
    values, vectors = np.linalg.eigh(normal[block] / np.outer(size, size))
    if values[0] < _OPEN * values[-1]:
        share = np.abs(vectors[:, 0])
        open_ = ", ".join(names[i] for i in np.argsort(-share)[:4] if share[i] > 0.2)
        raise CalibrationError(
            f"the points leave open {open_} together; touch more, from other sides, or state what "
            "is known"
        )
    inverse = np.zeros_like(normal)
    inverse[block] = (vectors / values) @ vectors.T / np.outer(size, size)
    return inverse


def fit_rows(
    rows: TipRows, prior: TipPrior, *, gate: float = GATE, start: TipState | None = None
) -> TipFit:
    """Fit corrections and pose to points of the tool: Gauss-Newton, Huber's weights, priors.

    After the robust fit, points further than `gate` standard deviations from what all others
    expect are dropped as outliers, the worst first, and the rest is fitted again. Where the noise
    is what residuals say, of many rows, those further than `gate` of it weigh nothing at each step.
    The fit begins at `start`, by default at the prior's state; held parameters are always the
    prior's. Raises CalibrationError if points and prior leave a direction of the parameters open,
    the fit does not settle, or more than a fifth of the points, and more than one, are outliers:
    among few points, the two that are dropped may be the good ones.
    """
    inlier = np.ones(len(rows), dtype=np.bool_)
    state = prior.state
    if start is not None:
        state = state.moved(np.where(prior.free, start.minus(state), 0.0))
    if rows.alike is not None:
        return _fit_inliers(rows, prior, state, inlier, gate)
    while True:
        fit = _fit_inliers(rows, prior, state, inlier)
        distance = np.where(inlier, fit.distance, 0.0)
        worst = int(np.argmax(distance))
        if not distance[worst] > gate:
            break
        inlier[worst] = False
        if (~inlier).sum() > max(1, len(rows) // 5):
            raise CalibrationError(
                f"{(~inlier).sum()} of {len(rows)} points do not fit the others: are they all of "
                "this arm, of this day and in this frame?"
            )
        state = fit.state
    # A point that was dropped beside a worse one may fit after all.
    back = ~inlier & (fit.distance <= gate)
    return _fit_inliers(rows, prior, fit.state, inlier | back) if back.any() else fit


def noise_of(residual: Array) -> tuple[Array, Array]:
    """Lengths (m, 1 or 2) of the residuals of points and turns, and their robust deviations."""
    length = np.linalg.norm(residual.reshape(len(residual), -1, 3), axis=2)
    return length, np.asarray(np.maximum(np.median(length, axis=0) / NORM_MEDIAN, 1e-12))


def whiten_rows(rows: TipRows, inlier: Mask, state: TipState, gate: float = np.inf) -> Whitened:
    """Equations in deviations, with Huber's weights; outliers, and what is beyond the gate, have 0.

    The deviations are those that the rows state, or else of what residuals say.
    """
    equations, sd = rows.equations(state), np.array(rows.point_sd)
    if rows.alike is not None:
        length, noise = noise_of(equations.residual)
        sd = np.repeat(noise * np.sqrt(rows.alike), 3)
    white = equations.whitened(rows.joint_sd, sd)
    distance = np.linalg.norm(white.residual, axis=1)
    if rows.alike is not None:
        distance = (length / noise).max(axis=1)
    weight = np.minimum(1.0, HUBER / np.maximum(distance, 1e-300)) * inlier * (distance <= gate)
    return white._replace(weight=np.asarray(weight))


def _fit_inliers(
    rows: TipRows, prior: TipPrior, state: TipState, inlier: Mask, gate: float = np.inf
) -> TipFit:
    """Fit to the inliers with Huber's weights, and judge every point."""
    is_stated, names = rows.alike is None, prior.state.names
    settled = _SETTLED if is_stated else _NEARLY
    for _ in range(_MOST_STEPS):
        normal, gradient = normal_equations(prior, state, whiten_rows(rows, inlier, state, gate))
        inverse = inverted(normal, names, prior.free)
        step = -inverse @ gradient
        state = state.moved(step)
        if (np.abs(step) <= settled * np.sqrt(np.diag(inverse))).all():
            break
    else:
        if is_stated:
            raise CalibrationError(
                "the points do not settle on one correction; are they of this arm and this frame?"
            )
    white = whiten_rows(rows, inlier, state, gate)
    jacobian, residual, weight = white.jacobian, white.residual, white.weight
    covariance = inverted(normal_equations(prior, state, white)[0], names, prior.free)
    # What the fit of the others expects of each point: its own share is taken out of the normal
    # equations (Cook and Weisberg, Residuals and Influence in Regression, 1982, ch. 2).
    one, leverage = np.eye(residual.shape[1]), jacobian @ covariance @ jacobian.transpose(0, 2, 1)
    without = one - weight[:, None, None] * leverage + 1e-9 * one
    deleted = np.linalg.solve(without, residual[:, :, None])
    spread = one + np.linalg.solve(without, leverage)
    distance = np.sqrt((deleted * np.linalg.solve(spread, deleted)).sum(axis=(1, 2)))
    off = prior.state.minus(state)
    misfit = float((weight[:, None] * residual**2).sum() + off @ prior.precision @ off)
    rank = int(np.linalg.matrix_rank(prior.precision, hermitian=True))
    freedom = 3 * int(inlier.sum()) + rank - int(prior.free.sum())
    residuals = white.equations.residual, distance, weight
    return TipFit(rows, prior, state, covariance, *residuals, misfit, freedom)
