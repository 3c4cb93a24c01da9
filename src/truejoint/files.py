"""Files: written whole or not at all, known by a hash of what they hold, read within bounds."""

import errno
import hashlib
import json
import os
import secrets
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from truejoint.errors import TruejointError, words

if TYPE_CHECKING:  # a command that only answers does without NumPy
    from truejoint.array_types import Array

Write = Callable[[Path], object] | bytes
"""Fills a file, or is what it shall hold."""
Kind = type[TruejointError]
"""Kind of the error that is raised."""
UNHASHED: Final = "was written without a content hash: whether it is whole cannot be told"

_REASONS: Final = {
    errno.ENOSPC: "the disk is full; make room",
    errno.EDQUOT: "your share of the disk is used up; make room",
    errno.EFBIG: "larger than files may be here",
}


def write_atomically(
    path: Path, write: Write, *, overwrite: bool, error: Kind = TruejointError
) -> None:
    """Let `write` fill a temporary file beside `path`, then move it there in one step.

    When this returns, the file is on the disk and not in a cache of it. Without `overwrite` only
    one of two processes that write `path` at once succeeds, and a file that exists is refused.
    Whatever goes wrong, `error` is raised and what was at `path` stays as it was.
    """
    write_all_atomically({path: write}, overwrite=overwrite, error=error)


def write_all_atomically(
    files: Mapping[Path, Write], *, overwrite: bool, error: Kind = TruejointError
) -> None:
    """Write several files as `write_atomically` does; none is moved before all are filled."""
    for path in files:
        check_target(path, overwrite=overwrite, error=error)
    # Named before they are made, so that none is forgotten wherever Ctrl-C strikes.
    filled = {path: path.with_name(f".truejoint-{secrets.token_hex(8)}.part") for path in files}
    try:
        for path, temporary in filled.items():
            temporary.open("xb").close()
            write = files[path]
            temporary.write_bytes(write) if isinstance(write, bytes) else write(temporary)
            _sync(temporary)
        for path, temporary in filled.items():
            move(temporary, path, overwrite=overwrite)
        for folder in {path.parent for path in files}:
            _sync(folder)
    except FileExistsError:
        raise _taken(path, error) from None
    except OSError as cause:
        raise error(f"{path}: cannot be written: {reason(cause)}") from None
    finally:
        for temporary in filled.values():
            temporary.unlink(missing_ok=True)


def check_target(
    path: Path, *, overwrite: bool, makes_folder: bool = False, error: Kind = TruejointError
) -> None:
    """Refuse, as `write_atomically` does, a path that cannot become a file.

    With `makes_folder` its folder need not be there yet.
    """
    try:
        exists = path.exists()
    except OSError as cause:  # a name that no file can have
        raise error(f"{str(path)[:200]}: cannot be written: {reason(cause)}") from None
    if exists and not path.is_file():
        raise error(f"{path}: exists already and is no file; choose another name")
    if exists and not overwrite:
        raise _taken(path, error)
    if not (makes_folder or path.parent.is_dir()):
        raise error(f"{path}: the folder {path.parent} does not exist; make it first")
    check_folder(path.parent, error=error)


def check_ending(path: Path, ending: str, what: str, error: Kind) -> None:
    """Refuse a path whose ending says that it is another file than `what`, as "a recording"."""
    if path.suffix not in {"", ending}:
        raise error(f"{path}: {what} is a {ending} file; call it {path.stem}{ending}")


def check_folder(folder: Path, *, error: Kind = TruejointError) -> None:
    """Refuse a folder in which no file can be made, once it is made itself."""
    there = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    if not there.is_dir():
        raise error(f"{there}: is a file; name a folder")
    if not os.access(there, os.W_OK | os.X_OK):
        raise error(f"{there}: nothing may be written in this folder; choose another")


def free_name(path: Path, word: str) -> Path:
    """First name beside `path` that is not taken: ``a.word.parquet``, ``a.word2.parquet``, ..."""
    count, free = 1, path.with_name(f"{path.stem}.{word}{path.suffix}")
    while free.exists():
        count += 1
        free = path.with_name(f"{path.stem}.{word}{count}{path.suffix}")
    return free


def content_hash(description: Mapping[str, Any], arrays: "Mapping[str, Array]") -> str:
    """SHA-256 over JSON values and float64 arrays with names and shapes, hexadecimal.

    Of what a file says, not of its bytes: compressed in another way it is the same. Raises
    ValueError for a description that is not JSON.
    """
    digest = hashlib.sha256(canonical_json(description).encode())
    for name in sorted(arrays):
        array = arrays[name]
        digest.update(json.dumps([name, array.shape]).encode())
        digest.update(array.astype("<f8", order="C", copy=False).data)
    return digest.hexdigest()


def is_as_written(
    digest: object, description: Mapping[str, Any], arrays: "Mapping[str, Array]"
) -> bool:
    """Whether `digest` is the hash of this content."""
    try:
        return digest == content_hash(description, arrays)
    except (ValueError, RecursionError):  # nothing that was ever written
        return False


def canonical_json(description: Mapping[str, Any]) -> str:
    """JSON of a description, the same for the same values."""
    return json.dumps(description, sort_keys=True, allow_nan=False, separators=(",", ":"))


def read_small(path: Path, error: Kind, most: int, kind: str) -> bytes:
    """Content of a file that is `kind` only if it holds at most `most` bytes; raises `error`."""
    require_ordinary(path, error)
    try:
        with path.open("rb") as file:
            data = file.read(min(most, os.fstat(file.fileno()).st_size) + 1)
    except OSError as fault:
        raise error(f"{path}: cannot be read ({fault.strerror}); check the path") from None
    if len(data) > most:
        raise error(f"{path}: holds more than {most} bytes; is it {kind}?")
    return data


def head_of(path: Path, most: int) -> bytes:
    """First bytes of a file, at most so many; none where there is no file."""
    try:
        if not path.is_file():
            return b""
        with path.open("rb") as file:
            return file.read(most)
    except (OSError, ValueError) as fault:  # a name that no file can have
        raise TruejointError(f"{path}: cannot be read ({words(fault)}); check the path") from None


def is_folder(path: Path) -> bool:
    """Whether there is such a folder; a name that no file can have is that of none."""
    return os.path.isdir(path)  # noqa: PTH112  # pathlib's raises for such a name


def require_ordinary(path: Path, error: Kind) -> None:
    """Refuse what is no file, a pipe above all, at which reading would wait for ever."""
    try:
        if (path.exists() and not path.is_file()) or "\0" in str(path):
            raise error(f"{path}: is not a file, but a folder, a pipe or a device")
    except (OSError, ValueError) as fault:  # a name that no file can have
        raise error(f"{path}: cannot be read ({fault}); check the path") from None


def reason(cause: OSError) -> str:
    """Say what went wrong with a file, and what to do."""
    advice = _REASONS.get(cause.errno or 0)
    return advice or f"{cause.strerror or cause}; check path and permissions"


def _sync(path: Path) -> None:
    """Have the disk keep a file's content, or which names a folder holds."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def move(temporary: Path, path: Path, *, overwrite: bool) -> None:
    """Give a file the name `path`; it may be left under its own as well.

    Raises FileExistsError, without `overwrite`, if there is one of that name.
    """
    if not overwrite:
        try:
            # A link, unlike a rename, fails if somebody made the file in the meantime.
            path.hardlink_to(temporary)
            return
        except FileExistsError:
            raise
        except OSError:  # a file system without links, as on a USB stick: claim the name first
            path.open("xb").close()
    temporary.replace(path)


def _taken(path: Path, error: Kind) -> TruejointError:
    return error(f"{path}: exists already; choose another name, or allow overwriting (--force)")
