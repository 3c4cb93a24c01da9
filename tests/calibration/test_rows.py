"""A recording is seen once; what is made of its rows is what is made of the recording."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from truejoint.calibration import Zero, calibrate, find_zero
from truejoint.calibration.fit_task import signal_moves
from truejoint.errors import CalibrationError
from truejoint.runtime import Corrector

FEATURES = ("measured/shoulder", "measured/elbow", "measured/insertion", "effort/elbow")


@pytest.fixture(scope="module")
def calibration(build):
    return calibrate(build(1500, 0), "linear", features=FEATURES)


def test_rows_serve_as_the_recording_does(calibration, build):
    test = build(200, 3)
    rows = calibration.rows(test)
    assert calibration.rows(rows) is rows
    assert calibration.baselines["offset"].rows(rows) is rows
    assert calibration.correct(rows).tobytes() == calibration.correct(test).tobytes()
    assert calibration.range_excess(rows).tobytes() == calibration.range_excess(test).tobytes()
    assert (
        find_zero(calibration, rows).offset.tolist() == find_zero(calibration, test).offset.tolist()
    )


def test_rows_are_seen_anew_where_the_inputs_have_moved_and_stay_hidden(calibration, build):
    rows = calibration.rows(build(200, 3))
    hidden = rows.hide(np.arange(200) < 50)
    moves = signal_moves([rows.recording], calibration.signals, calibration.joints)
    moved = replace(calibration, moves=moves).shifted(np.full(3, 0.02))
    again = moved.rows(hidden)
    assert not np.array_equal(again.X, rows.X)
    assert again.known.sum() == 150
    assert moved.correct(again).tobytes() == moved.correct(rows.recording).tobytes()


def test_one_door_takes_any_zero(calibration, build):
    test, offset = build(200, 3), np.array([0.01, -0.02, 1e-3])
    moved = calibration.at(Zero(offset, source="a stop", homing_id="h9"))
    np.testing.assert_allclose(moved.correct(test) - calibration.correct(test), [offset] * 200)
    for name, baseline in moved.baselines.items():
        shift = baseline.correct(test) - calibration.baselines[name].correct(test)
        np.testing.assert_allclose(shift, [offset] * 200)
    assert moved.origin.homing_ids == ("h9",)
    assert "a stop" in moved.summary()["zero"]
    corrector = Corrector(calibration)
    corrector.rezero(Zero(offset))
    assert corrector.offset.tolist() == offset.tolist()
    for wrong in (np.zeros(2), np.full(3, np.nan)):
        with pytest.raises(CalibrationError, match="not a finite number for each of shoulder"):
            calibration.at(Zero(wrong))
