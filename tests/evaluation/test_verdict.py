import math

import numpy as np
import pandas as pd
import pytest
from pandas import DataFrame

from truejoint.calibration.origin import Origin, Session
from truejoint.errors import CalibrationError
from truejoint.evaluation.evaluate import part_by_time
from truejoint.evaluation.paired_test import compare
from truejoint.evaluation.results import Domain
from truejoint.evaluation.verdict import PLAIN, advise, doubts_about, judge, objections_to
from truejoint.recordings import DataCheck, Recording


def _scores(**chosen):
    rows = [("offset", joint, math.radians(1.0)) for joint in chosen]
    rows += [("dnn", joint, math.radians(value)) for joint, value in chosen.items()]
    return DataFrame(rows, columns=["estimator", "joint", "rmse"]).assign(unit="rad")


def test_without_a_tolerance_every_joint_must_beat_the_fixed_offset():
    good = judge(_scores(shoulder=0.2, elbow=0.9), "dnn")
    assert good.passed
    assert "No tolerance was stated" in good.rule
    assert "all 2 joints" in good.text
    bad = judge(_scores(shoulder=0.2, elbow=1.0), "dnn")
    assert not bad.passed
    assert [joint.passed for joint in bad.joints] == [True, False]
    assert "elbow 1.00 deg against the fixed offset's 1.00 deg" in bad.text
    simple = pd.concat([_scores(elbow=0.2), _scores(elbow=0.1).tail(1).assign(estimator="linear")])
    assert "0.200 deg against the linear model's 0.100 deg" in judge(simple, "dnn").text


def test_a_stated_tolerance_decides_even_above_the_fixed_offset():
    tolerance = {"shoulder": math.radians(0.2)}
    assert judge(_scores(shoulder=0.2), "dnn", tolerance=tolerance).passed
    verdict = judge(_scores(shoulder=0.21), "dnn", tolerance=tolerance)
    assert not verdict.passed
    assert verdict.text == (
        "The neural network is not good enough in the joint: shoulder 0.210 deg against the "
        "tolerance of 0.200 deg."
    )
    assert judge(_scores(shoulder=1.5), "dnn", tolerance={"shoulder": math.radians(2)}).passed


def test_joints_without_a_tolerance_are_named_in_the_rule():
    verdict = judge(_scores(shoulder=0.1, elbow=0.5), "dnn", tolerance={"shoulder": 0.01})
    assert verdict.passed
    assert "No tolerance was stated for elbow" in verdict.rule
    assert [joint.stated for joint in verdict.joints] == [True, False]


def test_the_fixed_offset_does_not_beat_itself():
    assert not judge(_scores(shoulder=0.1), "offset").passed


def test_an_objection_forbids_a_pass_and_opens_the_sentence():
    verdict = judge(_scores(shoulder=0.1), "dnn", objections=["trained on rows of a.csv"])
    assert not verdict.passed
    assert verdict.text == "This test cannot be believed: trained on rows of a.csv."


@pytest.mark.parametrize(
    ("tolerance", "said"),
    [({"shoulder": value}, "positive number") for value in (0.0, -1.0, math.nan, math.inf)]
    + [({"wrist": 0.1}, "no calibrated joint called 'wrist'")],
)
def test_a_tolerance_that_is_no_length_of_a_joint_is_refused(tolerance, said):
    with pytest.raises(CalibrationError, match=said):
        judge(_scores(shoulder=0.5), "dnn", tolerance=tolerance)


NOTHING = DataCheck((), ())
WITHIN = Domain(1.0, {}, 0.0)


@pytest.mark.parametrize("sha256", ["", "ab" * 32])
def test_rows_of_training_are_found_and_a_later_part_is_not(recording_of, sha256):
    recording = recording_of("davinci_grasper", sha256=sha256, session="s", source="x/a.csv")
    train, test = part_by_time(recording, 0.0, 0.6), part_by_time(recording, 0.65, 1.0)
    origin = Origin(sessions=(Session.of(train),))
    assert not list(objections_to(origin, [test], WITHIN))
    (objection,) = objections_to(origin, [test, recording], WITHIN)
    assert "rows of a.csv" in objection


def test_another_file_at_the_same_time_was_not_seen(recording_of):
    train = recording_of("davinci_grasper", sha256="ab", source="a.csv")
    test = recording_of("davinci_grasper", sha256="cd", source="a.csv")
    assert not list(objections_to(Origin(sessions=(Session.of(train),)), [test], WITHIN))
    assert not list(objections_to(Origin(), [test], WITHIN))
    (refused,) = objections_to(Origin(), [test], Domain(0.4, {"SPIKE": 0.6}, 0.0))
    assert "the loop would refuse 60 % of the rows (SPIKE 60 %)" in refused
    unnamed = recording_of("davinci_grasper")
    columns = unnamed.table.assign(**{"measured/jaw": -unnamed.column("measured/jaw")})
    other = Recording.from_columns(columns, unnamed.provenance, unnamed.units)
    origin = Origin(sessions=(Session.of(unnamed),))
    assert not list(objections_to(origin, [other], WITHIN))
    assert list(objections_to(origin, [part_by_time(unnamed, 0.4, 0.5)], WITHIN))


def test_another_homing_is_said(recording_of):
    test = recording_of("davinci_grasper", homing_id="h2")
    (doubt,) = doubts_about(Origin(homing_ids=("h1",)), None, [test], WITHIN, NOTHING)
    assert "h2" in doubt
    both = Origin(homing_ids=("h1", "h2"))
    assert not list(doubts_about(both, None, [test], WITHIN, NOTHING))
    assert not list(doubts_about(Origin(homing_ids=()), None, [test], WITHIN, NOTHING))


NOISE = np.random.default_rng(0).normal(size=(5, 2, 800, 1))


def _frames(*tests, legs=40):
    """Errors and rows of a test for each mapping of sizes of errors, by estimator."""
    errors, rows = [], []
    for number, sizes in enumerate(tests):
        own = {name: size * NOISE[k, number] for k, (name, size) in enumerate(sizes.items())}
        for name, error in own.items():
            error[::10] = 0.0 if name == "dnn" else 100.0  # rows that the loop refuses
        index = [number] * 800
        errors.append(pd.concat({n: DataFrame(e, index, ["jaw"]) for n, e in own.items()}, axis=1))
        way = np.where(np.arange(800) * legs // 800 % 2, -1.0, 1.0)
        known = {("inside", ""): np.arange(800) % 10 > 0, ("direction", "jaw"): way}
        rows.append(DataFrame(known, index))
    return pd.concat(errors), pd.concat(rows)


BASE = {"raw": 9.0, "offset": 1.0}


@pytest.mark.parametrize(
    ("sizes", "deploy"),
    [
        ({"linear": 0.5, "dnn": 0.3}, "dnn"),
        ({"linear": 0.5, "dnn": 0.5}, ""),  # 800 rows cannot tell 5 %
        ({"raw": 0.3, "linear": 0.5, "dnn": 0.4}, "raw"),
        ({"mine": 0.5, "dnn": 0.3}, "dnn"),
        ({"mine": 0.5, "dnn": 0.8}, "mine"),
        ({"linear": 0.5, "poly2": 0.4, "dnn": 0.3}, "dnn"),
    ],
)
def test_a_model_is_advised_that_no_other_beats_by_the_margin(sizes, deploy):
    found = advise(*_frames(*[BASE | sizes] * 2), "dnn", plain=PLAIN | {"mine"})
    assert found.deploy == deploy
    assert set(found.rivals) == ({"linear", "dnn"} if not deploy else set())
    assert ("Keep" in found.text) == (deploy == "dnn")
    assert ("error more than 5 % smaller in the rows" in found.text) == bool(deploy)


@pytest.mark.parametrize("legs", [1, 2, 7])
def test_a_test_of_few_motions_to_and_fro_tells_nothing_however_far_apart(legs):
    frames = _frames(BASE | {"linear": 0.2, "dnn": 0.8}, legs=legs)
    found = advise(*frames, "dnn", automatic=False)
    assert found.deploy == ""
    for words in ("cannot be told", "keep the neural network", "longer motion", "-e auto"):
        assert words in found.text
    verdict = judge(_scores(shoulder=0.5), "dnn", advice=found)
    assert (verdict.deploy, verdict.advice) == ("", found.text)
    assert verdict.level == "pass", "what cannot be told is no reservation"


def test_nearly_the_same_model_is_kept_plain():
    errors, rows = _frames(BASE | {"linear": 0.5})
    errors["dnn", "jaw"] = errors["linear", "jaw"]
    assert advise(errors, rows, "dnn").deploy == "linear"


def test_a_joint_that_no_model_helps_hides_no_other():
    errors, rows = _frames(BASE | {"linear": 0.2, "dnn": 0.05})
    for name in errors.columns.unique(0):
        errors[name, "wrist"] = NOISE[4, 1]
    rows["direction", "wrist"] = rows["direction", "jaw"]
    assert advise(errors, rows, "dnn").deploy == "dnn"


def test_tests_count_together_or_each_by_itself():
    good = {"raw": 2.0, "offset": 1.0, "dnn": 0.5}
    assert advise(*_frames(good)).deploy == "dnn"
    assert advise(*_frames(good, good | {"dnn": 4.0})).deploy == ""
    sizes = {"raw": 9.0, "offset": 9.0, "linear": 0.5, "dnn": 0.45}
    errors, rows = _frames(*(sizes | {"linear": own} for own in (0.6, 5.0)))
    counted = errors[rows["inside"].to_numpy()]
    pair = ([counted.loc[row, name].to_numpy() for row in range(2)] for name in ("dnn", "linear"))
    assert compare(*pair).outcome == "cannot be told", "the case shows nothing"
    assert advise(errors, rows).deploy == "dnn"


def test_where_another_is_advised_the_sentence_says_how_to_get_it():
    frames = _frames(*[BASE | {"linear": 0.2, "dnn": 0.8}] * 2)
    found = advise(*frames, "dnn", automatic=False)
    assert found.deploy == "linear"
    assert "Deploy the linear model instead (`truejoint calibrate -e linear`)" in found.text
    assert "-e auto" in found.text
    assert "-e auto" not in advise(*frames, "dnn").text
    assert "instead" not in advise(*frames).text
    kept = advise(*_frames(*[BASE | {"linear": 0.8, "dnn": 0.2}] * 2), "dnn", automatic=False)
    assert "Keep" in kept.text
    assert "-e auto" in kept.text
