"""Values that the shell completes; a wrong or unreadable word completes to nothing.

Only names and headers of files are read: a shell waits for each of these.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import typer

import truejoint
from truejoint.errors import TruejointError
from truejoint.estimators import registry


def named(place: str) -> Callable[..., Any]:
    """Give what completes a value: a function of this module, or names in a ``module:collection``.

    The names of a mapping stand beside what each means, where its values say so.
    """
    module, _, name = place.rpartition(":")
    if not module:
        return globals()[name]  # type: ignore[no-any-return]

    def names() -> list[Any]:
        values = getattr(import_module(f"truejoint.{module}"), name)
        if not isinstance(values, Mapping):
            return [*values]
        return [
            (key, getattr(v, "summary", v if isinstance(v, str) else ""))
            for key, v in values.items()
        ]

    return names


def robots() -> list[str]:
    """Names of robots, and of their arms as ``ROBOT:ARM``."""
    names = truejoint.robots.robot_names()
    arms = [f"{name}:{arm}" for name in names for arm in truejoint.robots.arm_names(name)]
    return [*names, *arms]


def metadata() -> list[str]:
    """Keys of ``--metadata``, as ``KEY=``; readers as ``format=NAME``."""
    keys = ("homing_id", "load_grams", "session", "rate_hz", "truth_unit", "truth_zero")
    formats = truejoint.recordings.format_names()
    return [*(f"{key}=" for key in keys), *(f"format={name}" for name in formats)]


def topics() -> list[str]:
    """List the CRTK topics that can be recorded, as ``NAME=``."""
    return [f"{parameter}=" for parameter in truejoint.crtk.TOPICS]


def settings(context: typer.Context) -> list[str]:
    """List the parameters of the estimator on the command line, as ``NAME=``."""
    name = context.params.get("estimator") or registry.DEFAULT
    if name not in truejoint.estimators.estimator_names():
        return []
    return [f"{parameter}=" for parameter in truejoint.estimators.get_estimator(name).get_params()]


def estimators() -> list[str]:
    """Names of estimators, and what has one chosen."""
    return [*truejoint.estimators.estimator_names(), registry.AUTO]


def recordings(incomplete: str) -> list[str]:
    """Public data sets once a letter of one is typed; files are the shell's own to complete."""
    return [*truejoint.recordings.datasets.DATASETS] if incomplete else []


def splits(context: typer.Context) -> list[str]:
    """List the splits of the data sets that the command line names."""
    sets = truejoint.recordings.datasets.DATASETS
    return [split.name for name in _named(context) if name in sets for split in sets[name].splits]


def joints(context: typer.Context) -> list[str]:
    """List the joints with truth in the headers of the recordings that the command line names."""
    return [c.removeprefix("truth/") for c in _columns(context) if c.startswith("truth/")]


def features(context: typer.Context) -> list[str]:
    """List the signals of the recordings that the command line names, then the data sets."""
    signals = [c for c in _columns(context) if "/" in c and not c.startswith("truth/")]
    return [*signals, *truejoint.recordings.datasets.DATASETS]


def tolerances(context: typer.Context) -> list[str]:
    """List the joints of the model that the command line names, as ``JOINT=``."""
    return [f"{joint}=" for joint in _model_file(context)[0].get("joints", ())]


def levels(context: typer.Context) -> list[str]:
    """List the probabilities that the model's interval states, in percent."""
    return [f"{100.0 * level:g}" for level in _model_file(context)[1].get("interval/levels", ())]


def _named(context: typer.Context) -> list[str]:
    """Words of the command line that belong to no option; unsorted while one lacks its value."""
    return [*(context.params.get("recordings") or []), *context.args]


def _columns(context: typer.Context) -> list[str]:
    """Columns of the recordings that the command line names, each once."""
    sets = truejoint.recordings.datasets.DATASETS
    columns: list[str] = []
    for name in _named(context):
        if name in sets:
            columns += sets[name].features
            columns += [c.replace("measured/", "truth/") for c in sets[name].features]
        else:
            columns += _header(Path(name))
    return list(dict.fromkeys(columns))


def _model_file(context: typer.Context) -> tuple[Mapping[str, Any], Mapping[str, Any]]:
    """Header and arrays of the model file that the command line names; empty if unreadable."""
    from truejoint.calibration.container import read_model_file  # needs NumPy

    try:
        return read_model_file(context.params.get("model") or context.args[0])
    except (IndexError, TruejointError):
        return {}, {}


def _header(path: Path) -> list[str]:
    """Columns of a Parquet or CSV file; empty where it cannot be read."""
    try:
        if path.suffix == ".parquet":
            from pyarrow.parquet import read_schema  # not for the other words

            return list(read_schema(path).names)
        with path.open(encoding="utf-8") as file:
            return [field.strip(' "\n') for field in file.readline(100_000).split(",")]
    except (OSError, ValueError):  # pyarrow's errors derive from these
        return []


def studies() -> list[str]:
    """Names of studies, and what runs all."""
    from truejoint.studies.study import STUDIES

    return [*STUDIES, "all"]


def study_options(context: typer.Context) -> list[str]:
    """List the options of the study that the command line names, as ``OPTION=``."""
    from truejoint.studies.study import STUDIES

    study = STUDIES.get(context.params.get("name") or "")
    return [f"{option.name}=" for option in study.options] if study else []
