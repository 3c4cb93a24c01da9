"""`truejoint extract`, `bag` and `doctor`, as a person calls them."""

from pathlib import Path

import numpy as np
import pytest

from truejoint import read_recording

pytest.importorskip("rosbags", reason="rosbags is not installed (truejoint[ros])")


@pytest.fixture
def bag(call, session) -> Path:
    made = call.good(f"export {session}/random.parquet --to bag -o random.bag")
    assert "/ravenstate" in made.out
    return Path("random.bag")


def test_a_session_goes_to_a_bag_and_back(call, session, bag):
    assert "/ext_jpos  sensor_msgs/JointState" in call(f"extract {bag}").out
    line = f"extract {bag} -o again.parquet --metadata load_grams=200 --metadata homing_id=x"
    assert call.json(line)["homing_id"] == "x"
    again, before = read_recording("again.parquet"), read_recording(session / "random.parquet")
    assert again.provenance.load == 0.2
    assert again.provenance.command.startswith("truejoint extract")
    np.testing.assert_allclose(
        again.column("measured/elbow"), before.column("measured/elbow"), rtol=1e-6
    )
    call.refuses("--force", line)

    # The joint sensors from a file, beside the bag of the robot.
    truth = before.table[["t", *(c for c in before.table if str(c).startswith("truth/"))]]
    truth.dropna().to_csv("encoders.csv", index=False)
    sensors = f"--truth encoders.csv --offset-s {before.provenance.start}"
    call.good(f"extract {bag} {sensors} -o joined.parquet")
    assert np.isfinite(read_recording("joined.parquet").column("truth/elbow")).mean() > 0.9


def test_the_doctor_says_a_line_for_each_verdict(call, session, bag):
    for target in (session / "random.parquet", bag):
        told = call.good(f"doctor {target}")
        assert len(told.out.splitlines()) == 15
        assert "effort sign: net work of the efforts" in told.out
    findings = call.json(f"doctor {bag} --robot raven2:right", code=1)["findings"]
    assert "arm" in {finding["heading"] for finding in findings if finding["level"] == "fail"}
