"""Names of what the judge can find in a recording; `findings.toml` says what each means."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from importlib.resources import files
from typing import Final

_TABLE: Final = tomllib.loads((files(__package__) / "findings.toml").read_text("utf-8"))
_ROWS: Final = {name: row for names in _TABLE.values() for name, row in names.items()}

HEADINGS: Final = tuple(_TABLE)
"""Headings in the order in which a person reads them."""

FINDINGS: Final[Mapping[str, str]] = {name: _ROWS[name][0] for name in sorted(_ROWS)}
"""Meaning of each name; ``--accept`` takes the names."""

ADVICE: Final[Mapping[str, str]] = {
    name: row[1] for name, row in _ROWS.items() if row[1:] and row[1]
}
"""What to do about a finding, by the names of which that is always the same."""

HEADING_OF: Final[Mapping[str, str]] = {n: heading for heading in _TABLE for n in _TABLE[heading]}
"""Heading of each name."""

WELL: Final[Mapping[str, str]] = {name: row[2] for name, row in _ROWS.items() if len(row) > 2}
"""What is said where nothing under a heading is wrong, by one name of each."""
