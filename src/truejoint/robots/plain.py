"""Checks of tables that describe robots."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from truejoint.errors import RobotError


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
