"""What the loop would refuse, the evaluation says."""

import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from truejoint.calibration import calibrate
from truejoint.errors import CalibrationError, TruejointError
from truejoint.evaluation import evaluate
from truejoint.evaluation.scoring import rmse, score_errors, tool_error, worst_windows
from truejoint.robots import get_robot
from truejoint.runtime import Corrector


@pytest.fixture(scope="module")
def model(recording_of):
    return calibrate([recording_of("davinci_grasper", seed=i) for i in range(3)], "linear")


@pytest.fixture
def test(recording_of):
    return recording_of("davinci_grasper", seed=7)


def _shifted(recording, rows, **shifts):
    table = recording.table.copy()
    for name, shift in shifts.items():
        column = table.columns.get_loc(f"{name}/jaw")
        table.iloc[rows, column] += shift
    return replace(recording, table=table)


def test_status_is_that_of_the_loop(model, test):
    strange = _shifted(test, slice(100, 300), measured=0.8, truth=0.8)
    corrector = Corrector(model)
    corrector.set_homing(True)
    expected = []
    for i, t in enumerate(strange.t):
        sample = [strange.column(name)[i] for name in corrector.signals]
        expected.append(int(corrector.step(float(t), sample)))
    np.testing.assert_array_equal(evaluate(model, strange).rows["status"], expected)


def test_errors_inside_and_outside_stand_apart(model, test):
    strange = _shifted(test, slice(100, 300), measured=0.8, truth=0.8)
    evaluation = evaluate(model, strange)
    score, inside = evaluation.score("linear", "jaw"), evaluation.rows["inside"]
    error = evaluation.errors["linear", "jaw"]
    assert score.rmse_inside == pytest.approx(np.sqrt(np.mean(error[inside] ** 2)))
    assert score.rmse_outside == pytest.approx(np.sqrt(np.mean(error[~inside] ** 2)))
    assert evaluation.domain.inside == inside.mean()
    assert evaluation.verdict.level == "warn"
    assert any("pass the raw position" in doubt for doubt in evaluation.verdict.doubts)


def test_another_instrument_is_called_that(model, test):
    other = _shifted(test, slice(None), measured=0.9)
    verdict = evaluate(model, other).verdict
    assert verdict.level == "fail"
    assert "another instrument" in verdict.text
    moved = evaluate(model, _shifted(test, slice(None), truth=0.4))
    assert moved.domain.inside > 0.9  # the inputs are as in training; only the truth tells
    assert "a zero that has moved" in moved.verdict.text


def test_a_moved_zero_is_no_objection_once_re_zeroed(model, test):
    moved = _shifted(test, slice(None), truth=0.4)
    found = evaluate(model, moved, rezero=2.0)
    assert found.domain.beyond == 0.0
    assert found.verdict.objections == ()
    at_zero = evaluate(model, test, rezero=2.0).domain
    assert at_zero is not None
    assert found.domain.inside == at_zero.inside


def test_a_joint_worse_than_raw_does_not_pass(model, test):
    error = test.column("measured/jaw") - test.column("truth/jaw")
    moved = _shifted(test, slice(None), truth=0.75 * float(error.mean()))
    verdict = evaluate(model, moved).verdict
    assert verdict.level == "fail"
    assert "the raw position's" in verdict.text
    assert verdict.deploy == "raw"
    assert verdict.advice.startswith("Deploy none")


def test_a_failed_data_check_is_no_green_pass(model, test):
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


def test_a_calibration_without_a_training_range_is_refused(model, test):
    with pytest.raises(TruejointError, match="calibrate it again"):
        evaluate(replace(model, training_domain=None), test)


def test_percent_is_of_the_offset_and_nan_where_that_is_zero():
    own = {"offset": ([0.859, -0.859], [0.0, 0.0]), "dnn": ([0.104, 0.104], [1.0, 1.0])}
    frames = {(n, 0): pd.DataFrame({"jaw": jaw, "wrist": w}) for n, (jaw, w) in own.items()}
    errors = pd.concat(frames, axis=1, names=["estimator", "seed", "joint"])
    rows = pd.DataFrame({"inside": [True, False]})
    scores = score_errors(errors, rows, {"jaw": "rad", "wrist": "rad"}).set_index("estimator")
    percent = scores.percent_of_offset["dnn"].to_numpy()
    assert percent[0] == pytest.approx(12.107, abs=1e-3)
    assert np.isnan(percent[1])


@pytest.mark.parametrize(
    ("bad", "said"),
    [(np.empty((0, 2)), "no row"), (np.empty(0), "no row"), (1.0, "no row"),
     ([0.0, math.nan], "not finite")],
)  # fmt: skip
def test_what_has_no_mean_is_refused(bad, said):
    with pytest.raises(CalibrationError, match=said):
        rmse(bad)


def test_a_root_mean_square_is_that_of_each_joint():
    np.testing.assert_allclose(rmse([[3.0, 1.0], [4.0, -1.0]]), [math.sqrt(12.5), 1.0])


def test_an_error_of_the_insertion_moves_the_tool_by_as_much():
    robot = get_robot("raven2")
    assert robot.kinematics is not None
    true = np.tile(robot.home, (3, 1))
    estimated = true.copy()
    estimated[:, robot.index(["insertion"])] += np.array([[0.0], [1e-3], [-2e-3]])
    distance = np.linalg.norm(tool_error(robot.kinematics, estimated, true), axis=1)
    np.testing.assert_allclose(distance, [0.0, 1e-3, 2e-3], atol=1e-12)


@settings(deadline=None)
@given(st.integers(2, 80), st.floats(0.5, 30.0), st.integers(0, 1000))
def test_windows_match_a_search_by_hand(n, window, seed):
    random = np.random.default_rng(seed)
    t = np.cumsum(random.uniform(0.1, 1.0, n))
    error = random.normal(size=n)
    found = worst_windows(t, error, window, 4)
    parts = [(t >= start) & (t <= start + window) for start in t]
    long_enough = [p for p in parts if np.ptp(t[p]) >= 0.5 * min(window, t[-1] - t[0])]
    by_hand = max(np.sqrt(np.mean(error[p] ** 2)) for p in long_enough or parts)
    assert found[0][2] == pytest.approx(by_hand, rel=1e-9)
    assert [f[2] for f in found] == sorted((f[2] for f in found), reverse=True)
    taken = np.zeros(n)
    for first, end, _ in found:
        taken[first:end] += 1
    assert taken.max() == 1
