from __future__ import annotations

import numpy as np
import pytest
from tests.estimators.conftest import SETTLED, steps, target

from truejoint.errors import CalibrationError
from truejoint.estimators.jaw_load import JawLoad, find_encoder_zero, identify_stiffness
from truejoint.motion.forceps_trajectories import calibration_trajectory, sine_trajectory
from truejoint.recordings.forceps import record_forceps
from truejoint.simulation.forceps.load import LoadTest
from truejoint.simulation.forceps.parameters import friction_at_pretension
from truejoint.simulation.forceps.sensors import ZeroShift
from truejoint.simulation.forceps.specimens import specimen

NOMINAL = specimen("nominal")


def rows(run) -> np.ndarray:
    return np.column_stack([run.column("motor/jaw"), run.column("cable/reset")])


@pytest.fixture(scope="module")
def load():
    run = record_forceps(NOMINAL, calibration_trajectory().positions[:, 0], seed=0)
    return JawLoad().fit(rows(run), target(run), steps(run))


def weighed(mass: float, direction: str = "along"):
    test = LoadTest(mass, direction)
    run, phases = record_forceps(NOMINAL, test, seed=3), test.phases
    before = (run.t >= phases["II"][0]) & (run.t < phases["II"][1])
    return run, before, run.t >= phases["IV"][0]


def test_friction_of_the_jaw_is_seen_unloaded(load):
    true = friction_at_pretension(NOMINAL)[0]
    assert load.jaw_friction == pytest.approx(true, rel=0.25)
    assert load.dead_band == 2.0 * load.jaw_friction


def test_one_known_weight_calibrates_the_others(load):
    run, before, after = weighed(0.2)
    torque = float(run.column("truth_load/jaw")[after].mean())
    X = rows(run)
    found = identify_stiffness(load, X, before, after, torque, steps(run))
    mended = load.with_stiffness(found.drive_stiffness)
    # A weight hung along the motion shows at once, against it up to the dead band is missing.
    for mass, direction, missing in (
        (0.1, "along", 0.0),
        (0.25, "along", 0.0),
        (0.25, "opposing", mended.dead_band),
    ):
        run, _before, after = weighed(mass, direction)
        estimate = mended.predict(rows(run), steps(run))[after].mean()
        true = run.column("truth_load/jaw")[after].mean()
        assert abs(estimate - true) < 0.15 * abs(true) + missing
    assert mended.grams(np.array([true]), NOMINAL.jaw.load_arm)[0] == pytest.approx(
        -250.0, rel=0.05
    )


def test_steps_give_the_bits_of_the_whole(load):
    run, _before, _after = weighed(0.1)
    X, dt = rows(run)[:300], steps(run)[:300]
    state = load.start()
    online = [load.step(state, each, row) for each, row in zip(dt, X, strict=True)]
    assert np.array_equal(online, load.predict(X, dt))


def test_a_constant_or_hidden_load_tells_no_stiffness(load):
    run, before, after = weighed(0.2)
    X, torque = rows(run), float(run.column("truth_load/jaw")[after].mean())
    with pytest.raises(CalibrationError, match="constant load"):
        identify_stiffness(load, X, np.zeros_like(after), after, torque)
    with pytest.raises(CalibrationError, match="constant load"):
        identify_stiffness(load, X, after, after, torque)
    with pytest.raises(CalibrationError, match="hang a heavier one"):
        identify_stiffness(load, X, before, after, 1e-4)
    with pytest.raises(CalibrationError, match="its sign"):
        identify_stiffness(load, X, before, after, -torque)


@pytest.mark.parametrize("shift", [0.0, 8e-6, -2e-5])
def test_zero_is_found_without_a_sensor_at_the_jaw(load, shift):
    motion = sine_trajectory(((-np.radians(25.0), 1.0),), 4.0 * np.pi)
    run = record_forceps(NOMINAL, motion.positions[:, 0], seed=5, zero_shift=ZeroShift(reset=shift))
    X = rows(run)[run.t > SETTLED]
    zero = find_encoder_zero(load, X)
    assert zero.shift == pytest.approx(shift, abs=1.5e-6)


def test_what_tells_no_zero_is_refused(load):
    run, before, _after = weighed(0.2)
    X = rows(run)
    with pytest.raises(CalibrationError, match="of the calibration's range"):
        find_encoder_zero(load, X[before])
    with pytest.raises(CalibrationError, match=r"0\.3 mm"):
        find_encoder_zero(load, X + np.array([0.0, 1e-2]))
