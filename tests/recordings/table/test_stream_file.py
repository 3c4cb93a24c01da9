"""Tests of the stream file: whatever ends a recorder, what it wrote is there."""

from pathlib import Path

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.recordings.refusals import refused

from truejoint.errors import RecordingError
from truejoint.recordings import read_recording
from truejoint.recordings.table.stream_file import StreamWriter, read_streams
from truejoint.robots import get_robot

ROBOT = get_robot("forceps")
HEADER = {
    "provenance": {"robot": "forceps"},
    "robot": ROBOT.to_dict(),
    "gap_limit": 0.05,
    "state_rate": None,
}
BLOCKS = 6


def write(path: Path) -> list[int]:
    """Six blocks of ten rows of the state and five of the truth; sizes after each pair."""
    writer, ends = StreamWriter(path, HEADER), []
    for k in range(BLOCKS):
        t = k + np.arange(10) * 0.1
        writer.write("state", t, {"measured/jaw": np.sin(t), "motor/jaw": 30.0 * np.sin(t)})
        writer.write("truth", t[::2], {"truth/jaw": np.sin(t[::2]) + 0.01})
        ends.append(path.stat().st_size)
    writer.close()
    return ends


def test_a_whole_file_gives_all_streams(tmp_path):
    write(tmp_path / "run.stream")
    header, streams, end = read_streams(tmp_path / "run.stream")
    assert header["gap_limit"] == 0.05
    assert (len(streams["state"].t), len(streams["truth"].t), end) == (60, 30, "")
    t = streams["state"].t
    assert np.array_equal(streams["state"].columns["motor/jaw"], 30.0 * np.sin(t))
    recording = read_recording(tmp_path / "run.stream")
    assert recording.units["measured/jaw"] == "rad"
    assert recording.joints_of("truth") == ("jaw",)


@settings(max_examples=60)
@given(share=st.floats(0.0, 1.0))
def test_cut_anywhere_it_gives_the_blocks_before(tmp_path, share):
    whole, cut = tmp_path / "run.stream", tmp_path / "cut.stream"
    whole.unlink(missing_ok=True)
    ends = write(whole)
    content = whole.read_bytes()
    size = round(share * len(content))
    cut.write_bytes(content[:size])
    try:
        _, streams, end = read_streams(cut)
    except RecordingError:
        assert size < ends[0]
        return
    assert bool(end) == (size < len(content))
    pairs = sum(end <= size for end in ends)
    state = streams.get("state")
    found = 0 if state is None else len(state.t)
    assert found in (10 * pairs, 10 * pairs + 10)
    if state is not None:
        assert np.array_equal(state.columns["measured/jaw"], np.sin(state.t))


def test_what_is_no_such_file_is_refused(tmp_path):
    path = tmp_path / "run.stream"
    path.write_text("not a stream")
    refused("is no stream of a recorder", read_streams, path)
    refused("choose another name", StreamWriter, path, {})
    path.unlink()
    StreamWriter(path, {}).close()
    refused("metadata is damaged", read_recording, path)
    path.unlink()
    writer = StreamWriter(path, HEADER)
    refused("no rows: cut short while it was recorded", read_recording, path)
    writer.close()
    refused("0 rows", read_recording, path)
