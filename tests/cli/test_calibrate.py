"""`truejoint calibrate`: an automatic choice, and an interval of what it is fitted to."""

from __future__ import annotations

import json

import pytest
from tests.cli.conftest import Call
from tests.runtime.registered import model, wrist
from tests.synthetic import build_recording

from truejoint.calibration import read_calibration, write_calibration
from truejoint.cli.fit_options import FitOptions
from truejoint.estimators import get_estimator
from truejoint.recordings import Recording, write_parquet

JOINTS = ("shoulder", "elbow")
GRASPER = "davinci_grasper_umn"


@pytest.fixture
def sessions(tmp_path):
    paths = [tmp_path / f"s{seed}.parquet" for seed in range(3)]
    for seed, path in enumerate(paths):
        write_parquet(build_recording(900, seed), path)
    return paths


def test_auto_prints_what_was_tried_and_keeps_it(call: Call, sessions, tmp_path, monkeypatch):
    few = [get_estimator(name) for name in ("offset", "linear", "poly2")]
    monkeypatch.setattr("truejoint.estimators.candidates", lambda: few)
    monkeypatch.setattr("truejoint.cli.console._LOG_PERIOD", 0.0)
    path = tmp_path / "m.safetensors"
    done = call("calibrate", *sessions, "-e", "auto", "--interval", "cross", "-o", path,
                "--accept", "unit")  # fmt: skip
    assert done.code == 0, done.err
    assert "s left: Choosing: poly2 without recordings 2" in done.err
    assert "RMSE on 3 parts left out" in done.out
    assert "(100%)" in done.out, done.out
    assert "shoulder [deg]" in done.out
    model = read_calibration(path)
    assert model.estimator == "poly2"
    assert model.metadata["choice"]["reference"] == "linear"
    assert "time [s]" in done.out
    assert model.metadata["fit_seconds"] > 0.0
    assert f"in {model.metadata['fit_seconds']:.1f} s" in model.summary()["trained on"]
    assert (model.interval.trajectories, model.interval.cut, model.interval.whole) == (15, 3, 3)
    assert "15 parts of its 3 recordings" in done.out.replace("\n", " ")


def test_a_chosen_model_is_a_prior_and_its_choice_is_told_once(call: Call, tmp_path, monkeypatch):
    few = [get_estimator("poly2")]
    monkeypatch.setattr("truejoint.estimators.candidates", lambda: few)
    paths = [tmp_path / f"s{seed}.parquet" for seed in range(2)]
    for seed, path in enumerate(paths):
        write_parquet(build_recording(900, seed), path)
    prior, changed = tmp_path / "prior.st", tmp_path / "changed.st"
    assert call("calibrate", paths[0], "-e", "auto", "-o", prior, "--accept", "unit").code == 0
    done = call("adapt", prior, paths[1], "-o", changed, "--accept", "unit")
    assert done.code == 0, done.err
    assert "left out (share" not in done.out
    assert "prior" in read_calibration(changed).metadata


def test_an_interval_of_the_same_recordings_is_in_the_json(call: Call, sessions, tmp_path):
    path = tmp_path / "m.safetensors"
    how = ["-e", "linear", "--interval", "cross", "--json"]
    done = call("calibrate", sessions[0], *how, "-o", path)
    assert done.code == 0, done.err
    assert json.loads(done.out)["metadata"]["interval_sessions"][0]["session"] == "s0"
    assert read_calibration(path).interval.cut == 1


def test_columns_that_check_are_chosen(call: Call, tmp_path):
    made = build_recording(900, 0)
    motor = {f"motor/{joint}": 8.0 * made.column(f"measured/{joint}") for joint in JOINTS}
    units = {**made.units, **dict.fromkeys(motor, "rad")}
    path = tmp_path / "s.parquet"
    write_parquet(Recording(made.table.assign(**motor), units, made.provenance), path)
    model = tmp_path / "m.safetensors"
    for asked, used in {"motor/elbow": ["motor/elbow"], "none": []}.items():
        done = call("calibrate", path, "-e", "linear", "--redundant", asked, "-o", model, "--force")
        assert done.code == 0, done.err
        assert list(read_calibration(model).redundant) == used


@pytest.mark.parametrize(
    ("name", "features"),
    [("hybrid", None), ("linear", [GRASPER]), ("auto", [GRASPER]), (None, [GRASPER])],
)
def test_features_that_suit_a_data_set_do_not_replace_an_estimators_own(name, features):
    assert FitOptions(estimator=name).suited_to(GRASPER).features == features


def test_what_was_identified_is_shown_with_its_deviation(call: Call, tmp_path):
    path = tmp_path / "cables.st"
    write_calibration(model("ukf_cables"), path)
    text = call("show", path).out
    assert "deviation" in text
    assert "jaw1_stiffness" in text
    assert "tip_second_dead_band" in text
    (shown,) = json.loads(call("show", path, "--json").out)["shown"]
    assert shown["identified"]["tension"][2] == "N"


def test_a_wrist_without_a_load_is_refused_in_one_line(call: Call, tmp_path):
    path = tmp_path / "free.parquet"
    write_parquet(wrist()[0], path)
    result = call("calibrate", path, "-e", "ukf_cables", "-o", tmp_path / "m.st")
    assert result.code == 2
    assert "add a minute under known loads" in result.err


def test_models_of_like_instruments_make_a_model_of_few_seconds(call, session, tmp_path):
    (tmp_path / "lab").mkdir()
    (tmp_path / "lab" / "one.st").write_bytes((session / "m.st").read_bytes())
    output, brief = tmp_path / "new.st", (session / "zigzag.parquet", "--part", "0:0.2")
    made = call("calibrate", *brief, "--like", tmp_path / "lab", session / "m.st", "-o", output)
    assert made.code == 0, made.err
    assert made.out.count("50 %") == 2 * 3  # two models alike, three joints
    assert read_calibration(output).estimator == "pooled"
    (tmp_path / "empty").mkdir()
    refused = call("calibrate", *brief, "--like", tmp_path / "empty", "-o", output, "--force")
    assert refused.code == 2
    assert "no model file is there" in refused.err
    refused = call("calibrate", *brief, "--like", session / "m.st", "--interval", "cross",
                   "-o", output, "--force")  # fmt: skip
    assert "leave out cross" in refused.err
