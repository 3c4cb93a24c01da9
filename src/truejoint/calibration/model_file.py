"""What a calibration consists of in a model file, and how it is written and read."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Final, Literal, NamedTuple

import numpy as np

from truejoint import schema
from truejoint.array_types import Array
from truejoint.calibration.calibration import Calibration, RezeroedFit, as_calibration
from truejoint.calibration.container import encode_arrays, read_model_file, write_model_file
from truejoint.calibration.domain import decode_training_domain
from truejoint.calibration.efforts import decode_effort_baseline
from truejoint.calibration.interval import Interval, decode_interval
from truejoint.calibration.origin import Origin
from truejoint.calibration.redundancy import decode_parity_equations
from truejoint.calibration.zero import Zero
from truejoint.errors import CalibrationError, ModelFileError, RobotError, TruejointError
from truejoint.estimators.family import EstimatorData, Target, find_family
from truejoint.features.feature_set import FeatureSet, is_signal
from truejoint.robots.robot import Robot
from truejoint.schema import Bounds, Length, Pattern

MAX_JOINTS: Final = 64

_REZEROED: Final = "rezeroed_fit"
_TAKEN: Final = frozenset(
    {
        "model",
        "training_domain",
        "effort_baseline",
        "parity",
        "interval",
        "zero",
        "moves",
        _REZEROED,
    }
)  # names of parts, which no baseline may have

_Name = Annotated[str, Pattern(r"\w{1,60}", "a name of up to 60 letters, digits and _")]
_Unit = Annotated[str, Pattern(r"[^\x00-\x1f\x7f]{1,40}", "a text of 1 to 40 characters")]
_Edge = Annotated[float, Bounds(-1e300, 1e300)]


class _Estimator(NamedTuple):
    """An estimator but for its arrays."""

    family: Annotated[str, Length(1, 60)]
    params: Mapping[str, Any]


class _Fit(NamedTuple):
    """A model and its baselines."""

    model: _Estimator
    baselines: Mapping[str, _Estimator]


@dataclass(frozen=True)
class _Description:
    """The JSON part of a model file."""

    kind: Literal["calibration"]
    robot: Mapping[str, Any]
    joints: Annotated[tuple[_Name, ...], Length(1, MAX_JOINTS)]
    target: Target
    features: tuple[str, ...]
    units: Mapping[str, _Unit]
    ranges: tuple[tuple[_Edge, _Edge], ...]
    gap_limit: Annotated[float, Bounds(1e-9, 1e9)]
    fit: _Fit
    origin: Origin
    metadata: Mapping[str, Any]
    redundant: Mapping[str, _Unit] = field(default_factory=dict)
    zero: Zero | None = None
    rezeroed_fit: _Fit | None = None

    def __post_init__(self) -> None:
        if len(set(self.joints)) < len(self.joints):
            raise ModelFileError(f"joints {', '.join(self.joints)} are not different names")
        fits = [self.fit] if self.rezeroed_fit is None else [self.fit, self.rezeroed_fit]
        for name in (name for fit in fits for name in fit.baselines):
            if name in _TAKEN or not name.isidentifier():
                raise ModelFileError(f"baselines: {name!r:.60} is no name of one")
        if any(low > high for low, high in self.ranges):
            raise ModelFileError("ranges: a lower bound is above its upper one")
        if any(not is_signal(name) for name in self.redundant):  # they stand in C source
            raise ModelFileError(f"redundant: {list(self.redundant)!r:.80} is called as none is")


def write_calibration(
    calibration: Calibration, path: str | os.PathLike[str], *, overwrite: bool = False
) -> None:
    """Write a calibration as one safetensors file; `read_calibration` reads it back.

    Raises
    ------
    ModelFileError
        If the file exists and `overwrite` is false, or it cannot be written.
    CalibrationError
        If it is no calibration, or no installed package has the family of its estimator.

    Examples
    --------
    >>> write_calibration(model, "jaw.safetensors")
    >>> read_calibration("jaw.safetensors").estimator
    'linear'
    """
    if as_calibration(calibration).family.row is None:
        _ = calibration.model.data  # refuses what no file can hold
    find_family(calibration.fitted.family)
    write_model_file(path, *encode(calibration), overwrite=overwrite)


def read_calibration(path: str | os.PathLike[str]) -> Calibration:
    """Read a calibration that `write_calibration` wrote; it predicts bit for bit as before.

    Nothing in the file is run.

    Raises
    ------
    ModelFileError
        If the file is missing, truncated, edited, too large, or of a newer format.

    Examples
    --------
    >>> write_calibration(model, "jaw.safetensors")
    >>> read_calibration("jaw.safetensors").joints
    ('jaw',)
    """
    description, arrays = read_model_file(path)
    try:
        calibration = decode(description, arrays)
        if calibration.counts_samples and not calibration.origin.sample_dt > 0.0:
            raise ModelFileError("the model counts samples, and the time step is not stated")
        for fit in (calibration, calibration.for_rezeroing):
            for name, data in {**fit.fitted_baselines, "model": fit.fitted}.items():
                _check(name, data, len(fit.feature_set), len(fit.joints))
            if calibration.rezeroed_fit is None:
                break
    except TruejointError as error:
        raise ModelFileError(f"{path}: {error}; copy or calibrate it again") from None
    return calibration


def _check(name: str, data: EstimatorData, n_features: int, n_outputs: int) -> None:
    """Refuse an estimator whose numbers make no model."""
    try:
        family = find_family(data.family)
        family.check(data, n_features, n_outputs)
        if family.row is not None:
            family.memory(data, n_features, n_outputs)
    except CalibrationError as error:
        raise ModelFileError(f"estimator {name!r}: {error}") from None


def encode(calibration: Calibration) -> tuple[dict[str, Any], dict[str, Array]]:
    """Give description and arrays for `container.write_model_file`."""
    c, again = calibration, calibration.rezeroed_fit
    description = {
        "kind": "calibration",
        "robot": dict(c.robot_values or c.machine.to_dict()),
        "joints": list(c.joints),
        "target": c.target,
        "features": list(c.feature_set.names),
        "units": dict(c.units),
        "ranges": np.column_stack([c.lower, c.upper]).tolist(),
        "gap_limit": c.gap_limit,
        "fit": _fit_entry(c.fitted, c.fitted_baselines),
        "origin": schema.plain(c.origin),
        "metadata": dict(c.metadata),
        "redundant": dict(c.redundant),
    }
    parts = _fit_arrays(c.fitted, c.fitted_baselines)
    for name in ("training_domain", "effort_baseline", "parity", "interval"):
        if getattr(c, name) is not None:
            parts[name] = encode_arrays(getattr(c, name))
    parts["zero"] = dict(c.offsets)
    parts["moves"] = {} if c.moves is None else {"signals": c.moves}
    if c.zero is not None:
        description["zero"] = schema.plain(c.zero)
        if np.isnan(c.zero.deviation).any():
            del description["zero"]["deviation"]
    if again is not None:
        description[_REZEROED] = _fit_entry(again.fitted, again.baselines)
        of_fit = _fit_arrays(again.fitted, again.baselines)
        of_fit["moves"] = {} if again.moves is None else {"signals": again.moves}
        of_fit["interval"] = {} if again.interval is None else encode_arrays(again.interval)
        parts |= {f"{_REZEROED}/{name}": arrays for name, arrays in of_fit.items()}
    arrays = {f"{part}/{name}": a for part, named in parts.items() for name, a in named.items()}
    return description, arrays


def _fit_entry(fitted: EstimatorData, baselines: Mapping[str, EstimatorData]) -> dict[str, Any]:
    def entry(data: EstimatorData) -> dict[str, Any]:
        return {"family": data.family, "params": _plain(data.params)}

    entries = {name: entry(data) for name, data in baselines.items()}
    return {"model": entry(fitted), "baselines": entries}


def _fit_arrays(
    fitted: EstimatorData, baselines: Mapping[str, EstimatorData]
) -> dict[str, Mapping[str, Array]]:
    return {"model": fitted.arrays} | {name: data.arrays for name, data in baselines.items()}


def _plain(value: Any) -> Any:
    """JSON value of a parameter; a generator of random numbers states no seed."""
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, (tuple, list)):
        return [_plain(item) for item in value]
    if isinstance(value, np.random.RandomState):
        return None
    return value.item() if isinstance(value, np.generic) else value


def _tuples(value: Any) -> Any:
    """JSON value with tuples for lists."""
    if isinstance(value, dict):
        return {key: _tuples(item) for key, item in value.items()}
    return tuple(map(_tuples, value)) if isinstance(value, list) else value


def decode(description: Mapping[str, Any], arrays: Mapping[str, Array]) -> Calibration:
    """Inverse of `encode`.

    Raises ModelFileError if any part is not as it must be. Parameters and arrays of the estimators
    are not looked into: that is up to `Family.check`.
    """
    stated = schema.read(_Description, description, "the model description", ModelFileError)
    parts: dict[str, dict[str, Array]] = {}
    for name, array in arrays.items():
        part, _, own = name.partition("/")
        if part == _REZEROED:
            inner, _, own = own.partition("/")
            part = f"{part}/{inner}"
        parts.setdefault(part, {})[own] = array
    try:
        feature_set = FeatureSet.parse(stated.features)
        Robot.from_dict(stated.robot, "the model file")  # refused here, if it is none
    except (CalibrationError, RobotError) as error:
        raise ModelFileError(str(error)) from None
    if len(stated.ranges) != len(feature_set):
        raise ModelFileError("the training ranges are not those of the features")
    fitted, baselines = _fit(stated.fit, parts, "")
    lower, upper = np.array(stated.ranges, dtype=float).T.copy()
    bare = Calibration(
        robot=str(stated.robot["name"]),
        arm=str(stated.robot.get("arm", "")),
        robot_values=stated.robot,
        joints=stated.joints,
        feature_set=feature_set,
        target=stated.target,
        units=stated.units,
        gap_limit=stated.gap_limit,
        lower=lower,
        upper=upper,
        fitted=fitted,
        fitted_baselines=baselines,
        origin=stated.origin,
        metadata=stated.metadata,
        redundant=stated.redundant,
        zero=stated.zero,
    )
    if set(bare.units) != set(bare.signals):
        raise ModelFileError("the units are not those of the columns that the model needs")
    if set(bare.redundant) & set(bare.signals):
        raise ModelFileError("a redundant column is an input as well")
    calibration = _with_parts(bare, parts, stated.rezeroed_fit)
    if parts:
        raise ModelFileError(f"arrays {sorted(parts)[:5]} belong to no part of the model")
    return calibration


def _fit(
    entry: _Fit, parts: dict[str, dict[str, Array]], prefix: str
) -> tuple[EstimatorData, dict[str, EstimatorData]]:
    """Take the model and the baselines of a fit out of the parts."""

    def data(name: str, own: _Estimator) -> EstimatorData:
        return EstimatorData(own.family, _tuples(own.params), parts.pop(prefix + name, {}))

    baselines = {name: data(name, own) for name, own in entry.baselines.items()}
    return data("model", entry.model), baselines


def _with_parts(
    bare: Calibration, parts: dict[str, dict[str, Array]], again: _Fit | None
) -> Calibration:
    """Take what the calibration may have besides out of the parts: what checks, and zeros."""
    n_joints, n_loop = len(bare.joints), len(bare.loop_signals)
    own: dict[str, Any] = {"moves": _moves(bare, parts.pop("moves", None))}
    own["interval"] = _interval(parts.pop("interval", None), n_joints)
    if "training_domain" in parts:
        shape = n_loop, len(bare.feature_set), n_joints
        own["training_domain"] = decode_training_domain(parts.pop("training_domain"), *shape)
    if "effort_baseline" in parts:
        own["effort_baseline"] = decode_effort_baseline(parts.pop("effort_baseline"), n_joints)
    if "parity" in parts:
        own["parity"] = decode_parity_equations(parts.pop("parity"), n_loop, n_joints)
    offsets = parts.pop("zero", {})
    if not set(offsets) <= {"model", *bare.fitted_baselines}:
        raise ModelFileError("the zero is of none of the models")
    for offset in offsets.values():
        if offset.shape != (n_joints,) or not np.isfinite(offset).all():
            raise ModelFileError("the zero is not a finite number for each joint")
    if bare.zero is not None and bare.zero.shift.shape != (n_joints,):
        raise ModelFileError("the zero is not a number for each joint")
    if again is not None:
        if set(again.baselines) != set(bare.fitted_baselines):
            raise ModelFileError("the models for re-zeroing are not those of the calibration")
        prefix = f"{_REZEROED}/"
        fitted, baselines = _fit(again, parts, prefix)
        moves = _moves(bare, parts.pop(f"{prefix}moves", None))
        interval = _interval(parts.pop(f"{prefix}interval", None), n_joints)
        own[_REZEROED] = RezeroedFit(fitted, baselines, moves, interval)
    return replace(bare, offsets=offsets, **own)


def _moves(bare: Calibration, named: Mapping[str, Array] | None) -> Array | None:
    if named is None:
        return None
    moves, shape = named.get("signals", np.empty(0)), (len(bare.signals), len(bare.joints))
    if set(named) != {"signals"} or moves.shape != shape or not np.isfinite(moves).all():
        raise ModelFileError("what the zero moves is not a finite number for signals and joints")
    return moves


def _interval(named: Mapping[str, Array] | None, n_joints: int) -> Interval | None:
    return None if named is None else decode_interval(named, n_joints)
