"""What a corrector is told between samples: the homing, an offset, that the zero is right."""

from __future__ import annotations

from typing import Final

from truejoint.array_types import Array, Integers
from truejoint.compiled import compiled, fill, vector
from truejoint.runtime import fields as at
from truejoint.runtime.correction import forget
from truejoint.runtime.status import Status

_NOT_HOMED: Final = int(Status.NOT_HOMED)
_HOMED_AGAIN: Final = int(Status.HOMED_AGAIN)


@compiled
def acknowledge(numbers: Integers, memory: Array) -> None:
    """Let the zero count as right, and parity at the next sample."""
    numbers[at.SUSPECT] = 0
    numbers[at.ANCHOR] = 1
    memory[at.PARITY_T] = memory[at.T]


@compiled
def trust(numbers: Integers, memory: Array) -> None:
    """Let the zero count as that of the training, and parity hold as it did there."""
    numbers[at.SUSPECT] = 0
    numbers[at.ANCHOR] = 0
    n_parity = numbers[at.N_PARITY]
    fill(vector(memory, numbers[at.PARITY_SHIFT], n_parity), n_parity, 0.0)


@compiled
def tell_homing(numbers: Integers, memory: Array) -> int:
    """Take over what is told of the homing; the status bits that samples have from now on.

    Reads `IS_HOMED` and `TOLD_ID`. Where positions may have moved, the offset ends and the history
    starts anew: a homing that was left is another one when it is told again.
    """
    homing, homing_id, told = numbers[at.HOMING], numbers[at.HOMING_ID], numbers[at.TOLD_ID]
    if numbers[at.IS_HOMED] == 0:
        numbers[at.WAS_LOST] = 1
        numbers[at.HOMING_ID] = at.HOMING_UNKNOWN
        numbers[at.HOMING] = _NOT_HOMED
    else:
        if told != at.HOMING_UNKNOWN:
            if numbers[at.OWN_ID] == at.HOMING_UNKNOWN:
                numbers[at.OWN_ID] = told
            is_rezeroed = numbers[at.REZEROED] != 0 and told == homing_id
            fits = told < 0 or told == numbers[at.OWN_ID] or is_rezeroed
            numbers[at.WAS_LOST] = 0 if fits else 1
            numbers[at.HOMING_ID] = told
        numbers[at.HOMING] = _HOMED_AGAIN if numbers[at.WAS_LOST] else 0
    if numbers[at.HOMING] != homing or numbers[at.HOMING_ID] != homing_id:
        numbers[at.REZEROED] = 0
        n = numbers[at.N_JOINTS]
        fill(vector(memory, numbers[at.OFFSET], n), n, 0.0)
        forget(numbers, memory)
        trust(numbers, memory)
    if numbers[at.ZEROED] and numbers[at.HOMING] == 0:
        numbers[at.REZEROED] = 1
    return int(numbers[at.HOMING])


@compiled
def accept_offset(numbers: Integers, memory: Array) -> int:
    """Let the offset be that of the present homing; status bits as of `tell_homing`."""
    if numbers[at.HOMING] != _NOT_HOMED:
        numbers[at.WAS_LOST] = 0
        numbers[at.REZEROED] = 1
        numbers[at.HOMING] = 0
    acknowledge(numbers, memory)
    return int(numbers[at.HOMING])
