"""A zero that moved between recordings, each seen from all the others."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from truejoint.array_types import Array
from truejoint.recordings.join.explained import Explained, robust_spread

_RIDGE: Final = 1e-2  # of the rows, for standardised columns: a recording left out may lie outside


@dataclass(frozen=True, eq=False)
class Zeros:
    """Median residuals of recordings, each by a model that was fitted to the others."""

    apart: Array  # (n,), each from what the others predict [rad or m]
    spread: float  # of a left-out recording's residual about its median, the median of all

    @property
    def offsets(self) -> Array:
        """Those about their median (n,): one that moved shifts what is predicted of the others."""
        return np.asarray(self.apart - np.median(self.apart))


def left_out_zeros(explained: Explained) -> Zeros:
    """Offset of each of two or more recordings from what the others, with one zero, predict."""
    inputs = [explained.scaled(s.inputs) for s in explained.samples]
    designs = [np.hstack([x, np.ones((len(x), 1))]) for x in inputs]
    pairs = list(zip(designs, explained.samples, strict=True))
    normal = np.array([(d * s.weights[:, None]).T @ d for d, s in pairs])
    right = np.array([d.T @ (s.weights * s.error) for d, s in pairs])
    all_normal, all_right = normal.sum(axis=0), right.sum(axis=0)
    medians, spreads = [], []
    for matrix, own_right, (design, sample) in zip(normal, right, pairs, strict=True):
        others = all_normal - matrix
        k = len(others) - 1
        others[np.arange(k), np.arange(k)] += _RIDGE * others[-1, -1]
        residual = sample.error - design @ np.linalg.solve(others, all_right - own_right)
        medians.append(float(np.median(residual)))
        spreads.append(robust_spread(residual))
    return Zeros(np.array(medians), float(np.median(spreads)))
