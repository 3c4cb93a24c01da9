"""The unscented Kalman filter: a whole record in one compiled call, or one step at a time."""

from dataclasses import dataclass, field
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from truejoint.array_types import Array, Integers, floats
from truejoint.compiled import address, compiled, copy
from truejoint.filters import fields as at
from truejoint.filters import kernels
from truejoint.filters.fields import call_step, unpack_filter
from truejoint.filters.smoother import smooth
from truejoint.filters.state_space import (
    FilterError,
    ScaledSigmaPoints,
    StateSpaceModel,
    check_covariance,
    covariance_factor,
)
from truejoint.layout import Memory, refuse_copy


@dataclass(frozen=True, eq=False, slots=True)
class FilterState:
    """State of a filter between two steps; `UnscentedFilter.step` changes it in place.

    The arrays are views of one block of memory: copy what you want to keep.

    Attributes
    ----------
    x : (n,) array
        State estimate.
    P : (n, n) array
        Its covariance.
    innovation : (m,) array
        Measured less predicted in the last step, NaN where nothing was measured.

    Examples
    --------
    >>> state = UnscentedFilter(random_walk).initial_state([0.0], [[1.0]])
    >>> state.x
    array([0.])
    """

    owner: "UnscentedFilter"
    numbers: Integers = field(repr=False)
    memory: Array = field(repr=False)
    x: Array
    P: Array
    innovation: Array
    z: Array = field(repr=False)
    u: Array = field(repr=False)

    __reduce__ = refuse_copy

    @property
    def nis(self) -> float:
        """Normalised innovation squared of the last step, NaN without a measurement."""
        return float(self.memory[at.NIS])

    @property
    def loglik(self) -> float:
        """Log-likelihood of the last measurement; 0 if there was none or it was gated."""
        return float(self.memory[at.LOGLIK])


class FilterResult(NamedTuple):
    """States that a filter estimated over a record of N rows.

    Attributes
    ----------
    x : (N, n) array
        State after each row's measurement.
    P : (N, n, n) array
        Its covariance.
    innovation : (N, m) array
        Measured less predicted, NaN where nothing was measured.
    nis : (N,) array
        Normalised innovation squared, NaN without a measurement.
    loglik : (N,) array
        Log-likelihood of each measurement that was used; their sum is the record's.
    inflation : (N,) array
        Factor by which re-acquiring enlarged the predicted covariance, 1 elsewhere.
    status : (N,) int64 array
        Bits of `FilterStatus`.
    u, dt, x0, P0 : arrays
        The inputs (N, inputs), time steps (N,) [s] and prior that it started from.

    Examples
    --------
    >>> UnscentedFilter(random_walk).run([0.5, 0.6], x0=[0.0], P0=[[1.0]], dt=1.0).status
    array([0, 0])
    """

    x: Array
    P: Array
    innovation: Array
    nis: Array
    loglik: Array
    inflation: Array
    status: Integers
    u: Array
    dt: Array
    x0: Array
    P0: Array

    def plot(self) -> Any:
        """Draw the states, and two standard deviations, over time; give matplotlib's axes (n,)."""
        units = {f"x[{k}]": "1" for k in range(self.x.shape[1])}
        sd = 2 * np.sqrt(np.diagonal(self.P, axis1=1, axis2=2))
        curves = {"estimate": self.x, "less 2 sd": self.x - sd, "plus 2 sd": self.x + sd}
        draw = import_module("truejoint.drawing").plot
        return draw("", np.cumsum(self.dt), curves, units, "time [s]")


class SmoothedResult(NamedTuple):
    """States given the whole record, by the unscented Rauch-Tung-Striebel smoother.

    Attributes
    ----------
    x : (N, n) array
        Smoothed states.
    P : (N, n, n) array
        Their covariances.
    x0, P0 : (n,), (n, n) array
        The state before the first row and its covariance.

    Examples
    --------
    >>> unscented = UnscentedFilter(random_walk)
    >>> unscented.smooth(unscented.run([0.5, 0.6], x0=[0.0], P0=[[1.0]], dt=1.0)).x.shape
    (2, 1)
    """

    x: Array
    P: Array
    x0: Array
    P0: Array


@dataclass(frozen=True, eq=False)
class UnscentedFilter:
    """Unscented Kalman filter for any `StateSpaceModel` (yan2020, equations 15-23).

    Parameters
    ----------
    model : StateSpaceModel
        Model that is filtered.
    sigma_points : ScaledSigmaPoints
        How far the points stand out and what they weigh.
    gate : float, optional
        A measurement is left out if its NIS exceeds this quantile of chi-square; by default all are
        used.
    patience : int
        Measurements left out in a row; the next one is used with an enlarged covariance, so that a
        filter that is wrong finds back.

    Examples
    --------
    >>> unscented = UnscentedFilter(random_walk)
    >>> state = unscented.initial_state([0.0], [[1.0]])
    >>> unscented.step(state, [1.1], None, 1.0), state.x.round(3)
    (0, array([0.576]))
    """

    model: StateSpaceModel
    sigma_points: ScaledSigmaPoints = field(default_factory=ScaledSigmaPoints)
    gate: float | None = None
    patience: int = 10

    def __post_init__(self) -> None:
        if not isinstance(self.model, StateSpaceModel):
            raise FilterError(f"model: give a StateSpaceModel, not {type(self.model).__name__}")
        if self.gate is not None and not 0.0 < self.gate < 1.0:
            raise FilterError(f"gate is {self.gate}: give a probability between 0 and 1")
        if not 0 <= self.patience <= 10**9:
            raise FilterError(f"patience is {self.patience}: give a number of measurements")
        self.sigma_points.reach(len(self.model.states))

    def initial_state(self, x0: npt.ArrayLike, P0: npt.ArrayLike) -> FilterState:
        """Filter at rest, ready to step; the step is compiled when this returns.

        Its state before the first step is `x0` (n,), of covariance `P0` (n, n): zero, or singular,
        where the state is known. Raises FilterError if a shape is wrong, a number not finite or P0
        no covariance.
        """
        model = self.model
        n = len(model.states)
        mean = floats(x0, "x0", FilterError)
        if mean.shape != (n,) or not np.all(np.abs(mean) <= 1e100):
            raise FilterError(f"x0: give {n} finite numbers ({', '.join(model.states)})")
        covariance = check_covariance(P0, n, "P0")
        memory = self.memory(mean, covariance)
        views = (memory.view(name) for name in ("x", "covariance", "innovation", "z", "u"))
        return FilterState(self, memory.numbers, memory.memory, *views)

    def memory(self, x0: Array, P0: Array) -> Memory:
        """Lay out the kernels' memory, for a prior that `initial_state` would take."""
        model, points = self.model, self.sigma_points
        n, m = len(model.states), len(model.measurements)
        reach, correction = points.reach(n), points.centre_correction
        factor = covariance_factor(P0)
        functions = {name: getattr(model, name) for name in model.addresses}
        values: dict[str, Any] = {
            **model.addresses, "step": address(kernels.step, at.STEP),
            "theta": model.parameters, "reach": reach, "root_weight": np.sqrt(0.5) / reach,
            "correction": correction, "root_correction": np.sqrt(abs(correction)),
            "u": np.zeros(len(model.inputs)), "z": np.full(m, np.nan),
            "sensor_factor": covariance_factor(np.asarray(model.measurement_noise)),
            "angles": [name in model.angles for name in (*model.states, *model.measurements)],
            "x": x0, "covariance": P0, "factor": factor,
            "x_prior": x0, "covariance_prior": P0, "factor_prior": factor,
            "lowest": model.bounds[0], "highest": model.bounds[1], "longest": model.longest_step,
            "n_deviations": 2 * n, "n_rows": 5 * n + m + 1, "widest": max(n, m),
            "n_limits": m + 1, "inflation": 1.0,
        }  # fmt: skip
        if not callable(model.process_noise):
            values["noise_factor"] = covariance_factor(np.asarray(model.process_noise))
        if self.gate is not None:
            from scipy.stats import chi2  # noqa: PLC0415  # a control loop without a gate

            values["patience"] = self.patience
            limits = chi2.ppf(self.gate, np.arange(1, m + 1))
            values["gate"] = np.append(0.0, limits)
        return at.LAYOUT.pack({**functions, "step": kernels.step}, **values)

    def step(self, state: FilterState, z: npt.ArrayLike, u: npt.ArrayLike | None, dt: float) -> int:
        """Advance a state by one sample, in place and allocating nothing; bits of `FilterStatus`.

        `state` is from this filter's `initial_state`, and `z` (m,) the measurement, NaN where
        missing. `u` (inputs,) is the control input over the step, None for a model without, and
        `dt` the time since the last step [s]; 0 only corrects. Raises FilterError if the state is
        another filter's or a length is wrong; never for what the numbers hold.
        """
        if state.owner is not self:
            raise FilterError("state: belongs to another filter; use this one's initial_state")
        if len(z) != len(state.z):  # type: ignore[arg-type]  # a scalar has no length: TypeError
            raise FilterError(f"z: give {len(state.z)} numbers, NaN where missing")
        state.z[:] = z
        if (0 if u is None else len(u)) != len(state.u):  # type: ignore[arg-type]
            raise FilterError(f"u: give {len(state.u)} numbers, None for a model without inputs")
        if u is not None:
            state.u[:] = u
        state.memory[at.DT] = dt
        return kernels.step(state.numbers, state.memory)

    def run(
        self,
        z: npt.ArrayLike,
        u: npt.ArrayLike | None = None,
        *,
        x0: npt.ArrayLike,
        P0: npt.ArrayLike,
        dt: npt.ArrayLike | None = None,
        t: npt.ArrayLike | None = None,
    ) -> FilterResult:
        """Filter a whole record in one compiled call; the same bits as its single steps.

        Row k first advances the state over dt[k] under u[k], then corrects it by z[k]. Rows that
        hold NaN or make no sense are survived and carry a status.

        Parameters
        ----------
        z : (N, m) array_like
            Measurements, NaN where missing.
        u : (N, inputs) array_like, optional
            Control input over the step that ends at each row.
        x0, P0 : (n,), (n, n) array_like
            Prior: at the first row if dt[0] = 0, else dt[0] before it.
        dt : float or (N,) array_like, optional
            Time from the row before [s].
        t : (N,) array_like, optional
            Time stamps [s] instead of dt; the prior then holds at the first row.

        Raises
        ------
        FilterError
            If shapes do not fit together, or the prior is wrong.
        """
        state = self.initial_state(x0, P0)
        measured = _table(z, len(state.z), "z")
        rows = len(measured)
        control = np.zeros((rows, 0)) if u is None else _table(u, len(state.u), "u")
        if control.shape != (rows, len(state.u)):
            raise FilterError(f"u: shape is {control.shape}, must be {(rows, len(state.u))}")
        steps = _time_steps(dt, t, rows)
        n, m = len(state.x), len(state.z)
        x, P, innovation = np.empty((rows, n)), np.empty((rows, n, n)), np.empty((rows, m))
        nis, loglik, inflation = np.empty((3, rows))
        result = FilterResult(
            x, P, innovation, nis, loglik, inflation, np.empty(rows, dtype=np.int64),
            control, steps, state.x.copy(), state.P.copy(),
        )  # fmt: skip
        _run(state.numbers, state.memory, measured, result)
        return result

    def smooth(self, result: FilterResult) -> SmoothedResult:
        """Smooth the result of this filter's `run`, in one compiled call.

        Each row knows the whole record. Nothing passes backwards over a row whose prediction
        failed.
        """
        state = self.initial_state(result.x0, result.P0)
        x, P, x0, P0 = (array.copy() for array in (result.x, result.P, result.x0, result.P0))
        record = result.u, result.dt, result.inflation, result.status
        smooth(state.numbers, state.memory, *record, x0, P0, x, P)
        return SmoothedResult(x, P, x0, P0)


UKF = UnscentedFilter  # as most call it


@compiled
def _run(numbers: Integers, memory: Array, z: Array, result: FilterResult) -> None:
    """Fill a result by one step for each row of measurements `z` (N, m), as single steps would."""
    m, n = unpack_filter(numbers, memory), numbers[at.N]
    for k in range(z.shape[0]):
        copy(z[k], m.z, m.n_measurements)
        copy(result.u[k], m.u, m.n_inputs)
        memory[at.DT] = result.dt[k]
        result.status[k] = call_step(numbers[at.ADVANCE], numbers, memory)
        copy(m.x, result.x[k], n)
        for i in range(n):
            copy(m.covariance[i], result.P[k, i], n)
        copy(m.innovation, result.innovation[k], m.n_measurements)
        result.nis[k] = memory[at.NIS]
        result.loglik[k] = memory[at.LOGLIK]
        result.inflation[k] = memory[at.INFLATION]


def _table(values: npt.ArrayLike, columns: int, what: str) -> Array:
    table = np.array(floats(values, what, FilterError), order="C")
    if table.ndim == 1 and columns == 1:
        table = table[:, np.newaxis]
    if table.ndim != 2 or table.shape[1] != columns or not len(table):
        raise FilterError(f"{what}: shape is {table.shape}, must be (rows, {columns})")
    return table


def _time_steps(dt: npt.ArrayLike | None, t: npt.ArrayLike | None, rows: int) -> Array:
    if (dt is None) == (t is None):
        raise FilterError("time: give either dt or t")
    what, times = ("dt", dt) if t is None else ("t", t)
    values = floats(() if times is None else times, what, FilterError)
    if t is None and values.ndim == 0:
        if not (np.isfinite(values) and values > 0.0):
            raise FilterError(f"dt is {values}: give a positive time step in seconds")
        values = np.full(rows, values)
    if values.shape != (rows,):
        raise FilterError(f"{what}: shape is {values.shape}, must be {(rows,)}")
    return values.copy() if t is None else np.diff(values, prepend=values[0])
