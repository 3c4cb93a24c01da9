"""`truejoint calibrate`: an automatic choice, and an interval of what it is fitted to."""

import pytest
from tests.runtime.registered import model, wrist
from tests.synthetic import build_recording

from truejoint.calibration import Automatic, read_calibration, write_calibration
from truejoint.cli.calibrate import FitOptions
from truejoint.estimators import get_estimator
from truejoint.recordings import Recording, write_parquet

GRASPER = "davinci_grasper_umn"


@pytest.fixture
def sessions(call):
    """Files of three sessions, in this folder."""
    for seed in range(3):
        write_parquet(build_recording(900, seed), f"s{seed}.parquet")
    return "s0.parquet s1.parquet s2.parquet"


def test_auto_prints_what_was_tried_and_its_model_is_a_prior(call, sessions, monkeypatch):
    few = [get_estimator(name) for name in ("offset", "linear", "poly2")]
    monkeypatch.setattr("truejoint.estimators.candidates", lambda: few)
    monkeypatch.setattr("truejoint.cli.console._LOG_PERIOD", 0.0)
    done = call.good(f"calibrate {sessions} -e auto --interval cross -o m.st --accept unit")
    assert "s left: Choosing: poly2 without recordings 2" in done.err
    assert "RMSE on 3 parts left out" in done.out
    assert "(100%)" in done.out, done.out
    assert "shoulder [deg]" in done.out
    assert "time [s]" in done.out
    model = read_calibration("m.st")
    assert model.estimator == "poly2"
    assert model.metadata["choice"]["reference"] == "linear"
    assert model.metadata["fit_seconds"] > 0.0
    assert f"in {model.metadata['fit_seconds']:.1f} s" in model.summary()["trained on"]
    assert (model.interval.trajectories, model.interval.cut, model.interval.whole) == (15, 3, 3)
    assert "15 parts of its 3 recordings" in done.out.replace("\n", " ")


def test_an_interval_of_the_same_recordings_is_in_the_json(call, sessions):
    made = call.json("calibrate s0.parquet -e linear --interval cross -o m.safetensors")
    assert made["metadata"]["interval_sessions"][0]["session"] == "s0"
    assert read_calibration("m.safetensors").interval.cut == 1


def test_columns_that_check_are_chosen(call):
    made = build_recording(900, 0)
    motor = {f"motor/{j}": 8.0 * made.column(f"measured/{j}") for j in ("shoulder", "elbow")}
    units = {**made.units, **dict.fromkeys(motor, "rad")}
    write_parquet(Recording(made.table.assign(**motor), units, made.provenance), "s.parquet")
    for asked, used in {"motor/elbow": ["motor/elbow"], "none": []}.items():
        call.good(f"calibrate s.parquet -e linear --redundant {asked} -o m.st --force")
        assert list(read_calibration("m.st").redundant) == used


@pytest.mark.parametrize(
    ("name", "features"),
    [("hybrid", None), ("linear", [GRASPER]), ("auto", [GRASPER]), (None, [GRASPER])],
)
def test_features_that_suit_a_data_set_do_not_replace_an_estimators_own(name, features):
    assert FitOptions(estimator=name).suited_to(GRASPER).features == features


@pytest.mark.parametrize("dataset", [None, GRASPER])  # whose features take none of that time
def test_the_choice_has_the_time_that_it_has_in_python(dataset):
    assert FitOptions().unfitted(dataset).seconds == Automatic().seconds == 60.0


def test_what_was_identified_is_shown_with_its_deviation(call):
    write_calibration(model("ukf_cables"), "cables.st")
    text = call("show cables.st").out
    for word in ("deviation", "jaw1_stiffness", "tip_second_dead_band"):
        assert word in text
    (shown,) = call.json("show cables.st")["shown"]
    assert shown["identified"]["tension"][2] == "N"


def test_a_wrist_without_a_load_is_refused_in_one_line(call):
    write_parquet(wrist()[0], "free.parquet")
    call.refuses("add a minute under known loads", "calibrate free.parquet -e ukf_cables -o m.st")


def test_models_of_like_instruments_make_a_model_of_few_seconds(call, session, tmp_path):
    (tmp_path / "lab").mkdir()
    (tmp_path / "empty").mkdir()
    (tmp_path / "lab" / "one.st").write_bytes((session / "m.st").read_bytes())
    line = f"calibrate {session}/zigzag.parquet --part 0:0.2 -o {tmp_path}/new.st --like"
    said = call.good(f"{line} {tmp_path}/lab {session}/m.st")
    assert said.out.count("50 %") == 2 * 3  # two models alike, three joints
    assert read_calibration(tmp_path / "new.st").estimator == "pooled"
    call.refuses("no model file is there", f"{line} {tmp_path}/empty --force")
    call.refuses("leave out cross", f"{line} {session}/m.st --interval cross --force")
