"""A calibration as a model file: safetensors, whose header holds a JSON description.

Nothing in a file is ever run. Size, header, shapes and the hash are checked before any number is
used.
"""

import json
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Final, Literal, NamedTuple, get_type_hints

import numpy as np
import safetensors
import safetensors.numpy

from truejoint import files, schema
from truejoint.array_types import Array
from truejoint.calibration.calibration import Calibration, Fit, as_calibration
from truejoint.calibration.conditions import CELLS
from truejoint.calibration.domain import TrainingDomain
from truejoint.calibration.efforts import BEGINNINGS, EffortBaseline, count_effort_terms
from truejoint.calibration.interval import MAX_LEVELS, Interval, needed_trajectories
from truejoint.calibration.origin import Origin
from truejoint.calibration.potentiometers import STRETCHES, PotentiometerReference
from truejoint.calibration.redundancy import ParityEquations
from truejoint.calibration.zero import Zero
from truejoint.errors import CalibrationError, ModelFileError, TruejointError, other_kind
from truejoint.estimators.family import EstimatorData, Target, find_family
from truejoint.features.feature_set import FeatureSet, is_signal
from truejoint.robots.catalogue import robot_of
from truejoint.schema import Bounds, Length, Pattern, Shape
from truejoint.toml_file import with_tuples

FORMAT_VERSION: Final = 8
MAX_FILE_BYTES: Final = 256 * 2**20  # a forest of a hundred full trees takes half of it
MAX_HEADER_BYTES: Final = 2**20
MAX_TENSORS: Final = 512
_KEY: Final = "truejoint"
_OTHER_FORMATS: Final = frozenset(
    {".c", ".csv", ".h", ".html", ".json", ".mat", ".npy", ".onnx", ".parquet", ".pkl", ".toml"}
)
_DAMAGED: Final = "the file is damaged or was edited; copy or calibrate it again"
MAX_JOINTS: Final = 64

_REZEROED: Final = "rezeroed_fit"
_SAME: Final = "origin", "joints", "target", "units", "gap_limit", "metadata", "redundant", "zero"
"""Fields of a calibration that its description holds by the same name."""

_Name = Annotated[str, Pattern(r"\w{1,60}", "a name of up to 60 letters, digits and _")]
_Unit = Annotated[str, Pattern(r"[^\x00-\x1f\x7f]{1,40}", "a text of 1 to 40 characters")]
_Axes = Mapping[str, str]
_Parts = dict[str, dict[str, Array]]


def _arrays(kind: type[Any], usual: str, **others: str) -> tuple[type[Any], _Axes]:
    """Give a dataclass and its fields' axes; numbers are arrays of one, `others` come by axes."""
    axes_of = {name: axes for axes, names in others.items() for name in names.split()}
    numbers = {float: "1", int: "i"}
    hints = get_type_hints(kind).items()
    return kind, {name: axes_of.get(name, numbers.get(hint, usual)) for name, hint in hints}


_PARTS: Final[Mapping[str, tuple[type[Any], _Axes]]] = {
    "training_domain": _arrays(
        TrainingDomain,
        "s",
        f="feature_mean",
        ff="whitening",
        j="error_lower error_upper stride swing_lower swing_upper",
        jc="swings",
    ),
    "effort_baseline": _arrays(EffortBaseline, "j", jt="coef", bj="beginning"),
    "parity": _arrays(ParityEquations, "e", es="matrix"),
    "interval": _arrays(Interval, "lj", l="levels"),
    "potentiometers": _arrays(PotentiometerReference, "j", jp="difference rows"),
}
"""A letter for each axis of an array: s signals of the loop, n those of the model, f features, j
joints, t terms of an effort, b beginnings, p stretches, c pairs of turning points; another one is
of any length."""
_POSITIVE: Final = re.compile(r"dt|scale|stride|\w+_limit|residual|correlation|beginning")
_SIGNED: Final = re.compile(
    r"feature_mean|whitening|coef|difference|matrix|intercept|.*lower|.*upper"
)


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
    ranges: Annotated[Array, Shape((None, 2)), Bounds(-1e300, 1e300)]
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
        if (self.ranges[:, 0] > self.ranges[:, 1]).any():
            raise ModelFileError("ranges: a lower bound is above its upper one")
        if any(not is_signal(name) for name in self.redundant):  # they stand in C source
            raise ModelFileError(f"redundant: {list(self.redundant)!r:.80} is called as none is")
        if len(self.ranges) != len(self.feature_set):
            raise ModelFileError("ranges: they are not those of the features")
        if set(self.units) != self.signals or set(self.redundant) & self.signals:
            raise ModelFileError("units: they are not those of the columns that the model needs")

    @cached_property
    def feature_set(self) -> FeatureSet:
        """Inputs of the model."""
        return FeatureSet.parse(self.features)

    @property
    def signals(self) -> set[str]:
        """Columns that the model needs, besides those that check them."""
        return {*self.feature_set.signals, *(f"measured/{joint}" for joint in self.joints)}


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
    path, data = check_name(path), to_bytes(*encode(calibration))
    try:
        from_bytes(data)
    except ModelFileError as error:
        raise ModelFileError(f"{path} is not written, it could not be read back: {error}") from None
    files.write_atomically(path, data, overwrite=overwrite, error=ModelFileError)


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
    if not isinstance(path, str | os.PathLike):
        raise ModelFileError(other_kind(path, "path", "give that of a model file"))
    path = Path(path)
    content = files.read_small(path, ModelFileError, MAX_FILE_BYTES, "a model")
    try:
        description, arrays = from_bytes(content)
    except ModelFileError as error:
        raise ModelFileError(f"{path}: {error}") from None
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
    """Give description and arrays for `to_bytes`."""
    c, parts = calibration, dict[str, Mapping[str, Array]]()
    description = {
        "kind": "calibration",
        "robot": c.machine.to_dict(),
        "features": list(c.feature_set.names),
        "ranges": np.column_stack([c.lower, c.upper]).tolist(),
        **{name: schema.plain(getattr(c, name)) for name in _SAME},
    }
    if c.zero is None:
        del description["zero"]
    elif np.isnan(c.zero.deviation).any():
        del description["zero"]["deviation"]
    parts["zero"] = c.offsets
    parts |= {name: _arrays_of(getattr(c, name)) for name in _PARTS}
    parts["moves"] = {} if c.moves is None else {"signals": c.moves}
    for key, prefix, fit in (
        ("fit", "", Fit(c.fitted, c.fitted_baselines)),
        (_REZEROED, f"{_REZEROED}/", c.rezeroed_fit),
    ):
        if fit is None:
            continue
        models = {"model": fit.fitted, **fit.baselines}
        entries = {
            name: {
                "family": data.family,
                "params": json.loads(json.dumps(data.params, default=_plain)),
            }
            for name, data in models.items()
        }
        description[key] = {"model": entries.pop("model"), "baselines": entries}
        parts |= {prefix + name: data.arrays for name, data in models.items()}
    arrays = {f"{part}/{name}": a for part, named in parts.items() for name, a in named.items()}
    return description, arrays


def _arrays_of(value: Any) -> dict[str, Array]:
    """Fields of a dataclass by name, numbers as arrays of one element; nothing of None."""
    named = {} if value is None else vars(value)
    return {name: np.atleast_1d(np.asarray(v, dtype=np.float64)) for name, v in named.items()}


def _plain(value: Any) -> Any:
    """JSON value of a parameter that is none; a generator of random numbers states no seed."""
    return None if isinstance(value, np.random.RandomState) else schema.plain(value)


def decode(description: Mapping[str, Any], arrays: Mapping[str, Array]) -> Calibration:
    """Inverse of `encode`.

    Raises ModelFileError (RobotError for the robot) if any part is not as it must be. Parameters
    and arrays of the estimators are not looked into: that is up to `Family.check`.
    """
    stated = schema.read(_Description, description, "the model description", ModelFileError)
    parts: _Parts = {}
    for path, array in arrays.items():
        *part, name = path.split("/", 2 if path.startswith(f"{_REZEROED}/") else 1)
        parts.setdefault("/".join(part), {})[name] = array
    n_joints = len(stated.joints)
    sizes = {
        "s": len(stated.units) + len(stated.redundant), "n": len(stated.units), "j": n_joints,
        "f": len(stated.features), "t": count_effort_terms(n_joints), "b": len(BEGINNINGS),
        "p": STRETCHES, "c": CELLS**2,
    }  # fmt: skip
    first, again = _fit(stated.fit, parts, ""), stated.rezeroed_fit
    offsets, moves = parts.pop("zero", {}), parts.pop("moves", {})
    lower, upper = stated.ranges.T.copy()
    calibration = Calibration(
        machine=robot_of(stated.robot, "the model file"),
        feature_set=stated.feature_set,
        lower=lower,
        upper=upper,
        fitted=first.fitted,
        fitted_baselines=first.baselines,
        moves=_checked("moves", {"signals": "nj"} if moves else {}, moves, sizes).get("signals"),
        rezeroed_fit=None if again is None else _fit(again, parts, f"{_REZEROED}/"),
        offsets=_checked("zero", dict.fromkeys(offsets, "j"), offsets, sizes),
        **{name: _part(name, parts, sizes) for name in _PARTS},
        **{name: getattr(stated, name) for name in _SAME},
    )
    if not set(offsets) <= {"model", *first.baselines}:
        raise ModelFileError("the zero is of none of the models")
    if stated.zero is not None:
        _checked("zero", {"shift": "j"}, {"shift": stated.zero.shift}, sizes)
    parity = calibration.parity
    if parity is not None and not np.isin(parity.joint, np.arange(n_joints)).all():
        raise ModelFileError("the parity equations are of joints that there are not")
    if again is not None and set(again.baselines) != set(first.baselines):
        raise ModelFileError("the models for re-zeroing are not those of the calibration")
    if parts:
        raise ModelFileError(f"arrays {sorted(parts)[:5]} belong to no part of the model")
    return calibration


def _fit(entry: _Fit, parts: _Parts, prefix: str) -> Fit:
    """Take the models of a fit out of the parts."""
    models = {
        name: EstimatorData(stated.family, with_tuples(stated.params), parts.pop(prefix + name, {}))
        for name, stated in {**entry.baselines, "model": entry.model}.items()
    }
    return Fit(models.pop("model"), models)


def _part(name: str, parts: _Parts, sizes: Mapping[str, int]) -> Any:
    """Take a part of a model out of the parts; None where it is not there.

    Raises ModelFileError when names or shapes are not those of the part, or a number is not finite
    or none that a calibration gives.
    """
    kind, axes = _PARTS[name]
    arrays, title = parts.pop(name, None), name.replace("_", " ")
    if arrays is None:
        return None
    values = _checked(title, axes, arrays, sizes)
    is_possible = kind is not Interval or _can_be_stated(arrays)
    for key, array in arrays.items():
        least = array.min(initial=np.inf)
        is_possible &= least >= 0.0 or _SIGNED.fullmatch(key) is not None
        is_possible &= least > 0.0 or _POSITIVE.fullmatch(key) is None
        if "lower" in key:
            is_possible &= bool((array <= arrays[key.replace("lower", "upper")]).all())
    if not is_possible:
        raise ModelFileError(f"the {title} holds values that no calibration gives")
    return kind(**values)


def _checked(
    title: str, axes: _Axes, arrays: Mapping[str, Array], sizes: Mapping[str, int]
) -> dict[str, Any]:
    """Arrays and numbers of a part whose axes have these `sizes`."""
    lengths, values = {**sizes, "1": 1, "i": 1}, dict[str, Any]()
    if set(arrays) != set(axes):
        raise ModelFileError(f"the arrays of the {title} are not those of the model")
    for name, letters in axes.items():
        array = arrays[name]
        pairs = zip(letters, array.shape, strict=False)
        shape = [lengths.setdefault(letter, length) for letter, length in pairs]
        if array.ndim != len(letters) or list(array.shape) != shape:
            raise ModelFileError(f"the arrays of the {title} are not those of the model")
        if not np.isfinite(array).all():
            raise ModelFileError(f"the {title} is not finite")
        values[name] = {"1": float, "i": int}[letters](array[0]) if letters in "1i" else array
    return values


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


def check_name(path: str | os.PathLike[str]) -> Path:
    """Path of a model file to write; raises ModelFileError when its ending is another format's."""
    path = Path(path)
    if path.suffix.lower() in _OTHER_FORMATS:
        raise ModelFileError(
            f"{path}: a model file is not {path.suffix}; call it "
            f"{path.with_suffix('.safetensors').name}, and see `truejoint export` for C and ONNX"
        )
    return path


def to_bytes(description: Mapping[str, Any], arrays: Mapping[str, Array]) -> bytes:
    """Bytes of a model file; the same for the same model."""
    arrays = {name: np.ascontiguousarray(array, dtype="<f8") for name, array in arrays.items()}
    versioned = {**description, "format": FORMAT_VERSION}
    signed = {**versioned, "sha256": files.content_hash(versioned, arrays)}
    return bytes(safetensors.numpy.save(arrays, metadata={_KEY: files.canonical_json(signed)}))


def from_bytes(data: bytes) -> tuple[dict[str, Any], dict[str, Array]]:
    """Give description and arrays of the bytes of a model file; raises ModelFileError."""
    if len(data) > MAX_FILE_BYTES:
        raise ModelFileError(
            f"larger than {MAX_FILE_BYTES} bytes, which no truejoint model is; {_DAMAGED}"
        )
    if data[:4] == b"PAR1":
        raise ModelFileError("is a Parquet file, as recordings are; name the model file here")
    length = int.from_bytes(data[:8], "little")
    if len(data) < 8 or length > min(MAX_HEADER_BYTES, len(data) - 8):
        raise ModelFileError(
            f"{len(data)} bytes with a header said to have {length}: not a safetensors file of "
            f"truejoint, or cut short; {_DAMAGED}"
        )
    try:
        arrays = safetensors.numpy.load(data)
    except (safetensors.SafetensorError, KeyError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise ModelFileError(f"its arrays cannot be read ({reason:.80}); {_DAMAGED}") from None
    description = _header(data[8 : 8 + length])
    version = description.pop("format", None)
    if version is True or version != FORMAT_VERSION:
        is_newer = isinstance(version, int) and version > FORMAT_VERSION
        word = "newer than" if is_newer else "not"
        advice = "update truejoint" if is_newer else "calibrate again"
        raise ModelFileError(
            f"format version {version!r:.40} is {word} {FORMAT_VERSION}, the newest that this "
            f"truejoint reads; {advice}"
        )
    if len(arrays) > MAX_TENSORS:
        raise ModelFileError(f"{len(arrays)} tensors, more than {MAX_TENSORS}; {_DAMAGED}")
    for name, array in arrays.items():
        if array.dtype != np.float64 or array.ndim not in (1, 2):
            raise ModelFileError(f"tensor {name!r:.60} has a wrong type or shape; {_DAMAGED}")
    digest = description.pop("sha256", None)
    if not files.is_as_written(digest, {**description, "format": FORMAT_VERSION}, arrays):
        raise ModelFileError(f"its content does not match its hash; {_DAMAGED}")
    return description, {name: np.array(array) for name, array in arrays.items()}


def _header(header: bytes) -> dict[str, Any]:
    """Give the JSON object that stands in the header, which safetensors has checked."""
    metadata = json.loads(header).get("__metadata__", {})
    if _KEY not in metadata:
        raise ModelFileError(
            f"a safetensors file without truejoint's part in its header; {_DAMAGED}"
        )
    try:
        description = json.loads(metadata[_KEY], parse_constant=int)  # refuses NaN and Infinity
    except (ValueError, RecursionError):
        description = None
    if not isinstance(description, dict):
        raise ModelFileError(f"the model description is not a JSON object; {_DAMAGED}")
    return description
