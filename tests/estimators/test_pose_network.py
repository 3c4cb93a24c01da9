"""The network that is trained on the tool: its squares, the tool's motion, what it is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.estimators.test_network import SIZES, assert_slopes, forward, problem
from tests.runtime.streams import JOINTS, MINUTE, SIGNALS, recording

from truejoint.calibration import calibrate, read_calibration, write_calibration
from truejoint.calibration.fit import reseeded
from truejoint.errors import CalibrationError
from truejoint.estimators import Combination, NeuralNetwork, PoseNetwork
from truejoint.estimators.network import learn as network
from truejoint.estimators.network.layers import Layers, loss_and_gradient
from truejoint.estimators.network.pose_network import ToolMotion
from truejoint.robots import get_robot

RAVEN = get_robot("raven2")
SMALL = {"hidden_layer_sizes": (5,), "epochs": 3}
FEATURES = ("effort/elbow", "measured/elbow", "measured/shoulder", "measured/insertion")


def test_gradient_of_weighted_squares_is_the_slope_of_the_loss():
    layers, X, y = problem(13)
    moves = np.random.default_rng(1).normal(size=(13, 2, 3))
    y[:4, 1] = np.nan

    def loss() -> float:
        left = np.nan_to_num(y - forward(layers, X))  # what is not known is met
        away = np.stack([move @ one for move, one in zip(moves, left, strict=True)])
        decay = 0.01 * sum(float((weight**2).sum()) for weight in layers.weights)
        return float((away**2).sum(axis=1).mean()) + decay

    weights = moves.transpose(0, 2, 1) @ moves
    gradient = Layers.zeros(SIZES, np.float64)
    found = loss_and_gradient(layers, X, y, 0.01, gradient, weights=weights)
    assert found == pytest.approx(loss(), rel=1e-12)
    assert_slopes(gradient, layers, range(0, layers.flat.size, 3), loss)


def test_outputs_that_move_the_tool_alike_are_those_of_any_network():
    rng = np.random.default_rng(0)
    X, y = rng.normal(size=(400, 3)), rng.normal(2.0, [0.1, 7.0], (400, 2))
    each = np.diag(1.0 / y.std(axis=0))
    alike = PoseNetwork(**SMALL, tool=lambda X: np.broadcast_to(each, (len(X), 2, 2))).fit(X, y)
    usual = NeuralNetwork(**SMALL).fit(X, y)
    np.testing.assert_allclose(alike.predict(X), usual.predict(X), rtol=0, atol=1e-4)
    assert alike.loss_curve_ == pytest.approx(usual.loss_curve_, rel=1e-4)


def test_its_squares_are_those_of_the_tool_over_what_is_usual():
    moves = np.random.default_rng(2).normal(size=(50, 3, 2))
    scale, left = np.array([0.2, 3.0]), np.array([1.5, -0.5])
    weights = PoseNetwork(tool=lambda X: moves).squares(np.zeros((50, 1)), scale)
    away = moves @ (scale * left)
    usual = np.mean([np.sum((move * scale) ** 2) for move in moves])
    squares = np.einsum("i,nij,j->n", left, weights, left)
    np.testing.assert_allclose(squares, (away**2).sum(axis=1) / usual, rtol=1e-5)


def arm(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Two joints, and errors of which the first, a curve, is the tool's; the second is noise."""
    rng = np.random.default_rng(seed)
    X = rng.uniform(-1.0, 1.0, (2000, 2))
    return X, np.column_stack([np.sin(4.0 * X[:, 0]) * X[:, 1], np.sign(np.sin(9.0 * X[:, 1]))])


@pytest.mark.parametrize("seed", [0, 1])
def test_it_spends_its_units_on_the_tool(seed):
    def moves(X):
        swung = 0.3 + 0.1 * np.cos(X[:, 1])
        return np.stack([np.column_stack([swung, np.full(len(X), 0.002)])], axis=1)

    def tool_error(model):
        X, y = arm(seed + 10)
        return float(np.mean((moves(X) @ (model.predict(X) - y)[:, :, None]) ** 2))

    how = {"hidden_layer_sizes": (6,), "learning_rate": 0.02, "weight_decay": 0.0, "epochs": 60}
    usual = NeuralNetwork(**how, random_state=seed).fit(*arm(seed))
    on_tool = PoseNetwork(**how, random_state=seed, tool=moves).fit(*arm(seed))
    assert tool_error(on_tool) < 0.7 * tool_error(usual)


def test_training_until_convergence_sees_the_tool_alone(monkeypatch):
    monkeypatch.setattr(network, "PATIENCE", 300)
    monkeypatch.setattr(network, "LONGEST", 1500)
    rng = np.random.default_rng(0)
    X = rng.uniform(-1.0, 1.0, (400, 2))
    curve = np.sin(3.0 * X[:, 0]) + rng.normal(0.0, 0.3, 400)

    def first(X):
        return np.broadcast_to([[1.0, 0.0]], (len(X), 1, 2))

    usual = {"hidden_layer_sizes": (10,), "learning_rate": 0.05, "weight_decay": 0.0}
    usual |= {"epochs": 0, "tool": first}
    looked_at = np.isin(np.arange(400) * network.BLOCKS // 400, network.LEFT_OUT)
    one, other = (  # that would stop early or late, were they to see the second output
        PoseNetwork(**usual).fit(X, np.column_stack([curve, sign * X[:, 0] * looked_at]))
        for sign in (1.0, -1.0)
    )
    assert one.epochs_ == other.epochs_
    np.testing.assert_array_equal(one.predict(X)[:, 0], other.predict(X)[:, 0])


def test_the_tool_moves_as_forward_kinematics_say():
    motion = ToolMotion.of("it", FEATURES, RAVEN, ("insertion", "elbow"))
    X = np.array([[9.0, 0.9, 0.4, 0.05], [9.0, 1.2, 0.6, 0.1]])
    for row, found in zip(X, motion(X), strict=True):
        positions = RAVEN.home.copy()  # of the wrist, whose positions are no features
        positions[:3] = row[[2, 1, 3]]
        for joint, column in ((2, found[:, 0]), (1, found[:, 1])):
            sides = []
            for h in (1e-6, -1e-6):
                moved = positions.copy()
                moved[joint] += h
                sides.append(RAVEN.kinematics.forward(moved)[:3, 3])
            np.testing.assert_allclose(column, (sides[0] - sides[1]) / 2e-6, atol=1e-8)


def test_a_calibration_is_told_the_robot_and_reseeds_after_its_file(tmp_path):
    training = recording(MINUTE)
    how = {"features": SIGNALS, "joints": JOINTS}
    made = calibrate(training, PoseNetwork(**SMALL), **how)
    assert made.model.tool.joints == JOINTS
    usual = calibrate(training, NeuralNetwork(**SMALL), **how)
    assert not np.array_equal(made.correct(training), usual.correct(training))
    path = tmp_path / "model.safetensors"
    write_calibration(made, path)
    read = read_calibration(path)
    np.testing.assert_array_equal(read.correct(training), made.correct(training))
    (again,) = reseeded(read, training, [0])
    np.testing.assert_array_equal(again.correct(training), made.correct(training))
    sum_of_two = calibrate(training, Combination(("linear", PoseNetwork(**SMALL))), **how)
    assert sum_of_two.model.members_[1].tool.joints == JOINTS


def test_what_it_is_told_by_hand_stays():
    def tool(X):
        return np.broadcast_to(np.eye(2), (len(X), 2, 2))

    told = PoseNetwork(tool=tool).for_features(FEATURES, RAVEN, ("elbow",))
    assert told.tool is tool


@pytest.mark.parametrize(
    ("names", "robot", "joints", "said"),
    [
        (FEATURES, replace(RAVEN, kinematics=None), JOINTS, "needs the kinematics of raven2"),
        (FEATURES[1:2], RAVEN, JOINTS, "add measured/shoulder to the features"),
    ],
)
def test_what_leaves_the_tool_unknown_is_refused(names, robot, joints, said):
    with pytest.raises(CalibrationError, match=said) as caught:
        PoseNetwork().for_features(names, robot, joints)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("joints", [("roll",), ("insertion", "roll"), RAVEN.joint_names[:4]])
def test_joints_that_the_tool_does_not_tell_apart_are_refused(joints):
    names = [f"measured/{joint}" for joint in RAVEN.joint_names[:4]]
    X = np.random.default_rng(0).uniform(0.3, 0.8, (400, 4))
    told = PoseNetwork(**SMALL).for_features(names, RAVEN, joints)
    with pytest.raises(CalibrationError, match=f"does not tell {', '.join(joints)} apart"):
        told.fit(X, X[:, : len(joints)])


@pytest.mark.parametrize(
    ("tool", "said"),
    [
        ("jacobian", "tool is 'jacobian'; it must be a function"),
        (lambda X: np.ones((len(X), 3)), r"shape \(400, 3\); it must be \(400, coordinates, 2\)"),
        (lambda X: np.ones((len(X), 3, 1)), r"shape \(400, 3, 1\); it must be"),
        (lambda X: np.zeros((len(X), 3, 2)), "by which nothing moves"),
        (lambda X: np.full((len(X), 3, 2), np.nan), "not finite"),
    ],
)
def test_a_tool_that_is_none_is_refused(tool, said):
    X = np.random.default_rng(0).normal(size=(400, 2))
    with pytest.raises(CalibrationError, match=said):
        PoseNetwork(**SMALL, tool=tool).fit(X, X)
