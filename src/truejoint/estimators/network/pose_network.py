"""The network of peng2024, trained on where the tool is instead of on each joint."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar, Final, Self

import numpy as np

from truejoint.array_types import Array
from truejoint.errors import CalibrationError
from truejoint.estimators.family import Family, Rule, optional
from truejoint.estimators.network import tool_network
from truejoint.estimators.network.layers import Floats
from truejoint.estimators.network.learn import NeuralNetwork

if TYPE_CHECKING:
    from truejoint.robots import Robot
    from truejoint.robots.parts import Kinematics

_STILL: Final = 1e-6  # m per rad or m per m; below, a joint moves the tool nowhere of its own


@dataclass(eq=False, repr=False)
class PoseNetwork(NeuralNetwork):
    """The network of peng2024, trained on where the tool is instead of on each joint.

    After Peng et al., "Real-time data driven precision estimator for RAVEN-II surgical robot end
    effector position" (ICRA 2020), whose network corrects the tool's position: minimises the mean
    squared distance of the tool from its true position, to first order by the Jacobian of the
    robot's kinematics at the measured positions, over what it would be if each joint were off by
    one standard deviation of its own. Predicts the joints all the same, and runs as `NeuralNetwork`
    does. Joints that it does not correct count as exact.

    Parameters
    ----------
    hidden_layer_sizes, weight_decay, learning_rate, batch_size, epochs, random_state, rows
        As of `NeuralNetwork`.
    tool : callable, optional
        Gives for rows `X` (n, k) how the tool moves with the outputs, (n, m, n_outputs) [m per rad
        or m]; `calibrate` takes a `ToolMotion` of the robot. By default the outputs themselves are
        the tool's coordinates.

    Examples
    --------
    >>> def on_a_circle(X):
    ...     return np.stack([-np.sin(X), np.cos(X)], axis=1)
    >>> network = PoseNetwork(hidden_layer_sizes=(8,), epochs=2, tool=on_a_circle)
    >>> X = np.linspace(0.0, 1.0, 50)[:, None]
    >>> network.fit(X, 0.1 * X[:, 0]).predict([[0.3]]).shape
    (1,)
    """

    family: ClassVar[Family] = tool_network.FAMILY
    training: ClassVar[Mapping[str, Rule]] = {
        **NeuralNetwork.training,
        "tool": optional(Rule(callable, "a function of rows")),
    }
    tool: Callable[[Array], Array] | None = None

    def for_features(self, names: Sequence[str], robot: Robot, joints: Sequence[str]) -> Self:
        """Unfitted copy that knows how the robot's joints move its tool.

        Raises CalibrationError where the robot's kinematics are not known, or the measured position
        of a joint that is corrected is no feature.
        """
        if not (self.tool is None or isinstance(self.tool, ToolMotion)):
            return self.with_params()
        return self.with_params(tool=ToolMotion.of(self.name, names, robot, joints))

    def squares(self, X: Array, target_scale: Array) -> Floats:
        """Weigh squared differences from standardised targets (n, k, k) by what the tool does."""
        k = len(target_scale)
        moves = np.broadcast_to(np.eye(k), (len(X), k, k)) if self.tool is None else self.tool(X)
        if np.ndim(moves) != 3 or (len(moves), moves.shape[2]) != (len(X), k):
            raise CalibrationError(
                f"{self.name}: tool gives an array of shape {np.shape(moves)}; it must be "
                f"({len(X)}, coordinates, {k}) for {len(X)} rows and {k} outputs"
            )
        scaled = moves * target_scale
        weights = scaled.transpose(0, 2, 1) @ scaled
        usual = float(np.trace(weights, axis1=1, axis2=2).mean())
        if not 0.0 < usual < math.inf:
            raise CalibrationError(
                f"{self.name}: tool gives numbers by which nothing moves, or that are not finite"
            )
        return (weights / usual).astype(np.float32)


@dataclass(frozen=True, eq=False)
class ToolMotion:
    """How a robot's tool moves with some of its joints, of rows of features.

    Joints whose measured positions are no features stand where they are after homing.
    """

    joints: tuple[str, ...]
    name: str = field(repr=False)  # of the estimator
    kinematics: Kinematics = field(repr=False)
    home: Array = field(repr=False)  # (n,) [rad or m], of all joints
    corrected: tuple[int, ...] = field(repr=False)  # places of `joints` among all
    places: tuple[tuple[int, int], ...] = field(repr=False)  # of a joint, and of its feature

    @classmethod
    def of(cls, name: str, names: Sequence[str], robot: Robot, joints: Sequence[str]) -> Self:
        """Find the joints' measured positions among the features called `names`.

        Raises CalibrationError as `PoseNetwork.for_features`.
        """
        if robot.kinematics is None:
            raise CalibrationError(
                f"{name} needs the kinematics of {robot.title}, which are not known; add them to "
                "its robot file, or choose another estimator"
            )
        measured = {joint: f"measured/{joint}" for joint in robot.joint_names}
        absent = [measured[joint] for joint in joints if measured[joint] not in names]
        if absent:
            raise CalibrationError(
                f"{name} must know where the joints are that it corrects; add "
                f"{', '.join(absent)} to the features"
            )
        places = tuple(
            (i, list(names).index(one)) for i, one in enumerate(measured.values()) if one in names
        )
        corrected = tuple(robot.index(joints))
        return cls(tuple(joints), name, robot.kinematics, robot.home, corrected, places)

    def __call__(self, X: Array) -> Array:
        """Jacobian (n, 3, n_joints) [m per rad or m] of the tool's position for rows `X` (n, k).

        Raises CalibrationError where it leaves a joint open in most rows.
        """
        positions = np.tile(self.home, (len(X), 1))
        for joint, feature in self.places:
            positions[:, joint] = X[:, feature]
        moves = self.kinematics.jacobian(positions)[:, :3, list(self.corrected)]
        least = np.linalg.svd(moves, compute_uv=False)[:, -1]
        if len(self.corrected) > 3 or np.median(least) < _STILL:
            raise CalibrationError(
                f"{self.name}: where the tool is does not tell {', '.join(self.joints)} apart; "
                "correct three joints at most, each of which moves the tool (--joint)"
            )
        return np.ascontiguousarray(moves)
