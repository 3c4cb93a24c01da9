"""Parameter files: commented TOML in, checked frozen sections out."""

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, ClassVar, Final, NamedTuple, Self

import numpy as np

from truejoint import schema
from truejoint.errors import TruejointError, other_kind, unknown
from truejoint.toml_file import laid_over, read_toml, shipped_table

Sections = Mapping[str, Mapping[str, Any]]
MAX_POPULATION: Final = 100_000


def random_streams(count: int, seed: int) -> list[np.random.Generator]:
    """Give the generator of each specimen of a population; TruejointError unless 1 to 100000.

    The same seed gives the same ones, and a larger population begins with the smaller one.
    """
    if not 1 <= count <= MAX_POPULATION:
        raise TruejointError(f"a population of {count}; it must be 1 to {MAX_POPULATION}")
    return [np.random.default_rng(stream) for stream in np.random.SeedSequence(seed).spawn(count)]


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


@cache
def shipped_spreads(name: str) -> dict[str, Spread]:
    """Ranges of the TOML file `name` that comes with the package, in the order of the draws."""
    return {key: Spread(**values) for key, values in shipped_table(__package__, name).items()}


@dataclass(frozen=True)
class Parameters:
    """Parameters of a twin in SI units: a value of named fields for each section of its TOML file.

    The comments of the shipped files give the meaning, unit and source of every number.

    Raises TruejointError, from `read` and `with_values`, if the file cannot be read, a section or
    key is unknown, a value is of the wrong kind or out of bounds, or the plant cannot be simulated.
    """

    SPECIMENS: ClassVar[tuple[str, ...]]
    """Named specimens, each a file beside the class; all others are laid over ``"nominal"``."""

    @classmethod
    def read(cls, path: str | Path = "nominal") -> Self:
        """Parameters of a specimen in `SPECIMENS`, or of the TOML file at `path`.

        A file states only what differs from the nominal specimen.
        """
        if not isinstance(path, str | Path):
            advice = f"name a specimen, one of {', '.join(cls.SPECIMENS)}, or a TOML file"
            raise TruejointError(other_kind(path, "path", advice))
        nominal, name = cls._shipped("nominal"), str(path)
        if name in cls.SPECIMENS:
            return cls._laid_over(nominal, cls._shipped(name), name)
        if not (Path(path).suffix or os.path.exists(path)):  # noqa: PTH110  # of any length
            refusal = unknown("specimen", name, cls.SPECIMENS)
            raise TruejointError(f"{refusal}; or give a TOML file")
        return cls._laid_over(nominal, read_toml(Path(path), TruejointError), name)

    @classmethod
    def _shipped(cls, name: str) -> Sections:
        return shipped_table(cls.__module__.rpartition(".")[0], f"{name.lower()}.toml")

    @classmethod
    def from_dict(cls, values: Sections) -> Self:
        """Inverse of `to_dict`; raises TruejointError as `read` does."""
        return cls._laid_over(cls._shipped("nominal"), values, "from_dict")

    def with_values(self, changes: Mapping[str, Any]) -> Self:
        """Copy with some values changed, by dotted name: ``{"jaw.load_arm": 9e-3}``."""
        nested: dict[str, dict[str, Any]] = {}
        for name, value in changes.items():
            section, _, key = name.partition(".")
            nested.setdefault(section, {})[key] = value
        return self._laid_over(self.to_dict(), nested, "with_values")

    def to_dict(self) -> dict[str, dict[str, Any]]:
        """Plain nested values, as in the file."""
        return {name: section._asdict() for name, section in vars(self).items()}

    def check(self, source: str) -> None:
        """Raise TruejointError, naming the `source`, if the whole cannot be simulated."""

    @classmethod
    def _laid_over(cls, base: Sections, changes: Sections, source: str) -> Self:
        for name, values in changes.items():
            if not isinstance(values, Mapping):
                raise TruejointError(
                    f"{source}: {name!r:.60} stands outside a section; put it under [section]"
                )
        parameters = schema.read(cls, laid_over(base, changes), source)
        parameters.check(source)
        return parameters
