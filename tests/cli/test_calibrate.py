"""`truejoint calibrate`: an automatic choice, and an interval of what it is fitted to."""

from __future__ import annotations

import json

import pytest
from tests.cli.conftest import Call
from tests.synthetic import build_recording

from truejoint.calibration import read_calibration
from truejoint.estimators import get_estimator
from truejoint.recordings import write_parquet


@pytest.fixture
def sessions(tmp_path):
    paths = [tmp_path / f"s{seed}.parquet" for seed in range(3)]
    for seed, path in enumerate(paths):
        write_parquet(build_recording(900, seed), path)
    return paths


def test_auto_prints_what_was_tried_and_keeps_it(call: Call, sessions, tmp_path, monkeypatch):
    few = [get_estimator(name) for name in ("offset", "linear", "poly2")]
    monkeypatch.setattr("truejoint.estimators.candidates", lambda: few)
    path = tmp_path / "m.safetensors"
    done = call("calibrate", *sessions, "-e", "auto", "--interval", "cross", "-o", path,
                "--accept", "unit")  # fmt: skip
    assert done.code == 0, done.err
    assert "RMSE on 3 parts left out" in done.out
    assert "(100%)" in done.out, done.out
    assert "shoulder [deg]" in done.out
    model = read_calibration(path)
    assert model.estimator == "poly2"
    assert model.metadata["choice"]["reference"] == "linear"
    assert (model.interval.trajectories, model.interval.cut) == (15, 3)
    assert "15 parts of its 3 recordings" in done.out.replace("\n", " ")


def test_an_interval_of_the_same_recordings_is_in_the_json(call: Call, sessions, tmp_path):
    path = tmp_path / "m.safetensors"
    how = ["-e", "linear", "--interval", "cross", "--interval-rezero-s", "1", "--json"]
    done = call("calibrate", sessions[0], *how, "-o", path)
    assert done.code == 0, done.err
    assert json.loads(done.out)["metadata"]["interval_sessions"][0]["session"] == "s0"
    assert read_calibration(path).interval.rezero == 1.0


def test_a_setting_needs_an_estimator(call: Call, sessions, tmp_path):
    done = call(
        "calibrate", sessions[0], "-e", "auto", "--set", "epochs=3", "-o", tmp_path / "m.st"
    )
    assert (done.code, done.out) == (2, "")
    assert "--set 'epochs=3' needs one estimator; name it with -e" in done.err
