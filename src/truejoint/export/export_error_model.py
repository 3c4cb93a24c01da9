"""Write an error model as C99, for simulators."""

from __future__ import annotations

import os
from importlib.metadata import version
from pathlib import Path

from truejoint.calibration.calibration import Calibration
from truejoint.export.export_c import (
    check_prefix,
    default_prefix,
    render,
    source_files,
    write_files,
)
from truejoint.runtime.error_model import ErrorModel


def export_error_model(
    model: Calibration,
    folder: str | os.PathLike[str],
    *,
    prefix: str | None = None,
    overwrite: bool = False,
) -> tuple[Path, ...]:
    """Write what `ErrorModel` does as C99; the caller draws the normal numbers of the noise.

    Gives the files of `export_c`, and ``<prefix>_error_model.h``. Raises CalibrationError if the
    model is a correction, and ExportError as `export_c`.

    Examples
    --------
    >>> learnt = truejoint.calibration.learn_error_model(training, "linear")
    >>> export_error_model(learnt, "simulator", prefix="jaw")[-1].name
    'jaw_error_model.h'
    """
    stepping = ErrorModel(model)
    name = check_prefix(default_prefix(model) if prefix is None else prefix)
    contents = source_files(model, name)
    context = {
        "prefix": name, "guard": name.upper(), "title": model.title,
        "version": version("truejoint"), "sizes": stepping.noise_size,
        "times": stepping.noise_time, "inputs": stepping.inputs,
    }  # fmt: skip
    contents[f"{name}_error_model.h"] = render("error_model.h.j2", context, "double")
    return write_files(folder, contents, overwrite=overwrite)
