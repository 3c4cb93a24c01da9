"""Plain CSV: a header of our column names in SI units, or any columns through a column map."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from truejoint.errors import RecordingError
from truejoint.recordings.column_map import (
    SI_UNITS,
    ColumnMap,
    MappedColumn,
    load_column_map,
)
from truejoint.recordings.numeric_text import (
    TextLayout,
    first_line,
    is_number,
    read_numbers,
    split_fields,
)
from truejoint.recordings.recording import (
    POSITION_QUANTITIES,
    Array,
    Provenance,
    Recording,
    default_unit,
    since_first,
)
from truejoint.robots import Robot, get_robot

_JOINT_QUANTITIES: Final = (*POSITION_QUANTITIES, "velocity")


def read(
    path: Path,
    robot: str = "",
    arm: str = "",
    column_map: str | os.PathLike[str] | Mapping[str, Any] | ColumnMap | None = None,
) -> Recording:
    """Read a CSV file.

    Parameters
    ----------
    path : Path
        Text or gzip. Without a column map its first line must name ``t`` and
        ``<quantity>/<joint>`` columns, in SI units.
    robot, arm : str
        As in `truejoint.robots.get_robot`; they overrule those of the column map.
    column_map : path-like or mapping or ColumnMap, optional
        See `truejoint.recordings.load_column_map`.

    Returns
    -------
    Recording
        Empty and ``nan`` fields are accepted for truth only. Stamps counted from 1970 are counted
        from the first row instead, which `Provenance.start` keeps.

    Raises
    ------
    RecordingError
        Naming file and column, line or value that is wrong.
    """
    mapping = load_column_map(column_map) if column_map is not None else None
    number, line = first_line(path, mapping.comment if mapping else "#")
    delimiter = (mapping.delimiter if mapping else "") or _delimiter(line)
    fields = split_fields(line, delimiter)
    header = None if all(is_number(field) for field in fields) else fields
    if mapping is None:
        mapping = _map_of_header(path, header)
    model = robot or mapping.robot
    if not model:
        raise RecordingError(f"{path}: which robot is it? state robot=..., or put it in the map")
    machine = get_robot(model, arm or mapping.arm)
    _check_names(path, mapping, machine)
    use = _positions(path, mapping, header, len(fields))
    layout = TextLayout(len(fields), delimiter, mapping.comment, number if header else 0)
    may_miss = [use[name] for name in use if name.startswith("truth")]
    table = read_numbers(path, layout, list(use.values()), may_miss)
    columns, units = _convert(path, mapping, machine, dict(zip(use, table.values.T, strict=True)))
    columns["t"], start = since_first(columns["t"])
    dropped = {"last line cut short": table.incomplete, "truth: value missing": _missing(columns)}
    provenance = Provenance(
        robot=machine.name,
        arm=machine.arm,
        source=path.name,
        sha256=table.sha256,
        session=path.name.split(".", maxsplit=1)[0],
        rates=_rate(columns["t"]),
        dropped={reason: n for reason, n in dropped.items() if n},
        start=start,
    )
    return Recording.from_columns(columns, provenance, units)


def _delimiter(line: str) -> str:
    for delimiter in (",", ";", "\t"):
        if delimiter in line:
            return delimiter
    return " "


def _map_of_header(path: Path, header: Sequence[str] | None) -> ColumnMap:
    if header is None:
        raise RecordingError(
            f"{path}: has no header that names t and <quantity>/<joint> columns; give a column map"
        )
    return ColumnMap({name: MappedColumn(name) for name in header})


def _check_names(path: Path, mapping: ColumnMap, robot: Robot) -> None:
    for name in mapping.columns:
        quantity, _, channel = name.partition("/")
        if name != "t" and not (quantity and channel):
            raise RecordingError(
                f"{path}: column {name!r} is neither 't' nor '<quantity>/<joint>', for instance "
                f"'measured/{robot.joint_names[0]}'; give a column map"
            )
        if quantity in _JOINT_QUANTITIES and channel not in robot.channels:
            raise RecordingError(
                f"{path}: column {name!r}: {robot.title} has no joint {channel!r}; it has "
                f"{', '.join(robot.channels)}"
            )
    if not any(name.startswith("measured/") for name in mapping.columns):
        raise RecordingError(f"{path}: no 'measured/<joint>' column; there is nothing to correct")


def _positions(
    path: Path, mapping: ColumnMap, header: Sequence[str] | None, count: int
) -> dict[str, int]:
    """Position in the file of every mapped column."""
    use = {}
    for name, mapped in mapping.columns.items():
        if isinstance(mapped.column, int):
            if mapped.column >= count:
                raise RecordingError(
                    f"{path}: {name!r} is to be column {mapped.column}, but there are {count} "
                    "columns, counted from 0; correct the column map"
                )
            use[name] = mapped.column
            continue
        if header is None:
            raise RecordingError(
                f"{path}: has no header, so column {mapped.column!r} cannot be found; "
                "give its position in the column map"
            )
        if header.count(mapped.column) != 1:
            often = "twice" if mapped.column in header else "not there"
            raise RecordingError(
                f"{path}: column {mapped.column!r} is {often}; the header has {', '.join(header)}"
            )
        use[name] = header.index(mapped.column)
    return use


def _convert(
    path: Path, mapping: ColumnMap, robot: Robot, columns: Mapping[str, Array]
) -> tuple[dict[str, Array], dict[str, str]]:
    """Columns in SI, and the units of those whose unit is stated or is not the default."""
    converted, units = {}, {}
    for name, values in columns.items():
        mapped = mapping.columns[name]
        expected = "s" if name == "t" else default_unit(name, robot)
        si, factor = SI_UNITS[mapped.unit] if mapped.unit else (expected, 1.0)
        if expected not in {si, "1"}:
            raise RecordingError(
                f"{path}: column {name!r} is in {expected}, which {mapped.unit!r} cannot be; "
                "correct the column map"
            )
        converted[name] = values * (mapped.scale * factor)
        if name != "t":
            units[name] = si
    return converted, units


def _missing(columns: Mapping[str, Array]) -> int:
    truth = [np.isnan(values) for name, values in columns.items() if name.startswith("truth/")]
    return int(np.any(truth, axis=0).sum()) if truth else 0


def _rate(t: Array) -> dict[str, float]:
    interval = float(np.median(np.diff(t))) if t.size > 1 else 0.0
    return {"state": round(1.0 / interval, 3)} if interval > 0 else {}
