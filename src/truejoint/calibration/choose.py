"""Which estimator to use for each joint: what is best on recordings that a fit did not use."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Final

import numpy as np

from truejoint.array_types import Array
from truejoint.calibration.cross_validate import (
    GAIN,
    TRIED_ON,
    FoldErrors,
    cross_validate,
    is_better,
    log_ratio,
)
from truejoint.calibration.folds import Fold
from truejoint.errors import CalibrationError
from truejoint.estimators.base import JointRegressor, Progress, untold
from truejoint.estimators.family import Target
from truejoint.estimators.registry import LINEAR
from truejoint.estimators.stack.learn import Stack
from truejoint.estimators.wrapped import Regressor, candidates
from truejoint.features.feature_set import FeatureSet

_FIRST_SHARE: Final = 0.8  # of the progress, where what was chosen is tried with more features

Say = Callable[[int, str, int], None]
"""Called with the number of a fold, the name of a candidate and its number."""
Extend = Callable[[FoldErrors, Collection[str]], FoldErrors | None]
"""Table of the candidates of these names with more features than in another table."""


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
class Choice:
    """What was chosen, unfitted, what it is fitted to, and the evidence, as JSON values."""

    estimator: JointRegressor
    features: FeatureSet
    target: Target
    evidence: Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class _Option:
    """What may be chosen: weights of the candidates of a table, and their errors."""

    table: FoldErrors
    weights: Array  # (m, n_joints)
    square: Array  # (n_folds, n_joints), mean square error

    @property
    def names(self) -> set[str]:
        """Names of the candidates that have a weight."""
        used = np.flatnonzero(self.weights.any(axis=1))
        return {self.table.candidates[number].model.name for number in used}

    @property
    def estimator(self) -> JointRegressor:
        """Unfitted estimator of these weights."""
        used = np.flatnonzero(self.weights.any(axis=1))
        members = tuple(self.table.candidates[number].model for number in used)
        if len(members) == 1:
            return members[0]
        return Stack(members, tuple(map(tuple, self.weights[used].tolist())))


def choose(
    tables: Sequence[FoldErrors],
    left_out: Sequence[Fold],
    joints: Sequence[str],
    tell: Callable[[str], None] | None = None,
    progress: Progress | None = None,
    extended: Extend | None = None,
) -> Choice:
    """Choose as `Automatic` says; of two sets of features, the first unless the other is better.

    `tables` are empty; `extended` makes one with more features of what was chosen, or None. A fold
    without which the linear model of the first features cannot be fitted is passed over; raises
    CalibrationError if that is every one. Other features with which it cannot be fitted, as more of
    them take more rows, are left out.
    """
    tell, report = tell or (lambda _what: None), progress or untold
    left_out = [*left_out[1::2], *left_out[::2]]  # the ends, such as the fastest, are not first
    share = _FIRST_SHARE if extended else 1.0
    starts = np.cumsum([0, *(len(table.candidates) for table in tables)])

    def say(start: int, number: int, name: str, candidate: int) -> None:
        tell(f"Choosing: {name} without {left_out[number].name}")
        report(share * (number + (start + candidate) / starts[-1]) / len(left_out))

    judged, whole, behind = _validated(tables, left_out, [partial(say, at) for at in starts])
    chosen = _best([option for table in whole for option in _options(table)])
    tried = [*whole, *behind]
    more = extended(chosen.table, chosen.names) if extended and len(judged) > 1 else None
    if more is not None:
        m = len(more.candidates)

        def say_more(number: int, name: str, candidate: int) -> None:
            tell(f"Choosing: {name} without {judged[number].name}")
            report(share + (1.0 - share) * (number + candidate / m) / len(judged))

        more, is_whole = _validated_more(more, chosen, judged, say_more)
        if is_whole:
            chosen = _best([chosen, *_options(more)])
        tried += [more] if more.products else []
    tell("Fitting what was chosen")
    return _choice(chosen, tried, judged, joints)


def _validated(
    tables: Sequence[FoldErrors], left_out: Sequence[Fold], say: Sequence[Say]
) -> tuple[list[Fold], list[FoldErrors], list[FoldErrors]]:
    """Folds on which the first table could be filled, tables that were on all of these, and others.

    Those are not so much better than the first on the first folds, and are given up.
    """
    first, others = tables[0], list(zip(tables[1:], say[1:], strict=False))
    judged, behind = list[Fold](), list[FoldErrors]()
    for number, fold in enumerate(left_out):
        try:
            first = cross_validate(first, fold, partial(say[0], number))
            judged.append(fold)
        except CalibrationError:
            if fold is left_out[-1] and not judged:
                raise
            continue
        filled = []
        for table, say_of in others:
            more = _filled(table.passed_by(first), fold, partial(say_of, number))
            filled += [] if more is None else [(more, say_of)]
        others = filled
        if len(judged) == TRIED_ON:
            usual = next(_options(first))
            behind = [table.given_up() for table, _ in others if _is_behind(table, usual)]
            others = [pair for pair in others if not _is_behind(pair[0], usual)]
    return judged, [first, *(table for table, _ in others)], behind


def _filled(table: FoldErrors, fold: Fold, say: Callable[[str, int], None]) -> FoldErrors | None:
    """Table with one fold more; None where the linear model cannot be fitted."""
    try:
        return cross_validate(table, fold, say)
    except CalibrationError:
        return None


def _validated_more(
    table: FoldErrors, chosen: _Option, judged: Sequence[Fold], say: Say
) -> tuple[FoldErrors, bool]:
    """Fill a table, unless it does no better on the first folds; whether it was on all."""
    for number, fold in enumerate(judged):
        if number == TRIED_ON and _is_behind(table, chosen):
            return table.given_up(), False
        more = _filled(table, fold, partial(say, number))
        if more is None:
            return table, False
        table = more
    return table, True


def _is_behind(table: FoldErrors, chosen: _Option) -> bool:
    """Whether a table is not, so far, as much better as it must be in the end."""
    reference = chosen.square[: len(table.products)]
    return all(log_ratio(o.square, reference).mean() > GAIN for o in _options(table))


def _options(table: FoldErrors) -> Iterator[_Option]:
    """Give what may be chosen of a table: a weighted mean, or what only works offline alone."""
    weights, square = table.combined()
    yield _Option(table, weights, square)
    for number, candidate in enumerate(table.candidates):
        if not candidate.is_member and table.stands(number) and table.usable[number].all():
            alone = np.zeros_like(weights)
            alone[number] = 1.0
            yield _Option(table, alone, table.alone[:, number])


def _best(options: Sequence[_Option]) -> _Option:
    """Best of those that are better than the first without doubt, or the first."""
    usual, *others = options
    ratios = [log_ratio(other.square, usual.square) for other in others]
    better = [
        (ratio.mean(), number)
        for number, ratio in enumerate(ratios)
        if is_better(ratio.mean(axis=1))
    ]
    return others[min(better)[1]] if better else usual


def _choice(
    chosen: _Option, tables: Sequence[FoldErrors], judged: Sequence[Fold], joints: Sequence[str]
) -> Choice:
    """Make the choice of what was chosen, with the evidence of what was tried."""
    reference, table, square = tables[0].linear, chosen.table, chosen.square
    evidence = {
        "reference": LINEAR,
        "left_out": [fold.name for fold in judged],
        "chosen": {
            "rmse": by_joint(joints, square),
            "median": by_joint(joints, np.median(square, axis=0, keepdims=True)),
        }
        | _ratio(log_ratio(square, reference)),
        "tried": [
            _entry(each, number, reference, joints, chosen.weights if each is table else None)
            for each in tables
            for number in range(len(each.candidates))
        ],
    }
    return Choice(chosen.estimator, table.features, table.rows.target, evidence)


def _entry(
    table: FoldErrors,
    number: int,
    reference: Array,
    joints: Sequence[str],
    weights: Array | None,
) -> dict[str, Any]:
    """Errors of one candidate: RMSE [rad or m] over folds, ratio to linear, its weights.

    Of the folds that it was fitted without: on others it has the error of a simple model.
    """
    candidate = table.candidates[number]
    weight_by_joint = (
        {} if weights is None else dict(zip(joints, weights[number].tolist(), strict=True))
    )
    entry: dict[str, Any] = {
        "estimator": candidate.model.name,
        "features": list(table.features.names),
        "folds": len(candidate.folds),
        "seconds": round(candidate.seconds, 3),
        "weights": weight_by_joint,
        "note": candidate.note or candidate.lacking,
    }
    coupled = [j for j, good in zip(joints, table.usable[number], strict=True) if not good]
    if coupled:
        entry["note"] = f"needs signals that move together: {', '.join(coupled)}"
    square = table.alone[:, number]
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
