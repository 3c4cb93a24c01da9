"""Every study by name, as `catalogue.toml` beside this file lists them."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from importlib.resources import files
from typing import Any, Final

from truejoint.errors import StudyError, unknown
from truejoint.studies.study import Option, Study


def _read() -> dict[str, Study]:
    text = files("truejoint.studies").joinpath("catalogue.toml").read_text(encoding="utf-8")
    catalogue = tomllib.loads(text)
    shared = {
        key: _option({"name": key.partition(".")[0], **table})
        for key, table in catalogue["options"].items()
    }
    studies = [
        Study(
            table["name"],
            table["title"],
            table.get("source", ""),
            f"truejoint.studies.{table['module']}",
            tuple(shared[o] if isinstance(o, str) else _option(o) for o in table["options"]),
            table.get("version", 1),
        )
        for table in catalogue["studies"]
    ]
    return {study.name: study for study in studies}


def _option(table: Mapping[str, Any]) -> Option:
    values: dict[str, Any] = {
        key: tuple(v) if isinstance(v, list) else v for key, v in table.items()
    }
    return Option(**values)


STUDIES: Final = _read()
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
