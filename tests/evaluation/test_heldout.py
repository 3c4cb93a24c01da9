from collections.abc import Callable

import pytest

from truejoint.calibration.origin import Origin, Session
from truejoint.evaluation.evaluate import part_by_time
from truejoint.evaluation.results import Domain
from truejoint.evaluation.verdict import doubts_about, objections_to
from truejoint.recordings import DataCheck
from truejoint.recordings.table.recording import Recording

NOTHING = DataCheck((), ())
WITHIN = Domain(1.0, {}, 0.0)


@pytest.mark.parametrize("sha256", ["", "ab" * 32])
def test_rows_of_training_are_found_and_a_later_part_is_not(
    recording_of: Callable[..., Recording], sha256: str
) -> None:
    recording = recording_of("davinci_grasper", sha256=sha256, session="s", source="x/a.csv")
    train, test = part_by_time(recording, 0.0, 0.6), part_by_time(recording, 0.65, 1.0)
    origin = Origin(sessions=(Session.of(train),))
    assert not list(objections_to(origin, [test], WITHIN))
    (objection,) = objections_to(origin, [test, recording], WITHIN)
    assert "rows of a.csv" in objection


def test_another_file_at_the_same_time_was_not_seen(
    recording_of: Callable[..., Recording],
) -> None:
    train = recording_of("davinci_grasper", sha256="ab", source="a.csv")
    test = recording_of("davinci_grasper", sha256="cd", source="a.csv")
    assert not list(objections_to(Origin(sessions=(Session.of(train),)), [test], WITHIN))
    assert not list(objections_to(Origin(), [test], WITHIN))


def test_another_homing_is_said(recording_of: Callable[..., Recording]) -> None:
    test = recording_of("davinci_grasper", homing_id="h2")
    (doubt,) = doubts_about(Origin(homing_ids=("h1",)), None, [test], WITHIN, NOTHING)
    assert "h2" in doubt
    both = Origin(homing_ids=("h1", "h2"))
    assert not list(doubts_about(both, None, [test], WITHIN, NOTHING))
    assert not list(doubts_about(Origin(homing_ids=()), None, [test], WITHIN, NOTHING))
