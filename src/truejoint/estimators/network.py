"""The deep neural network of peng2024, IV-B: its training by the Keras loss, and Adam."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING, Any, ClassVar, Final, NamedTuple, Self

import numpy as np
from numpy.typing import DTypeLike, NDArray
from sklearn.base import clone
from sklearn.utils import check_random_state

from truejoint.array_types import Array
from truejoint.compiled import compiled
from truejoint.errors import CalibrationError
from truejoint.estimators.base import Arrays, JointRegressor, Progress, scaling
from truejoint.models import network, tool_network
from truejoint.models.family import Family, Params, is_integer

if TYPE_CHECKING:
    from truejoint.robots import Robot
    from truejoint.robots.parts import Kinematics

Floats = NDArray[np.floating]

MINIMUM_ROWS: Final = 300  # ten seconds at 30 Hz; fewer hold half a motion
ROWS_PER_FEATURE: Final = 10
BATCHES_PER_EPOCH: Final = 8  # at least: where rows are few, batches shrink to keep their number
SMALLEST_BATCH: Final = 32
BLOCKS: Final = 10  # that the rows are cut into, to see when training has converged
LEFT_OUT: Final = (2, 7)  # which of them training does not see meanwhile
LONGEST: Final = 30_000  # steps of Adam until convergence, at most
PATIENCE: Final = 4_000  # steps without a better loss that are always waited for
# Adam as in peng2024, IV-B; the last is the default of Keras, which the paper does not state.
FIRST_DECAY: Final = 0.9
SECOND_DECAY: Final = 0.999
EPSILON: Final = 1e-7
_STILL: Final = 1e-6  # m per rad or m per m; below, a joint moves the tool nowhere of its own


@dataclass(eq=False, repr=False)
class NeuralNetwork(JointRegressor):
    """Fully connected network with logistic hidden units and linear outputs: peng2024, IV-B.

    Minimises Keras' loss, mean squared error plus `weight_decay` times the sum of the squared
    weights, by Adam from Keras' default start, on features and targets standardised by the
    training rows. Trains in float32, predicts in float64.

    Parameters
    ----------
    hidden_layer_sizes : sequence of int
        Units of each hidden layer.
    weight_decay : float
        Factor of the L2 penalty on the weights in the sense of Keras; biases are free.
    learning_rate : float
        Of Adam, with decay rates 0.9 and 0.999.
    batch_size : int
        Rows of a batch. Where there are fewer rows than eight such batches, a batch is an eighth of
        the rows, yet at least 32, so that few rows still get 1600 steps in 200 epochs.
    epochs : int
        Passes over the rows. 0: until convergence. Two tenths of the rows, each on end, are then
        left out until their loss has not fallen for half as many steps of Adam as it took, and
        4000, at most 30,000 in all; the network is fitted anew to all rows for the best epochs.
    random_state : int, RandomState or None
        Seeds the start and the order of the rows; None differs every time.
    rows : int, optional
        Most rows that it is fitted to, evenly spread; by default all.

    Attributes
    ----------
    weight_0_, weight_1_, ... : ndarray, shape (inputs, units)
    bias_0_, bias_1_, ... : ndarray, shape (units,)
    batch_size_ : int
        Batch that training used.
    epochs_ : int
        Epochs that it took.
    loss_curve_ : list of float
        Mean loss over the batches of each epoch, in standardised units.

    Examples
    --------
    >>> network = NeuralNetwork(hidden_layer_sizes=(8,), epochs=2)
    >>> X = np.arange(50.0)[:, None]
    >>> network.fit(X, X[:, 0]).predict([[3.0]]).shape
    (1,)
    """

    family: ClassVar[Family] = network.FAMILY
    least_rows: ClassVar[int] = MINIMUM_ROWS
    rows_per_feature: ClassVar[int] = ROWS_PER_FEATURE
    partial: ClassVar[bool] = True
    hidden_layer_sizes: tuple[int, ...] = (100, 100)
    weight_decay: float = 5e-4
    learning_rate: float = 1e-3
    batch_size: int = 1024
    epochs: int = 200
    random_state: int | np.random.RandomState | None = 0
    rows: int | None = None

    def model_params(self) -> Params:
        """Parameters as the family knows them: once fitted, with the epochs that it took."""
        known = {name: value for name, value in super().model_params().items() if name != "rows"}
        return known | {"epochs": self.epochs or vars(self).get("epochs_", 0)}

    def check_params(self) -> None:
        """Raise CalibrationError, naming the parameter and its rule, when one breaks it."""
        super().check_params()
        if not (self.rows is None or is_integer(self.rows, MINIMUM_ROWS, 10**9)):
            raise CalibrationError(
                f"{self.name} parameter rows is {self.rows!r:.60}; it must be an integer from "
                f"{MINIMUM_ROWS}, or None for all"
            )

    def penalties(self) -> Penalties:
        """Penalties beside that on the squared weights: none."""
        return _NO_MORE

    def settled(self) -> Self:
        """Unfitted network that takes the epochs which this one took.

        In an automatic choice that is the one without the first part: for the median over all
        parts, each would need a search of its own, which trains the network a second time.
        """
        return clone(self).set_params(**self.model_params())  # type: ignore[no-any-return]

    def _learn(self, X: Array, y: Array, dt: Array, progress: Progress) -> Arrays:
        if self.rows is not None:
            spread = slice(None, None, -(-len(X) // int(self.rows)))
            X, y = X[spread], y[spread]
        arrays = scaling(X, y)
        rows = ((X - arrays["mean"]) * arrays["inverse_scale"]).astype(np.float32)
        targets = ((y - arrays["target_mean"]) / arrays["target_scale"]).astype(np.float32)
        sizes = network.layer_sizes(self.get_params(), X.shape[1], y.shape[1])
        weights = self.squares(X, arrays["target_scale"])
        self.epochs_ = int(self.epochs) or self._converged(rows, targets, weights, sizes, progress)
        rng = check_random_state(self.random_state)
        layers = Layers.glorot(sizes, rng)
        self.train(layers, rows, targets, self.epochs_, rng, progress, weights)
        for i, (weight, bias) in enumerate(zip(layers.weights, layers.biases, strict=True)):
            arrays |= {f"weight_{i}": weight.astype(float), f"bias_{i}": bias.astype(float)}
        return arrays

    def squares(self, X: Array, target_scale: Array) -> Floats | None:
        """Weigh squared differences from standardised targets; None: all alike.

        See `loss_and_gradient`; `X` (n, n_inputs) are the rows, `target_scale` (n_outputs,) that of
        the targets.
        """
        return None

    def train(
        self,
        layers: Layers,
        X: Floats,
        y: Floats,
        epochs: int,
        rng: np.random.RandomState,
        progress: Progress,
        weights: Floats | None = None,
    ) -> None:
        """Train layers in place on standardised rows."""
        for epoch in self._epochs(layers, X, y, weights, epochs, rng):
            progress((epoch + 1) / epochs)

    def _converged(
        self,
        X: Floats,
        y: Floats,
        weights: Floats | None,
        sizes: tuple[int, ...],
        progress: Progress,
    ) -> int:
        """Epochs after which the loss of the rows left out was least."""
        rng = check_random_state(self.random_state)
        layers = Layers.glorot(sizes, rng)
        blocks = np.arange(len(X)) * BLOCKS // len(X)
        unseen = np.isin(blocks, LEFT_OUT)
        per_epoch = -(-int((~unseen).sum()) // effective_batch(len(X), int(self.batch_size)))
        longest, patience = LONGEST // per_epoch + 1, PATIENCE // per_epoch + 1
        least, best = math.inf, 1
        own = None if weights is None else weights[~unseen]
        for epoch in self._epochs(layers, X[~unseen], y[~unseen], own, longest, rng):
            delta = forward(layers, X[unseen])[-1] - y[unseen]
            delta[np.isnan(y[unseen])] = 0.0
            weighted = delta
            if weights is not None:
                weighted = np.einsum("nij,nj->ni", weights[unseen], delta)
            loss = float(np.vdot(delta, weighted))
            if loss < least:
                least, best = loss, epoch + 1
            if epoch + 1 >= best + max(patience, best // 2):
                break
            progress(0.0)
        return best

    def _epochs(
        self,
        layers: Layers,
        X: Floats,
        y: Floats,
        weights: Floats | None,
        epochs: int,
        rng: np.random.RandomState,
    ) -> Iterator[int]:
        """Train in place, in a fresh order of the rows in each epoch; give each when it is over."""
        sizes = len(layers.weights[0]), *map(len, layers.biases)
        gradient = Layers.zeros(sizes, layers.flat.dtype)
        decay, rate = float(self.weight_decay), float(self.learning_rate)
        more = self.penalties()
        adam = Adam(layers.flat, rate)
        self.batch_size_ = effective_batch(len(X), int(self.batch_size))
        self.loss_curve_: list[float] = []
        for epoch in range(epochs):
            order = rng.permutation(len(X))
            losses = []
            for start in range(0, len(X), self.batch_size_):
                rows = order[start : start + self.batch_size_]
                inputs, wanted = (one.take(rows, axis=0, mode="clip") for one in (X, y))  # fastest
                own = None if weights is None else weights.take(rows, axis=0, mode="clip")
                losses.append(loss_and_gradient(layers, inputs, wanted, decay, gradient, more, own))
                adam.step(gradient.flat)
            self.loss_curve_.append(float(np.mean(losses)))
            check_loss(self.loss_curve_, epochs, rate)
            yield epoch

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.non_deterministic = self.random_state is None
        return tags


@dataclass(eq=False, repr=False)
class WideNetwork(NeuralNetwork):
    """The larger network of peng2024, II-H, for all features of the robot's state.

    Factors are those of HaonanPeng/RAVEN-2-Feature-Ablation, as the paper's; each in the sense of
    Keras. Once fitted, it is a network like any other.

    Parameters
    ----------
    hidden_layer_sizes, weight_decay, learning_rate, batch_size, epochs, random_state, rows
        As of `NeuralNetwork`.
    absolute_decay : float
        Factor of the L1 penalty on the weights.
    bias_decay, activity_decay : float
        Factors of the L2 penalties on biases and on hidden activations.

    Examples
    --------
    >>> WideNetwork().hidden_layer_sizes
    (600, 500, 400)
    """

    hidden_layer_sizes: tuple[int, ...] = (600, 500, 400)
    weight_decay: float = 1e-4
    absolute_decay: float = 1e-5
    bias_decay: float = 1e-4
    activity_decay: float = 1e-5

    def model_params(self) -> Params:
        """Parameters as the family knows them, which is told nothing of the other penalties."""
        own = ("absolute_decay", "bias_decay", "activity_decay")
        return {name: value for name, value in super().model_params().items() if name not in own}

    def penalties(self) -> Penalties:
        """Penalties beside that on the squared weights."""
        return Penalties(self.absolute_decay, self.bias_decay, self.activity_decay)


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
    tool: Callable[[Array], Array] | None = None

    def model_params(self) -> Params:
        """Parameters as the family knows them, which is told nothing of the tool."""
        return {name: value for name, value in super().model_params().items() if name != "tool"}

    def check_params(self) -> None:
        """Raise CalibrationError, naming the parameter and its rule, when one breaks it."""
        super().check_params()
        if self.tool is not None and not callable(self.tool):
            raise CalibrationError(
                f"{self.name} parameter tool is {self.tool!r:.60}; it must be a function of rows, "
                "or left to the robot's kinematics"
            )

    def for_features(self, names: Sequence[str], robot: Robot, joints: Sequence[str]) -> Self:
        """Unfitted copy that knows how the robot's joints move its tool.

        Raises CalibrationError where the robot's kinematics are not known, or the measured position
        of a joint that is corrected is no feature.
        """
        if not (self.tool is None or isinstance(self.tool, ToolMotion)):
            return clone(self)  # type: ignore[no-any-return]  # sklearn: untyped
        return clone(self).set_params(  # type: ignore[no-any-return]  # sklearn: untyped
            tool=ToolMotion.of(self.name, names, robot, joints)
        )

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


def effective_batch(n_rows: int, batch_size: int) -> int:
    """Rows of a batch: `batch_size`, or an eighth of the rows where these are few."""
    return min(batch_size, max(SMALLEST_BATCH, n_rows // BATCHES_PER_EPOCH))


@dataclass(frozen=True, eq=False)
class Layers:
    """Weights and biases of a network, as views into one flat vector for the optimiser."""

    flat: Floats
    weights: tuple[Floats, ...]  # (inputs, units)
    biases: tuple[Floats, ...]  # (units,)

    @classmethod
    def zeros(cls, sizes: tuple[int, ...], dtype: DTypeLike = np.float32) -> Self:
        """Layers between `sizes` = (inputs, hidden units..., outputs), all zero."""
        pairs = list(pairwise(sizes))
        ends = np.cumsum([n for inputs, units in pairs for n in (inputs * units, units)])
        flat = np.zeros(ends[-1], dtype)
        parts = np.split(flat, ends[:-1])
        biases = tuple(parts[1::2])
        weights = (w.reshape(-1, len(b)) for w, b in zip(parts[::2], biases, strict=True))
        return cls(flat, tuple(weights), biases)

    @classmethod
    def glorot(
        cls, sizes: tuple[int, ...], rng: np.random.RandomState, dtype: DTypeLike = np.float32
    ) -> Self:
        """Layers as Keras starts them: uniform within sqrt(6 / (inputs + units)), zero biases."""
        layers = cls.zeros(sizes, dtype)
        for weight in layers.weights:
            bound = math.sqrt(6.0 / sum(weight.shape))
            weight[:] = rng.uniform(-bound, bound, weight.shape)
        return layers


class Penalties(NamedTuple):
    """Factors of further penalties on a network, in the sense of Keras."""

    weights: float = 0.0  # of the sum of the weights' sizes (L1)
    biases: float = 0.0  # of the sum of the squared biases
    activities: float = 0.0  # of the sum of the squared hidden activations, mean over a batch


_NO_MORE: Final = Penalties()


def loss_and_gradient(
    layers: Layers,
    X: Floats,
    y: Floats,
    weight_decay: float,
    gradient: Layers,
    more: Penalties = _NO_MORE,
    weights: Floats | None = None,
) -> float:
    """Keras' loss of a batch `X` (n, n_inputs), `y` (n, n_outputs), and its gradient, in place.

    ``mean((y - f(X))**2) + weight_decay * sum(weights**2)``, the mean over rows and outputs, biases
    free; where `y` is NaN, the difference is none. The loss of scikit-learn's ``MLPRegressor`` has
    the same minimiser at ``alpha = weight_decay * n_outputs * n_rows``. `more` is added to it. With
    symmetric `weights` W (n, n_outputs, n_outputs) the squares are (y - f(X))' W (y - f(X)), and
    the mean is over rows.
    """
    activations = forward(layers, X)
    delta = activations.pop()
    sums = np.zeros_like(layers.biases[-1])
    if weights is None:
        loss = _slopes_of_squares(delta, y, np.array([2.0 / delta.size], delta.dtype), sums)
    else:
        loss = _slopes_of_weighted_squares(delta, y, weights, sums)
    for layer in reversed(range(len(layers.weights))):
        source, weight = activations[layer], layers.weights[layer]
        np.matmul(source.T, delta, out=gradient.weights[layer])
        gradient.weights[layer][:] += (2.0 * weight_decay) * weight
        gradient.biases[layer][:] = sums
        loss += weight_decay * float(np.vdot(weight, weight))
        if more is not _NO_MORE:
            loss += _penalised(more, weight, layers.biases[layer], gradient, layer)
        if layer:
            delta = delta @ weight.T
            if more.activities:
                loss += more.activities * float(np.vdot(source, source)) / len(X)
                delta += (2.0 * more.activities / len(X)) * source
            sums = np.zeros_like(layers.biases[layer - 1])
            _through_logistic(delta, source, sums)
    return loss


@compiled
def _slopes_of_squares(found: Floats, y: Floats, scale: Floats, sums: Floats) -> float:
    """Make slopes of the mean square of what was found (n, k), and give it; add them up (k,).

    `scale` (1,) is twice the inverse of its numbers, of their precision; unknown is what is NaN.
    """
    total = 0.0
    for i in range(found.shape[0]):
        for j in range(found.shape[1]):
            difference = found[i, j] - y[i, j]
            if math.isnan(y[i, j]):
                difference = found[i, j] - found[i, j]
            total += difference * difference
            found[i, j] = difference * scale[0]
            sums[j] += found[i, j]
    return total / found.size


@compiled
def _slopes_of_weighted_squares(found: Floats, y: Floats, weights: Floats, sums: Floats) -> float:
    """As `_slopes_of_squares`, of squares by `weights` (n, k, k), in mean over rows."""
    total, n = 0.0, found.shape[0]
    difference = np.zeros(found.shape[1])
    for i in range(n):
        for j in range(found.shape[1]):
            difference[j] = 0.0 if math.isnan(y[i, j]) else found[i, j] - y[i, j]
        for j in range(found.shape[1]):
            pull = 0.0
            for m in range(found.shape[1]):
                pull += weights[i, j, m] * difference[m]
            total += difference[j] * pull
            found[i, j] = 0.0 if math.isnan(y[i, j]) else 2.0 * pull / n
            sums[j] += found[i, j]
    return float(total / n)


@compiled
def _through_logistic(delta: Floats, hidden: Floats, sums: Floats) -> None:
    """Multiply slopes (n, units) by that of the function that gave `hidden`; add up (units,)."""
    for i in range(delta.shape[0]):
        for j in range(delta.shape[1]):
            delta[i, j] *= hidden[i, j] - hidden[i, j] * hidden[i, j]
            sums[j] += delta[i, j]


def _penalised(
    more: Penalties, weight: Floats, bias: Floats, gradient: Layers, layer: int
) -> float:
    """Penalty on weights and biases of a layer, added to the gradient as well."""
    gradient.weights[layer][:] += more.weights * np.sign(weight)
    gradient.biases[layer][:] += (2.0 * more.biases) * bias
    return more.weights * float(np.abs(weight).sum()) + more.biases * float(np.vdot(bias, bias))


def forward(layers: Layers, X: Floats) -> list[Floats]:
    """Activations of every layer, input first, output last."""
    activations = [X]
    last = len(layers.weights) - 1
    for layer, (weight, bias) in enumerate(zip(layers.weights, layers.biases, strict=True)):
        # The logistic function by way of tanh of half, which numpy computes ten times faster than
        # scipy's expit; halving the weights costs less than halving what they give.
        half = 0.5 if layer < last else 1.0
        units = activations[-1] @ (half * weight)
        _add_to_rows(units, half * bias)
        if layer < last:
            np.tanh(units, out=units)
            _lift(units, units.dtype.type(0.5))
        activations.append(units)
    return activations


@compiled
def _add_to_rows(values: Floats, row: Floats) -> None:
    """Add a row (k,) to values (n, k); numpy takes five times as long for so short a one."""
    for i in range(values.shape[0]):
        for j in range(values.shape[1]):
            values[i, j] += row[j]


@compiled
def _lift(values: Floats, half: float) -> None:
    """Make a logistic function of tanh, in one pass; a `half` of the values' own precision."""
    for i in range(values.shape[0]):
        for j in range(values.shape[1]):
            values[i, j] = half * values[i, j] + half


class Adam:
    """Adam (Kingma and Ba, 2014) on one flat vector, in place."""

    def __init__(self, values: Floats, learning_rate: float) -> None:
        self._values = values.reshape(-1, copy=False)  # raises where it would be a copy
        self.learning_rate = learning_rate
        self._first, self._second = np.zeros((2, values.size), values.dtype)
        self._steps = 0

    def step(self, gradient: Floats) -> None:
        """Move the values one step down `gradient`."""
        self._steps += 1
        # With the bias corrections folded into the step and epsilon beside the uncorrected root, as
        # in section 2 of the paper on Adam, in Keras and in scikit-learn.
        root = math.sqrt(1.0 - SECOND_DECAY**self._steps)
        rate = self.learning_rate * root / (1.0 - FIRST_DECAY**self._steps)
        factors = np.array(  # of the values' precision, which each step keeps
            [FIRST_DECAY, 1.0 - FIRST_DECAY, SECOND_DECAY, 1.0 - SECOND_DECAY, EPSILON, rate],
            self._values.dtype,
        )
        _descend(self._values, gradient.ravel(), self._first, self._second, factors)


@compiled
def _descend(
    values: Floats, gradient: Floats, first: Floats, second: Floats, factors: Floats
) -> None:
    """Take a step of Adam: both decays, each with what is left to 1, epsilon and the rate."""
    for i in range(values.shape[0]):
        first[i] = factors[0] * first[i] + factors[1] * gradient[i]
        second[i] = factors[2] * second[i] + factors[3] * (gradient[i] * gradient[i])
        values[i] -= factors[5] * (first[i] / (np.sqrt(second[i]) + factors[4]))


def check_loss(history: list[float], epochs: int, learning_rate: float) -> None:
    """Raise CalibrationError if the loss of the last of the epochs so far is out of bounds."""
    if not math.isfinite(history[-1]):
        raise CalibrationError(
            f"training diverged in epoch {len(history)} of {epochs} at learning rate "
            f"{learning_rate:g}; lower the learning rate"
        )
