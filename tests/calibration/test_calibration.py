"""Correcting: whole recordings and sample by sample."""

from dataclasses import replace

import numpy as np
import pytest
from tests.refusals import refused

from truejoint.calibration import Zero, calibrate, find_zero
from truejoint.recordings import Recording
from truejoint.runtime import Corrector

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
    assert (calibration.estimator, calibration.title) == ("linear", "raven2 (left arm)")


def test_correcting_needs_no_truth(calibration, build):
    test = build(100, 3)
    bare = test.table.drop(columns=[c for c in test.table if c.startswith("truth")])
    bare = Recording(bare, test.units, test.provenance)
    assert calibration.correct(bare).tobytes() == calibration.correct(test).tobytes()


def test_other_robot_arm_columns_units_and_rate_are_refused(calibration, build, recording):
    correct = calibration.correct
    said = r"is of raven2 \(right arm\), the calibration of raven2 \(left arm\)"
    refused(said, correct, build(50, arm="right"))
    table = recording.table.drop(columns=["effort/elbow", "measured/insertion"])
    bare = Recording(table, recording.units, recording.provenance)
    refused("lacks effort/elbow, measured/insertion, which", correct, bare)
    units = {**recording.units, "effort/elbow": "N"}
    other = Recording(recording.table, units, recording.provenance)
    refused("'effort/elbow' is in N, the calibration was made with Nm", correct, other)
    refused("a row every 0.00", correct, build(100, rate=1000.0))
    timed = calibrate(recording, "linear", features=FEATURES[:2])
    assert np.isfinite(timed.correct(build(100, rate=1000.0))).all()


def test_rows_that_each_follow_a_gap_tell_a_feature_with_a_memory_nothing(recording):
    sparse = recording.rows(np.arange(0, len(recording), 12))
    plain, play = (
        calibrate(recording, "linear", features=names) for names in (FEATURES[:2], FEATURES[-1:])
    )
    assert np.isfinite(plain.correct(sparse)).all()
    refused("so that it tells too little of the past", play.correct, sparse)


def test_metadata_can_be_added(calibration):
    more = calibration.with_metadata(held_out={"elbow": np.float64(0.1)}, command="truejoint x")
    assert more.metadata["held_out"] == {"elbow": 0.1}
    assert more.metadata["rows"] == calibration.metadata["rows"]
    assert "command" not in calibration.metadata
    for value in (float("nan"), {1, 2}, object()):
        refused("held_out cannot be kept as JSON", calibration.with_metadata, held_out=value)


@pytest.fixture(scope="module")
def plain(build):
    features = ("measured/shoulder", "measured/elbow", "measured/insertion", "effort/elbow")
    return calibrate(build(1500, 0), "linear", features=features)


def test_rows_serve_as_the_recording_does(plain, build):
    test = build(200, 3)
    rows = plain.rows(test)
    assert plain.rows(rows) is rows
    assert plain.baselines["offset"].rows(rows) is rows
    assert plain.correct(rows).tobytes() == plain.correct(test).tobytes()
    assert plain.range_excess(rows).tobytes() == plain.range_excess(test).tobytes()
    assert find_zero(plain, rows).offset.tolist() == find_zero(plain, test).offset.tolist()


def test_rows_are_seen_anew_where_the_inputs_have_moved_and_stay_hidden(plain, build):
    rows = plain.rows(build(200, 3))
    hidden = rows.hide(np.arange(200) < 50)
    moves = np.array([[s == f"measured/{j}" for j in plain.joints] for s in plain.signals], float)
    moved = replace(plain, moves=moves).shifted(np.full(3, 0.02))
    again = moved.rows(hidden)
    assert not np.array_equal(again.X, rows.X)
    assert again.known.sum() == 150
    assert moved.correct(again).tobytes() == moved.correct(rows.recording).tobytes()


def test_one_door_takes_any_zero(plain, build):
    test, offset = build(200, 3), np.array([0.01, -0.02, 1e-3])
    moved = plain.at(Zero(offset, source="a stop", homing_id="h9"))
    np.testing.assert_allclose(moved.correct(test) - plain.correct(test), [offset] * 200)
    for name, baseline in moved.baselines.items():
        shift = baseline.correct(test) - plain.baselines[name].correct(test)
        np.testing.assert_allclose(shift, [offset] * 200)
    assert moved.origin.homing_ids == ("h9",)
    assert "a stop" in moved.summary()["zero"]
    corrector = Corrector(plain)
    corrector.rezero(Zero(offset))
    assert corrector.offset.tolist() == offset.tolist()
    for wrong in (np.zeros(2), np.full(3, np.nan)):
        refused("not a finite number for each of shoulder", plain.at, Zero(wrong))
