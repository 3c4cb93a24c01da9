"""Regressors of scikit-learn as bytes in which there is no code, by the package skops."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from sklearn.gaussian_process import kernels

from truejoint.array_types import Array
from truejoint.errors import CalibrationError
from truejoint.estimators.scikit_learn import MAX_BYTES
from truejoint.extras import require

MAX_UNPACKED: Final = 512 * 2**20

_TRUSTED: Final = [
    "sklearn.utils._bunch.Bunch",
    *(f"{kernels.__name__}.{name}" for name, cls in vars(kernels).items() if isinstance(cls, type)),
    "sklearn.neural_network._stochastic_optimizers.AdamOptimizer",
    "sklearn.neural_network._stochastic_optimizers.SGDOptimizer",
]
"""Classes in plain Python beyond those that skops trusts."""

_ADVICE: Final = {
    "Tree": "take random forest, extra trees or gradient boosting by itself",
    "TreePredictor": "take a loss without a link function and features without categories",
    "KDTree": "set algorithm='brute'",
    "BallTree": "set algorithm='brute'",
}
"""What to do about the classes that look into memory wherever a file tells them to."""


def to_words(parts: Sequence[object]) -> tuple[Array, int]:
    """Archive of regressors: its bytes, four to a number, and how many; raises CalibrationError."""
    data = _dumped(list(parts))
    if isinstance(data, str):
        for part in parts:
            check_savable(part)
        raise CalibrationError(f"{type(parts[0]).__name__} cannot be saved without code: {data}")
    if len(data) > MAX_BYTES:
        raise CalibrationError(
            f"{type(parts[0]).__name__} takes {len(data)} bytes, more than the {MAX_BYTES} that a "
            "model file holds; fit it at a lower rate"
        )
    padded = data + b"\0" * (-len(data) % 4)
    return np.frombuffer(padded, dtype="<u4").astype(np.float64), len(data)


def from_words(words: Array, n_bytes: int) -> list[Any]:
    """Regressors of an archive; raises CalibrationError if it is damaged or not to be trusted."""
    if not ((words >= 0) & (words < 2**32) & (words == np.floor(words))).all():
        raise CalibrationError("the archive of the regressor is damaged: it is no bytes")
    data = words.astype("<u4").tobytes()[:n_bytes]
    skops = require("skops.io", "skops", "this calibration")
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            size = sum(entry.file_size for entry in archive.infolist())
        if size > MAX_UNPACKED:
            raise ValueError(f"it unpacks to {size} bytes, more than {MAX_UNPACKED}")
        parts = skops.loads(data, trusted=_TRUSTED)
    except Exception as error:  # noqa: BLE001  # whatever damaged bytes lead to
        raise CalibrationError(
            f"the archive of the regressor is damaged or holds what is not trusted "
            f"({one_line(error)})"
        ) from None
    if not isinstance(parts, list) or not all(hasattr(part, "predict") for part in parts):
        raise CalibrationError("the archive of the regressor holds no regressors")
    return parts


def check_savable(regressor: Any, where: str = "") -> None:
    """Raise CalibrationError, naming the step of a pipeline, if it cannot be saved."""
    refused = _dumped(regressor)
    if not isinstance(refused, str):
        return
    for name, step in getattr(regressor, "steps", []):
        check_savable(step, f"step {name!r}, ")
    advice = _ADVICE.get(refused.rpartition(".")[2], "take one of scikit-learn's")
    raise CalibrationError(
        f"{where}{type(regressor).__name__} cannot be saved without code, because of {refused}: "
        f"{advice}"
    )


def one_line(error: Exception) -> str:
    """Class and message of an error that others raised, cut to a line."""
    return " ".join(f"{type(error).__name__}: {error}".split())[:300]


def _dumped(regressor: Any) -> bytes | str:
    """Archive of a regressor, or what in it cannot be saved."""
    kind = type(regressor[0] if isinstance(regressor, list) else regressor).__name__
    skops = require("skops.io", "skops", f"keeping {kind} in a file")
    try:
        data: bytes = skops.dumps(regressor, compression=zipfile.ZIP_DEFLATED)
        odd = [kind for kind in skops.get_untrusted_types(data=data) if kind not in _TRUSTED]
    except Exception as error:  # noqa: BLE001  # objects of others may raise anything
        return one_line(error)
    return odd[-1] if odd else data
