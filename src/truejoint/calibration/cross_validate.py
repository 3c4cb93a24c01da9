"""Errors of models on folds that their fits did not use: one table, and the fits that fill it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Final

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

Say = Callable[[float, str], None]
"""Called with the fraction done, 0 to 1, and what is done next, in words."""


@dataclass(eq=False)
class Candidate:
    """A model, and how it was fitted so far."""

    model: JointRegressor  # unfitted; a first fit settles what it determines
    is_member: bool = True  # whether a weighted mean may hold it
    folds: list[int] = field(default_factory=list)  # numbers of those that it was fitted without
    seconds: float = 0.0
    note: str = ""  # why it is not tried any more
    lacking: str = ""  # why it could not be fitted without the last fold, where that is so

    def give_up(self, reason: str = "") -> None:
        """Try it no more, for a `reason` or what it did so far."""
        count = len(self.folds)
        self.note = reason or f"given up after {count} fold{'s' * (count != 1)}"


class CrossValidation:
    """Table of errors: of each candidate and pair of candidates, in each fold and joint.

    `cross_validate` fills it; the choice and its weights are functions of it. The simple models
    that can predict the target come first, the linear one before the others. All see the same rows
    of the same recordings.

    Attributes
    ----------
    kept : list of ndarray
        Rows of each recording that are among the m rows.
    X, decoupled : ndarray, shape (m, k)
        Features; the same with every signal taken from another time.
    dt : ndarray, shape (m,)
        Time since the row before [s], 0 where a history starts.
    targets : ndarray, shape (m, n_joints)
        [rad or m]; NaN where no fit uses them.
    products : list of ndarray, shape (n_joints, n_candidates, n_candidates)
        Mean product of two candidates' errors, for each fold; NaN where one was not tried.
    spreads : ndarray, shape (n_candidates, n_joints)
        Largest spread of predictions where signals come apart, over that of the targets.
    hopeless : set of str
        Names of the candidates that were given up after the first fold.
    """

    def __init__(
        self, parts: Sequence[Rows], target: Target, models: Sequence[JointRegressor], most: int
    ) -> None:
        """Take at most `most` rows of each recording, and as many of those with targets.

        A history that starts in a row that is left out starts in the next.
        """
        self.features: FeatureSet = parts[0].feature_set
        self.target: Target = target
        self.times = [part.t for part in parts]
        self.kept, steps, targets = list[Integers](), list[Array](), list[Array]()
        for part in parts:
            values = part.fitted_targets(target)
            has_target = np.flatnonzero(np.isfinite(values).any(axis=1))
            rows = np.union1d(_spread(np.arange(len(part)), most), _spread(has_target, most))
            starts = np.diff(np.cumsum(part.dt == 0.0)[rows], prepend=0) > 0
            steps.append(np.where(starts, 0.0, np.diff(part.t[rows], prepend=part.t[0])))
            targets.append(values[rows])
            self.kept.append(rows)
        features = [part.X[rows] for part, rows in zip(parts, self.kept, strict=True)]
        self.X, self.dt, self.targets = (
            np.concatenate(arrays) for arrays in (features, steps, targets)
        )
        self.decoupled = np.concatenate([decoupled(x, self.features) for x in features])
        self.has_target = np.isfinite(self.targets).all(axis=1)
        usual = get_estimator(LINEAR), get_estimator(OFFSET), Raw()
        simple = [model for model in usual if target in model.family.targets]
        names = {model.name for model in simple}
        others = [model for model in models if model.name not in names]
        self.candidates = [Candidate(model) for model in (*simple, *others)]
        self.n_simple = len(simple)
        self.products: list[Array] = []
        self.spreads = np.zeros((len(self.candidates), self.targets.shape[1]))
        self.hopeless: set[str] = set()

    def split(self, fold: Fold) -> tuple[Integers, Integers]:
        """Rows that a fit uses, few enough, and rows that are judged."""
        hidden, judged = [], []
        for index, (t, kept) in enumerate(zip(self.times, self.kept, strict=True)):
            parts = [part for part in fold.parts if part.recording == index]
            hidden.append(hidden_rows(t, parts)[kept])
            masks = [part.rows(len(t))[kept] for part in parts]
            judged.append(np.any([np.zeros(len(kept), dtype=bool), *masks], axis=0))
        training = np.flatnonzero(self.has_target & ~np.concatenate(hidden))
        test = np.flatnonzero(self.has_target & np.concatenate(judged))
        if not len(test):
            raise CalibrationError(f"no row of {fold.name} has a known truth")
        return _spread(training, FITTED_ROWS), _spread(test, _JUDGED)

    @property
    def usable(self) -> Mask:
        """Which candidates (n_candidates, n_joints) do without signals that move together.

        Where no simple model does, as may be of a position, the linear one counts as if it did.
        """
        usable = np.asarray(self.spreads <= _FURTHEST)
        usable[0] |= ~usable[: self.n_simple].any(axis=0)
        return usable

    @property
    def alone(self) -> Array:
        """Mean square error (n_folds, n_candidates, n_joints), NaN where one was not tried."""
        return np.array([np.diagonal(product, axis1=1, axis2=2).T for product in self.products])

    def stands(self, number: int) -> bool:
        """Whether a candidate is not given up, and was fitted without half of the folds or more."""
        candidate = self.candidates[number]
        return not candidate.note and 2 * len(candidate.folds) >= len(self.products)

    def weights(self, without: int | None = None) -> Array:
        """Weights (n_candidates, n_joints) of the members, of all folds or `without` one.

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
        """Weights (n_candidates, n_joints): of a mean, of one candidate, or of the best simple one.

        And the mean square error (n_folds, n_joints), of a mean with the weights of other folds.
        """
        usable, alone, weights = self.usable, self.alone, self.weights()
        errors = np.empty((len(self.products), weights.shape[1]))
        for fold, product in enumerate(self.products):
            w = self.weights(without=fold)
            weighs = w.T[:, :, None] * w.T[:, None, :] > 0.0  # the others may be NaN
            errors[fold] = np.einsum("mj,jmp,pj->j", w, np.where(weighs, product, 0.0), w)
        members = [k for k, c in enumerate(self.candidates) if c.is_member and self.stands(k)]
        for joint in range(weights.shape[1]):
            numbers = [k for k in members if usable[k, joint]]
            options = np.vstack([weights[:, joint], np.eye(len(self.candidates))[numbers]])
            squares = np.vstack([errors[:, joint], alone[:, numbers, joint].T])
            ratios = log_ratio(squares, alone[:, 0, joint]).mean(axis=1)
            simple = 1 + np.flatnonzero(np.array(numbers) < self.n_simple)
            yardstick = squares[min(simple, key=ratios.__getitem__)]
            better = [k for k, s in enumerate(squares) if is_better(log_ratio(s, yardstick))]
            best = min(better or simple, key=ratios.__getitem__)
            weights[:, joint], errors[:, joint] = options[best], squares[best]
        return weights, errors

    def pass_by(self, other: CrossValidation) -> None:
        """Do not try what is hopeless in another table, where this one has more features."""
        if set(other.features.names) <= set(self.features.names):
            for candidate in self.candidates[self.n_simple :]:
                if candidate.model.name in other.hopeless and not candidate.note:
                    candidate.give_up("hopeless with fewer features")

    def give_up_hopeless(self) -> None:
        """Try no more what no joint needs, nor what is hopeless in every one."""
        sizes = np.where(self.usable, 0.5 * np.log(self.alone + _TINY).mean(axis=0), np.inf)
        worse = sizes - np.nanmin(sizes, axis=0)
        is_first = len(self.products) < TRIED_ON
        unneeded = (worse > math.log1p(_AT_ONCE if is_first else _HOPELESS)).all(axis=1)
        if not is_first:
            unneeded |= (worse > math.log1p(_WORSE)).all(axis=1) & ~self.weights().any(axis=1)
        unneeded[: self.n_simple] = False
        for candidate in (self.candidates[k] for k in np.flatnonzero(unneeded)):
            is_tried = candidate.is_member and not candidate.note
            if is_tried and len(candidate.folds) >= min(TRIED_ON, len(self.products)):
                candidate.give_up()
                if is_first:
                    self.hopeless.add(candidate.model.name)


def cross_validate(table: CrossValidation, fold: Fold, say: Say) -> None:
    """Fit the candidates that are not given up without a fold, and add their errors on it.

    `say` is called with the share of candidates done, and what is fitted next. Raises
    CalibrationError, and adds nothing, if the linear model cannot be fitted.
    """
    training, test = table.split(fold)
    errors = np.full((len(table.candidates), len(test), table.targets.shape[1]), np.nan)
    for number, candidate in enumerate(table.candidates):
        if candidate.note:
            continue
        say(number / len(table.candidates), f"Choosing: {candidate.model.name} without {fold.name}")
        began = time.perf_counter()
        try:
            predicted, spread = _predict(candidate, table, training, test)
            errors[number] = table.targets[test] - predicted
            table.spreads[number] = np.maximum(table.spreads[number], spread)
            candidate.folds.append(len(table.products))
        except CalibrationError as reason:
            if number == 0:
                raise
            if number < table.n_simple:
                candidate.note = str(reason)
            else:
                candidate.lacking = str(reason)
                # Other folds may show what it does: here the best simple model stands in.
                simple = errors[: table.n_simple]
                square = np.where(
                    table.usable[: table.n_simple], np.mean(simple**2, axis=1), np.inf
                )
                best = np.nanargmin(square, axis=0)
                errors[number] = simple[best, :, np.arange(len(best))].T
        candidate.seconds += time.perf_counter() - began
    table.products.append(np.einsum("mnj,pnj->jmp", errors, errors) / len(test))
    table.give_up_hopeless()


def _predict(
    candidate: Candidate, table: CrossValidation, training: Integers, test: Integers
) -> tuple[Array, Array]:
    """Fit to the rows `training`, settle what that determined, and predict the rows `test`.

    And how widely (n_joints,) predictions spread where signals come apart, in deviations of the
    targets; that is not asked of more than two recordings.
    """
    model = candidate.model.settled()
    needed = model.minimum_rows(table.X.shape[1])
    if len(training) < needed:
        raise CalibrationError(
            f"{len(training)} rows with truth beside a part left out; {model.name} needs {needed}: "
            "record for longer, or choose fewer features"
        )
    if model.family.remembers:
        targets = np.full_like(table.targets, np.nan)
        targets[training] = table.targets[training]
        model.fit(table.X, targets, None, table.dt)
        history = np.cumsum(table.dt == 0.0)
        run = np.isin(history, history[test])  # what runs before it does not matter
        predicted = model.evaluate(table.X[run], table.dt[run])
        predicted = predicted[np.searchsorted(np.flatnonzero(run), test)]
    else:
        model.fit(table.X[training], table.targets[training])
        predicted = model.evaluate(np.ascontiguousarray(table.X[test]))
    spread = np.zeros(predicted.shape[1])
    if len(table.times) < FEW and model.name not in (RAW, OFFSET):  # of no signal
        targets = table.targets[table.has_target]
        middle, deviation = targets.mean(axis=0), np.maximum(targets.std(axis=0), _TINY)
        far = (model.evaluate(table.decoupled, table.dt) - middle) / deviation
        spread = np.sqrt(np.mean(far**2, axis=0))
    family, candidate.model = model.family, model.settled()
    candidate.is_member = family.row is not None and (
        family.inputs is None or table.target == "position"
    )
    return predicted, spread


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
    members = np.flatnonzero(np.isfinite(np.diag(products)))
    while True:
        values, vectors = np.linalg.eigh(products[np.ix_(members, members)])
        root = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
        n = len(members)
        shares, _ = nnls(np.vstack([root, np.ones(n)]), np.append(np.zeros(n), 1.0))
        shares /= shares.sum()
        large = shares >= _LEAST
        if large.all():
            weights[members] = shares
            return weights
        members = members[large]


def is_better(ratios: Array) -> bool:
    """Whether errors are smaller without doubt; `ratios` (n_folds,) are of logarithms."""
    if len(ratios) < 2:
        return False
    mean, error = ratios.mean(), ratios.std(ddof=1) / math.sqrt(len(ratios))
    return bool(mean <= GAIN and mean + _ERRORS * error < 0.0)


def log_ratio(square: Array, other: Array) -> Array:
    """Logarithm of the ratio of two errors, of their squares."""
    return np.asarray(0.5 * np.log(np.maximum(square, _TINY) / np.maximum(other, _TINY)))
