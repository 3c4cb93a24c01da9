"""Files of other people: a CSV header of our column names, or any columns through a map."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from numbers import Real
from pathlib import Path
from typing import Final

import numpy as np

from truejoint.array_types import Array
from truejoint.errors import RecordingError
from truejoint.recordings.bounded_file import read_bounded, read_head
from truejoint.recordings.read.array_files import NPY_MAGIC, MatValue, read_mat, read_npy
from truejoint.recordings.read.column_map import (
    ColumnMap,
    MappedColumn,
    MapSource,
    read_column_map,
)
from truejoint.recordings.read.numeric_text import (
    TextLayout,
    first_line,
    is_number,
    read_numbers,
    split_fields,
)
from truejoint.recordings.table.recording import (
    POSITION_QUANTITIES,
    Recording,
    default_unit,
    recordings_of_file,
)
from truejoint.recordings.table.stream import Stream
from truejoint.robots import Robot, get_robot
from truejoint.units import SI_UNITS

MAP_ADVICE: Final = "give a column map (`truejoint columns FILE` writes one to start from)"


def read(
    path: Path,
    robot: str = "",
    arm: str = "",
    column_map: MapSource | None = None,
    rate: float = 0.0,
) -> list[Recording]:
    """Read a text file of columns, or arrays: .npy with a row a sample, MATLAB with a signal a row.

    Without a map the first line of a text must name columns, in SI units; arrays need a map. In a
    MATLAB file a column is called ``variable`` or ``struct.field``, followed by ``[k]`` where that
    holds several signals. Any file may be in gzip. `robot` and `arm` overrule those of the column
    map, `rate` [Hz] stands in for time stamps.
    """
    table = _read(path, robot, arm, column_map, rate, "measured")
    return recordings_of_file(
        path, table.robot, table.columns, table.units, sha256=table.sha256, dropped=table.dropped
    )


def read_truth(
    path: str | os.PathLike[str],
    robot: str = "",
    arm: str = "",
    column_map: MapSource | None = None,
    rate: float = 0.0,
) -> Stream:
    """Read the truth of a robot's joints, as `read` does, from a file that has nothing else of it.

    Stamps stay as the file has them. Raises RecordingError if no column is ``truth/<joint>``, or
    as `read_recording` does.

    Examples
    --------
    >>> test.table[["t", "truth/jaw"]].to_csv("encoder.csv", index=False)
    >>> list(read_truth("encoder.csv", robot="davinci_grasper").columns)
    ['truth/jaw']
    """
    path = Path(path)
    columns = dict(_read(path, robot, arm, column_map, rate, "truth").columns)
    t = columns.pop("t")
    return Stream(t, {name: v for name, v in columns.items() if name.startswith("truth/")})


@dataclass(frozen=True)
class _Table:
    """Columns (n,) in SI units, and what else a file tells."""

    robot: Robot
    columns: Mapping[str, Array]
    units: Mapping[str, str]
    sha256: str
    dropped: Mapping[str, int]


def _read(
    path: Path,
    robot: str,
    arm: str,
    column_map: MapSource | None,
    rate: float,
    needed: str,
) -> _Table:
    """Columns of a file, of which one must be of the quantity `needed`."""
    head, incomplete = read_head(path), 0
    if b"\0" not in head:
        mapping, use, layout = read_header(path, column_map, rate)
        machine = _robot(path, mapping, robot, arm, needed)
        table = read_numbers(path, layout, list(use.values()), list(use.values()))
        columns = dict(zip(use, table.values.T, strict=True))
        digest, incomplete = table.sha256, table.incomplete
    elif column_map is None:
        raise RecordingError(f"{path}: what is in its columns? {MAP_ADVICE}")
    else:
        mapping = _timed(path, read_column_map(column_map), rate)
        machine = _robot(path, mapping, robot, arm, needed)
        columns, digest = _arrays(path, mapping, head)
    columns, units = _in_si(path, mapping, machine, columns)
    truth = [np.isnan(values) for name, values in columns.items() if name.startswith("truth/")]
    dropped = {
        "last line cut short": incomplete,
        "truth: value missing": int(np.any(truth, axis=0).sum()),
    }
    return _Table(machine, columns, units, digest, dropped)


def _arrays(path: Path, mapping: ColumnMap, head: bytes) -> tuple[dict[str, Array], str]:
    """Columns of a file of arrays, and its SHA-256."""
    if head.startswith(NPY_MAGIC):
        array, digest = read_npy(path)
        table = array.reshape(len(array) if array.ndim else 1, -1)
        use = _positions(path, mapping, None, table.shape[1])
        return {name: table[:, k] for name, k in use.items()}, digest
    data, digest = read_bounded(path)
    variables = read_mat(data, str(path))
    names = {name: str(mapped.column) for name, mapped in mapping.columns.items()}
    rows = _signal(path, variables, names["t"]).size if "t" in names else 0
    return {k: _signal(path, variables, name, rows) for k, name in names.items()}, digest


def read_header(
    path: Path, column_map: MapSource | None = None, rate: float = 0.0
) -> tuple[ColumnMap, dict[str, int], TextLayout]:
    """Map of a text file's columns, where each of its columns stands, and how the numbers stand.

    Raises RecordingError if a mapped column is not there, or nothing says what the columns are.
    """
    mapping = read_column_map(column_map) if column_map is not None else None
    number, line = first_line(path, mapping.comment if mapping else "#")
    guess = next((d for d in ",;\t" if d in line), " ")
    delimiter = (mapping.delimiter if mapping else "") or guess
    fields = split_fields(line, delimiter)
    header = None if all(is_number(field) for field in fields) else fields
    if mapping is None:
        if header is None:
            raise RecordingError(
                f"{path}: has no header that names t and <quantity>/<joint> columns; {MAP_ADVICE}"
            )
        mapping = ColumnMap({name: MappedColumn(name) for name in header})
    mapping = _timed(path, mapping, rate)
    use = _positions(path, mapping, header, len(fields))
    return (
        mapping,
        use,
        TextLayout(len(fields), delimiter, mapping.comment, number if header else 0),
    )


def _timed(path: Path, mapping: ColumnMap, rate: float) -> ColumnMap:
    """Column map with time stamps, or else with the rate that the caller states [Hz]."""
    if not (isinstance(rate, Real) and 0.0 <= rate <= 1e9):
        raise RecordingError(f"{path}: a rate of {rate!r:.40} Hz; state one above 0 Hz")
    if "t" in mapping.columns and rate:
        raise RecordingError(f"{path}: has time stamps, so no rate can be stated; leave it out")
    if "t" not in mapping.columns and not (rate or mapping.rate):
        raise RecordingError(
            f"{path}: no column 't' of time stamps: state their rate (rate_hz in the column map, "
            f"or --rate-hz), or which column it is; {MAP_ADVICE}"
        )
    return replace(mapping, rate=rate or mapping.rate)


def arrays_of(variables: Mapping[str, MatValue]) -> dict[str, Array]:
    """Arrays of a MATLAB file by ``variable`` or ``struct.field``."""
    found: dict[str, Array] = {}
    for name, value in variables.items():
        inner = {f"{name}.{k}": v for k, v in value.items()} if isinstance(value, dict) else None
        found |= {name: value} if inner is None else inner  # type: ignore[dict-item]
    return found


def _signal(path: Path, variables: Mapping[str, MatValue], name: str, rows: int = 0) -> Array:
    """One signal of a MATLAB file, along the side of `rows` samples, else the longer one."""
    variable = name.partition("[")[0]
    arrays = arrays_of(variables)
    value = arrays.get(variable)
    if value is None or not value.size:
        known = ", ".join(arrays)[:300]
        raise RecordingError(f"{path}: no signal {name!r}; the file has {known}")
    along = value.shape[1] == rows if rows in value.shape else value.shape[1] > value.shape[0]
    signals = value if along else value.T
    names = [variable] if len(signals) == 1 else [f"{variable}[{k}]" for k in range(len(signals))]
    if name not in names:
        raise RecordingError(
            f"{path}: {variable!r} holds {len(signals)} signals, which {name!r} does not name; "
            f"write {' to '.join(dict.fromkeys((names[0], names[-1])))}"
        )
    signal: Array = signals[names.index(name)]
    return signal


def _robot(path: Path, mapping: ColumnMap, robot: str, arm: str, needed: str) -> Robot:
    model = robot or mapping.robot
    if not model:
        raise RecordingError(f"{path}: which robot is it? state robot=..., or put it in the map")
    machine = get_robot(model, arm or mapping.arm)
    for name in mapping.columns:
        quantity, _, channel = name.partition("/")
        if name != "t" and not (quantity and channel):
            raise RecordingError(
                f"{path}: column {name!r} is neither 't' nor '<quantity>/<joint>', for instance "
                f"'measured/{machine.joint_names[0]}'; give a column map"
            )
        if quantity in (*POSITION_QUANTITIES, "velocity") and channel not in machine.channels:
            raise RecordingError(
                f"{path}: column {name!r}: {machine.title} has no joint {channel!r}; it has "
                f"{', '.join(machine.channels)}"
            )
    known = {name.partition("/")[0] for name in mapping.columns}
    # Where the mechanism is known, the measured position may be its motor's.
    if needed not in known and not (
        needed == "measured" and machine.mechanism and "motor" in known
    ):
        why = "there is nothing to correct" if needed == "measured" else "it is no truth"
        raise RecordingError(f"{path}: no '{needed}/<joint>' column; {why}")
    return machine


def _in_si(
    path: Path, mapping: ColumnMap, robot: Robot, found: Mapping[str, Array]
) -> tuple[dict[str, Array], dict[str, str]]:
    """Columns in SI units with their stamps, and the unit of each but those."""
    columns, units = {}, {}
    for name, values in found.items():
        mapped = mapping.columns[name]
        expected = "s" if name == "t" else default_unit(name, robot)
        units[name], factor = SI_UNITS[mapped.unit] if mapped.unit else (expected, 1.0)
        if expected not in {units[name], "1"}:
            raise RecordingError(
                f"{path}: column {name!r} is in {expected}, which {mapped.unit!r} cannot be; "
                "correct the column map"
            )
        with np.errstate(over="ignore"):  # an infinite one is refused in its row
            columns[name] = values * (mapped.scale * factor)
    units.pop("t", None)
    if mapping.rate:
        columns = {"t": np.arange(next(iter(columns.values())).size) / mapping.rate, **columns}
    return columns, units


def _positions(
    path: Path, mapping: ColumnMap, header: Sequence[str] | None, count: int
) -> dict[str, int]:
    """Position in the file of every mapped column."""
    use = {}
    for name, mapped in mapping.columns.items():
        column = mapped.column
        if isinstance(column, int):
            if column >= count:
                raise RecordingError(
                    f"{path}: {name!r} is to be column {column}, but there are {count} columns, "
                    "counted from 0; correct the column map"
                )
            use[name] = column
        elif header is None:
            raise RecordingError(
                f"{path}: has no header, so column {column!r} cannot be found; give its position "
                "in the column map"
            )
        elif header.count(column) != 1:
            often = "twice" if column in header else "not there"
            raise RecordingError(
                f"{path}: column {column!r} is {often}; the header has {', '.join(header)}"
            )
        else:
            use[name] = header.index(column)
    return use
