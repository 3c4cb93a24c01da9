"""Files from others, read within bounds.

Whatever packed a file (gzip, bz2, LZ4, Zstandard; a whole file, chunks, messages, pages), one rule
says what it may unpack to: `Allowance`.
"""

import bz2
import gzip
import hashlib
import io
import re
import sys
import zlib
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Self

from truejoint.errors import RecordingError
from truejoint.extras import require
from truejoint.files import require_ordinary

# Most bytes of a text file once unpacked: 6 h of the 252-column layout is 4.5 GB.
MAX_UNPACKED_BYTES: Final = 8 * 2**30
MAX_BINARY_BYTES: Final = 2**30  # of a file that is read in one go (.npy, .mat)
MAX_VALUES: Final = 250_000_000  # kept of one file (2 GB): 72 h of 30 Hz rows with 32 columns
MAX_LINE_BYTES: Final = 1 << 20  # of a text file; the widest layout known takes 6.3 kB a line
HEAD_BYTES: Final = 1 << 16  # how much of a file is looked at to tell its format
FOREIGN: Final = {  # beginning of files that no reader takes
    b"PK\3\4": "a zip archive, as .xlsx and .npz are",
    b"\xd0\xcf\x11\xe0": "a workbook (.xls)",
    b"BZh": "packed by bzip2",
    b"\xfd7zXZ": "packed by xz",
    b"\xff\xfe": "text in UTF-16",
    b"\xfe\xff": "text in UTF-16",
}
# What a packed file may unpack to in all, however small it is, and as a multiple of its size:
# recordings pack to a quarter or a twentieth; what packs to a hundredth is no measurement.
_SMALL_BYTES: Final = 1 << 26
_MOST_PACKED: Final = 100
MOST_PIECE_BYTES: Final = 1 << 26  # of a message or chunk; recorders write about 1 MB
_STEP_BYTES: Final = 1 << 20  # that are unpacked at a time, between which Ctrl-C is heard


class DamagedError(Exception):
    """What is packed, a message or an array is cut short or damaged; it never reaches a user."""


@dataclass
class Allowance:
    """What a file may unpack to, of which its chunks, messages and pages take their parts."""

    path: Path | str
    most: int  # bytes in all
    what: str = "unpacks to"
    taken: int = 0

    @classmethod
    def of_size(cls, path: Path | str, size: int) -> Self:
        """Give what a packed file of `size` bytes may unpack to."""
        return cls(path, max(_SMALL_BYTES, _MOST_PACKED * size))

    def take(self, size: int) -> None:
        """Count bytes that were, or would be, unpacked; raises RecordingError past the bound."""
        self.taken += size
        if self.taken > self.most:
            raise RecordingError(
                f"{self.path}: {self.what} more than {self.most} bytes, the most that is read; "
                "cut the recording into parts"
            )

    def check_piece(self, size: int) -> None:
        """Refuse, with RecordingError, a message or chunk of so many bytes, once it is unpacked."""
        if size > MOST_PIECE_BYTES:
            raise RecordingError(
                f"{self.path}: a message or chunk of more than {MOST_PIECE_BYTES} bytes, the most "
                "that is read; record in smaller chunks"
            )

    def unpack(self, data: bytes, packing: str) -> bytes:
        """Unpack a chunk or a message, or as much as there is of one that is not whole.

        Raises RecordingError past the bounds; nothing comes of one whose `packing` is unknown.
        """
        content = bytearray()
        for piece in _readable(_UNPACKERS[packing](data)) if packing in _UNPACKERS else ():
            self.take(len(piece))
            content += piece
            self.check_piece(len(content))
        return bytes(content)


def _readable(pieces: Iterator[bytes]) -> Iterator[bytes]:
    """Give pieces up to where they are damaged; each packing has errors of its own."""
    with suppress(Exception):
        yield from pieces


def _pieces(packed: Any) -> Iterator[bytes]:
    with packed:
        while piece := packed.read1(_STEP_BYTES):
            yield piece


def _frames(start: Callable[[], Any], data: bytes) -> Iterator[bytes]:
    """Unpack frames without a file, one for each message: the end of a file may swallow Ctrl-C."""
    while data:
        frame, packed = start(), data
        while not frame.eof and (piece := frame.decompress(packed, _STEP_BYTES)):
            yield piece
            packed = b""
        data = frame.unused_data if frame.eof else b""


_ZSTD: Final = "compression.zstd" if sys.version_info >= (3, 14) else "backports.zstd"
_UNPACKERS: Final[dict[str, Callable[[bytes], Iterator[bytes]]]] = {
    "bz2": lambda data: _pieces(bz2.BZ2File(io.BytesIO(data))),
    "lz4": lambda data: _pieces(
        require("lz4.frame", "ros", "unpacking LZ4").LZ4FrameFile(io.BytesIO(data))
    ),
    "zstd": lambda data: _frames(
        require(_ZSTD, "ros", "unpacking Zstandard").ZstdDecompressor, data
    ),
}


class BoundedFile(io.RawIOBase):
    """A file that hashes what is read from it and refuses to go on past `limit` bytes.

    A gzip file is unpacked as it is read, so a small file that unpacks to an endless one costs
    no memory. With `lines` it refuses a line longer than `MAX_LINE_BYTES` too.
    """

    def __init__(self, path: Path, limit: int = MAX_UNPACKED_BYTES, *, lines: bool = False) -> None:
        super().__init__()
        self._path, self._lines, self._line = path, lines, 0
        self._hash = hashlib.sha256()
        self._plain = io.FileIO(path)
        packed = self._plain.read(2) == b"\x1f\x8b"  # whatever the file is called
        self._plain.seek(0)
        size = path.stat().st_size
        self._room = Allowance.of_size(path, size) if packed else Allowance(path, limit, "holds")
        self._room.most = min(limit, self._room.most)
        self._file: Any = gzip.GzipFile(fileobj=self._plain) if packed else self._plain

    def readable(self) -> bool:
        """Say that it is made for reading."""
        return True

    def readinto(self, buffer: Any) -> int:
        """Read into `buffer`; raises RecordingError past the limit or when gzip is damaged."""
        try:
            data: bytes = self._file.read(len(buffer)) or b""
        except (EOFError, zlib.error, gzip.BadGzipFile) as error:
            raise RecordingError(
                f"{self._path}: the gzip file is cut short or damaged ({error}); fetch it again"
            ) from None
        self._room.take(len(data))
        if self._lines:
            end = data.rfind(b"\n")
            self._line = len(data) - end - 1 if end >= 0 else self._line + len(data)
            if self._line > MAX_LINE_BYTES:
                raise RecordingError(
                    f"{self._path}: has a line longer than {MAX_LINE_BYTES} bytes; is it text?"
                )
        self._hash.update(data)
        buffer[: len(data)] = data
        return len(data)

    def sha256(self) -> str:
        """SHA-256 of the whole unpacked file, hexadecimal; reads what is left of it."""
        buffer = bytearray(1 << 20)
        while self.readinto(buffer):
            pass
        return self._hash.hexdigest()

    def close(self) -> None:
        """Close the file."""
        self._file.close()
        self._plain.close()
        super().close()


def require_file(path: Path) -> Path:
    """`path` if it is a file with something in it; raises RecordingError if not."""
    require_ordinary(path, RecordingError)
    if not path.exists():
        raise RecordingError(f"{path}: there is no such file; check the path")
    if path.stat().st_size == 0:
        raise RecordingError(f"{path}: the file is empty; was the recording ever started?")
    return path


def read_bounded(path: Path, limit: int = MAX_BINARY_BYTES) -> tuple[bytes, str]:
    """Whole content of a file, unpacked, of at most `limit` bytes, and its SHA-256."""
    with BoundedFile(require_file(path), limit) as file:
        data = file.readall()
        return data, file.sha256()


@dataclass(frozen=True)
class Head:
    """First bytes of a file, unpacked: read once, and handed to everyone who looks at them."""

    path: Path
    data: bytes

    @classmethod
    def of(cls, path: Path, size: int = HEAD_BYTES) -> Self:
        """Read the first `size` bytes of a file; raises RecordingError if there is none."""
        with (
            BoundedFile(require_file(path), limit=size + io.DEFAULT_BUFFER_SIZE) as file,
            io.BufferedReader(file) as buffered,
        ):
            data = buffered.read(size)
        for begin, kind in FOREIGN.items():
            if data.startswith(begin):
                raise RecordingError(f"{path}: is {kind}; save its table as text (CSV, UTF-8)")
        return cls(path, data)

    @property
    def is_text(self) -> bool:
        """Whether there is no byte that text never has."""
        return b"\0" not in self.data

    def lines(self) -> list[str]:
        """Lines of a text, the last of which may be cut off."""
        return re.split("\r\n|\r|\n", self.data.decode("utf-8-sig", errors="replace"))

    def first_line(self, comment: str = "") -> tuple[int, str]:
        """Find the first line that is neither blank nor a comment: its number, from 1, and text.

        Raises RecordingError if there is none, or the file is no text.
        """
        if not self.is_text:
            raise RecordingError(f"{self.path}: is not a text file; name its format")
        lines, is_cut = self.lines(), len(self.data) >= HEAD_BYTES
        for number, line in enumerate(lines[: -1 if is_cut else None], start=1):
            text = line.strip()
            if text and not (comment and text.startswith(comment)):
                return number, text
        why = f"neither header nor row ends in its first {HEAD_BYTES} bytes; shorten it"
        raise RecordingError(f"{self.path}: {why if is_cut else 'holds no rows'}")


def sha256_of(path: Path) -> str:
    """SHA-256 of a file, unpacked if it is a gzip file, hexadecimal."""
    with BoundedFile(require_file(path)) as file:
        return file.sha256()
