"""One reader of tables: plain values of TOML or JSON in, checked frozen values out.

A dataclass or named tuple is the schema: its annotations say what each key holds. A field may be a
`float`, `int`, `bool`, `str`, `Literal`, `tuple`, `Mapping` with text keys, `Array`, another
dataclass, a union of these, or any of them `Annotated` with a rule of this module. A field with a
default may be missing.
"""

import inspect
import math
import re
import types
import typing
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, is_dataclass
from functools import cache, partial
from typing import Annotated, Any, Final, Literal, NamedTuple, Self, TypeVar, cast, get_args

import numpy as np

from truejoint.errors import TruejointError, unknown

_Value = TypeVar("_Value")
_Read = Callable[[Any], Any]
_Rules = Mapping[type, Any]
_NUMBER: Final = 1.7e308


@dataclass(frozen=True)
class Bounds:
    """Range of a number, or of each number of a list; NaN and infinity are in none.

    `above` says that the number must be larger than `low`.
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

    def within(self, key: str | int) -> Self:
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

    The annotations of `kind` are the schema. If it has a class attribute ``SHORT``, a value that is
    no table stands for a table with this one key. `values` are plain, as TOML or JSON give them.

    Raises `error` if a key is unknown or missing, or a value breaks its rule: the message begins
    with `source` and has the path to the value, the value and the rule. What the constructor raises
    is raised alike.
    """
    try:
        return cast("_Value", _reader(kind)(values))
    except _Broken as fault:
        path = f": {fault.path}" if fault.path else ""
        raise error(f"{source}{path}{fault}") from None


def plain(value: Any) -> Any:
    """Plain values for JSON or TOML, of which `read` makes the value again.

    Fields that are None, NaN or infinite are left out.
    """
    if is_dataclass(value) or hasattr(value, "_fields"):
        written = {}
        for key, (name, rules, _) in _schema(cast("Any", type(value))).items():
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


_compiled = cache(partial(re.compile, flags=re.ASCII))
_hints = cache(partial(typing.get_type_hints, include_extras=True))


def _reader(hint: Any, outer: _Rules | None = None) -> _Read:
    """Make the reader of an annotation; `outer` rules are those of what it stands in."""
    inner, *metadata = get_args(hint) if typing.get_origin(hint) is Annotated else (hint,)
    rules = {**(outer or {}), **{type(rule): rule for rule in metadata}}
    kind, entries = typing.get_origin(inner) or inner, get_args(inner)
    if is_dataclass(inner) or hasattr(inner, "_fields"):
        return _table(inner)
    if inner in (float, int):
        return _number(inner, rules)
    if inner is None or kind not in _READERS:
        raise TypeError(f"no table holds {inner}")
    if kind in (tuple, Mapping):
        of_numbers: _Rules = {rule: rules[rule] for rule in (Bounds, Key) if rule in rules}
        entries = tuple(e if e is Ellipsis else _reader(e, of_numbers) for e in entries)
    elif kind in (typing.Union, types.UnionType):
        entries = tuple(e if e is types.NoneType else _reader(e, rules) for e in entries)
    return partial(_READERS[kind], kind if kind is bool else entries, rules)


def _number(kind: Any, rules: _Rules) -> _Read:
    """Make the reader of a number: of many, so that it looks its rules up once."""
    bounds, factor = rules.get(Bounds, Bounds()), rules.get(Key, Key("")).factor
    low, high, above = bounds.low, bounds.high, bounds.above
    accepted: Any = int if kind is int else (int, float)
    rule = f"{'a whole' if kind is int else 'a'} number {bounds.rule}".rstrip()

    def read_number(value: Any) -> Any:
        good = isinstance(value, accepted) and not isinstance(value, bool)
        if not good or not low <= value <= high or (above and value == low):
            raise _Broken(f" is {value!r:.40}; want {rule}")
        return kind(value) if factor == 1.0 else kind(value * factor)

    return read_number


def _read_any(kind: Any, _: _Rules, value: Any) -> Any:
    if kind is bool and not isinstance(value, bool):
        raise _Broken(f" is {value!r:.40}; want true or false")
    return value


def _read_text(_: Any, rules: _Rules, value: Any) -> Any:
    if Choice in rules:
        return _read_choice(rules[Choice].names, rules, value)
    length, pattern = rules.get(Length, _ANY_LENGTH), rules.get(Pattern)
    good = isinstance(value, str) and length.low <= len(value) <= length.high
    if not good or (pattern and not _compiled(pattern.expression).fullmatch(value)):
        most = f" of {length.low} to {length.high} characters" if Length in rules else ""
        raise _Broken(f" is {value!r:.80}; want {pattern.rule if pattern else f'a text{most}'}")
    return value


def _read_choice(choices: tuple[Any, ...], _: _Rules, value: Any) -> Any:
    for choice in choices:
        if type(value) is type(choice) and value == choice:
            return choice
    rule = " or ".join(filter(None, [", ".join(map(str, choices[:-1])), str(choices[-1])]))
    raise _Broken(f" is {value!r:.40}; want {rule}")


def _read_one_of(kinds: tuple[Any, ...], _: _Rules, value: Any) -> Any:
    """Read by the first alternative that takes the value; the last one says what is wrong."""
    *others, last = (reader for reader in kinds if reader is not types.NoneType)
    if value is None and types.NoneType in kinds:
        return None
    for reader in others:
        with suppress(_Broken):
            return reader(value)
    return last(value)


def _check_length(value: Any, length: Length | None, what: str) -> None:
    if length is not None and not length.low <= len(value) <= length.high:
        few = f"{length.low}" if length.low == length.high else f"{length.low} to {length.high}"
        raise _Broken(f" has {len(value)} {what}; want {few}")


def _read_entries(entries: Iterable[tuple[int | str, _Read, Any]]) -> Iterator[Any]:
    """Entries of a list or table by key, reader and value; a fault in one names its key."""
    for key, reader, value in entries:
        try:
            yield reader(value)
        except _Broken as fault:
            raise fault.within(key) from None


def _read_tuple(readers: tuple[Any, ...], rules: _Rules, value: Any) -> tuple[Any, ...]:
    length = rules.get(Length)
    if not isinstance(value, list | tuple):
        raise _Broken(f" is {value!r:.40}; want a list")
    if readers[-1] is Ellipsis:
        readers = readers[:1] * len(value)
    else:
        length = Length(len(readers), len(readers))
    _check_length(value, length, "entries")
    return tuple(_read_entries(zip(range(len(value)), readers, value, strict=True)))


def _read_array(_: Any, rules: _Rules, value: Any) -> Any:
    sizes: tuple[int | None, ...] | None = rules[Shape].sizes if Shape in rules else None
    bounds, factor = rules.get(Bounds, _FINITE), rules.get(Key, _SAME).factor
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
        shape = " x ".join("n" if n is None else str(n) for n in sizes or ())
        raise _Broken(f" is {entries!r:.40}; want {f'{shape} numbers {bounds.rule}'.strip()}")
    return array * factor if factor != 1.0 else array


def _read_mapping(readers: tuple[Any, ...], rules: _Rules, values: Any) -> dict[str, Any]:
    read_key, read_value = readers
    if isinstance(values, list | tuple):
        values = _by_name(values, rules.get(Ordered, Ordered()).value)
    if not isinstance(values, Mapping):
        raise _Broken(f" is {values!r:.40}; want a table")
    _check_length(values, rules.get(Length), "keys")
    keys = _read_entries((str(key), read_key, key) for key in values)
    entries = _read_entries((str(key), read_value, value) for key, value in values.items())
    return dict(zip(keys, entries, strict=True))


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
def _schema(kind: type) -> dict[str, tuple[str, dict[type, Any], bool]]:
    """Field, its rules, and whether it is needed, by the key in the file."""
    schema = {}
    for name, parameter in inspect.signature(kind).parameters.items():
        rules = {type(rule): rule for rule in get_args(_hints(kind)[name])[1:]}
        key = rules[Key].name if Key in rules else name
        schema[key] = name, rules, parameter.default is parameter.empty
    return schema


@cache
def _table(kind: type) -> _Read:
    """Make the reader of a table into a dataclass or named tuple."""
    schema, short = _schema(kind), getattr(kind, "SHORT", "")
    readers = {key: _reader(_hints(kind)[name]) for key, (name, *_) in schema.items()}

    def read_table(values: Any) -> Any:
        if not isinstance(values, Mapping):
            if not short or isinstance(values, list | tuple):
                raise _Broken(f" is {values!r:.40}; want a table")
            values = {short: values}
        for key in values:
            if key not in readers:
                raise _Broken(f": {unknown('key', str(key), readers)}")
        made = [*_read_entries((key, readers[key], value) for key, value in values.items())]
        for key, (_, _, is_needed) in schema.items():
            if is_needed and key not in values:
                raise _Broken(f": {key!r} is missing; add it")
        try:
            return kind(**{schema[key][0]: entry for key, entry in zip(values, made, strict=True)})
        except TruejointError as fault:
            raise _Broken(f": {fault}") from None

    return read_table


_FINITE, _SAME, _ANY_LENGTH = Bounds(), Key(""), Length()
_READERS: Final[Mapping[Any, Callable[[Any, _Rules, Any], Any]]] = {
    str: _read_text, Literal: _read_choice,
    tuple: _read_tuple, np.ndarray: _read_array, Mapping: _read_mapping, typing.Union: _read_one_of,
    types.UnionType: _read_one_of, bool: _read_any, Any: _read_any,
}  # fmt: skip
