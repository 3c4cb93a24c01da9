"""Which columns of somebody's file are those of a recording."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Final, Literal

from truejoint import schema
from truejoint.errors import RecordingError
from truejoint.toml_file import read_toml
from truejoint.units import SI_UNITS

_LARGEST: Final = 1e30  # scale or offset
_Number = Annotated[float, schema.Bounds(-_LARGEST, _LARGEST)]


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
    offset : float
        Added to that, in the same unit.

    Raises
    ------
    RecordingError
        If the scale is 0.

    Examples
    --------
    >>> MappedColumn("angle", unit="deg").scale
    1.0
    """

    SHORT: ClassVar = "column"

    column: str | Annotated[int, schema.Bounds(0)]
    unit: Annotated[str, schema.Choice(("", *SI_UNITS))] = ""
    scale: _Number = 1.0
    offset: _Number = 0.0

    def __post_init__(self) -> None:
        if self.scale == 0.0:
            raise RecordingError("scale is 0; want a number other than 0")


@dataclass(frozen=True)
class ColumnMap:
    """Columns of a recording by name, and what else a file does not say.

    Attributes
    ----------
    columns : mapping of str to MappedColumn
        ``t`` and ``<quantity>/<joint>``.
    robot, arm : str
        As in `truejoint.robots.get_robot`, a robot file beside the map's own file; empty where the
        caller states them.
    delimiter : str
        Between two numbers; empty to detect it, blank for any white space.
    comment : str
        A line that begins with it is passed over.
    rate : float
        Sampling rate of a file without time stamps [Hz], ``rate_hz`` in a file; 0 where ``t`` is
        among the columns, or the caller states it.

    Raises
    ------
    RecordingError
        If there are both time stamps and a rate.

    Examples
    --------
    >>> ColumnMap({"t": MappedColumn("time")}).delimiter
    ''
    """

    columns: Mapping[str, MappedColumn]
    robot: str = ""
    arm: str = ""
    delimiter: Literal["", ",", ";", "\t", " "] = ""
    comment: Annotated[str, schema.Length(0, 1)] = "#"
    rate: Annotated[float, schema.Bounds(0.0, 1e9), schema.Key("rate_hz")] = 0.0

    def __post_init__(self) -> None:
        if "t" in self.columns and self.rate > 0:
            raise RecordingError("gives 't' and rate_hz; a rate is for files without stamps")


MapSource = str | os.PathLike[str] | Mapping[str, Any] | ColumnMap


def read_column_map(source: MapSource) -> ColumnMap:
    """Column map of a TOML file, or of a mapping of the same shape.

    Parameters
    ----------
    source : path-like or mapping or ColumnMap
        Keys ``robot``, ``arm``, ``delimiter``, ``comment``, ``rate_hz`` (all optional) and the
        table ``columns``: name in the recording to the name or position of the file's column, or
        to a table with ``column``, ``unit``, ``scale`` and ``offset``.

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
        return schema.read(ColumnMap, source, "column map", RecordingError)
    path = Path(source)
    mapping = schema.read(ColumnMap, read_toml(path, RecordingError), str(path), RecordingError)
    if not mapping.robot.endswith(".toml"):
        return mapping
    return replace(mapping, robot=str(path.parent / mapping.robot))
