import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from truejoint.calibration import calibrate, find_zero
from truejoint.calibration.origin import Origin, Session
from truejoint.errors import CalibrationError, RecordingError
from truejoint.estimators.polynomial.learn import Raw
from truejoint.evaluation import evaluate
from truejoint.evaluation.evaluate import part_by_time, split_sides, unique_names
from truejoint.evaluation.paired_test import compare, cycle_rows
from truejoint.evaluation.results import TOOL
from truejoint.evaluation.scoring import WINDOW
from truejoint.evaluation.verdict import rezero_remarks
from truejoint.recordings import Provenance, Recording, check_data
from truejoint.recordings.datasets import DATASETS, HeldOut
from truejoint.robots import get_robot

ROBOTS = ["raven2", "davinci_grasper"]  # with and without kinematics


@pytest.fixture(scope="module", params=ROBOTS)
def case(request, recording_of, calibration_of):
    train = [recording_of(request.param, seed=i) for i in range(2)]
    test = [recording_of(request.param, seed=7), recording_of(request.param, seed=8, seconds=12)]
    seeds = [calibration_of(train, seed=s) for s in range(3)]
    return seeds, test, evaluate({"dnn": seeds}, test)


def test_scores_agree_with_numpy(case):
    seeds, test, evaluation = case
    joints = seeds[0].joints
    truth = np.concatenate([r.columns("truth", joints) for r in test])
    roots = []
    for seed in seeds:
        error = np.concatenate([seed.correct(r) for r in test]) - truth
        roots.append(np.sqrt((error**2).mean(axis=0)))
    offset = np.concatenate([seeds[0].baselines["offset"].correct(r) for r in test]) - truth
    raw = np.concatenate([r.columns("measured", joints) for r in test]) - truth
    for j, joint in enumerate(joints):
        row = evaluation.score("dnn", joint)
        assert row.rmse == pytest.approx(np.mean(roots, axis=0)[j], rel=1e-12)
        assert row.spread == pytest.approx(np.std(roots, axis=0, ddof=1)[j], rel=1e-9)
        assert row.seeds == 3
        below = evaluation.score("offset", joint)
        assert below.rmse == pytest.approx(np.sqrt((offset[:, j] ** 2).mean()), rel=1e-12)
        assert below.max_abs == pytest.approx(np.abs(offset[:, j]).max(), rel=1e-12)
        assert below.percent_of_offset == pytest.approx(100.0)
        assert row.percent_of_offset == pytest.approx(100 * row.rmse / below.rmse, rel=1e-12)
        assert evaluation.score("raw", joint).mean == pytest.approx(raw[:, j].mean(), rel=1e-9)


def test_baselines_are_always_in_the_table(case):
    seeds, test, evaluation = case
    assert evaluation.estimators == ("raw", "offset", "linear", "poly2", "dnn")
    of_joints = evaluation.scores[evaluation.scores.joint != TOOL]
    assert len(of_joints) == 5 * len(seeds[0].joints)
    assert len(evaluation.recording_scores) == len(of_joints) * len(test)


def without_effort(recording):
    """The same recording, of a robot that reports no efforts."""
    names = [name for name in recording.table.columns if not name.startswith("effort/")]
    units = {name: unit for name, unit in recording.units.items() if name in names}
    return Recording(recording.table[names], units, recording.provenance)


def test_efforts_may_be_missing_in_some_recordings_or_in_all(recording_of):
    train, *test = (recording_of("davinci_grasper", seed=seed) for seed in range(3))
    model = calibrate(train, "linear", features=["measured/jaw"])
    for which in ((0,), (1,), (0, 1)):
        mixed = [without_effort(r) if k in which else r for k, r in enumerate(test)]
        evaluation = evaluate(model, mixed)
        assert not evaluation.effort_units
        assert evaluation.score("linear", "jaw").rmse > 0.0
        assert str(evaluation)


def test_the_tool_error_goes_through_the_robot_s_kinematics(case):
    seeds, test, evaluation = case
    robot = test[0].robot
    if robot.kinematics is None:
        assert TOOL not in set(evaluation.scores.joint)
        assert robot.name in evaluation.cartesian_note
        return
    errors = []
    for recording in test:
        measured = recording.columns("measured", robot.joint_names)
        true, raw = measured.copy(), measured
        true[:, robot.index(list(seeds[0].joints))] = recording.columns("truth", seeds[0].joints)
        errors.append(
            robot.kinematics.forward(raw)[:, :3, 3] - robot.kinematics.forward(true)[:, :3, 3]
        )
    error = np.concatenate(errors)
    row = evaluation.score("raw", TOOL)
    assert row.rmse == pytest.approx(np.sqrt((error**2).sum(axis=1).mean()), rel=1e-9)
    assert row.max_abs == pytest.approx(np.sqrt((error**2).sum(axis=1).max()), rel=1e-9)
    np.testing.assert_allclose([row.x, row.y, row.z], np.sqrt((error**2).mean(axis=0)), rtol=1e-9)
    assert row.rmse**2 == pytest.approx(row.x**2 + row.y**2 + row.z**2, rel=1e-9)


def test_the_dictionary_is_json_without_nan(case):
    _, test, evaluation = case
    values = json.loads(json.dumps(evaluation.to_dict(), allow_nan=False))
    assert values["verdict"]["passed"] is evaluation.verdict.passed
    assert len(values["test"]) == len(test)
    assert values["worst"][0]["recording"] in {t["name"] for t in values["test"]}


def test_stretches_of_a_comparison_end_where_their_recording_does(case):
    _, _, evaluation = case
    parts = [part for _, part in evaluation.errors.groupby(level=0, sort=False)]
    moves = evaluation.rows["direction"].groupby(level=0, sort=False)
    least = cycle_rows([part.to_numpy() for _, part in moves])
    for row in evaluation.comparisons.itertuples():
        own, other = ([p[n, row.joint].to_numpy() for p in parts] for n in ("dnn", row.estimator))
        found = compare(own, other, least)
        assert (row.outcome, row.stretches) == (found.outcome, found.stretches)


def test_worst_stretches_come_worst_first(case):
    _, _, evaluation = case
    limits = {joint.joint: joint.limit for joint in evaluation.verdict.joints}
    worst = evaluation.worst
    assert (worst.rmse / worst.joint.map(limits)).is_monotonic_decreasing
    assert set(worst.joint) == set(evaluation.joints)
    assert (worst.end - worst.start).between(0, WINDOW, inclusive="right").all()


@pytest.fixture(scope="module")
def grasper(recording_of, calibration_of):
    train = [recording_of("davinci_grasper", seed=i) for i in range(2)]
    return calibration_of(train), recording_of("davinci_grasper", seed=5)


def test_rows_without_truth_are_left_out_after_correcting_all(grasper):
    calibration, test = grasper
    table = test.table.copy()
    table.loc[100:499, "truth/jaw"] = np.nan
    gappy = replace(test, table=table)
    evaluation = evaluate({"dnn": calibration}, gappy)
    known = np.isfinite(gappy.column("truth/jaw"))
    error = (calibration.correct(test) - test.columns("truth", ["jaw"]))[known, 0]
    assert evaluation.score("dnn", "jaw").rmse == pytest.approx(np.sqrt(np.mean(error**2)))
    assert evaluation.test[0]["rows_total"] == len(test)
    assert (
        evaluation.test[0]["rows"] == len(evaluation.rows) == len(evaluation.errors) == known.sum()
    )


def test_a_chosen_baseline_takes_its_place_in_the_table(grasper):
    calibration, test = grasper
    evaluation = evaluate({"linear": calibration}, test)
    assert evaluation.estimators == ("raw", "offset", "linear", "poly2")
    own = evaluate({"dnn": calibration}, test).score("dnn", "jaw").rmse
    assert evaluation.score("linear", "jaw").rmse == own


def test_a_missing_baseline_leaves_its_note(grasper):
    calibration, test = grasper
    baselines = {k: v for k, v in calibration.fitted_baselines.items() if k != "poly2"}
    origin = Origin(baseline_notes={"poly2": "left out: too few rows"})
    weak = replace(calibration, fitted_baselines=baselines, origin=origin)
    evaluation = evaluate({"dnn": [weak]}, [test])
    assert evaluation.estimators == ("raw", "offset", "linear", "dnn")
    assert evaluation.baseline_notes == {"poly2": "left out: too few rows"}
    with pytest.raises(CalibrationError, match="no fixed offset"):
        evaluate({"dnn": [replace(calibration, fitted_baselines={})]}, [test])


def test_testing_on_training_rows_fails_the_verdict(grasper):
    calibration, test = grasper
    seen = replace(calibration, origin=Origin(sessions=(Session.of(test),)))
    verdict = evaluate({"dnn": [seen]}, [test]).verdict
    assert not verdict.passed
    assert "cannot be believed" in verdict.text


def test_what_cannot_be_judged_is_refused(grasper, recording_of):
    calibration, test = grasper
    arrays = {name: values * np.nan for name, values in calibration.fitted.arrays.items()}
    broken = replace(calibration, fitted=replace(calibration.fitted, arrays=arrays))
    blind = replace(test, table=test.table.assign(**{"truth/jaw": np.nan}))
    good, other = {"dnn": [calibration]}, replace(calibration, joints=("wrist",))
    for models, recordings, how, said in (
        ({}, [test], {}, "no calibration"),
        ({"dnn": []}, [test], {}, "no calibration"),
        (good, [], {}, "no recording"),
        (good, [test], {"chosen": "linear"}, "no calibration called 'linear'"),
        (good, [test], {"rezero": -1.0}, "time to re-zero from is -1.0 s"),
        (good, [test], {"rezero": np.nan}, "is nan s"),
        (good, [test], {"rezero": 60.0}, "after the 60 s that re-zero it; a test"),
        (good, [test, recording_of("bros")], {}, "; take recordings of one arm alone"),
        (good | {"other": [other]}, [test], {}, "wrist but dnn corrects jaw"),
        (good, [blind], {}, "synthetic-5.csv: 0 rows have the truth of jaw"),
        ({"dnn": [broken]}, [test], {}, "dnn gives no number for row 0"),
    ):
        with pytest.raises((CalibrationError, RecordingError), match=said):
            evaluate(models, recordings, **how)


def test_a_missing_jaw_does_not_hide_the_tool(recording_of, calibration_of):
    robot = get_robot("raven2")
    assert robot.kinematics is not None
    train, test = recording_of("raven2", seed=0), recording_of("raven2", seed=1)
    calibration = calibration_of([train])
    jaws = ["measured/jaw1", "measured/jaw2"]
    judged, lacking = partial(evaluate, check=check_data([test])), test.table.drop(columns=jaws)
    whole = judged({"dnn": calibration}, test)
    without = judged({"dnn": [calibration]}, [replace(test, table=lacking)])
    tool, same = (found.scores.query("joint == @TOOL").rmse for found in (whole, without))
    np.testing.assert_allclose(tool, same, rtol=1e-9)
    lame = replace(test, table=test.table.drop(columns="measured/wrist"))
    note = judged({"dnn": calibration}, lame).cartesian_note
    assert "lacks the measured position of wrist" in note


def test_names_of_recordings_are_short_and_unique():
    sources = ["a/1.csv", "b/1.csv", "b/2.csv", "b/2.csv", "", ""]
    names = ["a/1.csv", "b/1.csv", "b/2.csv #1", "b/2.csv #2", "recording #1", "recording #2"]
    assert unique_names(sources) == names


def test_judging_after_re_zeroing_leaves_the_truth_that_was_used(grasper):
    calibration, test = grasper
    moved = replace(test, table=test.table.assign(**{"truth/jaw": test.table["truth/jaw"] + 0.1}))
    found = evaluate({"dnn": calibration}, moved, rezero=2.0)
    start = moved.t < 2.0
    for name, model in (("dnn", calibration), ("offset", calibration.baselines["offset"])):
        error = find_zero(model, moved, 2.0).shift + model.correct(moved)
        error = (error - moved.columns("truth", ["jaw"]))[~start]
        assert found.score(name, "jaw").rmse == pytest.approx(np.sqrt(np.mean(error**2)))
    raw = moved.error(["jaw"])[~start]
    assert found.score("raw", "jaw").rmse == pytest.approx(np.sqrt(np.mean(raw**2)))
    assert found.to_dict()["rezero"] == 2.0
    assert len(found.rows) == (~start).sum()
    assert found.verdict.remarks[0].startswith("Re-zeroed from the first 2 s of each recording: ")


def test_a_raw_position_that_was_chosen_is_re_zeroed_beside_that_as_it_comes(recording_of):
    train, test = (recording_of("raven2", seed=seed, source=f"{seed}.csv") for seed in (0, 9))
    model = calibrate(train, Raw())
    check = check_data([test])
    found = evaluate(model, test, rezero=3.0, check=check)
    assert found.chosen == "raw, re-zeroed"
    error = -test.error(model.joints)
    left = error[test.t >= 3.0]
    moved = -find_zero(model, test, 3.0).shift
    for name, zero in (("raw", 0.0), (found.chosen, moved)):
        expected = np.sqrt(np.mean((left - zero) ** 2, axis=0))
        scores = [found.score(name, joint).rmse for joint in model.joints]
        np.testing.assert_allclose(scores, expected, rtol=1e-9)
    assert evaluate(model, test, check=check).chosen == "raw"


def test_re_zeroing_that_harms_is_told(grasper):
    calibration, test = grasper
    slow = np.where(test.t < 2.0, 0.05, 0.0)  # a stretch that is unlike the rest
    biased = replace(
        test, table=test.table.assign(**{"truth/jaw": test.column("truth/jaw") + slow})
    )
    found = evaluate({"dnn": calibration}, biased, rezero=2.0).verdict
    harm = "Re-zeroing from the first 2 s of each recording harms: jaw 2."
    assert found.remarks[0].startswith(harm)
    assert not list(rezero_remarks(found.joints, np.array([found.joints[0].rmse]), 2.0))


def test_after_re_zeroing_the_fit_with_zeros_is_judged(recording_of):
    train = [recording_of("davinci_grasper", seed=i, source=f"{i}.csv") for i in range(3)]
    test = recording_of("davinci_grasper", seed=9, source="9.csv")
    model = calibrate(train, "linear", zero="recording")

    check = check_data([test])

    def scores(judged, rezero):
        return evaluate(judged, test, rezero=rezero, check=check).scores.rmse.tolist()

    own, plain = model.for_rezeroing, replace(model, rezeroed_fit=None)
    assert scores(model, 3.0) == scores(own, 3.0) != scores(plain, 3.0)
    assert scores(model, 0.0) == scores(plain, 0.0) != scores(own, 0.0)


def _ramp(n=200, source="a.csv", sha256=""):
    t = 5.0 + 0.1 * np.arange(n)
    columns = {"t": t, "measured/jaw": t, "truth/jaw": t}
    return Recording.from_columns(columns, Provenance("davinci_grasper", "", source, sha256))


@given(st.floats(0.1, 0.9))
def test_a_side_of_a_data_set_begins_a_second_after_the_other(fraction):
    recording = _ramp()
    split = HeldOut("", "*", test_fraction=1.0 - fraction)
    ((train,), (test,)) = split_sides([recording], DATASETS["kuka_kr300_dual_encoder"], split)
    assert train.t[0] == recording.t[0]
    assert test.t[-1] == recording.t[-1]
    assert test.t[0] - train.t[-1] >= 1.0
    assert train.duration == pytest.approx(fraction * recording.duration, abs=0.11)


@given(st.floats(0.05, 0.95))
def test_parts_that_meet_share_no_row_and_lose_none(cut):
    recording = _ramp()
    done = (recording.t - recording.t[0]) / recording.duration
    for at in (cut, done[int(cut * len(done))]):  # where there is no row, and where one is
        first, last = part_by_time(recording, 0.0, at), part_by_time(recording, at, 1.0)
        np.testing.assert_array_equal(np.concatenate([first.t, last.t]), recording.t)


@pytest.mark.parametrize(
    ("begin", "end", "said"),
    [(0.5, 0.5, "0 to 1"), (0.7, 0.2, "0 to 1"), (-0.1, 0.5, "0 to 1"), (0.2, 1.1, "0 to 1"),
     (0.0, 0.001, "longer part")],
)  # fmt: skip
def test_a_part_outside_the_recording_or_of_one_row_is_refused(begin, end, said):
    with pytest.raises(RecordingError, match=said):
        part_by_time(_ramp(), begin, end)
