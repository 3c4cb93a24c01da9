import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from truejoint.errors import RecordingError
from truejoint.evaluation.evaluate import part_by_time, split_sides
from truejoint.recordings.datasets import DATASETS, HeldOut
from truejoint.recordings.table.recording import Provenance, Recording


def _ramp(n: int = 200, source: str = "a.csv", sha256: str = "") -> Recording:
    t = 5.0 + 0.1 * np.arange(n)
    columns = {"t": t, "measured/jaw": t, "truth/jaw": t}
    return Recording.from_columns(columns, Provenance("davinci_grasper", "", source, sha256))


@given(st.floats(0.1, 0.9))
def test_a_side_of_a_data_set_begins_a_second_after_the_other(fraction: float) -> None:
    recording = _ramp()
    split = HeldOut("", "*", test_fraction=1.0 - fraction)
    ((train,), (test,)) = split_sides([recording], DATASETS["kuka_kr300_dual_encoder"], split)
    assert train.t[0] == recording.t[0]
    assert test.t[-1] == recording.t[-1]
    assert test.t[0] - train.t[-1] >= 1.0
    assert train.duration == pytest.approx(fraction * recording.duration, abs=0.11)


@given(st.floats(0.05, 0.95))
def test_parts_that_meet_share_no_row_and_lose_none(cut: float) -> None:
    recording = _ramp()
    first, last = part_by_time(recording, 0.0, cut), part_by_time(recording, cut, 1.0)
    np.testing.assert_array_equal(np.concatenate([first.t, last.t]), recording.t)


@pytest.mark.parametrize(("begin", "end"), [(0.5, 0.5), (0.7, 0.2), (-0.1, 0.5), (0.2, 1.1)])
def test_a_part_outside_the_recording_is_refused(begin: float, end: float) -> None:
    with pytest.raises(RecordingError, match="within 0 to 1"):
        part_by_time(_ramp(), begin, end)


def test_a_part_of_one_row_is_refused() -> None:
    with pytest.raises(RecordingError, match="longer part"):
        part_by_time(_ramp(n=10), 0.0, 0.05)
