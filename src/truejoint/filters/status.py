"""What a filter step did, as bits of one number: the loop itself raises nothing."""

from enum import IntFlag


class FilterStatus(IntFlag):
    """Bits of the status of one filter step; 0 means that everything in `z` was used.

    Whatever the bits, state and covariance stay finite and the covariance positive semidefinite.

    Examples
    --------
    >>> FilterStatus(6).name
    'PARTIAL|GATED'
    """

    OK = 0
    MISSING = 1
    """No measurement in this step (all NaN): predicted only."""
    PARTIAL = 2
    """Some components of the measurement are missing: the others were used."""
    GATED = 4
    """The NIS is above the gate: the measurement was left out."""
    REACQUIRED = 8
    """Gated too often in a row: the covariance was enlarged and the measurement used."""
    INVALID_INPUT = 16
    """dt is negative or not finite, or a control input is not possible: the state was held."""
    INVALID_MEASUREMENT = 32
    """A measurement is not possible: that component was treated as missing."""
    TRANSITION_FAILED = 64
    """The transition or the process noise gave NaN or a number out of range: the state was held."""
    MEASUREMENT_FAILED = 128
    """The measurement function gave NaN or a number out of range: predicted only."""
    COVARIANCE_REPAIRED = 256
    """The weights asked for gave no covariance: the negative centre term was left out."""
    OUT_OF_RANGE = 512
    """State or covariance would have left +-1e100: this step's change was not made."""
    SINGULAR = 1024
    """A predicted measurement has no variance at all: that component was not used."""
    RESTARTED = 2048
    """More time passed than the model holds for, or the state became none that is possible: it
    started anew from the prior."""


BROKEN_PREDICTION = (
    FilterStatus.INVALID_INPUT
    | FilterStatus.TRANSITION_FAILED
    | FilterStatus.OUT_OF_RANGE
    | FilterStatus.RESTARTED
)
"""Steps over which a smoother passes nothing backwards."""
