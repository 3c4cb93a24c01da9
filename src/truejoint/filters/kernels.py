"""One step of the unscented filter and a whole record of steps, as compiled kernels."""

from __future__ import annotations

from typing import Final

from truejoint.array_types import Array, Integers
from truejoint.compiled import borrow, compiled, copy, fill, vector
from truejoint.filters import fields as at
from truejoint.filters.correction import correct
from truejoint.filters.fields import call_step
from truejoint.filters.prediction import possible, predict
from truejoint.filters.status import FilterStatus

_RESTARTED: Final = int(FilterStatus.RESTARTED)


@compiled
def restart(numbers: Integers, memory: Array) -> None:
    """Put the filter back to where it stood before its first step."""
    n = numbers[at.N]
    size = n * n
    copy(vector(memory, numbers[at.X_PRIOR], n), vector(memory, numbers[at.X], n), n)
    copy(vector(memory, numbers[at.P_PRIOR], size), vector(memory, numbers[at.P], size), size)
    copy(vector(memory, numbers[at.S_PRIOR], size), vector(memory, numbers[at.S], size), size)
    if numbers[at.G] != 0:
        fill(vector(memory, numbers[at.Q], n * n), n * n, 0.0)
    numbers[at.REJECTED] = 0


@compiled
def step(numbers: Integers, memory: Array) -> int:
    """Advance the state in the memory by DT, correct it by the measurement in Z; status bits."""
    lent_numbers, lent_memory = borrow(numbers), borrow(memory)
    status = 0
    if memory[at.DT] > memory[at.LONGEST]:
        restart(lent_numbers, lent_memory)
        memory[at.DT] = 0.0
        status = _RESTARTED
    status |= predict(lent_numbers, lent_memory)
    status |= correct(lent_numbers, lent_memory)
    x = vector(lent_memory, numbers[at.X], numbers[at.N])
    if not possible(lent_numbers, lent_memory, x, numbers[at.N], 0):
        restart(lent_numbers, lent_memory)
        status |= _RESTARTED
    numbers[at.STATUS] = status
    return status


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

    Of measurements `z` (N, m), inputs `u` (N, inputs) and time steps `dt` (N,) [s]; the other
    arrays, a row for each of them, are filled.
    """
    n, m, inputs = numbers[at.N], numbers[at.M], numbers[at.INPUTS]
    row_z = vector(memory, numbers[at.Z], m)
    row_u = vector(memory, numbers[at.U], inputs)
    x = vector(memory, numbers[at.X], n)
    covariance = vector(memory, numbers[at.P], n * n)
    innovation = vector(memory, numbers[at.INNOVATION], m)
    for k in range(z.shape[0]):
        copy(z[k], row_z, m)
        copy(u[k], row_u, inputs)
        memory[at.DT] = dt[k]
        statuses[k] = call_step(numbers[at.ADVANCE], numbers, memory)
        copy(x, states[k], n)
        copy(covariance, covariances[k], n * n)
        copy(innovation, innovations[k], m)
        nis[k] = memory[at.NIS]
        loglik[k] = memory[at.LOGLIK]
        inflation[k] = memory[at.INFLATION]
