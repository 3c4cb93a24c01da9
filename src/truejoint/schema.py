"""One reader of tables: plain values of TOML or JSON in, checked frozen values out.

A dataclass or named tuple is the schema: its annotations say what each key holds. A field may be a
`float`, `int`, `bool`, `str`, `Literal`, `tuple`, `Mapping` with text keys, `Array`, another
dataclass, a union of these, or any of them `Annotated` with a rule of this module. A field with a
default may be missing.
"""

from __future__ import annotations

import math
import re
import types
import typing
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import MISSING, dataclass, fields, is_dataclass
from functools import cache
from typing import (
    Annotated,
    Any,
    Final,
    Literal,
    NamedTuple,
    TypeVar,
    Union,
    cast,
    get_args,
    get_origin,
)

import numpy as np

from truejoint.errors import TruejointError, unknown

_Value = TypeVar("_Value")
_Read = Callable[[Any], Any]
_NUMBER: Final = 1.7e308


@dataclass(frozen=True)
class Bounds:
    """Range of a number, or of each number of a list; NaN and infinity are in none.

    `above` says that the number must be larger than `low`.

    Examples
    --------
    >>> Bounds(0.0, above=True).rule
    'above 0'
    """

    low: float = -_NUMBER
    high: float = _NUMBER
    above: bool = False

    @property
    def rule(self) -> str:
        """The range in words, empty if every finite number is in it."""
        low = "" if self.low == -_NUMBER else f"{'above' if self.above else 'from'} {self.low:g}"
        high = "" if self.high == _NUMBER else f"{'to' if low else 'up to'} {self.high:g}"
        return f"{low} {high}".strip()


class Length(NamedTuple):
    """Least and largest number of entries of a list or table, or of characters of a text."""

    low: int = 0
    high: int = 1 << 20


class Choice(NamedTuple):
    """Texts of which a text must be one, where `Literal` cannot name them."""

    names: tuple[str, ...]


class Pattern(NamedTuple):
    """Regular expression that a text matches as a whole, and the same rule in words."""

    expression: str
    rule: str


class Shape(NamedTuple):
    """Shape of an array; None for an axis of any length."""

    sizes: tuple[int | None, ...]


class Key(NamedTuple):
    """Key of a field in the file where it is not the field's name; `factor` leads to SI units."""

    name: str
    factor: float = 1.0


class Ordered(NamedTuple):
    """Mapping whose order counts: it is written as a list of tables, each with its ``name``.

    `value` is the key of a value that is no table. Every mapping can be read from such a list.
    """

    value: str = "value"


Positive = Annotated[float, Bounds(0.0, above=True)]
NotNegative = Annotated[float, Bounds(0.0)]
Name = Annotated[str, Pattern(r"\w{1,60}", "up to 60 letters, digits and _")]


class _Broken(Exception):  # it never leaves this module
    """A value that breaks a rule, and the path to it, which grows from the inside."""

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self.path = ""

    def within(self, key: str | int) -> _Broken:
        """Give the same fault, one table or list further out."""
        if isinstance(key, int):
            step = f"[{key}]"
        else:
            step = key if key.isidentifier() and len(key) <= 60 else f"{key!r:.60}"
        self.path = step + ("." if self.path and self.path[0] != "[" else "") + self.path
        return self


def read(
    kind: type[_Value], values: Any, source: str, error: type[TruejointError] = TruejointError
) -> _Value:
    """Value of a dataclass or named tuple from a table.

    Parameters
    ----------
    kind : type
        Its annotations are the schema. If it has a class attribute ``SHORT``, a value that is no
        table stands for a table with this one key.
    values : mapping
        Plain values, as TOML or JSON give them.
    source : str
        Where the table stands; the errors begin with it.
    error : type
        Raised if a key is unknown or missing, or a value breaks its rule. The message has the path
        to the value, the value and the rule. What the constructor raises is raised alike.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> from truejoint import schema
    >>> @dataclass(frozen=True)
    ... class Pulley:
    ...     radius: schema.Positive
    ...     wrap: float = 0.0
    >>> schema.read(Pulley, {"radius": 4e-3}, "robot.toml")
    Pulley(radius=0.004, wrap=0.0)
    >>> schema.read(Pulley, {"radius": "4 mm"}, "robot.toml")
    Traceback (most recent call last):
    truejoint.errors.TruejointError: robot.toml: radius is '4 mm'; want a number above 0
    """
    try:
        return cast("_Value", _reader(kind)(values))
    except _Broken as fault:
        path = f": {fault.path}" if fault.path else ""
        raise error(f"{source}{path}{fault}") from None


def plain(value: Any) -> Any:
    """Plain values for JSON or TOML, of which `read` makes the value again.

    Fields that are None, NaN or infinite are left out.

    Examples
    --------
    >>> plain({"points": np.zeros((2, 1)), "names": ("a", "b")})
    {'points': [[0.0], [0.0]], 'names': ['a', 'b']}
    """
    if is_dataclass(value) or hasattr(value, "_fields"):
        written = {}
        for name, (key, _, rules) in _schema(cast("Any", type(value))).items():
            entry = plain(getattr(value, name))
            if entry is None or (isinstance(entry, float) and not math.isfinite(entry)):
                continue
            if Ordered in rules:
                only = rules[Ordered].value
                entry = [
                    {"name": n, **(row if isinstance(row, dict) else {only: row})}
                    for n, row in entry.items()
                ]
            written[key] = _divided(entry, rules[Key].factor) if Key in rules else entry
        return written
    if isinstance(value, Mapping):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value


def _divided(entry: Any, factor: float) -> Any:
    """Numbers of plain values in the unit of the file."""
    if isinstance(entry, dict):
        return {key: _divided(value, factor) for key, value in entry.items()}
    if isinstance(entry, list):
        return [_divided(value, factor) for value in entry]
    return entry if factor == 1.0 else entry / factor


def _reader(hint: Any, rules: Mapping[type, Any] = types.MappingProxyType({})) -> _Read:
    """Compile the reader of one annotation; rules of a list or table hold for its entries."""
    if get_origin(hint) is Annotated:
        inner, *metadata = get_args(hint)
        return _reader(inner, {**rules, **{type(rule): rule for rule in metadata}})
    if is_dataclass(hint) or hasattr(hint, "_fields"):
        return _table(hint)
    if hint is None or (get_origin(hint) or hint) not in _MAKERS:
        raise TypeError(f"no table holds {hint}")
    return _MAKERS[get_origin(hint) or hint](hint, rules)


def _of_numbers(rules: Mapping[type, Any]) -> dict[type, Any]:
    return {rule: rules[rule] for rule in (Bounds, Key) if rule in rules}


def _number(kind: Any, rules: Mapping[type, Any]) -> _Read:
    bounds, factor = rules.get(Bounds, Bounds()), rules.get(Key, Key("")).factor
    accepted: Any = int if kind is int else (int, float)
    rule = f"{'a whole' if kind is int else 'a'} number {bounds.rule}".rstrip()
    low, high, above = bounds.low, bounds.high, bounds.above
    rule = f"{'a whole' if kind is int else 'a'} number {bounds.rule}".rstrip()

    def read_number(value: Any) -> float:
        good = isinstance(value, accepted) and not isinstance(value, bool)
        if not good or not low <= value <= high or (above and value == low):
            raise _Broken(f" is {value!r:.40}; want {rule}")
        return kind(value) if factor == 1.0 else kind(value * factor)  # type: ignore[no-any-return]

    return read_number


def _anything(kind: Any, _: Mapping[type, Any]) -> _Read:
    def read_anything(value: Any) -> Any:
        if kind is bool and not isinstance(value, bool):
            raise _Broken(f" is {value!r:.40}; want true or false")
        return value

    return read_anything


def _text(_: Any, rules: Mapping[type, Any]) -> _Read:
    if Choice in rules:
        return _choice(Literal[rules[Choice].names], rules)
    length, pattern = rules.get(Length, Length()), rules.get(Pattern)
    expression = None if pattern is None else re.compile(pattern.expression, re.ASCII)
    most = f" of {length.low} to {length.high} characters" if Length in rules else ""
    rule = f"a text{most}" if pattern is None else pattern.rule

    def read_text(value: Any) -> Any:
        good = isinstance(value, str) and length.low <= len(value) <= length.high
        if not good or (expression is not None and not expression.fullmatch(value)):
            raise _Broken(f" is {value!r:.80}; want {rule}")
        return value

    return read_text


def _choice(hint: Any, _: Mapping[type, Any]) -> _Read:
    choices = get_args(hint)
    rule = " or ".join(filter(None, [", ".join(map(str, choices[:-1])), str(choices[-1])]))

    def read_choice(value: Any) -> Any:
        for choice in choices:
            if type(value) is type(choice) and value == choice:
                return choice
        raise _Broken(f" is {value!r:.40}; want {rule}")

    return read_choice


def _one_of(hint: Any, rules: Mapping[type, Any]) -> _Read:
    """Read by the first alternative that takes the value; the last one says what is wrong."""
    kinds = [kind for kind in get_args(hint) if kind is not types.NoneType]
    optional = len(kinds) < len(get_args(hint))
    *others, last = (_reader(kind, rules) for kind in kinds)

    def read_one_of(value: Any) -> Any:
        if value is None and optional:
            return None
        for reader in others:
            with suppress(_Broken):
                return reader(value)
        return last(value)

    return read_one_of


def _check_length(value: Any, length: Length | None, what: str) -> None:
    if length is not None and not length.low <= len(value) <= length.high:
        few = f"{length.low}" if length.low == length.high else f"{length.low} to {length.high}"
        raise _Broken(f" has {len(value)} {what}; want {few}")


def _tuple(hint: Any, rules: Mapping[type, Any]) -> _Read:
    inner = get_args(hint)
    endless = inner[-1] is Ellipsis
    readers = [_reader(hint, _of_numbers(rules)) for hint in inner if hint is not Ellipsis]
    length = rules.get(Length) if endless else Length(len(readers), len(readers))

    def read_tuple(value: Any) -> tuple[Any, ...]:
        if not isinstance(value, list | tuple):
            raise _Broken(f" is {value!r:.40}; want a list")
        _check_length(value, length, "entries")
        entries = []
        for k, entry in enumerate(value):
            try:
                entries.append(readers[0 if endless else k](entry))
            except _Broken as fault:
                raise fault.within(k) from None
        return tuple(entries)

    return read_tuple


def _array(_: Any, rules: Mapping[type, Any]) -> _Read:
    sizes: tuple[int | None, ...] | None = rules[Shape].sizes if Shape in rules else None
    bounds, factor = rules.get(Bounds, Bounds()), rules.get(Key, Key("")).factor
    shape = "" if sizes is None else " x ".join("n" if n is None else str(n) for n in sizes) + " "
    rule = f"{shape}numbers {bounds.rule}".rstrip()

    def read_array(value: Any) -> Any:
        entries = value.tolist() if isinstance(value, np.ndarray) else value
        try:
            flat = np.array(entries, dtype=object).ravel()  # lists remain in a ragged one
            good = set(map(type, flat)) <= {int, float}
            array = np.asarray(entries, dtype=np.float64)
        except (TypeError, ValueError, OverflowError, RecursionError):
            array, good = np.empty(0), False
        if sizes is not None and good:
            fits = zip(array.shape, sizes, strict=False)
            good = array.ndim == len(sizes) and all(size in (None, n) for n, size in fits)
        inside = (array >= bounds.low) & (array <= bounds.high)  # false for NaN
        if not good or not inside.all() or (bounds.above and (array == bounds.low).any()):
            raise _Broken(f" is {entries!r:.40}; want {rule}")
        return array * factor if factor != 1.0 else array

    return read_array


def _mapping(hint: Any, rules: Mapping[type, Any]) -> _Read:
    of_keys, of_values = get_args(hint)
    read_key, read_value = _reader(of_keys), _reader(of_values, _of_numbers(rules))
    only, length = rules.get(Ordered, Ordered()).value, rules.get(Length)

    def read_mapping(values: Any) -> dict[str, Any]:
        if isinstance(values, list | tuple):
            values = _by_name(values, only)
        if not isinstance(values, Mapping):
            raise _Broken(f" is {values!r:.40}; want a table")
        _check_length(values, length, "keys")
        entries = {}
        for key, value in values.items():
            try:
                entries[read_key(key)] = read_value(value)
            except _Broken as fault:
                raise fault.within(str(key)) from None
        return entries

    return read_mapping


def _by_name(rows: Any, only: str) -> dict[str, Any]:
    """Entries by name of a list of tables, each with its name."""
    by_name = {}
    for k, row in enumerate(rows):
        if not isinstance(row, Mapping) or not isinstance(row.get("name"), str):
            raise _Broken(f" is {row!r:.40}; want a table with a name").within(k)
        rest = {key: value for key, value in row.items() if key != "name"}
        if row["name"] in by_name:
            raise _Broken(f": {row['name']!r:.60} stands twice; keep one")
        by_name[row["name"]] = rest[only] if set(rest) == {only} else rest
    return by_name


@cache
def _schema(kind: type) -> dict[str, tuple[str, bool, dict[type, Any]]]:
    """Key in the file, whether it is needed, and the rules, by field."""
    hints = typing.get_type_hints(kind, include_extras=True)
    if is_dataclass(kind):
        made = [each for each in fields(kind) if each.init]
        needed = {f.name for f in made if f.default is MISSING and f.default_factory is MISSING}
        names = [field.name for field in made]
    else:
        names = list(kind._fields)  # type: ignore[attr-defined]  # a named tuple
        needed = set(names) - set(kind._field_defaults)  # type: ignore[attr-defined]
    schema = {}
    for name in names:
        hint = hints[name]
        metadata = get_args(hint)[1:] if get_origin(hint) is Annotated else ()
        rules = {type(rule): rule for rule in metadata}
        schema[name] = (rules[Key].name if Key in rules else name, name in needed, rules)
    return schema


@cache
def _table(kind: type) -> _Read:
    """Compile the reader of a table into a dataclass or named tuple."""
    hints = typing.get_type_hints(kind, include_extras=True)
    schema = _schema(kind)
    readers = {key: (name, _reader(hints[name])) for name, (key, _, _) in schema.items()}
    needed = [key for key, is_needed, _ in schema.values() if is_needed]
    short = getattr(kind, "SHORT", "")

    def read_table(values: Any) -> Any:
        if not isinstance(values, Mapping):
            if not short or isinstance(values, list | tuple):
                raise _Broken(f" is {values!r:.40}; want a table")
            values = {short: values}
        made = {}
        for key, value in values.items():
            if key not in readers:
                raise _Broken(f": {unknown('key', str(key), readers)}")
            name, reader = readers[key]
            try:
                made[name] = reader(value)
            except _Broken as fault:
                raise fault.within(key) from None
        if missing := [key for key in needed if key not in values]:
            raise _Broken(f": {missing[0]!r} is missing; add it")
        try:
            return kind(**made)
        except TruejointError as fault:
            raise _Broken(f": {fault}") from None

    return read_table


_MAKERS: Final[Mapping[Any, Callable[[Any, Mapping[type, Any]], _Read]]] = {
    float: _number, int: _number, str: _text, Literal: _choice, tuple: _tuple,
    np.ndarray: _array, Mapping: _mapping, Union: _one_of, types.UnionType: _one_of,
    bool: _anything, Any: _anything,
}  # fmt: skip
