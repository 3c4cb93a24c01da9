"""What is put out in doubt: the correction believed last, and no leap on the way in or out."""

from dataclasses import replace

import numpy as np
import pytest

from truejoint.calibration import calibrate
from truejoint.calibration.interval import Interval
from truejoint.errors import CalibrationError
from truejoint.runtime import Corrector, OnFault, Status

from .streams import (
    FAULT,
    JOINTS,
    MEASURED,
    RATE,
    SIGNALS,
    T,
    changed,
    ready,
    recording,
    remembering,
    run,
    stream,
    trained,
)

SPEED = np.radians([2.0, 2.0])


@pytest.fixture(scope="module")
def calibration():
    return remembering()


nan = changed(1, lambda _: np.nan, 400)
far_out = changed(3, lambda part: part + 5.0, 2500)
freeze = changed((0, 1, 2, 3), lambda part: part[0], 3000)
spike = changed(0, lambda part: part + 0.2, 3)


def gap(t, samples):
    t[FAULT:] += 2.0
    samples[:] = stream(t)


def test_nothing_is_held_of_a_healthy_stream(calibration):
    bits, positions, *_ = run(ready(calibration), T, stream(T))
    assert not bits.any()
    raw = run(ready(calibration, on_fault="raw"), T, stream(T))
    np.testing.assert_array_equal(positions, raw[1])


@pytest.mark.parametrize("put", [nan, freeze, spike, far_out, gap], ids="nfsog")
def test_a_correction_never_leaps(calibration, put):
    t, samples = T.copy(), stream(T)
    put(t, samples)
    bits, positions, widths, _ = run(ready(calibration), t, samples)
    assert bits.any()
    assert not bits[-1]
    applied = positions - samples[:, MEASURED]
    bound = np.minimum(np.diff(t), 0.1)[:, None] * SPEED + 1e-12
    doubted = bits != 0
    assert (np.abs(np.diff(applied, axis=0))[doubted[1:]] <= bound[doubted[1:]]).all()
    assert np.isinf(widths[doubted]).all()
    # Beside what the model itself says anew, it goes back to it at that speed.
    believed = run(ready(calibration, on_fault="raw"), t, samples)
    rest = np.where(doubted[:, None], np.nan, positions - believed[1])
    steps = np.nan_to_num(np.abs(np.diff(rest, axis=0)))
    assert (steps <= bound).all()
    np.testing.assert_array_equal(positions[-1], believed[1][-1])


@pytest.mark.parametrize("action", ["other homing", "not homed"])
def test_a_homing_that_does_not_fit_is_no_leap(calibration, action):
    corrector = ready(calibration)

    def before(row):
        if row == FAULT:
            corrector.set_homing(action == "other homing", "another")
        elif row == FAULT + 3000:
            corrector.set_homing(True, "h1")

    bits, positions, *_ = run(corrector, T, stream(T), before)
    applied = positions - stream(T)[:, MEASURED]
    steps = np.abs(np.diff(applied, axis=0))
    doubted = bits != 0
    assert (steps[doubted[1:]] <= SPEED / RATE + 1e-12).all()
    held = np.flatnonzero(doubted)[:RATE]
    np.testing.assert_allclose(
        applied[held], np.tile(applied[FAULT - 1], (len(held), 1)), rtol=0, atol=1e-12
    )
    assert doubted[FAULT]
    assert not bits[-1]


def test_while_it_returns_the_half_width_holds_what_is_missing():
    recordings = [recording(np.arange(0.0, 20.0, 1 / 30) + 20.0 * k, seed=k) for k in range(10)]
    model = calibrate(recordings, "linear", features=SIGNALS, joints=JOINTS)
    widths = np.full((1, 2), 0.003)
    model = replace(model, interval=Interval(np.array([0.9]), widths, 2.0, 0.0, 12, 12))
    t, samples = T.copy(), stream(T)
    far_out(t, samples)
    bits, positions, widths, _ = run(ready(model), t, samples)
    _, believed, stated, _ = run(ready(model, on_fault="raw"), t, samples)
    good = bits == 0
    rest = np.abs(positions[good] - believed[good])
    assert rest.max() > 1e-3
    np.testing.assert_allclose(widths[good], stated[good] + rest, rtol=0, atol=1e-12)


def test_a_correction_that_is_believed_again_soon_moves_on_at_the_stated_speed(calibration):
    t, samples = T.copy(), stream(T)
    nan(t, samples)
    fast = OnFault(speed_rad_s=1e3)
    _, positions, *_ = run(ready(calibration, on_fault=fast), t, samples)
    _, believed, *_ = run(ready(calibration, on_fault="raw"), t, samples)
    np.testing.assert_array_equal(positions[FAULT + 400 :], believed[FAULT + 400 :])


def test_it_may_be_silent_or_give_what_is_measured(calibration):
    t, samples = T.copy(), stream(T)
    nan(t, samples)
    bits, silent, *_ = run(ready(calibration, on_fault="silent"), t, samples)
    assert np.isnan(silent[bits != 0]).all()
    _, raw, widths, _ = run(ready(calibration, on_fault="raw"), t, samples)
    np.testing.assert_array_equal(raw[bits != 0], samples[bits != 0][:, MEASURED])
    np.testing.assert_array_equal(silent[bits == 0], raw[bits == 0])
    assert np.isinf(widths[bits != 0]).all()


def test_messages_that_come_again_or_late_are_no_event(calibration):
    rng = np.random.default_rng(3)
    samples = stream(T)
    order = np.argsort(
        np.arange(len(T)) + np.where(rng.random(len(T)) < 0.2, rng.uniform(0, 5, len(T)), 0)
    )
    order = np.repeat(order, 1 + (rng.random(len(T)) < 0.01))
    bits, positions, *_ = run(ready(calibration), T[order], samples[order])
    assert not bits.any()
    applied = positions - samples[order][:, MEASURED]
    clean = run(ready(calibration), T, samples)[1] - samples[:, MEASURED]
    assert np.abs(np.diff(applied, axis=0)).max() < 7 * np.abs(np.diff(clean, axis=0)).max()


def test_a_late_message_of_a_slow_loop_is_no_clock_that_was_set_back():
    fast = np.arange(0.0, 6.0, 1e-3)
    model = trained(recordings=recording(fast))
    t = np.arange(0.0, 6.0, 5e-3)
    order = np.arange(len(t))
    order[100:900:40], order[101:901:40] = order[101:901:40].copy(), order[100:900:40].copy()
    bits = run(ready(model), t[order], stream(t)[order])[0]
    assert not (bits & Status.TIME_JUMP).any()


def test_a_gap_is_a_fault_for_a_model_that_remembers_alone(calibration):
    t = np.concatenate([T[:FAULT], T[FAULT:] + 2.0])
    forgetful = run(ready(trained()), t, stream(t))[0]
    remembering = run(ready(calibration), t, stream(t))[0]
    assert not forgetful.any()
    np.testing.assert_array_equal(np.flatnonzero(remembering), [FAULT])
    assert remembering[FAULT] == Status.TIME_JUMP


@pytest.mark.parametrize(
    ("wrong", "told"),
    [({"on_fault": "keep"}, "hold, raw, silent"), ({"hold_s": -1.0}, "hold_s is -1.0"),
     ({"speed_m_s": np.nan}, "speed_m_s is nan")],
)  # fmt: skip
def test_what_makes_no_sense_is_refused(calibration, wrong, told):
    with pytest.raises(CalibrationError, match=told):
        Corrector(calibration, **wrong) if "on_fault" in wrong else OnFault(**wrong)
