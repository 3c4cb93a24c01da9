"""Tables of numbers in text files, read in pieces and within bounds."""

from __future__ import annotations

import io
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from truejoint.errors import RecordingError
from truejoint.recordings.files import BoundedFile, read_head, require_file

Array = NDArray[np.float64]

MAX_VALUES: Final = 250_000_000
"""Most numbers kept of one file (2 GB): 72 h of 30 Hz rows with 32 columns."""
_ROWS_AT_ONCE: Final = 50_000
# From 3.1 on pandas reads numbers to the last bit unasked, and warns if asked to.
_EXACT: Final[dict[str, Any]] = (
    {}
    if tuple(map(int, pd.__version__.split(".")[:2])) >= (3, 1)
    else {"float_precision": "round_trip"}
)


@dataclass(frozen=True)
class TextLayout:
    """How the numbers stand in a text file.

    Attributes
    ----------
    delimiter : str
        Between two numbers: comma, semicolon or tab; a blank means any white space.
    comment : str
        A line that begins with it is passed over; empty for none.
    skip : int
        Lines to pass over at the start, the header among them.
    columns : int
        How many numbers a line must have.
    """

    columns: int
    delimiter: str = ","
    comment: str = ""
    skip: int = 0


@dataclass(frozen=True)
class NumericTable:
    """Some columns of a text file.

    Attributes
    ----------
    values : ndarray, shape (n, k)
        The columns asked for, in the order asked for; NaN where a field is empty or ``nan``.
    sha256 : str
        Hash of the whole (unpacked) file.
    incomplete : int
        Lines at the end that were cut short and left out: 0 or 1.
    """

    values: Array
    sha256: str
    incomplete: int


def read_numbers(
    path: Path, layout: TextLayout, use: Sequence[int], may_miss: Sequence[int] = ()
) -> NumericTable:
    """Columns `use` of a text file of numbers.

    Parameters
    ----------
    path : Path
        Text, or text in gzip.
    layout : TextLayout
    use : sequence of int
        Columns to read, counted from 0.
    may_miss : sequence of int
        Those of `use` that may be empty or ``nan`` in some rows.

    Returns
    -------
    NumericTable
        A last line with too few numbers is what an interrupted recorder leaves behind: it is left
        out and counted.

    Raises
    ------
    RecordingError
        Naming line, column and text of a field that is not a number or is missing, of a line with
        too many or too few fields, or when the file holds more than is read.
    """
    # The last column tells a short line from a whole one.
    wanted = sorted({*use, layout.columns - 1})
    strict = [column for column in wanted if column not in may_miss]
    incomplete = 0
    try:
        values, digest = _parse(path, layout, wanted, strict)
    except _BrokenLineError as broken:
        rows, cut_short = _scan(path, layout)
        if not cut_short or rows < 2:
            raise _explain(path, layout, wanted, strict, str(broken)) from None
        incomplete = 1
        try:
            values, digest = _parse(path, layout, wanted, strict, rows - 1)
        except _BrokenLineError as again:
            raise _explain(path, layout, wanted, strict, str(again)) from None
    return NumericTable(values[:, [wanted.index(c) for c in use]], digest, incomplete)


def first_line(path: Path, comment: str = "") -> tuple[int, str]:
    """First line that is neither blank nor a comment.

    Returns
    -------
    number : int
        Of the line, counted from 1.
    text : str
        The line, stripped.

    Raises
    ------
    RecordingError
        If there is none, the file is not text or has more columns than are read.
    """
    head = read_head(path)
    if b"\0" in head:
        raise RecordingError(f"{path}: is not a text file; name its format")
    for number, line in enumerate(head.decode("utf-8-sig", errors="replace").splitlines(), start=1):
        text = line.strip()
        if text and not (comment and text.startswith(comment)):
            return number, text
    raise RecordingError(f"{path}: holds no rows")


def split_fields(line: str, delimiter: str) -> list[str]:
    """Fields of a line, stripped; the delimiter blank is any white space."""
    if delimiter == " ":
        return line.split()
    return [field.strip() for field in line.split(delimiter)]


def is_number(text: str) -> bool:
    """Whether a field reads as a number."""
    try:
        float(text)
    except ValueError:
        return False
    return True


class _BrokenLineError(Exception):
    """Some line does not hold what the layout says; which one is found by `_explain`."""


def _parse(
    path: Path, layout: TextLayout, wanted: list[int], strict: list[int], rows: int | None = None
) -> tuple[Array, str]:
    """Columns `wanted` of the first `rows` rows, and the hash of the whole file."""
    pieces: list[Array] = []
    left = most = MAX_VALUES // len(wanted)
    checked = [wanted.index(column) for column in strict]
    delimiter = b"" if layout.delimiter == " " else layout.delimiter.encode()
    raw = BoundedFile(require_file(path), lines=True, count=delimiter)
    with raw, io.BufferedReader(raw) as file:
        try:
            for piece in _pieces(file, layout, wanted, rows):
                left -= len(piece)
                if left < 0:
                    raise RecordingError(
                        f"{path}: more than {most} rows of {len(wanted)} columns, the most that "
                        "is read; cut the recording into parts"
                    )
                values = piece[wanted].to_numpy(dtype=np.float64)
                if np.isnan(values[:, checked]).any():
                    raise _BrokenLineError("a field is missing")
                pieces.append(values)
        except (pd.errors.EmptyDataError, StopIteration):
            raise RecordingError(f"{path}: holds no rows of numbers") from None
        except RecordingError:
            raise
        except (ValueError, OverflowError) as error:
            raise _BrokenLineError(str(error)) from None
        if not any(len(piece) for piece in pieces):
            raise RecordingError(f"{path}: holds no rows of numbers")
        digest = raw.sha256()
    values = np.concatenate(pieces)
    # The parser passes over surplus fields; the number of delimiters gives them away.
    expected = len(values) * (layout.columns - 1) + _delimiters_aside(path, layout, delimiter)
    if (not delimiter or raw.counted != expected) and rows is None:
        broken = _broken_line(path, layout, wanted, strict)
        if broken is not None:
            raise broken
    return values, digest


def _pieces(
    file: io.BufferedReader[BoundedFile], layout: TextLayout, wanted: list[int], rows: int | None
) -> Iterator[pd.DataFrame]:
    """Read columns `wanted` piece by piece."""
    yield from pd.read_csv(
        file,
        header=None,
        skiprows=layout.skip,
        names=list(range(layout.columns)),
        usecols=wanted,
        nrows=rows,
        index_col=False,
        sep=layout.delimiter if layout.delimiter in {",", ";", "\t"} else r"\s+",
        comment=layout.comment or None,
        dtype=np.float64,
        skipinitialspace=True,
        **_EXACT,
        chunksize=_ROWS_AT_ONCE,
        encoding="utf-8-sig",
        encoding_errors="replace",
    )


def _delimiters_aside(path: Path, layout: TextLayout, delimiter: bytes) -> int:
    """Count the delimiters in the lines at the start of the file that are no rows."""
    count = 0
    for number, line in enumerate(read_head(path).splitlines(), start=1):
        comment = layout.comment and line.strip().startswith(layout.comment.encode())
        if delimiter and (number <= layout.skip or comment):
            count += line.count(delimiter)
    return count


def _text_lines(path: Path) -> io.TextIOWrapper:
    raw = BoundedFile(path, lines=True)
    return io.TextIOWrapper(io.BufferedReader(raw), encoding="utf-8-sig", errors="replace")


def _rows_of(lines: io.TextIOWrapper, layout: TextLayout) -> Iterator[tuple[int, str]]:
    """Line number and text of every line that must hold numbers."""
    for number, line in enumerate(lines, start=1):
        text = line.strip()
        commented = bool(layout.comment) and text.startswith(layout.comment)
        if number > layout.skip and text and not commented:
            yield number, line


def _scan(path: Path, layout: TextLayout) -> tuple[int, bool]:
    """Count the rows, and tell whether the last lacks something and its line end."""
    rows, last = 0, "\n"
    with _text_lines(path) as lines:
        for _, line in _rows_of(lines, layout):
            rows += 1
            last = line
    fields = split_fields(last.strip("\r\n "), layout.delimiter)
    short = len(fields) < layout.columns or not all(is_number(field) for field in fields)
    return rows, short and not last.endswith("\n")


def _explain(
    path: Path, layout: TextLayout, wanted: list[int], strict: list[int], reason: str
) -> RecordingError:
    """Find the first line that breaks the layout; slow, and only run when one does."""
    found = _broken_line(path, layout, wanted, strict)
    if found is not None:
        return found
    return RecordingError(f"{path}: cannot be read as numbers ({reason.splitlines()[0][:120]})")


def _broken_line(
    path: Path, layout: TextLayout, wanted: list[int], strict: list[int]
) -> RecordingError | None:
    with _text_lines(path) as lines:
        for number, line in _rows_of(lines, layout):
            fields = split_fields(line.strip("\r\n "), layout.delimiter)
            if len(fields) != layout.columns:
                return RecordingError(
                    f"{path}: line {number} has {len(fields)} columns, expected {layout.columns}; "
                    "repair or remove the line"
                )
            for column in wanted:
                field = fields[column]
                missing = not field or (is_number(field) and math.isnan(float(field)))
                if (missing and column in strict) or not (missing or is_number(field)):
                    return RecordingError(
                        f"{path}: line {number}, column {column} is {field[:40]!r}, not a number; "
                        "repair or remove the line"
                    )
    return None
