"""Tests of truejoint.monitor.samples."""

from dataclasses import replace

import numpy as np
import pytest
from tests.synthetic import jaw_motion

from truejoint.calibration import calibrate
from truejoint.errors import CalibrationError, RecordingError
from truejoint.monitor.samples import MOST_ROWS, LiveSamples, Samples
from truejoint.recordings import Provenance, Recording
from truejoint.robots import get_robot
from truejoint.robots.blocks import StateBlock, TruthBlock
from truejoint.runtime import Corrector, Status


def _blocks(recording, first=0, last=None, truth_every=10):
    """What an arm would have reported while it was recorded."""
    rows = slice(first, last)
    t = recording.t[rows]
    measured, effort, truth = (
        recording.column(f"{q}/jaw")[rows, None] for q in ("measured", "effort", "truth")
    )
    zero = np.zeros_like(measured)
    state = StateBlock(t, ("jaw",), measured, zero, effort, measured + 0.1, zero, zero)
    return state, TruthBlock(t[::truth_every], ("jaw",), truth[::truth_every])


@pytest.fixture
def live(jaw_model):
    live = LiveSamples(get_robot("davinci_grasper"), jaw_model)
    live.set_homing(True, "h")
    return live


def test_a_recording_is_corrected_as_the_loop_would(jaw_recording, jaw_model):
    samples = Samples.of_recording(jaw_recording, jaw_model)
    trace = Corrector(jaw_model)
    trace.set_homing(True, "h")
    trace = trace.run(jaw_recording)
    good = trace.status == Status.OK
    assert good.sum() > 300
    assert np.array_equal(samples.corrected[good], trace.position[good])
    assert np.array_equal(samples.half_width[good], trace.half_width[good])
    assert np.isnan(samples.corrected[~good]).all()
    assert np.array_equal(samples.truth[:, 0], jaw_recording.column("truth/jaw"))
    assert np.isnan(samples.setpoint).all()
    assert samples.effort_units == ("Nm",)
    assert np.isnan(samples.interval[0])
    assert samples.interval[1:] == pytest.approx(np.full(399, 0.01))


def test_live_is_what_the_recording_shows(jaw_recording, jaw_model, live):
    whole = Samples.of_recording(jaw_recording, jaw_model)
    for first in range(0, 400, 40):
        state, truth = _blocks(jaw_recording, first, first + 40)
        row = live.row([state.rows(slice(0, 7)), state.rows(slice(7, None))], [truth], 0.02)
        at = first + 30  # of the last reading of the joint encoder
        assert row.t[0] == jaw_recording.t[at]
        for name in ("reported", "corrected", "half_width", "truth", "effort", "status"):
            assert getattr(row, name)[0] == pytest.approx(getattr(whole, name)[at]), name
        assert row.setpoint[0, 0] == pytest.approx(row.reported[0, 0] + 0.1)
        assert row.interval[0] == 0.02


def test_truth_is_taken_between_two_readings(jaw_recording, live):
    state, truth = _blocks(jaw_recording, 0, 12)
    between = TruthBlock(truth.t + 0.005, truth.name, np.array([[1.0], [2.0]]))
    row = live.row([state], [between])
    assert row.t[0] == pytest.approx(0.10)
    assert row.truth[0, 0] == pytest.approx(1.95)


def test_a_picture_waits_for_the_next_reading(jaw_recording, live):
    state, truth = _blocks(jaw_recording, 0, 8)
    assert live.row([state], [truth]).t[0] == 0.0
    later, _ = _blocks(jaw_recording, 8, 12)
    assert live.row([later], []) is None
    later, truth = _blocks(jaw_recording, 12, 16)
    assert live.row([later], [truth]).t[0] == pytest.approx(0.12)


def test_what_is_not_vouched_for_is_not_shown(jaw_recording, jaw_model, live):
    live.set_homing(True, "another")
    state, truth = _blocks(jaw_recording, 0, 40)
    row = live.row([state], [truth])
    assert np.isnan(row.corrected).all()
    assert np.isnan(row.half_width).all()
    assert row.status[0] == Status.HOMED_AGAIN
    assert np.isfinite(row.reported).all()


def test_a_braked_arm_that_stands_keeps_its_correction(jaw_recording, live):
    state, _ = _blocks(jaw_recording, 0, 100)
    assert live.row([state], []).status[0] == Status.OK
    still = state.rows(np.full(400, 99))
    still = replace(still, t=state.t[-1] + np.arange(1, 401) / 100)
    rows = [
        live.row([still.rows(slice(i, i + 4))], [], is_braked=is_braked)
        for i, is_braked in zip(range(0, 400, 4), [True] * 50 + [False] * 50, strict=True)
    ]
    braked, moving = rows[49], rows[-1]
    assert moving.status[0] == Status.FROZEN  # of an arm that should move it is a fault
    assert np.isnan(moving.corrected).all()
    assert braked.status[0] == Status.OK
    assert braked.corrected - braked.reported == pytest.approx(rows[0].corrected - rows[0].reported)
    assert np.isfinite(braked.half_width).all()


def test_an_arm_faster_than_real_time_is_shown_where_it_is_now(jaw_recording):
    live = LiveSamples(get_robot("davinci_grasper"))
    n = MOST_ROWS + 100
    zero = np.zeros((n, 1))
    state = StateBlock(np.arange(n) / 1e3, ("jaw",), *[zero] * 6)
    row = live.row([state], [TruthBlock(state.t[:5], ("jaw",), zero[:5])])
    assert row.t[0] == state.t[-1]
    assert np.isnan(row.truth).all()  # what was read five seconds before is no truth of now


def test_a_model_that_counts_samples_gets_them_at_its_rate(jaw_recording):
    model = calibrate(
        [jaw_motion(0, homing_id="h")], "linear", features=["measured/jaw", "lag(measured/jaw, 1)"]
    )
    live = LiveSamples(get_robot("davinci_grasper"), model)
    live.set_homing(True, "h")
    state, _ = _blocks(jaw_recording, 0, 40)
    fine = np.arange(390) / 1e3
    at_1_khz = replace(
        state, t=fine,
        **{
            n: np.interp(fine, state.t, getattr(state, n)[:, 0])[:, None]
            for n in ("measured", "velocity", "effort", "setpoint", "motor", "motor_velocity")
        },
    )  # fmt: skip
    rows = [live.row([at_1_khz.rows(slice(i, i + 6))], []) for i in range(0, 390, 6)]
    shown = [row for row in rows if row is not None]
    assert len(shown) == pytest.approx(39, abs=1)  # every 10 ms
    assert all(row.status[0] == Status.OK for row in shown[2:])


def test_a_model_of_another_arm_is_refused(jaw_model, jaw_recording):
    with pytest.raises(CalibrationError, match="davinci_grasper is not for raven2"):
        LiveSamples(get_robot("raven2"), jaw_model)
    other = Recording.from_columns({"t": [0, 1], "measured/jaw": [0, 1]}, "forceps")
    with pytest.raises(CalibrationError, match="is of forceps"):
        Samples.of_recording(other, jaw_model)


def test_an_arm_that_does_not_report_what_the_model_needs_is_refused(jaw_model):
    live = LiveSamples(get_robot("davinci_grasper"), jaw_model)
    zero, none = np.zeros((3, 1)), np.zeros((3, 0))
    state = StateBlock(np.arange(3.0), ("jaw",), zero, zero, none, zero, zero, zero)
    with pytest.raises(CalibrationError, match="does not report effort/jaw, which the model"):
        live.row([state], [])


def test_a_recording_without_measured_positions_is_refused():
    columns = {"t": [0.0, 1.0], "effort/jaw": [0.0, 1.0]}
    recording = Recording.from_columns(columns, Provenance("davinci_grasper", source="a.csv"))
    with pytest.raises(RecordingError, match=r"a.csv has no measured position .* nothing to show"):
        Samples.of_recording(recording)
