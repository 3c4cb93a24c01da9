"""Whatever is done to the bytes of a file, it is read in part or refused in one line."""

from __future__ import annotations

import gzip
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.synthetic import make_recording

from truejoint.errors import TruejointError
from truejoint.recordings import Recording, bag_topics, read_recordings, write_bag, write_parquet
from truejoint.recordings.table.parquet import recording_header
from truejoint.recordings.table.stream_file import StreamWriter

JAW = make_recording("davinci_grasper", seconds=1.0, rate=20.0)
ROBOT = {"robot": "davinci_grasper"}
SIGNED = (".parquet", ".stream")  # whose content has a hash


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


@pytest.fixture(scope="module", params=KINDS)
def whole(request, tmp_path_factory) -> tuple[str, bytes, dict[str, Any]]:
    """Suffix, content, and how a file of a kind is read."""
    suffix, (write, options) = request.param, KINDS[request.param]
    if suffix in (".bag", ".mcap"):
        pytest.importorskip("rosbags", reason="rosbags is not installed (truejoint[ros])")
    path = tmp_path_factory.mktemp("whole") / f"a{suffix}"
    write(path)
    return suffix, path.read_bytes(), options


@settings(max_examples=70)
@given(
    changes=st.lists(st.tuples(st.floats(0.0, 1.0), st.integers(0, 255)), max_size=4),
    kept=st.just(1.0) | st.floats(0.0, 1.0),
)
def test_damage_is_survived(whole, tmp_path, changes, kept):
    suffix, content, options = whole
    data = bytearray(content)
    for place, value in changes:
        data[int(place * (len(data) - 1))] = value
    data = data[: round(kept * len(data))]
    path, said, found = tmp_path / f"b{suffix}", "", list[Recording]()
    path.write_bytes(data)
    try:
        if suffix in (".bag", ".mcap"):
            bag_topics(path)
        found = read_recordings(path, **options)
    except TruejointError as error:
        said = str(error)
    assert bool(found) != bool(said)
    assert "\n" not in said
    assert found or bytes(data) != content
    for part in found if suffix in SIGNED else ():
        assert part.provenance.load == pytest.approx(JAW.provenance.load, nan_ok=True)
        np.testing.assert_array_equal(part.t, (JAW.t - JAW.t[0])[: len(part)])
        for name in part.units:
            np.testing.assert_array_equal(part.column(name), JAW.column(name)[: len(part)])
