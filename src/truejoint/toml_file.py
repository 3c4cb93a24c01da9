"""TOML files of others, read within bounds."""

import tomllib
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
