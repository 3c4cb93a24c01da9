"""One step of the unscented filter and a whole record of steps, as compiled kernels."""

from __future__ import annotations

from truejoint.compiled import compiled
from truejoint.filters import memory as lay
from truejoint.filters.correction import correct
from truejoint.filters.memory import Array, Integers, borrow, copy, vector
from truejoint.filters.prediction import predict


@compiled
def step(numbers: Integers, memory: Array) -> int:
    """Advance the state in the memory by DT and correct it by the measurement in Z.

    Returns
    -------
    int
        Status bits, see `FilterStatus`.
    """
    lent_numbers, lent_memory = borrow(numbers), borrow(memory)
    status = predict(lent_numbers, lent_memory)
    return status | correct(lent_numbers, lent_memory)


@compiled
def run(
    numbers: Integers,
    memory: Array,
    z: Array,
    u: Array,
    dt: Array,
    states: Array,
    covariances: Array,
    innovations: Array,
    nis: Array,
    loglik: Array,
    inflation: Array,
    statuses: Integers,
) -> None:
    """Take one step for each row of a record; single steps give the same bits.

    Parameters
    ----------
    numbers, memory : arrays
        The filter's memory, left as it is after the last row.
    z, u, dt : (N, m), (N, inputs), (N,) array
        Measurements, control inputs and time steps [s].
    states, covariances, innovations : (N, n), (N, n * n), (N, m) array
        Filled.
    nis, loglik, inflation, statuses : (N,) array
        Filled.
    """
    n, m, inputs = numbers[lay.N], numbers[lay.M], numbers[lay.INPUTS]
    row_z = vector(memory, numbers[lay.Z], m)
    row_u = vector(memory, numbers[lay.U], inputs)
    x = vector(memory, numbers[lay.X], n)
    covariance = vector(memory, numbers[lay.P], n * n)
    innovation = vector(memory, numbers[lay.INNOVATION], m)
    for k in range(z.shape[0]):
        copy(z[k], row_z, m)
        copy(u[k], row_u, inputs)
        memory[lay.DT] = dt[k]
        statuses[k] = step(numbers, memory)
        copy(x, states[k], n)
        copy(covariance, covariances[k], n * n)
        copy(innovation, innovations[k], m)
        nis[k] = memory[lay.NIS]
        loglik[k] = memory[lay.LOGLIK]
        inflation[k] = memory[lay.INFLATION]
