"""A small file of every kind of recordings, and what may come of it once its bytes are damaged."""

import contextlib
import gzip
import struct
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import scipy.io
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_typestore
from tests.synthetic import make_recording

from truejoint.errors import TruejointError
from truejoint.recordings import Recording, bag_topics, read_recordings, write_bag, write_parquet
from truejoint.recordings.table.parquet import recording_header
from truejoint.recordings.table.stream_file import StreamWriter

JAW = make_recording("davinci_grasper", seconds=1.0, rate=20.0)
ROBOT = {"robot": "davinci_grasper"}


def by(t: object, measured: object) -> dict[str, Any]:
    return {"column_map": {**ROBOT, "columns": {"t": t, "measured/jaw": measured}}}


def _stream(path: Path) -> None:
    header = recording_header(JAW.provenance, JAW.robot)
    writer = StreamWriter(path, {**header, "gap_limit": 0.1, "state_rate": None})
    for rows in (slice(10), slice(10, None)):
        columns = {name: JAW.column(name)[rows] for name in JAW.units if "truth" not in name}
        writer.write("state", JAW.t[rows], columns)
    writer.close()


def _text(path: Path, pack: Callable[[bytes], bytes] = bytes) -> None:
    path.write_bytes(pack(JAW.table.to_csv(index=False).encode()))


ROWS = JAW.table.to_numpy()
MAT = {"time": ROWS[:, 0], "q": ROWS[:, 1]}
KINDS: dict[str, tuple[Callable[[Path], Any], dict[str, Any]]] = {
    ".parquet": (lambda path: write_parquet(JAW, path), {}),
    ".stream": (_stream, {}),
    ".csv": (_text, ROBOT),
    ".csv.gz": (lambda path: _text(path, gzip.compress), ROBOT),
    ".npy": (lambda path: np.save(path, ROWS), by(0, 1)),
    ".4.mat": (lambda path: scipy.io.savemat(path, MAT, format="4"), by("time", "q")),
    ".mat": (lambda path: scipy.io.savemat(path, MAT, do_compression=True), by("time", "q")),
    ".bag": (lambda path: write_bag(JAW, path), ROBOT),
    ".mcap": (lambda path: write_bag(JAW, path), ROBOT),
}


def _number(cell: str | None) -> float:
    with contextlib.suppress(TypeError, ValueError):
        return float(cell)
    return np.nan


def _of_text(data: bytes) -> pd.DataFrame:
    plain = gzip.decompress(data) if data[:2] == b"\x1f\x8b" else data
    text = plain.decode("utf-8-sig", "replace")
    lines = [line.partition("#")[0].split(",") for line in text.splitlines()]
    lines = [[cell.strip().strip('"') for cell in line] for line in lines if line != [""]]
    return pd.DataFrame(lines[1:], columns=lines[0]).map(_number)


def _of_bag(path: Path, read: Any, deserialize: str) -> pd.DataFrame:
    rows = []
    store = get_typestore(Stores.ROS1_NOETIC if path.suffix == ".bag" else Stores.ROS2_HUMBLE)
    for connection, _, raw in read:
        if connection.topic == "/measured_js":
            state = getattr(store, deserialize)(raw, connection.msgtype)
            stamp = state.header.stamp
            cells = {"measured/jaw": state.position[0], "effort/jaw": (*state.effort, np.nan)[0]}
            rows.append({"t": stamp.sec + 1e-9 * stamp.nanosec, **cells})
    return pd.DataFrame(rows)


def _of_ros1(path: Path) -> pd.DataFrame:
    with rosbag1.Reader(path) as bag:
        return _of_bag(path, bag.messages(), "deserialize_ros1")


def _of_mcap(path: Path) -> pd.DataFrame:
    with rosbag2.Reader(path) as bag:
        return _of_bag(path, bag.messages(), "deserialize_cdr")


def _of_arrays(path: Path) -> pd.DataFrame:
    return pd.DataFrame(np.load(path)[:, :2], columns=["t", "measured/jaw"])


def _of_mat4(path: Path) -> pd.DataFrame:
    data, columns = path.read_bytes(), dict[str, Any]()
    with contextlib.suppress(Exception):  # what stands before something else is read all the same
        while data:
            kind, rows, count, _, length = struct.unpack_from("<5i", data)
            name, begin = data[20 : 20 + length - 1].decode(), 20 + length
            dtype = np.dtype({0: "<f8", 10: "<f4", 20: "<i4", 30: "<i2", 40: "<u2", 50: "u1"}[kind])
            columns[name] = np.frombuffer(data, dtype, rows * count, begin)
            data = data[begin + columns[name].nbytes :]
    return pd.DataFrame({"t": columns["time"], "measured/jaw": columns["q"]})


READERS: dict[str, Callable[[Path], pd.DataFrame]] = {
    ".csv": lambda path: _of_text(path.read_bytes()),
    ".csv.gz": lambda path: _of_text(path.read_bytes()),
    ".npy": _of_arrays, ".4.mat": _of_mat4, ".bag": _of_ros1, ".mcap": _of_mcap,
}  # fmt: skip
"""Readers that share nothing with those under test, of kinds whose numbers have no checksum."""


def check_rows(path: Path, found: list[Recording]) -> None:
    """Each row that was read is one of the file as others read it, or one of before the damage.

    Times may count from another beginning. What a checksum covers is that of before alone. Where
    others give a bag up its numbers must at least stand in it.
    """
    known = [JAW.table]
    with contextlib.suppress(Exception), warnings.catch_warnings(action="ignore"):
        known += [READERS["".join(path.suffixes)](path)]
    for part in found:
        names = [name for name in part.units if name in ("measured/jaw", "effort/jaw")]
        rows = [table.reindex(columns=["t", *names]).to_numpy(float) for table in known]
        t, cells = np.array(part.t), part.table[names].to_numpy(float)
        alike = [_find(table, t, cells) for table in rows]
        if len(known) == 1 and path.suffix in (".bag", ".mcap"):  # others give it up
            data = path.read_bytes()
            alike += [[all(struct.pack("<d", cell) in data for cell in row) for row in cells]]
        assert np.any(alike, axis=0).all(), part.table[~np.any(alike, axis=0)]


def _find(table: Any, t: Any, cells: Any) -> Any:
    """Rows whose cells stand in a table, as long after another row as there (n,)."""
    at = [np.flatnonzero((table[:, 1:] == row).all(axis=1)) for row in cells]
    shifts = [t[i] - table[j, 0] for i, rows in enumerate(at) for j in rows]
    if not shifts:
        return np.zeros(len(t), dtype=bool)
    shift = max(shifts, key=lambda one: np.isclose(one, shifts, rtol=0, atol=1e-6).sum())
    close = [np.isclose(t[i] - table[rows, 0], shift, atol=1e-6) for i, rows in enumerate(at)]
    return np.array([one.any() for one in close])


def read_damaged(path: Path, options: dict[str, Any]) -> str:
    """Read what may be damaged and check it; what was said where it was refused."""
    try:
        if path.suffix in (".bag", ".mcap"):
            bag_topics(path)
        found = read_recordings(path, **options)
    except TruejointError as error:
        return str(error)
    check_rows(path, found)
    return "" if found else "\n"
