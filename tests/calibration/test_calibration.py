"""Correcting: whole recordings and sample by sample."""

from __future__ import annotations

import numpy as np
import pytest

from truejoint.calibration import calibrate
from truejoint.errors import CalibrationError
from truejoint.recordings import Recording

FEATURES = (
    "measured/elbow", "effort/elbow", "lag(measured/elbow, 2)", "lowpass(effort/elbow, 0.1)",
    "rate(measured/shoulder, 0.1)", "play(measured/elbow, 0.02)",
)  # fmt: skip


@pytest.fixture(scope="module")
def calibration(recording):
    return calibrate(recording, "linear", features=FEATURES)


def test_signals_hold_what_the_correction_is_added_to(calibration):
    assert calibration.signals == (
        "measured/elbow", "effort/elbow", "measured/shoulder", "measured/insertion",
    )  # fmt: skip
    assert dict(calibration.units) == {
        "measured/elbow": "rad", "effort/elbow": "Nm", "measured/shoulder": "rad",
        "measured/insertion": "m",
    }  # fmt: skip


def test_correcting_needs_no_truth(calibration, build):
    test = build(100, 3)
    bare = test.table.drop(columns=[c for c in test.table if c.startswith("truth")])
    bare = Recording(bare, test.units, test.provenance)
    assert calibration.correct(bare).tobytes() == calibration.correct(test).tobytes()


def refused(said: str, calibration, recording: Recording) -> None:
    with pytest.raises(CalibrationError, match=said) as caught:
        calibration.correct(recording)
    assert "\n" not in str(caught.value)


def test_other_robot_arm_columns_units_and_rate_are_refused(calibration, build, recording):
    refused(r"is of raven2 \(right arm\), the calibration of raven2 \(left arm\)",
            calibration, build(50, arm="right"))  # fmt: skip
    table = recording.table.drop(columns=["effort/elbow", "measured/insertion"])
    refused("lacks effort/elbow, measured/insertion, which",
            calibration, Recording(table, recording.units, recording.provenance))  # fmt: skip
    units = {**recording.units, "effort/elbow": "N"}
    refused("'effort/elbow' is in N, the calibration was made with Nm",
            calibration, Recording(recording.table, units, recording.provenance))  # fmt: skip
    refused("a row every 0.00", calibration, build(100, rate=1000.0))
    timed = calibrate(recording, "linear", features=FEATURES[:2])
    assert np.isfinite(timed.correct(build(100, rate=1000.0))).all()


def test_rows_that_each_follow_a_gap_tell_a_feature_with_a_memory_nothing(recording):
    sparse = recording.rows(np.arange(0, len(recording), 12))
    plain, play = (
        calibrate(recording, "linear", features=names) for names in (FEATURES[:2], FEATURES[-1:])
    )
    assert np.isfinite(plain.correct(sparse)).all()
    refused("for a gap, after which it knows no past", play, sparse)


def test_metadata_can_be_added(calibration):
    more = calibration.with_metadata(held_out={"elbow": np.float64(0.1)}, command="truejoint x")
    assert more.metadata["held_out"] == {"elbow": 0.1}
    assert more.metadata["rows"] == calibration.metadata["rows"]
    assert "command" not in calibration.metadata
    for value in (float("nan"), {1, 2}, object()):
        with pytest.raises(CalibrationError, match="held_out cannot be kept as JSON"):
            calibration.with_metadata(held_out=value)


def test_names_for_people(calibration):
    assert calibration.estimator == "linear"
    assert calibration.title == "raven2 (left arm)"
