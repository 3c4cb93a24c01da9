import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from truejoint.errors import RecordingError
from truejoint.evaluation.splits import part_by_time, split_by_time
from truejoint.recordings.table.recording import Provenance, Recording


def _ramp(n: int = 200, source: str = "a.csv", sha256: str = "") -> Recording:
    t = 5.0 + 0.1 * np.arange(n)
    columns = {"t": t, "measured/jaw": t, "truth/jaw": t}
    return Recording.from_columns(columns, Provenance("davinci_grasper", "", source, sha256))


@given(st.floats(0.1, 0.9), st.floats(0.0, 1.0))
def test_a_split_by_time_keeps_order_and_gap(fraction: float, gap: float) -> None:
    recording = _ramp()
    train, test = split_by_time(recording, fraction, gap)
    assert train.t[0] == recording.t[0]
    assert test.t[-1] == recording.t[-1]
    assert test.t[0] - train.t[-1] >= gap
    assert len(train) + len(test) <= len(recording)
    assert train.duration == pytest.approx(fraction * recording.duration, abs=0.11)


@given(st.floats(0.05, 0.95))
def test_parts_that_meet_share_no_row_and_lose_none(cut: float) -> None:
    recording = _ramp()
    first, last = part_by_time(recording, 0.0, cut), part_by_time(recording, cut, 1.0)
    np.testing.assert_array_equal(np.concatenate([first.t, last.t]), recording.t)


@pytest.mark.parametrize(
    ("fraction", "gap", "words"),
    [
        (0.0, 1.0, "between 0 and 1"),
        (1.0, 1.0, "between 0 and 1"),
        (float("nan"), 1.0, "between 0 and 1"),
        (0.5, -1.0, "0 s or more"),
        (0.5, float("nan"), "0 s or more"),
        (0.999, 0.0, "test part"),
        (0.5, 15.0, "test part"),
        (0.0001, 0.0, "training part"),
    ],
)
def test_a_split_that_leaves_nothing_is_refused(fraction: float, gap: float, words: str) -> None:
    with pytest.raises(RecordingError, match=words):
        split_by_time(_ramp(), fraction, gap)


@pytest.mark.parametrize(("begin", "end"), [(0.5, 0.5), (0.7, 0.2), (-0.1, 0.5), (0.2, 1.1)])
def test_a_part_outside_the_recording_is_refused(begin: float, end: float) -> None:
    with pytest.raises(RecordingError, match="within 0 to 1"):
        part_by_time(_ramp(), begin, end)


def test_a_part_of_one_row_is_refused() -> None:
    with pytest.raises(RecordingError, match="longer part"):
        part_by_time(_ramp(n=10), 0.0, 0.05)
