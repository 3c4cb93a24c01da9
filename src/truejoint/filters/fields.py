"""What an unscented filter keeps in its memory, and how it calls its model.

A model's functions are called through their addresses, so that one compiled filter, cached on disk,
serves every model. So is its step, which would be compiled anew into everything that takes one.
"""

from __future__ import annotations

from typing import Any, Final

from numba import types
from numba.extending import intrinsic

from truejoint.compiled import INTEGERS, MATRIX, VECTOR, call_address
from truejoint.layout import Layout

TRANSITION: Final = types.void(VECTOR, VECTOR, types.float64, VECTOR, VECTOR)
MEASUREMENT: Final = types.void(VECTOR, VECTOR, VECTOR, VECTOR)
PROCESS_NOISE: Final = types.void(VECTOR, VECTOR, types.float64, VECTOR, MATRIX)
STEP: Final = types.int64(INTEGERS, VECTOR)

LAYOUT: Final = Layout()
_N: Final = "n_states"
_M: Final = "n_measurements"
N: Final = LAYOUT.integer(_N, "states")
LAYOUT.integer(_M, "measurements")
LAYOUT.integer("n_inputs", "control inputs")
LAYOUT.integer("n_parameters", "parameters of the model")
F: Final = LAYOUT.address("transition", "state after a step")
H: Final = LAYOUT.address("measurement", "what a state measures")
G: Final = LAYOUT.address("process_noise", "its covariance; 0 where it is a constant matrix")
PATIENCE: Final = LAYOUT.integer("patience", "measurements gated in a row before one is taken")
REJECTED: Final = LAYOUT.integer("rejected", "measurements gated in a row so far")
OBSERVED: Final = LAYOUT.integer("observed", "components of the measurement in use")
STATUS: Final = LAYOUT.integer("status", "FILTER bits of the last step")

LAYOUT.scalar("reach", "of a sigma point, in deviations")
LAYOUT.scalar("root_weight", "square root of a point's weight")
LAYOUT.scalar("correction", "weight of the centre's outer product")
LAYOUT.scalar("root_correction", "square root of its magnitude")
LONGEST: Final = LAYOUT.scalar("longest", "time over which the model holds [s]")
DT: Final = LAYOUT.scalar("dt", "time since the step before [s]")
NIS: Final = LAYOUT.scalar("nis", "normalised innovation squared")
LOGLIK: Final = LAYOUT.scalar("loglik", "log-likelihood of the measurement")
INFLATION: Final = LAYOUT.scalar("inflation", "of the covariance, where a measurement was far off")

LAYOUT.array("x", "state", _N)
P: Final = LAYOUT.array("covariance", "of the state", _N, _N)
LAYOUT.array("factor", "lower factor of the covariance", _N, _N)
LAYOUT.array("z", "measurement, NaN where missing", _M)
LAYOUT.array("u", "control input", "n_inputs")
LAYOUT.array("innovation", "measured less predicted, or NaN", _M)
Q: Final = LAYOUT.array("noise_factor", "lower factor of the process noise", _N, _N)
LAYOUT.array("x_prior", "state before the first step", _N)
LAYOUT.array("covariance_prior", "of the state before the first step", _N, _N)
LAYOUT.array("factor_prior", "its lower factor", _N, _N)
LAYOUT.array("theta", "parameters of the model", "n_parameters")
LAYOUT.array("sensor_factor", "lower factor of the measurement noise", _M, _M)
LAYOUT.array("gate", "NIS limit for 0, 1, ... components, all 0 without a gate", "n_limits")
LAYOUT.array("x_mean", "predicted state", _N)
P_MEAN: Final = LAYOUT.array("covariance_mean", "of the predicted state", _N, _N)
LAYOUT.array("factor_mean", "its lower factor", _N, _N)
LAYOUT.array("centre", "image of the centre point", _N)
LAYOUT.array("shift", "predicted state minus centre", _N)
LAYOUT.array("deviations", "sigma points less centre", "n_deviations", _N)
LAYOUT.array("z_deviations", "of their measurements", "n_deviations", _M)
LAYOUT.array("z_shift", "predicted measurement minus that of the centre", _M)
LAYOUT.array("z_mean", "predicted measurement", _M)
P_ZZ: Final = LAYOUT.array("z_covariance", "of the predicted measurement", _M, _M)
S_ZZ: Final = LAYOUT.array("z_factor", "its lower factor", _M, _M)
LAYOUT.array("gain", "of the measurement", _N, _M)
LAYOUT.array("white", "innovation divided by its factor", _M)
LAYOUT.array("stack", "rows whose outer products are summed", "n_rows", "widest")
LAYOUT.array("deficit", "row whose outer product is added or taken away", "widest")
LAYOUT.array("point", "one sigma point", _N)
LAYOUT.array("image", "of one sigma point", "widest")
NOISE: Final = LAYOUT.array("noise", "covariance of the process noise", _N, _N)
LOWEST: Final = LAYOUT.array("lowest", "possible of each state, then measurement, then input")
HIGHEST: Final = LAYOUT.array("highest", "possible of each state, then measurement, then input")
LAYOUT.integers("angles", "1 for states, then measurements, that are angles", "n_angles")
LAYOUT.integers("chosen", "components of the measurement in use", _M)
ADVANCE: Final = LAYOUT.address("step", "of the filter")

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
