"""Names that a shell completes: a zig-zag's directions, a random motion's profiles; no imports."""

from __future__ import annotations

from typing import Final

DIRECTIONS: Final = ("J1", "J2", "J3", "J1-J2", "J2-J3", "J1-J3", "J1-J2-J3")
"""Joints that move along the strokes of a zig-zag; J1 to J3 are the positioning joints."""

PROFILES: Final = ("cosine", "laboratory")
"""How the speed of a random motion goes along a swing; see `random_motion`."""
