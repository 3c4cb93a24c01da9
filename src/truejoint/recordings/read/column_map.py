"""How the columns of somebody's CSV file become those of a recording."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from truejoint.errors import RecordingError
from truejoint.toml_file import read_toml
from truejoint.units import SI_UNITS


@dataclass(frozen=True)
class MappedColumn:
    """Where one column of a recording comes from.

    Attributes
    ----------
    column : str or int
        Name in the file's header, or position counted from 0.
    unit : str
        One of `SI_UNITS`; empty for the SI unit of the quantity.
    scale : float
        Multiplies the number in the file before its unit counts, for instance 360/8192 with
        ``deg`` for an encoder of 8192 counts a turn.

    Examples
    --------
    >>> MappedColumn("angle", unit="deg").scale
    1.0
    """

    column: str | int
    unit: str = ""
    scale: float = 1.0


@dataclass(frozen=True)
class ColumnMap:
    """Columns of a recording by name, and what else a CSV file does not say.

    Attributes
    ----------
    columns : mapping of str to MappedColumn
        ``t`` and ``<quantity>/<joint>``.
    robot, arm : str
        As in `truejoint.robots.get_robot`, a robot file beside the map's own file; empty where the
        caller states them.
    delimiter : str
        Between two numbers; empty to find out, blank for any white space.
    comment : str
        A line that begins with it is passed over.
    rate : float
        Of a file without time stamps [Hz]; 0 where ``t`` is among the columns, or the caller states
        it.

    Examples
    --------
    >>> ColumnMap({"t": MappedColumn("time")}).delimiter
    ''
    """

    columns: Mapping[str, MappedColumn]
    robot: str = ""
    arm: str = ""
    delimiter: str = ""
    comment: str = "#"
    rate: float = 0.0


MapSource = str | os.PathLike[str] | Mapping[str, Any] | ColumnMap


def read_column_map(source: MapSource) -> ColumnMap:
    """Column map of a TOML file, or of a mapping of the same shape.

    Parameters
    ----------
    source : path-like or mapping or ColumnMap
        Keys ``robot``, ``arm``, ``delimiter``, ``comment``, ``rate_hz`` (all optional) and the
        table ``columns``: name in the recording to the name or position of the file's column, or
        to a table with ``column``, ``unit`` and ``scale``.

    Raises
    ------
    RecordingError
        Naming the file, the key and the rule that it breaks.

    Examples
    --------
    >>> read_column_map({"robot": "bros", "columns": {
    ...     "t": {"column": "stamp", "unit": "ms"},
    ...     "measured/joint1": {"column": 1, "unit": "deg"}}}).columns["t"].unit
    'ms'
    """
    if isinstance(source, ColumnMap):
        return source
    if isinstance(source, Mapping):
        return _parse(source, "column map")
    path = Path(source)
    mapping = _parse(read_toml(path, RecordingError), str(path))
    if not mapping.robot.endswith(".toml"):
        return mapping
    return replace(mapping, robot=str(path.parent / mapping.robot))


_MOST: Final = 1e30  # in size, of a scale
_TEXTS: Final = ("robot", "arm", "delimiter", "comment")


def _parse(values: Mapping[str, Any], name: str) -> ColumnMap:
    _check_keys(name, values, (*_TEXTS, "rate_hz", "columns"))
    columns, rate = values.get("columns"), values.get("rate_hz", 0.0)
    if not _is_number(rate) or not 0 <= rate <= 1e9:
        raise RecordingError(f"{name}: rate_hz is {rate!r:.40}; want a number above 0")
    if not isinstance(columns, Mapping):
        raise RecordingError(f"{name}: needs a table 'columns' that says what is in which column")
    if "t" in columns and rate > 0:
        raise RecordingError(f"{name}: gives 't' and rate_hz; a rate is for files without stamps")
    texts = {key: values[key] for key in _TEXTS if key in values}
    for key, text in texts.items():
        if not isinstance(text, str) or (key == "comment" and len(text) > 1):
            raise RecordingError(f"{name}: {key} is {text!r}; want text, one character at most")
    delimiter = texts.get("delimiter", "")
    if delimiter not in ("", ",", ";", "\t", " "):
        raise RecordingError(
            f"{name}: delimiter is {delimiter!r}; want comma, semicolon, tab or blank"
        )
    mapped = {str(k): _column(f"{name}: {k!r}", v) for k, v in columns.items()}
    return ColumnMap(mapped, **texts, rate=float(rate))


def _column(name: str, value: Any) -> MappedColumn:
    if isinstance(value, str | int) and not isinstance(value, bool):
        value = {"column": value}
    if not isinstance(value, Mapping) or "column" not in value:
        raise RecordingError(f"{name} is {value!r}; want a column's name, position or table")
    _check_keys(name, value, ("column", "unit", "scale"))
    column, unit, scale = value["column"], value.get("unit", ""), value.get("scale", 1.0)
    if isinstance(column, bool) or not isinstance(column, str | int):
        raise RecordingError(f"{name}: column is {column!r:.40}; want a name or a position")
    if isinstance(column, int) and column < 0:
        raise RecordingError(f"{name}: column is {column!s:.40}; positions count from 0")
    if unit and unit not in SI_UNITS:
        raise RecordingError(f"{name}: unit {unit!r} is not known; use {', '.join(SI_UNITS)}")
    if not _is_number(scale) or not 0 < abs(scale) <= _MOST:
        raise RecordingError(
            f"{name}: scale is {scale!r:.40}; want a number other than 0, at most {_MOST:g}"
        )
    return MappedColumn(column, unit, float(scale))


def _check_keys(name: str, values: Mapping[str, Any], known: Sequence[str]) -> None:
    for key in values:
        if key not in known:
            raise RecordingError(f"{name}: key {key!r} is not known; use {', '.join(known)}")


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
