"""The physical filter of a wrist: what it finds, states and refuses."""

import numpy as np
import pytest
from tests.refusals import refused
from tests.runtime.registered import model, wrist

from truejoint.calibration import calibrate
from truejoint.estimators import CableFilter
from truejoint.estimators.cables import learn as own
from truejoint.estimators.cables import loops as r
from truejoint.robots import get_robot


def test_deviations_of_least_squares_hold_what_rows_have_in_common():
    rng = np.random.default_rng(3)
    blocks = np.repeat(np.arange(400), 10)
    common = rng.normal(size=400)[blocks]  # each draw counts ten times, and tells once
    jacobian, prior = np.ones((4000, 1)), np.zeros(1)
    found = own.jackknife_deviations(jacobian, common - common.mean(), [blocks], prior)
    assert found[0] == pytest.approx(0.05, rel=0.15)


def test_a_deviation_shows_that_signals_contradict_each_other():
    """Two signals that tell 1.0 and 1.2 by many rows each: neither spreads, both cannot be true."""
    signal = np.repeat([0, 1], 500)
    jacobian, left = np.ones((1000, 1)), np.where(signal == 0, 0.1, -0.1)
    alike, prior = np.zeros(1000, dtype=np.int64), np.zeros(1)
    found = own.jackknife_deviations(jacobian, left, [signal], prior)
    assert found[0] == pytest.approx(0.1)  # the deviation of the mean of two draws 0.2 apart
    np.testing.assert_array_equal(own.jackknife_deviations(jacobian, left, [alike], prior + 1), 0.0)


def test_what_nothing_tells_is_as_uncertain_as_before():
    jacobian, left, signal = np.eye(2)[[0, 1]], np.array([0.0, 3.0]), np.array([0, 1])
    found = own.jackknife_deviations(jacobian, left, [signal], np.array([1.0, 1.0 / 9.0]))
    assert 0.0 < found[1] <= 27.0
    assert np.isfinite(found).all()


def test_a_half_width_never_vanishes_though_loads_explain_all_errors():
    wave = np.sin(np.arange(1000.0))[:, None] * np.ones(3)
    truth, dt, states = np.zeros((1000, 3)), np.full(1000, 5e-3), np.zeros((1000, r.STATES))
    runs, found = [], []
    for n, size in enumerate((0.5, 2.0)):  # the filter's deviations say the opposite of errors
        load, deviation = 0.01 * size * wave, np.full((1000, 3), 1e-3 / size)
        rows = slice(1000 * n, 1000 * (n + 1))
        runs.append((rows, own.Run(np.zeros((1000, 6)), truth, load, dt)))
        found.append((1e-3 * size * wave, deviation, 1.01 * load, deviation, states))
    whole = own.Estimate(*(np.concatenate(parts) for parts in zip(*found, strict=True)))
    angle, by_load, of_load, load_by_load = structure = own.structure(runs, whole)
    assert (structure[::2] > 1e-6).all()  # of the filter's own deviations, without any load
    for rows, run in runs:
        loads = np.abs(whole.load[rows]).sum(axis=1, keepdims=True)
        stated = angle * whole.angle_deviation[rows] ** 2 + by_load * loads
        assert (stated.mean(axis=0) > 0.5 * np.mean(whole.angle[rows] ** 2, axis=0)).all()
        stated = of_load * whole.load_deviation[rows] ** 2 + load_by_load * loads
        off = whole.load[rows] - run.load
        assert (stated.mean(axis=0) > 0.5 * np.mean(off**2, axis=0)).all()


def test_errors_are_stated_as_large_as_they_are_and_twice_the_square_under_loads():
    truth, dt, states = np.zeros((1000, 3)), np.full(1000, 5e-3), np.zeros((1000, r.STATES))
    sign = np.where(np.arange(1000) % 2, 1.0, -1.0)[:, None] * np.ones(3)
    runs, found, wanted = [], [], []
    for n, (size, load) in enumerate(((1e-3, 0.0), (2e-3, 0.03))):
        runs.append(
            (slice(1000 * n, 1000 * n + 1000), own.Run(np.zeros((1000, 6)), truth, load * sign, dt))
        )
        deviation = np.full((1000, 3), 5e-4)
        found.append((size * sign, deviation, (load + size) * sign, deviation, states))
        wanted.append((2.0 if load else 1.0) * size**2)
    whole = own.Estimate(*(np.concatenate(parts) for parts in zip(*found, strict=True)))
    structure = own.structure(runs, whole)
    for (rows, _), square in zip(runs, wanted, strict=True):
        loads = np.abs(whole.load[rows]).sum(axis=1).mean()
        for factor, by_load in (structure[:2], structure[2:]):
            np.testing.assert_allclose(factor * 25e-8 + by_load * loads, square, rtol=1e-3)


def test_a_filter_as_good_as_its_reference_has_deviations_all_the_same():
    rng = np.random.default_rng(4)
    true, noise = np.zeros((1000, 3)), 1e-3 * rng.normal(size=(1000, 3))
    run = own.Run(np.zeros((1000, 6)), noise, true, np.full(1000, 5e-3))
    one, load = np.full((1000, 3), 1e-3), 0.01 * rng.normal(size=(1000, 3))
    found = own.Estimate(true, one, load, one, np.zeros((1000, r.STATES)))
    structure = own.structure([(slice(None), run)], found)
    assert structure.shape == (4, 3)
    assert (structure.reshape(2, 2, 3).sum(axis=1) > 0.0).all()


def test_a_dead_band_is_the_friction_of_the_pin_that_gives_way_first():
    found = model("ukf_cables").model.identified
    assert next(iter(found)) == "pitch_stiffness"
    assert all(value > 0.0 and deviation >= 0.0 for value, deviation, _unit in found.values())
    assert found["grip_dead_band"] == found["jaw_pin"]
    assert found["tip_first_dead_band"] == found["pitch_pin"]
    # A yaw torque turns both jaws by half.
    assert found["tip_second_dead_band"][0] == pytest.approx(2.0 * found["jaw_pin"][0])


def test_a_calibration_without_a_load_is_not_asked_for_loads():
    refused("add a minute under known loads", calibrate, wrist()[:1], "ukf_cables")


def test_a_weight_that_always_hangs_there_counts_by_its_size():
    """Its variance is nothing: by that the filter would never believe that any load has changed."""
    swinging = 0.01 * np.sin(np.arange(1000.0))
    free = np.zeros((1000, 3))
    load = np.column_stack([swinging, np.full(1000, -0.03), np.zeros(1000)])
    runs = [
        own.Run(np.zeros((1000, 6)), free, known, np.full(1000, 5e-3)) for known in (free, load)
    ]
    found = own.load_variances(runs)
    np.testing.assert_allclose(found, [swinging.var(), 9e-4, 9e-4])


HERE, NAN = np.arange(2000), np.nan


@pytest.mark.parametrize(
    ("truth", "loads", "said"),
    [
        (np.where(HERE < 1000, 0.0, NAN), np.where(HERE < 1000, 0.0, 0.02), "truth has a load"),
        (np.zeros(2000), np.where(HERE < 1900, 0.0, NAN), "100 rows whose load is not known"),
        (np.where(HERE < 410, 0.0, NAN), np.ones(2000), "more than 2 s of truth after its first"),
        (np.where(HERE < 390, 0.0, NAN), np.ones(2000), "390 rows with a known position"),
    ],
    ids=["loaded without truth", "unknown load", "truth at first alone", "little truth"],
)
def test_rows_that_do_not_tell_loads_are_refused(truth, loads, said):
    """Two histories of 5 s, in which truth and loads of all joints are alike."""
    joints, dt = np.ones((1, 3)), np.where(HERE % 1000, 5e-3, 0.0)
    fit = CableFilter(mechanism=get_robot("wrist").mechanism).fit
    X, truth, loads = np.zeros((2000, 6)), truth[:, None] * joints, loads[:, None] * joints
    refused(said, fit, X, truth, dt=dt, loads=loads)


def test_loads_of_another_shape_and_unknown_cables_are_refused():
    X, truth = np.zeros((500, 6)), np.zeros((500, 3))
    fit = CableFilter(mechanism=get_robot("wrist").mechanism).fit
    said = r"loads have shape \(500, 2\); give \(500, 3\)"
    refused(said, fit, X, truth, loads=truth[:, :2])
    refused("knows no cables", CableFilter().fit, X, truth)
