"""What a corrector says about a sample, as bits of one number: the loop itself raises nothing."""

from enum import IntFlag
from typing import Final

from truejoint.toml_file import shipped_table


class _Bits(IntFlag):
    """Bits whose meanings stand in a table."""

    @property
    def words(self) -> str:
        """Meaning of each bit, for a person; empty for 0."""
        return "; ".join(_MEANINGS[str(bit.name)] for bit in self)


class Unlearnt(_Bits):
    """How the motion is unlike the training's, as bits of one number; 0 where it is not.

    It is a warning beside the status: the sample is corrected. docs/status.md says what is seen.

    Examples
    --------
    >>> Unlearnt(6).name, Unlearnt.SLOWER.words
    ('SLOWER|SWING', 'the arm moves slower than in training')
    """

    LEARNT = 0
    FASTER = 1
    SLOWER = 2
    SWING = 4


class Status(_Bits):
    """Bits of the status of one sample; 0 means that its position is corrected.

    With any bit set the half-width is infinite, and the position is what `OnFault` says.
    docs/status.md says what is seen, what happens and when it recovers.

    Examples
    --------
    >>> Status(80).name, Status.STALE.words
    ('SPIKE|OUT_OF_RANGE', 'the stamp is that of the last sample or an older one')
    """

    OK = 0
    NOT_FINITE = 1
    WRONG_SIZE = 2
    STALE = 4
    TIME_JUMP = 8
    SPIKE = 16
    FROZEN = 32
    OUT_OF_RANGE = 64
    OUT_OF_DOMAIN = 128
    IMPLAUSIBLE = 256
    NOT_HOMED = 512
    HOMED_AGAIN = 1024
    ZERO_SUSPECT = 2048
    OTHER_THREAD = 4096


_MEANINGS: Final = shipped_table(__package__, "status.toml")
