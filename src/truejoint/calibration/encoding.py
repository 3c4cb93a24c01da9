"""What a calibration consists of, and how it is laid out in a model file."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final, Generic, Self, TypeVar, get_args

import numpy as np

from truejoint.array_types import Array
from truejoint.calibration.domain import TrainingDomain, decode_training_domain
from truejoint.calibration.efforts import EffortBaseline, decode_effort_baseline
from truejoint.calibration.interval import Interval, decode_interval
from truejoint.calibration.model_file import encode_arrays
from truejoint.calibration.redundancy import ParityEquations, decode_parity_equations
from truejoint.errors import (
    CalibrationError,
    ModelFileError,
    RecordingError,
    RobotError,
    other_kind,
)
from truejoint.estimators.family import EstimatorData, Target, is_number
from truejoint.features.feature_set import FeatureSet, is_signal
from truejoint.robots import adopt_robot, get_robot
from truejoint.robots.robot import Robot

if TYPE_CHECKING:  # a control loop decodes without scikit-learn
    from truejoint.estimators.base import JointRegressor

Model = TypeVar("Model")
Data = TypeVar("Data")
Recorded = TypeVar("Recorded")

MAX_JOINTS: Final = 64

_KIND: Final = "calibration"
_EXTRAS: Final = ("training_domain", "interval", "effort_baseline", "parity")  # not estimators
_ZERO: Final = "zero"  # where arrays of the zero stand
_MOVES: Final = "moves"
_TAKEN: Final = frozenset({"model", "rezero_models", _ZERO, _MOVES, *_EXTRAS})  # no baseline's name
_NAME: Final = re.compile(r"\w{0,60}", re.ASCII)
_KEYS: Final = frozenset(
    {
        "kind", "robot", "joints", "target", "features", "units", "ranges", "gap_limit",
        "model", "baselines", "rezero_models", "metadata", "redundant",
    }
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class CalibrationData(Generic[Model]):
    """Everything that a model file holds.

    The estimators are `JointRegressor` objects in a `Calibration` and plain `EstimatorData` as
    `decode` gives them.
    """

    robot: str
    arm: str
    joints: tuple[str, ...]  # that it corrects
    feature_set: FeatureSet  # inputs of the model, in order
    target: Target  # of the model: truth minus measured (peng2024, II-J), or the position itself
    units: Mapping[str, str]  # SI unit of each column that a recording must have
    gap_limit: float  # time without a sample [s] after which the history of features starts anew
    lower: Array  # (k,), range of each feature in the training rows
    upper: Array
    model: Model  # fitted to `joints` in their order
    baseline_models: Mapping[str, Model]  # fitted to the error on the same rows
    metadata: Mapping[str, Any]  # where it comes from, as JSON values
    training_domain: TrainingDomain | None = None  # for the checks of a control loop
    interval: Interval | None = None  # None until trajectories that the fit has not seen were given
    effort_baseline: EffortBaseline | None = None  # for the monitors
    parity: ParityEquations | None = None  # of measured positions with `redundant` columns
    redundant: Mapping[str, str] = field(default_factory=dict)  # units of these, by column
    rezero_models: Mapping[str, Model] = field(default_factory=dict)
    """For motions that begin with re-zeroing: ``"model"`` and the baselines, fitted with a zero for
    each recording or homing; empty where all recordings were taken to share one."""
    offsets: Mapping[str, Array] = field(default_factory=dict)
    """Zero (n_joints,) [rad or m] that re-zeroing found, of ``"model"`` and the baselines."""
    moves: Array | None = None
    """(n_signals, n_joints), how far a signal moves with the zero of each joint: then the zero is
    one of the measured positions, as after a homing. None: it is added to the output."""

    @property
    def title(self) -> str:
        """Robot and arm for a person, for instance ``"raven2 (left arm)"``."""
        return Robot(self.robot, (), self.arm).title

    @cached_property
    def signals(self) -> tuple[str, ...]:
        """Columns that are needed: those of the features, then any other measured position."""
        measured = (f"measured/{joint}" for joint in self.joints)
        return tuple(dict.fromkeys((*self.feature_set.signals, *measured)))

    @property
    def loop_signals(self) -> tuple[str, ...]:
        """Columns of a sample in the control loop: `signals`, then those that check them."""
        return (*self.signals, *self.redundant)

    def without_redundant(self) -> Self:
        """Give it without the columns that check `signals`, for recordings that lack them."""
        domain = self.training_domain
        if domain is not None:
            kept = {
                name: values[: len(self.signals)]
                for name, values in vars(domain).items()
                if name.startswith("signal_")
            }
            domain = replace(domain, **kept)
        return replace(self, training_domain=domain, parity=None, redundant={})

    def required_interval(self) -> Interval:
        """Interval that is stated; raises CalibrationError when there is none."""
        if self.interval is None:
            raise CalibrationError(
                f"the calibration of {self.title} states no interval; make one of recordings that "
                "it has not seen: truejoint calibrate ... --interval RECORDING"
            )
        return self.interval

    @cached_property
    def offset(self) -> Array:
        """Zero of the model (n_joints,) [rad or m]."""
        return self.offsets.get("model", np.zeros(len(self.joints)))

    @cached_property
    def signal_shift(self) -> Array:
        """What is added to each signal (n_signals,) before anything is made of it."""
        return np.zeros(len(self.signals)) if self.moves is None else self.moves @ self.offset

    @cached_property
    def output_shift(self) -> Array:
        """What is added to the prediction (n_joints,) [rad or m]."""
        by_signals = self.moves is not None and self.target == "position"
        return np.zeros(len(self.joints)) if by_signals else self.offset

    def fitted_for(self, *, rezeroing: bool) -> Self:
        """Give the fit for motions that begin with re-zeroing, or for those that do not.

        They are one unless zeros were fitted. An interval stays with the fit that it was made of.
        """
        if not self.rezero_models:
            return self
        models = {"model": self.model, **self.baseline_models}
        models = dict(self.rezero_models) if rezeroing else models
        interval = self.interval
        if interval is not None and (interval.rezero > 0.0) != rezeroing:
            interval = None
        model = models.pop("model")
        return replace(
            self, model=model, baseline_models=models, interval=interval, rezero_models={}
        )


def as_calibration(value: Data) -> Data:
    """Give back a calibration; raises CalibrationError for anything else, saying how to get one."""
    if hasattr(value, "effort_baseline"):  # as anything may have that stands for one
        return value
    advice = "give what `calibrate` gives, or read_calibration(path)"
    raise CalibrationError(other_kind(value, "Calibration", advice))


def as_recorded(value: Recorded) -> Recorded:
    """Give back a recording, known by its columns: what runs does without the tables of one."""
    if hasattr(value, "column"):
        return value
    raise RecordingError(other_kind(value, "Recording", "read_recording(path) gives one"))


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
        "rezero_models": {name: _encode_estimator(m) for name, m in data.rezero_models.items()},
        "metadata": dict(data.metadata),
        "redundant": dict(data.redundant),
    }
    parts = {"model": data.model.arrays_}
    parts |= {name: model.arrays_ for name, model in data.baseline_models.items()}
    parts |= {f"rezero_models/{name}": m.arrays_ for name, m in data.rezero_models.items()}
    parts[_ZERO] = dict(data.offsets) | ({} if data.moves is None else {_MOVES: data.moves})
    for extra in _EXTRAS:
        if getattr(data, extra) is not None:
            parts[extra] = encode_arrays(getattr(data, extra))
    arrays = {f"{part}/{name}": a for part, found in parts.items() for name, a in found.items()}
    return description, arrays


def decode(
    description: Mapping[str, Any], arrays: Mapping[str, Array]
) -> CalibrationData[EstimatorData]:
    """Inverse of `encode`, but for the estimators, which stay plain data.

    Raises ModelFileError if any part is not as it must be. Parameters and arrays of the estimators
    are not looked into: that is up to `Family.check`, or to `JointRegressor.from_data`.
    """
    kind, odd = description.get("kind"), sorted(set(description) ^ _KEYS)
    _require(kind == _KIND, f"kind {kind!r:.60} is not a calibration")
    _require(not odd, f"the model description lacks or adds {', '.join(odd)[:200]}")
    joints = _names(description["joints"], "joints")
    try:
        feature_set = FeatureSet.parse(_strings(description["features"], "features"))
    except CalibrationError as error:
        raise ModelFileError(str(error)) from None
    baselines = _baselines(description["baselines"])
    models = _decode_estimators({"model": description["model"], **baselines}, arrays)
    again = description["rezero_models"]
    good = isinstance(again, dict) and (not again or set(again) - set(baselines) == {"model"})
    _require(good, "the models for re-zeroing are not those of the calibration")
    rezero_models = _decode_estimators(again, _within(arrays, "rezero_models"))
    known = {*models, *_EXTRAS, _ZERO, "rezero_models"}
    left_over = sorted(n for n in arrays if n.partition("/")[0] not in known)
    _require(not left_over, f"arrays {left_over[:5]} belong to no estimator")
    lower, upper = _ranges(description["ranges"], feature_set)
    target, gap, metadata = (description[key] for key in ("target", "gap_limit", "metadata"))
    _require(target in get_args(Target), f"target {target!r:.60} is not 'error' or 'position'")
    _require(is_number(gap, 1e-9, 1e9), f"gap limit {gap!r:.60} is not a time in seconds")
    _require(isinstance(metadata, dict), "the metadata is not a JSON object")
    _check_metadata(metadata)
    robot = _robot(description["robot"])
    data = CalibrationData[EstimatorData](
        robot=robot.name,
        arm=robot.arm,
        joints=joints,
        feature_set=feature_set,
        target=target,
        units=_units(description["units"]),
        gap_limit=float(gap),
        lower=lower,
        upper=upper,
        model=models.pop("model"),
        baseline_models=models,
        metadata=metadata,
        rezero_models=rezero_models,
    )
    needed = set(data.units) == set(data.signals)
    _require(needed, "the units are not those of the columns that the model needs")
    return _with_extras(data, _units(description["redundant"]), arrays)


def _with_extras(
    data: CalibrationData[EstimatorData], redundant: dict[str, str], arrays: Mapping[str, Array]
) -> CalibrationData[EstimatorData]:
    """Give what it may have besides: redundant columns and their units, what checks, and zeros."""
    _require(not set(redundant) & set(data.signals), "a redundant column is an input as well")
    odd = [name for name in redundant if not is_signal(name)]  # such names stand in C source
    _require(not odd, f"the redundant column {odd[:1]!r:.60} is called as none is")
    data = replace(data, redundant=redundant)
    n_joints, n_signals = len(data.joints), len(data.loop_signals)
    shape = n_signals, len(data.feature_set), n_joints
    decoders: dict[str, Callable[[Mapping[str, Array]], Any]] = {
        "training_domain": lambda found: decode_training_domain(found, *shape),
        "interval": lambda found: decode_interval(found, n_joints),
        "effort_baseline": lambda found: decode_effort_baseline(found, n_joints),
        "parity": lambda found: decode_parity_equations(found, n_signals, n_joints),
    }
    extras = {name: _within(arrays, name) for name in _EXTRAS}
    data = replace(data, **{n: decoders[n](found) for n, found in extras.items() if found})
    offsets = _within(arrays, _ZERO)
    for name, array in offsets.items():
        wanted = (len(data.signals), n_joints) if name == _MOVES else (n_joints,)
        good = name in {"model", _MOVES, *data.baseline_models} and array.shape == wanted
        _require(good and bool(np.isfinite(array).all()), f"the zero of {name!r:.60} is none")
    return replace(data, moves=offsets.pop(_MOVES, None), offsets=offsets)


def _encode_estimator(model: JointRegressor) -> dict[str, Any]:
    params = {name: _plain(value) for name, value in model.model_params().items()}
    return {"family": model.data.family, "params": params}


def _plain(value: Any) -> Any:
    """JSON value of a parameter; a generator has no seed that could be told."""
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, (tuple, list)):
        return [_plain(item) for item in value]
    if isinstance(value, np.random.RandomState):
        return None
    return value.item() if isinstance(value, np.generic) else value


def _require(good: bool, message: str) -> None:
    if not good:
        raise ModelFileError(message)


def _decode_estimator(entry: Any, name: str, arrays: Mapping[str, Array]) -> EstimatorData:
    described = isinstance(entry, dict) and set(entry) == {"family", "params"}
    _require(described, f"estimator {name!r} is not described by family and params")
    family, params = entry["family"], entry["params"]
    known = isinstance(family, str) and isinstance(params, dict)
    _require(known, f"estimator {name!r} is of family {family!r:.60}, not a known one")
    return EstimatorData(family, _with_tuples(params), arrays)


def _with_tuples(value: Any) -> Any:
    """JSON value with tuples for lists."""
    if isinstance(value, dict):
        return {key: _with_tuples(item) for key, item in value.items()}
    return tuple(map(_with_tuples, value)) if isinstance(value, list) else value


def _baselines(value: Any) -> dict[str, Any]:
    good = isinstance(value, dict) and not _TAKEN & set(value)
    _require(good, "the baselines are not estimators by name")
    return {_name(name, "a baseline"): entry for name, entry in value.items()}


def _decode_estimators(
    entries: Mapping[str, Any], arrays: Mapping[str, Array]
) -> dict[str, EstimatorData]:
    return {
        name: _decode_estimator(entry, name, _within(arrays, name))
        for name, entry in entries.items()
    }


def _within(arrays: Mapping[str, Array], name: str) -> dict[str, Array]:
    """Arrays whose names start with `name` and a slash, without these."""
    prefix = name + "/"
    return {key.removeprefix(prefix): a for key, a in arrays.items() if key.startswith(prefix)}


def _check_metadata(metadata: Mapping[str, Any]) -> None:
    """Refuse metadata that are not what is read of them."""
    for key in ("baseline_notes", "rezeroed"):
        _require(isinstance(metadata.get(key, {}), dict), f"{key} is not a JSON object")
    for key in ("homing_ids", "accepted"):
        names = metadata.get(key, ())
        good = isinstance(names, list | tuple) and all(isinstance(name, str) for name in names)
        _require(good, f"{key} is not a list of texts")
    for key in ("sessions", "interval_sessions"):
        rows = metadata.get(key, ())
        good = isinstance(rows, list | tuple) and all(map(_is_session, rows))
        _require(good, f"{key} are not recordings as `session_of` tells them")


def _is_session(row: Any) -> bool:
    if not (isinstance(row, dict) and isinstance(row.get("sha256"), str)):
        return False
    load = row.get("load")
    numbers = [row.get("first"), row.get("last"), *([] if load is None else [load])]
    return all(is_number(number, -1e15, 1e15) for number in numbers)


def _ranges(value: Any, feature_set: FeatureSet) -> tuple[Array, Array]:
    named = isinstance(value, dict) and set(value) == set(feature_set.names)
    _require(named, "the training ranges are not those of the features")
    pairs = [value[name] for name in feature_set.names]
    for name, pair in zip(feature_set.names, pairs, strict=True):
        good = isinstance(pair, list) and len(pair) == 2
        good = good and all(is_number(v, -1e300, 1e300) for v in pair) and pair[0] <= pair[1]
        _require(good, f"the training range of {name!r} is {pair!r:.60}, not [low, high]")
    lower, upper = np.array(pairs, dtype=float).T.copy()
    return lower, upper


def _units(value: Any) -> dict[str, str]:
    good = isinstance(value, dict) and all(
        isinstance(unit, str) and 1 <= len(unit) <= 40 and unit.isprintable()
        for unit in value.values()
    )
    _require(good, "the units are not texts by column name")
    return dict(value)


def _robot(value: Any) -> Robot:
    """Robot that the file describes, known by its name from now on."""
    _require(isinstance(value, dict), "the robot is not described")
    try:
        adopt_robot(value, "the model file")
        return Robot.from_dict(value, "the model file")  # as described: nothing is compiled for it
    except RobotError as error:
        raise ModelFileError(str(error)) from None


def _strings(value: Any, what: str) -> list[str]:
    good = isinstance(value, list) and all(isinstance(item, str) for item in value)
    _require(good, f"{what} is not a list of texts")
    return list(value)


def _name(value: Any, what: str) -> str:
    good = isinstance(value, str) and _NAME.fullmatch(value) is not None
    _require(good, f"{what} is {value!r:.60}, not a name")
    return str(value)


def _names(value: Any, what: str) -> tuple[str, ...]:
    names = tuple(_name(item, what) for item in _strings(value, what))
    good = 1 <= len(names) <= MAX_JOINTS and len(set(names)) == len(names) and "" not in names
    _require(good, f"{what} are not 1 to {MAX_JOINTS} different names")
    return names
