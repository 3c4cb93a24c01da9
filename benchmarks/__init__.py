"""Measurements of speed, the loop and faults; see docs/results.md. Nothing passes or fails."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any


def stored(out: Path, title: str, make: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """Give what `make` gives, from its file in a folder where there is one."""
    path = out / f"{title.replace(', ', '-').replace(' ', '_')}.json"
    if not path.exists():
        out.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(make()))
    found: dict[str, Any] = json.loads(path.read_text())
    return found
