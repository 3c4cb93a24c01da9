"""Measured positions against what is redundant to them: seen, kept in mind, and taken back."""

import copy
import pickle
from dataclasses import replace

import numpy as np
import pytest

from truejoint.calibration import calibrate
from truejoint.calibration.redundancy import fit_parity_equations
from truejoint.errors import CalibrationError
from truejoint.recordings import Recording
from truejoint.runtime import Corrector, Monitor, Status

from .streams import EFFORTS, JOINTS, SIGNALS, recording, stream

SLOW = ("setpoint/elbow",)  # that follows from afar
MOTORS = ("motor/shoulder", "motor/elbow")
T = np.arange(0.0, 5.0, 1e-3)
FAULT = 2000
OK, SUSPECT = Status.OK, Status.ZERO_SUSPECT


def redundant(t, samples) -> np.ndarray:
    """Set point of the elbow, 5 mrad off as the joint moves; two motors, the second coupled."""
    shoulder, elbow = samples[:, 0], samples[:, 2]
    motors = np.column_stack([8.0 * shoulder, 5.0 * elbow - 3.0 * shoulder + 1.0])
    return np.column_stack([elbow + 0.005 * np.cos(1.3 * t), motors])


def with_redundant(made: Recording) -> Recording:
    """The recording with the set point and the motors."""
    columns = {name: made.column(name) for name in made.table.columns}
    more = redundant(made.t, made.table[list(SIGNALS)].to_numpy())
    columns |= dict(zip((*SLOW, *MOTORS), more.T, strict=True))
    units = dict.fromkeys(EFFORTS, "Nm") | dict.fromkeys(MOTORS, "rad")
    return Recording.from_columns(columns, made.provenance, units)


TRAINING = with_redundant(recording(np.arange(0.0, 60.0, 1 / 30)))


@pytest.fixture(scope="module")
def calibration():
    return calibrate(TRAINING, "linear", features=SIGNALS, joints=JOINTS)


def statuses(calibration, *, change, redundant_to_true=True):
    """Corrector, and the bits of a stream whose measured positions a fault has changed."""
    corrector = Corrector(calibration)
    corrector.set_homing(True, "h1")
    true = stream(T)
    read = true.copy()
    change(read)
    rows = np.column_stack([read, redundant(T, true if redundant_to_true else read)])
    order = (*SIGNALS, *SLOW, *MOTORS)
    rows = rows[:, [order.index(name) for name in corrector.signals]]
    return (
        corrector,
        rows,
        np.array([corrector.step(t, row) for t, row in zip(T, rows, strict=True)]),
    )


def test_equations_take_the_columns_that_they_need(calibration):
    assert set(calibration.redundant) == {*SLOW, *MOTORS}
    assert calibration.loop_signals[: len(SIGNALS)] == SIGNALS
    rows = TRAINING.table[list(calibration.loop_signals)].to_numpy()
    rest = rows @ calibration.parity.matrix.T + calibration.parity.intercept
    np.testing.assert_allclose(rest.min(axis=0), calibration.parity.lower, atol=1e-12)
    np.testing.assert_allclose(rest.max(axis=0), calibration.parity.upper, atol=1e-12)
    exact = np.abs(rest).max(axis=0) < 1e-9
    assert calibration.parity.joint[exact].tolist() == [0.0, 1.0]
    used = calibration.parity.matrix[exact] != 0.0
    assert [
        [name for name, on in zip(calibration.loop_signals, row, strict=True) if on] for row in used
    ] == [["measured/shoulder", "motor/shoulder"], ["measured/elbow", *sorted(MOTORS)]]


def test_columns_that_say_nothing_of_a_joint_are_left_out():
    columns = {name: np.array(TRAINING.column(name)) for name in TRAINING.table.columns}
    columns["setpoint/elbow"] = np.random.default_rng(0).normal(size=len(TRAINING.t))
    columns["motor/shoulder"] = np.zeros(len(TRAINING.t))
    units = dict.fromkeys(EFFORTS, "Nm") | dict.fromkeys(MOTORS, "rad")
    odd = Recording.from_columns(columns, TRAINING.provenance, units)
    equations, used = fit_parity_equations([odd], JOINTS, SIGNALS)
    assert equations is None
    assert used == {}


def test_columns_asked_for(calibration):
    made = calibrate(TRAINING, "linear", features=SIGNALS, joints=JOINTS, redundant=MOTORS)
    assert tuple(made.redundant) == tuple(sorted(MOTORS))
    none = calibrate(TRAINING, "linear", features=SIGNALS, joints=JOINTS, redundant=())
    assert none.parity is None
    assert Corrector(none).signals == SIGNALS
    with pytest.raises(CalibrationError, match="'effort/elbow' cannot check"):
        calibrate(TRAINING, "linear", features=SIGNALS, redundant=["effort/elbow"])


def test_correcting_a_recording_needs_none_of_them(calibration):
    plain = recording(np.arange(0.0, 5.0, 1 / 30))
    assert calibration.correct(plain).shape == (150, 2)


def test_a_healthy_stream_is_ok(calibration):
    assert not statuses(calibration, change=lambda _: None)[2].any()


def drift(read):
    read[FAULT:, 0] += 0.002 * (T[FAULT:] - T[FAULT])


def stuck(read):
    noise = 1e-9 * np.random.default_rng(1).normal(size=len(T) - FAULT)
    read[FAULT:, 2] = read[FAULT, 2] + noise


def scale(read):
    read[FAULT:, 0] = read[FAULT, 0] + 1.02 * (read[FAULT:, 0] - read[FAULT, 0])


@pytest.mark.parametrize("change", [drift, stuck, scale])
def test_what_the_motors_contradict_is_seen_and_kept_in_mind(calibration, change):
    def then_right(read):
        right = read.copy()
        change(read)
        read[-500:] = right[-500:]

    corrector, rows, bits = statuses(calibration, change=then_right)
    assert not bits[:FAULT].any()
    first = int(np.argmax(bits & SUSPECT))
    true = stream(T)[first, [0, 2]]
    assert 0 < np.abs(rows[first, [0, 2]] - true).max() < 2e-3
    assert (bits[first + 200 :] & SUSPECT).all()  # after the readings are right again, too
    corrector.set_homing(False)
    corrector.set_homing(True, "h1")
    assert corrector.step(T[-1] + 1e-3, rows[-1]) == OK


def test_a_set_point_shows_what_is_larger_than_it_ever_was_off(calibration):
    made = calibrate(TRAINING, "linear", features=SIGNALS, joints=JOINTS, redundant=SLOW)
    slope = 0.02 * np.maximum(T - T[FAULT], 0.0)

    def change(read):
        read[:, 2] += slope

    bits = statuses(made, change=change)[2]
    assert not bits[slope < 0.002].any()
    assert (bits[slope > 0.03] & SUSPECT).all()


def test_what_is_acknowledged_counts_as_right_from_then_on(calibration):
    def slip(read):
        read[FAULT:, 0] += 0.01

    corrector, rows, bits = statuses(calibration, change=slip)
    assert bits[-1] == SUSPECT
    corrector.acknowledge()
    assert [corrector.step(T[-1] + k * 1e-3, rows[-1]) for k in (1, 2)] == [OK, OK]
    assert corrector.step(T[-1] + 3e-3, rows[-1] - [0.0005, *[0] * 6]) == SUSPECT
    corrector.rezero([0.0, 0.0])
    assert corrector.step(T[-1] + 4e-3, rows[-1] - [0.0005, *[0] * 6]) == OK


def test_zeros_that_differ_from_those_of_training_are_suspect_at_once(calibration):
    def shift(read):
        read[:, 0] += 0.01

    bits = statuses(calibration, change=shift)[2]
    assert (bits & SUSPECT).all()


def test_a_signal_that_checks_is_needed_as_any_other(calibration):
    corrector = Corrector(calibration)
    corrector.set_homing(True, "h1")
    assert corrector.step(0.0, stream(T[:1])[0]) == Status.WRONG_SIZE
    assert corrector.step(0.0, [*stream(T[:1])[0], np.nan, 4.0, 2.0]) == Status.NOT_FINITE


def test_monitors_take_the_samples_of_a_corrector(calibration):
    steady = replace(
        calibration.effort_baseline, monitored=np.zeros(2)
    )  # what it says is not the matter here
    monitor = Monitor(replace(calibration, effort_baseline=steady))
    row = np.concatenate([stream(T[:1])[0], [0.5, 4.0, 2.0]])
    assert monitor.step(0.0, row) == monitor.step(0.1, row[:4]) == 0


@pytest.mark.parametrize("duplicate", [copy.copy, copy.deepcopy, pickle.dumps])
def test_what_holds_addresses_is_not_copied(calibration, duplicate):
    for one in (Corrector(calibration), Monitor(calibration)):
        with pytest.raises(TypeError, match="make another from the same model"):
            duplicate(one)
