"""Correcting: whole recordings and sample by sample."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from truejoint.calibration import calibrate
from truejoint.errors import CalibrationError
from truejoint.estimators import NeuralNetwork
from truejoint.recordings import Recording

FEATURES = (
    "measured/elbow", "effort/elbow", "lag(measured/elbow, 2)", "lowpass(effort/elbow, 0.1)",
    "rate(measured/shoulder, 0.1)", "play(measured/elbow, 0.02)",
)  # fmt: skip


@pytest.fixture(scope="module")
def calibration(recording):
    return calibrate(recording, "linear", features=FEATURES)


@pytest.mark.parametrize("target", ["error", "position"])
@pytest.mark.parametrize(
    "estimator", ["linear", "poly2", NeuralNetwork(hidden_layer_sizes=(8, 8), epochs=2)], ids=str
)
def test_step_gives_the_bits_of_correct(build, recording, estimator, target):
    calibration = calibrate(recording, estimator, features=FEATURES, target=target)
    test = build(200, 5)
    t = test.t.copy()
    t[120:] += 3.0  # a gap, after which the history starts anew
    test = Recording(test.table.assign(t=t), test.units, test.provenance)
    whole = calibration.correct(test)
    state = calibration.start()
    signals = test.table[list(calibration.signals)].to_numpy()
    for row in range(len(test)):
        assert calibration.step(state, t[row], signals[row]).tobytes() == whole[row].tobytes()


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


def test_wrong_sample_is_refused_and_leaves_the_state(calibration, recording):
    signals = recording.table[list(calibration.signals)].to_numpy()
    state = calibration.start()
    calibration.step(state, 0.0, signals[0])
    nan = signals[1].copy()
    nan[2] = np.nan
    for t, sample, said in (
        (0.03, nan, "'measured/shoulder' is not finite"),
        (0.03, signals[1, :3], "must hold the 4 signals"),
        (0.0, signals[1], "does not follow that at"),
        (-1.0, signals[1], "does not follow that at"),
        (float("nan"), signals[1], "does not follow that at"),
    ):
        before = state.features.memory.tobytes(), state.features.clock.tobytes()
        with pytest.raises(CalibrationError, match=said):
            calibration.step(state, t, sample)
        assert before == (state.features.memory.tobytes(), state.features.clock.tobytes())


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
    assert replace(calibration, arm="").title == "raven2"
