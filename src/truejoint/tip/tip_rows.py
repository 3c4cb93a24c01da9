"""Points of the tool that a frame of unknown pose sees: their rows, and the fit to them.

A tip that rests in a dimple of a printed block, or is shot by a tracker, gives three equations in
the corrections of the joints and the pose of that frame: ``R' (tip(joint + correction) - t) = s p``
with the pose ``R, t`` of the frame in the robot's base, the point ``p`` in the frame and the
frame's scale ``s``. The Jacobian of the tip is the kinematics' own.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from truejoint.array_types import Array, Integers, Mask
from truejoint.errors import CalibrationError
from truejoint.robots.parts import Kinematics

POSE: Final = ("turn x", "turn y", "turn z", "shift x", "shift y", "shift z")
"""Parameters of a frame's pose: turn about its own axes [rad], shift along the base's [m]."""
MARKER: Final = ("marker x", "marker y", "marker z")
SCALE: Final = "scale"

HUBER: Final = 2.8
"""Residuals longer than this, in their deviations, pull no harder: one good one in twenty is."""
GATE: Final = 4.5
"""A point that its neighbours expect further off than this, in deviations, is left out: of 30 true
ones, one in two hundred sets."""
_MOST_STEPS: Final = 50
_SETTLED: Final = 1e-4  # of a parameter's standard deviation
_OPEN: Final = 1e-13  # eigenvalue of the scaled normal equations below which a direction is open


@dataclass(frozen=True, eq=False)
class TipState:
    """What the rows depend on.

    Attributes
    ----------
    coefficients : ndarray, shape (k,)
        Of the correction's terms.
    rotation : ndarray, shape (3, 3)
        Of the frame in the robot's base.
    translation : ndarray, shape (3,)
        Of the frame's origin in the robot's base [m].
    marker : ndarray, shape (3,)
        Point that is seen, in the tool's frame [m].
    scale : float
        By which the frame's points are larger than stated.
    """

    coefficients: Array
    rotation: Array = field(default_factory=lambda: np.eye(3))
    translation: Array = field(default_factory=lambda: np.zeros(3))
    marker: Array = field(default_factory=lambda: np.zeros(3))
    scale: float = 1.0

    @property
    def names(self) -> tuple[str, ...]:
        """Parameters, in the order of every Jacobian and covariance."""
        terms = tuple(f"term {k}" for k in range(len(self.coefficients)))
        return (*terms, *POSE, *MARKER, SCALE)

    def __len__(self) -> int:
        return len(self.coefficients) + len(POSE) + len(MARKER) + 1

    def moved(self, step: Array) -> TipState:
        """State after a step (n,) of all parameters; the turn is about the frame's own axes."""
        k = len(self.coefficients)
        return TipState(
            self.coefficients + step[:k],
            self.rotation @ Rotation.from_rotvec(step[k : k + 3]).as_matrix(),
            self.translation + step[k + 3 : k + 6],
            self.marker + step[k + 6 : k + 9],
            self.scale + float(step[k + 9]),
        )

    def minus(self, other: TipState) -> Array:
        """Step (n,) that leads from `other` here."""
        turn = Rotation.from_matrix(other.rotation.T @ self.rotation).as_rotvec()
        shifts = self.translation - other.translation, self.marker - other.marker
        return np.concatenate(
            [self.coefficients - other.coefficients, turn, *shifts, [self.scale - other.scale]]
        )


@dataclass(frozen=True, eq=False)
class TipPrior:
    """What is known before any point is seen.

    Attributes
    ----------
    state : TipState
        Where the parameters are expected, and where the fit starts.
    precision : ndarray, shape (n, n)
        Inverse of their covariance; zero where nothing is known.
    free : ndarray of bool, shape (n,)
        What is estimated; the rest stays as it is in `state`.
    """

    state: TipState
    precision: Array
    free: Mask

    @classmethod
    def of(cls, state: TipState, sd: ArrayLike) -> TipPrior:
        """Prior of independent parameters; `sd` (n,) is infinite where nothing is known, 0 to hold.

        Raises CalibrationError unless there is one standard deviation for each.
        """
        spread = np.asarray(sd, dtype=np.float64)
        if spread.shape != (len(state),) or not (spread >= 0.0).all():
            raise CalibrationError(
                f"a prior of shape {spread.shape} must hold a standard deviation of 0 or more for "
                f"each of {len(state)} parameters"
            )
        free = spread > 0.0
        return cls(
            state, np.diag(np.where(free, 1.0 / np.where(free, spread, 1.0) ** 2, 0.0)), free
        )

    def with_pose(self, precision: Array) -> TipPrior:
        """Prior of a frame whose pose is known: inverse covariance (6, 6) of turn and shift."""
        k = len(self.state.coefficients)
        whole = self.precision.copy()
        whole[k : k + 6, k : k + 6] = precision
        return replace(self, precision=whole)


@dataclass(frozen=True, eq=False)
class TipRows:
    """Points of a tool, a row each.

    Attributes
    ----------
    kinematics : Kinematics
    joint : ndarray, shape (m, n_joints)
        Positions of all joints that the kinematics take, as measured or corrected [rad or m].
    columns : sequence of int
        Which of these the terms correct.
    basis : ndarray, shape (m, n_corrected, k)
        Correction per coefficient [rad or m].
    point : ndarray, shape (m, 3)
        Where the frame has the tool's point [m].
    point_sd : ndarray, shape (m,)
        Standard deviation of that, per axis [m].
    joint_sd : ndarray, shape (n_corrected,)
        Standard deviation of what the best correction leaves, independent from row to row [rad or
        m].

    Raises
    ------
    CalibrationError
        If a shape does not fit the others, or a number is not finite.
    """

    kinematics: Kinematics
    joint: Array
    columns: tuple[int, ...]
    basis: Array
    point: Array
    point_sd: Array
    joint_sd: Array

    def __post_init__(self) -> None:
        m, n = len(self.joint), len(self.columns)
        shapes = {
            "basis": (self.basis, (m, n, self.basis.shape[-1])),
            "point": (self.point, (m, 3)),
            "point_sd": (self.point_sd, (m,)),
            "joint_sd": (self.joint_sd, (n,)),
        }
        for name, (array, shape) in shapes.items():
            if array.shape != shape:
                raise CalibrationError(f"{name} of shape {array.shape} must have shape {shape}")
        arrays = [self.joint, *(array for array, _ in shapes.values())]
        if not all(np.isfinite(array).all() for array in arrays):
            raise CalibrationError(
                "positions and points of the tool must be finite; leave out rows"
            )
        if not ((self.point_sd > 0.0).all() and (self.joint_sd >= 0.0).all()):
            raise CalibrationError("points need a standard deviation above 0, joints 0 or more")

    def __len__(self) -> int:
        return len(self.joint)

    def rows(self, chosen: Mask) -> TipRows:
        """Give some of the rows."""
        names = ("joint", "basis", "point", "point_sd")
        return replace(self, **{name: getattr(self, name)[chosen] for name in names})

    def corrected(self, state: TipState) -> Array:
        """Positions (m, n_joints) of all joints with the correction [rad or m]."""
        joint = self.joint.copy()
        joint[:, self.columns] += self.basis @ state.coefficients
        return joint

    def predict(self, state: TipState) -> Array:
        """Points (m, 3) of the tool in the frame, in true size [m]."""
        tool = self.kinematics.forward(self.corrected(state))
        place = tool[:, :3, 3] + tool[:, :3, :3] @ state.marker
        return np.asarray((place - state.translation) @ state.rotation)

    def residual(self, state: TipState) -> Array:
        """Predicted less stated points (m, 3) [m]."""
        return self.predict(state) - state.scale * self.point

    def moves(self, state: TipState) -> tuple[Array, Array]:
        """Tool poses (m, 4, 4), and the geometric Jacobian (m, 6, n_joints) at the marker.

        Both in the base, the latter of all joints.
        """
        joint = self.corrected(state)
        tool, moves = self.kinematics.forward(joint), self.kinematics.jacobian(joint)
        arm = tool[:, :3, :3] @ state.marker
        moves[:, :3] += np.cross(moves[:, 3:], arm[:, :, None], axis=1)
        return tool, moves

    def jacobian(self, state: TipState) -> tuple[Array, Array]:
        """Jacobians of `residual` by the parameters (m, 3, n) and by the corrected joints.

        The latter (m, 3, n_corrected) is what an error of a joint does to the point.
        """
        tool, moves = self.moves(state)
        back = state.rotation.T
        by_joint = back @ moves[:, :3, self.columns]
        seen = (tool[:, :3, 3] + tool[:, :3, :3] @ state.marker - state.translation) @ back.T
        m = len(self)
        parts = [
            by_joint @ self.basis,
            cross_matrix(seen),
            np.broadcast_to(-back, (m, 3, 3)),
            back @ tool[:, :3, :3],
            -self.point[:, :, None],
        ]
        return np.concatenate(parts, axis=2), by_joint

    def whitening(self, by_joint: Array) -> Array:
        """Matrices (m, 3, 3) that turn residuals into numbers of deviation 1."""
        spread = by_joint * self.joint_sd
        covariance = spread @ spread.transpose(0, 2, 1)
        covariance[:, range(3), range(3)] += self.point_sd[:, None] ** 2
        return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)))


@dataclass(frozen=True, eq=False)
class TipFit:
    """Parameters that fit the points, and how surely.

    Attributes
    ----------
    state : TipState
    covariance : ndarray, shape (n, n)
        Of all parameters; zero for those that were held.
    residual : ndarray, shape (m, 3)
        Predicted less stated points [m].
    distance : ndarray, shape (m,)
        How far off each point is from what the others say, in its standard deviations.
    weight : ndarray, shape (m,)
        With which each point counted; 0 where it was left out.
    expected : ndarray, shape (m, 3, 3)
        Covariance of what is expected of each point's residual: touch, joints, and parameters [m2].
    misfit : float
        Sum of squares of all whitened residuals, the prior's included; `freedom` is what it should
        be.
    freedom : int
        Residuals less parameters that are estimated.
    evidence : float
        Logarithm of the restricted likelihood of the points, to choose standard deviations by, the
        prior's too.
    """

    state: TipState
    covariance: Array
    residual: Array
    distance: Array
    weight: Array
    expected: Array
    misfit: float
    freedom: int
    evidence: float

    @property
    def sd(self) -> Array:
        """Standard deviations (n,) of the parameters."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def left_out(self) -> Mask:
        """Which points (m,) did not fit."""
        return np.asarray(self.weight == 0.0)


def align(tip: Array, point: Array) -> tuple[Array, Array]:
    """Rotation (3, 3) and translation (3,) [m] that lay points (m, 3) over the tip's (m, 3).

    Least squares (Kabsch, Acta Cryst. A32, 1976). Raises CalibrationError for fewer than three
    points or points in one line, which leave a turn open.
    """
    spread = np.linalg.svd(point - point.mean(axis=0), compute_uv=False) if len(point) > 2 else [0]
    if not (len(spread) > 1 and spread[1] > 1e-3 * spread[0] > 0.0):
        raise CalibrationError(
            f"{len(point)} points leave the pose of their frame open; give three or more that do "
            "not lie in one line"
        )
    turn = Rotation.align_vectors(tip - tip.mean(axis=0), point - point.mean(axis=0))[0].as_matrix()
    return turn, tip.mean(axis=0) - turn @ point.mean(axis=0)


def fit_tip(
    rows: TipRows, prior: TipPrior, *, gate: float = GATE, start: TipState | None = None
) -> TipFit:
    """Fit corrections and pose to points of the tool: Gauss-Newton, Huber's weights, priors.

    After the robust fit, points further off than `gate` standard deviations from what all others
    say are left out, the worst first, and the rest is fitted again. `TipFit.weight` says which.
    The fit begins at `start`, by default where the prior expects it; what is held is the prior's.

    Raises
    ------
    CalibrationError
        If points and prior leave a direction of the parameters open, if the fit does not settle,
        or if more than a fifth of the points, and more than one, do not fit: of few, two
        that are left out may be those that are right.
    """
    if len(prior.free) != len(prior.state) or rows.basis.shape[2] != len(prior.state.coefficients):
        raise CalibrationError("the prior is not one of the terms of these rows")
    kept = np.ones(len(rows), dtype=np.bool_)
    state = prior.state
    if start is not None:
        state = state.moved(np.where(prior.free, start.minus(state), 0.0))
    while True:
        found = _fitted(rows, prior, state, kept)
        far = np.where(kept, found.distance, 0.0)
        worst = int(np.argmax(far)) if len(far) else 0
        if not (len(far) and far[worst] > gate):
            break
        kept[worst] = False
        if (~kept).sum() > max(1, len(rows) // 5):
            raise CalibrationError(
                f"{(~kept).sum()} of {len(rows)} points do not fit the others: is this the plate "
                "that was touched, the arm that touched it, and its pose of this day?"
            )
        state = found.state
    # One that was left out beside a worse one may fit after all.
    back = ~kept & (found.distance <= gate)
    return _fitted(rows, prior, found.state, kept | back) if back.any() else found


def _fitted(rows: TipRows, prior: TipPrior, state: TipState, kept: Mask) -> TipFit:
    """Fit to the rows that are kept, weighing by Huber those that lie far off."""
    free = np.flatnonzero(prior.free)
    for _ in range(_MOST_STEPS):
        normal, gradient, _, _ = _normal_equations(rows, prior, state, kept)
        inverse = _inverse(normal[np.ix_(free, free)], prior, free)
        step = np.zeros(len(prior.free))
        step[free] = -inverse @ gradient[free]
        state = state.moved(step)
        if (np.abs(step[free]) <= _SETTLED * np.sqrt(np.diag(inverse))).all():
            break
    else:
        raise CalibrationError(
            "the points do not settle on one correction; are they of this arm and this frame?"
        )
    normal, _, whitened, weight = _normal_equations(rows, prior, state, kept)
    jacobian, residual, whitening = whitened
    inverse = _inverse(normal[np.ix_(free, free)], prior, free)
    covariance = np.zeros_like(normal)
    covariance[np.ix_(free, free)] = inverse
    # What the fit of the others expects of each point: its own share is taken out of the normal
    # equations (Cook and Weisberg, Residuals and Influence in Regression, 1982, ch. 2).
    leverage = jacobian @ covariance @ jacobian.transpose(0, 2, 1)
    own = np.where(kept, weight, 0.0)[:, None, None] * leverage
    without = np.eye(3) - own + 1e-9 * np.eye(3)
    left = np.linalg.solve(without, residual[:, :, None])
    spread = np.eye(3) + np.linalg.solve(without, leverage)
    distance = np.sqrt((left * np.linalg.solve(spread, left)).sum(axis=(1, 2)))
    unwhite = np.linalg.inv(whitening)
    expected = unwhite @ (np.eye(3) + leverage) @ unwhite.transpose(0, 2, 1)
    off = prior.state.minus(state)
    misfit = float((weight[:, None] * residual**2)[kept].sum() + off @ prior.precision @ off)
    log_size = float(np.log(np.linalg.det(whitening[kept])).sum())
    evidence = log_size - 0.5 * misfit + 0.5 * float(np.linalg.slogdet(inverse)[1])
    known = np.flatnonzero(np.diag(prior.precision))
    evidence += 0.5 * float(np.linalg.slogdet(prior.precision[np.ix_(known, known)])[1])
    stated = int(np.linalg.matrix_rank(prior.precision, hermitian=True))
    return TipFit(
        state, covariance, rows.residual(state), distance, np.where(kept, weight, 0.0), expected,
        misfit, 3 * int(kept.sum()) + stated - len(free), evidence,
    )  # fmt: skip


def _normal_equations(
    rows: TipRows, prior: TipPrior, state: TipState, kept: Mask
) -> tuple[Array, Array, tuple[Array, Array, Array], Array]:
    """Set up normal matrix, gradient, whitened Jacobian and residual with what whitens, weights."""
    by_parameter, by_joint = rows.jacobian(state)
    whitening = rows.whitening(by_joint)
    jacobian = whitening @ by_parameter
    residual = np.einsum("mij,mj->mi", whitening, rows.residual(state))
    length = np.linalg.norm(residual, axis=1)
    weight = np.minimum(1.0, HUBER / np.maximum(length, 1e-300))
    counted = np.where(kept, weight, 0.0)
    flat = jacobian.reshape(-1, jacobian.shape[2])
    weighed = (counted[:, None, None] * jacobian).reshape(flat.shape).T
    normal = prior.precision + weighed @ flat
    gradient = prior.precision @ state.minus(prior.state) + weighed @ residual.ravel()
    return normal, gradient, (jacobian, residual, whitening), weight


def _inverse(normal: Array, prior: TipPrior, free: Integers) -> Array:
    """Invert the normal matrix of what is free; raises CalibrationError naming what stays open."""
    size = np.sqrt(np.diag(normal))
    if not (size > 0.0).all():
        name = prior.state.names[free[int(np.argmin(size))]]
        raise CalibrationError(f"the points say nothing of {name}")
    values, vectors = np.linalg.eigh(normal / np.outer(size, size))
    if values[0] < _OPEN * values[-1]:
        share = np.abs(vectors[:, 0])
        names = prior.state.names
        open_ = [names[free[i]] for i in np.argsort(-share)[:4] if share[i] > 0.2]
        raise CalibrationError(
            f"the points leave open {', '.join(open_)} together; touch more, from other sides, or "
            "state what is known"
        )
    return np.asarray((vectors / values) @ vectors.T / np.outer(size, size))


def cross_matrix(vectors: Array) -> Array:
    """Matrices (m, 3, 3) with ``M w = v x w`` of vectors (m, 3)."""
    matrices = np.zeros((len(vectors), 3, 3))
    x, y, z = vectors.T
    matrices[:, 0, 1], matrices[:, 0, 2], matrices[:, 1, 2] = -z, y, -x
    matrices[:, 1, 0], matrices[:, 2, 0], matrices[:, 2, 1] = z, -y, x
    return matrices
