"""The project's best for a jaw: both sides while they agree, the reset cable alone under a load."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from truejoint.compiled import compiled
from truejoint.estimators.base import Progress
from truejoint.estimators.jaw import MOTOR, RESET, JawEstimator
from truejoint.estimators.play import BankMemory, BothPlay, ResetPlay
from truejoint.models.jaw_kernels import redescending

Array = NDArray[np.float64]


@compiled
def _blend(reset: Array, both: Array, gate: float, out: Array) -> None:
    for i in range(reset.shape[0]):
        out[i] = reset[i] + redescending(both[i] - reset[i], gate)


@dataclass
class GatedMemory:
    """Memories of the two estimates."""

    reset: BankMemory
    both: BankMemory


class GatedPlay(JawEstimator):
    """`ResetPlay` corrected by `BothPlay` as far as the two agree.

    Without a load both see the same jaw, and their difference stays within a few times what it was
    in calibration; the estimate from both sides is then the better one. A load stretches the drive
    cable, which only that one mistakes for a motion of the jaw: the difference grows, and the
    estimate goes over, without a jump, to the reset cable's.

    Parameters
    ----------
    gate : float
        How many times the difference's RMS in calibration still counts as agreement.
    smallest_gate : float
        Difference that always does [rad].
    """

    family: ClassVar[str] = "play_gated"
    inputs: ClassVar[tuple[str, ...]] = (MOTOR, RESET)

    def __init__(self, gate: float = 5.0, smallest_gate: float = 9e-4) -> None:
        self.gate = gate
        self.smallest_gate = smallest_gate

    @property
    def gate_angle(self) -> float:
        """Difference between the two estimates that still counts as agreement [rad]."""
        return float(self.gate_angle_[0])

    def differences(self, X: Array, steps: Array) -> Array:
        """Give what the estimate from both sides adds to the reset cable's (n,) [rad]."""
        reset = self.reset_.evaluate(X[:, 1:], steps)
        return np.asarray((self.both_.evaluate(X, steps) - reset)[:, 0])

    def to_arrays(self) -> dict[str, Array]:
        """Both estimates' arrays, and the gate (1,) [rad]."""
        return {
            **{f"reset_{name}": array for name, array in self.reset_.to_arrays().items()},
            **{f"both_{name}": array for name, array in self.both_.to_arrays().items()},
            "gate_angle": self.gate_angle_,
        }

    def _set_arrays(self, arrays: Mapping[str, Array]) -> None:
        def part(name: str) -> dict[str, Array]:
            return {k.removeprefix(name): a for k, a in arrays.items() if k.startswith(name)}

        self.reset_ = ResetPlay.from_arrays(
            ResetPlay().get_params(), part("reset_"), n_features=1, n_outputs=1
        )
        self.both_ = BothPlay.from_arrays(
            BothPlay().get_params(), part("both_"), n_features=2, n_outputs=1
        )
        self.gate_angle_ = arrays["gate_angle"]

    def evaluate(self, X: Array, steps: Array | None = None) -> Array:
        """Jaw angle (n, 1) [rad] for rows `X` (n, 2) in the order of time."""
        reset = self.reset_.evaluate(X[:, 1:], steps)
        both = self.both_.evaluate(X, steps)
        out = np.empty(len(X))
        _blend(reset[:, 0], both[:, 0], self.gate_angle, out)
        return out[:, None]

    def start(self) -> GatedMemory:
        """Memory before the first row."""
        return GatedMemory(self.reset_.start(), self.both_.start())

    def step(self, state: GatedMemory, interval: float, row: Array) -> Array:
        """Jaw angle (1,) [rad] of one row; see `SequenceRegressor.step`."""
        reset = self.reset_.step(state.reset, interval, row[1:])
        both = self.both_.step(state.both, interval, row)
        return np.array([reset[0] + redescending(both[0] - reset[0], self.gate_angle)])

    def _fit_jaw(
        self, X: Array, y: Array, steps: Array, known: NDArray[np.bool_], progress: Progress
    ) -> None:
        self.reset_ = ResetPlay().fit(X[:, 1:], y, steps=steps)
        progress(0.4)
        self.both_ = BothPlay().fit(X, y, steps=steps)
        progress(0.8)
        spread = float(np.sqrt(np.mean(self.differences(X, steps)[known] ** 2)))
        self.gate_angle_ = np.array([max(self.gate * spread, self.smallest_gate)])
