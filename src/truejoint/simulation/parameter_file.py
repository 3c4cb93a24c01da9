"""Parameter files: commented TOML in, checked frozen sections out."""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, ClassVar, NamedTuple, Self, get_args, get_origin, get_type_hints

import numpy as np

from truejoint.errors import TruejointError, other_kind, unknown
from truejoint.toml_file import read_toml

Sections = Mapping[str, Mapping[str, Any]]


@dataclass(frozen=True)
class Bounds:
    """Range [low, high] that a number, or each of `count` numbers in a list, must lie in."""

    low: float
    high: float
    count: int | None = None
    whole: bool = False


@dataclass(frozen=True)
class Choice:
    """Names that a text must be one of."""

    names: tuple[str, ...]


class Spread(NamedTuple):
    """Range [low, high] of one property; drawn evenly, or evenly in its logarithm."""

    low: float
    high: float
    scale: str

    def draw(self, rng: np.random.Generator) -> float:
        """One value."""
        if self.scale == "log":
            return float(np.exp(rng.uniform(math.log(self.low), math.log(self.high))))
        return float(rng.uniform(self.low, self.high))


def shipped_sections(name: str) -> Sections:
    """Sections of the TOML file `name` that comes with the package."""
    return tomllib.loads(resources.files(__package__).joinpath(name).read_text(encoding="utf-8"))


def shipped_spreads(name: str) -> dict[str, Spread]:
    """Ranges of the TOML file `name` that comes with the package, in the order of the draws."""
    return {key: Spread(**values) for key, values in shipped_sections(name).items()}


@dataclass(frozen=True)
class Parameters:
    """What a twin is made of, in SI units; one value of named fields per section of its TOML file.

    The comments of the shipped files give the meaning, unit and source of every number.

    Raises
    ------
    TruejointError
        From `read` and `with_values`: if the file cannot be read, a section or key is
        unknown, a value is of the wrong kind or out of bounds, or the plant cannot be simulated.
    """

    SPECIMENS: ClassVar[Mapping[str, str]]
    """Shipped file of every named specimen; all others are laid over ``"nominal"``."""

    BOUNDS: ClassVar[Mapping[str, type]] = {}
    """Dataclass that states the bounds of a section, where its own type does not."""

    @classmethod
    def read(cls, path: str | Path = "nominal") -> Self:
        """Parameters of a specimen in `SPECIMENS`, or of the TOML file at `path`.

        A file states only what differs from the nominal specimen.
        """
        if not isinstance(path, str | Path):
            advice = f"name a specimen, one of {', '.join(cls.SPECIMENS)}, or a TOML file"
            raise TruejointError(other_kind(path, "path", advice))
        nominal = shipped_sections(cls.SPECIMENS["nominal"])
        if str(path) in cls.SPECIMENS:
            return cls._laid_over(nominal, shipped_sections(cls.SPECIMENS[str(path)]), str(path))
        if not (Path(path).suffix or Path(path).exists()):
            known = unknown("specimen", str(path), cls.SPECIMENS)
            raise TruejointError(f"{known}; or give a TOML file")
        table = read_toml(Path(path), TruejointError)
        for name, values in table.items():
            if not isinstance(values, dict):
                raise TruejointError(
                    f"{path}: {_shown(name)} stands outside a section; put it under [section]"
                )
        return cls._laid_over(nominal, table, str(path))

    @classmethod
    def from_dict(cls, values: Sections) -> Self:
        """Inverse of `to_dict`; raises TruejointError as `read` does."""
        return cls._laid_over(shipped_sections(cls.SPECIMENS["nominal"]), values, "from_dict")

    def with_values(self, changes: Mapping[str, Any]) -> Self:
        """Copy with some values changed, by dotted name: ``{"jaw.load_arm": 9e-3}``."""
        nested: dict[str, dict[str, Any]] = {}
        for name, value in changes.items():
            section, _, key = name.partition(".")
            nested.setdefault(section, {})[key] = value
        return self._laid_over(self.to_dict(), nested, "with_values")

    def to_dict(self) -> dict[str, dict[str, Any]]:
        """Plain nested values, as in the file."""
        return {
            name: section._asdict() if hasattr(section, "_asdict") else asdict(section)
            for name, section in vars(self).items()
        }

    def to_toml(self) -> str:
        """Text that `read` turns into these parameters again, without the comments."""
        return "".join(
            f"[{section}]\n" + "".join(f"{k} = {json.dumps(v)}\n" for k, v in values.items())
            for section, values in self.to_dict().items()
        )

    def check(self, source: str) -> None:
        """Raise TruejointError, naming the `source`, if the whole cannot be simulated."""

    @classmethod
    def _laid_over(cls, base: Sections, changes: Sections, source: str) -> Self:
        merged = {name: dict(values) for name, values in base.items()}
        for name, values in changes.items():
            if name not in merged:
                raise TruejointError(
                    f"{source}: no section [{_shown(name)}]; known: {', '.join(merged)}"
                )
            merged[name].update(values)
        kinds = _types_of(cls)  # type: ignore[arg-type]  # mypy: type[Self] is hashable
        sections = {}
        for name in (field.name for field in fields(cls)):
            bounds = cls.BOUNDS.get(name, kinds[name])
            sections[name] = kinds[name](**_checked_section(bounds, name, merged[name], source))
        parameters = cls(**sections)
        parameters.check(source)
        return parameters


@cache  # resolving annotations is most of what drawing a population takes
def _types_of(cls: type) -> dict[str, Any]:
    """Types of the fields of a class, with their bounds."""
    return get_type_hints(cls, include_extras=True)


def _checked_section(
    kind: type, name: str, values: Mapping[str, Any], source: str
) -> dict[str, Any]:
    """Values of section `name`, each within the `Bounds` that `kind` annotates it with."""
    hints = _types_of(kind)
    known = {key: get_args(hint)[1] for key, hint in hints.items() if get_origin(hint) is Annotated}
    if unknown := [key for key in values if key not in known]:
        raise TruejointError(
            f"{source}: no key {name}.{_shown(unknown[0])}; known in [{name}]: {', '.join(known)}"
        )
    if missing := [key for key in known if key not in values]:
        raise TruejointError(f"{source}: {name}.{missing[0]} is missing; add it to [{name}]")
    return {
        key: _checked(values[key], bounds, f"{source}: {name}.{key}")
        for key, bounds in known.items()
    }


def _shown(key: str) -> str:
    """Key as it stands in the file, or quoted and cut where it would not fit in one line."""
    return key if key.isidentifier() and len(key) <= 60 else f"{key!r:.60}"


def _checked(
    value: Any, bounds: Bounds | Choice | None, where: str
) -> bool | str | float | tuple[float, ...]:
    if isinstance(bounds, Choice):
        if value not in bounds.names:
            known = ", ".join(bounds.names)
            raise TruejointError(f"{where} is {value!r:.80}; choose one of {known}")
        return str(value)
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
