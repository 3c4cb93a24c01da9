"""The container of a model: a safetensors file whose header holds a JSON description.

Nothing in a file is ever run. Size, header, shapes and the hash are checked before any number is
used.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import safetensors
import safetensors.numpy

from truejoint.array_types import Array
from truejoint.errors import ModelFileError, other_kind
from truejoint.files import (
    canonical_json,
    content_hash,
    is_as_written,
    read_small,
    write_atomically,
)

FORMAT_VERSION: Final = 6
MAX_FILE_BYTES: Final = 256 * 2**20  # a forest of a hundred full trees takes half of it
MAX_HEADER_BYTES: Final = 2**20
MAX_TENSORS: Final = 512

_KEY: Final = "truejoint"
_OTHER_FORMATS: Final = frozenset(
    {".c", ".csv", ".h", ".html", ".json", ".mat", ".npy", ".onnx", ".parquet", ".pkl", ".toml"}
)
_DAMAGED: Final = "the file is damaged or was edited; copy or calibrate it again"


def check_name(path: str | os.PathLike[str]) -> Path:
    """Path of a model file to write; raises ModelFileError when its ending is another format's."""
    path = Path(path)
    if path.suffix.lower() in _OTHER_FORMATS:
        raise ModelFileError(
            f"{path}: a model file is not {path.suffix}; call it "
            f"{path.with_suffix('.safetensors').name}, and see `truejoint export` for C and ONNX"
        )
    return path


def write_model_file(
    path: str | os.PathLike[str],
    description: Mapping[str, Any],
    arrays: Mapping[str, Array],
    *,
    overwrite: bool = False,
) -> None:
    """Write JSON values and float64 arrays of one or two dimensions, whole or not at all.

    Raises ModelFileError if the file exists, is named like another format, cannot be written, or
    would break a bound that reading enforces.
    """
    path = check_name(path)
    data = to_bytes(description, arrays)
    try:
        from_bytes(data)
    except ModelFileError as error:
        raise ModelFileError(f"{path} is not written, it could not be read back: {error}") from None
    write_atomically(
        path, lambda part: part.write_bytes(data), overwrite=overwrite, error=ModelFileError
    )


def read_model_file(path: str | os.PathLike[str]) -> tuple[dict[str, Any], dict[str, Array]]:
    """Read the description and the arrays of a model file.

    Raises ModelFileError if it is missing, too large, truncated, edited, or of another format.
    """
    if not isinstance(path, str | os.PathLike):
        raise ModelFileError(other_kind(path, "path", "give that of a model file"))
    path = Path(path)
    data = read_small(path, ModelFileError, MAX_FILE_BYTES, "a model")
    try:
        return from_bytes(data)
    except ModelFileError as error:
        raise ModelFileError(f"{path}: {error}") from None


def to_bytes(description: Mapping[str, Any], arrays: Mapping[str, Array]) -> bytes:
    """Bytes of a model file; the same for the same model."""
    arrays = {name: np.ascontiguousarray(array, dtype="<f8") for name, array in arrays.items()}
    versioned = {**description, "format": FORMAT_VERSION}
    signed = {**versioned, "sha256": content_hash(versioned, arrays)}
    return bytes(safetensors.numpy.save(arrays, metadata={_KEY: canonical_json(signed)}))


def from_bytes(data: bytes) -> tuple[dict[str, Any], dict[str, Array]]:
    """Give description and arrays of the bytes of a model file; raises ModelFileError."""
    if len(data) > MAX_FILE_BYTES:
        raise ModelFileError(
            f"larger than {MAX_FILE_BYTES} bytes, which no truejoint model is; {_DAMAGED}"
        )
    if data[:4] == b"PAR1":
        raise ModelFileError("is a Parquet file, as recordings are; name the model file here")
    length = int.from_bytes(data[:8], "little")
    if len(data) < 8 or length > min(MAX_HEADER_BYTES, len(data) - 8):
        raise ModelFileError(
            f"{len(data)} bytes with a header said to have {length}: not a safetensors file of "
            f"truejoint, or cut short; {_DAMAGED}"
        )
    try:
        arrays = safetensors.numpy.load(data)
    except (safetensors.SafetensorError, KeyError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise ModelFileError(f"its arrays cannot be read ({reason:.80}); {_DAMAGED}") from None
    description = _description(data[8 : 8 + length])
    version = description.pop("format", None)
    if version is True or version != FORMAT_VERSION:
        is_newer = isinstance(version, int) and version > FORMAT_VERSION
        word, advice = (
            ("newer than", "update truejoint") if is_newer else ("not", "calibrate again")
        )
        raise ModelFileError(
            f"format version {version!r:.40} is {word} {FORMAT_VERSION}, the newest that this "
            f"truejoint reads; {advice}"
        )
    if len(arrays) > MAX_TENSORS:
        raise ModelFileError(f"{len(arrays)} tensors, more than {MAX_TENSORS}; {_DAMAGED}")
    for name, array in arrays.items():
        if array.dtype != np.float64 or array.ndim not in (1, 2):
            raise ModelFileError(f"tensor {name!r:.60} has a wrong type or shape; {_DAMAGED}")
    digest = description.pop("sha256", None)
    if not is_as_written(digest, {**description, "format": FORMAT_VERSION}, arrays):
        raise ModelFileError(f"its content does not match its hash; {_DAMAGED}")
    return description, {name: np.array(array) for name, array in arrays.items()}


def _description(header: bytes) -> dict[str, Any]:
    """Give the JSON object that stands in the header, which safetensors has checked."""
    metadata = json.loads(header).get("__metadata__", {})
    if _KEY not in metadata:
        raise ModelFileError(
            f"a safetensors file without truejoint's part in its header; {_DAMAGED}"
        )
    try:
        description = json.loads(metadata[_KEY], parse_constant=int)  # refuses NaN and Infinity
    except (ValueError, RecursionError):
        description = None
    if not isinstance(description, dict):
        raise ModelFileError(f"the model description is not a JSON object; {_DAMAGED}")
    return description
