"""What a calibration consists of, and how it is laid out in a model file."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final, Generic, TypeVar, get_args

import numpy as np

from truejoint.array_types import Array
from truejoint.calibration.arrays import encode_arrays
from truejoint.calibration.effort_baseline import EffortBaseline, decode_effort_baseline
from truejoint.calibration.interval import Interval, decode_interval
from truejoint.calibration.training_domain import TrainingDomain, decode_training_domain
from truejoint.errors import CalibrationError, ModelFileError, RobotError
from truejoint.models.family import EstimatorData, Target, is_number
from truejoint.models.features import FeatureSet
from truejoint.robots import adopt_robot, get_robot
from truejoint.robots.robot import Robot

if TYPE_CHECKING:  # a control loop decodes without scikit-learn
    from truejoint.estimators.base import JointRegressor

Model = TypeVar("Model")

MAX_JOINTS: Final = 64

_KIND: Final = "calibration"
_EXTRAS: Final = ("training_domain", "interval", "effort_baseline")  # beside the estimators
_NAME: Final = re.compile(r"\w{0,60}", re.ASCII)
_KEYS: Final = frozenset(
    {
        "kind", "robot", "joints", "target", "features", "units", "ranges", "gap_limit",
        "model", "baselines", "metadata",
    }
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class CalibrationData(Generic[Model]):
    """Everything that a model file holds.

    The estimators are `JointRegressor` objects in a `Calibration` and plain `EstimatorData` as
    `decode` gives them.

    Attributes
    ----------
    robot, arm : str
        The arm that it was made for.
    joints : tuple of str
        Joints that it corrects.
    feature_set : FeatureSet
        Inputs of the model, in order.
    target : {"error", "position"}
        What the model predicts: truth minus measured (peng2024, II-J), or the position itself.
    units : mapping of str to str
        SI unit of each column that a recording must have.
    gap_limit : float
        Time without a sample [s] after which the history of the features starts anew.
    lower, upper : ndarray, shape (k,)
        Range of each feature in the training rows.
    model : JointRegressor or EstimatorData
        Fitted to `joints` in their order.
    baseline_models : mapping of str to JointRegressor or EstimatorData
        Fitted to the error on the same rows.
    metadata : mapping
        Where it comes from, as JSON values.
    training_domain : TrainingDomain, optional
        What the training rows looked like, for the checks of a control loop.
    interval : Interval, optional
        How far off a corrected position may be; None until trajectories that the fit has not
        seen were given for it.
    effort_baseline : EffortBaseline, optional
        How the arm behaves while the calibration holds, for the monitors.
    """

    robot: str
    arm: str
    joints: tuple[str, ...]
    feature_set: FeatureSet
    target: Target
    units: Mapping[str, str]
    gap_limit: float
    lower: Array
    upper: Array
    model: Model
    baseline_models: Mapping[str, Model]
    metadata: Mapping[str, Any]
    training_domain: TrainingDomain | None = None
    interval: Interval | None = None
    effort_baseline: EffortBaseline | None = None

    @cached_property
    def signals(self) -> tuple[str, ...]:
        """Columns that are needed: those of the features, then any other measured position."""
        measured = (f"measured/{joint}" for joint in self.joints)
        return tuple(dict.fromkeys((*self.feature_set.signals, *measured)))


def encode(data: CalibrationData[JointRegressor]) -> tuple[dict[str, Any], dict[str, Array]]:
    """Give description and arrays for `model_file.write_model_file`."""
    ranges = zip(data.feature_set.names, data.lower, data.upper, strict=True)
    description = {
        "kind": _KIND,
        "robot": get_robot(data.robot, data.arm).to_dict(),
        "joints": list(data.joints),
        "target": data.target,
        "features": list(data.feature_set.names),
        "units": dict(data.units),
        "ranges": {name: [float(low), float(high)] for name, low, high in ranges},
        "gap_limit": data.gap_limit,
        "model": _encode_estimator(data.model),
        "baselines": {name: _encode_estimator(m) for name, m in data.baseline_models.items()},
        "metadata": dict(data.metadata),
    }
    parts = {"model": data.model.arrays_}
    parts |= {name: model.arrays_ for name, model in data.baseline_models.items()}
    for extra in _EXTRAS:
        if getattr(data, extra) is not None:
            parts[extra] = encode_arrays(getattr(data, extra))
    arrays = {f"{part}/{name}": a for part, found in parts.items() for name, a in found.items()}
    return description, arrays


def decode(
    description: Mapping[str, Any], arrays: Mapping[str, Array]
) -> CalibrationData[EstimatorData]:
    """Inverse of `encode`, but for the estimators, which stay plain data.

    Raises
    ------
    ModelFileError
        If any part is not as it must be. Parameters and arrays of the estimators are not looked
        into: that is up to `Family.check`, or to `JointRegressor.from_data`.
    """
    if description.get("kind") != _KIND:
        raise ModelFileError(f"kind {description.get('kind')!r:.60} is not a calibration")
    if set(description) != _KEYS:
        odd = sorted(set(description) ^ _KEYS)
        raise ModelFileError(f"the model description lacks or adds {', '.join(odd)[:200]}")
    joints = _names(description["joints"], "joints")
    try:
        feature_set = FeatureSet.parse(_strings(description["features"], "features"))
    except CalibrationError as error:
        raise ModelFileError(str(error)) from None
    models = {
        name: _decode_estimator(entry, name, _within(arrays, name))
        for name, entry in _estimators(description).items()
    }
    known = {*models, *_EXTRAS}
    left_over = {name for name in arrays if name.partition("/")[0] not in known}
    if left_over:
        raise ModelFileError(f"arrays {sorted(left_over)[:5]} belong to no estimator")
    lower, upper = _ranges(description["ranges"], feature_set)
    if description["target"] not in get_args(Target):
        raise ModelFileError(f"target {description['target']!r:.60} is not 'error' or 'position'")
    if not is_number(description["gap_limit"], 1e-9, 1e9):
        raise ModelFileError(f"gap limit {description['gap_limit']!r:.60} is not a time in seconds")
    if not isinstance(description["metadata"], dict):
        raise ModelFileError("the metadata is not a JSON object")
    robot = _robot(description["robot"])
    data = CalibrationData[EstimatorData](
        robot=robot.name,
        arm=robot.arm,
        joints=joints,
        feature_set=feature_set,
        target=description["target"],
        units=_units(description["units"]),
        gap_limit=float(description["gap_limit"]),
        lower=lower,
        upper=upper,
        model=models.pop("model"),
        baseline_models=models,
        metadata=description["metadata"],
    )
    if set(data.units) != set(data.signals):
        raise ModelFileError("the units are not those of the columns that the model needs")
    n_joints, shape = len(joints), (len(data.signals), len(feature_set), len(joints))
    decoders: dict[str, Callable[[Mapping[str, Array]], Any]] = {
        "training_domain": lambda found: decode_training_domain(found, *shape),
        "interval": lambda found: decode_interval(found, n_joints),
        "effort_baseline": lambda found: decode_effort_baseline(found, n_joints),
    }
    extras = {name: _within(arrays, name) for name in _EXTRAS}
    return replace(data, **{n: decoders[n](found) for n, found in extras.items() if found})


def _encode_estimator(model: JointRegressor) -> dict[str, Any]:
    return {
        "family": model.family.name,
        "params": {name: _plain(value) for name, value in model.model_params().items()},
    }


def _plain(value: Any) -> Any:
    """JSON value of a parameter; a generator has no seed that could be told."""
    if isinstance(value, (tuple, list)):
        return [_plain(item) for item in value]
    if isinstance(value, np.random.RandomState):
        return None
    return value.item() if isinstance(value, np.generic) else value


def _estimators(description: Mapping[str, Any]) -> dict[str, Any]:
    baselines = description["baselines"]
    known = {"model", *_EXTRAS}
    if not isinstance(baselines, dict) or known & set(baselines):
        raise ModelFileError("the baselines are not estimators by name")
    for name in baselines:
        _name(name, "a baseline")
    return {"model": description["model"], **baselines}


def _decode_estimator(entry: object, name: str, arrays: Mapping[str, Array]) -> EstimatorData:
    if not isinstance(entry, dict) or set(entry) != {"family", "params"}:
        raise ModelFileError(f"estimator {name!r} is not described by family and params")
    family, params = entry["family"], entry["params"]
    if not isinstance(family, str) or not isinstance(params, dict):
        raise ModelFileError(f"estimator {name!r} is of family {family!r:.60}, not a known one")
    params = {key: tuple(v) if isinstance(v, list) else v for key, v in params.items()}
    return EstimatorData(family, params, arrays)


def _within(arrays: Mapping[str, Array], name: str) -> dict[str, Array]:
    """Arrays whose names start with `name` and a slash, without these."""
    prefix = name + "/"
    return {key.removeprefix(prefix): a for key, a in arrays.items() if key.startswith(prefix)}


def _ranges(value: object, feature_set: FeatureSet) -> tuple[Array, Array]:
    if not isinstance(value, dict) or set(value) != set(feature_set.names):
        raise ModelFileError("the training ranges are not those of the features")
    pairs = [value[name] for name in feature_set.names]
    for name, pair in zip(feature_set.names, pairs, strict=True):
        good = isinstance(pair, list) and len(pair) == 2
        if not good or not all(is_number(v, -1e300, 1e300) for v in pair) or pair[0] > pair[1]:
            raise ModelFileError(f"the training range of {name!r} is {pair!r:.60}, not [low, high]")
    bounds = np.array(pairs, dtype=float)
    return bounds[:, 0].copy(), bounds[:, 1].copy()


def _units(value: object) -> dict[str, str]:
    if not isinstance(value, dict) or not all(
        isinstance(unit, str) and 1 <= len(unit) <= 40 and unit.isprintable()
        for unit in value.values()
    ):
        raise ModelFileError("the units are not texts by column name")
    return value


def _robot(value: object) -> Robot:
    """Robot that the file describes, known by its name from now on."""
    if not isinstance(value, dict):
        raise ModelFileError("the robot is not described")
    try:
        adopt_robot(value, "the model file")
        return Robot.from_dict(value, "the model file")  # as described: nothing is compiled for it
    except RobotError as error:
        raise ModelFileError(str(error)) from None


def _strings(value: object, what: str) -> list[str]:
    if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
        raise ModelFileError(f"{what} is not a list of texts")
    return value


def _name(value: object, what: str) -> str:
    if not isinstance(value, str) or not _NAME.fullmatch(value):
        raise ModelFileError(f"{what} is {value!r:.60}, not a name")
    return value


def _names(value: object, what: str) -> tuple[str, ...]:
    names = tuple(_name(item, what) for item in _strings(value, what))
    if not 1 <= len(names) <= MAX_JOINTS or len(set(names)) != len(names) or "" in names:
        raise ModelFileError(f"{what} are not 1 to {MAX_JOINTS} different names")
    return names
