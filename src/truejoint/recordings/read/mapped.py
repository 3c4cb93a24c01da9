"""Files of other people: a CSV header of our column names, or any columns through a map."""

import itertools
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from numbers import Real
from pathlib import Path
from typing import Annotated, Any, ClassVar, Final, Literal

import numpy as np

from truejoint import schema
from truejoint.array_types import Array
from truejoint.errors import RecordingError
from truejoint.files import is_folder
from truejoint.recordings.bounded_file import Head, read_bounded
from truejoint.recordings.read.array_files import NPY_MAGIC, read_mat, read_npy
from truejoint.recordings.read.numeric_text import TextLayout, read_numbers, text_layout
from truejoint.recordings.table.recording import (
    EPOCH,
    MISSING,
    POSITION_QUANTITIES,
    Provenance,
    Recording,
    check_shapes,
    default_unit,
    last_of_each_stamp,
    nominal_rates,
)
from truejoint.recordings.table.stream import Stream
from truejoint.robots import Joint, Robot, get_robot
from truejoint.toml_file import read_toml
from truejoint.units import SI_UNITS

CUT_SHORT: Final = "last line cut short"
MAP_ADVICE: Final = "give a column map (`truejoint columns FILE` writes one to start from)"
_LARGEST: Final = 1e30  # scale or offset
_YEAR_5000: Final = 1e11  # [s]
_MAX_MISSING: Final = 1 / 3  # share of rows that may lack a value
_SHORTEST_SESSION: Final = 10  # rows before and after a clock's restart
_RESTART: Final = 0.1  # share of the time before at which the clock may go on
_Number = Annotated[float, schema.Bounds(-_LARGEST, _LARGEST)]


@dataclass(frozen=True)
class MappedColumn:
    """Origin of one column of a recording.

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


def read(path: Path, **context: Any) -> list[Recording]:
    """Read the recordings of a file of columns; `context` as `read_table` takes it."""
    return read_table(path, **context).recordings(path)


def read_truth(
    path: str | os.PathLike[str],
    robot: Robot | str = "",
    arm: str = "",
    column_map: MapSource | None = None,
    rate: float = 0.0,
) -> Stream:
    """Read the truth of a robot's joints from a file that has nothing else of it.

    Stamps stay as the file has them. Raises RecordingError if no column is ``truth/<joint>``, or
    as `read_recording` does.

    Examples
    --------
    >>> test.table[["t", "truth/jaw"]].to_csv("encoder.csv", index=False)
    >>> list(read_truth("encoder.csv", robot="davinci_grasper").columns)
    ['truth/jaw']
    """
    columns = read_table(Path(path), robot, arm, column_map, rate, needed="truth").columns
    truth = {name: v for name, v in columns.items() if name.startswith("truth/")}
    return Stream(columns["t"], truth)


@dataclass(frozen=True)
class Table:
    """Columns (n,) in SI units, and what else a file tells."""

    robot: Robot
    columns: Mapping[str, Array]
    units: Mapping[str, str]
    sha256: str
    dropped: Mapping[str, int]
    notes: str = ""

    def recordings(self, path: Path) -> list[Recording]:
        """Make recordings of the file at `path`: one, or one a session if its clock restarts.

        Rows in which a value other than truth is missing are left out, of rows with the same stamp
        all but the last; both are counted beside what was `dropped` before. Stamps since 1970 are
        counted from the first row. The session is the file's name up to a dot.
        """
        columns, robot = self.columns, self.robot
        check_shapes(columns, path.name)
        gaps = {n: np.isnan(values) for n, values in columns.items() if not n.startswith("truth")}
        whole = ~np.logical_or.reduce(list(gaps.values()))
        missing = int((~whole).sum())
        if missing > _MAX_MISSING * whole.size:
            worst = max(gaps, key=lambda name: int(gaps[name].sum()))
            raise RecordingError(
                f"{path.name}: {missing} of {whole.size} rows lack a value, {worst!r} in "
                f"{int(gaps[worst].sum())}; only truth may be missing that often: leave the column "
                "out"
            )
        if (columns["t"][:1] > _YEAR_5000).any():
            raise RecordingError(
                f"{path.name}: 't' begins at {columns['t'][0]:.4g} s, beyond the year 5000; "
                "if that is in ms, us or ns, state the unit in a column map"
            )
        last = last_of_each_stamp(columns["t"][whole])
        rows = np.flatnonzero(whole)[last]
        if len(rows) < whole.size:
            columns = {name: values[rows] for name, values in columns.items()}
        counts = {**self.dropped, MISSING: missing, "repeated time stamp": int((~last).sum())}
        session, rates = path.name.partition(".")[0], nominal_rates(state=columns["t"])
        provenance = Provenance(
            robot.name, robot.arm, path.name, self.sha256, session, rates=rates, notes=self.notes
        )
        sessions = _sessions(columns["t"])
        recordings = []
        for count, (first, end) in enumerate(sessions, 1):
            part = {name: values[first:end] for name, values in columns.items()}
            since_1970 = bool((part["t"][:1] > EPOCH).any())
            start = float(part["t"][0]) if since_1970 else math.nan
            if since_1970:
                part["t"] = part["t"] - start
            origin = replace(provenance, start=start, dropped=counts if count == 1 else {})
            if len(sessions) > 1:
                origin = replace(origin, session=f"{session}#{count}")
            recordings.append(Recording.from_columns(part, origin, self.units, robot=robot))
        return recordings


def _sessions(t: Array) -> list[tuple[int, int]]:
    """First row, and the row behind the last, of what was recorded in one go, by stamps (n,) [s].

    A clock restarts where it goes back by nearly all that went before, and stays there. Any other
    step back, or one next to a few rows only, is a stray stamp, which a recording refuses.
    """
    starts = [0]
    for row in (np.flatnonzero(np.diff(t) < 0) + 1).tolist():
        begin, before = t[starts[-1]], t[row - 1]
        stays = (t[row : row + 2] < before).all()
        if stays and t[row] - begin <= _RESTART * (before - begin):
            starts.append(row)
    bounds = list(itertools.pairwise([*starts, t.size]))
    stray = any(end - first < _SHORTEST_SESSION for first, end in bounds)
    return [(0, t.size)] if stray else bounds


def read_table(
    path: Path,
    robot: Robot | str = "",
    arm: str = "",
    column_map: MapSource | None = None,
    rate: float = 0.0,
    head: Head | None = None,
    needed: str = "measured",
) -> Table:
    """Read a text file of columns, or arrays: .npy with a row a sample, MATLAB with a signal a row.

    Without a map the first line of a text must name columns, in SI units, and others than ours are
    left out; arrays need a map. Without a robot one is made of the columns' joints, in rad. In a
    MATLAB file a column is called ``variable`` or ``struct.field``, followed by ``[k]`` where that
    holds several signals, and so it is in a folder of .npy files; a star stands for any letters.
    Any file may be in gzip. `robot` and `arm` overrule those of the column map, `rate` [Hz] stands
    in for time stamps. One column must be of the quantity `needed`.
    """
    head = head or (None if is_folder(path) else Head.of(path))
    if head and head.is_text:
        header = read_header(head, column_map, rate)
        machine, notes = _robot(path, header.columns, robot, arm, needed)
        table = read_text(header, machine)
        return replace(table, notes="; ".join(filter(None, (notes, header.left_out))))
    if column_map is None:
        raise RecordingError(f"{path}: what is in its columns? {MAP_ADVICE}")
    columns = _timed(path, read_column_map(column_map), rate)
    machine, notes = _robot(path, columns, robot, arm, needed)
    return replace(_in_si(path, columns, machine, *_arrays(path, columns, head)), notes=notes)


def read_text(header: "Header", robot: Robot) -> Table:
    """Columns of a text file, in which any value may be missing."""
    table = read_numbers(header.path, header.layout, [*header.positions.values()])
    columns = dict(zip(header.positions, table.values.T, strict=True))
    return _in_si(header.path, header.columns, robot, columns, table.sha256, table.incomplete)


def _arrays(path: Path, columns: ColumnMap, head: Head | None) -> tuple[dict[str, Array], str]:
    """Columns of a file of arrays, or of a folder of .npy files, as they stand; their SHA-256."""
    if head is not None and head.data.startswith(NPY_MAGIC):
        table, digest = read_npy(path)
        use = _positions(path, columns, None, table.shape[1])
        return {name: table[:, k] for name, k in use.items()}, digest
    names = {name: str(mapped.column) for name, mapped in columns.columns.items()}
    variables: dict[str, Array] = {}
    if head is not None:
        data, digest = read_bounded(path)
        variables = read_mat(data, str(path))
    else:
        for part in dict.fromkeys(name.partition("[")[0] for name in names.values()):
            array, digest = read_npy(path / f"{part}.npy")
            variables[part] = array.T
    rows = _signal(path, variables, names["t"]).size if "t" in names else 0
    return {ours: _signal(path, variables, name, rows) for ours, name in names.items()}, digest


@dataclass(frozen=True)
class Header:
    """What stands in the columns of a text file, where, and how the numbers stand."""

    path: Path
    columns: ColumnMap
    positions: Mapping[str, int]
    layout: TextLayout
    left_out: str = ""


def read_header(head: Head, column_map: MapSource | None = None, rate: float = 0.0) -> Header:
    """Find the columns of a text file.

    Raises RecordingError if a mapped column is not there, or nothing says what the columns are.
    """
    mapping = read_column_map(column_map) if column_map is not None else None
    how = (mapping.comment, mapping.delimiter) if mapping else ()
    layout, fields, named = text_layout(head, *how)
    left_out: list[str] = []
    if mapping is None:
        if not named:
            raise RecordingError(
                f"{head.path}: has no header that names t and <quantity>/<joint> columns; "
                f"{MAP_ADVICE}"
            )
        ours = [name for name in fields if all(name.partition("/"))]
        ours = ["t", *ours] if ours and "t" in fields else ours or fields
        left_out = [name for name in fields if name not in ours]
        mapping = ColumnMap({name: MappedColumn(name) for name in ours})
    mapping = _timed(head.path, mapping, rate)
    positions = _positions(head.path, mapping, fields if named else None, len(fields))
    notes = f"left out: {', '.join(left_out)}" if left_out else ""
    return Header(head.path, mapping, positions, layout, notes)


def _timed(path: Path, mapping: ColumnMap, rate: float) -> ColumnMap:
    """Column map with time stamps, or else with the rate that the caller states [Hz]."""
    if not (isinstance(rate, Real) and 0.0 <= rate <= 1e9):
        raise RecordingError(f"{path}: a rate of {rate!r:.40} Hz; state one above 0 Hz")
    if "t" in mapping.columns and rate:
        raise RecordingError(f"{path}: has time stamps, so no rate can be stated; leave it out")
    if "t" not in mapping.columns and not (rate or mapping.rate):
        raise RecordingError(
            f"{path}: no column 't' of time stamps: state their rate (rate_hz in the column map, "
            f"or --metadata rate_hz=), or which column it is; {MAP_ADVICE}"
        )
    return replace(mapping, rate=rate or mapping.rate)


def _signal(path: Path, arrays: Mapping[str, Array], name: str, rows: int = 0) -> Array:
    """One signal among arrays, along the side of `rows` samples, else the longer one."""
    stated, _, _ = name.partition("[")
    fitting = [array for array in arrays if fnmatchcase(array, stated)] if "*" in stated else []
    variable = fitting[0] if len(fitting) == 1 else stated
    name = variable + name[len(stated) :]
    value = arrays.get(variable)
    if value is None or not value.size:
        raise RecordingError(f"{path}: no signal {name!r}; the file has {', '.join(arrays)[:300]}")
    along = value.shape[1] == rows if rows in value.shape else value.shape[1] > value.shape[0]
    signals: Array = value if along else value.T
    names = [variable] if len(signals) == 1 else [f"{variable}[{k}]" for k in range(len(signals))]
    if name not in names:
        raise RecordingError(
            f"{path}: {variable!r} holds {len(signals)} signals, which {name!r} does not name; "
            f"write {' to '.join(dict.fromkeys((names[0], names[-1])))}"
        )
    return np.asarray(signals[names.index(name)])


def _robot(
    path: Path, mapping: ColumnMap, robot: Robot | str, arm: str, needed: str
) -> tuple[Robot, str]:
    """Give the robot, and what was assumed where one had to be made.

    One that nobody names has the joints with a `needed` column, in rad unless from a length.
    """
    names = {name: (*name.partition("/")[::2],) for name in mapping.columns}
    notes = ""
    if model := robot or mapping.robot:
        machine = get_robot(model, arm or mapping.arm)
    else:
        units = {name: SI_UNITS.get(m.unit, ("rad", 1.0))[0] for name, m in mapping.columns.items()}
        joints = {
            joint: Joint(joint, "prismatic" if units[name] == "m" else "revolute")
            for name, (quantity, joint) in names.items()
            if quantity == needed and joint
        }
        if not joints:
            raise RecordingError(
                f"{path}: no '{needed}/<joint>' column; name the columns t,measured/bend,"
                f"truth/bend,... or {MAP_ADVICE}"
            )
        machine = Robot("rig", tuple(joints.values()))
        listed = ", ".join(f"{joint.name} [{joint.unit}]" for joint in machine.joints)
        notes = f"no robot named: made one of the columns, {listed}, without limits"
        assumed = [
            f"{name} in {default_unit(name, machine)}"
            for name, (quantity, channel) in names.items()
            if channel and quantity not in POSITION_QUANTITIES and not mapping.columns[name].unit
        ]
        notes += f"; taken as {', '.join(assumed)}" if assumed else ""
    for name, (quantity, channel) in names.items():
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
    quantities = {quantity for quantity, _ in names.values()}
    # Where the mechanism is known, the measured position may be its motor's.
    if needed not in quantities and not (
        needed == "measured" and machine.mechanism and "motor" in quantities
    ):
        why = "there is nothing to correct" if needed == "measured" else "it is no truth"
        raise RecordingError(f"{path}: no '{needed}/<joint>' column; {why}")
    return machine, notes


def _in_si(
    path: Path,
    mapping: ColumnMap,
    robot: Robot,
    numbers: Mapping[str, Array],
    sha256: str,
    incomplete: int = 0,
) -> Table:
    """Columns in SI units with their stamps, the unit of each but those, and what is missing."""
    columns, units = {}, {}
    for name, values in numbers.items():
        mapped = mapping.columns[name]
        expected = "s" if name == "t" else default_unit(name, robot)
        units[name], factor = SI_UNITS[mapped.unit] if mapped.unit else (expected, 1.0)
        if expected not in {units[name], "1"}:
            raise RecordingError(
                f"{path}: column {name!r} is in {expected}, which {mapped.unit!r} cannot be; "
                "correct the column map"
            )
        with np.errstate(all="ignore"):  # what is not finite is refused in its row
            columns[name] = values * (mapped.scale * factor)
            if mapped.offset:
                columns[name] += mapped.offset * factor
    units.pop("t", None)
    if mapping.rate:
        columns = {"t": np.arange(next(iter(columns.values())).size) / mapping.rate, **columns}
    missing = [np.isnan(values) for name, values in columns.items() if name.startswith("truth/")]
    dropped = {CUT_SHORT: incomplete}
    if missing:
        dropped["truth: value missing"] = int(np.any(missing, axis=0).sum())
    return Table(robot, columns, units, sha256, dropped)


def _positions(
    path: Path, mapping: ColumnMap, header: Sequence[str] | None, count: int
) -> dict[str, int]:
    use = {}
    for name, mapped in mapping.columns.items():
        column = mapped.column
        if isinstance(column, int):
            places = [column] if column < count else []
            why = f"there are {count} columns, counted from 0"
        else:
            places = [k for k, field in enumerate(header or ()) if field == column]
            why = f"the header has {', '.join(header)}" if header else "there is no header"
        if len(places) != 1:
            often = "there twice" if places else "not there"
            raise RecordingError(
                f"{path}: column {column!r} is {often}, for {name!r}; {why}: correct the column map"
            )
        use[name] = places[0]
    return use
