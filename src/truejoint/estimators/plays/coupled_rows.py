"""Plays of joints whose cables pull at each other: friction in each, one stiffness of all.

Behind elastic cables each joint stands where its own friction holds it: it moves when the pull of
the cables, which is the stiffness of all joints times how far each is from where its motor wants
it, is larger than its friction. That is Moreau's sweeping process (Journal of Differential
Equations 26, 1977) in several dimensions; of one joint, or where no joint pulls at another, it is
the play of `truejoint.features.kernels`.
"""

from __future__ import annotations

from typing import Final

from truejoint.array_types import Array, Mask
from truejoint.compiled import compiled

SWEEPS: Final = 20  # over the joints, at most; four to seven are usual
SETTLED: Final = 1e-4  # by how much no joint moves any more in a sweep, in half ranges


@compiled
def coupled_play(
    coupling: Array,
    half_widths: Array,
    share: float,
    fresh: bool,
    values: Array,
    last: Array,
    deflections: Array,
) -> None:
    """Find how far the joints (k,) are from `values` (k,), where their motors want them.

    In `coupling` (k, k), row i is the stiffness between joint i and the others over its own, 0 on
    the diagonal; `half_widths` (k,), times `share`, are friction over that stiffness. `last` (k,)
    is where the joints are, and is brought up to date; a fresh start puts them where they are
    wanted. Joint after joint is moved as far as its friction lets the cables pull it
    (Gauss and Seidel), until none moves.
    """
    k = values.shape[0]
    for i in range(k):
        if fresh:
            last[i] = values[i]
        deflections[i] = last[i] - values[i]
    for _sweep in range(SWEEPS):
        largest = 0.0
        for i in range(k):
            centre = 0.0
            for j in range(k):
                centre -= coupling[i, j] * deflections[j]
            reach = share * half_widths[i]
            moved = min(max(last[i] - values[i], centre - reach), centre + reach)
            largest = max(largest, abs(moved - deflections[i]))
            deflections[i] = moved
        if largest < SETTLED:
            break
    for i in range(k):
        last[i] = values[i] + deflections[i]


@compiled
def coupled_play_rows(
    coupling: Array, half_widths: Array, fresh: Mask, values: Array, last: Array, out: Array
) -> None:
    """Deflections `out` (n, k) of rows `values` (n, k); a history starts where `fresh` (n,)."""
    for i in range(values.shape[0]):
        coupled_play(coupling, half_widths, 1.0, fresh[i], values[i], last, out[i])
