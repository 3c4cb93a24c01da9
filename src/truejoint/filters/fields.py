"""What an unscented filter keeps in its memory, its statuses, and how it calls its model.

A model's functions are called through their addresses, so that one compiled filter, cached on disk,
serves every model. So is its step, which would be compiled anew into everything that takes one.
"""

import tomllib
from enum import IntFlag
from importlib.resources import files
from typing import Any, Final

from numba import types
from numba.extending import intrinsic

from truejoint.compiled import INTEGERS, MATRIX, VECTOR, call_address
from truejoint.layout import Layout


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

TRANSITION: Final = types.void(VECTOR, VECTOR, types.float64, VECTOR, VECTOR)
MEASUREMENT: Final = types.void(VECTOR, VECTOR, VECTOR, VECTOR)
PROCESS_NOISE: Final = types.void(VECTOR, VECTOR, types.float64, VECTOR, MATRIX)
STEP: Final = types.int64(INTEGERS, VECTOR)

LAYOUT: Final = Layout().declare(__package__, "filter")
N, F, H, G, ADVANCE = LAYOUT.places("n_states transition measurement process_noise step")
PATIENCE, REJECTED, OBSERVED, STATUS = LAYOUT.places("patience rejected observed status")
LONGEST, DT, NIS, LOGLIK, INFLATION = LAYOUT.places("longest dt nis loglik inflation")
P, Q, P_MEAN, P_ZZ, S_ZZ = LAYOUT.places(
    "covariance noise_factor covariance_mean z_covariance z_factor"
)
NOISE, LOWEST, HIGHEST = LAYOUT.places("noise lowest highest")

unpack_filter = LAYOUT.unpacker()
"""Give a kernel the filter's numbers, state, covariance, measurement, inputs and parameters."""


@intrinsic
def call_model(
    _typing: Any, function: Any, x: Any, u: Any, dt: Any, parameters: Any, out: Any
) -> Any:
    """Call the transition or the process noise at an address."""
    return types.void(types.int64, x, u, dt, parameters, out), call_address


@intrinsic
def call_measurement(_typing: Any, function: Any, x: Any, u: Any, parameters: Any, out: Any) -> Any:
    """Call the measurement function at an address."""
    return types.void(types.int64, *MEASUREMENT.args), call_address


@intrinsic
def call_step(_typing: Any, function: Any, numbers: Any, memory: Any) -> Any:
    """Call the filter's step at an address."""
    return types.int64(types.int64, *STEP.args), call_address
