"""The filter of a wrist's cables, and plays that learn what it leaves.

The plays are of the filter's estimate, of the motors and of their efforts. What the filter says of
its own accuracy stays, as far as it was then found to hold.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from truejoint.array_types import Array, Integers
from truejoint.compiled import compiled, unrolled
from truejoint.estimators import hybrid
from truejoint.estimators.cables import run as cable_filter
from truejoint.estimators.cables.loops import LOAD, PIN, RIGID, N
from truejoint.estimators.cables.run import raw_joints
from truejoint.filters.fields import unpack_filter
from truejoint.layout import part_memory, part_numbers

SEEN: Final = 6 * N
"""What plays see: raw joints, motors, efforts, what the filter adds to the joints, loads, pins."""
TOLD: Final = 2 * N
"""What they tell: joints less raw joints, and loads."""


def sight(X: Array, angle: Array, states: Array, parameters: Array) -> Array:
    """Give what plays see (n, SEEN) of motors and efforts `X` (n, 2 N).

    With the filter's joints `angle` (n, N) and states (n, STATES).
    """
    raw = raw_rows(X, parameters)
    return np.hstack([raw, X, angle - raw, states[:, LOAD:], states[:, PIN:LOAD]])


def raw_rows(X: Array, parameters: Array) -> Array:
    """Joints (n, N) [rad] of cables that give nowhere, of motors in the first columns of `X`."""
    return X[:, :N] @ parameters[RIGID : RIGID + N * N].reshape(N, N).T


@compiled
def take_sight(
    numbers: Integers, memory: Array, _dt: float, x: Array, out: Array, inputs: Array
) -> None:
    """Fill `inputs` (SEEN,) as `sight`; the plays add to raw joints and to loads of nothing."""
    sizes = part_numbers(numbers, hybrid.FILTER)
    state = part_memory(numbers, memory, hybrid.FILTER)
    inner = part_numbers(sizes, cable_filter.FILTER)
    f = unpack_filter(inner, part_memory(sizes, state, cable_filter.FILTER))
    raw_joints(x, f.theta, inputs)
    for j in range(N):
        inputs[N + j], inputs[2 * N + j] = x[j], x[N + j]
        inputs[3 * N + j] = out[j] - inputs[j]
        inputs[4 * N + j], inputs[5 * N + j] = f.x[LOAD + j], f.x[PIN + j]
        out[j] = inputs[j]
    for j in range(unrolled(N)):
        state[sizes[cable_filter.GRIP + j]] = 0.0


FAMILY: Final = hybrid.hybrid_family(
    "cables.hybrid_rows", cable_filter.FAMILY, take_sight, "grip", lambda _params: (SEEN, TOLD)
)
