"""Parts on disk: NumPy's archive without pickle, named after all that its content depends on."""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
import zlib
from importlib.metadata import version
from pathlib import Path
from typing import Final

import numpy as np

from truejoint.recordings.files import write_atomically
from truejoint.studies.study import Part, PartResult, Study

_NUMBERS: Final = "numbers"
_ARRAY: Final = "array/"


def part_file(folder: Path, study: Study, part: Part) -> Path:
    """Where a part is kept: another argument, seed or version is another file."""
    origin = (study.name, version("truejoint"), study.version, part.key, part.arguments)
    digest = hashlib.sha256(json.dumps(origin, sort_keys=True).encode()).hexdigest()
    return folder / f"{part.key}-{digest[:16]}.npz"


def write_part(path: Path, result: PartResult) -> None:
    """Write a part whole or not at all; raises RecordingError or OSError where it cannot."""
    data = io.BytesIO()
    numbers = np.frombuffer(json.dumps(result.numbers).encode(), np.uint8)
    arrays = {_ARRAY + name: values for name, values in result.arrays.items()}
    np.savez(data, allow_pickle=False, **{_NUMBERS: numbers}, **arrays)
    write_bytes(path, data.getvalue())


def read_part(path: Path) -> PartResult | None:
    """Part that was kept; None if there is none, or it is damaged (the archive has checksums)."""
    try:
        with np.load(path, allow_pickle=False) as archive:
            numbers = json.loads(archive[_NUMBERS].tobytes())
            names = [name for name in archive.files if name.startswith(_ARRAY)]
            return PartResult(numbers, {n.removeprefix(_ARRAY): archive[n] for n in names})
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error):
        return None


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file whole or not at all, over what is there; makes its folder."""

    def fill(temporary: Path) -> None:
        temporary.write_bytes(data)

    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, fill, overwrite=True)
