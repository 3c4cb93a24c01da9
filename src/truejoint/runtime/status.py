"""What a corrector says about a sample, as bits of one number: the loop itself raises nothing."""

from __future__ import annotations

from enum import IntFlag


class Status(IntFlag):
    """Bits of the status of one sample; 0 means that its position is corrected.

    With any bit set the measured position passes through as it is, and its half-width is
    infinite. docs/status.md says what is seen, what happens and when it recovers.

    Examples
    --------
    >>> Status(80).name
    'SPIKE|OUT_OF_RANGE'
    """

    OK = 0
    NOT_FINITE = 1
    """A signal, or the time stamp, is NaN or infinite."""
    WRONG_SIZE = 2
    """Sample or stamp are not numbers, or not as many as the model has signals."""
    STALE = 4
    """The stamp is that of the last sample or an older one."""
    TIME_JUMP = 8
    """The stamp is further from the last one than the history may bridge."""
    SPIKE = 16
    """A signal changed faster than it ever did in training."""
    FROZEN = 32
    """A signal stands still, or nearly, while its joint moves, or all of them do for long."""
    OUT_OF_RANGE = 64
    """A feature lies outside its trained range."""
    OUT_OF_DOMAIN = 128
    """Each feature is in its range, but together they are unlike any trained row."""
    IMPLAUSIBLE = 256
    """The correction is larger than the errors seen in training."""
    NOT_HOMED = 512
    """Nobody has said that the robot is homed: positions mean nothing."""
    HOMED_AGAIN = 1024
    """The robot was homed again: its positions are shifted against those of the calibration."""
    ZERO_SUSPECT = 2048
    """A measured position has jumped, or contradicts what else is known of the joint: its zero may
    have moved."""
