"""Files of public data sets, whose layouts are rows of `layouts.toml`."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Final

from truejoint import schema
from truejoint.errors import RecordingError
from truejoint.recordings.bounded_file import Head
from truejoint.recordings.read.column_map import ColumnMap
from truejoint.recordings.read.mapped import array_names, read_table
from truejoint.recordings.read.numeric_text import split_fields
from truejoint.recordings.table.recording import Recording, recordings_of_file

_FILE: Final = "layouts.toml"


@dataclass(frozen=True)
class Layout:
    """Layout of a public file; `layouts.toml` says what each field means."""

    columns: Annotated[ColumnMap, schema.Key("map")]
    fields: int = 0
    mark: str = ""
    mark_at: int = -1
    nominal_rate: Annotated[float, schema.Key("nominal_hz")] = math.nan
    session: str = ""
    homing_id: str = ""
    folder: bool = False
    notes: str = ""

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of the files in a folder of this layout."""
        return tuple(f"{name}.npy" for name in array_names(self.columns)) if self.folder else ()

    def is_marked(self, head: bytes) -> bool:
        """Whether a file that begins with `head` has the mark, a text in its first comment."""
        at = head.find(self.mark.encode())
        begins = not self.fields or head.startswith(self.columns.comment.encode())
        return bool(self.mark) and at >= 0 and self.mark_at in (-1, at) and begins


@cache
def layouts() -> Mapping[str, tuple[Layout, ...]]:
    """Layouts of each format by its name."""
    text = (files(__package__) / _FILE).read_text("utf-8")
    return {
        name: tuple(schema.read(Layout, row, f"{_FILE}: {name}", RecordingError) for row in rows)
        for name, rows in tomllib.loads(text).items()
    }


def detect_marked(head: bytes) -> str:
    """Name of the format whose mark a file has; empty if it has none."""
    return next((n for n, rows in layouts().items() if any(r.is_marked(head) for r in rows)), "")


def detect_fields(count: int) -> str:
    """Name of the format whose lines have so many numbers and no mark; empty if there is none."""
    unmarked = {name: rows for name, rows in layouts().items() if not any(r.mark for r in rows)}
    return next((n for n, rows in unmarked.items() if count in [r.fields for r in rows]), "")


def known_counts() -> list[int]:
    """Numbers in a line of each layout of text that has no mark."""
    return [
        row.fields for rows in layouts().values() for row in rows if row.fields and not row.mark
    ]


def folder_format(path: Path) -> str:
    """Name of the format of which a folder holds all parts; empty if there is none."""
    for name, rows in layouts().items():
        if any(row.parts and all((path / part).is_file() for part in row.parts) for row in rows):
            return name
    return ""


def read(path: Path, layout: str, head: Head | None = None) -> list[Recording]:
    """Read a file, or a folder, of the format called `layout`; text may be in gzip."""
    row = _layout_of(path, layouts()[layout], head)
    table = read_table(path, row.columns, head, folder=row.folder)
    place = {"name": path.name.partition(".")[0], "folder": path.resolve().parent.name}
    facts = {"session": row.session, "homing_id": row.homing_id}
    return recordings_of_file(
        path,
        table.robot,
        table.columns,
        table.units,
        rate=None if math.isnan(row.nominal_rate) else row.nominal_rate,
        sha256=table.sha256,
        dropped=table.dropped,
        notes=row.notes,
        **{key: text.format(**place) for key, text in facts.items() if text},
    )


def _layout_of(path: Path, rows: Sequence[Layout], head: Head | None) -> Layout:
    """Layout of a file among those of its format."""
    first = rows[0]
    if first.folder and not path.is_dir():
        parts = ", ".join(first.parts)
        raise RecordingError(f"{path}: is not a folder; name the folder that holds {parts}")
    if not first.fields:
        return first
    line = (head or Head.of(path)).first_line(first.columns.comment)[1]
    count = len(split_fields(line, first.columns.delimiter))
    for row in rows:
        if row.fields == count:
            return row
    expected = " or ".join(str(row.fields) for row in rows)
    raise RecordingError(f"{path}: {count} columns, expected {expected}; is it such a file?")
