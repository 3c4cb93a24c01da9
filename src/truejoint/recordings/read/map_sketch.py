"""A column map to start from: what a file has, and what its names suggest that it is."""

import json
import os
import re
from collections.abc import Iterator, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import Final

from truejoint.errors import RecordingError
from truejoint.recordings.bounded_file import Head, read_bounded
from truejoint.recordings.read.array_files import NPY_MAGIC, read_mat, read_npy
from truejoint.recordings.read.numeric_text import is_number, split_fields, text_layout
from truejoint.recordings.table.parquet import PARQUET_MAGIC
from truejoint.recordings.table.recording import default_unit
from truejoint.robots import Robot, get_robot
from truejoint.toml_file import shipped_table
from truejoint.units import SI_UNITS

# A column's name is cut into words of one kind of letter.
_WORD: Final = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+")
_LAYOUT: Final = shipped_table(__package__, "layouts.toml")
_SYNONYMS: Final[dict[str, str]] = _LAYOUT["synonyms"]
_QUANTITY_WORDS: Final = frozenset(" ".join(_SYNONYMS.values()).split())
QUANTITIES: Final = (*reversed(_SYNONYMS),)
"""Quantities that names of columns are searched for."""

_TIMES: Final = frozenset({"t", "time", "stamp", "timestamp", "sec", "secs", "seconds"})
_UNITS: Final = {unit.lower(): unit for unit in SI_UNITS if unit != "1"} | _LAYOUT["units"]
_ARRAY_COLUMNS: Final = 64  # of one variable that are listed


def sketch_column_map(path: str | os.PathLike[str], robot: str = "", arm: str = "") -> str:
    r"""Write a column map for a file, with guesses for `read_column_map` to read and you to mend.

    Parameters
    ----------
    path : path-like
        Text with or without a header, .npy or .mat file.
    robot, arm : str
        As in `truejoint.robots.get_robot`, for the names of joints.

    Raises
    ------
    RecordingError
        If the file cannot be read, or needs no map.

    Examples
    --------
    >>> _ = open("run.csv", "w").write("stamp_ms,jaw_pos_deg,jaw_torque\n0,5,0.1\n1,6,0.1\n")
    >>> print(sketch_column_map("run.csv", "davinci_grasper"))
    # Columns of run.csv as their names suggest; mend what is wrong, delete what is not needed.
    robot = "davinci_grasper"
    # joints: jaw
    # quantities: measured, effort, current, velocity, motor, setpoint, truth, pot, motor_velocity
    <BLANKLINE>
    [columns]
    "t" = { column = "stamp_ms", unit = "ms" }  # 0
    "measured/jaw" = { column = "jaw_pos_deg", unit = "deg" }  # 5
    "effort/jaw" = { column = "jaw_torque" }  # 0.1
    """
    path = Path(path)
    machine = get_robot(robot, arm) if robot else None
    entries = {"robot": machine.name, "arm": machine.arm} if machine else {}
    columns = {name: (example, _number(name)) for name, example in _columns(path)}
    from_zero = any(number == 0 for _, number in columns.values())
    sketched: dict[str, str] = {}
    rest = []
    for name, (example, number) in columns.items():
        ours = _guess(name, machine, None if number is None else number + from_zero)
        is_whole = "<" not in ours
        unit = _unit(ours if is_whole else "", name, machine)
        entry = f"{{ column = {_quoted(name)}{unit} }}  # {example}"
        if is_whole and ours not in sketched:
            sketched[ours] = entry
        else:
            rest.append(f'# "{"<quantity>/<joint>" if is_whole else ours}" = {entry}')
    lines = [
        f"# Columns of {_quoted(path.name)[1:-1]} as their names suggest; mend what is wrong, "
        "delete what is not needed."
    ]
    lines += [f"{key} = {_quoted(text)}" for key, text in entries.items() if text]
    if not machine:
        lines.append('# robot = "<name, or a robot file beside this one; else one of the columns>"')
    joints = ", ".join(machine.channels if machine else ("as you call them",))
    lines += [f"# joints: {joints}", f"# quantities: {', '.join(QUANTITIES)}"]
    if not any(name.startswith("measured/") for name in sketched):
        lines.append("# no measured/<joint>: where a command stands for it, write so in its place")
    if "t" not in sketched:
        lines.append("# rate_hz = <rate of the rows, unless one of the columns is t>")
    lines += ["", "[columns]", *(f"{_quoted(ours)} = {e}" for ours, e in sketched.items()), *rest]
    return "\n".join(lines)


def _columns(path: Path) -> Iterator[tuple[str | int, str]]:
    """Name or position of each column of a file, and what stands in its first row."""
    head = Head.of(path)
    if head.data.startswith(PARQUET_MAGIC):
        raise RecordingError(f"{path}: is Parquet: ours needs no column map, save others as CSV")
    if head.data.startswith(NPY_MAGIC):
        array, _ = read_npy(path)
        yield from ((k, f"{value:g}") for k, value in enumerate(array[0].tolist()))
    elif not head.is_text:
        data, _ = read_bounded(path)
        for name, value in read_mat(data, str(path)).items():
            signals = value if value.shape[1] > value.shape[0] else value.T
            for k, signal in enumerate(signals[:_ARRAY_COLUMNS]):
                first = f"{signal[0]:g}, {signal.size} values" if signal.size else "empty"
                yield name if len(signals) == 1 else f"{name}[{k}]", first
    else:
        layout, fields, named = text_layout(head)
        if not named:
            yield from enumerate(fields)
            return
        line = "".join(head.lines()[layout.skip : layout.skip + 1])
        below = split_fields(line, layout.delimiter)[: len(fields)]
        for k, (field, example) in enumerate(zip_longest(fields, below, fillvalue="")):
            is_unique = field and fields.count(field) == 1
            yield field if is_unique else k, example if is_number(example) else ""


def _words(name: str | int) -> list[str]:
    return [word.lower() for word in _WORD.findall(name)] if isinstance(name, str) else []


def _number(name: str | int) -> int | None:
    """Last number in a name, if it could count joints."""
    numbers = [int(word) for word in _words(name) if word.isdigit() and len(word) < 3]
    return numbers[-1] if numbers else None


def _guess(name: str | int, robot: Robot | None, number: int | None) -> str:
    """Guess what a column is in a recording, with <...> for what its name does not say."""
    words = set(_words(name))
    if name == "t" or (words & _TIMES and not words - _TIMES - set(_UNITS) - {"ros", "header"}):
        return "t"
    if isinstance(name, str) and re.fullmatch(r"[A-Za-z]\w*/\w+", name, re.ASCII):
        return name
    quantity = next((q for q, names in _SYNONYMS.items() if words & {*names.split()}), "")
    channels: Sequence[str] = robot.channels if robot else ()
    named = _channels_named(words, str(name).lower(), channels)
    if named and not words - set(_UNITS) - set(named) - set(_words(named[0])):
        quantity = "measured"  # nothing but the joint, and perhaps a unit
    if not named and number is not None:
        joints = robot.joint_names if robot else [f"joint{k}" for k in range(1, 100)]
        named = [joints[number - 1]] if 1 <= number <= len(joints) else []
    if not named and len(channels) == 1:
        named = list(channels)
    return f"{quantity or '<quantity>'}/{named[0] if named else '<joint>'}"


def _channels_named(words: set[str], name: str, channels: Sequence[str]) -> list[str]:
    """Channels that a name holds, the longest first; else that with most of its words."""
    if whole := [channel for channel in channels if channel in name]:
        return sorted(whole, key=len, reverse=True)
    of_each = {c: {word for word in _words(c) if word.isalpha()} for c in channels}
    begun = tuple(word for word in words - _QUANTITY_WORDS if len(word) > 2)  # as ins of insertion
    words = words | {w for own in of_each.values() for w in own if w.startswith(begun)}
    common = set.intersection(*of_each.values()) if len(channels) > 1 else set()
    likeness = {c: (len(w & words), -len(w)) for c, w in of_each.items() if (w - common) & words}
    return sorted(likeness, key=lambda channel: likeness[channel], reverse=True)[:1]


def _unit(ours: str, name: str | int, robot: Robot | None) -> str:
    """Give the unit as a part of an entry, where the name says one that the column may have."""
    unit = next((_UNITS[word] for word in reversed(_words(name)) if word in _UNITS), "")
    si = SI_UNITS[unit][0] if unit else ""
    expected = "s" if ours == "t" else default_unit(ours, robot) if ours and robot else si
    return f', unit = "{unit}"' if unit and expected in {si, "1"} and unit != si else ""


def _quoted(name: str | int) -> str:
    """Give a name as TOML has it, whatever it holds."""
    text = json.dumps(name, ensure_ascii=False) if isinstance(name, str) else str(name)
    return text.replace("\x7f", "\\u007F")
