"""State-space models that a user writes, and the sigma points that a filter sends through them."""

import dis
import math
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from functools import lru_cache
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from numba import njit
from numba.core.dispatcher import Dispatcher
from numba.core.errors import NumbaError

from truejoint.array_types import Array, floats
from truejoint.compiled import address
from truejoint.errors import TruejointError
from truejoint.filters.factors import semidefinite_cholesky
from truejoint.filters.fields import MEASUREMENT, PROCESS_NOISE, TRANSITION


class FilterError(TruejointError):
    """A filter, a state-space model or a record for one that breaks a rule.

    Examples
    --------
    >>> issubclass(FilterError, ValueError)
    True
    """


@dataclass(frozen=True)
class ScaledSigmaPoints:
    """Scaled unscented transform (Wan and van der Merwe, 2000).

    With an `alpha` of 1 and a `beta` of 0 it is the plain form, where `kappa` is the ``lambda`` of
    yan2020, (15) and (18): the centre weighs ``kappa / (L + kappa)`` in mean and covariance alike.
    With ``kappa < 0`` a strongly curved model can make that covariance indefinite; the filter then
    leaves the offending term out and says so in its status.

    The kernels place 2 L points at plus and minus `reach` times the columns of a covariance factor
    and let each weigh 1 / (2 reach^2). The centre's weights follow from that, because mean weights
    sum to one; in terms of differences d_i from the centre's image and their weighted sum mu, ::

        mean = centre + mu,        covariance = sum_i w d_i d_i' + centre_correction mu mu'.

    This is the usual weighted sum, rearranged: the centre's weight, about -1e6 for a small alpha,
    never appears, and neither do the digits that it would cost.

    Parameters
    ----------
    alpha : float
        Spread of the points around the mean, 0 < alpha <= 1 as a rule.
    beta : float
        Knowledge of the distribution; 2 is best for a Gaussian.
    kappa : float
        Secondary scaling, kappa > -L for L dimensions.

    Examples
    --------
    >>> ScaledSigmaPoints().reach(4) > 0.0
    True
    """

    alpha: float = 1.0
    beta: float = 2.0
    kappa: float = 0.0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.alpha) and 1e-4 <= self.alpha <= 1e3):
            raise FilterError(f"alpha is {self.alpha}: give a number in 1e-4 .. 1e3")
        if not (math.isfinite(self.beta) and math.isfinite(self.kappa)):
            raise FilterError(f"beta {self.beta} and kappa {self.kappa} must be finite numbers")

    def reach(self, dimensions: int) -> float:
        """Distance of the points from the mean in deviations, alpha sqrt(L + kappa), L > -kappa."""
        if not dimensions + self.kappa > 0.0:
            raise FilterError(f"kappa is {self.kappa}: it must be above -{dimensions}")
        return self.alpha * math.sqrt(dimensions + self.kappa)

    @property
    def centre_correction(self) -> float:
        """Factor of mu mu' in the covariance: beta - alpha^2, not negative for alpha^2 <= beta."""
        return self.beta - self.alpha**2


# How far from symmetric or from semidefinite, relative to the variances, rounding may leave a
# covariance that somebody computed.
_TOLERANCE: Final = 1e-8
# No model writes this number: an element that still holds it was never written.
_UNWRITTEN: Final = 1.2345678e-67


def check_covariance(value: npt.ArrayLike, size: int, what: str) -> Array:
    """Covariance (size, size), exactly symmetric; may be zero.

    Raises FilterError if `what` is not that, symmetric and positive semidefinite within rounding.
    """
    matrix = floats(value, what, FilterError)
    if matrix.shape != (size, size):
        raise FilterError(f"{what}: shape is {matrix.shape}, must be {(size, size)}")
    if not np.all(np.abs(matrix) <= 1e100):
        raise FilterError(f"{what}: holds NaN, infinity or a number above 1e100")
    variance = np.diag(matrix)
    if np.any(variance < 0.0):
        raise FilterError(f"{what}: variance {variance.min():.3g} on the diagonal is negative")
    scale = np.sqrt(np.outer(variance, variance))
    if np.any(np.abs(matrix - matrix.T) > _TOLERANCE * scale):
        raise FilterError(f"{what}: not symmetric; pass (P + P') / 2 if that is what you mean")
    matrix = 0.5 * (matrix + matrix.T)
    correlation = np.divide(matrix, scale, out=np.zeros_like(matrix), where=scale > 0.0)
    lowest = float(np.linalg.eigvalsh(correlation)[0]) if matrix.size else 0.0
    if lowest < -_TOLERANCE * size or np.any((scale == 0.0) & (matrix != 0.0)):
        raise FilterError(f"{what}: not positive semidefinite, so no covariance")
    return matrix


def covariance_factor(covariance: Array) -> Array:
    """Lower factor L of a checked covariance, L L'."""
    factor = np.zeros_like(covariance)
    semidefinite_cholesky(covariance, len(covariance), factor)
    return factor


@dataclass(frozen=True, eq=False)
class StateSpaceModel:
    """A discrete model x[k] = f(x[k-1], u[k], dt) + w, z[k] = h(x[k], u[k]) + v.

    The functions fill `out` and are compiled with ``numba.njit(cache=True, error_model="numpy")``;
    the options keep them on disk and let a division by zero give infinity. A function without `out`
    returns its values. Plain Python functions do for a prototype, and warn: numba compiles them
    anew each time. The filter survives NaN and infinity with a status. An exception of a function
    counts as its failure too; of one that a compiled function calls, numba prints each, which takes
    milliseconds.

    A model that states what is possible recovers from absurd numbers: it leaves out measurements
    and inputs that are not, and starts anew from the prior where the state or a time step is not.

    Parameters
    ----------
    transition : compiled ``f(x, u, dt, parameters, out)``
        Writes the next state into `out`; all but `dt` [s] are 1-D arrays.
    measurement : compiled ``h(x, u, parameters, out)``
        Writes the expected measurement into `out`. Several sensors are one measurement: NaN stands
        in a row of z where a sensor has no value.
    process_noise : (n, n) array_like or compiled ``q(x, u, dt, parameters, out)``
        Covariance of w over one step. A function writes it into `out` (n, n), which comes filled
        with zeros; use one where dt varies.
    measurement_noise : (m, m) array_like
        Covariance of v.
    states, measurements, inputs : tuple of str
        Names, which also give n, m and the length of u.
    parameters : (p,) array_like
        Passed on to the functions.
    angles : tuple of str
        States and measurements that are angles [rad]: their differences are taken the short way
        round and their values kept in (-pi, pi].
    possible : mapping of str to (float, float)
        Lowest and highest possible value of states, measurements and inputs by name; for a name
        that is a state and a measurement, of both. Without, up to 1e100.
    longest_step : float
        Time [s] over which the model holds.

    Raises
    ------
    FilterError
        If a function does not compile or run or writes past `out`, or a covariance or
        a name is wrong.

    Examples
    --------
    >>> random_walk.states
    ('x0',)
    """

    transition: Callable[..., None]
    measurement: Callable[..., None]
    process_noise: npt.ArrayLike | Callable[..., None]
    measurement_noise: npt.ArrayLike
    states: tuple[str, ...]
    measurements: tuple[str, ...]
    inputs: tuple[str, ...] = ()
    parameters: npt.ArrayLike = ()
    angles: tuple[str, ...] = ()
    possible: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    longest_step: float = np.inf
    addresses: Mapping[str, int] = field(init=False, repr=False)
    """Where the compiled functions stand, by field."""
    called: tuple[Dispatcher, ...] = field(init=False, repr=False)
    """What stands there: an address is valid as long as its function lives."""
    bounds: Array = field(init=False, repr=False)
    """Lowest and highest (2, n + m + inputs) of each state, measurement and input."""

    def __post_init__(self) -> None:
        for kind in ("states", "measurements", "inputs", "angles"):
            names = getattr(self, kind)
            if isinstance(names, str) or len(set(names)) != len(names):
                raise FilterError(f"{kind} {names!r}: give a tuple of different names")
        if not self.states or not self.measurements:
            raise FilterError("a model needs at least one state and one measurement")
        unknown = set(self.angles) - set(self.states) - set(self.measurements)
        if unknown:
            raise FilterError(f"angles {sorted(unknown)}: neither a state nor a measurement")
        n, m = len(self.states), len(self.measurements)
        freeze = object.__setattr__
        freeze(self, "bounds", self._bounds())
        if not self.longest_step > 0.0:
            raise FilterError(f"longest step is {self.longest_step}: give a time above 0 s")
        parameters = np.array(self.parameters, dtype=np.float64)
        if parameters.ndim != 1:
            raise FilterError(f"parameters: shape is {parameters.shape}, must be one row")
        freeze(self, "parameters", parameters)
        noise = check_covariance(self.measurement_noise, m, "measurement noise")
        freeze(self, "measurement_noise", noise)
        x, u = np.zeros(n), np.zeros(len(self.inputs))
        step = x, u, 1e-3, parameters
        trials: dict[str, tuple[Any, ...]] = {
            "transition": (TRANSITION, step, (n,)),
            "measurement": (MEASUREMENT, (x, u, parameters), (m,)),
        }
        if callable(self.process_noise):
            trials["process_noise"] = (PROCESS_NOISE, step, (n, n))
        else:
            freeze(self, "process_noise", check_covariance(self.process_noise, n, "process noise"))
        called = {}
        for name, trial in trials.items():
            called[name] = _compile(getattr(self, name), name.replace("_", " "), *trial)
        freeze(self, "addresses", {name: place for name, (place, _) in called.items()})
        freeze(self, "called", tuple(function for _, function in called.values()))

    def _bounds(self) -> Array:
        names = (*self.states, *self.measurements, *self.inputs)
        for name, (lowest, highest) in self.possible.items():
            if name not in names or not lowest < highest:
                raise FilterError(
                    f"possible {name!r}: {lowest} to {highest}; give the lowest and the highest "
                    f"value, by the name of one of {', '.join(names)}"
                )
        return np.array([self.possible.get(name, (-np.inf, np.inf)) for name in names]).T.copy()

    def __reduce__(self) -> tuple[Any, ...]:
        values = (getattr(self, f.name) for f in fields(self) if f.init)
        return type(self), tuple(values)


def _compile(
    function: Any, what: str, signature: Any, arguments: tuple[Any, ...], shape: tuple[int, ...]
) -> tuple[int, Dispatcher]:
    """Address of a model function, and the function, after a trial run that sees stray writes."""
    if not callable(function):
        raise FilterError(f"{what}: {function!r} is no function; give one that fills `out`")
    trial = function.py_func if isinstance(function, Dispatcher) else function
    if trial is function:
        warnings.warn(
            f"{what}: {getattr(function, '__name__', function)} is plain Python, which numba "
            "compiles each time; decorate it with "
            '@numba.njit(cache=True, error_model="numpy") when it works',
            RuntimeWarning,
            stacklevel=4,
        )
        function = njit(error_model="numpy")(function)
    names = "x, u, dt, parameters" if len(arguments) == 4 else "x, u, parameters"
    code = getattr(trial, "__code__", None)
    taken: tuple[str, ...] = code.co_varnames[: code.co_argcount] if code else ()
    try:
        if len(taken) == len(arguments) and taken[-1] != "out":
            function = _filling(function, len(signature.args))
            trial = function.py_func
        called = _quiet(function, len(signature.args)) if _may_raise(function) else function
        place = address(called, signature)
    except (NumbaError, TypeError) as error:  # TypeError: another number of arguments
        reason = " ".join(str(error).split())[:200]
        raise FilterError(
            f"{what}: numba cannot compile it as f({names}, out), nor as f({names}) that returns: "
            f"{reason}"
        ) from None
    out = np.full(shape, _UNWRITTEN if len(shape) == 1 else 0.0)
    try:
        with np.errstate(all="ignore"):
            trial(*arguments, out)
    except (IndexError, NameError, TypeError, AttributeError) as error:
        raise FilterError(f"{what}: {error}; check its names and parameters") from None
    except (ArithmeticError, ValueError, NotImplementedError):
        # Zero may lie outside the model; compiled, it gives NaN there. Or it runs compiled only.
        return place, called
    if np.any(out == _UNWRITTEN):
        element = int(np.flatnonzero(out == _UNWRITTEN)[0])
        raise FilterError(f"{what}: it does not write element {element} of `out`")
    return place, called


def _filling(function: Dispatcher, arguments: int) -> Any:
    """Give a function that fills `out` with what this one returns, as filterpy's do."""

    @njit(error_model="numpy")
    def measurement(x: Array, u: Array, parameters: Array, out: Array) -> None:
        out[:] = np.asarray(function(x, u, parameters))

    @njit(error_model="numpy")
    def transition(x: Array, u: Array, dt: float, parameters: Array, out: Array) -> None:
        out[:] = np.asarray(function(x, u, dt, parameters))

    return transition if arguments == len(TRANSITION.args) else measurement


@lru_cache(maxsize=256)  # of models that differ in their parameters alone, of a fit's every step
def _may_raise(function: Dispatcher) -> bool:
    """Whether there is a `raise`, an `assert`, or a division that Python would refuse."""
    divides = function.targetoptions.get("error_model") != "numpy"
    return any(
        code.opname in ("RAISE_VARARGS", "LOAD_ASSERTION_ERROR")
        or (divides and code.opname == "BINARY_OP" and code.argrepr.strip("=") in ("/", "//", "%"))
        for code in dis.get_instructions(function.py_func)
    )


def _quiet(function: Dispatcher, arguments: int) -> Any:
    """Give a function that writes NaN where this one raises: numba prints what nobody catches."""

    @njit(error_model="numpy")
    def measurement(x: Array, u: Array, parameters: Array, out: Array) -> None:
        try:
            function(x, u, parameters, out)
        except Exception:  # noqa: BLE001  # numba tells no other
            out[:] = np.nan

    @njit(error_model="numpy")
    def transition(x: Array, u: Array, dt: float, parameters: Array, out: Array) -> None:
        try:
            function(x, u, dt, parameters, out)
        except Exception:  # noqa: BLE001
            out[:] = np.nan

    return transition if arguments == len(TRANSITION.args) else measurement
