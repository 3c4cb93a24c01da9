"""Which estimator to use for each joint: what is best on recordings that a fit did not use.

Errors of models on folds that their fits did not use stand in one table, which a cross-validation
fills; the choice and its weights are functions of it.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from scipy.optimize import nnls

from truejoint.array_types import Array, Integers, Mask
from truejoint.calibration import compatibility, fit_task
from truejoint.calibration.calibration import Calibration
from truejoint.calibration.folds import FEW, FOLDS, Fold, folds, hidden_rows
from truejoint.calibration.origin import distinct
from truejoint.calibration.rows import Rows
from truejoint.calibration.zero import judged_error
from truejoint.errors import CalibrationError
from truejoint.estimators.base import JointRegressor, Progress
from truejoint.estimators.family import TARGETS, Target
from truejoint.estimators.polynomial.learn import Raw
from truejoint.estimators.registry import LINEAR, OFFSET, RAW
from truejoint.estimators.stack.learn import Stack
from truejoint.estimators.wrapped import Regressor, candidates, get_estimator
from truejoint.features.feature_set import (
    FeatureSet,
    default_features,
    default_gap_limit,
    sample_dt,
)
from truejoint.recordings import Recording
from truejoint.robots import Robot

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
_FIRST_SHARE: Final = 0.8  # of the progress, where what was chosen is tried with more features

_MORE: Final = ("measured", "effort"), ("measured", "effort", "current")
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


@dataclass(frozen=True, eq=False)
class Automatic:
    """Estimators among which each joint is given what predicts it best: stacked regressions.

    Every candidate is fitted without some of the recordings in turn, never without single samples,
    and judged on these: see `truejoint.calibration.folds.folds`. For each joint, the weights that
    sum to 1, are not negative, and make the least mean square of the errors on what the fits did
    not see, each fold relative to the best candidate in it, make a mean of them (Breiman, Stacked
    regressions, Machine Learning 24, 1996). The mean, each fold judged with the weights of the
    others, or one candidate alone, whichever is best, is used where it beats the best of three
    simple models: linear, fixed offset and the raw position; by 10 % and by two standard errors of
    the logarithm's mean over the folds. Elsewhere that simple model stays. The fits that serve the
    choice see six thousand rows; what is chosen is fitted to all. What was tried stands in the
    metadata under ``choice``. Where no features are asked for, the default ones are tried, every
    measured position and effort, and these with every motor current, of what all recordings have;
    then, of three recordings or more whose rows are at most 0.1 s apart, what is best so far once
    more, with the rates of the measured positions beside.

    Nor does the choice end there: a brief truth may set the zero of a recording to come. Where that
    is so is not known, so what is chosen, fitted with one zero, corrects positions as they come. Of
    three recordings or more the choice judges besides whether, once each that is left out is
    re-zeroed from its first 2 s, a fit with a zero for each recording is better, by the same rule
    in a joint and no worse in any. It is then kept beside the other, as ``zero="recording"`` of
    `calibrate` does it; ``zero="shared"`` leaves that out. See ``choice``, ``zero`` in the
    metadata.

    Parts of one or two recordings cannot tell what each of several signals does that always moved
    together, and a model that sets one against the other fails in the next motion. There each fit
    is shown the same rows with every signal taken from another time: a candidate whose predictions
    then spread, about the mean of the targets, twice as widely as the targets is not used for that
    joint.

    Parameters
    ----------
    candidates : sequence of Regressor
        What is tried; by default what the registry says: offset, linear, quadratic, a network
        until convergence, boosted trees on the residual of the linear model, rich plays with and
        without trees, coupled plays, capstans that run out, two Gaussian processes, and a jaw's
        filter with trees. One that takes features of its own is tried where the recordings have
        them, with what learns its residual beside it, and what only works offline is taken for all
        joints or not at all.
    default_features : bool
        Whether to try the default features too, where others are asked for and there are three
        recordings or more: parts of one motion do not tell which features hold on another.
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
    default_features: bool = False
    tell: Callable[[str], None] | None = None

    def say(self, report: Progress) -> Say:
        """Tell what is done next, and `report` the fraction done."""

        def say(fraction: float, what: str) -> None:
            if self.tell is not None:
                self.tell(what)
            report(fraction)

        return say


@dataclass(frozen=True, eq=False)
class _Option:
    """What may be chosen: weights of the candidates of a table, and their errors."""

    table: CrossValidation
    weights: Array  # (n_candidates, n_joints)
    square: Array  # (n_folds, n_joints), mean square error


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
    """Choose as `Automatic` says; of two sets of features, the first unless the other is better.

    Gives what was chosen, unfitted, what it is fitted to, and the evidence, as JSON values.

    A fold without which the linear model of the first features cannot be fitted is passed over;
    raises CalibrationError if that is every one. Other features with which it cannot be fitted, as
    more of them take more rows, are left out.
    """
    robot = compatibility.common_robot(recordings)
    names = compatibility.chosen_joints(robot, recordings, joints)
    recordings = distinct(recordings)
    named = dict.fromkeys(n for r in recordings for n in default_features(robot, r).names)
    usual = FeatureSet.parse(compatibility.in_all(recordings, named))
    compatibility.common_units(recordings, usual, names)  # refuses rad here and m there
    models = [fit_task.unfitted(model, None, random_state) for model in automatic.candidates]
    asked = usual if features is None else features
    by_features, targets = _with_their_features(models, robot, recordings, asked, target)
    free = [m for models in by_features.values() for m in models if m.family.inputs is None]
    more = [usual] if automatic.default_features and len(recordings) >= FEW else []
    if features is None:  # all columns of some quantities, besides the default ones
        units = recordings[0].units
        columns = [[n for n in units if n.split("/")[0] in quantities] for quantities in _MORE]
        more = [FeatureSet.parse(compatibility.in_all(recordings, names)) for names in columns]
    _extend(by_features, free, more)
    outlying = fit_task.outlying_values(recordings, names)
    gap_limit, dt = default_gap_limit(recordings), sample_dt(recordings)
    stride, sizes = fit_task.stride_of(fit_rate, dt), [len(recording) for recording in recordings]

    def tabled(
        feature_set: FeatureSet, models: Sequence[JointRegressor], target: Target
    ) -> CrossValidation:
        thinned = not any(model.family.counts_samples for model in models)
        most = share_of(sizes, MOST_ROWS) if thinned else max(sizes)
        parts = fit_task.training_rows(recordings, feature_set, names, gap_limit, stride, outlying)
        models = [model.for_features(feature_set.names, robot, names) for model in models]
        return CrossValidation(parts, target, models, most)

    tables = [
        tabled(feature_set, models, targets.get(feature_set, target or TARGETS[0]))
        for feature_set, models in by_features.items()
    ]
    tries_rates = features is None and free and len(recordings) >= FEW and dt <= _RATE_DT
    share, left_out = _FIRST_SHARE if tries_rates else 1.0, folds(recordings)
    left_out = [*left_out[1::2], *left_out[::2]]  # the ends, such as the fastest, are not first

    say = automatic.say(progress)
    judged, whole, tried = _validated(tables, left_out, fit_task.within(say, 0.0, share))
    tried = [*whole, *tried]
    chosen = _best([option for table in whole for option in _options(table)])
    positions = [name for name in chosen.table.features.names if name.startswith("measured/")]
    if tries_rates and positions and len(judged) > 1:
        chosen_models = {model.name for model in _members(chosen)}
        rates = [f"rate({name}, {_RATE_TIME:g})" for name in positions]
        with_rates = FeatureSet.parse([*chosen.table.features.names, *rates])
        models = [model for model in free if model.name in chosen_models]
        extended = tabled(with_rates, models, chosen.table.target)
        rest = fit_task.within(say, share, 1.0 - share)
        _, whole, behind = _validated([extended], judged, rest, chosen)
        chosen = _best([chosen, *(option for table in whole for option in _options(table))])
        tried += [*whole, *behind]
    say(1.0, "Fitting what was chosen")
    evidence = _evidence(chosen, tried, judged, names)
    evidence["not_in_all"] = [n for n in named if features is None and n not in usual.names]
    members, weights = _members(chosen), chosen.weights[chosen.weights.any(axis=1)]
    stack = Stack(members, tuple(map(tuple, weights.tolist())))
    estimator = members[0] if len(members) == 1 else stack
    return estimator, chosen.table.features, chosen.table.target, evidence


def _with_their_features(
    models: Sequence[JointRegressor],
    robot: Robot,
    recordings: Sequence[Recording],
    asked: FeatureSet | Iterable[str],
    target: Target | None,
) -> tuple[dict[FeatureSet, list[JointRegressor]], dict[FeatureSet, Target]]:
    """Models that can be tried, by the features that they see, and what these then predict.

    Features are those that are `asked` for, or the model's own.
    """
    by_features: dict[FeatureSet, list[JointRegressor]] = {}
    targets: dict[FeatureSet, Target] = {}
    for model in models:
        inputs = model.family.inputs
        predicts = target or (TARGETS if inputs is None else model.family.targets)[0]
        if predicts not in model.family.targets:
            continue
        features = asked if inputs is None else None
        try:
            prepared = model.for_recordings(recordings)
            feature_set = compatibility.chosen_features(prepared, robot, recordings, features)
        except CalibrationError:
            if inputs is None:
                raise
            continue  # they lack what it takes
        by_features.setdefault(feature_set, []).append(prepared)
        targets.setdefault(feature_set, predicts)
    if not by_features:
        names = ", ".join(model.name for model in models)
        raise CalibrationError(
            f"none of {names} can be tried: the recordings lack what they take, or they predict no "
            f"{target or TARGETS[0]}; give other candidates"
        )
    return by_features, targets


def _extend(
    by_features: dict[FeatureSet, list[JointRegressor]],
    free: list[JointRegressor],
    more: Sequence[FeatureSet],
) -> None:
    """Try the models that are `free` to take any features with `more` of them as well."""
    for feature_set in more if free else ():
        if not any(set(feature_set.names) == set(each.names) for each in by_features):
            by_features[feature_set] = free
    for models in by_features.values():  # what learns a filter's residual, without the filter too
        each = [getattr(model, "members", ()) for model in models if model.family.inputs]
        members = {str(getattr(member, "name", member)) for some in each for member in some}
        models += [m for m in free if m.name in members and m not in models]


def _validated(
    tables: Sequence[CrossValidation],
    left_out: Sequence[Fold],
    say: Say,
    rival: _Option | None = None,
) -> tuple[list[Fold], list[CrossValidation], list[CrossValidation]]:
    """Folds on which the first table could be filled, tables that were on all of these, and others.

    Those are not so much better, on the first folds, than a `rival`, which is the first table's
    where none is given, and are given up. A table that cannot be filled is left out; without a
    rival it is the fold, where it is the first table.
    """
    tables, judged, behind = list(tables), list[Fold](), list[CrossValidation]()
    for fold_number, fold in enumerate(left_out):
        filled = list[CrossValidation]()
        for place, table in enumerate(tables):
            if filled:
                table.pass_by(filled[0])
            share = 1.0 / len(tables) / len(left_out)
            begin = fold_number / len(left_out) + place * share
            try:
                cross_validate(table, fold, fit_task.within(say, begin, share))
                filled.append(table)
            except CalibrationError:
                if rival is None and place == 0:
                    if fold is left_out[-1] and not judged:
                        raise
                    break
        if filled or rival is not None:
            tables = filled
            judged.append(fold)
        if filled and len(judged) == TRIED_ON:
            usual = rival or next(_options(tables[0]))
            square = usual.square[:TRIED_ON]
            behind = [
                table
                for table in tables[0 if rival else 1 :]
                if all(log_ratio(o.square, square).mean() > GAIN for o in _options(table))
            ]
            tables = [table for table in tables if table not in behind]
    for candidate in (c for table in behind for c in table.candidates if not c.note):
        candidate.give_up(candidate.lacking)
    return judged, tables, behind


def _options(table: CrossValidation) -> Iterator[_Option]:
    """Give what may be chosen of a table: a weighted mean, or what only works offline alone."""
    weights, square = table.combined()
    yield _Option(table, weights, square)
    for number, candidate in enumerate(table.candidates):
        if not candidate.is_member and table.stands(number) and table.usable[number].all():
            alone = np.zeros_like(weights)
            alone[number] = 1.0
            yield _Option(table, alone, table.alone[:, number])


def _members(option: _Option) -> tuple[JointRegressor, ...]:
    """Unfitted candidates that have a weight."""
    pairs = zip(option.table.candidates, option.weights, strict=True)
    return tuple(candidate.model for candidate, weights in pairs if weights.any())


def _best(options: Sequence[_Option]) -> _Option:
    """Best of those that are better than the first without doubt, or the first."""
    ratios = [log_ratio(option.square, options[0].square) for option in options]
    better = [number for number, ratio in enumerate(ratios) if is_better(ratio.mean(axis=1))]
    return options[min(better, key=lambda number: ratios[number].mean(), default=0)]


def _evidence(
    chosen: _Option,
    tables: Sequence[CrossValidation],
    judged: Sequence[Fold],
    joints: Sequence[str],
) -> dict[str, Any]:
    """JSON values of what was tried and chosen; the first candidate of the first is linear."""
    reference = tables[0].alone[:, 0]
    return {
        "reference": LINEAR,
        "left_out": [fold.name for fold in judged],
        "chosen": {
            "rmse": by_joint(joints, chosen.square),
            "median": by_joint(joints, np.median(chosen.square, axis=0, keepdims=True)),
            **_ratio(log_ratio(chosen.square, reference)),
        },
        "tried": [
            _entry(table, number, reference, joints, chosen)
            for table in tables
            for number in range(len(table.candidates))
        ],
    }


def _entry(
    table: CrossValidation, number: int, reference: Array, joints: Sequence[str], chosen: _Option
) -> dict[str, Any]:
    """Errors of one candidate: RMSE [rad or m] over folds, ratio to linear, its weights.

    Of the folds that it was fitted without: on others it has the error of a simple model.
    """
    candidate, square = table.candidates[number], table.alone[:, number]
    coupled = [j for j, good in zip(joints, table.usable[number], strict=True) if not good]
    weights = chosen.weights[number].tolist() if table is chosen.table else []
    together = f"needs signals that move together: {', '.join(coupled)}" if coupled else ""
    entry: dict[str, Any] = {
        "estimator": candidate.model.name,
        "features": list(table.features.names),
        "folds": len(candidate.folds),
        "seconds": round(candidate.seconds, 3),
        "weights": dict(zip(joints, weights, strict=False)),
        "note": together or candidate.note or candidate.lacking,
    }
    tried = [fold for fold in candidate.folds if np.isfinite(square[fold]).all()]
    if tried:
        entry["rmse"] = by_joint(joints, square[tried])
        entry |= _ratio(log_ratio(square[tried], reference[tried]))
    return entry


def _ratio(ratios: Array) -> dict[str, float]:
    """Ratio of errors to those of the linear model, mean over folds and joints; its error."""
    by_fold = ratios.mean(axis=1)
    verdict = {"ratio": math.exp(by_fold.mean())}
    if len(by_fold) > 1:
        verdict["standard_error"] = float(by_fold.std(ddof=1) / math.sqrt(len(by_fold)))
    return verdict


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

    `fit_pair` fits to recordings of these indices, with one zero and with one for each.
    Five of the folds at most, of whole recordings, are left out of a pair of fits each, and their
    recordings are re-zeroed from the first seconds as `find_zero` gives it. A
    zero for each is better where it beats one zero, by the rule of a choice, in a joint, and is no
    worse on the average in any. `say` is told what is done and the share of it.
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
        testing = [parts[index] for index in fold.recordings]
        try:
            pair = fit_pair(training)
            errors = [[judged_error(fit, one, stretch)[0] for one in testing] for fit in pair]
        except CalibrationError:  # as the choice itself passes such a fold over
            continue
        judged.append(fold.name)
        squares.append([np.mean(np.concatenate(each) ** 2, axis=0) for each in errors])
        shared, own = np.moveaxis(np.array(squares), 1, 0)
        ratios = log_ratio(own, shared)
        means = ratios.mean(axis=0)
        if len(judged) >= _ZEROS_TRIED_ON and (means.min() > GAIN or means.max() > 0.0):
            break
    if not squares:
        return False, {"kept": False, "note": "no part can be left out for it"}
    is_better_fit = any(map(is_better, ratios.T)) and bool((ratios.mean(axis=0) <= 0.0).all())
    joints = pair[0].joints
    return is_better_fit, {
        "kept": is_better_fit,
        "rezeroed_from": stretch,
        "left_out": judged,
        "shared": by_joint(joints, shared),
        "recording": by_joint(joints, own),
        "ratio": math.exp(ratios.mean()),
        "ratios": np.exp(ratios.mean(axis=1)).tolist(),
        "seconds": round(time.perf_counter() - began, 3),
    }
