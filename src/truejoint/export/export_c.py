"""Write a calibration as C99 source that needs nothing but math.h."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from truejoint.calibration import Calibration
from truejoint.calibration.encoding import CalibrationData, decode, encode
from truejoint.calibration.interval import inverse_span
from truejoint.errors import ExportError
from truejoint.estimators.sequence import SequenceRegressor
from truejoint.export.c_history import FILTER_MEANINGS, history_context
from truejoint.export.c_models import BLOCK, model_context
from truejoint.export.c_source import (
    Precision,
    check_precision,
    check_prefix,
    render,
    write_files,
)
from truejoint.export.c_vectors import Vector, homing_ids, make_vectors, single_error
from truejoint.models.families import EstimatorData
from truejoint.runtime.limits import RANGE_MARGIN, Limits, limits_of
from truejoint.runtime.status import Status

Array = NDArray[np.float64]

DOUBLE_TOLERANCE: Final = 1e-12
"""Largest difference from Python [rad or m] that the check of a double source accepts."""

MEANINGS: Final = {
    Status.OK: "the position is corrected",
    Status.NOT_FINITE: "a signal, or the time stamp, is NaN or infinite",
    Status.STALE: "the stamp is that of the last sample or an older one",
    Status.TIME_JUMP: "the stamp is further from the last one than the history may bridge",
    Status.SPIKE: "a signal changed faster than it ever did in training",
    Status.FROZEN: "a signal stands exactly still while its joint moves, or all of them for long",
    Status.OUT_OF_RANGE: "a feature or a signal is outside its trained range",
    Status.OUT_OF_DOMAIN: "the features together are unlike any trained row",
    Status.IMPLAUSIBLE: "the correction is larger than the errors seen in training",
    Status.NOT_HOMED: "nobody has said that the robot is homed",
    Status.HOMED_AGAIN: "the robot was homed again, so its positions are shifted",
}
"""All bits but WRONG_SIZE: a sample in C has its size by its type."""


def export_c(
    calibration: Calibration,
    folder: str | os.PathLike[str],
    *,
    prefix: str | None = None,
    precision: Precision = "double",
    level: float = 0.9,
    range_margin: float = RANGE_MARGIN,
    overwrite: bool = False,
) -> tuple[Path, ...]:
    """Write a calibration as C99 source that does what `Corrector` does, and what checks it.

    Parameters
    ----------
    calibration : Calibration
        Of a regressor, with the training_domain of its training rows.
    folder : path-like
        Receives ``<prefix>.h``, ``<prefix>.c``, ``<prefix>_vectors.h`` and ``<prefix>_check.c``;
        made if it does not exist.
    prefix : str, optional
        Beginning of every name in the source; `default_prefix` by default.
    precision : {"double", "float"}
        Of the arithmetic; time stamps are double in either.
    level, range_margin : float
        As `Corrector` takes them: probability of the half-width, where the model has an interval,
        and how far outside its trained range a feature may lie.
    overwrite : bool
        Whether files that are there may be replaced.

    Returns
    -------
    tuple of Path
        The files.

    Raises
    ------
    ExportError
        If the estimator has no C source, the prefix is no name, a file exists, or a number does not
        fit the precision.
    ModelFileError
        If the calibration lacks what the checks need.
    CalibrationError
        If the interval does not state that level.
    """
    prefix = check_prefix(default_prefix(calibration) if prefix is None else prefix)
    check_precision(precision)
    data = decode(*encode(calibration))
    limits = limits_of(data, range_margin)
    context: dict[str, Any] = {"prefix": prefix, "guard": prefix.upper(), "level": level}
    context |= _model_context(calibration, data.model, precision)
    size = 8 if precision == "double" else 4
    context |= _calibration_context(data, limits, level, size, context["room"])
    context |= {"title": calibration.title, "estimator": calibration.estimator}
    vectors, offset = make_vectors(
        calibration, data, limits, level, range_margin,
        np.float64 if precision == "double" else np.float32,
    )  # fmt: skip
    context |= {"rows": vectors, "vector_offset": offset}
    context |= _precision_context(data, vectors, precision, context)
    texts = {
        f"{prefix}{ending}": render(template, context, precision)
        for ending, template in {
            ".h": "corrector.h.j2",
            ".c": "corrector.c.j2",
            "_vectors.h": "vectors.h.j2",
            "_check.c": "check.c.j2",
        }.items()
    }
    contents = {name: text.encode("ascii") for name, text in texts.items()}
    return write_files(folder, contents, overwrite=overwrite)


def default_prefix(calibration: Calibration) -> str:
    """Prefix of robot and arm, for instance ``"raven2_left"``."""
    return "_".join(part for part in (calibration.robot, calibration.arm) if part)


def check_command(paths: Sequence[Path]) -> str:
    """Command that compiles and runs the check of an export, of the paths it gave."""
    sources = " ".join(str(path) for path in paths if path.suffix == ".c")
    return f"cc -std=c99 -O2 {sources} -lm -o check && ./check"


def _model_context(
    calibration: Calibration, data: EstimatorData, precision: Precision
) -> dict[str, Any]:
    """Values of the templates that say what the estimator is made of."""
    if isinstance(calibration.model, SequenceRegressor):
        found: tuple[str, Mapping[str, Any]] = history_context(calibration.model)
    else:
        found = model_context(data)
    template, values = found
    context = {"is_filter": False, "memory": (), **values, "model_template": template}
    if context["is_filter"] and precision != "double":
        raise ExportError(
            f"estimator {calibration.estimator!r} holds variances that differ too much for a "
            f"{precision}; export it in double"
        )
    return context


def _precision_context(
    data: CalibrationData[EstimatorData],
    vectors: list[Vector],
    precision: Precision,
    context: Mapping[str, Any],
) -> dict[str, Any]:
    """Values that say how much is rounded, and how much of it the check allows."""
    if precision == "double":
        notes = ["Double precision: equal to Python within 1e-12 (rad, m)."]
        return {"tolerance": DOUBLE_TOLERANCE, "precision_notes": notes}
    error = single_error(data, vectors, context)
    good = [float(np.abs(v.position).max()) for v in vectors if v.status == Status.OK]
    largest = max(good, default=0.0)
    notes = [
        "Single precision, but for time stamps: computed so, positions of the test vectors are",
        f"within {error:.1e} (rad, m) of those in double precision.",
    ]
    rounding = float(np.finfo(np.float32).eps) * largest
    return {"tolerance": 4 * error + 4 * rounding, "precision_notes": notes}


def _calibration_context(
    data: CalibrationData[EstimatorData], limits: Limits, level: float, size: int, room: int
) -> dict[str, Any]:
    """Values of the templates that say what the calibration is made of.

    `size` is that of a number in bytes, `room` how many the model needs on the stack.
    """
    features, signals = data.feature_set.features, data.signals
    # The length of a whitened row is all that counts, so a triangular factor does as well.
    factor = np.asarray(np.linalg.qr(limits.whitening.T, mode="r")).T
    extra = -len(factor) % BLOCK
    whitening = np.pad(factor, ((0, extra), (0, extra)))
    interval, k = data.interval, len(features)
    return {
        "stack_bytes": size * (room + k + 2 * len(whitening) + len(data.joints)) + 256,
        "version": version("truejoint"),
        "data_sha256": data.metadata.get("data_sha256", "unknown"),
        "homing_ids": homing_ids(data.metadata),
        "zeroed": "rezeroed" in data.metadata,
        "signals": _named(signals, data.units.__getitem__),
        "joints": _named(data.joints, lambda joint: data.units[f"measured/{joint}"]),
        "statuses": _bits(MEANINGS),
        "filter_statuses": _bits(FILTER_MEANINGS),
        "n_signals": len(signals),
        "n_joints": len(data.joints),
        "n_features": k,
        "features": [
            {
                "text": str(feature),
                "operation": feature.operation,
                "parameter": feature.parameter,
                "source": signals.index(feature.signal),
            }
            for feature in features
        ],
        "operations": {feature.operation for feature in features},
        "stateful": any(feature.memory for feature in features),
        "measured": [signals.index(f"measured/{joint}") for joint in data.joints],
        "target": data.target,
        "limits": limits,
        "whitening": whitening,
        "domain_columns": len(whitening),
        "lower": data.lower,
        "upper": data.upper,
        "per_span": inverse_span(data.lower, data.upper),
        "has_interval": interval is not None,
        "base_width": np.zeros(0) if interval is None else interval.half_width(level),
        "growth": 0.0 if interval is None else interval.growth,
        "needs_rezero": interval is not None and interval.rezero > 0.0,
    }


def _bits(meanings: Mapping[Any, str]) -> list[dict[str, Any]]:
    return [
        {"name": bit.name or "OK", "value": int(bit), "meaning": meaning}
        for bit, meaning in meanings.items()
    ]


def _named(names: Sequence[str], unit: Callable[[str], str]) -> list[dict[str, str]]:
    """Names with unit and C identifier, numbered where two would be one."""
    identifiers = [name.replace("/", "_").upper() for name in names]
    return [
        {
            "name": name,
            "unit": unit(name),
            "identifier": identifier if identifiers.count(identifier) == 1 else f"{identifier}_{i}",
        }
        for i, (name, identifier) in enumerate(zip(names, identifiers, strict=True))
    ]
