"""Jaw angle by banks of play operators (Prandtl-Ishlinskii): hysteresis as a linear regression.

The reset cable's end follows the jaw but for the slider's friction, a hysteresis in ``x2`` itself;
the motor's side differs from the jaw by the jaw's friction and by whatever load stretches the
drive cable. So an estimate from ``x2`` alone hardly knows about loads, and one from both is more
accurate as long as there is none.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from truejoint.estimators.base import Progress, standardisation
from truejoint.estimators.jaw import DRIVE, MOTOR, RESET, JawEstimator
from truejoint.estimators.sequence import regular_steps
from truejoint.models import jaw_kernels as kernels
from truejoint.models.play_banks import (
    MOTOR_WIDTHS,
    POWERS,
    RESET_WIDTHS,
    Bank,
    count_columns,
    product_pairs,
)
from truejoint.robots.forceps_mechanism import TABLE_1

Array = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class RidgeFit:
    """Linear model of standardised columns: the mean, and a weight and a mean for each column."""

    mean: Array
    inverse_scale: Array
    coef: Array
    constant: float

    @property
    def weights(self) -> tuple[Array, float]:
        """Weights (k,) of the columns as they are, and the constant that goes with them."""
        weights = self.coef * self.inverse_scale
        return weights, self.constant - float(weights @ self.mean)


def ridge(columns: Array, y: Array, penalty: float) -> RidgeFit:
    """Ridge regression on standardised columns (n, k); the constant is not penalised."""
    mean, inverse = standardisation(columns)
    scaled = (columns - mean) * inverse
    constant = float(y.mean())
    left = scaled.T @ scaled / len(y) + penalty * np.eye(scaled.shape[1])
    coef = np.linalg.solve(left, scaled.T @ (y - constant) / len(y))
    return RidgeFit(mean, inverse, np.asarray(coef, dtype=np.float64), constant)


@dataclass
class BankMemory:
    """Outputs of the plays on each displacement, and room for one row of columns."""

    plays: tuple[Array, ...]
    row: Array


class _PlayRegression(JawEstimator):
    """Ridge regression on banks of one or two displacements."""

    degree: int
    penalty: float

    @abstractmethod
    def displacements(self, X: Array) -> tuple[Array, ...]:
        """Displacements (n,) [m] that have a bank each."""

    @property
    @abstractmethod
    def _widths(self) -> tuple[Array, ...]:
        """Half-widths of each bank."""

    def columns(self, X: Array, steps: Array) -> Array:
        """Columns (n, k) of the regression."""
        values = self.displacements(X)
        banks = self._banks()
        blocks = [bank.compute(v, steps) for bank, v in zip(banks, values, strict=True)]
        products = np.empty((len(X), sum(len(widths) // 2 for widths in self._widths)))
        kernels.product_rows(np.hstack(blocks), self._pairs, products)
        return np.ascontiguousarray(np.hstack([*blocks, products]))

    def to_arrays(self) -> dict[str, Array]:
        """Inverse largest displacements [1/m], weights (k,) and constant (1,) [rad]."""
        return {"scale": self.scale_, "weights": self.weights_, "constant": self.constant_}

    def _set_arrays(self, arrays: Mapping[str, Array]) -> None:
        self.scale_ = arrays["scale"]
        self.weights_ = arrays["weights"]
        self.constant_ = arrays["constant"]

    def evaluate(self, X: Array, steps: Array | None = None) -> Array:
        """Jaw angle (n, 1) [rad] for rows `X` (n, k) in the order of time."""
        out = np.empty(len(X))
        kernels.weighted_rows(
            self.columns(X, regular_steps(len(X)) if steps is None else steps), self.weights_, out
        )
        return np.asarray((out + self.constant_[0])[:, None])

    def start(self) -> BankMemory:
        """Memory before the first row."""
        return BankMemory(tuple(np.zeros(len(w)) for w in self._widths), np.empty(self._count()))

    def step(self, state: BankMemory, interval: float, row: Array) -> Array:
        """Jaw angle (1,) [rad] of one row; see `SequenceRegressor.step`."""
        first = 0
        for bank, plays, value in zip(
            self._banks(), state.plays, self.displacements(row[None]), strict=True
        ):
            block = state.row[first : first + bank.size]
            kernels.bank_row(
                interval == 0.0, value[0], bank.scale, bank.degree, bank.widths, plays, block
            )
            first += bank.size
        kernels.product_row(state.row, self._pairs, state.row[first:])
        return np.array([kernels.weighted(state.row, self.weights_) + self.constant_[0]])

    def _banks(self) -> tuple[Bank, ...]:
        return tuple(
            Bank(float(scale), int(self.degree), widths)
            for scale, widths in zip(self.scale_, self._widths, strict=True)
        )

    def _count(self) -> int:
        return count_columns(int(self.degree), [len(widths) for widths in self._widths])

    @property
    def _pairs(self) -> Integers:
        return product_pairs(int(self.degree), [len(widths) for widths in self._widths])

    def _fit_jaw(
        self, X: Array, y: Array, steps: Array, known: NDArray[np.bool_], progress: Progress
    ) -> None:
        self.scale_ = np.array([1.0 / np.abs(v).max() for v in self.displacements(X)])
        fit = ridge(self.columns(X, steps)[known], y[known], float(self.penalty))
        progress(0.9)
        self.weights_, constant = fit.weights
        self.constant_ = np.array([constant])


class ResetPlay(_PlayRegression):
    """Jaw angle from the reset cable alone: powers of ``x2`` and plays on it.

    Parameters
    ----------
    degree : int
        Highest power of ``x2``, 1 to 8.
    reset_widths : tuple of float
        Half-widths of the plays on ``x2`` [m].
    penalty : float
        Ridge on the standardised columns.
    """

    family: ClassVar[str] = "play_reset"
    inputs: ClassVar[tuple[str, ...]] = (RESET,)

    def __init__(
        self,
        degree: int = POWERS,
        reset_widths: tuple[float, ...] = RESET_WIDTHS,
        penalty: float = 1e-5,
    ) -> None:
        self.degree = degree
        self.reset_widths = reset_widths
        self.penalty = penalty

    def displacements(self, X: Array) -> tuple[Array, ...]:
        """``x2`` (n,) [m]."""
        return (X[:, self.inputs.index(RESET)],)

    @property
    def _widths(self) -> tuple[Array, ...]:
        return (np.array(self.reset_widths, dtype=np.float64),)


class BothPlay(_PlayRegression):
    """Jaw angle from both sides: powers of and plays on ``x2`` and ``x1``, which is the motor's.

    The most accurate of all without a load, and wrong under one.

    Parameters
    ----------
    degree : int
        Highest power of ``x2`` and ``x1``, 1 to 8.
    reset_widths, motor_widths : tuple of float
        Half-widths of the plays on ``x2`` and on ``x1`` [m].
    penalty : float
        Ridge on the standardised columns.
    gear_ratio, wheel_radius : float
        ``z_i`` and ``R`` [m], which turn the motor's angle into ``x1``: (2), (3).
    """

    family: ClassVar[str] = "play_both"
    inputs: ClassVar[tuple[str, ...]] = (MOTOR, RESET)

    def __init__(
        self,
        degree: int = POWERS,
        reset_widths: tuple[float, ...] = RESET_WIDTHS,
        motor_widths: tuple[float, ...] = MOTOR_WIDTHS,
        penalty: float = 1e-5,
        gear_ratio: float = TABLE_1.gear_ratio,
        wheel_radius: float = TABLE_1.wheel_radius,
    ) -> None:
        self.degree = degree
        self.reset_widths = reset_widths
        self.motor_widths = motor_widths
        self.penalty = penalty
        self.gear_ratio = gear_ratio
        self.wheel_radius = wheel_radius

    def displacements(self, X: Array) -> tuple[Array, ...]:
        """``x2`` and ``x1`` (n,) [m]."""
        drive = X[:, self.inputs.index(MOTOR)] * (self.wheel_radius / self.gear_ratio)
        return X[:, self.inputs.index(RESET)], drive

    @property
    def _widths(self) -> tuple[Array, ...]:
        return (
            np.array(self.reset_widths, dtype=np.float64),
            np.array(self.motor_widths, dtype=np.float64),
        )


class MotorPlay(_PlayRegression):
    """Jaw angle from the motor alone: powers of and plays on ``x1``, with no sensor on a cable.

    What the strategy without sensors of yan2020, II-B, can reach. Parameters as `BothPlay`.
    """

    family: ClassVar[str] = "play_motor"
    inputs: ClassVar[tuple[str, ...]] = (MOTOR,)

    def __init__(
        self,
        degree: int = POWERS,
        motor_widths: tuple[float, ...] = MOTOR_WIDTHS,
        penalty: float = 1e-5,
        gear_ratio: float = TABLE_1.gear_ratio,
        wheel_radius: float = TABLE_1.wheel_radius,
    ) -> None:
        self.degree = degree
        self.motor_widths = motor_widths
        self.penalty = penalty
        self.gear_ratio = gear_ratio
        self.wheel_radius = wheel_radius

    def displacements(self, X: Array) -> tuple[Array, ...]:
        """``x1`` (n,) [m] by the motor's angle: (2), (3)."""
        return (X[:, 0] * (self.wheel_radius / self.gear_ratio),)

    @property
    def _widths(self) -> tuple[Array, ...]:
        return (np.array(self.motor_widths, dtype=np.float64),)


class CablesPlay(_PlayRegression):
    """Jaw angle from the encoders on both cables: powers of and plays on ``x2`` and ``x1``.

    Parameters as `BothPlay`, but for the motor's gear.
    """

    family: ClassVar[str] = "play_cables"
    inputs: ClassVar[tuple[str, ...]] = (DRIVE, RESET)

    def __init__(
        self,
        degree: int = POWERS,
        reset_widths: tuple[float, ...] = RESET_WIDTHS,
        drive_widths: tuple[float, ...] = MOTOR_WIDTHS,
        penalty: float = 1e-5,
    ) -> None:
        self.degree = degree
        self.reset_widths = reset_widths
        self.drive_widths = drive_widths
        self.penalty = penalty

    def displacements(self, X: Array) -> tuple[Array, ...]:
        """``x2`` and ``x1`` (n,) [m]."""
        return X[:, 1], X[:, 0]

    @property
    def _widths(self) -> tuple[Array, ...]:
        return (
            np.array(self.reset_widths, dtype=np.float64),
            np.array(self.drive_widths, dtype=np.float64),
        )
