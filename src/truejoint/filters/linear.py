"""Linear state-space models, and their exact discretisation."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from truejoint.array_types import Array
from truejoint.compiled import compiled, inlined, matrix
from truejoint.filters.sigma_points import FilterError
from truejoint.filters.state_space import StateSpaceModel, check_covariance


@inlined
def _add_row(total: float, A: Array, i: int, x: Array) -> float:
    # The sum stays in a register: through memory each term would wait for the one before.
    for j in range(len(x)):
        total += A[i, j] * x[j]
    return total


@compiled
def linear_transition(x: Array, u: Array, dt: float, parameters: Array, out: Array) -> None:
    """Next state A x + B u, with A and B row by row at the head of the parameters."""
    n, p = len(x), len(u)
    A, B = matrix(parameters, 0, n, n), matrix(parameters, n * n, n, p)
    for i in range(n):
        out[i] = _add_row(_add_row(0.0, A, i, x), B, i, u)


@compiled
def linear_measurement(x: Array, u: Array, parameters: Array, out: Array) -> None:
    """Measurement C x, with C after A and B in the parameters."""
    n, m = len(x), len(out)
    C = matrix(parameters, n * (n + len(u)), m, n)
    for i in range(m):
        out[i] = _add_row(0.0, C, i, x)


@compiled
def linear_measurement_with_input(x: Array, u: Array, parameters: Array, out: Array) -> None:
    """Measurement C x + D u, with C and D after A and B in the parameters."""
    n, p, m = len(x), len(u), len(out)
    linear_measurement(x, u, parameters, out)
    D = matrix(parameters, n * (n + p) + m * n, m, p)
    for i in range(m):
        out[i] = _add_row(out[i], D, i, u)


def linear_model(
    A: npt.ArrayLike,
    B: npt.ArrayLike,
    C: npt.ArrayLike,
    D: npt.ArrayLike,
    process_noise: npt.ArrayLike,
    measurement_noise: npt.ArrayLike,
    *,
    states: tuple[str, ...],
    measurements: tuple[str, ...],
    inputs: tuple[str, ...] = (),
    angles: tuple[str, ...] = (),
) -> StateSpaceModel:
    """Model x[k] = A x[k-1] + B u[k] + w, z[k] = C x[k] + D u[k] + v, for steps of one length.

    Its functions are compiled once for all linear models.

    Parameters
    ----------
    A, B, C, D : (n, n), (n, p), (m, n), (m, p) array_like
        Matrices of the discrete system; see `discretise` for a continuous one.
    process_noise, measurement_noise : (n, n), (m, m) array_like
        Covariances of w and v; see `van_loan`.
    states, measurements, inputs, angles : tuple of str
        Names, as in `StateSpaceModel`.

    Raises
    ------
    FilterError
        If a shape does not fit the names, or a number is not finite.

    Examples
    --------
    >>> model = linear_model(
    ...     [[1.0]], [[]], [[1.0]], [[]], [[0.1]], [[1.0]], states=("x",), measurements=("z",)
    ... )
    >>> model.measurements
    ('z',)
    """
    n, m, p = len(states), len(measurements), len(inputs)
    parts = []
    for name, value, shape in zip(
        "ABCD", (A, B, C, D), ((n, n), (n, p), (m, n), (m, p)), strict=True
    ):
        part = np.array(value, dtype=np.float64)
        if part.shape != shape or not np.all(np.isfinite(part)):
            raise FilterError(f"{name}: shape is {part.shape}, must be {shape} of finite numbers")
        parts.append(part.ravel())
    return StateSpaceModel(
        linear_transition,
        linear_measurement_with_input if parts[3].any() else linear_measurement,
        process_noise,
        measurement_noise,
        states=states,
        measurements=measurements,
        inputs=inputs,
        parameters=np.concatenate(parts),
        angles=angles,
    )


def discretise(A: npt.ArrayLike, B: npt.ArrayLike, dt: float) -> tuple[Array, Array]:
    """Exact discretisation of dx/dt = A x + B u with u constant over a step.

    Returns exp(A dt) (n, n), and the integral of exp(A s) B (n, p) over 0 <= s <= dt: (13) to (14)
    of yan2020.

    Parameters
    ----------
    A : (n, n) array_like
        System matrix.
    B : (n, p) array_like
        Input matrix.
    dt : float
        Step [s], not negative.

    Raises
    ------
    FilterError
        If shapes or numbers are wrong.

    Examples
    --------
    >>> F, G = discretise([[0.0]], [[1.0]], 0.5)
    >>> float(G[0, 0])
    0.5
    """
    from scipy.linalg import expm  # noqa: PLC0415  # a control loop needs none of it

    system, step = _check_system(A, dt)
    inputs = np.array(B, dtype=np.float64)
    n = len(system)
    if inputs.ndim != 2 or len(inputs) != n or not np.all(np.isfinite(inputs)):
        raise FilterError(f"B: shape is {inputs.shape}, must be {n} rows of finite numbers")
    p = inputs.shape[1]
    both = np.zeros((n + p, n + p))
    both[:n, :n], both[:n, n:] = system * step, inputs * step
    exponential = expm(both)
    return exponential[:n, :n], exponential[:n, n:]


def van_loan(A: npt.ArrayLike, density: npt.ArrayLike, dt: float) -> tuple[Array, Array]:
    """Exact transition matrix and covariance of white noise acting on dx/dt = A x + w.

    Returns F = exp(A dt), and Q = integral of exp(A s) density exp(A s)' over 0 <= s <= dt, both
    (n, n).

    Van Loan (IEEE Transactions on Automatic Control 23(3), 1978) over a step short enough for
    exp(-A dt) to be harmless, then Q(2h) = Q(h) + F Q(h) F' until the whole step is covered, in
    balanced coordinates: stiff cables and slow sampling cost no digits.

    Parameters
    ----------
    A : (n, n) array_like
        System matrix.
    density : (n, n) array_like
        Spectral density of w, its covariance per second.
    dt : float
        Step [s], not negative.

    Raises
    ------
    FilterError
        If shapes or numbers are wrong.

    Examples
    --------
    >>> F, Q = van_loan([[0.0]], [[2.0]], 0.5)
    >>> float(Q[0, 0])
    1.0
    """
    from scipy.linalg import expm, matrix_balance  # noqa: PLC0415  # as in `discretise`

    system, step = _check_system(A, dt)
    n = len(system)
    noise = check_covariance(density, n, "spectral density")
    balanced, (scale, _) = matrix_balance(system, permute=False, separate=True)
    noise = noise / np.outer(scale, scale)
    size = float(np.linalg.norm(balanced, 1)) * step
    halvings = max(0, int(np.ceil(np.log2(size)))) if size > 0.0 else 0
    h = step / 2.0**halvings
    both = np.zeros((2 * n, 2 * n))
    both[:n, :n], both[:n, n:], both[n:, n:] = -balanced * h, noise * h, balanced.T * h
    exponential = expm(both)
    transition = exponential[n:, n:].T
    covariance = transition @ exponential[:n, n:]
    for _ in range(halvings):
        covariance = covariance + transition @ covariance @ transition.T
        transition = transition @ transition
    covariance = 0.5 * (covariance + covariance.T)
    back = np.outer(scale, scale)
    return transition * np.outer(scale, 1.0 / scale), covariance * back


def _check_system(A: npt.ArrayLike, dt: float) -> tuple[Array, float]:
    system = np.array(A, dtype=np.float64)
    if system.ndim != 2 or system.shape[0] != system.shape[1] or not np.all(np.isfinite(system)):
        raise FilterError(f"A: shape is {system.shape}, must be a square of finite numbers")
    if not (np.isfinite(dt) and dt >= 0.0):
        raise FilterError(f"dt is {dt}: give a finite time step of 0 s or more")
    return system, float(dt)
