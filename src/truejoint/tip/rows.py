"""Points of the tool that a frame of unknown pose sees, a row of equations each.

A tip that rests in a dimple of a printed block, or a marker that a tracker sees, gives three
equations in the corrections of the joints and the pose of that frame:
``R' (tip(joint + correction) - t) = s p`` with the pose ``R, t`` of the frame in the robot's base,
the point ``p`` in the frame and the frame's scale ``s``. An orientation of the marker gives three
more. The Jacobian of the tip is the kinematics' own.
"""

from __future__ import annotations

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


@dataclass(frozen=True, eq=False)
class TipState:
    """Parameters of the rows."""

    coefficients: Array  # (k,), of the correction's terms
    # (3, 3), of the frame in the robot's base
    rotation: Array = field(default_factory=lambda: np.eye(3))
    # (3,), of the frame's origin in the robot's base [m]
    translation: Array = field(default_factory=lambda: np.zeros(3))
    # (3,), point that is seen, in the tool's frame [m]
    marker: Array = field(default_factory=lambda: np.zeros(3))
    scale: float = 1.0  # By which the frame's points are larger than stated
    # (3, 3), rotation of the marker in the tool's frame
    turn: Array = field(default_factory=lambda: np.eye(3))

    @property
    def names(self) -> tuple[str, ...]:
        """Parameters, in the order of every Jacobian and covariance."""
        terms = tuple(f"term {k}" for k in range(len(self.coefficients)))
        return (*terms, *POSE, *MARKER, SCALE, *TURN)

    def __len__(self) -> int:
        return len(self.coefficients) + 13

    def moved(self, step: Array) -> TipState:
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

    def minus(self, other: TipState) -> Array:
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
        cls,
        state: TipState,
        terms: ArrayLike,
        *,
        pose: ArrayLike = np.inf,
        marker: ArrayLike = 0.0,
        scale: float = 0.0,
        pose_precision: Array | None = None,
    ) -> TipPrior:
        """Prior of independent parameters by their standard deviations.

        A deviation is infinite where nothing is known, and 0 where the parameter is held.
        `pose_precision` (6, 6) is the inverse covariance of a pose that is known, in place of
        `pose`.
        """
        sizes = len(state.coefficients), 6, 3, 1, 3
        parts = zip((terms, pose, marker, scale, 0.0), sizes, strict=True)
        sd = np.concatenate([np.broadcast_to(np.asarray(part, np.float64), n) for part, n in parts])
        free = sd > 0.0
        precision = np.diag(np.where(free, 1.0 / np.where(free, sd, 1.0) ** 2, 0.0))
        if pose_precision is not None:
            k = sizes[0]
            precision[k : k + 6, k : k + 6] = pose_precision
        return cls(state, precision, free)


class Equations(NamedTuple):
    """Residuals of rows at one state, and their Jacobians; d is 3, or 6 with orientations."""

    residual: Array
    """Predicted less stated points, then turns: (m, d) [m, rad]."""
    by_parameter: Array
    """Shape (m, d, n)."""
    by_joint: Array
    """By all joints of the kinematics, (m, d, n_joints)."""

    def whitening(self, joint_sd: Array, sd: Array) -> Array:
        """Matrices (m, d, d) that turn residuals into numbers of deviation 1.

        Of independent errors `joint_sd` (n_joints,) [rad or m] of the joints and `sd`, (m, d) or
        (d,), of the points [m, rad].
        """
        spread = self.by_joint * joint_sd
        covariance = spread @ spread.transpose(0, 2, 1)
        diagonal = range(self.residual.shape[1])
        covariance[:, diagonal, diagonal] += sd**2
        return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)))


@dataclass(frozen=True, eq=False)
class TipRows:
    """Points of a tool, a row each.

    Raises CalibrationError if a number is not finite, or a deviation not above 0.
    """

    kinematics: Kinematics
    # (m, n_joints), positions of all joints that the kinematics take, as measured or corrected [rad
    # or m]
    joint: Array
    columns: tuple[int, ...]  # Which of these the terms correct
    basis: Array  # (m, n_corrected, k), correction per coefficient [rad or m]
    point: Array  # (m, 3), where the frame has the tool's point [m]
    point_sd: float  # Standard deviation of that, per axis [m]
    # (n_joints,), standard deviation of what the best correction leaves of each joint, independent
    # from row to row [rad or m]
    joint_sd: Array
    orientation: Array | None = None  # (m, 3, 3), of the marker in the frame

    def __post_init__(self) -> None:
        arrays = self.joint, self.basis, self.point, self.joint_sd
        if not all(np.isfinite(array).all() for array in arrays):
            raise CalibrationError(
                "positions and points of the tool must be finite; leave out rows"
            )
        if not 0.0 < self.point_sd < np.inf:
            raise CalibrationError(
                f"points are within {self.point_sd} m of where they are stated; give a deviation "
                "above 0"
            )

    @classmethod
    def of(
        cls,
        robot: Robot,
        joint: Array,
        corrected: Sequence[str],
        basis: Array,
        point: Array,
        point_sd: float,
        corrected_sd: Array,
    ) -> TipRows:
        """Rows of a robot's tool, where deviations `corrected_sd` stay of the joints `corrected`.

        Raises CalibrationError where its kinematics are not known.
        """
        columns, joint_sd = robot.index(corrected), np.zeros(joint.shape[1])
        joint_sd[columns] = corrected_sd
        chain = known_kinematics(robot)
        return cls(chain, joint, tuple(columns), basis, point, point_sd, joint_sd)

    def __len__(self) -> int:
        return len(self.joint)

    def rows(self, chosen: Mask) -> TipRows:
        """Give some of the rows."""
        turns = None if self.orientation is None else self.orientation[chosen]
        names = ("joint", "basis", "point")
        parts = {name: getattr(self, name)[chosen] for name in names}
        return replace(self, **parts, orientation=turns)

    def with_joint_sd(self, corrected: Array) -> TipRows:
        """Rows with another deviation (n_corrected,) of the joints that the terms correct."""
        joint_sd = self.joint_sd.copy()
        joint_sd[list(self.columns)] = corrected
        return replace(self, joint_sd=joint_sd)

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

    def predict(self, state: TipState) -> Array:
        """Points (m, 3) of the tool in the frame, in true size [m]."""
        return np.asarray((self.tool_points(state)[1] - state.translation) @ state.rotation)

    def residual(self, state: TipState) -> Array:
        """Predicted less stated points (m, 3) [m]."""
        return self.predict(state) - state.scale * self.point

    def equations(self, state: TipState) -> Equations:
        """Residuals and Jacobians at a state, the latter by parameters and by joints."""
        m, k, back = len(self), len(state.coefficients), state.rotation.T
        turn, place = self.tool_points(state)
        moves = self.kinematics.jacobian(self.corrected(state))
        moves[:, :3] += np.cross(moves[:, 3:], (turn @ state.marker)[:, :, None], axis=1)
        by_joint = back @ moves[:, :3]
        point = (place - state.translation) @ state.rotation
        residual = point - state.scale * self.point
        parts = [
            by_joint[:, :, self.columns] @ self.basis,
            cross_matrix(point),
            np.broadcast_to(-back, (m, 3, 3)),
            back @ turn,
            -self.point[:, :, None],
            np.zeros((m, 3, 3)),
        ]
        by_parameter = np.concatenate(parts, axis=2)
        if self.orientation is None:
            return Equations(residual, by_parameter, by_joint)
        predicted, turns = back @ turn @ state.turn, back @ moves[:, 3:]
        off = Rotation.from_matrix(predicted @ self.orientation.transpose(0, 2, 1)).as_rotvec()
        by_turn = np.zeros((m, 3, k + 13))
        by_turn[:, :, :k] = turns[:, :, self.columns] @ self.basis
        by_turn[:, :, k : k + 3] = -np.eye(3)
        by_turn[:, :, k + 10 :] = predicted
        return Equations(
            np.hstack([residual, off]),
            np.concatenate([by_parameter, by_turn], axis=1),
            np.concatenate([by_joint, turns], axis=1),
        )


def known_kinematics(robot: Robot) -> Kinematics:
    """Kinematics of a robot; raises CalibrationError where they are not known."""
    if robot.kinematics is None:
        raise CalibrationError(
            f"the kinematics of {robot.title} are not known, so a point of its tool says nothing "
            "of its joints; give its robot file a table [kinematics] (docs/robots.md)"
        )
    return robot.kinematics


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


def cross_matrix(vectors: Array) -> Array:
    """Matrices (m, 3, 3) with ``M w = v x w`` of vectors (m, 3)."""
    matrices = np.zeros((len(vectors), 3, 3))
    x, y, z = vectors.T
    matrices[:, 0, 1], matrices[:, 0, 2], matrices[:, 1, 2] = -z, y, -x
    matrices[:, 1, 0], matrices[:, 2, 0], matrices[:, 2, 1] = z, -y, x
    return matrices
