"""Tables of numbers in text files, read in pieces and within bounds."""

import io
import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import pyarrow as pa
from pyarrow import csv

from truejoint.array_types import Array
from truejoint.errors import RecordingError
from truejoint.recordings.bounded_file import (
    MAX_LINE_BYTES,
    MAX_VALUES,
    BoundedFile,
    Head,
    require_file,
)

_PIECE_BYTES: Final = 1 << 22
_MISSING: Final = frozenset(csv.ConvertOptions().null_values)


@dataclass(frozen=True)
class TextLayout:
    """How the numbers stand in a text file."""

    columns: int  # numbers that a line must have
    delimiter: str = ","  # comma, semicolon or tab; a blank means any white space
    comment: str = ""  # one character; what follows it in a line is passed over
    skip: int = 0  # lines to pass over at the start, the header among them


class NumericTable(NamedTuple):
    """Some columns of a text file."""

    values: Array  # (n, k); NaN where a field is empty or ``nan``
    sha256: str  # of the whole (unpacked) file
    incomplete: int  # lines at the end that were cut short and left out: 0 or 1


def read_numbers(path: Path, layout: TextLayout, use: Sequence[int]) -> NumericTable:
    """Columns `use` of a text file of numbers, or of one in gzip; any of these may be empty.

    A last line without an end and with too few numbers is what an interrupted recorder leaves: it
    is left out and counted. A RecordingError names line, column and text of any of these that is no
    number, a line with too many or too few fields, or says that the file holds too much.
    """
    wanted = sorted({*use})
    pieces: list[Array] = []
    room = most = MAX_VALUES // len(wanted)
    incomplete = 0
    raw = BoundedFile(require_file(path), lines=True)
    with raw, io.BufferedReader(raw, _PIECE_BYTES) as file:
        for piece in _pieces(file, layout):
            values = None if piece.is_open else _parse(piece, layout, wanted)
            if values is None:
                values, incomplete = _parse_by_line(path, piece, layout, wanted, room < most)
            room -= len(values)
            if room < 0:
                raise RecordingError(
                    f"{path}: more than {most} rows of {len(wanted)} columns, the most that is "
                    "read; cut the recording into parts"
                )
            pieces.append(values)
        digest = raw.sha256()
    if room == most:
        raise RecordingError(f"{path}: holds no rows of numbers")
    values = np.concatenate(pieces)
    return NumericTable(values[:, [wanted.index(c) for c in use]], digest, incomplete)


def split_fields(line: str, delimiter: str) -> list[str]:
    """Fields of a line, stripped and without quotes; the delimiter blank is any white space."""
    apart = re.sub('"[^"]*"', lambda text: text[0].replace(delimiter, "\0"), line)
    fields = apart.split(None if delimiter == " " else delimiter)
    return [field.strip().strip('"').replace("\0", delimiter) for field in fields]


def text_layout(
    head: Head, comment: str = "#", delimiter: str = ""
) -> tuple[TextLayout, list[str], bool]:
    """Tell how the numbers of a text stand, the fields of its first line, and whether they name.

    Raises RecordingError if there is no line, or the file is no text.
    """
    number, line = head.first_line(comment)
    delimiter = delimiter or next((d for d in "\t;," if d in line), " ")
    fields = split_fields(line, delimiter)
    named = not all(map(is_number, fields))
    return TextLayout(len(fields), delimiter, comment, number if named else 0), fields, named


def is_number(text: str) -> bool:
    """Whether a field reads as a number."""
    try:
        float(text)
    except ValueError:
        return False
    return "_" not in text  # which Python, not a measurement, puts into numbers


class _Piece(NamedTuple):
    """Whole lines of a file, or its last one: the first is line `number`, `skip` are no rows."""

    text: bytes
    number: int
    skip: int
    is_open: bool  # a last line without an end, which may be cut short


def _pieces(file: "io.BufferedReader[BoundedFile]", layout: TextLayout) -> Iterator[_Piece]:
    comment = layout.comment.encode()
    note = re.compile(re.escape(comment) + rb"[^\r\n]*")
    number, skip = 1, layout.skip
    while text := file.read(_PIECE_BYTES) + file.readline():
        if comment and comment in text:
            text = note.sub(b"", text)
        if layout.delimiter == " ":
            parts = re.split(rb"\r\n|\r|\n", text)
            text = b"\n".join(b" ".join(line.split()) for line in parts)
        end = max(text.rfind(b"\n"), text.rfind(b"\r")) + 1
        for part, is_open in ((text[:end], False), (text[end:], True)):
            yield _Piece(part, number, skip, is_open)
            lines = part.count(b"\n") or part.count(b"\r")
            number, skip = number + lines, max(0, skip - lines)


def _parse(piece: _Piece, layout: TextLayout, wanted: Sequence[int]) -> Array | None:
    """Columns `wanted` of a piece; None where it does not fit."""
    names = [str(column) for column in range(layout.columns)]
    use = [names[column] for column in wanted]
    how = {"use_threads": False, "skip_rows": piece.skip, "block_size": 2 * MAX_LINE_BYTES}
    with suppress(pa.ArrowInvalid):
        table = csv.read_csv(
            pa.BufferReader(piece.text),
            csv.ReadOptions(column_names=names, **how),
            csv.ParseOptions(delimiter=layout.delimiter, quote_char=False),
            csv.ConvertOptions(include_columns=use, column_types=dict.fromkeys(use, pa.float64())),
        )
        return np.column_stack([table[name].to_numpy() for name in use])
    return None


def _parse_by_line(
    path: Path, piece: _Piece, layout: TextLayout, wanted: Sequence[int], after_rows: bool
) -> tuple[Array, int]:
    """As `_parse`, and whether its last line was cut short; slow, names faults, takes quotes."""
    rows: list[list[float]] = []
    lines = io.TextIOWrapper(io.BytesIO(piece.text), encoding="utf-8-sig", errors="replace")
    for number, line in enumerate(lines, start=piece.number):
        if number < piece.number + piece.skip or not line.strip():
            continue
        # A last field that nothing follows may be missing for this reason alone.
        text = line.strip("\r\n ").rstrip(layout.delimiter if piece.is_open else "\n")
        fields = split_fields(text, layout.delimiter)
        try:
            rows.append(_numbers(fields, layout, wanted))
        except RecordingError as error:
            if piece.is_open and after_rows and len(fields) <= layout.columns:
                return np.empty((0, len(wanted))), 1
            where = f"{path}: line {number}"
            raise RecordingError(f"{where}{error}; repair or remove the line") from None
    return np.array(rows, dtype=np.float64).reshape(-1, len(wanted)), 0


def _numbers(fields: list[str], layout: TextLayout, wanted: Sequence[int]) -> list[float]:
    if len(fields) != layout.columns:
        raise RecordingError(f" has {len(fields)} columns, expected {layout.columns}")
    for column in wanted:
        text = fields[column]
        if not is_number(text) and text not in _MISSING:
            advice = ": write it with a point, without commas" if "," in text else ""
            advice = ": write times in seconds" if ":" in text else advice
            raise RecordingError(f", column {column} is {text[:40]!r}, not a number{advice}")
    return [float(fields[k]) if is_number(fields[k]) else np.nan for k in wanted]
