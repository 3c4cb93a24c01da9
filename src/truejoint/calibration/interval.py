"""How far off a corrected position may be: half-widths that a model file carries."""

import math
from dataclasses import dataclass
from numbers import Real
from typing import Final

import numpy as np

from truejoint.array_types import Array
from truejoint.compiled import compiled
from truejoint.errors import CalibrationError

LEVELS: Final = (0.8, 0.9, 0.95)
LEVEL: Final = 0.9  # where none is asked for
GROWTH: Final = 2.0  # growth of the interval outside the trained range: see `Interval.growth`
MAX_LEVELS: Final = 16


@dataclass(frozen=True, eq=False)
class Interval:
    """Conformal half-widths with whole trajectories as the exchangeable unit.

    Draw a trajectory like those that the interval was made of, and pick a sample at random. It lies
    within ``corrected +- half_width`` with at least the stated probability, averaged over such
    trajectories, joint by joint (hierarchical conformal prediction, Lee, Barber and Willett,
    arXiv:2306.06342). One trajectory may lie inside altogether and another half outside.

    Attributes
    ----------
    levels : ndarray, shape (n_levels,)
        Stated probabilities, ascending; only those that the trajectories were enough for.
    half_widths : ndarray, shape (n_levels, n_joints)
        Half-width of the corrected position within the trained range [rad or m].
    growth : float
        A sample whose features lie outside their training ranges by at most a share s of the
        range has the half-width ``(1 + growth * s) * half_width``.
    rezero : float
        Time of truth [s] that every trajectory began with and that its offset was re-zeroed from;
        0 when none was: then positions count as homing left them.
    trajectories, homings : int
        How many exchangeable units there were, and homings that they span; 0 when not known.
    folds : int
        How many fits without some of the units judged those, where the fit itself saw them all
        (cross-conformal); 0 where it saw none of them.
    cut : int
        How many recordings were cut into the units; 0 where these are whole.
    whole : int
        How many recordings, or homings, the fits did without as a whole, where they were cut; 0
        where the fits did without parts of them.

    Examples
    --------
    >>> model.interval.levels.tolist()
    [0.8, 0.9]
    """

    levels: Array
    half_widths: Array
    growth: float
    rezero: float
    trajectories: int
    homings: int
    folds: int = 0
    cut: int = 0
    whole: int = 0

    @property
    def any_homing(self) -> bool:
        """Whether homings were what was drawn, so that it holds after others without a re-zeroing.

        With fewer homings than a level takes, the parts of their recordings count, without what a
        further homing adds.
        """
        return self.homings > 1 and not self.cut and self.rezero == 0.0

    def half_width(self, level: float = 0.9) -> Array:
        """Half-width (n_joints,) [rad or m] at one level, within the trained range.

        Raises CalibrationError if the interval does not state it, saying what it would take.
        """
        return np.asarray(self.half_widths[self.index(level)])

    def index(self, level: float) -> int:
        """Row of a level in the half-widths; raises CalibrationError as `half_width`."""
        check_level(level)
        near = np.flatnonzero(np.isclose(self.levels, level, rtol=0.0, atol=1e-9))
        if near.size:
            return int(near[0])
        stated = ", ".join(f"{100 * stated_level:g} %" for stated_level in self.levels)
        raise CalibrationError(
            f"no {100 * level:g} % interval was made of {self.trajectories} trajectories; it "
            f"takes at least {needed_trajectories(level)}, and the model states {stated}"
        )

    @property
    def meaning(self) -> str:
        """Purpose and promise of the interval, in one sentence for a person."""
        if self.rezero > 0.0:
            what = (
                f"for motions that begin with re-zeroing from {self.rezero:g} s of truth "
                f"({self.trajectories} trajectories seen)"
            )
        elif self.any_homing:
            what = f"for motions after any homing ({self.homings} homings seen)"
        else:
            only = f"{self.homings} homings" if self.homings > 1 else "homing"
            what = (
                f"for motions after the {only} of its {self.trajectories} trajectories only; it "
                f"says nothing of another homing, which takes {needed_trajectories(LEVEL)} homings "
                f"for {100 * LEVEL:g} %, or re-zeroing"
            )
        if not self.folds:
            return what
        of, beyond = f"its {self.trajectories} trajectories", ""
        if self.cut:
            plural = "s" if self.cut > 1 else ""
            of = f"the {self.trajectories} parts of its {self.cut} recording{plural}"
            beyond = ", nor of another day or tool"
        if self.whole:
            beyond = (
                f"; one more recording that errs in its own way may lie outside altogether in 1 of "
                f"{self.whole + 1} cases"
            )
        return (
            f"{what}; cross-conformal over {of}: the stated share is to be expected of more like "
            f"them, as far as {self.folds} fits, each without some of them, err as the fit of all "
            "does; nothing is promised of a speed, load or motion that is not among them" + beyond
        )


def needed_trajectories(level: float) -> int:
    """Fewest calibration trajectories that an interval of that level can be made of.

    9 for 90 %, 19 for 95 %: the smallest n with ``level * (n + 1) <= n``.

    Raises
    ------
    CalibrationError
        If the level is not between 0 and 1.

    Examples
    --------
    >>> needed_trajectories(0.9), needed_trajectories(0.95)
    (9, 19)
    """
    check_level(level)
    return max(1, math.ceil(level / (1.0 - level) - 1e-9))


def check_level(level: float) -> None:
    """Refuse, with CalibrationError, a probability that is not between 0 and 1."""
    if not (isinstance(level, Real) and 0.0 < level < 1.0):
        raise CalibrationError(f"level {level!r:.60} is not a share between 0 and 1, as 0.9")


def inverse_span(lower: Array, upper: Array) -> Array:
    """Inverse length (k,) of the ranges of features; 0 for one that never changed."""
    span = upper - lower
    return np.divide(1.0, span, out=np.zeros_like(span), where=span > 0.0)


@compiled
def range_excess(x: Array, lower: Array, upper: Array, per_span: Array) -> float:
    """Largest share of its training range by which a feature lies outside; 0 if none does.

    `x`, `lower`, `upper` (k,) are features and their ranges in training, `per_span` (k,) is as
    `inverse_span` gives it. A feature that is no number is infinitely far outside.
    """
    worst = 0.0
    for i in range(x.shape[0]):
        if not (x[i] >= lower[i] and x[i] <= upper[i]):  # few are: the sums would wait for each
            worst = max(worst, (lower[i] - x[i]) * per_span[i], (x[i] - upper[i]) * per_span[i])
            if math.isnan(x[i]):
                worst = math.inf
    return worst


@compiled
def range_excesses(X: Array, lower: Array, upper: Array, per_span: Array, out: Array) -> None:
    """`range_excess` of every row of `X` (n, k), into `out` (n,)."""
    for row in range(X.shape[0]):
        out[row] = range_excess(X[row], lower, upper, per_span)
