import math

import pytest

from truejoint.errors import CalibrationError
from truejoint.evaluation.results import Score
from truejoint.evaluation.verdict import judge


def _score(estimator: str, joint: str, rmse: float, unit: str = "rad") -> Score:
    return Score(estimator, joint, unit, rmse, 3 * rmse, 0.0, math.nan)


def _scores(**chosen: float) -> list[Score]:
    rows = [_score("offset", joint, math.radians(1.0)) for joint in chosen]
    return rows + [_score("dnn", joint, math.radians(value)) for joint, value in chosen.items()]


def test_without_a_tolerance_every_joint_must_beat_the_fixed_offset() -> None:
    good = judge(_scores(shoulder=0.2, elbow=0.9), "dnn")
    assert good.passed
    assert "No tolerance was stated" in good.rule
    assert "all 2 joints" in good.text
    bad = judge(_scores(shoulder=0.2, elbow=1.0), "dnn")
    assert not bad.passed
    assert [joint.passed for joint in bad.joints] == [True, False]
    assert "elbow 1.00 deg against the fixed offset's 1.00 deg" in bad.text


def test_a_stated_tolerance_decides_even_above_the_fixed_offset() -> None:
    tolerance = {"shoulder": math.radians(0.2)}
    assert judge(_scores(shoulder=0.2), "dnn", tolerance=tolerance).passed
    verdict = judge(_scores(shoulder=0.21), "dnn", tolerance=tolerance)
    assert not verdict.passed
    assert verdict.text == (
        "The neural network is not good enough in the joint: shoulder 0.210 deg against the "
        "tolerance of 0.200 deg."
    )
    assert judge(_scores(shoulder=1.5), "dnn", tolerance={"shoulder": math.radians(2)}).passed


def test_joints_without_a_tolerance_are_named_in_the_rule() -> None:
    verdict = judge(_scores(shoulder=0.1, elbow=0.5), "dnn", tolerance={"shoulder": 0.01})
    assert verdict.passed
    assert "No tolerance was stated for elbow" in verdict.rule
    assert [joint.stated for joint in verdict.joints] == [True, False]


def test_the_fixed_offset_does_not_beat_itself() -> None:
    assert not judge(_scores(shoulder=0.1), "offset").passed


def test_an_objection_forbids_a_pass_and_opens_the_sentence() -> None:
    verdict = judge(_scores(shoulder=0.1), "dnn", objections=["trained on rows of a.csv"])
    assert not verdict.passed
    assert verdict.text == "This test cannot be believed: trained on rows of a.csv."


def test_a_baseline_that_is_closer_is_named() -> None:
    scores = [*_scores(shoulder=0.5), _score("linear", "shoulder", math.radians(0.3))]
    (remark,) = judge(scores, "dnn").remarks
    assert remark == "Smaller RMSE: the linear model in shoulder (0.300 against 0.500 deg)."
    assert judge(scores, "linear").remarks == ()


@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_a_tolerance_that_is_no_length_is_refused(value: float) -> None:
    with pytest.raises(CalibrationError, match="positive number"):
        judge(_scores(shoulder=0.5), "dnn", tolerance={"shoulder": value})


def test_a_tolerance_of_an_unknown_joint_is_refused() -> None:
    with pytest.raises(CalibrationError, match="no calibrated joint called 'wrist'"):
        judge(_scores(shoulder=0.5), "dnn", tolerance={"wrist": 0.1})
