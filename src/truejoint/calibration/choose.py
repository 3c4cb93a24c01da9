"""Which estimator to use for each joint: what is best on recordings that a fit did not use.

Errors of models on folds that their fits did not use stand in one table, which a cross-validation
fills; the choice and its weights are functions of it.
"""

import math
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from typing import Any, Final

import numpy as np
from scipy.optimize import nnls

from truejoint.array_types import Array, Integers, Mask
from truejoint.calibration import compatibility, fit_task
from truejoint.calibration.calibration import Calibration
from truejoint.calibration.folds import (
    FEW,
    FOLDS,
    GAP,
    SORTED_FROM,
    Fold,
    folds,
    hidden_rows,
    inside,
)
from truejoint.calibration.origin import distinct
from truejoint.calibration.rows import Rows
from truejoint.calibration.truth_zero import judged_error, known_error
from truejoint.compiled import working_times
from truejoint.errors import CalibrationError
from truejoint.estimators.base import JointRegressor, Progress
from truejoint.estimators.family import TARGETS, Target, evaluate
from truejoint.estimators.polynomial.learn import Raw
from truejoint.estimators.registry import BESIDE_FILTER, FILTER_WITH_TREES, LINEAR, OFFSET, RAW
from truejoint.estimators.stack.learn import Stack
from truejoint.estimators.stack.run import MAX_MEMBERS
from truejoint.estimators.wrapped import Regressor, candidates, get_estimator
from truejoint.features.feature_set import (
    FeatureSet,
    default_features,
    default_gap_limit,
    sample_dt,
)
from truejoint.recordings import Recording
from truejoint.robots import Robot

GAIN: Final = math.log(1.0 - 0.1)  # mean logarithm by which zeros of recordings must be better,
_ERRORS: Final = 2.0  # and standard errors of that mean
_EQUAL: Final = 0.02  # of the least expected error, by which the linear model may be worse
FITTED_ROWS: Final = 6_000  # that a fit for the choice uses, at most
MOST_ROWS: Final = 30_000  # that models with a history run over, at most, and so many fitted to
_TRIED_ON: Final = 2  # folds, after which a candidate is given up if, for each joint,
_WORSE: Final = 0.25  # it is worse than the best by this share and has no weight,
_HOPELESS: Final = 1.0  # or worse by this one
_LEAST_FOLDS: Final = 3  # that are judged, whatever they take
_FURTHEST: Final = 2.0  # spreads of the targets that predictions may have where signals come apart
_FORCES: Final = ("effort", "current")  # what tells more than where a joint is
_BEARS: Final = 1.5  # times the least error that a model which holds under loads may have
_BELIEF: Final = 0.3  # weight of what is believed of a mean beside what is left out
_FIRM: Final = 1e3  # weight of the sum of 1
_LEAST: Final = 0.05  # weight, below which a member is left out
_JUDGED: Final = 100_000  # rows that a fold judges, at most
_TINY: Final = np.finfo(float).tiny
_FIRST_SHARE: Final = 0.8  # of the progress, where what was chosen is tried with more features
_CHOICE_SHARE: Final = 0.6  # of the budget; fits to all rows take the rest

_MORE: Final = tuple(("measured", "effort", *more) for more in ((), ("current",), ("cable",)))
"""Quantities of which a choice tries all columns, where it chooses features."""
_RATE_TIME: Final = 0.02  # [s] of the low-pass whose slope is the rate that a choice tries
_RATE_DT: Final = 0.101  # [s] between rows, beyond which they show steps and no rates; 10 Hz do
_REZERO: Final = 2.0  # [s] of truth that each recording is re-zeroed from to be judged,
_SHARE: Final = 0.1  # or this share of the shortest one
_ZEROS_TRIED_ON: Final = 3  # parts, after which zeros that are no better so far are given up

Say = Callable[[float, str], None]
"""Called with the fraction done, 0 to 1, and what is done next, in words."""


@dataclass(eq=False)
class Candidate:
    """A model of some features, and how it was fitted so far."""

    model: JointRegressor  # unfitted
    features: tuple[str, ...]
    target: Target
    is_simple: bool = False
    is_believed: bool = False  # whether it is made for such a mechanism, and so tried on all folds
    folds: list[int] = field(default_factory=list)  # numbers of those that it was fitted without
    errors: dict[int, Array] = field(default_factory=dict)
    """(n_rows, n_joints) by fold [rad or m]; of a simple model where it could not be fitted."""
    unheld: dict[int, Array] = field(default_factory=dict)
    """The same where it is not held to the range of its training, of folds with rows beyond."""
    spread: Array | float = 0.0
    """Largest (n_joints,) of predictions where signals come apart, over that of the targets."""
    seconds: float = 0.0
    step: float = 0.0  # time of its row [s], the least of any fold; 0: it was not fitted
    n_bytes: int = 0  # of what it learnt
    note: str = ""  # why it is not tried any more
    lacking: str = ""  # why it could not be fitted without the last fold, where that is so

    @property
    def is_held(self) -> bool:
        """Whether it errs less if it is held to the range of its training: mean of logarithms."""
        pairs = [(self.errors[number], error) for number, error in self.unheld.items()]
        squares = [np.mean(np.square(pair), axis=1) for pair in pairs]
        return bool(squares) and float(np.mean([log_ratio(*pair) for pair in squares])) < 0.0

    def judged(self, number: int) -> Array | None:
        """Errors (n_rows, n_joints) in a fold, held to its range or not; None if not tried."""
        errors = self.errors.get(number)
        return errors if self.is_held else self.unheld.get(number, errors)

    @cached_property
    def bears_load(self) -> bool:
        """Whether it still holds where a load moves the joint off what its motor says."""
        return self.model.family.bears_load(self.model.model_params())


class CrossValidation:
    """Table of errors: of each candidate and pair of candidates, in each fold and joint.

    `cross_validate` fills it; the choice and its weights are functions of it. The simple models
    that can predict the target come first, the linear one before the others. All see the same m
    rows, numbers `rows` among those of all `parts`, and are judged by what they leave of the true
    position. `X` (m, k) has the features of all, `dt` (m,) the time since the row before [s], 0
    where a history starts; `measured` and `targets` (m, n_joints) are in rad or m, the latter truth
    minus measured, NaN where no fit uses them. `products` of each fold (n_joints, n_candidates,
    n_candidates) are the mean products of two candidates' errors, NaN where one was not tried.
    """

    def __init__(self, parts: Sequence[Rows], candidates: Sequence[Candidate], most: int) -> None:
        """Take at most `most` rows of each recording, and as many of those with targets.

        A history that starts in a row that is left out starts in the next.
        """
        self.parts, self.candidates = parts, list(candidates)
        self.folds, self.products = list[Fold](), list[Array]()
        self.features: FeatureSet = parts[0].feature_set
        self._starts, rows = np.cumsum([0, *map(len, parts)]), list[Integers]()
        targets = [part.fitted_targets("error") for part in parts]
        for values, start in zip(targets, self._starts, strict=False):
            has_target = np.flatnonzero(np.isfinite(values).any(axis=1))
            every = _spread(np.arange(len(values)), most)
            rows.append(start + np.union1d(every, _spread(has_target, most)))
        self.rows, self.targets = np.concatenate(rows), np.concatenate(targets)
        self.targets = self.targets[self.rows]
        self.has_target = np.isfinite(self.targets).all(axis=1)
        self.X, self.measured, t = (
            np.concatenate([getattr(part, name) for part in parts])[self.rows]
            for name in ("X", "measured", "t")
        )
        history = np.cumsum(np.concatenate([part.dt for part in parts]) == 0.0)[self.rows]
        self.dt = np.where(np.diff(history, prepend=0) > 0, 0.0, np.diff(t, prepend=0.0))

    @cached_property
    def decoupled(self) -> Array:
        """Features (m, k) with every signal taken from another time of its recording."""
        pieces = np.split(self.X, np.searchsorted(self.rows, self._starts[1:-1]))
        return np.concatenate([decoupled(piece, self.features) for piece in pieces])

    def split(self, fold: Fold) -> tuple[Integers, Integers]:
        """Rows that a fit uses, few enough, and rows that are judged."""
        hidden, judged = (
            np.concatenate([
                hidden_rows(part.t, fold.parts, index, gap) for index, part in enumerate(self.parts)
            ])[self.rows]
            for gap in (GAP, 0.0)
        )  # fmt: skip
        training = _spread(np.flatnonzero(self.has_target & ~hidden), FITTED_ROWS)
        test = _spread(np.flatnonzero(self.has_target & judged), _JUDGED)
        if not len(test):
            raise CalibrationError(f"no row of {fold.name} has a known truth")
        return training, test

    def history(self, test: Integers) -> Integers:
        """Rows that a model with a memory runs over to predict the rows `test`; none is before."""
        history = np.cumsum(self.dt == 0.0)
        return np.flatnonzero(np.isin(history[: test[-1] + 1], history[test]))

    def multiplied(self, number: int) -> Array:
        """Mean products (n_joints, n_candidates, n_candidates) of errors in a fold, as now held."""
        tried = [candidate.judged(number) for candidate in self.candidates]
        untried = np.full_like(next(one for one in tried if one is not None), np.nan)
        errors = np.array([untried if one is None else one for one in tried])
        return np.asarray(np.einsum("mnj,pnj->jmp", errors, errors) / len(untried))

    @property
    def usable(self) -> Mask:
        """Which candidates (n_candidates, n_joints) do without signals that move together.

        Where no simple model does, as may be of a position, the linear one counts as if it did.
        """
        n_joints = self.targets.shape[1]
        spreads = [np.broadcast_to(candidate.spread, n_joints) for candidate in self.candidates]
        usable = np.asarray(np.array(spreads) <= _FURTHEST)
        usable[0] |= ~usable[: self.n_simple].any(axis=0)
        return usable

    @property
    def seconds(self) -> float:
        """Time that all fits took [s], see `working_times`."""
        return sum(candidate.seconds for candidate in self.candidates)

    @property
    def n_simple(self) -> int:
        """How many of the candidates, the first, are simple models."""
        return sum(candidate.is_simple for candidate in self.candidates)

    @property
    def alone(self) -> Array:
        """Mean square error (n_folds, n_candidates, n_joints), NaN where one was not tried."""
        return np.array([np.diagonal(product, axis1=1, axis2=2).T for product in self.products])

    @property
    def yardstick(self) -> Array:
        """Mean square error (n_folds, n_joints) of the best simple model in each fold."""
        simple = np.where(self.usable, self.alone, np.inf)[:, : self.n_simple]
        return np.asarray(np.nanmin(simple, axis=1))

    @property
    def belief(self) -> Array:
        """Weights (n_candidates,) that are believed in before: half and half of a pair, or none."""
        pair = [c.is_believed and not c.bears_load and self.stands(c) for c in self.candidates]
        return np.array(pair) * (0.5 if sum(pair) == 2 else 0.0)

    @property
    def eligible(self) -> Mask:
        """Which usable candidates (n_candidates, n_joints) are to be chosen from.

        Where a model of the mechanism, which holds under loads too, errs no more than half as much
        again as the best, only such: what is left out may have known no load.
        """
        eligible = self.usable
        bearing = np.array([c.bears_load and self.stands(c) for c in self.candidates])
        if bearing.any():
            squares = np.where(eligible & np.isfinite(self.alone), self.alone, np.inf)
            expected = relative_error(squares, self.yardstick[:, None])
            has_one = expected[bearing].min(axis=0) <= _BEARS * expected.min(axis=0)
            eligible &= ~has_one | bearing[:, None]
        return eligible

    def stands(self, candidate: Candidate) -> bool:
        """Whether a candidate is not given up, and was fitted without half of the folds or more."""
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
            if is_raw or not self.stands(candidate):
                relative[:, number] = np.nan
        relative[~self.eligible.T] = np.nan
        belief = self.belief
        return np.array([stacking_weights(product, belief) for product in relative]).T

    def combined(self) -> tuple[Array, Array]:
        """Weights (n_candidates, n_joints) of the least expected error, and its squares.

        Each fold (n_folds, n_joints) is judged with the weights of the others. The error that is
        expected is the mean over the folds of the error relative to that of the best simple model
        there. Where that is hardly worse, the linear model is taken before a mean. Raw position and
        offset are only where every correction does harm (`is_harmed`).
        """
        eligible, weights = self.eligible, self.weights()
        errors = np.empty((len(self.products), weights.shape[1]))
        for fold, products in enumerate(self.products):
            w = self.weights(without=fold)
            weighs = w.T[:, :, None] * w.T[:, None, :] > 0.0  # the others may be NaN
            errors[fold] = np.einsum("mj,jmp,pj->j", w, np.where(weighs, products, 0.0), w)
        simple = [k for k in range(self.n_simple) if self.stands(self.candidates[k])]
        for joint, yardstick in enumerate(self.yardstick.T):
            numbers = [k for k in simple if eligible[k, joint]]
            squares = np.column_stack([self.alone[:, numbers, joint], errors[:, joint]])
            expected, best = relative_error(squares, yardstick[:, None]), len(numbers)
            least = int(np.argmin(expected))
            if 0 in numbers and expected[0] <= (1.0 + _EQUAL) * expected[best]:
                best = 0
            is_idle = least < len(numbers) and numbers[least] > 0  # raw position or offset
            if is_idle and is_harmed(squares[:, [best, least]], yardstick):
                best = least
            if best < len(numbers):
                weights[:, joint], errors[:, joint] = 0.0, squares[:, best]
                weights[numbers[best], joint] = 1.0
        return at_most(MAX_MEMBERS, weights), errors

    def give_up_hopeless(self) -> None:
        """Try no more what no joint needs, nor what is hopeless in every one."""
        if len(self.products) < _TRIED_ON:
            return
        sizes = np.where(self.usable, 0.5 * np.log(self.alone + _TINY).mean(axis=0), np.inf)
        worse = sizes - np.nanmin(sizes, axis=0)
        is_idle = ~np.asarray(self.weights().any(axis=1))
        names = np.array([candidate.model.name for candidate in self.candidates])
        for number, candidate in enumerate(self.candidates):
            is_beaten = (worse[names == names[number]] < worse[number]).all(axis=1).any()
            is_worse, is_hopeless = (
                (worse[number] > math.log1p(share)).all() for share in (_WORSE, _HOPELESS)
            )
            is_needed = not (is_hopeless or (is_idle[number] and (is_worse or is_beaten)))
            stays = candidate.is_simple or candidate.is_believed
            if not (is_needed or stays or candidate.note) and len(candidate.folds) >= _TRIED_ON:
                candidate.note = f"given up after {len(candidate.folds)} folds"

    def keep_within(self, seconds: float, n_folds: int) -> bool:
        """Whether so many more folds can be tried in so many seconds, or it is too early to tell.

        What takes longest of the candidates that no joint needs so far is given up first.
        """
        times = {c: c.seconds / len(c.folds) for c in self.candidates if not c.note and c.folds}
        needed = dict(zip(self.candidates, np.asarray(self.weights().any(axis=1)), strict=True))
        idle = [c for c in times if not (needed[c] or c.is_simple)]
        for candidate in sorted(idle, key=lambda c: -times[c]):
            if n_folds * sum(times.values()) <= seconds:
                break
            candidate.note = f"cut: {times.pop(candidate):.1f} s a part"
        return len(self.products) < _LEAST_FOLDS or sum(times.values()) <= seconds


def cross_validate(table: CrossValidation, number: int, fold: Fold, say: Say) -> None:
    """Fit what is not given up without a fold, of this `number`, and set down its errors there.

    Of a fold that was tried before, only what it has not seen. Raises CalibrationError, and adds
    nothing, if the linear model cannot be fitted.
    """
    training, test = table.split(fold)
    were_held = [candidate.is_held for candidate in table.candidates]
    for place, candidate in enumerate(table.candidates):
        if candidate.note or number in candidate.errors:
            continue
        say(place / len(table.candidates), f"Choosing: {candidate.model.name} without {fold.name}")
        began = working_times()
        try:
            candidate.errors[number] = _errors_of(candidate, table, training, test)
            if _goes_beyond(candidate, table, training, test):
                candidate.unheld[number] = _errors_of(candidate, table, training, test, held=False)
            candidate.folds.append(number)
        except CalibrationError as reason:
            if place == 0:
                raise
            if candidate.is_simple:
                candidate.note = str(reason)
            else:
                candidate.lacking = str(reason)
                # Other folds may show what it does: here the best simple model stands in.
                fitted = [k for k in range(table.n_simple) if number in table.candidates[k].errors]
                simple = np.array([table.candidates[k].errors[number] for k in fitted])
                square = np.where(table.usable[fitted], np.mean(simple**2, axis=1), np.inf)
                best = np.argmin(square, axis=0)
                candidate.errors[number] = simple[best, :, np.arange(len(best))].T
        candidate.seconds += max(0.0, float(np.min(working_times() - began)))
    is_new = number == len(table.folds)
    if is_new:
        table.folds.append(fold)
    if were_held == [candidate.is_held for candidate in table.candidates]:
        table.products[number:] = [table.multiplied(number), *table.products[number + 1 :]]
    else:
        table.products = [table.multiplied(each) for each in range(len(table.folds))]
    if is_new:
        table.give_up_hopeless()


def _errors_of(
    candidate: Candidate,
    table: CrossValidation,
    training: Integers,
    test: Integers,
    held: bool = True,
) -> Array:
    """Fit to the rows `training`, settle what that determined, and give the errors of rows `test`.

    And see how widely predictions spread where signals come apart, in deviations of the targets;
    that is not asked of more than two recordings.
    """
    places = map(table.features.names.index, candidate.features)
    model = Stack((candidate.model,), sees=(tuple(places),), held=(held,))
    needed = model.minimum_rows(len(candidate.features))
    if len(training) < needed:
        raise CalibrationError(
            f"{len(training)} rows with truth beside a part left out; {model.name} needs {needed}: "
            "record for longer, or choose fewer features"
        )
    measured = table.measured * (candidate.target == "position")
    values = table.targets + measured
    if model.family.remembers:
        targets = np.full_like(values, np.nan)
        targets[training] = values[training]
        names = model.truth_beside()
        loads = np.concatenate([fit_task.known_loads(p.recording, names) for p in table.parts])
        model.fit(table.X, targets, None, table.dt, loads[table.rows])
        run = table.history(test)
    else:
        model.fit(table.X[training], values[training])
        run = test
    rows, dt = table.X[run], table.dt[run]
    if model.members_[0].family.row is None:
        candidate.note = "only works offline, so it is used where it is named alone"
        predicted = model.evaluate(rows, dt)
    else:
        memory, began = model.memory(), time.perf_counter()
        predicted = evaluate(model.family, memory, rows, dt, model.n_outputs_)
        step = (time.perf_counter() - began) / len(rows)
        candidate.step = min(candidate.step or math.inf, step)
    predicted = predicted[np.searchsorted(run, test)]
    candidate.n_bytes = sum(values.nbytes for values in model.arrays_.values())
    if len(table.parts) < FEW and model.name not in (RAW, OFFSET):  # of no signal
        targets = values[table.has_target]
        middle, deviation = targets.mean(axis=0), np.maximum(targets.std(axis=0), _TINY)
        far = (model.evaluate(table.decoupled, table.dt) - middle) / deviation
        candidate.spread = np.maximum(candidate.spread, np.sqrt(np.mean(far**2, axis=0)))
    return np.asarray(table.targets[test] - (predicted - measured[test]))


def _goes_beyond(
    candidate: Candidate, table: CrossValidation, training: Integers, test: Integers
) -> bool:
    """Whether the rows `test` go beyond the range that a fit to `training` may be held to."""
    if candidate.is_simple or candidate.model.family.inputs is not None:
        return False
    places = list(map(table.features.names.index, candidate.features))
    run = table.history(test) if candidate.model.family.remembers else test
    known, judged = (table.X[rows][:, places] for rows in (training, run))
    return bool(((judged < known.min(axis=0)) | (judged > known.max(axis=0))).any())


def decoupled(features: Array, feature_set: FeatureSet) -> Array:
    """Features (n, k) of one recording with every signal taken from another time of it.

    All features of a signal move alike, by a share of the recording, and go round at its end.
    Sensors that follow one joint cannot come apart and count as one signal: those of its channel
    and, where a single joint is measured, of its cables.
    """
    joints = {signal for signal in feature_set.signals if signal.startswith("measured/")}

    def group(signal: str) -> str:
        quantity, _, channel = signal.partition("/")
        if quantity in _FORCES:
            return signal
        return channel if len(joints) > 1 else "joint"

    groups = list(dict.fromkeys(map(group, feature_set.signals)))
    moved = np.empty_like(features)
    for number, feature in enumerate(feature_set.features):
        rows = len(features) * groups.index(group(feature.signal)) // len(groups)
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


def stacking_weights(products: Array, belief: Array | None = None) -> Array:
    """Weights (m,), not negative and of sum 1, of the least mean square of the weighted errors.

    `products` (m, m) are mean products of two estimators' errors, NaN for those left out. Weights
    believed in before, `belief` (m,), of sum 1, hold them back as ridge regression does: squares of
    what they differ by count `_BELIEF` times the mean square error of these.
    """
    weights, held = np.zeros(len(products)), np.zeros(len(products)) if belief is None else belief
    members = np.flatnonzero(np.isfinite(np.diag(products)))
    while True:
        square = products[np.ix_(members, members)]
        values, vectors = np.linalg.eigh(square)
        root = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
        n, prior = len(members), held[members]
        pull = math.sqrt(_BELIEF * max(float(prior @ square @ prior), 0.0))
        firm = _FIRM * math.sqrt(max(float(square.max()), _TINY))
        shares, _ = nnls(
            np.vstack([root, pull * np.eye(n), np.full(n, firm)]),
            np.concatenate([np.zeros(n), pull * prior, [firm]]),
        )
        shares /= shares.sum()
        large = shares >= _LEAST
        if large.all():
            weights[members] = shares
            return weights
        members = members[large]


def at_most(count: int, weights: Array) -> Array:
    """Weights (m, n_joints) of so many members: those that a joint needs most share the others'."""
    need = weights.max(axis=1)
    if np.count_nonzero(need) <= count:
        return weights
    need[weights.argmax(axis=0)] += 1.0  # each joint keeps its first
    shares = np.where(np.isin(range(len(need)), np.argsort(-need)[:count])[:, None], weights, 0.0)
    return np.asarray(shares / shares.sum(axis=0))


def mean_and_error(values: Array) -> tuple[float, float]:
    """Mean of values (n,) and its standard error, 0 where there is one alone."""
    n = len(values)
    return float(values.mean()), float(values.std(ddof=1)) / math.sqrt(n) if n > 1 else 0.0


def log_ratio(square: Array, other: Array) -> Array:
    """Logarithm of the ratio of two errors, of their squares."""
    return np.asarray(0.5 * np.log(np.maximum(square, _TINY) / np.maximum(other, _TINY)))


def is_harmed(squares: Array, yardstick: Array) -> bool:
    """Whether a correction's errors are larger than those without it, of `squares` (n_folds, 2).

    By more than the standard error of the mean difference, each fold relative to its yardstick.
    """
    sides = np.sqrt(squares.T / np.maximum(yardstick, _TINY))
    mean, error = mean_and_error(np.subtract(*sides))
    return mean > error


def relative_error(squares: Array, yardstick: Array) -> Array:
    """Mean over folds, the first axis, of the root of `squares` over that of the yardstick."""
    ratios = np.maximum(squares, _TINY) / np.maximum(yardstick, _TINY)
    return np.asarray(np.sqrt(ratios).mean(axis=0))


@dataclass(frozen=True, eq=False)
class Automatic:
    """Estimators among which each joint is given what predicts it best: stacked regressions.

    Every candidate is fitted without some of the recordings in turn, never without single samples,
    and judged on these. It is held to its training range where it errs less so (`Stack`). A joint
    is given what has the least expected error there: a mean of several (Breiman, Stacked
    regressions, Machine Learning 24, 1996) or one alone; raw position and offset where every
    correction did harm. The fits that serve the choice see six thousand rows; what is chosen is
    fitted to all. The metadata list what was tried under ``choice``.

    Without features the default ones are tried, every measured position and effort, and these with
    every motor current or cable that all recordings have; then, of three recordings or more whose
    rows are at most 0.1 s apart, what has a weight once more, with the rates of the measured
    positions beside.

    With three recordings or more the choice also judges a fit with a zero for each recording. Each
    recording that is left out is then re-zeroed from its first 2 s. It is then kept beside the
    other, as ``zero="recording"`` of `calibrate` does it; ``zero="shared"`` leaves that out. Parts
    of one or two cannot tell what each of several signals does that always moved together: there a
    candidate whose predictions spread twice as widely as the targets, with every signal taken from
    another time, is not used for that joint.

    Parameters
    ----------
    candidates : sequence of Regressor
        Candidates; by default those of the registry. One with its own features is tried where the
        recordings have them; one that only works offline is not chosen.
    seconds : float
        Time that the choice and the fit may take, about: on a quiet machine, and without the time
        that kernels take to compile on their first use. Raises CalibrationError for no time.
    tell : callable, optional
        Called with what is done next, in words.

    Examples
    --------
    >>> from sklearn.linear_model import Ridge
    >>> chosen = truejoint.calibrate(training, Automatic([Ridge(1e-3)]))
    >>> [trial["estimator"] for trial in chosen.metadata["choice"]["tried"]]
    ['linear', 'offset', 'raw', 'Ridge']
    """

    candidates: Sequence[Regressor] = field(default_factory=candidates)
    seconds: float = field(default=60.0, kw_only=True)
    tell: Callable[[str], None] | None = None

    def __post_init__(self) -> None:
        if isinstance(self.seconds, bool) or not self.seconds >= 0.0:
            raise CalibrationError(f"Automatic: seconds are {self.seconds!r}; give a time [s]")

    def say(self, report: Progress) -> Say:
        """Tell what is done next, and `report` the fraction done."""

        def say(fraction: float, what: str) -> None:
            if self.tell is not None:
                self.tell(what)
            report(fraction)

        return say


def choose(
    recordings: Sequence[Recording],
    automatic: Automatic,
    features: FeatureSet | Iterable[str] | None,
    joints: Sequence[str] | None,
    target: Target | None,
    fit_rate: float | None,
    random_state: int | None,
    progress: Progress,
) -> tuple[JointRegressor, FeatureSet, Target, dict[str, Any]]:
    """Choose as `Automatic` says, among models of all sets of features.

    Gives what was chosen, unfitted, what it is fitted to, and the evidence, as JSON values. A fold
    without which the linear model of the first features cannot be fitted is passed over; raises
    CalibrationError if that is every one.
    """
    robot = compatibility.common_robot(recordings)
    names = compatibility.chosen_joints(robot, recordings, joints)
    recordings = distinct(recordings)
    named = dict.fromkeys(n for r in recordings for n in default_features(robot, r).names)
    usual = FeatureSet.parse(compatibility.in_all(recordings, named))
    compatibility.common_units(recordings, usual, names)  # refuses rad here and m there
    models = [fit_task.unfitted(model, None, random_state) for model in automatic.candidates]
    sets = [usual if features is None else FeatureSet.parse(features)]
    if features is None:  # all columns of some quantities, besides the default ones
        units = recordings[0].units
        columns = [[n for n in units if n.split("/")[0] in quantities] for quantities in _MORE]
        sets += [FeatureSet.parse(compatibility.in_all(recordings, names)) for names in columns]
    tried = _candidates(models, robot, recordings, names, sets, target)
    gap_limit, dt = default_gap_limit(recordings), sample_dt(recordings)
    stride, sizes = fit_task.stride_of(fit_rate, dt), [len(recording) for recording in recordings]
    tries_rates = features is None and len(recordings) >= FEW and dt <= _RATE_DT
    union = dict.fromkeys(name for candidate in tried for name in candidate.features)
    feature_set = FeatureSet.parse([*union, *(_rates(sets[-1].names) if tries_rates else ())])
    counts = any(candidate.model.family.counts_samples for candidate in tried)
    most = max(sizes) if counts else share_of(sizes, MOST_ROWS)
    parts = fit_task.training_rows(recordings, feature_set, names, gap_limit, stride)
    table = CrossValidation(parts, tried, most)

    share, left_out = _FIRST_SHARE if tries_rates else 1.0, folds(recordings)
    left_out = [*left_out[1::2], *left_out[::2]]  # the ends, such as the fastest, are not first
    say = automatic.say(progress)
    budget = _CHOICE_SHARE * automatic.seconds
    _validate(table, left_out, budget, fit_task.within(say, 0.0, share))
    judged = table.folds
    chosen = table.combined()
    if tries_rates and len(judged) > 1 and table.seconds < budget:
        unprepared = {model.name: model for model in models}  # which know no features yet
        for number in np.flatnonzero(chosen[0].any(axis=1)).tolist():
            model, positions = tried[number].model, tried[number].features
            if not model.family.inputs and model.name not in (RAW, OFFSET):
                more = (*positions, *_rates(positions))  # once more, with rates beside
                model = unprepared.get(model.name, model).for_features(more, robot, names)
                table.candidates.append(Candidate(model, more, tried[number].target))
        rest = fit_task.within(say, share, 1.0 - share)
        for number, fold in enumerate(judged):
            cross_validate(table, number, fold, fit_task.within(rest, number / len(judged), 0.1))
        chosen = table.combined()
    is_few = FEW <= len(recordings) < SORTED_FROM and not any(fold.is_inside for fold in judged)
    has_time = is_few and table.seconds < budget
    inner = _inside_errors(table, chosen[0], recordings) if has_time else []
    say(1.0, "Fitting what was chosen")
    evidence = _evidence(table, *chosen, names, inner) | {
        "left_out": [fold.name for fold in judged],
        "not_in_all": [n for n in named if features is None and n not in usual.names],
        "not_judged": [fold.name for fold in left_out if fold not in judged],
    }
    return *_estimator(table, chosen[0], names), evidence


def _rates(names: Iterable[str]) -> list[str]:
    """Give the rates of the measured positions among features."""
    return [f"rate({name}, {_RATE_TIME:g})" for name in names if name.startswith("measured/")]


def _candidates(
    models: Sequence[JointRegressor],
    robot: Robot,
    recordings: Sequence[Recording],
    joints: tuple[str, ...],
    sets: Sequence[FeatureSet],
    target: Target | None,
) -> list[Candidate]:
    """Give what can be tried: simple models, then each model on each of the sets that it takes.

    Or on features of its own, where the recordings have them.
    """
    first, tried = sets[0].names, dict[tuple[str, frozenset[str]], Candidate]()
    for model in (get_estimator(LINEAR), get_estimator(OFFSET), Raw()):
        predicts = target or TARGETS[0]
        if predicts in model.family.targets:
            prepared = model.for_features(first, robot, joints)
            tried[model.name, frozenset(first)] = Candidate(prepared, first, predicts, True)
    others = [model for model in models if model.name != OFFSET]
    for features, model in product(sets, others):
        inputs = model.family.inputs
        predicts = target or (TARGETS if inputs is None else model.family.targets)[0]
        if predicts not in model.family.targets:
            continue
        try:
            prepared = model.for_recordings(recordings)
            asked = features if inputs is None else None
            names = compatibility.chosen_features(prepared, robot, recordings, asked).names
        except CalibrationError:
            if inputs is None:
                raise
            continue  # they lack what it takes
        if (key := (model.name, frozenset(names))) not in tried:
            prepared = prepared.for_features(names, robot, joints)
            tried[key] = Candidate(prepared, names, predicts)
    if others and not {model.name for model in others} & {name for name, _ in tried}:
        raise CalibrationError(
            f"none of {', '.join(m.name for m in models)} can be tried: the recordings lack what "
            f"they take, or they predict no {target or TARGETS[0]}; give other candidates"
        )
    filters = [c for (name, _), c in tried.items() if name == FILTER_WITH_TREES]
    beside = [c for (name, _), c in tried.items() if name == BESIDE_FILTER]
    bearing = [candidate for candidate in tried.values() if candidate.bears_load]
    for candidate in [*bearing, *filters, *(beside[:1] if filters else ())]:
        candidate.is_believed = True
    return list(tried.values())


def _validate(table: CrossValidation, left_out: Sequence[Fold], budget: float, say: Say) -> None:
    """Fill the table within a `budget` of time [s]."""
    for number, fold in enumerate(left_out):
        more = len(left_out) - number
        if table.folds and not table.keep_within(budget - table.seconds, more):
            break
        try:
            share = fit_task.within(say, number / len(left_out), 1.0 / len(left_out))
            cross_validate(table, len(table.folds), fold, share)
            for candidate in table.candidates:  # that could not be fitted without most of them
                if 2 * (len(table.folds) - len(candidate.folds)) > len(left_out):
                    candidate.note = candidate.note or candidate.lacking
        except CalibrationError:
            if fold is left_out[-1] and not table.folds:
                raise


def _inside_errors(
    table: CrossValidation, weights: Array, recordings: Sequence[Recording]
) -> list[Array]:
    """Mean square errors (n_joints,) of what was chosen, without two fifths of the time in turn."""
    squares = list[Array]()
    with suppress(CalibrationError):  # parts of few rows
        for fold in inside(recordings, range(len(recordings)))[1::2]:
            training, test = table.split(fold)
            error = np.zeros((len(test), weights.shape[1]))
            for number in np.flatnonzero(weights.any(axis=1)).tolist():
                candidate = table.candidates[number]
                errors = _errors_of(candidate, table, training, test, candidate.is_held)
                error += weights[number] * errors
            squares.append(np.mean(error**2, axis=0))
    return squares


def _estimator(
    table: CrossValidation, weights: Array, joints: Sequence[str]
) -> tuple[JointRegressor, FeatureSet, Target]:
    """Unfitted estimator that was chosen, of the features that it needs, and what it predicts."""
    in_use = weights.any(axis=1)
    members = [table.candidates[k] for k in np.flatnonzero(in_use)]
    first = members[0]
    if len(members) == 1 and (first.is_simple or first.model.family.inputs):
        return first.model, FeatureSet.parse(first.features), first.target
    mixed = len({member.target for member in members}) > 1
    measured = tuple(f"measured/{joint}" for joint in joints) if mixed else ()
    names = tuple(dict.fromkeys([*(n for c in members for n in c.features), *measured]))
    sees = tuple(tuple(map(names.index, candidate.features)) for candidate in members)
    others = tuple(map(names.index, measured))
    beside = tuple(others if candidate.target == "error" else () for candidate in members)
    shares = None if len(members) == 1 else tuple(map(tuple, weights[in_use].tolist()))
    models = tuple(candidate.model for candidate in members)
    held = tuple(candidate.is_held for candidate in members)
    estimator = Stack(models, shares, sees=sees, held=held, beside=beside if mixed else None)
    return estimator, FeatureSet.parse(names), "position" if mixed else first.target


def _evidence(
    table: CrossValidation, weights: Array, square: Array, joints: Sequence[str],
    inner: Sequence[Array],
) -> dict[str, Any]:  # fmt: skip
    """JSON values of what was tried and chosen; the first candidate is linear.

    `inner` are mean squares (n_joints,) of what was chosen, on parts inside recordings.

    Errors are RMSE [rad or m] over folds and ratios to linear: of a candidate those of the folds
    that it was fitted without, as on others it has the error of a simple model.
    """
    alone, usable, tried = table.alone, table.usable, []
    for number, candidate in enumerate(table.candidates):
        coupled = [j for j, good in zip(joints, usable[number], strict=True) if not good]
        together = f"needs signals that move together: {', '.join(coupled)}" if coupled else ""
        judged = [fold for fold in candidate.folds if np.isfinite(alone[fold, number]).all()]
        tried.append({
            "estimator": candidate.model.name,
            "features": list(candidate.features),
            "held": candidate.is_held,
            "folds": len(candidate.folds),
            "seconds": round(candidate.seconds, 3),
            "step": candidate.step,
            "bytes": candidate.n_bytes,
            "weights": dict(zip(joints, weights[number].tolist(), strict=True)),
            "note": together or candidate.note or candidate.lacking,
            **(_errors(alone[judged, number], alone[judged, 0], joints) if judged else {}),
        })  # fmt: skip
    median = by_joint(joints, np.median(square, axis=0, keepdims=True))
    chosen = {**_errors(square, alone[:, 0], joints), "median": median}
    is_inside = np.array([fold.is_inside for fold in table.folds])
    for name, part in (("inside", [*square[is_inside], *inner]), ("beyond", square[~is_inside])):
        chosen |= {name: by_joint(joints, np.array(part))} if len(part) else {}
    return {"reference": LINEAR, "chosen": chosen, "tried": tried}


def _errors(square: Array, reference: Array, joints: Sequence[str]) -> dict[str, Any]:
    """RMSE by joint of mean squares (n_folds, n_joints), and their ratio to those of linear."""
    mean, error = mean_and_error(log_ratio(square, reference).mean(axis=1))
    entry = {"rmse": by_joint(joints, square), "ratio": math.exp(mean)}
    return entry | ({"standard_error": error} if len(square) > 1 else {})


def by_joint(joints: Sequence[str], square: Array) -> dict[str, float]:
    """RMSE by joint, of the mean squares (n_folds, n_joints) of errors."""
    return dict(zip(joints, np.sqrt(np.mean(square, axis=0)).tolist(), strict=True))


def validate_zeros(
    parts: Sequence[Rows],
    left_out: Sequence[Fold],
    fit_pair: Callable[[Sequence[int]], tuple[Calibration, Calibration]],
    say: Say,
) -> tuple[bool, dict[str, Any]]:
    """Whether a zero for each recording is better without doubt, and how that was found, as JSON.

    `fit_pair` fits to recordings of these indices, with one zero and with one for each. At most
    five folds of whole recordings are left out of a pair of fits each, and re-zeroed from their
    first seconds. A zero for each is better where it beats one zero, re-zeroed or as it comes, by
    10 % and two standard errors of the mean in a joint, and is no worse on the average in any.
    """
    began = time.perf_counter()
    stretch = min(_REZERO, _SHARE * min(part.recording.duration for part in parts))
    judged, squares = list[str](), list[list[Array]]()
    left_out = left_out[:: -(-len(left_out) // FOLDS)]
    for number, fold in enumerate(left_out):
        training = [index for index in range(len(parts)) if index not in fold.recordings]
        if len(training) < 2:
            continue
        say(number / len(left_out), f"Judging a zero for each recording without {fold.name}")
        errors: list[list[Array]] = [[], [], []]  # with one for each, with one zero, as it comes
        try:
            pair = fit_pair(training)
            for part in (parts[index] for index in fold.recordings):
                for fit, of_fit in zip(pair[::-1], errors, strict=False):
                    error, rows = judged_error(fit, part, stretch)
                    of_fit.append(error)
                errors[2].append(known_error(pair[0], part)[0][rows])
        except CalibrationError:  # as the choice itself passes such a fold over
            continue
        judged.append(fold.name)
        squares.append([np.mean(np.concatenate(each) ** 2, axis=0) for each in errors])
        separate, shared, unmoved = np.moveaxis(np.array(squares), 1, 0)
        shared = np.minimum(shared, unmoved)
        ratios = log_ratio(separate, shared)
        means = ratios.mean(axis=0)
        if len(judged) >= _ZEROS_TRIED_ON and (means.min() > GAIN or means.max() > 0.0):
            break
    if not squares:
        return False, {"kept": False, "note": "no part can be left out for it"}
    gains = [mean_and_error(ratio) for ratio in ratios.T] if len(judged) > 1 else []
    is_better = any(mean <= GAIN and mean + _ERRORS * error < 0.0 for mean, error in gains)
    is_better = is_better and bool((means <= 0.0).all())
    joints = pair[0].joints
    return is_better, {
        "kept": is_better,
        "rezeroed_from": stretch,
        "left_out": judged,
        "shared": by_joint(joints, shared),
        "recording": by_joint(joints, separate),
        "ratio": math.exp(ratios.mean()),
        "ratios": np.exp(ratios.mean(axis=1)).tolist(),
        "seconds": round(time.perf_counter() - began, 3),
    }
