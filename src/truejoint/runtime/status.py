"""What a corrector says about a sample, as bits of one number: the loop itself raises nothing."""

from enum import IntFlag
from typing import Final


class Status(IntFlag):
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

    @property
    def words(self) -> str:
        """Meaning of each bit, for a person; empty for OK."""
        return "; ".join(_MEANINGS[bit] for bit in self)


_MEANINGS: Final = {
    Status.NOT_FINITE: "a signal, or the time stamp, is NaN or infinite",
    Status.WRONG_SIZE: "sample or stamp are not numbers, or not as many as the model has signals",
    Status.STALE: "the stamp is that of the last sample or an older one",
    Status.TIME_JUMP: (
        "the stamp is further from the last one than the history may bridge, or the model "
        "counts samples and they come slower than in training"
    ),
    Status.SPIKE: "a signal changed faster than it ever did in training",
    Status.FROZEN: (
        "a signal stands still, or nearly, while its joint moves, or all of them do for long"
    ),
    Status.OUT_OF_RANGE: "a feature lies outside its trained range",
    Status.OUT_OF_DOMAIN: (
        "each feature is in its range, but together they are unlike any trained row"
    ),
    Status.IMPLAUSIBLE: "the correction is larger than the errors seen in training",
    Status.NOT_HOMED: "nobody has said that the robot is homed: positions mean nothing",
    Status.HOMED_AGAIN: (
        "the robot was homed again: its positions are shifted against those of the calibration"
    ),
    Status.ZERO_SUSPECT: (
        "a measured position has jumped, or contradicts what else is known of the joint: its "
        "zero may have moved"
    ),
    Status.OTHER_THREAD: (
        "another thread has this corrector: nothing was done, its position is of another sample"
    ),
}
