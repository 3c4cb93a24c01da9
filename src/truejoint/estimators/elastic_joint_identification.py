"""Identify an elastic joint with friction from driver angle, driver torque and the jaw's truth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.optimize import least_squares

from truejoint.array_types import Array, Integers
from truejoint.estimators.base import Flags
from truejoint.estimators.play import ridge
from truejoint.filters import UnscentedFilter
from truejoint.models.elastic_joint import LOAD_TERMS, ElasticJoint, terms
from truejoint.models.filtered import run_histories
from truejoint.models.play import bank_columns

PENALTY: Final = 1e-7  # on standardised terms
NARROWEST: Final = 0.003
WIDEST: Final = 1.0
"""Least and largest width of a friction element, in half ranges of the driver."""
SETTLED: Final = 0.5
"""Travel after which friction is taken to have forgotten how it began, in half ranges."""
_FIRST_WIDTHS: Final = (0.012, 0.5)  # where the search for widths starts
_ROUNDS: Final = 8  # of loads and torque response in turn


@dataclass(frozen=True, eq=False)
class Motion:
    """Rows of one or more histories, in units of the calibration."""

    angle: Array  # (n,), of the driver, as is the torque
    torque: Array
    dt: Array  # (n,), time since the row before [s], 0 where a history starts

    @property
    def history(self) -> Integers:
        """Number of each row's history (n,), from 0."""
        return np.asarray(np.cumsum(self.dt == 0.0) - 1, dtype=np.int64)

    @property
    def moved(self) -> Array:
        """How far the driver went since the row before (n,), 0 where a history starts."""
        return np.where(self.dt > 0.0, np.diff(self.angle, prepend=self.angle[:1]), 0.0)

    @property
    def travel(self) -> Array:
        """Way that the driver went since its history started (n,)."""
        way = np.cumsum(np.abs(self.moved))
        return np.asarray(way - way[self.dt == 0.0][self.history])

    def deflections(self, widths: Array) -> Array:
        """Deflections (n, m) of friction elements that start in the middle of each history."""
        out = np.empty((len(self.angle), len(widths)))
        bank_columns(self.dt, self.angle, 1.0, widths, out)
        return out

    def pick(self, rows: Integers) -> Motion:
        """Take some of the rows, in order and with the first of each history among them."""
        clock = np.cumsum(self.dt)
        dt = np.diff(clock[rows], prepend=clock[rows[:1]])
        fresh = np.diff(self.history[rows], prepend=-1) > 0
        return Motion(
            np.ascontiguousarray(self.angle[rows]), self.torque[rows], np.where(fresh, 0.0, dt)
        )


def regress(columns: Array, y: Array) -> Array:
    """Ridge regression of `y` (n,) on standardised `columns` (n, k), the first constant."""
    weights, constant = ridge(columns, y, PENALTY)
    weights[0] = constant
    return weights


def regress_torque(columns: Array, torque: Array, load: Array) -> tuple[Array, Array]:
    """Torque response (p,) of which the load is a part as it is, and what it leaves over (n,)."""
    free = [i for i in range(columns.shape[1]) if i not in LOAD_TERMS]
    found = np.zeros(columns.shape[1])
    found[free] = ridge(columns[:, free], torque - load, PENALTY)[0]
    found[LOAD_TERMS[1]] = 1.0
    return found, torque - columns @ found


class _Static:
    """Rows to fit the static responses to, with one load for each history.

    The torque's response needs no truth and is fitted to all `rows`; the jaw's to the `known`.
    """

    def __init__(self, motion: Motion, rows: Integers, known: Flags, jaw: Array) -> None:
        self.motion, self.rows, self.known, self.jaw = motion, rows, known, jaw
        self.angle, self.torque = motion.angle[rows], motion.torque[rows]
        _, self.history = np.unique(motion.history[rows], return_inverse=True)
        self.count = np.bincount(self.history)
        self.load = self._by_history(self.torque)

    def columns(self, widths: Array) -> Array:
        """Terms (n, p) of the responses."""
        deflections = self.motion.deflections(widths)[self.rows]
        return terms(self.angle, self.load[self.history], deflections)

    def settle_loads(self, widths: Array) -> None:
        """Find the load of each history, and the torque response, by turns."""
        deflections = self.motion.deflections(widths)[self.rows]
        for _ in range(_ROUNDS):
            load = self.load[self.history]
            columns = terms(self.angle, load, deflections)
            self.load = self.load + self._by_history(regress_torque(columns, self.torque, load)[1])

    def misfits(self, widths: Array) -> tuple[Array, Array]:
        """Find what the best responses leave of torque (n,) and jaw angle (k,)."""
        columns = self.columns(widths)
        left = regress_torque(columns, self.torque, self.load[self.history])[1]
        columns = columns[self.known]
        return left, self.jaw - columns @ regress(columns, self.jaw)

    def find_widths(self, elements: int) -> Array:
        """Widths by variable projection: the responses are solved for at every trial."""
        start = np.geomspace(*_FIRST_WIDTHS, elements)
        self.settle_loads(start)
        # As if both had independent errors of their own size: their likelihoods then add up.
        scales = [max(float(e.std()), 1e-12) * np.sqrt(len(e)) for e in self.misfits(start)]

        def residuals(logarithms: Array) -> Array:
            left = self.misfits(np.exp(logarithms))
            return np.concatenate([e / scale for e, scale in zip(left, scales, strict=True)])

        found = least_squares(
            residuals,
            np.log(start),
            bounds=(np.log(NARROWEST), np.log(WIDEST)),
            diff_step=[0.05],
            max_nfev=15,
        )
        widths = np.sort(np.exp(found.x))
        self.settle_loads(widths)
        return widths

    def _by_history(self, values: Array) -> Array:
        return np.bincount(self.history, values) / self.count


def identify(
    motion: Motion,
    rows: Integers,
    known: Flags,
    jaw: Array,
    *,
    elements: int,
    load_drift: float,
    noise_density: float,
) -> ElasticJoint:
    """Identify widths, torque response and noise of a joint; each history has one load.

    Of all rows, it fits to `rows` (k,), after friction has `SETTLED`; `known` (k,) tells which of
    them have truth, `jaw` (known,) the jaw's angle there. Loads and the torque's response are found
    by turns, the elements' widths by variable projection on torque and jaw angle together.
    """
    static = _Static(motion, rows, known, jaw)
    widths = static.find_widths(elements)
    load = static.load[static.history]
    torque, left = regress_torque(static.columns(widths), static.torque, load)
    spread = max(float(load.std()), 1e-6)
    return ElasticJoint(
        widths=widths,
        torque=torque,
        load_density=(load_drift * spread) ** 2,
        rest_deviation=max(float(left.std()), 1e-6),
        rest_travel=_memory(left, motion.travel[rows]),
        noise_density=noise_density,
        load_mean=float(load.mean()),
        load_deviation=spread,
    )


def _memory(left: Array, travel: Array) -> float:
    """Travel over which `left` (n,) forgets itself, from neighbours a small way apart."""
    apart = np.diff(travel, prepend=travel[:1])
    near = np.flatnonzero((apart > 0.02) & (apart < 0.1))
    if not len(near):
        return 0.05
    alike = float(np.mean(left[near] * left[near - 1]) / max(float(np.mean(left**2)), 1e-300))
    return float(-apart[near].mean() / np.log(min(max(alike, 0.05), 0.99)))


def run(
    joint: ElasticJoint, motion: Motion, *, smoothed: bool = False, dt: float | None = None
) -> tuple[Array, Array]:
    """States (n, m + 2) and covariances (n, m + 2, m + 2) by filter or smoother, in each history.

    The torque's noise is reckoned with rows `dt` [s] apart; their mean by default.
    """
    if dt is None:
        dt = mean_dt(motion.dt)
    unscented = UnscentedFilter(joint.state_space(dt))
    u = np.column_stack([motion.angle, motion.moved])
    return run_histories(unscented, joint.prior(), motion.torque, u, motion.dt, smoothed=smoothed)


def mean_dt(dt: Array) -> float:
    """Mean time between rows [s] within histories; 5 ms where there is only one row."""
    moving = dt[dt > 0.0]
    return float(moving.mean()) if len(moving) else 5e-3
