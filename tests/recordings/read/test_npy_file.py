from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from truejoint.errors import RecordingError
from truejoint.recordings.read.array_files import read_npy

Refusal = Callable[[Callable[[], object]], str]


@given(
    array=arrays(
        st.sampled_from([">f8", "<f4", "<i2", "u1"]).map(np.dtype), array_shapes(max_dims=3)
    ),
    fortran=st.booleans(),
)
def test_reads_as_numpy_wrote_it(
    tmp_path_factory: pytest.TempPathFactory, array: np.ndarray, fortran: bool
) -> None:
    path = tmp_path_factory.mktemp("npy") / "a.npy"
    np.save(path, np.asfortranarray(array) if fortran else array)
    read, _ = read_npy(path)
    assert read.dtype == np.float64
    assert np.array_equal(read, array.astype(float), equal_nan=True)


def test_objects_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.npy"
    np.save(path, np.array([{"a": 1}, None], dtype=object), allow_pickle=True)
    with pytest.raises(RecordingError, match="does not announce an array of real numbers"):
        read_npy(path)


def test_a_header_that_promises_more_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.npy"
    file = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        file, {"descr": "<f8", "fortran_order": False, "shape": (10**12, 10**9)}
    )
    path.write_bytes(file.getvalue() + b"\0" * 80)
    with pytest.raises(RecordingError, match=r"holds 80 bytes, its header announces 8000"):
        read_npy(path)


@pytest.mark.parametrize("shape", [(-1, -8), (1,) * 65, (2, 4, 1, 1, 1)])
def test_a_shape_that_no_table_has_is_refused(tmp_path: Path, shape: tuple[int, ...]) -> None:
    path = tmp_path / "a.npy"
    file = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        file, {"descr": "<f8", "fortran_order": False, "shape": shape}
    )
    path.write_bytes(file.getvalue() + b"\0" * 64)
    with pytest.raises(RecordingError, match="does not announce an array of real numbers"):
        read_npy(path)


@given(data=st.binary(min_size=1, max_size=200), keep=st.integers(0, 128))
def test_damage_is_refused_in_one_line(
    tmp_path_factory: pytest.TempPathFactory, refusal: Refusal, data: bytes, keep: int
) -> None:
    path = tmp_path_factory.mktemp("npy") / "a.npy"
    np.save(path, np.arange(16.0))
    path.write_bytes(path.read_bytes()[:keep] + data)
    message = refusal(lambda: read_npy(path))
    assert "\n" not in message
    # Whatever stands before 128 bytes is a header that is cut short.
    assert message or keep == 128


def test_small_integers_that_take_much_as_float64_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("truejoint.recordings.read.array_files.MAX_BINARY_BYTES", 800)
    np.save(tmp_path / "a.npy", np.zeros(101, np.uint8))
    with pytest.raises(RecordingError, match="101 numbers take more than 800 bytes"):
        read_npy(tmp_path / "a.npy")
