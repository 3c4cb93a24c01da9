"""Linear models for the unscented filter, whose functions are compiled once for all of them."""

import numpy as np
from numba import njit

from truejoint.filters import StateSpaceModel


@njit(cache=True, error_model="numpy")
def transition(x, u, _dt, parameters, out):
    """A x + B u, with A and B row by row at the head of the parameters."""
    n, p = len(x), len(u)
    for i in range(n):
        out[i] = 0.0
        for j in range(n):
            out[i] += parameters[i * n + j] * x[j]
        for j in range(p):
            out[i] += parameters[n * n + i * p + j] * u[j]


@njit(cache=True, error_model="numpy")
def measurement(x, u, parameters, out):
    """C x, with C after A and B."""
    n = len(x)
    for i in range(len(out)):
        out[i] = 0.0
        for j in range(n):
            out[i] += parameters[n * (n + len(u)) + i * n + j] * x[j]


def linear_model(A, B, C, Q, R, **options) -> StateSpaceModel:
    """x[k] = A x[k-1] + B u[k] + w, z[k] = C x[k] + v, with names x0, u0, z0, ...."""
    (m, n), p = np.shape(C), np.shape(B)[1]
    return StateSpaceModel(
        transition, measurement, Q, R,
        states=tuple(f"x{i}" for i in range(n)), measurements=tuple(f"z{i}" for i in range(m)),
        inputs=tuple(f"u{i}" for i in range(p)),
        parameters=np.concatenate([np.ravel(part).astype(float) for part in (A, B, C)]), **options,
    )  # fmt: skip
