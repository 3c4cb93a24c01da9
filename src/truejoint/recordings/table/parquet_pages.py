"""What the pages of a Parquet file unpack to, by the headers that Arrow makes room by.

A file's metadata may lie about it, and Arrow's own view of a damaged chunk ends the process.
Layout: apache/parquet-format:src/main/thrift/parquet.thrift and
apache/thrift:doc/specs/thrift-compact-protocol.md.
"""

import os
from collections.abc import Iterator
from typing import Any, BinaryIO, Final, NamedTuple

from truejoint.recordings.bounded_file import DamagedError

_MOST_HEADER: Final = 1 << 12  # bytes of a page's header; those of numbers take about a hundred
_WHOLE, _BINARY, _LISTS, _STRUCT = (4, 5, 6), 8, (9, 10), 12
_WIDTHS: Final = {1: 0, 2: 0, 3: 1, 7: 8}  # bytes of a true, a false, a byte, a float
_DEEPEST: Final = 8  # structs and lists within each other
_MOST_FOOTER: Final = 1 << 22  # bytes


class Chunk(NamedTuple):
    """The values of one column in one group of rows, and the bytes of a file that hold them."""

    values: int
    begin: int
    end: int


def chunks(file: BinaryIO) -> list[Chunk]:
    """Read where the chunks of a Parquet file are.

    Raises DamagedError where its footer is not as Parquet has it.
    """
    file.seek(-8, os.SEEK_END)
    length = int.from_bytes(file.read(4), "little")
    if length > _MOST_FOOTER:
        raise DamagedError("a footer of too many bytes")
    file.seek(-8 - length, os.SEEK_END)
    try:
        footer, end = _struct(file.read(length), 0, has_lists=True)
        columns = [column[3] for group in footer[4] for column in group[1]]
        found = [
            Chunk(one[5], begin := min(one[9], one.get(11) or one[9]), begin + one[7])
            for one in columns
        ]
    except (IndexError, KeyError, TypeError, AttributeError):
        raise DamagedError("the footer") from None
    if end != length or any(min(chunk) < 0 for chunk in found):
        raise DamagedError("the footer")
    return found


def page_sizes(file: BinaryIO, of_chunks: list[Chunk]) -> Iterator[int]:
    """Bytes that reading each page takes: of its header, and unpacked.

    Raises DamagedError where pages are not as Parquet has them.
    """
    for chunk in of_chunks:
        at = chunk.begin
        while at < chunk.end:
            file.seek(at)
            try:
                numbers, length = _struct(file.read(_MOST_HEADER), 0)
                unpacked, packed = numbers[2], numbers[3]
                if min(unpacked, packed) < 0:
                    raise DamagedError("the length of a page")
            except (IndexError, KeyError, TypeError):
                raise DamagedError("the header of a page") from None
            yield _MOST_HEADER + unpacked
            at += length + packed


def _struct(
    data: bytes, at: int, depth: int = 0, *, has_lists: bool = False
) -> tuple[dict[int, Any], int]:
    """Values of the fields of a struct, by their keys, and where it ends."""
    values: dict[int, Any] = {}
    key = 0
    while head := data[at]:
        step, kind, at = head >> 4, head & 15, at + 1
        if not step:
            step, at = _whole(data, at)
            key = 0
        key += step
        if key in values:  # which of them would count?
            raise DamagedError("a field that stands twice")
        values[key], at = _value(data, at, kind, depth, has_lists=has_lists)
    return values, at + 1


def _value(data: bytes, at: int, kind: int, depth: int, *, has_lists: bool) -> tuple[Any, int]:
    """Read a whole number, a struct or a list, and where it ends; None of what is neither."""
    if kind in _WHOLE:
        return _whole(data, at)
    if kind == _BINARY:
        length, at = _varint(data, at)
        return None, at + length
    if kind == _STRUCT and depth < _DEEPEST:
        return _struct(data, at, depth + 1, has_lists=has_lists)
    if kind in _LISTS and has_lists and depth < _DEEPEST:
        count, of_kind, at = data[at] >> 4, data[at] & 15, at + 1
        if count == 15:
            count, at = _varint(data, at)
        if count > len(data) - at:
            raise DamagedError("a list that never ends")
        values = []
        for _ in range(count):
            value, at = _value(data, at, of_kind, depth + 1, has_lists=True)
            values.append(value)
        return values, at
    if kind in _WIDTHS:
        return None, at + _WIDTHS[kind]
    raise DamagedError("a field that no page has")


def _whole(data: bytes, at: int) -> tuple[int, int]:
    """Read a number with a sign."""
    value, at = _varint(data, at)
    return value >> 1 ^ -(value & 1), at


def _varint(data: bytes, at: int) -> tuple[int, int]:
    """Read a number of seven bits a byte, and where it ends."""
    value = 0
    for shift, place in enumerate(range(at, at + 10)):
        value |= (data[place] & 0x7F) << 7 * shift
        if data[place] < 0x80:
            return value, place + 1
    raise DamagedError("a number that never ends")
