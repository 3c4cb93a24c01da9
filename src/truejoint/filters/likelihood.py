"""Parameters of a model from a record, by maximum likelihood of what the filter did not expect."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from numbers import Real
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from truejoint.array_types import Array
from truejoint.errors import other_kind
from truejoint.filters.filter import UnscentedFilter
from truejoint.filters.sigma_points import FilterError
from truejoint.filters.status import FilterStatus

_STEP: Final = 1e-2  # of a logarithm, for the curvature at the maximum
_MAX_EVALUATIONS: Final = 400  # for each parameter
_USED: Final = ~int(FilterStatus.MISSING | FilterStatus.PARTIAL | FilterStatus.COVARIANCE_REPAIRED)


@dataclass(frozen=True, eq=False)
class ParameterFit:
    """What `maximum_likelihood` found.

    Attributes
    ----------
    values, deviations : mapping of str to float
        Parameters, and their standard deviations by the curvature of the likelihood there; NaN
        where the record does not tell them.
    loglik : float
        Logarithm of the likelihood.
    unscented : UnscentedFilter
        The filter with these parameters.
    evaluations : int
        How often the record was filtered.

    Examples
    --------
    >>> ParameterFit({"r": 0.1}, {"r": 0.01}, -3.0, UnscentedFilter(random_walk), 20).values["r"]
    0.1
    """

    values: Mapping[str, float]
    deviations: Mapping[str, float]
    loglik: float
    unscented: UnscentedFilter
    evaluations: int


def maximum_likelihood(
    filter_of: Callable[[Mapping[str, float]], UnscentedFilter],
    start: Mapping[str, float],
    z: npt.ArrayLike,
    u: npt.ArrayLike | None = None,
    **record: Any,
) -> ParameterFit:
    """Fit parameters to a record by the likelihood of the filter's innovations.

    The likelihood is the product of those of the innovations (Schweppe, IEEE Transactions on
    Information Theory 11(1), 1965); the simplex of Nelder and Mead climbs it in the logarithms of
    the parameters, which keep the signs that they start with.

    Parameters
    ----------
    filter_of : callable
        Filter for parameters by name, which may go wherever they belong: to the model's functions,
        to its noise or to both. It has no gate: what it leaves out would count as expected.
    start : mapping of str to float
        Where to begin, other than 0.
    z, u, **record
        As for `UnscentedFilter.run`.

    Raises
    ------
    FilterError
        If a parameter starts at 0 or at no number, `filter_of` makes no filter, the filter has a
        gate, or the record cannot be filtered with the parameters to start with.

    Examples
    --------
    >>> from dataclasses import replace
    >>> def walk(parameters):
    ...     still = replace(random_walk, process_noise=[[0.0]])
    ...     noise = [[parameters["variance"]]]
    ...     return UnscentedFilter(replace(still, measurement_noise=noise))
    >>> z = np.random.default_rng(0).normal(0.0, 0.5, 400)
    >>> fit = maximum_likelihood(walk, {"variance": 1.0}, z, x0=[0.0], P0=[[1.0]], dt=1.0)
    >>> print(f"{fit.values['variance']:.2f} +- {fit.deviations['variance']:.2f}")
    0.25 +- 0.02
    """
    from scipy.optimize import minimize  # noqa: PLC0415  # a control loop needs none of it

    first = _first(filter_of, start)
    names = list(start)
    signs = np.array([math.copysign(1.0, start[name]) for name in names])
    sizes = np.abs(np.array([start[name] for name in names], dtype=np.float64))

    def values(logarithms: Array) -> dict[str, float]:
        return dict(zip(names, (signs * sizes * np.exp(logarithms)).tolist(), strict=True))

    def surprise(logarithms: Array) -> float:
        try:
            result = filter_of(values(logarithms)).run(z, u, **record)
        except FilterError:
            return math.inf
        return math.inf if (result.status & _USED).any() else -float(result.loglik.sum())

    broken = first.run(z, u, **record).status & _USED
    if broken.any():
        what = FilterStatus(int(np.bitwise_or.reduce(broken)))
        raise FilterError(f"maximum likelihood: the start gives {what.name}; start elsewhere")
    zero = np.zeros(len(names))
    simplex = np.vstack([zero, 0.3 * np.eye(len(names))])
    options: Any = {
        "initial_simplex": simplex, "xatol": 1e-4, "fatol": 1e-4, "adaptive": True,
        "maxfev": _MAX_EVALUATIONS * len(names),
    }  # fmt: skip
    found = minimize(surprise, zero, method="Nelder-Mead", options=options)
    curvature = _curvature(surprise, found.x)
    best = values(found.x)
    with np.errstate(invalid="ignore"):
        try:
            relative = np.sqrt(np.diag(np.linalg.inv(curvature)))
        except np.linalg.LinAlgError:
            relative = np.full(len(names), np.nan)
    deviations = {n: float(r * abs(best[n])) for n, r in zip(names, relative, strict=True)}
    return ParameterFit(best, deviations, -float(found.fun), filter_of(best), int(found.nfev))


def _first(
    filter_of: Callable[[Mapping[str, float]], UnscentedFilter], start: Mapping[str, float]
) -> UnscentedFilter:
    """Filter with the parameters to start with; raises FilterError as `maximum_likelihood`."""
    if not callable(filter_of):
        advice = "give one that makes a filter of parameters by name"
        raise FilterError(other_kind(filter_of, "function", advice))
    if not isinstance(start, Mapping):
        raise FilterError(other_kind(start, "mapping", "give where each parameter starts, by name"))
    if not all(isinstance(v, Real) and math.isfinite(v) and v != 0.0 for v in start.values()):
        raise FilterError(f"start {dict(start)!s:.100}: give finite numbers other than 0")
    first = filter_of(dict(start))
    if not isinstance(first, UnscentedFilter):
        raise FilterError(other_kind(first, "filter", "filter_of is to make an UnscentedFilter"))
    if first.gate is not None:
        raise FilterError("maximum likelihood: the filter has a gate; give it none")
    return first


def _curvature(function: Callable[[Array], float], at: Array) -> Array:
    """Second derivatives (p, p) of a function at a point (p,), by central differences."""
    p = len(at)
    steps = _STEP * np.eye(p)
    found = np.empty((p, p))
    for i in range(p):
        for j in range(i + 1):
            a, b = steps[i], steps[j]
            corners = function(at + a + b) - function(at + a - b)
            corners += function(at - a - b) - function(at - a + b)
            found[i, j] = found[j, i] = corners / (4.0 * _STEP**2)
    return found
