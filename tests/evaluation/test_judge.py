"""What the loop would refuse, the evaluation says."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from truejoint.calibration import Calibration, calibrate
from truejoint.errors import TruejointError
from truejoint.evaluation import evaluate
from truejoint.recordings.table.recording import Recording
from truejoint.runtime import Corrector


@pytest.fixture(scope="module")
def model(recording_of: Callable[..., Recording]) -> Calibration:
    return calibrate([recording_of("davinci_grasper", seed=i) for i in range(3)], "linear")


@pytest.fixture
def test(recording_of: Callable[..., Recording]) -> Recording:
    return recording_of("davinci_grasper", seed=7)


def _shifted(recording: Recording, rows: slice, **shifts: float) -> Recording:
    table = recording.table.copy()
    for name, shift in shifts.items():
        column = table.columns.get_loc(f"{name}/jaw")
        table.iloc[rows, column] += shift
    return replace(recording, table=table)


def test_status_is_that_of_the_loop(model: Calibration, test: Recording) -> None:
    strange = _shifted(test, slice(100, 300), measured=0.8, truth=0.8)
    corrector = Corrector(model)
    corrector.set_homing(True)
    expected = []
    for i, t in enumerate(strange.t):
        sample = [strange.column(name)[i] for name in corrector.signals]
        expected.append(int(corrector.step(float(t), sample)))
    trace = evaluate(model, strange).traces[0]
    assert trace.status is not None
    np.testing.assert_array_equal(trace.status, expected)


def test_errors_inside_and_outside_stand_apart(model: Calibration, test: Recording) -> None:
    strange = _shifted(test, slice(100, 300), measured=0.8, truth=0.8)
    evaluation = evaluate(model, strange)
    score, inside = evaluation.score("linear", "jaw"), evaluation.traces[0].inside
    error = evaluation.error("linear", 0)
    assert score.rmse_inside == pytest.approx(np.sqrt(np.mean(error[inside] ** 2)))
    assert score.rmse_outside == pytest.approx(np.sqrt(np.mean(error[~inside] ** 2)))
    assert evaluation.domain.inside == inside.mean()
    assert evaluation.verdict.level == "warn"
    assert any("pass the raw position" in doubt for doubt in evaluation.verdict.doubts)


def test_another_instrument_is_called_that(model: Calibration, test: Recording) -> None:
    other = _shifted(test, slice(None), measured=0.9)
    verdict = evaluate(model, other).verdict
    assert verdict.level == "fail"
    assert "another instrument" in verdict.text
    moved = evaluate(model, _shifted(test, slice(None), truth=0.4))
    assert moved.domain.inside > 0.9  # the inputs are as in training; only the truth tells
    assert "a zero that has moved" in moved.verdict.text


def test_a_moved_zero_is_no_objection_once_re_zeroed(model: Calibration, test: Recording) -> None:
    moved = _shifted(test, slice(None), truth=0.4)
    found = evaluate(model, moved, rezero=2.0)
    assert found.domain.beyond == 0.0
    assert found.verdict.objections == ()
    at_zero = evaluate(model, test, rezero=2.0).domain
    assert at_zero is not None
    assert found.domain.inside == at_zero.inside


def test_a_joint_worse_than_raw_does_not_pass(model: Calibration, test: Recording) -> None:
    error = test.column("measured/jaw") - test.column("truth/jaw")
    moved = _shifted(test, slice(None), truth=0.75 * float(error.mean()))
    verdict = evaluate(model, moved).verdict
    assert verdict.level == "fail"
    assert "the raw position's" in verdict.text
    assert verdict.deploy == "raw"
    assert verdict.advice.startswith("Deploy none")


def test_a_failed_data_check_is_no_green_pass(model: Calibration, test: Recording) -> None:
    table = test.table.copy()
    table.loc[table.index % 5 > 1, "truth/jaw"] = np.nan
    evaluation = evaluate(model, replace(test, table=table))
    assert evaluation.check.failed
    assert evaluation.verdict.level == "warn"
    assert evaluation.to_dict()["check"]["findings"][0]["level"] == "fail"
    assert any("data check failed" in doubt for doubt in evaluation.verdict.doubts)
    accepted = evaluation.check.accept(["missing"])
    assert not accepted.failed
    verdict = evaluate(model, replace(test, table=table), check=accepted).verdict
    assert verdict.level == "warn"
    assert any("which was accepted" in doubt for doubt in verdict.doubts)
    of_training = evaluate(
        replace(model, origin=replace(model.origin, accepted=("outliers",))), test
    ).verdict
    assert of_training.level == "warn"
    assert "data check failed (outliers)" in of_training.doubts[0]


def test_a_calibration_without_a_training_range_is_refused(
    model: Calibration, test: Recording
) -> None:
    with pytest.raises(TruejointError, match="calibrate it again"):
        evaluate(replace(model, training_domain=None), test)
