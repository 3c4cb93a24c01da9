"""How the columns of somebody's CSV file become those of a recording."""

from __future__ import annotations

import math
import os
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from truejoint.errors import RecordingError
from truejoint.recordings.files import read_bounded

_MAX_BYTES: Final = 1 << 20

SI_UNITS: Final[Mapping[str, tuple[str, float]]] = {
    "s": ("s", 1.0),
    "ms": ("s", 1e-3),
    "us": ("s", 1e-6),
    "ns": ("s", 1e-9),
    "rad": ("rad", 1.0),
    "deg": ("rad", math.pi / 180.0),
    "m": ("m", 1.0),
    "cm": ("m", 1e-2),
    "mm": ("m", 1e-3),
    "um": ("m", 1e-6),
    "rad/s": ("rad/s", 1.0),
    "deg/s": ("rad/s", math.pi / 180.0),
    "rpm": ("rad/s", math.pi / 30.0),
    "m/s": ("m/s", 1.0),
    "mm/s": ("m/s", 1e-3),
    "Nm": ("Nm", 1.0),
    "mNm": ("Nm", 1e-3),
    "N": ("N", 1.0),
    "mN": ("N", 1e-3),
    "A": ("A", 1.0),
    "mA": ("A", 1e-3),
    "V": ("V", 1.0),
    "1": ("1", 1.0),
}
"""Unit in a file: SI unit and the factor to it."""


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
        As in `truejoint.robots.get_robot`; empty where the caller states them.
    delimiter : str
        Between two numbers; empty to find out, blank for any white space.
    comment : str
        A line that begins with it is passed over.

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


def load_column_map(source: str | os.PathLike[str] | Mapping[str, Any] | ColumnMap) -> ColumnMap:
    """Column map of a TOML file, or of a mapping of the same shape.

    Parameters
    ----------
    source : path-like or mapping or ColumnMap
        Keys ``robot``, ``arm``, ``delimiter``, ``comment`` (all optional) and the table
        ``columns``: name in the recording to the name or position of the file's column, or to a
        table with ``column``, ``unit`` and ``scale``.

    Raises
    ------
    RecordingError
        Naming the file, the key and the rule that it breaks.

    Examples
    --------
    >>> load_column_map({"robot": "bros", "columns": {
    ...     "t": {"column": "stamp", "unit": "ms"},
    ...     "measured/joint1": {"column": 1, "unit": "deg"}}}).columns["t"].unit
    'ms'
    """
    if isinstance(source, ColumnMap):
        return source
    if isinstance(source, Mapping):
        return _parse(source, "column map")
    path = Path(source)
    data, _ = read_bounded(path, _MAX_BYTES)
    try:
        values = tomllib.loads(data.decode("utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise RecordingError(f"{path}: is not TOML ({str(error).splitlines()[0]})") from None
    return _parse(values, str(path))


def _parse(values: Mapping[str, Any], name: str) -> ColumnMap:
    known = ("robot", "arm", "delimiter", "comment", "columns")
    unknown = [key for key in values if key not in known]
    if unknown:
        raise RecordingError(f"{name}: key {unknown[0]!r} is not known; use {', '.join(known)}")
    columns = values.get("columns")
    if not isinstance(columns, Mapping) or "t" not in columns:
        raise RecordingError(f"{name}: needs a table 'columns' that says which column is 't'")
    texts = {key: values.get(key, default) for key, default in _TEXTS.items()}
    for key, text in texts.items():
        if not isinstance(text, str) or (key == "comment" and len(text) > 1):
            raise RecordingError(f"{name}: {key} is {text!r}; want text, one character at most")
    if texts["delimiter"] not in _DELIMITERS:
        raise RecordingError(
            f"{name}: delimiter is {texts['delimiter']!r}; want comma, semicolon, tab or blank"
        )
    return ColumnMap({str(k): _column(f"{name}: {k!r}", v) for k, v in columns.items()}, **texts)


_DELIMITERS: Final = ("", ",", ";", "\t", " ")
_TEXTS: Final = {"robot": "", "arm": "", "delimiter": "", "comment": "#"}


def _column(name: str, value: Any) -> MappedColumn:
    if isinstance(value, str | int) and not isinstance(value, bool):
        value = {"column": value}
    if not isinstance(value, Mapping) or "column" not in value:
        raise RecordingError(f"{name} is {value!r}; want a column's name, position or table")
    unknown = [key for key in value if key not in {"column", "unit", "scale"}]
    if unknown:
        raise RecordingError(f"{name}: key {unknown[0]!r} is not known; use column, unit, scale")
    column, unit, scale = value["column"], value.get("unit", ""), value.get("scale", 1.0)
    if isinstance(column, bool) or not isinstance(column, str | int):
        raise RecordingError(f"{name}: column is {column!r}; want a name or a position")
    if isinstance(column, int) and column < 0:
        raise RecordingError(f"{name}: column is {column}; positions count from 0")
    if unit and unit not in SI_UNITS:
        raise RecordingError(f"{name}: unit {unit!r} is not known; use {', '.join(SI_UNITS)}")
    if isinstance(scale, bool) or not isinstance(scale, int | float):
        raise RecordingError(f"{name}: scale is {scale!r}; want a number")
    if not (math.isfinite(scale) and scale != 0):
        raise RecordingError(f"{name}: scale is {scale}; want a number other than 0")
    return MappedColumn(column, unit, float(scale))
