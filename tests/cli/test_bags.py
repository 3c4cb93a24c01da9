"""`truejoint extract`, `bag` and `doctor`, as a person calls them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from tests.cli.conftest import Call

from truejoint import read_recording

pytest.importorskip("rosbags", reason="rosbags is not installed (truejoint[ros])")


@pytest.fixture(scope="module")
def bag(session: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("bags") / "random.bag"


def test_a_session_goes_to_a_bag_and_back(call: Call, session: Path, bag: Path, tmp_path: Path):
    made = call("export", session / "random.parquet", "--to", "bag", "-o", bag)
    assert made.code == 0, made.err
    assert "/ravenstate" in made.out
    listed = call("extract", bag)
    assert "/ext_jpos  sensor_msgs/JointState" in listed.out
    output = tmp_path / "again.parquet"
    told = call(
        "extract",
        bag,
        "-o",
        output,
        "--metadata",
        "load_grams=200",
        "--metadata",
        "homing_id=x",
        "--json",
    )
    assert told.code == 0, told.err
    assert json.loads(told.out)["homing_id"] == "x"
    again, before = read_recording(output), read_recording(session / "random.parquet")
    assert again.provenance.load == 0.2
    assert again.provenance.command.startswith("truejoint extract")
    np.testing.assert_allclose(
        again.column("measured/elbow"), before.column("measured/elbow"), rtol=1e-6
    )
    assert call("extract", bag, "-o", output).code == 2

    # The joint sensors from a file, beside the bag of the robot.
    truth = before.table[["t", *(c for c in before.table if str(c).startswith("truth/"))]]
    truth.dropna().to_csv(tmp_path / "encoders.csv", index=False)
    joined = tmp_path / "joined.parquet"
    sensors = ("--truth", tmp_path / "encoders.csv", "--offset-s", before.provenance.start)
    assert call("extract", bag, *map(str, sensors), "-o", joined).code == 0
    assert np.isfinite(read_recording(joined).column("truth/elbow")).mean() > 0.9


def test_the_doctor_says_a_line_for_each_verdict(call: Call, session: Path, bag: Path):
    assert bag.exists()
    for target in (session / "random.parquet", bag):
        told = call("doctor", target)
        assert told.code == 0, told.out
        assert len(told.out.splitlines()) == 14
        assert "effort sign: net work of the efforts" in told.out
    swapped = call("doctor", bag, "--robot", "raven2:right", "--json")
    assert swapped.code == 1
    findings = json.loads(swapped.out)["findings"]
    assert "arm" in {finding["heading"] for finding in findings if finding["level"] == "fail"}
