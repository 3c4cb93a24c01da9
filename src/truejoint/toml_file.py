"""TOML files: tables of the package's own, and files of others, read within bounds."""

import tomllib
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

from truejoint.errors import TruejointError, words
from truejoint.files import read_small

MAX_BYTES: Final = 1 << 20


def read_toml(path: Path, error: type[TruejointError]) -> dict[str, Any]:
    """Table of a TOML file of at most 1 MiB; raises `error` naming the file and the fault."""
    data = read_small(path, error, MAX_BYTES, "the right file")
    try:
        return tomllib.loads(data.decode("utf-8"))
    except (ValueError, RecursionError) as fault:
        raise error(f"{path}: is not TOML ({words(fault, 120)})") from None


def read_differences(path: Path, error: type[TruejointError]) -> dict[str, Any]:
    """Table of a TOML file, laid over that of the file beside it that it is ``like``, if any."""
    values = read_toml(path, error)
    if "like" not in values:
        return values
    base = read_toml(path.parent / Path(str(values.pop("like"))).name, error)
    merged: dict[str, Any] = laid_over(base, values)
    return merged


def laid_over(base: Any, changes: Any) -> Any:
    """Give the changes of a value, a table with what they leave out."""
    if not (isinstance(base, Mapping) and isinstance(changes, Mapping)):
        return changes
    return {**base, **{key: laid_over(base.get(key), value) for key, value in changes.items()}}


@cache
def shipped_table(package: str, name: str) -> dict[str, Any]:
    """Table of a TOML file in a package, with tuples for lists; none of its readers changes it."""
    text = files(package).joinpath(name).read_text("utf-8")
    table: dict[str, Any] = with_tuples(tomllib.loads(text))
    return table


def with_tuples(value: Any) -> Any:
    """Values of TOML or JSON with tuples for lists."""
    if isinstance(value, dict):
        return {key: with_tuples(entry) for key, entry in value.items()}
    return tuple(map(with_tuples, value)) if isinstance(value, list) else value
