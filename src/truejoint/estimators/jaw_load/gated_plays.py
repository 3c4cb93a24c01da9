"""Plays on both sides of a forceps, gated by how far they agree."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from truejoint.array_types import Array
from truejoint.estimators.base import Arrays, Flags, Progress
from truejoint.estimators.family import Family, evaluate
from truejoint.estimators.jaw.base import JawEstimator
from truejoint.estimators.jaw_load import gated
from truejoint.estimators.plays import jaw_bank
from truejoint.estimators.plays import run as plays
from truejoint.estimators.plays.jaw_plays import PENALTY, fit_bank


@dataclass(eq=False, repr=False, kw_only=True)
class GatedPlays(JawEstimator):
    """`JawPlays` on the reset cable, corrected by those on both sides as far as the two agree.

    Without a load both see the same jaw, and their difference stays within a few times what it was
    in calibration; the estimate from both sides is then the better one. A load stretches the drive
    cable, which only that one mistakes for a motion of the jaw: the difference grows, and the
    estimate goes over, without a jump, to the reset cable's. In the loop it states how far off it
    may be, which a load makes more.

    Parameters
    ----------
    gate : float
        How many times the difference's RMS in calibration still counts as agreement.
    smallest_gate : float
        Difference that always does [rad].
    plays : tuple of float
        Half-widths of the plays, as for `JawPlays`.

    Examples
    --------
    >>> GatedPlays(gate=4.0).name
    'play_gated'
    """

    family: ClassVar[Family] = gated.FAMILY
    gate: float = 3.0
    smallest_gate: float = 1.75e-3
    plays: tuple[float, ...] = jaw_bank.WIDTHS

    def _learn_jaw(
        self, X: Array, y: Array, dt: Array, has_truth: Flags, progress: Progress
    ) -> Arrays:
        widths, estimates = tuple(self.plays), {}
        arrays: Arrays = {}
        for side, k in gated.SIDES.items():
            rows = np.ascontiguousarray(X[:, -k:])
            learnt = fit_bank(widths, PENALTY, rows, y, dt, has_truth)
            memory = plays.pack(jaw_bank.bank(widths, k), learnt, k, 1)
            estimates[side] = evaluate(plays.FAMILY, memory, rows, dt, 1)[has_truth, 0]
            arrays |= {f"{side}/{name}": array for name, array in learnt.items()}
            progress(0.4 * k)
        both, reset = estimates["both"], estimates["reset"]
        misfit = [_rms(both - y[has_truth]), _rms(reset - y[has_truth])]
        return {
            **arrays,
            "gate": np.array([max(self.gate * _rms(both - reset), self.smallest_gate)]),
            "misfit": np.array(misfit),
        }


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
