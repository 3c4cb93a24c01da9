"""Errors of models on folds that their fits did not use: one table, and the fits that fill it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final, NamedTuple, Self

import numpy as np
from scipy.optimize import nnls

from truejoint.array_types import Array, Integers, Mask
from truejoint.calibration.folds import FEW, Fold, hidden_rows
from truejoint.calibration.rows import Rows
from truejoint.errors import CalibrationError
from truejoint.estimators.base import JointRegressor
from truejoint.estimators.family import Target
from truejoint.estimators.polynomial.learn import Raw
from truejoint.estimators.registry import LINEAR, OFFSET, RAW
from truejoint.estimators.wrapped import get_estimator
from truejoint.features.feature_set import FeatureSet

GAIN: Final = math.log(1.0 - 0.1)  # mean logarithm by which the best simple model must be beaten
FITTED_ROWS: Final = 6_000  # that a fit for the choice uses, at most
MOST_ROWS: Final = 30_000  # that models with a history run over, at most, and so many fitted to
TRIED_ON: Final = 2  # folds, after which a candidate is given up if, for each joint,
_WORSE: Final = 0.25  # it is worse than the best by this share and has no weight,
_HOPELESS: Final = 1.0  # or worse by this one,
_AT_ONCE: Final = 2.0  # or by this one after the first, and then with more features too
_ERRORS: Final = 2.0  # standard errors of the mean over folds by which it must be beaten, too
_FURTHEST: Final = 2.0  # spreads of the targets that predictions may have where signals come apart
_LEAST: Final = 0.05  # weight, below which a member is left out
_JUDGED: Final = 100_000  # rows that a fold judges, at most
_TINY: Final = np.finfo(float).tiny


@dataclass(frozen=True, eq=False)
class FoldRows:
    """Rows of all recordings that models of the same features are fitted to and judged on.

    Of recording i, with stamps ``times[i]`` (n_i,) [s], the rows ``kept[i]`` are among them.
    """

    features: FeatureSet
    target: Target
    times: tuple[Array, ...]
    kept: tuple[Integers, ...]
    X: Array  # (m, k)
    dt: Array  # (m,), time since the row before [s], 0 where a history starts
    targets: Array  # (m, n_joints) [rad or m], NaN where no fit uses them
    decoupled: Array  # (m, k), features with every signal taken from another time

    @classmethod
    def of(cls, parts: Sequence[Rows], target: Target, most: int) -> Self:
        """At most so many rows of each recording, evenly spread, and as many of those with targets.

        A history that starts in a row that is left out starts in the next.
        """
        kept, dt, targets = [], [], []
        for part in parts:
            values = part.fitted_targets(target)
            known = np.flatnonzero(np.isfinite(values).any(axis=1))
            rows = np.union1d(_spread(np.arange(len(part)), most), _spread(known, most))
            starts = np.diff(np.cumsum(part.dt == 0.0)[rows], prepend=0) > 0
            dt.append(np.where(starts, 0.0, np.diff(part.t[rows], prepend=part.t[0])))
            targets.append(values[rows])
            kept.append(rows)
        features = parts[0].feature_set
        X = [part.X[rows] for part, rows in zip(parts, kept, strict=True)]
        return cls(
            features,
            target,
            tuple(part.t for part in parts),
            tuple(kept),
            np.concatenate(X),
            np.concatenate(dt),
            np.concatenate(targets),
            np.concatenate([decoupled(values, features) for values in X]),
        )

    @cached_property
    def known(self) -> Mask:
        """Rows (m,) with a target of every joint."""
        return np.asarray(np.isfinite(self.targets).all(axis=1))

    def split(self, fold: Fold) -> tuple[Integers, Integers]:
        """Rows that a fit uses, few enough, and rows that are judged."""
        hidden, judged = [], []
        for index, (t, kept) in enumerate(zip(self.times, self.kept, strict=True)):
            parts = [part for part in fold.parts if part.recording == index]
            hidden.append(hidden_rows(t, parts)[kept])
            among = [part.rows(len(t))[kept] for part in parts]
            judged.append(np.any([np.zeros(len(kept), dtype=bool), *among], axis=0))
        training = np.flatnonzero(self.known & ~np.concatenate(hidden))
        test = np.flatnonzero(self.known & np.concatenate(judged))
        if not len(test):
            raise CalibrationError(f"no row of {fold.name} has a known truth")
        return _spread(training, FITTED_ROWS), _spread(test, _JUDGED)


class Candidate(NamedTuple):
    """A model, and how it was fitted so far."""

    model: JointRegressor  # unfitted; a first fit settles what it determines
    is_member: bool = True  # whether a weighted mean may hold it
    folds: tuple[int, ...] = ()  # numbers of those that it was fitted without
    seconds: float = 0.0
    note: str = ""  # why it is not tried any more
    lacking: str = ""  # why it could not be fitted without the last fold, where that is so


@dataclass(frozen=True, eq=False)
class FoldErrors:
    """Table of errors: of each candidate and pair of candidates, in each fold and joint.

    The choice, its weights and what is given up are functions of it. The simple models that can
    predict the target come first, the linear one before the others.
    """

    rows: FoldRows
    candidates: tuple[Candidate, ...]
    n_simple: int
    products: tuple[Array, ...] = ()
    """For each fold, means (n_joints, m, m) of the products of two candidates' errors; NaN where
    one was not tried."""
    spreads: Array = field(default_factory=lambda: np.zeros((0, 0)))
    """(m, n_joints), largest spread of predictions where signals come apart, over that of the
    targets."""
    hopeless: frozenset[str] = frozenset()
    """Names of the candidates that were given up after the first fold."""

    @classmethod
    def of(cls, rows: FoldRows, models: Sequence[JointRegressor]) -> Self:
        """Table of models before the first fold."""
        usual = get_estimator(LINEAR), get_estimator(OFFSET), Raw()
        simple = [model for model in usual if rows.target in model.family.targets]
        names = [model.name for model in simple]
        others = [model for model in models if model.name not in names]
        candidates = tuple(map(Candidate, [*simple, *others]))
        spreads = np.zeros((len(candidates), rows.targets.shape[1]))
        return cls(rows, candidates, len(simple), spreads=spreads)

    @cached_property
    def usable(self) -> Mask:
        """Which candidates (m, n_joints) do without signals that move together.

        Where no simple model does, as may be of a position, the linear one counts as if it did.
        """
        good = np.asarray(self.spreads <= _FURTHEST)
        good[0] |= ~good[: self.n_simple].any(axis=0)
        return good

    @cached_property
    def alone(self) -> Array:
        """Mean square error (n_folds, m, n_joints) of each candidate, NaN where not tried."""
        return np.array([np.diagonal(product, axis1=1, axis2=2).T for product in self.products])

    def stands(self, number: int) -> bool:
        """Whether a candidate is not given up, and was fitted without half of the folds or more."""
        candidate = self.candidates[number]
        return not candidate.note and 2 * len(candidate.folds) >= len(self.products)

    def weights(self, without: int | None = None) -> Array:
        """Weights (m, n_joints) of the members, of all folds or without one of several.

        Each fold counts by its errors over the least of any: a fold that is easy for all, as of a
        joint at rest, is no more than another.
        """
        folds = [number for number in range(len(self.products)) if number != without] or [0]
        least = np.nanmin(np.where(self.usable, self.alone[folds], np.inf), axis=1)
        scales = np.maximum(least, _TINY)[:, :, None, None]
        relative = np.mean(np.array(self.products)[folds] / scales, axis=0)
        for number, candidate in enumerate(self.candidates):
            is_raw = isinstance(candidate.model, Raw)  # an offset is one anyhow
            if is_raw or not (candidate.is_member and self.stands(number)):
                relative[:, number] = np.nan
        relative[~self.usable.T] = np.nan
        return np.array([stacking_weights(product) for product in relative]).T

    def combined(self) -> tuple[Array, Array]:
        """Weights (m, n_joints): of a mean, or of one candidate, or of the best simple model.

        And the mean square error (n_folds, n_joints), of a mean with the weights of other folds.
        """
        m, best, usable = len(self.candidates), self.weights(), self.usable
        others = [self.weights(without=number) for number in range(len(self.products))]
        square = np.empty((len(others), self.spreads.shape[1]))
        for row, product, w in zip(square, self.products, others, strict=True):
            weighs = w.T[:, :, None] * w.T[:, None, :] > 0.0  # the others may be NaN
            row[:] = np.einsum("mj,jmp,pj->j", w, np.where(weighs, product, 0.0), w)
        weights, errors = np.zeros_like(best), np.empty_like(square)
        for joint in range(errors.shape[1]):
            options = [(best[:, joint], square[:, joint])] + [
                (np.eye(m)[number], self.alone[:, number, joint])
                for number, candidate in enumerate(self.candidates)
                if candidate.is_member and self.stands(number) and usable[number, joint]
            ]
            simple = [o for o in options[1:] if o[0][: self.n_simple].any()]
            linear = self.alone[:, 0, joint]
            yardstick = min(simple, key=lambda o: log_ratio(o[1], linear).mean())[1]
            better = [o for o in options if is_better(log_ratio(o[1], yardstick))]
            chosen = min(better or simple, key=lambda o: log_ratio(o[1], linear).mean())
            weights[:, joint], errors[:, joint] = chosen
        return weights, errors

    def _noting(self, notes: Mapping[int, str]) -> Self:
        """Say why candidates of these numbers are not tried any more."""
        noted = [c._replace(note=notes.get(k, c.note)) for k, c in enumerate(self.candidates)]
        return replace(self, candidates=tuple(noted))

    def given_up(self) -> Self:
        """Say of what was still tried that it is not any more."""
        tried = enumerate(self.candidates)
        return self._noting({k: c.note or c.lacking or _given_up(c) for k, c in tried})

    def passed_by(self, other: Self) -> Self:
        """Do not try what is hopeless in another table, where this one has more features."""
        if not set(other.rows.features.names) <= set(self.rows.features.names):
            return self
        others = list(enumerate(self.candidates))[self.n_simple :]
        lost = [k for k, c in others if c.model.name in other.hopeless and not c.note]
        return self._noting(dict.fromkeys(lost, "hopeless with fewer features"))

    def without_hopeless(self) -> Self:
        """Try no more what no joint needs, nor what is hopeless in every one."""
        sizes = np.where(self.usable, 0.5 * np.log(self.alone + _TINY).mean(axis=0), np.inf)
        worse = sizes - np.nanmin(sizes, axis=0)
        is_first = len(self.products) < TRIED_ON
        unneeded = (worse > math.log1p(_AT_ONCE if is_first else _HOPELESS)).all(axis=1)
        if not is_first:
            unneeded |= (worse > math.log1p(_WORSE)).all(axis=1) & ~self.weights().any(axis=1)
        least = min(TRIED_ON, len(self.products))
        lost = {
            k: c
            for k, c in enumerate(self.candidates)
            if k >= self.n_simple and c.is_member and not c.note
            if unneeded[k] and len(c.folds) >= least
        }
        names = {c.model.name for c in lost.values()} if is_first else set()
        table = self._noting({k: _given_up(c) for k, c in lost.items()})
        return replace(table, hopeless=self.hopeless | names)


def cross_validate(
    table: FoldErrors, fold: Fold, say: Callable[[str, int], None] = lambda _name, _number: None
) -> FoldErrors:
    """Fit the candidates that are not given up without a fold, and add their errors on it.

    `say` is called with the name and number of the candidate that is fitted next. Raises
    CalibrationError if the linear model cannot be fitted.
    """
    rows = table.rows
    training, test = rows.split(fold)
    candidates, spreads = list(table.candidates), table.spreads.copy()
    errors = np.full((len(candidates), len(test), rows.targets.shape[1]), np.nan)
    for number, candidate in enumerate(table.candidates):
        if candidate.note:
            continue
        say(candidate.model.name, number)
        began = time.perf_counter()
        try:
            tried, predicted, spread = _predict(candidate, rows, training, test)
            errors[number] = rows.targets[test] - predicted
            spreads[number] = np.maximum(spreads[number], spread)
            tried = tried._replace(folds=(*tried.folds, len(table.products)))
        except CalibrationError as reason:
            if number == 0:
                raise
            if number < table.n_simple:
                tried = candidate._replace(note=str(reason))
            else:
                tried = candidate._replace(lacking=str(reason))
                # Other folds may show what it does: here the best simple model stands in.
                simple = errors[: table.n_simple]
                usable = replace(table, spreads=spreads).usable[: table.n_simple]
                best = np.nanargmin(np.where(usable, np.mean(simple**2, axis=1), np.inf), axis=0)
                errors[number] = simple[best, :, np.arange(len(best))].T
        seconds = tried.seconds + time.perf_counter() - began
        candidates[number] = tried._replace(seconds=seconds)
    product = np.einsum("mnj,pnj->jmp", errors, errors) / len(test)
    return replace(
        table,
        candidates=tuple(candidates),
        products=(*table.products, product),
        spreads=spreads,
    ).without_hopeless()


def _predict(
    candidate: Candidate, rows: FoldRows, training: Integers, test: Integers
) -> tuple[Candidate, Array, Array]:
    """Fit to the rows `training`, settle what that determined, and predict the rows `test`.

    And how widely (n_joints,) predictions spread where signals come apart, in deviations of the
    targets; that is not asked of more than two recordings.
    """
    model = candidate.model.settled()
    needed = model.minimum_rows(rows.X.shape[1])
    if len(training) < needed:
        raise CalibrationError(
            f"{len(training)} rows with truth beside a part left out; {model.name} needs {needed}: "
            "record for longer, or choose fewer features"
        )
    if model.family.remembers:
        targets = np.full_like(rows.targets, np.nan)
        targets[training] = rows.targets[training]
        model.fit(rows.X, targets, None, rows.dt)
        history = np.cumsum(rows.dt == 0.0)
        run = np.isin(history, history[test])  # what runs before it does not matter
        predicted = model.evaluate(rows.X[run], rows.dt[run])
        predicted = predicted[np.searchsorted(np.flatnonzero(run), test)]
    else:
        model.fit(rows.X[training], rows.targets[training])
        predicted = model.evaluate(np.ascontiguousarray(rows.X[test]))
    is_member = model.family.row is not None and (
        model.family.inputs is None or rows.target == "position"
    )
    spread = np.zeros(predicted.shape[1])
    if len(rows.times) < FEW and model.name not in (RAW, OFFSET):  # of no signal
        known = rows.targets[rows.known]
        middle, deviation = known.mean(axis=0), np.maximum(known.std(axis=0), _TINY)
        far = (model.evaluate(rows.decoupled, rows.dt) - middle) / deviation
        spread = np.sqrt(np.mean(far**2, axis=0))
    return candidate._replace(model=model.settled(), is_member=is_member), predicted, spread


def _given_up(candidate: Candidate) -> str:
    count = len(candidate.folds)
    return f"given up after {count} fold{'s' * (count != 1)}"


def decoupled(features: Array, feature_set: FeatureSet) -> Array:
    """Features (n, k) of one recording with every signal taken from another time of it.

    All features of a signal are moved alike, by so many equal shares of the recording as there are
    signals, and go round at its end.
    """
    signals = feature_set.signals
    moved = np.empty_like(features)
    for number, feature in enumerate(feature_set.features):
        rows = len(features) * signals.index(feature.signal) // len(signals)
        moved[:, number] = np.roll(features[:, number], rows)
    return moved


def share_of(sizes: Sequence[int], most: int) -> int:
    """Rows that each recording may give for all to give `most`: short ones give all they have."""
    rest = most
    for done, size in enumerate(sorted(sizes)):
        share = rest // (len(sizes) - done)
        if size > share:
            return max(share, 1)
        rest -= size
    return max(sizes)


def _spread(rows: Integers, most: int) -> Integers:
    """Give at most so many of the rows (n,), evenly spread."""
    return rows[:: max(1, -(-len(rows) // most))]


def stacking_weights(products: Array) -> Array:
    """Weights (m,), not negative and of sum 1, of the least mean square of the weighted errors.

    `products` (m, m) are the means of the products of two estimators' errors, NaN for those that
    are left out. The weights of non-negative least squares with a sum near 1 point where those
    with a sum of 1 do.
    """
    weights = np.zeros(len(products))
    known = np.flatnonzero(np.isfinite(np.diag(products)))
    kept = known
    while True:
        values, vectors = np.linalg.eigh(products[np.ix_(kept, kept)])
        root = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
        found, _ = nnls(np.vstack([root, np.ones(len(kept))]), np.append(np.zeros(len(kept)), 1.0))
        found /= found.sum()
        large = found >= _LEAST
        if large.all():
            weights[kept] = found
            return weights
        kept = kept[large]


def is_better(ratios: Array) -> bool:
    """Whether errors are smaller without doubt; `ratios` (n_folds,) are of logarithms."""
    if len(ratios) < 2:
        return False
    mean, error = ratios.mean(), ratios.std(ddof=1) / math.sqrt(len(ratios))
    return bool(mean <= GAIN and mean + _ERRORS * error < 0.0)


def log_ratio(square: Array, other: Array) -> Array:
    """Logarithm of the ratio of two errors, of their squares."""
    return np.asarray(0.5 * np.log(np.maximum(square, _TINY) / np.maximum(other, _TINY)))
