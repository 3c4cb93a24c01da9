"""The `Recording`: one table with named columns, units and provenance."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from importlib import import_module
from numbers import Integral, Real
from os import PathLike
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from truejoint import drawing, schema
from truejoint.array_types import Array, Integers, Mask
from truejoint.errors import RecordingError, other_kind
from truejoint.extras import require
from truejoint.robots import Robot, get_robot
from truejoint.summary import Summarised, json_values
from truejoint.units import SI_UNITS

# A stamp above this is seconds since 1970: it would be 3 years into one recording.
EPOCH: Final = 1e8

_LARGEST: Final = 1e15  # number in a provenance: seconds, hertz, kilograms, rows
_SHOWN: Final = 8  # quantities that a summary lists with their channels

MISSING: Final = "value missing"

# Quantities whose unit is that of the joint's position.
POSITION_QUANTITIES: Final = ("measured", "setpoint", "pot", "truth", "truth_exact")


@dataclass(frozen=True)
class Provenance:
    """Origin of a recording.

    Attributes
    ----------
    robot, arm : str
        As in `truejoint.robots.get_robot`.
    source : str
        File or simulation that it was made from.
    sha256 : str
        Hash of the source file, hexadecimal; empty for a simulation.
    session : str
        Label of rows that were recorded in one go; rows of different sessions never share a model's
        history.
    homing_id : str
        Which homing the positions refer to; positions of two homings differ by an offset.
    load : float
        Mass hung on the tool [kg]; NaN when not known.
    rates : mapping
        Nominal rate [Hz] of each stream, for instance ``{"state": 30.0, "truth": 100.0}``.
    dropped : mapping
        How many rows were dropped, by reason, when streams were synchronised or read.
    start : float
        Time of ``t = 0`` on the clock of the robot [s], since 1970 for a real one; NaN when not
        known.
    command : str
        Command line that made the recording; empty when unknown.
    notes : str
        Anything that a reader of the table must know.

    Raises
    ------
    RecordingError
        If a field is of another kind.

    Examples
    --------
    >>> Provenance("raven2", "left", homing_id="morning").to_dict()["homing_id"]
    'morning'
    """

    robot: str
    arm: str = ""
    source: str = ""
    sha256: str = ""
    session: str = ""
    homing_id: str = ""
    load: float = math.nan
    rates: Mapping[str, float] = field(default_factory=dict)
    dropped: Mapping[str, int] = field(default_factory=dict)
    start: float = math.nan
    command: str = ""
    notes: str = ""

    def __post_init__(self) -> None:
        for each in fields(self):
            plain = _plain(each.name, each.type, getattr(self, each.name))
            object.__setattr__(self, each.name, plain)
        # A reason for which nothing was dropped need not be told.
        object.__setattr__(self, "dropped", {k: n for k, n in self.dropped.items() if n})

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON; NaN becomes None."""
        return dict(json_values(self))

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> "Provenance":
        """Inverse of `to_dict`; raises RecordingError on unknown keys and wrong kinds of value."""
        unknown = [name for name in ("load", "start") if values.get(name) is None]
        stated = {key: value for key, value in values.items() if key not in unknown}
        return schema.read(cls, stated, "provenance", RecordingError)


def _plain(name: str, kind: Any, value: Any) -> Any:
    """Field of a provenance that is annotated as `kind`, as a file keeps it."""
    if kind is str and isinstance(value, str):
        # Half a character, as of a file's name, can go nowhere.
        return value.encode("utf-8", "backslashreplace").decode()
    is_unknown = isinstance(value, float | np.floating) and math.isnan(value)
    if kind is float and (is_unknown or _is_number(value)):
        return float(value)
    if (
        kind not in (str, float)
        and isinstance(value, Mapping)
        and all(isinstance(key, str) and _is_number(number) for key, number in value.items())
    ):
        return {k: int(n) if isinstance(n, Integral) else float(n) for k, n in value.items()}
    want = {str: "text", float: "a number in SI units"}.get(kind, "numbers by name")
    raise RecordingError(f"provenance: {name!r} is {value!r:.60}; want {want}")


def _is_number(value: Any) -> bool:
    real = isinstance(value, Real) and not isinstance(value, bool)
    return real and bool(-_LARGEST <= value <= _LARGEST)


@dataclass(frozen=True, eq=False, repr=False)
class Recording(Summarised):
    """Motor-side signals of an arm over time, and the true joint positions where known.

    Attributes
    ----------
    table : DataFrame
        Column ``t`` [s], then ``<quantity>/<joint>``: ``measured`` (position reported from the
        motor side), ``velocity``, ``effort``, ``setpoint``, ``motor``, ``motor_velocity``,
        ``current``, ``pot`` (from a potentiometer), ``truth`` (from a joint sensor),
        ``truth_effort``, ... float64, one row a sample, ``t`` strictly increasing. NaN only in
        ``truth*`` columns, in rows without a truth.
    units : mapping
        SI unit of each column but ``t``; ``"1"`` for a quantity without a known unit.
    provenance : Provenance
    robot : Robot, optional
        The arm that was recorded; by default the one that the provenance names.

    Raises
    ------
    RecordingError
        If the table breaks one of these rules; the message names column, row and value.
    RobotError
        If there is no such robot.

    Examples
    --------
    >>> columns = {"t": [0.0, 0.01], "measured/jaw": [0.2, 0.3], "truth/jaw": [0.21, 0.31]}
    >>> recording = Recording.from_columns(columns, "davinci_grasper")
    >>> recording.error(["jaw"]).round(3).tolist()
    [[0.01], [0.01]]
    """

    table: pd.DataFrame
    units: Mapping[str, str]
    provenance: Provenance
    robot: Robot = None  # type: ignore[assignment]  # never None once it is made

    def __post_init__(self) -> None:
        origin = self.provenance
        if not isinstance(origin, Provenance):
            raise RecordingError(
                "a recording needs a Provenance; Recording.from_columns(table, robot) makes one"
            )
        if self.robot is None or (self.robot.name, self.robot.arm) != (origin.robot, origin.arm):
            object.__setattr__(self, "robot", get_robot(origin.robot, origin.arm))
        _check_table(self.table, self.units, self.provenance.source or "recording")

    @classmethod
    def from_columns(
        cls,
        columns: Mapping[str, Any],
        provenance: Provenance | Robot | str,
        units: Mapping[str, str] | None = None,
        *,
        robot: Robot | None = None,
        copy: bool = True,
    ) -> "Recording":
        """Make a recording of columns by name; units of joint positions come from the robot.

        `columns` is a mapping or a DataFrame of ``t`` [s] and ``<quantity>/<joint>`` (n,), SI;
        `provenance` says where they come from, or is the robot or its name; `units` those for
        which `default_unit` is not right; `robot` is the arm where its name does not tell all.
        The measured positions of a robot whose mechanism is known follow from those of its motors
        where they are not given. Without a `copy` the recording keeps
        the arrays themselves, which then must not change: those of a day take much memory. Raises
        RecordingError or RobotError if the columns break a rule of a recording, or there is no such
        robot.

        Examples
        --------
        >>> columns = {"t": [0.0, 0.1], "measured/jaw": [0.2, 0.3], "truth/jaw": [0.21, 0.32]}
        >>> Recording.from_columns(columns, "davinci_grasper")
        Recording
          robot        davinci_grasper
          source       -
          rows         2 over 0.1 s
          measured     jaw
          truth        jaw
        """
        if isinstance(provenance, Robot):
            robot, provenance = provenance, Provenance(provenance.name, provenance.arm)
        if isinstance(provenance, str):
            provenance = Provenance(provenance)
        if not isinstance(provenance, Provenance):
            advice = "give the robot, its name or a Provenance"
            raise RecordingError(other_kind(provenance, "Provenance", advice))
        try:
            arrays = {str(name): _numbers(values) for name, values in columns.items()}
        except (AttributeError, OverflowError, TypeError, ValueError) as error:
            raise RecordingError(
                f"{provenance.source or 'recording'}: {error}; give a table, or a mapping of names "
                "to columns of numbers"
            ) from None
        if not isinstance(units or {}, Mapping):
            advice = "give units by column; an arm is named by Provenance(robot, arm)"
            raise RecordingError(other_kind(units, "mapping", advice))
        check_shapes(arrays, provenance.source or "recording")
        robot = robot or get_robot(provenance.robot, provenance.arm)
        mechanism = robot.mechanism
        motors = [f"motor/{joint}" for joint in robot.joint_names]
        measured = [f"measured/{joint}" for joint in robot.joint_names]
        if mechanism is not None and arrays.keys() >= set(motors) and not {*measured} & {*arrays}:
            joints = np.linalg.solve(mechanism.coupling, np.array([arrays[m] for m in motors]))
            arrays.update(zip(measured, joints, strict=True))
        table = pd.DataFrame(arrays, copy=copy)
        filled = {name: default_unit(name, robot) for name in table.columns if name != "t"}
        filled.update(units or {})
        return cls(table, filled, provenance, robot)

    from_dataframe = from_columns

    def to_dataframe(self) -> pd.DataFrame:
        """Copy of `table`, whose ``attrs`` hold ``"units"`` and ``"provenance"``."""
        frame = self.table.copy()
        frame.attrs = {"units": dict(self.units), "provenance": self.provenance.to_dict()}
        return frame

    def to_xarray(self) -> Any:
        """Give an ``xarray.Dataset``: quantities by `t` and `joint`, with units (extra xarray).

        A channel that a quantity lacks is NaN. The Dataset's ``attrs`` hold the provenance.
        """
        xarray = require("xarray", "xarray", "to_xarray")
        joints = list(dict.fromkeys(name.partition("/")[2] for name in self.units))
        quantities = {}
        for quantity in dict.fromkeys(name.partition("/")[0] for name in self.units):
            values = self.table.reindex(columns=[f"{quantity}/{joint}" for joint in joints])
            units = {joint: self.units[f"{quantity}/{joint}"] for joint in self.joints_of(quantity)}
            quantities[quantity] = (("t", "joint"), values.to_numpy(), {"units": units})
        return xarray.Dataset(quantities, {"t": self.t, "joint": joints}, self.provenance.to_dict())

    def save(self, path: str | PathLike[str], *, overwrite: bool = False) -> None:
        """Write a Parquet file, as `write_parquet` does."""
        import_module("truejoint").write_parquet(self, path, overwrite=overwrite)

    def plot(self) -> Any:
        """Draw positions over time in deg and mm; give matplotlib's axes (n_joints,)."""
        joints = self.joints or map(str, self.column("measured"))  # which is refused
        units = {joint: self.units[f"measured/{joint}"] for joint in joints}
        there = filter(self.joints_of, POSITION_QUANTITIES)
        names = {quantity: [f"{quantity}/{joint}" for joint in units] for quantity in there}
        curves = {q: self.table.reindex(columns=own).to_numpy() for q, own in names.items()}
        return drawing.plot(self.provenance.source, self.t, curves, units, "time [s]")

    def __getitem__(self, key: str | slice) -> Any:
        """Give a column (n,), a quantity (n, n_joints), or the rows between two times [s]."""
        if isinstance(key, str):
            joints = self.joints_of(key)
            return self.columns(key, joints) if joints else self.column(key)
        is_plain = isinstance(key, slice) and key.step is None
        ends: tuple[Any, Any] = (key.start, key.stop) if is_plain else (key, key)
        if not is_plain or not all(end is None or isinstance(end, Real) for end in ends):
            raise RecordingError(f"recording[{key!r:.40}]: give a column or a slice of times [s]")
        first, end = ends
        later = self.t >= (-math.inf if first is None else first)
        return self.rows(later & (self.t < (math.inf if end is None else end)))

    def __iter__(self) -> Iterator[str]:
        return iter(self.table.columns)

    def __len__(self) -> int:
        return len(self.table)

    if not TYPE_CHECKING:  # as in its base

        def __getattr__(self, name: str) -> Any:
            if name in ("describe", "head", "iloc", "loc", "tail", "to_csv"):
                return getattr(self.to_dataframe(), name)
            known = name[0] != "_" and self.joints_of(name)
            return self[name] if known else super().__getattr__(name)

    def summary(self) -> dict[str, str]:
        """Robot, source, size and columns, by label."""
        quantities = sorted(
            dict.fromkeys(name.partition("/")[0] for name in self.units),
            key=lambda quantity: quantity not in ("measured", "effort", "truth"),
        )
        shown, others = quantities[:_SHOWN], ", ".join(quantities[_SHOWN:])
        return {
            "robot": self.robot.title,
            "source": self.provenance.source or "-",
            "rows": f"{len(self)} over {self.duration:.1f} s",
            **{name: ", ".join(self.joints_of(name)) or "-" for name in shown},
            **({"others": others} if others else {}),
        }

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints whose position is measured."""
        return self.joints_of("measured")

    @property
    def t(self) -> Array:
        """Time stamps (n,) [s]."""
        return self.table["t"].to_numpy()

    time = t

    @property
    def duration(self) -> float:
        """Time from the first to the last row [s]."""
        return float(self.t[-1] - self.t[0])

    def joints_of(self, quantity: str) -> tuple[str, ...]:
        """Names of the channels that have a column of `quantity`, in the table's order."""
        prefix = quantity + "/"
        return tuple([c.removeprefix(prefix) for c in self.table.columns if c.startswith(prefix)])

    def column(self, name: str) -> Array:
        """One column (n,) by name; raises RecordingError naming the columns that exist."""
        if name not in self.table.columns:
            raise RecordingError(
                f"{self.provenance.source or 'recording'} has no column {name!r}; it has "
                f"{', '.join(map(str, self.table.columns))}"
            )
        return self.table[name].to_numpy()

    def columns(self, quantity: str, joints: Sequence[str]) -> Array:
        """Columns of `quantity` for `joints` as one array (n, n_joints)."""
        arrays = [self.column(f"{quantity}/{joint}") for joint in joints]
        return np.column_stack([np.empty((len(self), 0)), *arrays])

    def error(self, joints: Sequence[str]) -> Array:
        """Truth minus measured (n, n_joints) [rad or m]; the correction to be added."""
        return self.columns("truth", joints) - self.columns("measured", joints)

    def rows(self, selection: slice | Mask | Integers) -> "Recording":
        """Keep the selected rows only; raises RecordingError where they do not fit it."""
        try:
            rows: Any = selection if isinstance(selection, slice) else np.atleast_1d(selection)
            table = self.table.iloc[rows]
        except (IndexError, TypeError, ValueError) as error:
            raise RecordingError(
                f"{self.provenance.source or 'recording'}: rows {str(selection)!r:.60} of "
                f"{len(self)}: {error}; give a slice, numbers of rows, or a mask of all"
            ) from None
        return replace(self, table=table.reset_index(drop=True))

    def with_truth(self, joints: Sequence[str]) -> "Recording":
        """Only the rows in which the truth of every joint in `joints` is known."""
        return self.rows(np.flatnonzero(~np.isnan(self.columns("truth", joints)).any(axis=1)))


def as_recording(value: object) -> Recording:
    """Give back a recording; raises RecordingError for anything else, saying how to make one."""
    if isinstance(value, Recording):
        return value
    advice = (
        "read files with read_recording(path), make one of columns with "
        "Recording.from_columns(table, robot)"
    )
    raise RecordingError(other_kind(value, "Recording", advice))


def as_recordings(recordings: Recording | Iterable[Recording]) -> list[Recording]:
    """One recording or several as a list; raises RecordingError as `as_recording`."""
    if isinstance(recordings, Sequence | Iterator) and not isinstance(recordings, str):
        return [as_recording(item) for item in recordings]
    return [as_recording(recordings)]


def nominal_rates(**stamps: Array) -> dict[str, float]:
    """Give the usual rate [Hz] of each stream's stamps (n,) [s], of those that have one."""
    steps = {name: float(np.median(np.diff(t))) for name, t in stamps.items() if t.size > 1}
    return {name: round(1.0 / dt, 3) for name, dt in steps.items() if dt * _LARGEST >= 1.0}


def last_of_each_stamp(t: Array | NDArray[np.int64]) -> Mask:
    """Rows (n,) of stamps `t` (n,) [s] that are not repeated by the next: a clock that stood."""
    return np.append(np.diff(t) != 0, [True] * min(t.size, 1)).astype(np.bool_)


def runs(same: Mask) -> list[tuple[int, int]]:
    """First row of each run of True in `same` (n,), and the row behind its last."""
    edges = np.flatnonzero(np.diff(same, prepend=False, append=False))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def default_unit(column: str, robot: Robot) -> str:
    """Give the SI unit that a column has unless another is stated; ``"1"`` if none is known."""
    quantity, _, channel = column.partition("/")
    if channel in robot.channels:
        is_joint = channel in robot.joint_names
        unit = robot.joint(channel).unit if is_joint else "rad"
        if quantity in POSITION_QUANTITIES:
            return unit
        if quantity == "velocity":
            return unit + "/s"
        if quantity in ("effort", "truth_effort", "truth_load"):
            at_joint = is_joint and (robot.effort == "joint" or quantity != "effort")
            return robot.joint(channel).effort_unit if at_joint else "Nm"
    return _UNITS.get(quantity, "1")


_UNITS: Final = {
    **dict.fromkeys(("motor", "motor_setpoint", "driver"), "rad"),
    **dict.fromkeys(("motor_velocity", "driver_velocity"), "rad/s"),
    **dict.fromkeys(("tool", "tool_setpoint", "cable"), "m"),
    **dict.fromkeys(("tension", "truth_tension", "force"), "N"),
    "current": "A",
    "truth_load": "Nm",
}


def _require_time(columns: Iterable[str], source: str) -> None:
    if "t" not in columns:
        raise RecordingError(f"{source}: no column 't'; a recording needs time stamps in seconds")


def _numbers(values: Any) -> Array:
    """Numbers as floats; TypeError for those that are complex, a date or a duration."""
    given = np.asarray(values)
    if given.dtype.kind in "cmM":
        raise TypeError(f"{given.dtype} is no column of numbers, such as seconds")
    return given.astype(float, copy=False)


def check_shapes(columns: Mapping[str, Array], source: str) -> None:
    """Refuse, with RecordingError, columns without time, or that are not all as long as it."""
    _require_time(columns, source)
    rows = columns["t"].shape
    for name, values in columns.items():
        if values.ndim != 1 or values.shape != rows:
            raise RecordingError(
                f"{source}: column {name!r} has shape {values.shape}; want {rows[:1]}: one value "
                "for each row of 't'"
            )


def _check_table(table: pd.DataFrame, units: Mapping[str, str], source: str) -> None:
    _require_time(table.columns, source)
    if table.columns.has_duplicates:
        twice = sorted(set(table.columns[table.columns.duplicated()]))
        raise RecordingError(f"{source}: columns {twice} appear twice; each name may stand once")
    if len(table) < 2:
        raise RecordingError(f"{source}: {len(table)} rows; a recording needs at least 2")
    without = [c for c in table.columns if c != "t" and c not in units]
    if without:
        raise RecordingError(f"{source}: columns {without} have no unit; state one for each")
    for name, unit in units.items():
        si, factor = SI_UNITS.get(unit, (unit, 1.0)) if isinstance(unit, str) else ("", 0.0)
        if factor != 1.0:
            advice = f"multiply it by {factor:g} and state {si!r}" if si else "state a text"
            raise RecordingError(f"{source}: unit of {name!r} is {unit!r:.40}, not SI; {advice}")
    for name in table.columns:
        values = table[name].to_numpy()
        if values.dtype != np.float64:
            raise RecordingError(f"{source}: column {name!r} is {values.dtype}, not float64")
        bad = np.isinf(values) if name.startswith("truth") else ~np.isfinite(values)
        if bad.any():
            row = int(np.argmax(bad))
            raise RecordingError(
                f"{source}: column {name!r} row {row} is {values[row]}; only truth may be "
                "missing: drop such rows before"
            )
    step = np.diff(table["t"].to_numpy())
    if not (step > 0).all():
        row = int(np.argmax(~(step > 0))) + 1
        raise RecordingError(
            f"{source}: time stamp of row {row} goes back or repeats ({table['t'].iloc[row]:.6f} s "
            f"after {table['t'].iloc[row - 1]:.6f} s); sort or drop such rows before"
        )
