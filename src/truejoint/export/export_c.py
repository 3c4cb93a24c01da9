"""Write a calibration as C99 source that needs nothing but math.h, and as a ROS package."""

import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache, partial
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final, Literal, get_args

import jinja2
import numpy as np
from numpy.typing import ArrayLike

from truejoint.array_types import Array
from truejoint.calibration.calibration import Calibration, as_calibration
from truejoint.errors import CalibrationError, ExportError
from truejoint.export.c_printer import print_kernels
from truejoint.export.c_values import Style
from truejoint.export.c_vectors import Answers, Vectors, make_vectors
from truejoint.files import write_all_atomically
from truejoint.filters import FilterStatus
from truejoint.robots import Robot
from truejoint.runtime import correction, fields
from truejoint.runtime.compensation import compensate
from truejoint.runtime.compensator import Compensator
from truejoint.runtime.error_model import NOISE, inputs_and_noise
from truejoint.runtime.fields import OnFault, Reaction
from truejoint.runtime.limits import RANGE_MARGIN, limits_of
from truejoint.runtime.status import Status, Unlearnt
from truejoint.toml_file import shipped_table

Precision = Literal["double", "float"]

_PREFIX: Final = re.compile(r"[A-Za-z](?:_?[A-Za-z0-9])*", re.ASCII)
_UNSAFE: Final = re.compile(r"[^A-Za-z0-9 _.,:;()\[\]{}<>=+/'%^-]")

DOUBLE_TOLERANCE: Final = 1e-12
"""Largest difference from Python [rad or m] that the check of a double source accepts."""

SINGLE_MARGIN: Final = 4.0
"""How many times the effect of rounding what is kept a float source may be off by."""
LARGEST_SHARE: Final = 0.01
"""Of a joint's largest correction, that a float source may be off by: its check must be able to
fail."""

_FILES: Final = shipped_table(__package__, "templates/files.toml")
_INPUTS: Final = ("t", "sample", "is_homed", "told_id", "offset")
_COMPENSATOR_INPUTS: Final = ("status", "wanted", "measured", "correction", "setpoint", "gain")
_OF_PYTHON: Final = Status.WRONG_SIZE | Status.OTHER_THREAD
_STATUSES: Final = [bit for bit in Status if bit not in _OF_PYTHON]
"""Statuses but for what only a sample or a thread of Python can be."""


def export_c(
    calibration: Calibration,
    folder: str | os.PathLike[str],
    *,
    prefix: str | None = None,
    precision: Precision = "double",
    level: float | None = None,
    range_margin: float = RANGE_MARGIN,
    on_fault: OnFault | Reaction = "hold",
    compensator: Compensator | None = None,
    overwrite: bool = False,
) -> tuple[Path, ...]:
    """Write a calibration as C99 source that does what `Corrector` does, and what checks it.

    Parameters
    ----------
    calibration : Calibration
    folder : path-like
        Made if it does not exist.
    prefix : str, optional
        Begins every name in the source and every file's; by default `default_prefix`.
    precision : {"double", "float"}
        Precision of the arithmetic; time stamps are double in either.
    level, range_margin : float
    on_fault : {"hold", "raw", "silent"} or OnFault
        As `truejoint.runtime.Corrector` takes them.
    compensator : Compensator, optional
        Also write what it does, around this calibration without its redundant signals, which its
        corrector is to be of.
    overwrite : bool
        Whether files that are there may be replaced.

    Returns
    -------
    tuple of Path
        ``<prefix>.h``, ``<prefix>.c``, ``<prefix>_vectors.h`` and ``<prefix>_check.c``; of a
        compensator ``<prefix>_compensator.h`` and ``.c``; of an error model
        ``<prefix>_error_model.h``, which does what `ErrorModel` does.

    Raises
    ------
    ExportError
        If the estimator has no C source, the model does not state that level, the prefix is no
        name, the compensator is of other joints, a file exists without
        `overwrite`, or a number does not fit the precision.
    ModelFileError
        If the calibration lacks what the checks need.

    Examples
    --------
    >>> [path.name for path in export_c(model, "controller", prefix="jaw")]
    ['jaw.h', 'jaw.c', 'jaw_vectors.h', 'jaw_check.c']
    """
    contents = source_files(
        calibration, prefix, precision, level=level, range_margin=range_margin,
        on_fault=on_fault, compensator=compensator,
    )  # fmt: skip
    return write_files(folder, contents, overwrite=overwrite)


def source_files(
    calibration: Calibration,
    prefix: str | None = None,
    precision: Precision = "double",
    *,
    level: float | None = None,
    range_margin: float = RANGE_MARGIN,
    on_fault: OnFault | Reaction = "hold",
    compensator: Compensator | None = None,
) -> dict[str, bytes]:
    """Give what `export_c` writes, by the name of each file."""
    calibration = as_calibration(calibration)
    prefix = check_prefix(default_prefix(calibration) if prefix is None else prefix)
    check_precision(precision)
    if compensator is not None:
        calibration = calibration.without_redundant()
        if compensator.corrector.signals != calibration.loop_signals:
            raise ExportError(
                f"the compensator is around {', '.join(compensator.corrector.signals)}, but the "
                f"calibration takes {', '.join(calibration.loop_signals)}; make it around this one"
            )
    try:
        limits = limits_of(calibration, range_margin)
        memory = fields.pack(calibration, limits, level, on_fault)
    except CalibrationError as refused:
        raise ExportError(str(refused)) from None
    guard = prefix.upper()
    kernels = (
        correction.correct_sample, correction.begin, correction.acknowledge,
        correction.tell_homing, correction.accept_offset,
    )  # fmt: skip
    program = print_kernels(
        kernels, memory, "state", f"{prefix}_state", single=precision == "float", inputs=_INPUTS,
        named={"homing": f"{guard}_NOT_HOMED"},
        enums={
            Status: f"{guard}_", Unlearnt: f"{guard}_UNLEARNT_", FilterStatus: f"{guard}_FILTER_",
        },
    )  # fmt: skip
    dtype = np.float64 if precision == "double" else np.float32
    vectors, answers, offset, error, strayed = make_vectors(
        calibration, limits, level, range_margin, on_fault, dtype, compensator
    )
    context: dict[str, Any] = {
        "program": program, "is_filter": f"{guard}_FILTER_" in program.functions,
        "in_doubt": _FILES["in_doubt"][int(memory.numbers[memory.layout.fields["on_fault"].index])],
        "needs_rezero": bool(memory.numbers[fields.NEEDS_REZERO]),
        "level": calibration.usual_level if level is None else level,
        "estimator": calibration.estimator,
        "rows": _vector_rows(vectors, answers, precision), "n_vectors": len(vectors),
        "vector_offset": offset,
    }  # fmt: skip
    context |= _calibration_context(calibration, prefix) | _precision_context(
        precision, calibration.joints, error,
        np.abs([limits.correction_lower, limits.correction_upper]).max(axis=0),
    )  # fmt: skip
    templates = dict(_FILES["source"])
    context["compensates"] = compensator is not None
    if NOISE in calibration.metadata:
        templates["_error_model.h"] = "error_model.h.j2"
        context["inputs"], context["sizes"], context["times"] = inputs_and_noise(calibration)
    if compensator is not None:
        loop = compensator.around(compensator.corrector).memory
        context |= {
            "loop": print_kernels(
                (compensate,), loop, "compensator", f"{prefix}_compensator",
                inputs=_COMPENSATOR_INPUTS,
            ),
            "rate": compensator.rate, "measured": compensator.measured,
            "vector_start": vectors.sample[0, compensator.measured],
            "setpoint_tolerance": np.maximum(SINGLE_MARGIN * strayed, DOUBLE_TOLERANCE),
        }  # fmt: skip
        templates |= _FILES["compensator"]
    return {
        f"{prefix}{ending}": render(template, context, precision)
        for ending, template in templates.items()
    }


def _vector_rows(vectors: Vectors, answers: Answers, precision: Precision) -> str:
    """Give the initialisers of the test vectors, a line each."""
    columns: list[Iterable[Any]] = [
        vectors.action, vectors.is_homed, vectors.homing_id, answers.unlearnt,
        Style(single=False).literals(vectors.t), rows(vectors.sample, precision), answers.status,
        rows(answers.position, "double"), rows(answers.half_width, "double"),
    ]  # fmt: skip
    if answers.setpoint.size:
        columns += [rows(answers.desired, "double"), rows(answers.setpoint, "double")]
    return "\n".join(f"    {{{', '.join(map(str, row))}}}," for row in zip(*columns, strict=True))


def default_prefix(calibration: Calibration) -> str:
    """Prefix of robot and arm, for instance ``"raven2_left"``.

    Examples
    --------
    >>> default_prefix(model)
    'davinci_grasper'
    """
    model = as_calibration(calibration)
    return "_".join(part for part in (model.robot, model.arm) if part)


def check_command(paths: Sequence[Path]) -> str:
    """Command that compiles and runs the check of an export, of the paths it gave.

    Examples
    --------
    >>> check_command(export_c(model, "controller", prefix="jaw"))
    'cc -std=c99 -O2 controller/jaw.c controller/jaw_check.c -lm -o check && ./check'
    """
    sources = " ".join(str(path) for path in paths if path.suffix == ".c")
    return f"cc -std=c99 -O2 {sources} -lm -o check && ./check"


def _precision_context(
    precision: Precision, joints: Sequence[str], error: Array, largest: Array
) -> dict[str, Any]:
    """Values that say how much is rounded, and how much of it the check allows each joint."""
    if precision == "double":
        notes = ["Double precision: equal to Python within 1e-12 (rad, m)."]
        return {"tolerance": np.full(len(joints), DOUBLE_TOLERANCE), "precision_notes": notes}
    tolerance = SINGLE_MARGIN * error
    wide = ~(tolerance <= LARGEST_SHARE * largest)
    if wide.any():
        joint = int(np.argmax(wide))
        raise ExportError(
            f"in float, {joints[joint]} would be off by up to {tolerance[joint]:.1e} (rad, m), too "
            f"much for corrections of up to {largest[joint]:.1e}; export in double"
        )
    notes = [
        "Single precision, but for time stamps: positions and half-widths of the test vectors are",
        f"within {tolerance.max():.1e} (rad, m) of those in double precision.",
    ]
    return {"tolerance": tolerance, "precision_notes": notes}


def _calibration_context(data: Calibration, prefix: str) -> dict[str, Any]:
    """Values of the templates that say what the calibration is made of."""
    stated_by = ""
    if data.interval is not None:
        stated_by = "for such motions as the interval was made of"
    elif data.family.states_deviation(data.fitted.params):
        stated_by = "as the model itself reckons"
    return {
        "prefix": prefix,
        "guard": prefix.upper(),
        "title": data.title,
        "stated_by": stated_by,
        "version": version("truejoint"),
        "data_sha256": data.metadata.get("data_sha256", "unknown"),
        "homing_unknown": fields.HOMING_UNKNOWN,
        "homing_of_calibration": fields.HOMING_OF_CALIBRATION,
        "homing_ids": list(data.origin.homing_ids),
        "signals": _named(data.loop_signals, {**data.units, **data.redundant}.__getitem__),
        "joints": _named(data.joints, lambda joint: data.units[f"measured/{joint}"]),
        "statuses": _bits(_STATUSES),
        "filter_statuses": _bits(FilterStatus),
        "n_signals": len(data.loop_signals),
        "n_joints": len(data.joints),
        "n_features": len(data.feature_set),
        "has_interval": data.interval is not None,
    }


def _bits(bits: Iterable[Any]) -> list[dict[str, Any]]:
    """Members of an enumeration with what they mean, after that which has none of them set."""
    named = [{"name": bit.name, "value": int(bit), "meaning": bit.words} for bit in bits]
    return [{"name": "OK", "value": 0, "meaning": "all is well"}, *named]


def _named(names: Sequence[str], unit: Callable[[str], str]) -> list[dict[str, str]]:
    """Names with unit and C identifier, numbered where two would be one."""
    identifiers = [name.replace("/", "_").upper() for name in names]
    named = []
    for i, (name, identifier) in enumerate(zip(names, identifiers, strict=True)):
        suffix = f"_{i}" if identifiers.count(identifier) > 1 else ""
        named.append({"name": name, "unit": unit(name), "identifier": identifier + suffix})
    return named


def check_precision(precision: str) -> None:
    """Refuse, with ExportError, a precision other than ``"double"`` and ``"float"``."""
    if precision not in get_args(Precision):
        raise ExportError(f"precision {precision!r:.60} is not 'double' or 'float'")


def check_prefix(prefix: str) -> str:
    """Return `prefix` if every C and C++ name may begin with it; raises ExportError."""
    if len(prefix) > 40 or not _PREFIX.fullmatch(prefix):
        raise ExportError(
            f"prefix {prefix!r:.60} cannot begin the names of the source; use up to 40 letters, "
            "digits and single underscores, a letter first and no underscore last"
        )
    return prefix


def table(values: ArrayLike, precision: Precision) -> str:
    """Braced initialiser of the values of an array, row by row."""
    return f"{{{', '.join(Style(precision == 'float').literals(values))}}}"


def rows(values: Array, precision: Precision) -> list[str]:
    """Braced initialisers of the rows of an array (n, k)."""
    return [table(row, precision) for row in values]


def comment(text: object) -> str:
    """Text that cannot end a C comment, whatever a model file says: plain ASCII, no ``*``."""
    return _UNSAFE.sub(".", str(text))


def render(template: str, context: Mapping[str, Any], precision: Precision) -> bytes:
    """Fill a template of this package with `context`; an unknown name is an error."""
    return _environment(precision).get_template(template).render(context).encode("ascii")


@cache
def _environment(precision: Precision) -> jinja2.Environment:
    """Templates and filters, each template compiled once."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("truejoint.export", "templates"),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,  # noqa: S701  # C source; texts from files go through `comment`
    )
    environment.globals["real"], environment.globals["single"] = precision, precision == "float"
    environment.globals["unlearnt"] = _bits(Unlearnt)[1:]
    environment.filters["table"] = partial(table, precision=precision)
    environment.filters["exact_table"] = partial(table, precision="double")
    environment.filters["comment"] = comment
    return environment


def write_files(
    folder: str | os.PathLike[str], contents: Mapping[str, bytes], *, overwrite: bool
) -> tuple[Path, ...]:
    """Write `contents` by file name into `folder`, none of them if one may not be written.

    Raises ExportError if a file exists and `overwrite` is false, or one cannot be written.
    """
    paths = tuple(Path(folder) / name for name in contents)
    try:
        Path(folder).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ExportError(f"{folder} cannot be written: {error.strerror or error}") from None
    files = dict(zip(paths, contents.values(), strict=True))
    write_all_atomically(files, overwrite=overwrite, error=ExportError)
    return paths


def export_ros(
    calibration: Calibration,
    folder: str | os.PathLike[str],
    *,
    prefix: str | None = None,
    precision: Precision = "double",
    overwrite: bool = False,
    **how: Any,
) -> tuple[Path, ...]:
    """Write a calibration as a package of catkin and ament: subscribe, correct, publish.

    The node reads ``measured_js``, and ``setpoint_js`` where the model has set-points. Signals
    that only check measured positions are left out where no joint state has them.

    Parameters
    ----------
    calibration : Calibration
    folder : path-like
        Folder of the package; made if it does not exist.
    prefix, precision, overwrite, **how
        As `export_c` takes them.

    Returns
    -------
    tuple of Path
        What `export_c` gives, then the files of the package.

    Raises
    ------
    ExportError
        As `export_c`, or if the model takes a signal that is in no joint state.

    Examples
    --------
    >>> [path.name for path in export_ros(model, "package", prefix="jaw")][-3:]
    ['jaw_ros2.cpp', 'correct.launch', 'correct.launch.xml']
    """
    robot = as_calibration(calibration).machine
    if not all(_value(robot, signal) for signal in calibration.loop_signals):
        calibration = calibration.without_redundant()
    prefix = default_prefix(calibration) if prefix is None else prefix
    signals = calibration.loop_signals
    values = [_value(robot, signal) for signal in signals]
    if lacking := [name for name, value in zip(signals, values, strict=True) if not value]:
        raise ExportError(
            f"no joint state has {', '.join(lacking)}, which the model takes: calibrate on "
            "others (--feature), or use --to c"
        )
    reads = {value.partition("[")[0] for value in values}
    context = _calibration_context(calibration, prefix) | {
        "inputs": [{"name": n, "value": v} for n, v in zip(signals, values, strict=True)],
        "joint_names": robot.joint_names,
        "corrected": robot.index(list(calibration.joints)),
        "corrected_names": calibration.joints,
        # Takes efforts on the joints to those at the motors.
        "motor_effort": None
        if robot.transmission is None or "motor" not in reads
        else robot.transmission.motor_effort(np.eye(len(robot.joint_names))),
        "needs_velocity": "in.velocity" in reads,
        "needs_effort": not reads.isdisjoint({"in.effort", "motor"}),
        "needs_setpoint": "setpoint_" in reads,
    }
    contents = source_files(calibration, prefix, precision, **how)
    for name, template in _FILES["ros"].items():
        contents[name.format(prefix)] = render(template, context, precision)
    for ros, name in _FILES["launch"].items():
        about = {**context, "ros": int(ros), "file": name}
        contents[name] = render("ros/launch.xml.j2", about, precision)
    return write_files(folder, contents, overwrite=overwrite)


def _value(robot: Robot, signal: str) -> str:
    """C++ of a signal in a joint state; empty where it is in none."""
    quantity, _, channel = signal.partition("/")
    effort = "in.effort" if robot.effort == "joint" or robot.transmission is None else "motor"
    arrays = {
        "measured": "in.position", "velocity": "in.velocity", "effort": effort,
        "setpoint": "setpoint_",
    }  # fmt: skip
    if quantity not in arrays:
        return ""
    if channel in robot.unused_channels:
        return "0.0"
    return f"{arrays[quantity]}[{robot.joint_names.index(channel)}]"
