"""What a person tries first in Python works, or is refused in one line that says what to do."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import truejoint
from truejoint import Calibration, Recording, TruejointError, write_calibration
from truejoint.runtime import Corrector

RAVEN = truejoint.get_robot("raven2")
WAY = truejoint.motion.zigzag(RAVEN, "J2", 1 / 2)


def motion(seed: int) -> Recording:
    t = np.arange(200) / 100
    jaw = 0.5 + 0.3 * np.sin((2 + seed) * t)
    effort = np.cos((3 + seed) * t)
    columns = {"t": t, "measured/jaw": jaw, "effort/jaw": effort, "truth/jaw": jaw + 0.01 * effort}
    return Recording.from_columns(columns, "davinci_grasper")


@pytest.fixture(scope="module")
def model() -> Calibration:
    return truejoint.calibrate(motion(0), "linear")


def test_evaluate_takes_one_or_several_and_paths(model: Calibration, tmp_path: Path) -> None:
    path = tmp_path / "jaw.safetensors"
    write_calibration(model, path)
    test = motion(1)
    rmse = truejoint.evaluate({"linear": [model]}, [test]).score("linear", "jaw").rmse
    for models in (model, path, str(path), [path], {"linear": path}):
        assert truejoint.evaluate(models, test).score("linear", "jaw").rmse == rmse
    assert truejoint.evaluate({"mine": model}, test).chosen == "mine"
    assert truejoint.evaluate([model, path], test).score("linear", "jaw").seeds == 2


def test_models_of_two_estimators_are_compared(model: Calibration) -> None:
    other = truejoint.calibrate(motion(0), "poly2")
    found = truejoint.evaluate([model, other], motion(1))
    assert found.chosen == "linear"
    assert {"linear", "poly2"} <= set(found.estimators)


@pytest.mark.parametrize(
    ("mistake", "said"),
    [
        (lambda model: model.correct(motion(1).table), "DataFrame, not a Recording"),
        (lambda model: model.correct("run.parquet"), "read_recording"),
        (lambda model: model.correct([motion(1)]), "list, not a Recording"),
        (lambda model: truejoint.calibrate("run.parquet"), "read_recording"),
        (lambda model: truejoint.calibrate(motion(1), "lin"), "did you mean 'linear'?"),
        (lambda model: truejoint.evaluate(motion(1), model), "not a Calibration"),
        (lambda model: truejoint.evaluate(model, "run.parquet"), "read_recording"),
        (lambda model: truejoint.evaluate("nothing.st", motion(1)), "nothing.st"),
        (lambda model: Recording.from_columns({"t": [0, 1]}, "raven"), "did you mean 'raven2'?"),
        (lambda model: Recording.from_columns({"t": [0, "x"]}, "bros"), "columns of numbers"),
        (lambda model: Recording(motion(1).table, {}, "bros"), "from_columns"),
        (lambda model: truejoint.read_recording(motion(1).table), "is no path"),
        (lambda model: truejoint.write_parquet(motion(1).table, "x.parquet"), "not a Recording"),
        (lambda model: truejoint.write_report(model, "x.html"), "not an Evaluation"),
        (lambda model: truejoint.evaluate(model, motion(1), tolerance=0.2), "{'jaw': 0.2}"),
        (lambda model: truejoint.evaluate(model, motion(1), tolerance={"jaw": "1"}), "positive"),
        (lambda model: truejoint.evaluate(model, motion(1), tolerance={"jw": 1}), "'jaw'?"),
        (lambda model: write_calibration("jaw.safetensors", model), "str, not a Calibration"),
        (lambda model: truejoint.calibrate(motion(1), joints="jw"), "called 'jw'; did you mean"),
        (lambda model: write_calibration(model, "model.onnx"), "call it model.safetensors"),
        (
            lambda model: truejoint.calibration.find_zero("m.st", motion(1)),
            "read_calibration(path)",
        ),
        (lambda model: truejoint.calibration.find_zero(model, "run.csv"), "read_recording"),
        (
            lambda model: truejoint.calibration.calibrate_like(motion(1), ["m.st"]),
            "not a Calibration",
        ),
        (lambda model: truejoint.calibration.with_interval(model, motion(0)), "used in the fit"),
        (lambda model: truejoint.calibration.with_interval(model, [], levels=0.9), "too few"),
        (lambda model: truejoint.calibration.cross_interval([]), "at least one"),
        (lambda model: truejoint.tip.read_block("none.toml"), "none.toml: cannot be read"),
        (lambda model: truejoint.tip.Touches(1.0, "1"), "a time and a name"),
        (lambda model: truejoint.tip.tracked_truth(motion(1), "p.csv"), "read_track(path)"),
        (lambda model: Corrector(motion(1)), "Recording, not a Calibration"),
        (lambda model: Corrector(model, level="0.9"), "level '0.9'"),
        (lambda model: Corrector(model).rezero("0.1 deg"), "could not convert"),
        (lambda model: Corrector(model).run("run.csv"), "read_recording"),
        (lambda model: truejoint.runtime.Monitor("m.st"), "read_calibration(path)"),
        (lambda model: truejoint.runtime.Compensator(model, motion(1).robot), "Corrector(model)"),
        (lambda model: truejoint.export.export_c("m.st", "out"), "read_calibration(path)"),
        (lambda model: truejoint.export.export_ros("m.st", "out"), "read_calibration(path)"),
        (lambda model: truejoint.motion.zigzag("raven2"), "get_robot(name) gives one"),
        (lambda model: truejoint.motion.zigzag(RAVEN, "J2", "1/4"), "sparsity '1/4'"),
        (lambda model: truejoint.motion.random_motion(RAVEN, 10.0, 1.5), "a whole number"),
        (lambda model: truejoint.motion.plot_trajectory([], "way.html"), "not a Trajectory"),
        (lambda model: truejoint.motion.write_trajectory("way.csv", WAY), "not a Trajectory"),
        (
            lambda model: truejoint.evaluation.part_by_time([motion(1)], 0.0, 0.5),
            "list, not a Recording",
        ),
        (lambda model: truejoint.evaluation.compare([], []), "one at least"),
        (lambda model: truejoint.evaluation.advise([], []), "its `errors` and `rows`"),
        (lambda model: truejoint.evaluation.tool_error(RAVEN, [0], [0]), "not a Kinematics"),
        (lambda model: truejoint.evaluate(model, motion(1)).score("lin", "jaw"), "'linear'?"),
        (lambda model: truejoint.evaluate(model, motion(1)).score("linear", "jw"), "'jaw'?"),
        (lambda model: truejoint.evaluate(model, motion(1), rezero="1"), "'1' s"),
        (lambda model: motion(1).rows([True, False]), "a mask of all"),
        (lambda model: truejoint.recordings.join_truth(motion(1), motion(2)), "read_truth(path)"),
        (lambda model: truejoint.recordings.Stream([0.0], {"truth/jaw": ["a"]}), "give numbers"),
        (lambda model: truejoint.robots.Joint("jaw", "rotary"), "revolute or prismatic"),
        (
            lambda model: truejoint.recordings.Track.of_readings([0.0], [1.0]),
            "must be (n,), (n, 3)",
        ),
        (lambda model: truejoint.evaluate(model, 5), "this is an int, not a Recording"),
        (lambda model: truejoint.read_calibration(7), "an int, not a path; give that of a model"),
        (lambda model: truejoint.calibrate(motion(1), fit_rate="30 Hz"), "fit rate is '30 Hz' Hz"),
        (lambda model: truejoint.write_parquet(motion(1), "run.csv"), "call it run.parquet"),
        (lambda model: truejoint.export.export_onnx(model, "model.c"), "call it model.onnx"),
        (lambda model: Recording.from_columns({"t": [0, 1]}, "wrist", "420006"), "not a mapping"),
        (lambda model: truejoint.recordings.Recorder("raven2"), "'raven2' is a str, not an Arm"),
        (
            lambda model: truejoint.recordings.Recorder(
                truejoint.crtk.simulated_arm("forceps"), path="run.csv"
            ),
            "run.csv: a recording is a .parquet file; call it run.parquet",
        ),
        (lambda model: truejoint.motion.Jog("raven2"), "'raven2' is a str, not an Arm"),
        (lambda model: truejoint.motion.follow("raven2", WAY), "'raven2' is a str, not an Arm"),
        (lambda model: truejoint.monitor.ArmPage("raven2"), "'raven2' is a str, not an Arm"),
        (lambda model: truejoint.crtk.SimulatedBackend("raven2"), "make_twin(robot) gives one"),
        (
            lambda model: truejoint.crtk.SimulatedBackend(
                truejoint.simulation.make_twin("forceps"), rate="fast"
            ),
            "fast set-points a second; a twin runs at 1000 Hz",
        ),
        (lambda model: truejoint.crtk.Arm("raven2"), "not a Backend; it lacks robot"),
        (lambda model: truejoint.crtk.time_law([[0.0], [1.0]], [0.0]), "a speed above 0"),
        (lambda model: truejoint.crtk.TimeLaw([0, 0], [[1], [2]]), "times (n,) that rise"),
        (lambda model: truejoint.simulation.make_twin("raven2", parameters={}), "not a path"),
        (lambda model: truejoint.simulation.make_twin("raven2", seed="1"), "a whole number"),
        (lambda model: truejoint.tip.Registration(np.eye(3)), "a Base"),
        (
            lambda model: truejoint.tip.find_block(model, motion(1), "t.csv", None),
            "read_touches(path)",
        ),
        (lambda model: truejoint.runtime.motor_loop("raven2"), "not a Robot"),
        (lambda model: truejoint.evaluation.render_report("page"), "not an Evaluation"),
        (lambda model: truejoint.studies.write_study("directions", "out"), "not a StudyResult"),
    ],
)
def test_mistakes_are_one_line(
    model: Calibration, mistake: Callable[[Calibration], object], said: str
) -> None:
    with pytest.raises(TruejointError) as refused:
        mistake(model)
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_corrected_recording_as_a_table(model: Calibration) -> None:
    test = motion(1)
    table = model.correct_table(test)
    assert isinstance(table, pd.DataFrame)
    assert list(table) == ["t", "corrected/jaw"]
    np.testing.assert_array_equal(table["corrected/jaw"], model.correct(test)[:, 0])


def test_values_show_themselves_in_a_few_lines(model: Calibration) -> None:
    robot = truejoint.get_robot("dvrk_psm")
    check = truejoint.recordings.check_data(motion(1))
    judged = truejoint.evaluate(model, motion(1))
    for value in (model, motion(1), judged, Corrector(model), robot, model.feature_set, check):
        assert "jaw" in repr(value)
        assert len(repr(value)) < 800
        assert len(repr(value).splitlines()) < 14
        assert value._repr_html_().startswith("<table>")
    assert len(repr(model.training_domain).splitlines()) < 6
    assert "<b>" not in Recording.from_columns({"t": [0, 1]}, "bros")._repr_html_()


def test_what_others_wrote_into_a_model_does_not_break_its_text(model: Calibration) -> None:
    for facts in ({"touch": 5}, {"touch": {"tip_error": "x"}}, {"duration": "long"}):
        assert "linear" in repr(model.with_metadata(**facts))


def test_the_package_lists_its_names() -> None:
    assert {"calibrate", "evaluate", "Recording", "runtime"} <= set(dir(truejoint))
