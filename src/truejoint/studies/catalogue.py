"""Every study by name, of `catalogue.toml`: experiments of peng2024 and yan2020, and past them."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping
from importlib import resources
from typing import Any, Final

from truejoint.errors import StudyError, unknown
from truejoint.studies.study import Option, Study


def _studies(table: Mapping[str, Any]) -> Iterator[Study]:
    shared: Mapping[str, Any] = table["options"]
    for row in table["studies"]:
        options = []
        for stated in row.pop("options", ()):
            own = {"name": stated} if isinstance(stated, str) else stated
            fields = {**shared.get(own["name"], {}), **own}
            options.append(Option(**{key: _value(value) for key, value in fields.items()}))
        row["module"] = f"{__package__}.{row['module']}"
        yield Study(**{"source": "", **row}, options=tuple(options))


def _value(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


_TEXT: Final = resources.files(__package__).joinpath("catalogue.toml").read_text("utf-8")
STUDIES: Final = {study.name: study for study in _studies(tomllib.loads(_TEXT))}
"""In the order in which they are listed."""


def get_study(name: str) -> Study:
    """Study called `name`; raises StudyError naming those that there are.

    Examples
    --------
    >>> get_study("forceps-unloaded").source
    'yan2020, Table 2, figures 6 and 7'
    """
    if name not in STUDIES:
        raise StudyError(unknown("study", name, STUDIES))
    return STUDIES[name]
