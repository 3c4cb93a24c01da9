"""Plain values of which a robot is described, as they stand in files: read and checked."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from truejoint.array_types import Array
from truejoint.errors import RobotError

MAX_JOINTS: Final = 64
_LARGEST: Final = 1e9
_NAME: Final = re.compile(r"\w{1,60}", re.ASCII)


def check_keys(
    values: Mapping[str, Any], known: Sequence[str], needed: Sequence[str], where: str
) -> None:
    """Refuse, with RobotError, a key that is none of the `known`, or one that is missing."""
    for key in values:
        if key not in known:
            raise RobotError(f"{where}: key {key!r:.60} is not known; use {', '.join(known)}")
    for key in needed:
        if key not in values:
            raise RobotError(f"{where}: {key!r} is missing; add it")


def check_once(names: Sequence[str], where: str) -> None:
    """Refuse, with RobotError, a name that stands twice."""
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise RobotError(f"{where}: {twice[0]!r} stands twice; keep one")


def tables(values: Any, where: str) -> Sequence[Mapping[str, Any]]:
    """Read 1 to `MAX_JOINTS` tables; raises RobotError."""
    good = isinstance(values, list | tuple) and all(isinstance(row, Mapping) for row in values)
    if not good or not 0 < len(values) <= MAX_JOINTS:
        raise RobotError(f"{where} are {values!r:.40}; want 1 to {MAX_JOINTS} tables")
    return list(values)


def name_of(value: Any, where: str) -> str:
    """Read a name of letters, digits and _; raises RobotError."""
    if not isinstance(value, str) or not _NAME.fullmatch(value):
        raise RobotError(f"{where} is {value!r:.80}; want up to 60 letters, digits and _")
    return value


def names_of(values: Any, where: str) -> tuple[str, ...]:
    """Read at most `MAX_JOINTS` names; raises RobotError."""
    if not isinstance(values, list | tuple) or len(values) > MAX_JOINTS:
        raise RobotError(f"{where} is {values!r:.40}; want a list of at most {MAX_JOINTS} names")
    return tuple(name_of(value, where) for value in values)


def number(value: Any, where: str) -> float:
    """Read a number that is not absurdly large; raises RobotError."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise RobotError(f"{where} is {value!r:.40}; want a number")
    if not -_LARGEST <= value <= _LARGEST:
        raise RobotError(
            f"{where} is beyond {_LARGEST:g} in size; leave it out where there is none"
        )
    return float(value)


def matrix_of(values: Any, where: str) -> Array:
    """Read rows of the same length; raises RobotError."""
    rows = values if isinstance(values, list | tuple) else [values]
    if not all(isinstance(row, list | tuple) and len(row) == len(rows[0]) for row in rows):
        raise RobotError(f"{where} is {values!r:.40}; want a list of rows of the same length")
    return np.array([[number(value, where) for value in row] for row in rows], dtype=np.float64)
