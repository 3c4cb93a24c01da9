from collections.abc import Callable
from typing import Any

import pytest

from truejoint.evaluation.splits import split_by_time
from truejoint.evaluation.verdict import doubts_about, objections_to
from truejoint.recordings import DataCheck
from truejoint.recordings.table.recording import Recording

NOTHING = DataCheck((), ())


def _session(recording: Recording) -> dict[str, Any]:
    own = recording.provenance
    return {
        "source": own.source,
        "sha256": own.sha256,
        "session": own.session,
        "first": float(recording.t[0]),
        "last": float(recording.t[-1]),
    }


@pytest.mark.parametrize("sha256", ["", "ab" * 32])
def test_rows_of_training_are_found_and_a_later_part_is_not(
    recording_of: Callable[..., Recording], sha256: str
) -> None:
    recording = recording_of("davinci_grasper", sha256=sha256, session="s", source="x/a.csv")
    train, test = split_by_time(recording, 0.6, gap=1.0)
    metadata = {"sessions": [_session(train)]}
    assert not list(objections_to(metadata, [test], None))
    (objection,) = objections_to(metadata, [test, recording], None)
    assert "rows of a.csv" in objection


def test_another_file_at_the_same_time_was_not_seen(
    recording_of: Callable[..., Recording],
) -> None:
    train = recording_of("davinci_grasper", sha256="ab", source="a.csv")
    test = recording_of("davinci_grasper", sha256="cd", source="a.csv")
    assert not list(objections_to({"sessions": [_session(train)]}, [test], None))
    assert not list(objections_to({}, [test], None))


def test_another_homing_is_said(recording_of: Callable[..., Recording]) -> None:
    test = recording_of("davinci_grasper", homing_id="h2")
    (doubt,) = doubts_about({"homing_ids": ["h1"]}, [test], None, NOTHING)
    assert "h2" in doubt
    assert not list(doubts_about({"homing_ids": ["h1", "h2"]}, [test], None, NOTHING))
    assert not list(doubts_about({"homing_ids": []}, [test], None, NOTHING))
