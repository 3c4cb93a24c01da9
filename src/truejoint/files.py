"""Write files whole or not at all."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path

from truejoint.errors import TruejointError


def write_atomically(
    path: Path,
    write: Callable[[Path], object],
    *,
    overwrite: bool,
    error: type[TruejointError] = TruejointError,
) -> None:
    """Let `write` fill a temporary file beside `path`, then move it there in one step.

    Raises
    ------
    TruejointError
        As `error`: if `path` exists and `overwrite` is false, its folder does not exist, or it
        cannot be written. Whatever goes wrong, what was at `path` stays as it was.
    """
    write_all_atomically({path: write}, overwrite=overwrite, error=error)


def write_all_atomically(
    files: Mapping[Path, Callable[[Path], object]],
    *,
    overwrite: bool,
    error: type[TruejointError] = TruejointError,
) -> None:
    """Write several files as `write_atomically` does; none is moved before all are filled."""
    for path in files:
        check_target(path, overwrite=overwrite, error=error)
    filled: dict[Path, Path] = {}
    try:
        for path, write in files.items():
            handle, name = tempfile.mkstemp(
                prefix=f".{path.name}.", suffix=".part", dir=path.parent
            )
            os.close(handle)
            temporary = filled[path] = Path(name)
            write(temporary)
            with temporary.open("rb") as file:
                os.fsync(file.fileno())
            temporary.chmod(0o644)
        for path, temporary in filled.items():
            if overwrite:
                temporary.replace(path)
            else:
                # A link, unlike a rename, fails if somebody made the file in the meantime.
                path.hardlink_to(temporary)
    except FileExistsError:
        raise _taken(path, error) from None
    except OSError as cause:
        raise _unwritable(path, cause, error) from None
    finally:
        for temporary in filled.values():
            temporary.unlink(missing_ok=True)


def check_target(
    path: Path, *, overwrite: bool, error: type[TruejointError] = TruejointError
) -> None:
    """Refuse, as `write_atomically` does, a path that cannot become a file."""
    if path.is_dir() or (path.exists() and not overwrite):
        raise _taken(path, error)
    if not path.parent.is_dir():
        raise error(f"{path}: the folder {path.parent} does not exist; make it first")


def _taken(path: Path, error: type[TruejointError]) -> TruejointError:
    return error(f"{path}: exists already; choose another name or allow overwriting")


def _unwritable(path: Path, cause: OSError, error: type[TruejointError]) -> TruejointError:
    return error(f"{path}: cannot be written: {cause.strerror or cause}")
