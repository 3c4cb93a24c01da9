"""What the pages of a Parquet file unpack to, by the headers that Arrow makes room by.

A file's metadata may lie about it. Layout: apache/parquet-format (PageHeader, first two fields) and
apache/thrift:doc/specs/thrift-compact-protocol.md.
"""

from collections.abc import Iterator
from typing import Any, BinaryIO, Final

from truejoint.recordings.bounded_file import DamagedError

_MOST_HEADER: Final = 1 << 12  # bytes of a page's header; those of numbers take about a hundred
_WIDTHS: Final = {1: 0, 2: 0, 3: 1, 7: 8}  # bytes of a true, a false, a byte, a float
_WHOLE, _BINARY, _STRUCT = (4, 5, 6), 8, 12
_DEEPEST: Final = 4  # structs within structs


def page_sizes(file: BinaryIO, metadata: Any) -> Iterator[int]:
    """Bytes that reading each page takes: of its header, and unpacked.

    Raises DamagedError where pages are not as Parquet has them.
    """
    for group in map(metadata.row_group, range(metadata.num_row_groups)):
        for chunk in map(group.column, range(metadata.num_columns)):
            at = min(chunk.data_page_offset, chunk.dictionary_page_offset or chunk.data_page_offset)
            end = at + chunk.total_compressed_size
            while at < end:
                file.seek(at)
                try:
                    numbers, length = _struct(file.read(_MOST_HEADER), 0)
                    unpacked, packed = numbers[2], numbers[3]
                except (IndexError, KeyError):
                    raise DamagedError("the header of a page") from None
                if min(unpacked, packed) < 0:
                    raise DamagedError("the length of a page")
                yield _MOST_HEADER + unpacked
                at += length + packed


def _struct(data: bytes, at: int, depth: int = 0) -> tuple[dict[int, int], int]:
    """Whole numbers among the fields of a struct, by their keys, and where it ends."""
    numbers: dict[int, int] = {}
    key = 0
    while head := data[at]:
        step, kind, at = head >> 4, head & 15, at + 1
        if not step:
            step, at = _whole(data, at)
            key = 0
        key += step
        if key in numbers:  # which of them would count?
            raise DamagedError("a field that stands twice")
        if kind in _WHOLE:
            numbers[key], at = _whole(data, at)
        elif kind == _BINARY:
            length, at = _varint(data, at)
            at += length
        elif kind == _STRUCT and depth < _DEEPEST:
            _, at = _struct(data, at, depth + 1)
        elif kind in _WIDTHS:
            at += _WIDTHS[kind]
        else:
            raise DamagedError("a field that no page has")
    return numbers, at + 1


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
