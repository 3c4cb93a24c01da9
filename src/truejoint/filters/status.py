"""What a filter step did, as bits of one number: the loop itself raises nothing."""

import tomllib
from enum import IntFlag
from importlib.resources import files
from typing import Final


class FilterStatus(IntFlag):
    """Bits of the status of one filter step; 0 means that everything in `z` was used.

    Whatever the bits, state and covariance stay finite and the covariance positive semidefinite.

    Examples
    --------
    >>> FilterStatus(6).name, FilterStatus.MISSING.words
    ('PARTIAL|GATED', 'No measurement in this step (all NaN): predicted only')
    """

    OK = 0
    MISSING = 1
    PARTIAL = 2
    GATED = 4
    REACQUIRED = 8
    INVALID_INPUT = 16
    INVALID_MEASUREMENT = 32
    TRANSITION_FAILED = 64
    MEASUREMENT_FAILED = 128
    COVARIANCE_REPAIRED = 256
    OUT_OF_RANGE = 512
    SINGULAR = 1024
    RESTARTED = 2048

    @property
    def words(self) -> str:
        """Meaning of each bit, for a person; empty for OK."""
        return "; ".join(_MEANINGS[str(bit.name)] for bit in self)


_MEANINGS: Final = tomllib.loads(files(__package__).joinpath("status.toml").read_text("utf-8"))
BROKEN_PREDICTION = (
    FilterStatus.INVALID_INPUT
    | FilterStatus.TRANSITION_FAILED
    | FilterStatus.OUT_OF_RANGE
    | FilterStatus.RESTARTED
)
"""Steps over which a smoother passes nothing backwards."""
