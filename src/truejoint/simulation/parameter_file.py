"""Parameter files: commented TOML in, checked frozen sections out."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Final, TypeVar, get_args, get_origin, get_type_hints

from truejoint.errors import TruejointError

MAX_FILE_SIZE: Final = 65_536
"""Largest parameter file that is read [bytes]; the shipped ones have about 10 000."""

Sections = Mapping[str, Mapping[str, Any]]
Section = TypeVar("Section")


@dataclass(frozen=True)
class Bounds:
    """Range [low, high] that a number, or each of `count` numbers in a list, must lie in."""

    low: float
    high: float
    count: int | None = None
    whole: bool = False


def read_sections(path: Path) -> Sections:
    """Sections of the TOML file at `path`.

    Raises
    ------
    TruejointError
        If the file cannot be read, is too large, is not TOML, or has a value outside a section.
    """
    try:
        with path.open("rb") as file:
            data = file.read(MAX_FILE_SIZE + 1)
    except OSError as error:
        raise TruejointError(f"{path}: cannot be read ({error.strerror})") from None
    if len(data) > MAX_FILE_SIZE:
        raise TruejointError(f"{path}: larger than {MAX_FILE_SIZE} bytes; not a parameter file")
    try:
        table = tomllib.loads(data.decode("utf-8"))
    except (UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError) as error:
        reason = " ".join(str(error).split())
        raise TruejointError(f"{path}: not a TOML file ({reason})") from None
    for name, values in table.items():
        if not isinstance(values, dict):
            raise TruejointError(
                f"{path}: {_shown(name)} stands outside a section; put it under [section]"
            )
    return table


def shipped_sections(name: str) -> Sections:
    """Sections of the TOML file `name` that comes with the package."""
    return tomllib.loads(resources.files(__package__).joinpath(name).read_text(encoding="utf-8"))


def overlay(base: Sections, changes: Sections, source: str) -> dict[str, dict[str, Any]]:
    """Put `changes` over `base`; raises TruejointError on a section that `base` does not have."""
    merged = {name: dict(values) for name, values in base.items()}
    for name, values in changes.items():
        if name not in merged:
            raise TruejointError(
                f"{source}: no section [{_shown(name)}]; known: {', '.join(merged)}"
            )
        merged[name].update(values)
    return merged


def build_section(
    kind: type[Section], name: str, values: Mapping[str, Any], source: str
) -> Section:
    """Make section `name` an instance of the dataclass `kind`, every value checked.

    The class annotates each attribute with its `Bounds`.

    Raises
    ------
    TruejointError
        For a key that is unknown or missing, or a value of the wrong kind or out of bounds.
    """
    hints = get_type_hints(kind, include_extras=True)
    known = {key: get_args(hint)[1] for key, hint in hints.items() if get_origin(hint) is Annotated}
    for key in values:
        if key not in known:
            raise TruejointError(
                f"{source}: no key {name}.{_shown(key)}; known in [{name}]: {', '.join(known)}"
            )
    for key in known:
        if key not in values:
            raise TruejointError(f"{source}: {name}.{key} is missing; add it to [{name}]")
    checked = {
        key: _checked(values[key], bounds, f"{source}: {name}.{key}")
        for key, bounds in known.items()
    }
    return kind(**checked)


def _shown(key: str) -> str:
    """Key as it stands in the file, or quoted and cut where it would not fit in one line."""
    return key if key.isidentifier() and len(key) <= 60 else f"{key!r:.60}"


def _checked(value: Any, bounds: Bounds | None, where: str) -> bool | float | tuple[float, ...]:
    if bounds is None:
        if not isinstance(value, bool):
            raise TruejointError(f"{where} must be true or false, not {value!r:.80}")
        return value
    if bounds.count is None:
        return _number(value, bounds, where)
    if not isinstance(value, list | tuple) or len(value) != bounds.count:
        raise TruejointError(f"{where} must be a list of {bounds.count} numbers, not {value!r:.80}")
    return tuple(_number(one, bounds, f"{where}[{i}]") for i, one in enumerate(value))


def _number(value: Any, bounds: Bounds, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TruejointError(f"{where} must be a number, not {value!r:.80}")
    if not bounds.low <= value <= bounds.high:  # also false for NaN
        raise TruejointError(
            f"{where} is {value!r:.40}; it must lie in [{bounds.low:g}, {bounds.high:g}] (SI units)"
        )
    if bounds.whole:
        if value != int(value):
            raise TruejointError(f"{where} is {value!r:.40}; it must be a whole number")
        return int(value)
    return float(value)
