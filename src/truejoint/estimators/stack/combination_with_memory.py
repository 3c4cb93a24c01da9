"""A combination of which a member remembers rows before."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from truejoint.estimators.stack import run as combination

FAMILY: Final = replace(
    combination.FAMILY, name="stack.combination_with_memory", remembers=True, counts_samples=True
)
