import io
import struct

import numpy as np
import pytest
import scipy.io
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from tests.recordings.refusals import refused

from truejoint.recordings.read.array_files import read_mat, read_npy


@given(
    array=arrays(
        st.sampled_from([">f8", "<f4", "<i2", "u1"]).map(np.dtype), array_shapes(max_dims=3)
    ),
    fortran=st.booleans(),
)
def test_reads_as_numpy_wrote_it(tmp_path, array, fortran):
    path = tmp_path / "a.npy"
    np.save(path, np.asfortranarray(array) if fortran else array)
    read, _ = read_npy(path)
    assert read.dtype == np.float64
    rows = array.astype(float).reshape(len(array), -1)
    assert np.array_equal(read, rows, equal_nan=True)


NO_TABLE = "does not announce an array of real numbers"


@pytest.mark.parametrize(
    ("shape", "message"),
    [
        ((10**12, 10**9), "holds 64 bytes, its header announces 8000"),
        ((-1, -8), NO_TABLE),
        ((1,) * 65, NO_TABLE),
        ((2, 4, 1, 1, 1), NO_TABLE),
        ((8,), NO_TABLE),  # of objects
    ],
)
def test_a_header_that_no_table_of_that_size_has_is_refused(tmp_path, shape, message):
    path, file = tmp_path / "a.npy", io.BytesIO()
    header = {"descr": "|O" if shape == (8,) else "<f8", "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(file, header)
    path.write_bytes(file.getvalue() + b"\0" * 64)
    refused(message, read_npy, path)


def test_small_integers_that_take_much_as_float64_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("truejoint.recordings.read.array_files.MAX_BINARY_BYTES", 800)
    np.save(tmp_path / "a.npy", np.zeros(101, np.uint8))
    refused("101 numbers take more than 800 bytes", read_npy, tmp_path / "a.npy")


matrices = st.tuples(st.integers(0, 5), st.integers(0, 5)).flatmap(
    lambda shape: arrays(
        st.sampled_from([np.float64, np.float32, np.int16, np.uint8, np.int32]).map(np.dtype), shape
    )
)


def save(variables: dict[str, object], **options: object) -> bytes:
    file = io.BytesIO()
    scipy.io.savemat(file, variables, **options)
    return file.getvalue()


@given(first=matrices, second=matrices, packed=st.booleans())
def test_version_5_reads_as_scipy_wrote_it(first, second, packed):
    data = save(
        {"a": first, "rec": {"x": second, "note": "text"}, "cell": [[1], "b"]},
        do_compression=packed,
    )
    read = read_mat(data, "f.mat")
    assert np.array_equal(read["a"], first.astype(float), equal_nan=True)
    assert np.array_equal(read["rec.x"], second.astype(float), equal_nan=True)
    assert list(read) == ["a", "rec.x"]


@given(first=matrices)
def test_version_4_reads_as_scipy_wrote_it(first):
    read = read_mat(save({"a": first, "data_1": first.T}, format="4"), "f.mat")
    assert np.array_equal(read["a"], first.astype(float), equal_nan=True)
    assert list(read) == ["a", "data_1"]


def test_what_is_not_numbers_is_stepped_over():
    data = save(
        {"z": np.array([1 + 2j]), "s": "text", "n": np.arange(3.0), "l": np.ones((2, 2, 2))}
    )
    assert list(read_mat(data, "f.mat")) == ["n"]


@pytest.mark.parametrize("bound", ["read.array_files.MAX_MAT_BYTES", "bounded_file._SMALL_BYTES"])
def test_a_bomb_is_refused(monkeypatch, bound):
    """By what variables may take at most, and by what so small a file may unpack to."""
    monkeypatch.setattr(f"truejoint.recordings.{bound}", 1000)
    data = save({"a": np.zeros((1_000_000, 1))}, do_compression=True)
    most = 1000 if "MAT" in bound else 100 * len(data)
    refused(f"unpacks to more than {most} bytes", read_mat, data, "f.mat")


def test_dimensions_that_the_data_do_not_fill_take_no_memory():
    whole = save({"abc": np.arange(12.0).reshape(3, 4)}, do_compression=False)
    at = whole.index(struct.pack("<2i", 3, 4))
    data = whole[:at] + struct.pack("<2i", 2**31 - 1, 2**31 - 1) + whole[at + 8 :]
    refused("144 bytes cannot hold an array of shape", read_mat, data, "f.mat")


def nested(depth: int, body: bytes = b"") -> bytes:
    """A struct of one field that holds a struct of one field, and so on; `body` is in the last."""
    for _ in range(depth):
        flags = struct.pack("<4I", 6, 8, 2, 0)
        shape = struct.pack("<2I2i", 5, 8, 1, 1)
        name = struct.pack("<2H4s", 1, 1, b"a")
        fields = struct.pack("<2Hi", 5, 4, 8) + struct.pack("<2I8s", 1, 8, b"x")
        inner = struct.pack("<2I", 14, len(body)) + body
        body = flags + shape + name + fields + inner
    header = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"
    return header + struct.pack("<2I", 14, len(body)) + body


def test_what_lies_deeper_than_a_struct_is_left_out():
    assert read_mat(nested(5000), "f.mat") == {}
    many = 5000
    cell = struct.pack("<4I", 6, 8, 1, 0) + struct.pack("<2I2i", 5, 8, 1, many)
    cell += struct.pack("<2H4s", 1, 1, b"c") + struct.pack("<2I", 14, 0) * many
    assert read_mat(nested(1, cell), "f.mat") == {}


def test_version_7_3_is_named():
    refused("save it with -v7", read_mat, b"\x89HDF\r\n\x1a\n" + b"\0" * 200, "f.mat")


def test_what_scipy_would_crash_on_is_refused_or_left_out():
    whole = save({"a": np.arange(12.0).reshape(3, 4), "b": np.ones((1, 1))})
    refused("cannot be read as a MAT file", read_mat, whole[:0xB1] + b"\1" + whole[0xB2:], "f.mat")
    halved = whole[:0x91] + b"\x08" + whole[0x92:]  # says that it is complex
    assert list(read_mat(halved, "f.mat")) == ["b"]
