"""What a Python user types first: each line works, or is refused in one that says what to do.

`WORK` and `NAMED` were written down before anyone looked at what there was.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from matplotlib import pyplot as plt
from tests.filters.linear import linear_model
from tests.synthetic import build_recording, jaw_motion

import truejoint
from truejoint import Recording, TruejointError

WORK = (
    'tj.Recording.from_dataframe(frame, "davinci_grasper").joints == ("jaw",)',
    '(recording["measured/jaw"] == frame["measured/jaw"]).all()',
    'recording["measured"].shape == (400, 1)',
    "recording[1.0:2.0].t.tolist() == recording.t[100:200].tolist()",
    "len(recording) == 400",
    '"measured/jaw" in recording and "truth/elbow" not in recording',
    'recording.joints == ("jaw",)',
    "(recording.time == recording.t).all()",
    "recording.duration == 3.99",
    "(recording.measured[:, 0] == frame['measured/jaw']).all()",
    "len(recording.plot()[0].lines) == 2",
    'recording.to_dataframe()["truth/jaw"].equals(frame["truth/jaw"])',
    'recording.to_dataframe().attrs["units"]["measured/jaw"] == "rad"',
    "recording.to_csv('x.csv', index=False) or list(pd.read_csv('x.csv')) == list(recording)",
    "len(recording.head()) == 5",
    '"motion_9.csv" in recording._repr_html_()',
    'tj.calibrate(recording, "linear").joints == ("jaw",)',
    'calibration.save("c.tjc") or tj.read_calibration("c.tjc").estimator == "linear"',
    'calibration.save("c.tjc") or tj.Calibration.load("c.tjc").estimator == "linear"',
    "(calibration.predict(recording) == calibration.correct(recording)).all()",
    "calibration.correct(recording).shape == (400, 1)",
    "len(calibration.plot()[0].lines) == 1",
    '"linear" in calibration._repr_html_()',
    "tj.evaluate(calibration, recording).joints == ('jaw',)",
    'set(evaluation.to_dataframe()["estimator"]) == set(evaluation.estimators)',
    'evaluation.rmse.loc["jaw", "linear"] == evaluation.score("linear", "jaw").rmse',
    "len(evaluation.plot()[0].lines) == len(evaluation.estimators)",
    'evaluation.save("e.json") or json.load(open("e.json"))["chosen"] == "linear"',
    'tj.Corrector(calibration).joints == ("jaw",)',
    "tj.UKF(random_walk).run([0.5, 0.6], x0=[0.0], P0=[[1.0]], dt=1.0).x.shape == (2, 1)",
    "len(result.plot()[0].lines) == 3",
    'tj.get_robot("davinci_grasper").joints[0].name == "jaw"',
    '{"calibrate", "evaluate", "Recording", "runtime"} <= set(dir(tj))',
)
NAMED = (
    ('tj.load("r.csv")', "read_recording(path)"),
    ('tj.read_recording("r.csv", "dvrk_psm")', "a robot is named by robot="),
    ("list(recording.columns)", ""),  # a method, so Python speaks: list(recording) gives the names
    ('recording.save("x.csv")', "call it x.parquet"),
    ("tj.fit(recording)", "truejoint.calibrate(recordings)"),
    ("calibration.evaluate(recording)", "truejoint.evaluate(model, recordings)"),
    ("tj.Corrector(calibration).update(sample)", "step(t, sample)"),
    ("tj.robots()", ""),  # a package, so Python speaks
    ("recording.duraton", "Recording has no 'duraton'; did you mean 'duration'?"),
    ("recording._jaw", "Recording has no '_jaw'"),
    ("tj.Calibraton", "truejoint has no 'Calibraton'; did you mean 'Calibration'?"),
)
MISTAKES = (
    ("calibration.correct(recording.table)", "DataFrame, not a Recording"),
    ("calibration.correct('run.parquet')", "read_recording"),
    ("calibration.correct([recording])", "list, not a Recording"),
    ("tj.calibrate('run.parquet')", "read_recording"),
    ("tj.calibrate(recording, 'lin')", "did you mean 'linear'?"),
    ("tj.evaluate(recording, calibration)", "not a Calibration"),
    ("tj.evaluate(calibration, 'run.parquet')", "read_recording"),
    ("tj.evaluate('nothing.st', recording)", "nothing.st"),
    ("tj.Recording.from_columns({'t': [0, 1]}, 'raven')", "did you mean 'raven2'?"),
    ("tj.Recording.from_columns({'t': [0, 'x']}, 'bros')", "columns of numbers"),
    ("tj.Recording(recording.table, {}, 'bros')", "from_columns"),
    ("tj.read_recording(recording.table)", "is no path"),
    ("tj.write_parquet(recording.table, 'x.parquet')", "not a Recording"),
    ("tj.write_report(calibration, 'x.html')", "not an Evaluation"),
    ("tj.evaluate(calibration, recording, tolerance=0.2)", "{'jaw': 0.2}"),
    ("tj.evaluate(calibration, recording, tolerance={'jaw': '1'})", "positive"),
    ("tj.evaluate(calibration, recording, tolerance={'jw': 1})", "'jaw'?"),
    ("tj.write_calibration('jaw.safetensors', calibration)", "str, not a Calibration"),
    ("tj.calibrate(recording, joints='jw')", "called 'jw'; did you mean"),
    ("tj.write_calibration(calibration, 'model.onnx')", "call it model.safetensors"),
    ("tj.calibration.find_zero('m.st', recording)", "read_calibration(path)"),
    ("tj.calibration.find_zero(calibration, 'run.csv')", "read_recording"),
    ("tj.calibration.calibrate_like(recording, ['m.st'])", "not a Calibration"),
    ("tj.calibration.with_interval(calibration, training[0])", "used in the fit"),
    ("tj.calibration.with_interval(calibration, [], levels=0.9)", "too few"),
    ("tj.calibration.cross_interval([])", "at least one"),
    ("tj.tip.read_block('none.toml')", "none.toml: cannot be read"),
    ("tj.tip.Touches(1.0, '1')", "a time and a name"),
    ("tj.tip.Block('empty', 'raven2', {}, 0.08)", "no dimples"),
    ("tj.tip.tracked_truth(recording, 'p.csv')", "read_track(path)"),
    ("tj.Corrector(recording)", "Recording, not a Calibration"),
    ("tj.Corrector(calibration, level='0.9')", "level '0.9'"),
    ("tj.Corrector(calibration).rezero('0.1 deg')", "could not convert"),
    ("tj.Corrector(calibration).run('run.csv')", "read_recording"),
    ("tj.runtime.Monitor('m.st')", "read_calibration(path)"),
    ("tj.runtime.Compensator(calibration, recording.robot)", "Corrector(model)"),
    ("tj.export.export_c('m.st', 'out')", "read_calibration(path)"),
    ("tj.export.export_ros('m.st', 'out')", "read_calibration(path)"),
    ("tj.motion.zigzag('raven2')", "get_robot(name) gives one"),
    ("tj.motion.zigzag(raven2, 'J2', '1/4')", "sparsity '1/4'"),
    ("tj.motion.random_motion(raven2, 10.0, 1.5)", "a whole number"),
    ("tj.motion.plot_trajectory([], 'way.html')", "not a Trajectory"),
    ("tj.motion.write_trajectory('way.csv', way)", "not a Trajectory"),
    ("tj.evaluation.part_by_time([recording], 0.0, 0.5)", "list, not a Recording"),
    ("tj.evaluation.compare([], [])", "one at least"),
    ("tj.evaluation.advise([], [])", "its `errors` and `rows`"),
    ("tj.evaluation.tool_error(raven2, [0], [0])", "not a Kinematics"),
    ("tj.evaluate(calibration, recording).score('lin', 'jaw')", "'linear'?"),
    ("tj.evaluate(calibration, recording).score('linear', 'jw')", "'jaw'?"),
    ("tj.evaluate(calibration, recording, rezero='1')", "'1' s"),
    ("recording.rows([True, False])", "a mask of all"),
    ("tj.recordings.join_truth(recording, training[0])", "read_truth(path)"),
    ("tj.recordings.Stream([0.0], {'truth/jaw': ['a']})", "give numbers"),
    ("tj.robots.Joint('jaw', 'rotary')", "revolute or prismatic"),
    ("tj.recordings.Track.of_readings([0.0], [1.0])", "must be (n,), (n, 3)"),
    ("tj.evaluate(calibration, 5)", "this is an int, not a Recording"),
    ("tj.read_calibration(7)", "an int, not a path; give that of a model"),
    ("tj.calibrate(recording, fit_rate='30 Hz')", "fit rate is '30 Hz' Hz"),
    ("tj.write_parquet(recording, 'run.csv')", "call it run.parquet"),
    ("tj.export.export_onnx(calibration, 'model.c')", "call it model.onnx"),
    ("tj.Recording.from_columns({'t': [0, 1]}, 'wrist', '420006')", "not a mapping"),
    ("tj.recordings.Recorder('raven2')", "'raven2' is a str, not an Arm"),
    (
        "tj.recordings.Recorder(tj.crtk.simulated_arm('forceps'), path='run.csv')",
        "run.csv: a recording is a .parquet file; call it run.parquet",
    ),
    ("tj.motion.Jog('raven2')", "'raven2' is a str, not an Arm"),
    ("tj.motion.follow('raven2', way)", "'raven2' is a str, not an Arm"),
    ("tj.monitor.ArmPage('raven2')", "'raven2' is a str, not an Arm"),
    ("tj.crtk.SimulatedBackend('raven2')", "make_twin(robot) gives one"),
    (
        "tj.crtk.SimulatedBackend(tj.simulation.make_twin('forceps'), rate='fast')",
        "fast set-points a second; a twin runs at 1000 Hz",
    ),
    ("tj.crtk.Arm('raven2')", "not a Backend; it lacks robot"),
    ("tj.crtk.time_law([[0.0], [1.0]], [0.0])", "a speed above 0"),
    ("tj.crtk.TimeLaw([0, 0], [[1], [2]])", "times (n,) that rise"),
    ("tj.simulation.make_twin('raven2', parameters={})", "not a path"),
    ("tj.simulation.make_twin('raven2', seed='1')", "a whole number"),
    ("tj.tip.Registration(np.eye(3))", "a Base"),
    ("tj.tip.find_block(calibration, recording, 't.csv', None)", "read_touches(path)"),
    ("tj.runtime.motor_loop('raven2')", "not a Robot"),
    ("tj.evaluation.render_report('page')", "not an Evaluation"),
    ("tj.studies.write_study('directions', 'out')", "not a StudyResult"),
    ("recording[5]", "recording[5]: give a column or a slice of times [s]"),
    ("recording['a':]", "give a column or a slice of times [s]"),
    ("recording[1.0:'a']", "give a column or a slice of times [s]"),
    ("recording[::2]", "give a column or a slice of times [s]"),
    ("recording['truth/elbow']", "no column 'truth/elbow'; it has t, measured/jaw"),
    ("recording[9:10]", "0 rows"),
    ("evaluation.save('e.html')", "call it e.json"),
    ("tj.monitor.RecordingPage('run.csv')", "not a Recording"),
)


@pytest.fixture(scope="module")
def names() -> dict[str, Any]:
    recording, training = jaw_motion(9), [jaw_motion(seed) for seed in range(2)]
    calibration, raven2 = truejoint.calibrate(training, "linear"), truejoint.get_robot("raven2")
    random_walk = linear_model([[1.0]], [[]], [[1.0]], [[0.1]], [[1.0]])
    return {
        "json": json,
        "np": np,
        "pd": pd,
        "tj": truejoint,
        "recording": recording,
        "training": training,
        "raven2": raven2,
        "way": truejoint.motion.zigzag(raven2, "J2", 1 / 2),
        "frame": recording.table.copy(),
        "calibration": calibration,
        "evaluation": truejoint.evaluate(calibration, recording),
        "sample": [0.0, 0.0],
        "random_walk": random_walk,
        "result": truejoint.UKF(random_walk).run([0.5, 0.6], x0=[0.0], P0=[[1.0]], dt=1.0),
    }


@pytest.fixture(autouse=True)
def _folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.chdir(tmp_path)
    Path("r.csv").write_text("t,measured/jaw\n0,1\n1,2\n")
    yield
    plt.close("all")


@pytest.mark.parametrize("guess", WORK)
def test_a_first_guess_works(guess: str, names: dict[str, Any]) -> None:
    assert eval(guess, names)  # noqa: S307 - our own line


@pytest.mark.parametrize(("guess", "word"), NAMED)
def test_a_first_guess_names_the_right_word(guess: str, word: str, names: dict[str, Any]) -> None:
    with pytest.raises((AttributeError, TypeError, TruejointError)) as refused:
        eval(guess, names)  # noqa: S307
    assert word in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(("line", "said"), MISTAKES)
def test_a_mistake_is_refused_in_a_line(line: str, said: str, names: dict[str, Any]) -> None:
    with pytest.raises(TruejointError) as refused:
        eval(line, names)  # noqa: S307
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)


def test_evaluate_takes_one_or_several_and_paths(names: dict[str, Any]) -> None:
    model, test = names["calibration"], names["recording"]
    path = Path("jaw.safetensors")
    truejoint.write_calibration(model, path)
    rmse = truejoint.evaluate({"linear": [model]}, [test]).score("linear", "jaw").rmse
    for models in (model, path, str(path), [path], {"linear": path}):
        assert truejoint.evaluate(models, test).score("linear", "jaw").rmse == rmse
    found = truejoint.evaluate({"mine": model}, test)
    assert found.chosen == "mine"
    assert found.estimators == ("raw", "offset", "poly2", "mine")  # which is the linear one
    offset = truejoint.calibrate(names["training"], "offset")
    assert "offset" in truejoint.evaluate({"mine": offset}, test).estimators  # the yardstick
    assert truejoint.evaluate([model, path], test).score("linear", "jaw").seeds == 2
    other = truejoint.calibrate(names["training"], "poly2")
    assert {"linear", "poly2"} <= set(truejoint.evaluate([model, other], test).estimators)


def test_values_show_themselves_in_a_few_lines(names: dict[str, Any]) -> None:
    model, recording = names["calibration"], names["recording"]
    robot, check = truejoint.get_robot("dvrk_psm"), truejoint.recordings.check_data(recording)
    made = truejoint.Corrector(model), robot, model.feature_set, check
    for value in (model, recording, names["evaluation"], *made):
        assert "jaw" in repr(value)
        assert len(repr(value)) < 800
        assert len(repr(value).splitlines()) < 14
        assert value._repr_html_().startswith("<table>")
    assert len(repr(model.training_domain).splitlines()) < 6
    assert "<b>" not in Recording.from_columns({"t": [0, 1]}, "bros")._repr_html_()
    # What others wrote into a model does not break its text.
    for facts in ({"touch": 5}, {"touch": {"tip_error": "x"}}, {"duration": "long"}):
        assert "linear" in repr(model.with_metadata(**facts))


def test_a_slice_begins_and_ends_where_it_says(names: dict[str, Any]) -> None:
    recording = names["recording"]
    parts = recording[:1.0], recording[1:2], recording[2.0:]
    np.testing.assert_array_equal(np.concatenate([p.t for p in parts]), recording.t)
    assert [len(part) for part in parts] == [100, 100, 200]
    assert parts[1].units == recording.units


def test_a_recording_is_kept_and_read_back(names: dict[str, Any]) -> None:
    names["recording"].save("run.parquet")
    assert truejoint.read_recording("run.parquet").table.equals(names["recording"].table)
    with pytest.raises(TruejointError, match="exists already"):
        names["recording"].save("run.parquet")
    names["recording"].save("run.parquet", overwrite=True)


def test_units_stay_with_frames(names: dict[str, Any]) -> None:
    recording, calibration = names["recording"], names["calibration"]
    frame = recording.to_dataframe()[100:200]
    assert frame.attrs["units"] == recording.units
    assert frame.attrs["provenance"]["source"] == "motion_9.csv"
    table = calibration.correct_table(recording)
    assert table.attrs["units"] == {"corrected/jaw": "rad"}
    assert list(table) == ["t", "corrected/jaw"]
    np.testing.assert_array_equal(table["corrected/jaw"], calibration.correct(recording)[:, 0])
    assert names["evaluation"].rmse.attrs["units"] == {"jaw": "rad"}
    frame["measured/jaw"] = 0.0
    assert recording["measured/jaw"].any()


def test_a_recording_is_an_xarray_with_units(names: dict[str, Any]) -> None:
    pytest.importorskip("xarray")
    data = names["recording"].to_xarray()
    np.testing.assert_array_equal(data["truth"].sel(joint="jaw"), names["recording"]["truth/jaw"])
    np.testing.assert_array_equal(data["t"], names["recording"].t)
    assert data["effort"].attrs["units"] == {"jaw": "Nm"}
    assert data.attrs["source"] == "motion_9.csv"


def test_plots_show_what_they_say(names: dict[str, Any]) -> None:
    recording, calibration = names["recording"], names["calibration"]
    (axis,) = recording.plot()
    assert (axis.get_xlabel(), axis.get_ylabel()) == ("time [s]", "jaw [deg]")
    measured, truth = (line.get_ydata() for line in axis.lines)
    np.testing.assert_allclose(measured, np.degrees(recording["measured/jaw"]))
    np.testing.assert_allclose(truth, np.degrees(recording["truth/jaw"]))
    (axis,) = calibration.plot(recording)
    np.testing.assert_allclose(axis.lines[0].get_xdata(), measured)
    np.testing.assert_allclose(
        axis.lines[0].get_ydata(), np.degrees(calibration.predict_error(recording)[:, 0])
    )
    assert axis.get_ylabel() == "correction [deg]"
    (axis,) = calibration.plot()
    domain = calibration.training_domain
    corners = axis.lines[0].get_xydata()
    np.testing.assert_allclose(np.radians(corners[:, 1].max()), domain.error_upper[0])
    np.testing.assert_allclose(np.radians(corners[:, 0].min()), domain.signal_lower[0])
    (axis,) = names["evaluation"].plot()
    own = dict(zip(names["evaluation"].estimators, axis.lines, strict=True))["linear"]
    largest = names["evaluation"].score("linear", "jaw").max_abs
    np.testing.assert_allclose(own.get_xydata()[-1], [100.0, np.degrees(largest)])
    (axis,) = names["result"].plot()
    x, low, high = (line.get_ydata() for line in axis.lines)
    np.testing.assert_allclose(x, names["result"].x[:, 0])
    np.testing.assert_allclose(high - low, 4 * np.sqrt(names["result"].P[:, 0, 0]))


def test_joints_without_truth_are_drawn_beside_those_with() -> None:
    columns = {"t": [0, 1], "measured/a": [0, 1], "measured/b": [2, 3], "truth/b": [2, 4]}
    Path("arm.toml").write_text(
        'name = "arm"\njoints = [{ name = "a" }, { name = "b", kind = "prismatic" }]\n'
    )
    arm = truejoint.get_robot("arm.toml")
    first, second = Recording.from_columns(columns, "arm", robot=arm).plot()
    assert np.isnan(first.lines[1].get_ydata()).all()
    assert second.get_ylabel() == "b [mm]"
    assert second.lines[1].get_ydata().tolist() == [2000.0, 4000.0]
    with pytest.raises(TruejointError, match="no column 'measured'; it has t, truth/b"):
        Recording.from_columns({"t": [0, 1], "truth/b": [0, 1]}, "arm", robot=arm).plot()


def test_an_evaluation_is_a_table_by_joint_and_model(names: dict[str, Any]) -> None:
    shown = names["evaluation"]._repr_html_()
    for cell in ("jaw", "Fixed offset", "Linear", "RMSE [deg]"):
        assert f"{cell}</t" in shown.split("</table>", 1)[1]


def test_a_property_that_fails_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(_self: Recording) -> float:
        raise AttributeError("the clock broke")

    monkeypatch.setattr(Recording, "duration", property(broken))
    with pytest.raises(AttributeError, match="the clock broke"):
        _ = build_recording().duration
