"""Newton's method for joint positions: every search for a pose or a point is this one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from truejoint.array_types import Array

_STEPS: Final = 100
_LONGEST_STEP: Final = 0.3  # [rad, m]


def newton(
    joint: Array,
    miss: Callable[[Array], Array],
    jacobian: Callable[[Array], Array],
    columns: Sequence[int],
    tolerance: float,
) -> Array:
    """Joint positions (m, n_joints) [rad or m] from which nothing is missed, if it finds any.

    Parameters
    ----------
    joint : ndarray, shape (m, n_joints)
        Starts of m searches, which go on side by side.
    miss : callable
        How far the tool is from its goal (m, k) [m, rad].
    jacobian : callable
        Slope of the tool's place (m, k, n_joints).
    columns : sequence of int
        Joints that move, the shortest way where there are more than k of them.
    tolerance : float
        Largest miss that ends the search [m, rad].
    """
    joint = joint.copy()
    for _ in range(_STEPS):
        error = miss(joint)
        if np.abs(error).max(initial=0.0) < tolerance:
            break
        inverse = np.linalg.pinv(jacobian(joint)[:, :, columns], rcond=1e-9)
        step = np.einsum("mij,mj->mi", inverse, error)
        largest = np.abs(step).max(axis=1, keepdims=True)
        joint[:, columns] += step * np.minimum(1.0, _LONGEST_STEP / np.maximum(largest, 1e-12))
    return joint
