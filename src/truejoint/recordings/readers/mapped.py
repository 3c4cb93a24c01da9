"""Files of other people: a CSV header of our column names, or any columns through a map."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from truejoint.array_types import Array
from truejoint.errors import RecordingError
from truejoint.recordings.array_files import NPY_MAGIC, MatValue, read_mat, read_npy
from truejoint.recordings.column_map import (
    SI_UNITS,
    ColumnMap,
    MappedColumn,
    MapSource,
    read_column_map,
)
from truejoint.recordings.files import read_bounded, read_head
from truejoint.recordings.numeric_text import (
    TextLayout,
    first_line,
    is_number,
    read_numbers,
    split_fields,
)
from truejoint.recordings.recording import (
    POSITION_QUANTITIES,
    Recording,
    default_unit,
    last_of_each_stamp,
    recording_of_file,
    since_first,
)
from truejoint.robots import Robot, get_robot


def read_csv(
    path: Path, robot: str = "", arm: str = "", column_map: MapSource | None = None
) -> Recording:
    """Read a CSV file, text or gzip; without a map its first line must name columns, in SI units.

    Empty and ``nan`` fields are accepted for truth only. Stamps counted from 1970 are counted from
    the first row instead, which `Provenance.start` keeps. Of rows with the same stamp the last is
    kept, the others are counted. `robot` and `arm` overrule those of the column map.
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
                f"{path}: has no header that names t and <quantity>/<joint> columns; "
                "give a column map"
            )
        mapping = ColumnMap({name: MappedColumn(name) for name in header})
    machine = _robot(path, mapping, robot, arm)
    use = _positions(path, mapping, header, len(fields))
    layout = TextLayout(len(fields), delimiter, mapping.comment, number if header else 0)
    may_miss = [use[name] for name in use if name.startswith("truth")]
    table = read_numbers(path, layout, list(use.values()), may_miss)
    columns = dict(zip(use, table.values.T, strict=True))
    return _recording(path, mapping, machine, columns, table.sha256, table.incomplete)


def read_arrays(
    path: Path, robot: str = "", arm: str = "", column_map: MapSource | None = None
) -> Recording:
    """Read a .npy file with a row a sample, or a MATLAB file with a row or column a signal.

    In a MATLAB file a column is called ``variable`` or ``struct.field``, followed by ``[k]`` where
    that holds several signals. The column map is needed; otherwise as `read_csv`.
    """
    if column_map is None:
        raise RecordingError(f"{path}: what is in its columns? give a column map")
    mapping = read_column_map(column_map)
    machine = _robot(path, mapping, robot, arm)
    if read_head(path).startswith(NPY_MAGIC):
        array, digest = read_npy(path)
        table = array.reshape(len(array) if array.ndim else 1, -1)
        use = _positions(path, mapping, None, table.shape[1])
        columns = {name: table[:, k] for name, k in use.items()}
    else:
        data, digest = read_bounded(path)
        variables = read_mat(data, str(path))
        names = {name: str(mapped.column) for name, mapped in mapping.columns.items()}
        rows = _signal(path, variables, names["t"]).size if "t" in names else 0
        columns = {k: _signal(path, variables, name, rows) for k, name in names.items()}
    return _recording(path, mapping, machine, columns, digest)


def _signal(path: Path, variables: Mapping[str, MatValue], name: str, rows: int = 0) -> Array:
    """One signal of a MATLAB file, along the side of `rows` samples, else the longer one."""
    variable = name.partition("[")[0]
    first, _, field = variable.partition(".")
    value = variables.get(first)
    if field:
        value = value.get(field) if isinstance(value, dict) else None
    if not isinstance(value, np.ndarray) or not value.size:
        known = [
            f"{key}.{inner}" if inner else key
            for key, found in variables.items()
            for inner in (found if isinstance(found, dict) else ("",))
        ]
        raise RecordingError(f"{path}: no signal {name!r}; the file has {', '.join(known)[:300]}")
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


def _robot(path: Path, mapping: ColumnMap, robot: str, arm: str) -> Robot:
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
    if not any(name.startswith("measured/") for name in mapping.columns):
        raise RecordingError(f"{path}: no 'measured/<joint>' column; there is nothing to correct")
    return machine


def _recording(
    path: Path,
    mapping: ColumnMap,
    robot: Robot,
    found: dict[str, Array],
    sha256: str,
    incomplete: int = 0,
) -> Recording:
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
        columns[name] = values * (mapped.scale * factor)
    units.pop("t", None)
    if mapping.rate:
        columns = {"t": np.arange(next(iter(columns.values())).size) / mapping.rate, **columns}
    keep = last_of_each_stamp(columns["t"])
    if not keep.all():
        columns = {name: values[keep] for name, values in columns.items()}
    columns["t"], start = since_first(columns["t"])
    truth = [np.isnan(values) for name, values in columns.items() if name.startswith("truth/")]
    dropped = {
        "last line cut short": incomplete,
        "repeated time stamp": int((~keep).sum()),
        "truth: value missing": int(np.any(truth, axis=0).sum()),
    }
    return recording_of_file(
        path, robot, columns, units, sha256=sha256, dropped=dropped, start=start
    )


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
