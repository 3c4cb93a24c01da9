"""Which estimator to use for each joint: what is best on recordings that a fit did not see."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Final, Self

import numpy as np
from scipy.optimize import nnls

from truejoint.array_types import Array, Integers, Mask
from truejoint.calibration.folds import FEW, Fold, hidden_rows
from truejoint.calibration.rows import Rows as Seen
from truejoint.errors import CalibrationError
from truejoint.estimators.base import JointRegressor, Progress, untold
from truejoint.estimators.family import Target
from truejoint.estimators.polynomial.learn import Raw
from truejoint.estimators.registry import LINEAR, OFFSET, RAW
from truejoint.estimators.stack.learn import Stack
from truejoint.estimators.wrapped import Regressor, candidates, get_estimator
from truejoint.features.feature_set import FeatureSet

GAIN: Final = math.log(1.0 - 0.1)  # mean logarithm by which the best simple model must be beaten
_ERRORS: Final = 2.0  # standard errors of the mean over folds by which it must, too
_FURTHEST: Final = 2.0  # spreads of the targets that predictions may have where signals come apart
_LEAST: Final = 0.05  # weight, below which a member is left out
FITTED_ROWS: Final = 6_000  # that a fit for the choice sees, at most
_JUDGED: Final = 100_000  # that a fold judges, at most
MOST_ROWS: Final = 30_000  # that models with a history run over, at most, and so many fitted to
_TRIED_ON: Final = 2  # folds, after which a candidate is given up if, for each joint,
_WORSE: Final = 0.25  # it is worse than the best by this share and has no weight,
_HOPELESS: Final = 1.0  # or worse by this one,
_AT_ONCE: Final = 2.0  # or by this one after the first, and then with more features too
_FIRST_SHARE: Final = 0.8  # of the progress, where what was chosen is tried with more features


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


@dataclass(frozen=True, eq=False)
class Rows:
    """What one recording gives to a choice: of its `n` rows those that are `kept`."""

    t: Array  # (n,) [s]
    kept: Integers  # (m,)
    dt: Array  # (m,), time since the row before, 0 where a history starts
    features: Array  # (m, k)
    targets: Array  # (m, n_joints) [rad or m], NaN where they are not fitted to

    @classmethod
    def of(cls, part: Seen, target: Target, most: int) -> Self:
        """At most so many rows, evenly spread, and at most as many of those with a target.

        A history that starts in a row that is left out starts in the next.
        """
        t, targets = part.recording.t, part.fitted_targets(target)
        known = np.flatnonzero(np.isfinite(targets).any(axis=1))
        kept = np.union1d(_spread(np.arange(len(t)), most), _spread(known, most))
        starts = np.diff(np.cumsum(part.dt == 0.0)[kept], prepend=0) > 0
        dt = np.where(starts, 0.0, np.diff(t[kept], prepend=t[0]))
        return cls(t, kept, dt, part.X[kept], targets[kept])


@dataclass(frozen=True, eq=False)
class Choice:
    """What was chosen, unfitted, what it is fitted to, and how that came about, as JSON values."""

    estimator: JointRegressor
    features: FeatureSet
    target: Target
    evidence: Mapping[str, Any]


@dataclass(eq=False)
class _Trial:
    """One candidate, and how it did."""

    candidate: JointRegressor  # of which a first fit settles what it finds
    is_member: bool = True  # whether it can be one
    folds: list[int] = field(default_factory=list)  # numbers of those that it was fitted without
    seconds: float = 0.0
    note: str = ""  # why it is not tried any more
    lacking: str = ""  # why it could not be fitted without the last fold where that is so


@dataclass(eq=False)
class Group:
    """Candidates that see the same features, and what they are fitted to and judged on.

    The simple models that can predict the target go before them, the linear one first.
    `recordings` are those of the folds, in their order.
    """

    features: FeatureSet
    recordings: Sequence[Rows]
    candidates: Sequence[JointRegressor]
    target: Target
    products: list[Array] = field(default_factory=list)
    """For each fold, means (n_joints, m, m) of the products of two candidates' errors; NaN where
    one was not tried."""
    hopeless: set[str] = field(default_factory=set)
    """Names of the candidates that were given up after the first fold."""

    def __post_init__(self) -> None:
        simple = [one for one in simple_models() if self.target in one.family.targets]
        names = [one.name for one in simple]
        others = [one for one in self.candidates if one.name not in names]
        self.trials = [_Trial(one) for one in (*simple, *others)]
        self._n_simple = len(simple)
        self._inputs, self._dt, self._targets = (
            np.concatenate([getattr(rows, name) for rows in self.recordings])
            for name in ("features", "dt", "targets")
        )
        moved = [apart(rows.features, self.features) for rows in self.recordings]
        self._apart = np.concatenate(moved)
        known = self._targets[np.isfinite(self._targets).all(axis=1)]
        self._middle, self._deviation = known.mean(axis=0), np.maximum(known.std(axis=0), _TINY)
        self._spreads = np.zeros((len(self.trials), known.shape[1]))  # largest so far

    def judge(self, fold: Fold, say: Callable[[str, int], None]) -> None:
        """Fit what is not given up without a fold, and judge it there.

        `say` is told what is fitted, and which of the candidates it is. Raises CalibrationError if
        the linear model cannot be fitted.
        """
        seen, unseen = self._split(fold)
        m, n_joints = len(self.trials), self._targets.shape[1]
        errors = np.full((m, len(unseen), n_joints), np.nan)
        for number, trial in enumerate(self.trials):
            if trial.note:
                continue
            say(trial.candidate.name, number)
            began = time.perf_counter()
            try:
                predicted, spread = self._predict(trial, seen, unseen)
                errors[number] = self._targets[unseen] - predicted
                self._spreads[number] = np.maximum(self._spreads[number], spread)
                trial.folds.append(len(self.products))
            except CalibrationError as reason:
                if number == 0:
                    raise
                if number < self._n_simple:
                    trial.note = str(reason)
                else:
                    trial.lacking = str(reason)
                    errors[number] = self._stand_in(errors[: self._n_simple])
            trial.seconds += time.perf_counter() - began
        self.products.append(np.einsum("mnj,pnj->jmp", errors, errors) / len(unseen))
        self._give_up_some()

    def _stand_in(self, errors: Array) -> Array:
        """Errors (n, n_joints) of the best of simple models, of theirs (m, n, n_joints).

        They count for what cannot be fitted without a fold, as of few rows beside a long recording:
        other folds may tell what it does, and it is not used where they are few.
        """
        square = np.where(self.usable[: self._n_simple], np.mean(errors**2, axis=1), np.inf)
        best = np.nanargmin(square, axis=0)
        return np.stack([errors[number, :, joint] for joint, number in enumerate(best)], axis=1)

    def stands(self, number: int) -> bool:
        """Whether a candidate is not given up, and was fitted without half of the folds or more."""
        trial = self.trials[number]
        return not trial.note and 2 * len(trial.folds) >= len(self.products)

    def give_up(self) -> None:
        """Say of what was still tried that it is not any more."""
        for trial in self.trials:
            trial.note = trial.note or trial.lacking or _given_up(trial)

    def pass_by(self, other: Group) -> None:
        """Do not try what is hopeless in another group, where this one has more features."""
        if set(other.features.names) <= set(self.features.names):
            for trial in self.trials[self._n_simple :]:
                if trial.candidate.name in other.hopeless and not trial.note:
                    trial.note = "hopeless with fewer features"

    def _give_up_some(self) -> None:
        """Try no more what no joint wants, nor what is hopeless in every one."""
        sizes = np.where(self.usable, 0.5 * np.log(self.alone + _TINY).mean(axis=0), np.inf)
        worse = sizes - np.nanmin(sizes, axis=0)
        is_first = len(self.products) < _TRIED_ON
        unwanted = (worse > math.log1p(_AT_ONCE if is_first else _HOPELESS)).all(axis=1)
        if not is_first:
            unwanted |= (worse > math.log1p(_WORSE)).all(axis=1) & ~self.weights().any(axis=1)
        for number, trial in enumerate(self.trials):
            tried = number >= self._n_simple and trial.is_member and not trial.note
            enough = len(trial.folds) >= min(_TRIED_ON, len(self.products))
            if tried and unwanted[number] and enough:
                trial.note = _given_up(trial)
                if is_first:
                    self.hopeless.add(trial.candidate.name)

    def _split(self, fold: Fold) -> tuple[Integers, Integers]:
        """Rows that a fit sees, few enough, and rows that are judged."""
        hidden, judged = [], []
        for index, rows in enumerate(self.recordings):
            own = [part for part in fold.parts if part.recording == index]
            hidden.append(hidden_rows(rows.t, own)[rows.kept])
            among = [part.rows(len(rows.t))[rows.kept] for part in own]
            judged.append(np.any([np.zeros(len(rows.kept), dtype=bool), *among], axis=0))
        known = np.isfinite(self._targets).all(axis=1)
        seen = np.flatnonzero(known & ~np.concatenate(hidden))
        unseen = np.flatnonzero(known & np.concatenate(judged))
        if not len(unseen):
            raise CalibrationError(f"no row of {fold.name} has a known truth")
        return _spread(seen, FITTED_ROWS), _spread(unseen, _JUDGED)

    def _predict(self, trial: _Trial, seen: Integers, unseen: Integers) -> tuple[Array, Array]:
        """Fit to the rows `seen`, settle what that found, and predict the rows `unseen`.

        And how widely (n_joints,) predictions spread where signals come apart, in deviations of
        the targets; nothing is asked of more than two recordings.
        """
        model = trial.candidate.settled()
        needed = model.minimum_rows(self._inputs.shape[1])
        if len(seen) < needed:
            raise CalibrationError(
                f"{len(seen)} rows with truth beside a part left out; {model.name} needs {needed}: "
                "record for longer, or choose fewer features"
            )
        if model.family.remembers:
            targets = np.full_like(self._targets, np.nan)
            targets[seen] = self._targets[seen]
            model.fit(self._inputs, targets, None, self._dt)
            history = np.cumsum(self._dt == 0.0)
            told = np.isin(history, history[unseen])  # what runs before it does not matter
            predicted = model.evaluate(self._inputs[told], self._dt[told])
            predicted = predicted[np.searchsorted(np.flatnonzero(told), unseen)]
        else:
            model.fit(self._inputs[seen], self._targets[seen])
            predicted = model.evaluate(np.ascontiguousarray(self._inputs[unseen]))
        trial.is_member = model.family.row is not None and (
            model.family.inputs is None or self.target == "position"
        )
        trial.candidate = model.settled()
        spread = np.zeros(predicted.shape[1])
        if len(self.recordings) < FEW and model.name not in (RAW, OFFSET):  # of no signal
            far = (model.evaluate(self._apart, self._dt) - self._middle) / self._deviation
            spread = np.sqrt(np.mean(far**2, axis=0))
        return predicted, spread

    @property
    def usable(self) -> Mask:
        """Which candidates (m, n_joints) do without signals that move together.

        Where no simple model does, as may be of a position, the linear one counts as if it did.
        """
        good = np.asarray(self._spreads <= _FURTHEST)
        good[0] |= ~good[: self._n_simple].any(axis=0)
        return good

    @property
    def alone(self) -> Array:
        """Mean square error (n_folds, m, n_joints) of each candidate, NaN where not tried."""
        return np.array([np.diagonal(product, axis1=1, axis2=2).T for product in self.products])

    @property
    def linear(self) -> Array:
        """Mean square error (n_folds, n_joints) of the linear model."""
        return self.alone[:, 0]

    def weights(self, without: int | None = None) -> Array:
        """Weights (m, n_joints) of the members, of all folds or without one of several.

        Each fold counts by its errors over the least of any: a fold that is easy for all, as of a
        joint at rest, is no more than another.
        """
        kept = [number for number in range(len(self.products)) if number != without] or [0]
        least = np.nanmin(np.where(self.usable, self.alone[kept], np.inf), axis=1)
        scales = np.maximum(least, _TINY)[:, :, None, None]
        relative = np.mean(np.array(self.products)[kept] / scales, axis=0)
        for number, trial in enumerate(self.trials):
            is_raw = isinstance(trial.candidate, Raw)  # an offset is one anyhow
            if is_raw or not (trial.is_member and self.stands(number)):
                relative[:, number] = np.nan
        relative[~self.usable.T] = np.nan
        return np.array([stacking_weights(product) for product in relative]).T

    def combined(self) -> tuple[Array, Array]:
        """Weights (m, n_joints): of a mean, or of one candidate, or of the best simple model.

        And the mean square error (n_folds, n_joints), of a mean with the weights of other folds.
        """
        m, best, usable = len(self.trials), self.weights(), self.usable
        others = [self.weights(without=number) for number in range(len(self.products))]
        square = np.array([_square(p, w) for p, w in zip(self.products, others, strict=True)])
        alone = self.alone
        weights, errors = np.zeros_like(best), np.empty_like(square)
        for joint in range(errors.shape[1]):
            options = [(best[:, joint], square[:, joint])] + [
                (np.eye(m)[number], alone[:, number, joint])
                for number, trial in enumerate(self.trials)
                if trial.is_member and self.stands(number) and usable[number, joint]
            ]
            simple = [o for o in options[1:] if o[0][: self._n_simple].any()]
            linear = self.linear[:, joint]
            yardstick = min(simple, key=lambda o: log_ratio(o[1], linear).mean())[1]
            better = [o for o in options if is_better(log_ratio(o[1], yardstick))]
            chosen = min(better or simple, key=lambda o: log_ratio(o[1], linear).mean())
            weights[:, joint], errors[:, joint] = chosen
        return weights, errors

    def estimator(self, weights: Array) -> JointRegressor:
        """Unfitted estimator of these weights (m, n_joints)."""
        used = np.flatnonzero(weights.any(axis=1))
        members = tuple(self.trials[number].candidate for number in used)
        if len(members) == 1:
            return members[0]
        return Stack(members, tuple(map(tuple, weights[used].tolist())))


_TINY: Final = np.finfo(float).tiny


def _given_up(trial: _Trial) -> str:
    count = len(trial.folds)
    return f"given up after {count} fold{'s' * (count != 1)}"


def simple_models() -> list[JointRegressor]:
    """Models that are kept unless another is better: linear, fixed offset, and none."""
    return [get_estimator(LINEAR), get_estimator(OFFSET), Raw()]


def apart(features: Array, feature_set: FeatureSet) -> Array:
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
    """Rows that each recording may give for all to give `most`: short ones give all they have.

    Examples
    --------
    >>> from truejoint.calibration.choose import share_of
    >>> share_of([10, 500, 900], most=410)
    200
    """
    left = most
    for done, size in enumerate(sorted(sizes)):
        share = left // (len(sizes) - done)
        if size > share:
            return max(share, 1)
        left -= size
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


def _square(products: Array, weights: Array) -> Array:
    """Mean square (n_joints,) of errors, weighted by `weights` (m, n_joints)."""
    known = np.where(weights.T[:, :, None] * weights.T[:, None, :] > 0.0, products, 0.0)
    return np.asarray(np.einsum("mj,jmp,pj->j", weights, known, weights))


@dataclass(frozen=True, eq=False)
class _Option:
    """What may be chosen: weights of the candidates of a group, and how they do."""

    group: Group
    weights: Array  # (m, n_joints)
    square: Array  # (n_folds, n_joints), mean square error

    @property
    def names(self) -> set[str]:
        """Names of the candidates that have a weight."""
        used = np.flatnonzero(self.weights.any(axis=1))
        return {self.group.trials[number].candidate.name for number in used}


def choose(
    groups: Sequence[Group],
    left_out: Sequence[Fold],
    joints: Sequence[str],
    tell: Callable[[str], None] | None = None,
    progress: Progress | None = None,
    extended: Callable[[Group, Collection[str]], Group | None] | None = None,
) -> Choice:
    """Choose as `Automatic` says; of two sets of features, the first unless the other is better.

    `extended` makes a group with more features of what was chosen: its group, and the names of the
    candidates with a weight, which alone are tried again; or None. A fold without which the linear
    model of the first features cannot be fitted is passed over; raises CalibrationError if that is
    every one. Other features with which it cannot be fitted, as more of them take more rows, are
    left out.
    """
    tell, report = tell or (lambda _what: None), progress or untold
    left_out = [*left_out[1::2], *left_out[::2]]  # the ends, such as the fastest, are not first
    share = _FIRST_SHARE if extended else 1.0

    def say(begin: float, width: float, name: str, fold: Fold, fraction: float) -> None:
        tell(f"Choosing: {name} without {fold.name}")
        report(begin + width * fraction)

    judged, whole, behind = _judged(groups, left_out, partial(say, 0.0, share))
    chosen = _best([option for group in whole for option in _options(group)])
    tried = [*whole, *behind]
    more = extended(chosen.group, chosen.names) if extended and len(judged) > 1 else None
    if more is not None:
        if _gains(more, chosen, judged, partial(say, share, 1.0 - share)):
            chosen = _best([chosen, *_options(more)])
        tried += [more] if more.products else []
    tell("Fitting what was chosen")
    return _choice(chosen, tried, judged, joints)


def _judged(
    groups: Sequence[Group], left_out: Sequence[Fold], say: Callable[[str, Fold, float], None]
) -> tuple[list[Fold], list[Group], list[Group]]:
    """Folds on which the first group could be judged, groups that were on all of these, and others.

    Those are not so much better than the first on the first folds, and are given up.
    """
    starts = np.cumsum([0, *(len(group.trials) for group in groups)])

    def told(number: int, start: int, name: str, trial: int) -> None:
        done = (number + (start + trial) / starts[-1]) / len(left_out)
        say(name, left_out[number], done)

    judged: list[Fold] = []
    behind: list[Group] = []
    others = list(zip(groups[1:], starts[1:], strict=False))
    for number, fold in enumerate(left_out):
        try:
            groups[0].judge(fold, partial(told, number, 0))
            judged.append(fold)
        except CalibrationError:
            if fold is left_out[-1] and not judged:
                raise
            continue
        for one, _ in others:
            one.pass_by(groups[0])
        others = [
            (one, at) for one, at in others if _is_judged(one, fold, partial(told, number, at))
        ]
        if len(judged) == _TRIED_ON:
            usual = next(_options(groups[0]))
            behind = [one for one, _ in others if _is_behind(one, usual)]
            others = [(one, at) for one, at in others if one not in behind]
    return judged, [groups[0], *(group for group, _ in others)], behind


def _is_judged(group: Group, fold: Fold, say: Callable[[str, int], None]) -> bool:
    try:
        group.judge(fold, say)
    except CalibrationError:
        return False
    return True


def _gains(
    group: Group, chosen: _Option, judged: Sequence[Fold], say: Callable[[str, Fold, float], None]
) -> bool:
    """Judge a group, unless it does no better on the first folds; whether it was on all."""

    def told(number: int, name: str, trial: int) -> None:
        say(name, judged[number], (number + trial / len(group.trials)) / len(judged))

    for number, fold in enumerate(judged):
        if number == _TRIED_ON and _is_behind(group, chosen):
            return False
        if not _is_judged(group, fold, partial(told, number)):
            return False
    return True


def _is_behind(group: Group, chosen: _Option) -> bool:
    """Give a group up that is not, so far, as much better as it must be in the end."""
    reference = chosen.square[: len(group.products)]
    if any(log_ratio(one.square, reference).mean() <= GAIN for one in _options(group)):
        return False
    group.give_up()
    return True


def _options(group: Group) -> Iterator[_Option]:
    """Give what may be chosen of a group: a weighted mean, or what only works offline alone."""
    weights, square = group.combined()
    yield _Option(group, weights, square)
    for number, trial in enumerate(group.trials):
        if not trial.is_member and group.stands(number) and group.usable[number].all():
            alone = np.zeros_like(weights)
            alone[number] = 1.0
            yield _Option(group, alone, group.alone[:, number])


def _best(options: Sequence[_Option]) -> _Option:
    """Best of those that are better than the first without doubt, or the first."""
    usual, *others = options
    ratios = [log_ratio(one.square, usual.square) for one in others]
    better = [
        (ratio.mean(), number)
        for number, ratio in enumerate(ratios)
        if is_better(ratio.mean(axis=1))
    ]
    return others[min(better)[1]] if better else usual


def _choice(
    chosen: _Option, groups: Sequence[Group], judged: Sequence[Fold], joints: Sequence[str]
) -> Choice:
    """Make the choice of what was chosen, and tell of what was tried."""
    reference, (group, square) = groups[0].linear, (chosen.group, chosen.square)
    told = {
        "reference": LINEAR,
        "left_out": [fold.name for fold in judged],
        "chosen": {
            "rmse": by_joint(joints, square),
            "median": by_joint(joints, np.median(square, axis=0, keepdims=True)),
        }
        | _ratio(log_ratio(square, reference)),
        "tried": [
            _told(one, number, reference, joints, chosen.weights[number] if one is group else None)
            for one in groups
            for number in range(len(one.trials))
        ],
    }
    return Choice(group.estimator(chosen.weights), group.features, group.target, told)


def _told(
    group: Group, number: int, reference: Array, joints: Sequence[str], weights: Array | None
) -> dict[str, Any]:
    """Tell how one candidate did: RMSE [rad or m] over folds, ratio to linear, its weights.

    Of the folds that it was fitted without: of others it shows the error of a simple model.
    """
    trial = group.trials[number]
    entry: dict[str, Any] = {
        "estimator": trial.candidate.name,
        "features": list(group.features.names),
        "folds": len(trial.folds),
        "seconds": round(trial.seconds, 3),
        "weights": {} if weights is None else dict(zip(joints, weights.tolist(), strict=True)),
        "note": trial.note or trial.lacking,
    }
    apart = [j for j, good in zip(joints, group.usable[number], strict=True) if not good]
    if apart:
        entry["note"] = f"needs signals that move together: {', '.join(apart)}"
    square = group.alone[:, number]
    tried = [fold for fold in trial.folds if np.isfinite(square[fold]).all()]
    if tried:
        entry["rmse"] = by_joint(joints, square[tried])
        entry |= _ratio(log_ratio(square[tried], reference[tried]))
    return entry


def _ratio(ratios: Array) -> dict[str, float]:
    """Ratio of errors to those of the linear model, mean over folds and joints; its error."""
    by_fold = ratios.mean(axis=1)
    told = {"ratio": math.exp(by_fold.mean())}
    if len(by_fold) > 1:
        told["standard_error"] = float(by_fold.std(ddof=1) / math.sqrt(len(by_fold)))
    return told


def by_joint(joints: Sequence[str], square: Array) -> dict[str, float]:
    """RMSE by joint, of the mean squares (n_folds, n_joints) of errors."""
    return dict(zip(joints, np.sqrt(np.mean(square, axis=0)).tolist(), strict=True))
