"""Checking with a brief truth."""

import math
from dataclasses import replace

import numpy as np
import pytest

from truejoint.calibration import calibrate, find_zero, with_interval
from truejoint.calibration.zero import believed
from truejoint.errors import CalibrationError
from truejoint.recordings import Provenance, Recording
from truejoint.runtime import Alarm, Corrector, Reason, check_calibration

JOINTS = ("shoulder", "elbow", "insertion")
FEATURES = [f"{quantity}/{joint}" for quantity in ("measured", "effort") for joint in JOINTS]
NOISE = 1e-3


def motion(seed: int, *, duration: float = 60.0, offset: float = 0.0, load: float = 0.0):
    """Smooth motion of three joints; efforts follow the position, truth is off by a constant."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, duration, 0.05)
    columns = {"t": t}
    for k, joint in enumerate(JOINTS):
        wave = np.sin(0.3 * (k + 1) * t + rng.uniform(0, 6))
        columns[f"measured/{joint}"] = 0.5 + 0.1 * wave
        columns[f"effort/{joint}"] = 0.1 * wave + load + rng.normal(0, 0.01, len(t))
        columns[f"truth/{joint}"] = 0.52 + 0.1 * wave + offset + rng.normal(0, NOISE, len(t))
    origin = Provenance("raven2", arm="left", source=f"m{seed}", homing_id=f"h{seed}")
    return Recording.from_columns(columns, origin)


@pytest.fixture(scope="module")
def calibration():
    fitted = calibrate([motion(0, duration=300.0), motion(1)], "linear", features=FEATURES)
    return with_interval(fitted, [motion(seed) for seed in range(2, 14)])


def sparse(recording: Recording, rows: list[int]) -> Recording:
    """Keep the truth in a few rows only."""
    truth = {}
    for joint in JOINTS:
        values = np.full(len(recording), np.nan)
        values[rows] = recording.column(f"truth/{joint}")[rows]
        truth[f"truth/{joint}"] = values
    return Recording(recording.table.assign(**truth), recording.units, recording.provenance)


def test_a_calibration_that_holds(calibration):
    test = motion(20)
    found = check_calibration(calibration, test)
    assert found.holds is True
    assert (found.rows, found.duration) == (len(test), pytest.approx(59.95))
    assert (found.alarm, found.reasons) == (Alarm.NONE, Reason.NOTHING)
    error = test.columns("truth", JOINTS) - calibration.correct(test)
    corrected, lower, upper = calibration.correct_with_interval(test)
    truth = test.columns("truth", JOINTS)
    for k, joint in enumerate(found.joints):
        assert (joint.joint, joint.unit) == (JOINTS[k], "m" if k == 2 else "rad")
        assert joint.rmse == pytest.approx(np.sqrt(np.mean(error[:, k] ** 2)))
        assert joint.largest == pytest.approx(np.abs(error[:, k]).max())
        assert joint.offset == pytest.approx(np.median(error[:, k]))
        zero = believed(joint.offset, joint.offset_sd)
        assert joint.rezeroed_rmse == pytest.approx(np.sqrt(np.mean((error[:, k] - zero) ** 2)))
        assert joint.half_width == pytest.approx((upper - corrected)[:, k].mean())
        inside = (lower[:, k] <= truth[:, k]) & (truth[:, k] <= upper[:, k])
        assert joint.inside == pytest.approx(inside.mean())


def test_an_offset_is_found_from_three_readings_and_mended(calibration):
    test = sparse(motion(21, offset=0.05), [100, 500, 900])
    found = check_calibration(calibration, test)
    assert found.rows == 3
    assert found.holds is False
    for joint in found.joints:
        assert joint.offset == pytest.approx(0.05, abs=4 * NOISE)
        assert 0.3 * NOISE < joint.offset_sd < NOISE
        assert joint.inside == 0.0
    assert check_calibration(calibration.at(find_zero(calibration, test)), test).holds is True


def test_the_stated_level_nearest_to_90_is_judged_where_none_is_asked_for(calibration):
    stated = calibration.interval
    for levels in ([0.8], [0.8, 0.9], [0.95]):
        widths = np.repeat(stated.half_widths[:1], len(levels), axis=0)
        interval = replace(stated, levels=np.array(levels), half_widths=widths)
        model = replace(calibration, interval=interval)
        assert check_calibration(model, motion(20)).level == levels[-1]


def test_one_joint_off_is_enough_to_fail(calibration):
    test = motion(22)
    table = test.table.assign(**{"truth/elbow": test.table["truth/elbow"] + 0.1})
    found = check_calibration(calibration, Recording(table, test.units, test.provenance))
    assert [joint.holds for joint in found.joints] == [True, False, True]
    assert found.holds is False


def test_without_an_interval_there_are_figures_but_no_verdict(calibration):
    bare = replace(calibration, interval=None, effort_baseline=None)
    found = check_calibration(bare, motion(23))
    assert found.holds is None
    assert all(joint.holds is None and math.isnan(joint.inside) for joint in found.joints)
    written = found.to_dict()
    assert written["holds"] is None
    assert written["joints"][0]["inside"] is None
    assert written["joints"][0]["offset_sd"] is None
    assert written["alarm"] == "none"


def test_what_the_monitor_saw_is_told(calibration):
    found = check_calibration(calibration, motion(24, duration=200.0, load=0.08))
    assert found.alarm >= Alarm.CHECK
    assert "shift" in found.to_dict()["reasons"]


def test_a_recording_without_truth_or_another_level_is_refused(calibration):
    with pytest.raises(CalibrationError, match="no row has the truth"):
        check_calibration(calibration, sparse(motion(25), []))
    with pytest.raises(CalibrationError, match="99 % interval"):
        check_calibration(calibration, motion(25), level=0.99)
    with pytest.raises(CalibrationError, match="states no interval"):
        check_calibration(replace(calibration, interval=None), motion(25), level=0.9)


def test_the_loop_takes_a_rezeroed_file_for_zeroed(calibration):
    test = motion(26, offset=0.05)
    zeroing = with_interval(
        replace(calibration, interval=None), [motion(seed) for seed in range(2, 14)], rezero=5.0
    )
    row = test.table[list(calibration.signals)].to_numpy()[0]
    for model, known in ((zeroing, False), (zeroing.at(find_zero(zeroing, test)), True)):
        corrector = Corrector(model)
        corrector.set_homing(is_homed=True, homing_id="h26" if known else "h0")
        corrector.step(0.0, row)
        assert np.isfinite(corrector.half_width).all() == known
    corrector.set_homing(is_homed=True, homing_id="h99")
    corrector.step(0.05, row)
    assert np.isinf(corrector.half_width).all()
