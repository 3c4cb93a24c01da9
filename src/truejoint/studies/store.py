"""Parts on disk: a hash, and NumPy's archive without pickle; named after what they depend on."""

from __future__ import annotations

import hashlib
import io
import json
from importlib.metadata import version
from pathlib import Path
from typing import Final

import numpy as np

from truejoint.files import write_atomically
from truejoint.studies.study import Part, PartResult, Study

_NUMBERS: Final = "numbers"
_DIGEST: Final = 32  # bytes of a SHA-256
_ARRAY: Final = "array/"


def part_file(folder: Path, study: Study, part: Part) -> Path:
    """Where a part is kept: another argument, seed or version is another file."""
    origin = (study.name, version("truejoint"), study.version, part.key, part.arguments)
    digest = hashlib.sha256(json.dumps(origin, sort_keys=True).encode()).hexdigest()
    return folder / f"{part.key}-{digest[:16]}.part"


def write_part(path: Path, result: PartResult) -> None:
    """Write a part whole or not at all; raises RecordingError or OSError where it cannot."""
    content = io.BytesIO()
    numbers = np.frombuffer(json.dumps(result.numbers).encode(), np.uint8)
    arrays = {_ARRAY + name: values for name, values in result.arrays.items()}
    np.savez(content, allow_pickle=False, **{_NUMBERS: numbers}, **arrays)
    write_bytes(path, hashlib.sha256(content.getvalue()).digest() + content.getvalue())


def read_part(path: Path) -> PartResult | None:
    """Part that was kept; None if there is none, or it is not as it was written."""
    data = path.read_bytes() if path.is_file() else b""
    digest, content = data[:_DIGEST], data[_DIGEST:]
    if hashlib.sha256(content).digest() != digest:
        return None
    with np.load(io.BytesIO(content), allow_pickle=False) as archive:
        arrays = {name.removeprefix(_ARRAY): archive[name] for name in archive.files}
    return PartResult(json.loads(arrays.pop(_NUMBERS).tobytes()), arrays)


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file whole or not at all, over what is there; makes its folder."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, lambda temporary: temporary.write_bytes(data), overwrite=True)
