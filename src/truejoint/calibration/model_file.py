"""What a calibration consists of in a model file, and how it is written and read."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Annotated, Any, Final, Literal, NamedTuple

import numpy as np

from truejoint import schema
from truejoint.array_types import Array
from truejoint.calibration.calibration import Calibration, RezeroedFit, as_calibration
from truejoint.calibration.container import read_model_file, write_model_file
from truejoint.calibration.domain import TrainingDomain
from truejoint.calibration.efforts import BEGINNINGS, EffortBaseline, count_effort_terms
from truejoint.calibration.interval import MAX_LEVELS, Interval, needed_trajectories
from truejoint.calibration.origin import Origin
from truejoint.calibration.redundancy import ParityEquations
from truejoint.calibration.zero import Zero
from truejoint.errors import CalibrationError, ModelFileError, TruejointError
from truejoint.estimators.family import EstimatorData, Target, find_family
from truejoint.features.feature_set import FeatureSet, is_signal
from truejoint.robots.catalogue import robot_of
from truejoint.schema import Bounds, Length, Pattern

MAX_JOINTS: Final = 64

_REZEROED: Final = "rezeroed_fit"

_Name = Annotated[str, Pattern(r"\w{1,60}", "a name of up to 60 letters, digits and _")]
_Unit = Annotated[str, Pattern(r"[^\x00-\x1f\x7f]{1,40}", "a text of 1 to 40 characters")]
_Edge = Annotated[float, Bounds(-1e300, 1e300)]
_Arrays = dict[str, dict[str, Array]]


_AXES: Final[Mapping[type, Mapping[str, str]]] = {
    TrainingDomain: {
        **{f.name: "s" for f in fields(TrainingDomain) if f.name.startswith("signal_")},
        "feature_mean": "f",
        "whitening": "ff",
        "error_lower": "j",
        "error_upper": "j",
    },
    EffortBaseline: {
        **{f.name: "j" for f in fields(EffortBaseline)},
        "coef": "jt",
        "beginning": "bj",
    },
    ParityEquations: {**{f.name: "e" for f in fields(ParityEquations)}, "matrix": "es"},
    Interval: {"levels": "l", **{f.name: "lj" for f in fields(Interval) if "widths" in f.name}},
}
"""A letter for each axis of an array: s signals of the loop, f features, j joints, t terms of an
effort, b beginnings; another one is of any length. A field that is not named is a number."""
_PARTS: Final[Mapping[str, type[Any]]] = {
    "training_domain": TrainingDomain,
    "effort_baseline": EffortBaseline,
    "parity": ParityEquations,
    "interval": Interval,
}
_POSITIVE: Final = re.compile(r"dt|scale|\w+_limit|residual|correlation|beginning")
_SIGNED: Final = re.compile(r"feature_mean|whitening|coef|matrix|intercept|.*lower|.*upper")


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
        taken = {"model", "zero", "moves", _REZEROED, *_PARTS}  # names of parts
        for name in (name for fit in fits for name in fit.baselines):
            if name in taken or not name.isidentifier():
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
        for fit in {id(fit): fit for fit in (calibration, calibration.for_rezeroing)}.values():
            for name, data in {**fit.fitted_baselines, "model": fit.fitted}.items():
                family, sizes = find_family(data.family), (len(fit.feature_set), len(fit.joints))
                try:
                    family.check(data, *sizes)
                    if family.row is not None:
                        family.memory(data, *sizes)
                except CalibrationError as error:
                    raise ModelFileError(f"estimator {name!r}: {error}") from None
    except TruejointError as error:
        raise ModelFileError(f"{path}: {error}; copy or calibrate it again") from None
    return calibration


def encode(calibration: Calibration) -> tuple[dict[str, Any], dict[str, Array]]:
    """Give description and arrays for `container.write_model_file`."""
    c, again = calibration, calibration.rezeroed_fit
    description = {
        "kind": "calibration",
        "robot": c.machine.to_dict(),
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
    parts = _fit_arrays(c, c.fitted_baselines) | {"zero": c.offsets}
    for name in ("training_domain", "effort_baseline", "parity"):
        parts[name] = encode_arrays(getattr(c, name))
    if c.zero is not None:
        description["zero"] = schema.plain(c.zero)
        if np.isnan(c.zero.deviation).any():
            del description["zero"]["deviation"]
    if again is not None:
        description[_REZEROED] = _fit_entry(again.fitted, again.baselines)
        of_fit = _fit_arrays(again, again.baselines)
        parts |= {f"{_REZEROED}/{name}": arrays for name, arrays in of_fit.items()}
    arrays = {f"{part}/{name}": a for part, named in parts.items() for name, a in named.items()}
    return description, arrays


def _fit_entry(fitted: EstimatorData, baselines: Mapping[str, EstimatorData]) -> dict[str, Any]:
    def entry(data: EstimatorData) -> dict[str, Any]:
        return {"family": data.family, "params": _plain(data.params)}

    entries = {name: entry(data) for name, data in baselines.items()}
    return {"model": entry(fitted), "baselines": entries}


def _fit_arrays(
    fit: Calibration | RezeroedFit, baselines: Mapping[str, EstimatorData]
) -> dict[str, Mapping[str, Array]]:
    return {
        "model": fit.fitted.arrays,
        **{name: data.arrays for name, data in baselines.items()},
        "moves": {} if fit.moves is None else {"signals": fit.moves},
        "interval": encode_arrays(fit.interval),
    }


def encode_arrays(value: Any) -> dict[str, Array]:
    """Fields of a dataclass by name, numbers as arrays of one element; nothing of None."""
    return {
        field.name: np.atleast_1d(np.asarray(getattr(value, field.name), dtype=np.float64))
        for field in (fields(value) if value is not None else ())
    }


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
    parts: _Arrays = {}
    for path, array in arrays.items():
        part, _, name = path.partition("/")
        if part == _REZEROED:
            inner, _, name = name.partition("/")
            part = f"{part}/{inner}"
        parts.setdefault(part, {})[name] = array
    try:
        feature_set = FeatureSet.parse(stated.features)
        machine = robot_of(stated.robot, "the model file")
    except TruejointError as error:
        raise ModelFileError(str(error)) from None
    if len(stated.ranges) != len(feature_set):
        raise ModelFileError("the training ranges are not those of the features")
    fitted, baselines = _fit(stated.fit, parts, "")
    lower, upper = np.array(stated.ranges, dtype=float).T.copy()
    bare = Calibration(
        machine=machine,
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
        offsets=parts.pop("zero", {}),
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
    entry: _Fit, parts: _Arrays, prefix: str
) -> tuple[EstimatorData, dict[str, EstimatorData]]:
    """Take the model and the baselines of a fit out of the parts."""

    def data(name: str, stated: _Estimator) -> EstimatorData:
        return EstimatorData(stated.family, _tuples(stated.params), parts.pop(prefix + name, {}))

    baselines = {name: data(name, stated) for name, stated in entry.baselines.items()}
    return data("model", entry.model), baselines


def _with_parts(bare: Calibration, parts: _Arrays, again: _Fit | None) -> Calibration:
    """Take what the calibration may have besides out of the parts: what checks, and zeros."""
    n_joints = len(bare.joints)
    zeros = [] if bare.zero is None else [bare.zero.shift]
    if not set(bare.offsets) <= {"model", *bare.fitted_baselines}:
        raise ModelFileError("the zero is of none of the models")
    for offset in (*bare.offsets.values(), *zeros):
        if offset.shape != (n_joints,) or not np.isfinite(offset).all():
            raise ModelFileError("the zero is not a finite number for each joint")
    sizes = {"s": len(bare.loop_signals), "f": len(bare.feature_set), "j": n_joints}
    sizes |= {"t": count_effort_terms(n_joints), "b": len(BEGINNINGS)}
    taken: dict[str, Any] = {
        name: decode_arrays(kind, parts.pop(name), sizes)
        for name, kind in _PARTS.items()
        if name in parts
    }
    parity = taken.get("parity")
    if parity is not None and not np.isin(parity.joint, np.arange(n_joints)).all():
        raise ModelFileError("the parity equations are of joints that there are not")
    taken["moves"] = _moves(bare, parts.pop("moves", None))
    if again is not None:
        if set(again.baselines) != set(bare.fitted_baselines):
            raise ModelFileError("the models for re-zeroing are not those of the calibration")
        fit = RezeroedFit(*_fit(again, parts, f"{_REZEROED}/"))
        moves = _moves(bare, parts.pop(f"{_REZEROED}/moves", None))
        widths = parts.pop(f"{_REZEROED}/interval", None)
        interval = None if widths is None else decode_arrays(Interval, widths, sizes)
        taken[_REZEROED] = replace(fit, moves=moves, interval=interval)
    return replace(bare, **taken)


def decode_arrays(kind: type[Any], arrays: Mapping[str, Array], sizes: Mapping[str, int]) -> Any:
    """Inverse of `encode_arrays` for a part of a model, whose axes have these `sizes`.

    Raises ModelFileError when names or shapes are not those of the part, or a number is not finite
    or none that a calibration gives.
    """
    axes, title = _AXES[kind], re.sub(r"\B([A-Z])", r" \1", kind.__name__).lower()
    lengths, values, is_possible = {**sizes, "1": 1}, dict[str, Any](), True
    stated = fields(kind)
    if set(arrays) != {field.name for field in stated}:
        raise ModelFileError(f"the arrays of the {title} are not those of the model")
    for field_ in stated:
        name, array = field_.name, arrays[field_.name]
        letters = axes.get(name, "1")
        pairs = zip(letters, array.shape, strict=False)
        shape = [lengths.setdefault(letter, length) for letter, length in pairs]
        if array.ndim != len(letters) or list(array.shape) != shape:
            raise ModelFileError(f"the arrays of the {title} are not those of the model")
        if not np.isfinite(array).all():
            raise ModelFileError(f"the {title} is not finite")
        least = array.min(initial=np.inf)
        is_possible &= least >= 0.0 or _SIGNED.fullmatch(name) is not None
        is_possible &= least > 0.0 or _POSITIVE.fullmatch(name) is None
        number = int if field_.type == "int" else float
        values[name] = array if name in axes else number(array[0])
    for name in arrays:
        if "lower" in name:
            is_possible &= bool((arrays[name] <= arrays[name.replace("lower", "upper")]).all())
    if not is_possible or (kind is Interval and not _can_be_stated(arrays)):
        raise ModelFileError(f"the {title} holds values that no calibration gives")
    return kind(**values)


def _can_be_stated(arrays: Mapping[str, Array]) -> bool:
    """Whether levels of an interval ascend, as its widths do, and its trajectories are enough."""
    levels = arrays["levels"]
    return (
        1 <= len(levels) <= MAX_LEVELS
        and bool((np.diff(levels) > 0.0).all() and 0.0 < levels[0] <= levels[-1] < 1.0)
        and all((np.diff(widths, axis=0) >= 0.0).all() for widths in arrays.values())
        and needed_trajectories(float(levels[-1])) <= arrays["trajectories"][0]
        and max(arrays[name][0] for name in ("trajectories", "homings")) <= 1e9
    )


def _moves(bare: Calibration, named: Mapping[str, Array] | None) -> Array | None:
    if named is None:
        return None
    moves, shape = named.get("signals", np.empty(0)), (len(bare.signals), len(bare.joints))
    if set(named) != {"signals"} or moves.shape != shape or not np.isfinite(moves).all():
        raise ModelFileError("what the zero moves is not a finite number for signals and joints")
    return moves
