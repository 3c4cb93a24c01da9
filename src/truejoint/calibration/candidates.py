"""Candidates of an automatic choice: which can be tried on recordings, each with its features."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import replace
from functools import partial
from typing import Final

from truejoint.array_types import Mask
from truejoint.calibration.choose import Automatic, Choice, choose
from truejoint.calibration.compatibility import (
    chosen_features,
    chosen_joints,
    common_robot,
    common_units,
    in_all,
)
from truejoint.calibration.cross_validate import MOST_ROWS, FoldErrors, FoldRows, share_of
from truejoint.calibration.fit_task import unfitted
from truejoint.calibration.folds import FEW, folds
from truejoint.calibration.origin import distinct
from truejoint.calibration.training_rows import outlying_values, stride_of, training_rows
from truejoint.errors import CalibrationError
from truejoint.estimators.base import JointRegressor, Progress
from truejoint.estimators.family import TARGETS, Target
from truejoint.features.feature_set import (
    FeatureSet,
    default_features,
    default_gap_limit,
    sample_dt,
)
from truejoint.recordings import Recording
from truejoint.robots import Robot

_MORE: Final = ("measured", "effort"), ("measured", "effort", "current")
"""Quantities of which a choice tries all columns, where it chooses features."""
_RATE_TIME: Final = 0.02  # [s] of the low-pass whose slope is the rate that a choice tries
_RATE_DT: Final = 0.101  # [s] between rows, beyond which they show steps and no rates; 10 Hz do


def choice_of(
    recordings: Sequence[Recording],
    automatic: Automatic,
    features: FeatureSet | Iterable[str] | None,
    joints: Sequence[str] | None,
    target: Target | None,
    fit_rate: float | None,
    random_state: int | None,
    progress: Progress,
) -> Choice:
    """Choose among the estimators that can predict the target, each with its features."""
    robot = common_robot(recordings)
    chosen = chosen_joints(robot, recordings, joints)
    recordings = distinct(recordings)
    named = dict.fromkeys(
        name for recording in recordings for name in default_features(robot, recording).names
    )
    usual = FeatureSet.parse(in_all(recordings, named))
    common_units(recordings, usual, chosen)  # refuses joints that are in rad here and in m there
    models = [unfitted(model, None, random_state) for model in automatic.candidates]
    by_features, targets = _with_their_features(
        models, robot, recordings, usual if features is None else features, target
    )
    free = [m for models in by_features.values() for m in models if m.family.inputs is None]
    if free and automatic.default_features and features is not None and len(recordings) >= FEW:
        by_features.setdefault(usual, free)
    for quantities in _MORE if features is None and free else ():
        columns = [name for name in recordings[0].units if name.split("/")[0] in quantities]
        more = FeatureSet.parse(in_all(recordings, columns))
        if not any(set(more.names) == set(each.names) for each in by_features):
            by_features[more] = free
    for models in by_features.values():  # what learns a filter's residual, without the filter too
        members = {name for model in models for name in _member_names(model)}
        models += [m for m in free if m.name in members and m not in models]
    grouped = partial(
        _grouped, recordings, outlying_values(recordings, chosen), robot, chosen,
        stride_of(fit_rate, sample_dt(recordings)),
    )  # fmt: skip

    def with_rates(table: FoldErrors, names: Collection[str]) -> FoldErrors | None:
        """Give candidates of these names the rates of the table's measured positions as well."""
        positions = [name for name in table.features.names if name.startswith("measured/")]
        rates = [f"rate({name}, {_RATE_TIME:g})" for name in positions]
        tried = [model for model in free if model.name in names]
        more = FeatureSet.parse([*table.features.names, *rates])
        return grouped(more, tried, table.rows.target) if rates else None

    tables = [
        grouped(feature_set, models, targets.get(feature_set, target or TARGETS[0]))
        for feature_set, models in by_features.items()
    ]
    shows_rates = len(recordings) >= FEW and sample_dt(recordings) <= _RATE_DT
    extended = with_rates if features is None and free and shows_rates else None
    choice = choose(tables, folds(recordings), chosen, automatic.tell, progress, extended)
    lacking = [] if features is not None else [name for name in named if name not in usual.names]
    return replace(choice, evidence={**choice.evidence, "not_in_all": lacking})


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
        has_inputs = model.family.inputs is not None
        predicts = target or (model.family.targets if has_inputs else TARGETS)[0]
        prepared = _prepared(model, recordings)
        if predicts not in model.family.targets or prepared is None:
            continue
        inputs = chosen_features(prepared, robot, recordings, None if has_inputs else asked)
        by_features.setdefault(inputs, []).append(prepared)
        targets.setdefault(inputs, predicts)
    if not by_features:
        names = ", ".join(model.name for model in models)
        raise CalibrationError(
            f"none of {names} can be tried: the recordings lack what they take, or they predict no "
            f"{target or TARGETS[0]}; give other candidates"
        )
    return by_features, targets


def _grouped(
    recordings: Sequence[Recording],
    outlying: Sequence[Mask],
    robot: Robot,
    joints: tuple[str, ...],
    stride: int,
    feature_set: FeatureSet,
    candidates: Sequence[JointRegressor],
    target: Target,
) -> FoldErrors:
    """Candidates with the rows of recordings, as many as serve a choice, that they see."""
    gap_limit = default_gap_limit(recordings)
    thinned = not any(model.family.counts_samples for model in candidates)
    sizes = [len(recording) for recording in recordings]
    most = share_of(sizes, MOST_ROWS) if thinned else max(sizes)
    parts = training_rows(recordings, feature_set, joints, gap_limit, stride, outlying)
    models = [model.for_features(feature_set.names, robot, joints) for model in candidates]
    return FoldErrors.of(FoldRows.of(parts, target, most), models)


def _prepared(model: JointRegressor, recordings: Sequence[Recording]) -> JointRegressor | None:
    """Unfitted copy with what recordings say; None where they lack inputs that it insists on."""
    inputs = model.family.inputs
    if inputs is None:
        return model.for_recordings(recordings)
    try:
        prepared = model.for_recordings(recordings)
    except CalibrationError:
        return None
    signals = FeatureSet.parse(inputs(prepared.model_params())).signals
    has_all = all(name in r.table.columns for r in recordings for name in signals)
    return prepared if has_all else None


def _member_names(model: JointRegressor) -> list[str]:
    """Names of what learns the residual of a model with features of its own."""
    members = getattr(model, "members", ()) if model.family.inputs is not None else ()
    return [str(getattr(member, "name", member)) for member in members]
