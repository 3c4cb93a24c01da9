import numpy as np
import pytest
from tests.estimators.conftest import SETTLED, steps, target
from tests.refusals import refused
from tests.runtime.streams import stepped

from truejoint.calibration import EncoderZero, find_encoder_zero, identify_stiffness
from truejoint.estimators.jaw_load.learn import FrictionFilter
from truejoint.estimators.jaw_load.run import SHOWN, UNSHOWN
from truejoint.motion.forceps_trajectories import calibration_trajectory, sine_trajectory
from truejoint.simulation.forceps.load import LoadTest
from truejoint.simulation.forceps.parameters import friction_at_pretension
from truejoint.simulation.forceps.specimens import specimen
from truejoint.simulation.forceps.twin import ZeroShift
from truejoint.studies.forceps.load import effective_stiffness, rocking_test
from truejoint.studies.forceps.methods import record_forceps

# Off Table 1: a thicker jaw pulley, a smaller wheel, another gear.
OFF = {"mechanism.jaw_radius": 4.6e-3, "mechanism.wheel_radius": 9e-3, "mechanism.gear_ratio": 40.0}
PLANT = specimen("nominal").with_values(OFF)


def rows(run) -> np.ndarray:
    return np.column_stack([run.column("motor/jaw"), run.column("cable/reset")])


@pytest.fixture(scope="module")
def model():
    run = record_forceps(PLANT, calibration_trajectory().positions[:, 0], seed=0)
    return FrictionFilter(**PLANT.mechanism._asdict()).fit(rows(run), target(run), dt=steps(run))


@pytest.fixture(scope="module")
def hung():
    """200 g each way: a record, and its torque where the weight hangs still."""
    found = {}
    for way in ("along", "opposing"):
        test = LoadTest(0.2, way)
        run = record_forceps(PLANT, test, seed=3)
        still = run.t >= test.phases["IV"][0]
        found[way] = run, still, np.where(still, run.column("truth_load/jaw"), np.nan)
    return found


@pytest.fixture(scope="module")
def found(model, hung):
    X = np.concatenate([rows(run) for run, _, _ in hung.values()])
    dt = np.concatenate([steps(run) for run, _, _ in hung.values()])
    return identify_stiffness(model, X, np.concatenate([t for _, _, t in hung.values()]), dt)


def test_known_weights_tell_the_stiffness_and_what_it_is_off_by(model, found):
    true = effective_stiffness(PLANT)
    assert found.drive_stiffness == pytest.approx(true, rel=0.05)
    assert abs(found.drive_stiffness - true) < 3.0 * found.deviation < 0.2 * true
    # With it, the unloaded motion tells the jaw's friction.
    identified = model.with_stiffness(found)
    assert identified.stiffness_error >= 0.05
    assert identified.jaw_friction == pytest.approx(friction_at_pretension(PLANT)[0], rel=0.15)
    assert model.jaw_friction == pytest.approx(
        identified.jaw_friction * model.drive_stiffness / found.drive_stiffness
    )


def test_weights_under_which_the_jaw_rocks_tell_it_better(model):
    """A hand that swings the weight leaves in the friction of a jaw at rest what it will."""
    X, torque = [], []
    for way in ("along", "opposing"):
        run = record_forceps(PLANT, rocking_test(0.2, way), seed=5)
        X.append(rows(run))
        torque.append(np.where(run.t >= 14.0, run.column("truth_load/jaw"), np.nan))
    dt = np.r_[0.0, np.full(len(X[0]) - 1, 5e-3)]
    rocked = identify_stiffness(model, np.concatenate(X), np.concatenate(torque), np.tile(dt, 2))
    true = effective_stiffness(PLANT)
    assert rocked.drive_stiffness == pytest.approx(true, rel=0.04)
    assert abs(rocked.drive_stiffness - true) < 3.0 * rocked.deviation < 0.15 * true


@pytest.mark.parametrize(("mass", "way"), [(0.1, "along"), (0.25, "opposing")])
def test_other_weights_are_then_within_what_is_stated(model, found, mass, way):
    identified, test = model.with_stiffness(found), LoadTest(mass, way)
    run = record_forceps(PLANT, test, seed=4)
    still = run.t >= test.phases["IV"][0]
    states = identified.states(rows(run), steps(run))
    error = (states.load - run.column("truth_load/jaw"))[still]
    hidden = 2.0 * identified.jaw_friction * (way == "opposing")
    assert np.abs(error).mean() < 0.1 * abs(run.column("truth_load/jaw")[still].mean()) + hidden
    stated = states.load_deviation[still]
    assert (np.abs(error) < 3.0 * stated).all()
    # It is no more than the stiffness, and the jaw's standing friction, leave open.
    law = identified.stiffness_error * states.load[still]
    shown, unshown = (np.hypot(size * identified.jaw_friction, law) for size in (SHOWN, UNSHOWN))
    assert (stated > shown).all()
    assert (stated < 1.1 * unshown).all()


def test_a_load_that_cannot_be_is_not_believed(model, hung):
    run, _, _ = hung["along"]
    X = np.vstack([rows(run)[:1], rows(run)[:400] + np.array([5.0, 0.0])])
    _, widths = stepped(model, X, np.where(np.arange(401) == 0, 0.0, 5e-3))
    assert np.isnan(widths[-1, 0])


def test_what_tells_no_stiffness_is_refused(model, hung):
    run, _, torque = hung["along"]
    X = rows(run)
    refused("no weight is stated", identify_stiffness, model, X, np.full(len(X), np.nan))
    refused(
        r"beyond the 50\.0 mNm .* hang a lighter one", identify_stiffness, model, X, 4.0 * torque
    )
    refused("no stiffness within 3 times", identify_stiffness, model, X, -torque)
    opposing, _, torque = hung["opposing"]
    before = (opposing.t > 19.0) & (opposing.t < 23.0)  # the jaw did not turn round
    light = np.where(before, -1e-3, np.nan)
    refused(
        "does not show above the jaw's friction", identify_stiffness, model, rows(opposing), light
    )


@pytest.mark.parametrize("shift", [0.0, 8e-6, -2e-5])
def test_zero_is_found_without_a_sensor_at_the_jaw(model, shift):
    motion = sine_trajectory(((-np.radians(25.0), 1.0),), 4.0 * np.pi)
    run = record_forceps(PLANT, motion.positions[:, 0], seed=5, zero_shift=ZeroShift(reset=shift))
    zero = find_encoder_zero(model, rows(run)[run.t > SETTLED])
    assert zero.shift == pytest.approx(shift, abs=1.5e-6)
    assert abs(zero.shift - shift) < 3.0 * zero.deviation < 6e-6
    assert zero.correction == (0.0 if shift == 0.0 else zero.shift)


def test_a_zero_may_be_off_by_half_of_what_friction_moves_either_way():
    phase = np.linspace(0.0, 12.0 * np.pi, 4000)
    X = np.column_stack([11.5 * np.sin(phase), 3e-3 * np.sin(phase)])
    model = FrictionFilter().fit(X, 0.8 * np.sin(phase))
    lost = np.column_stack([0.1 * np.sign(np.cos(phase)), np.zeros(len(X))])
    zero = find_encoder_zero(model, X + lost)
    assert zero.shift == pytest.approx(0.0, abs=5e-7)
    assert zero.deviation == pytest.approx(0.5 * 0.1 * 3e-3 / 11.5, rel=0.1)


def test_a_shift_within_what_it_may_be_off_by_is_left_alone():
    assert EncoderZero(-2.8e-6, 1.5e-6).correction == 0.0
    assert EncoderZero(-2.8e-6, 1.3e-6).correction == -2.8e-6


def test_what_tells_no_zero_is_refused(model, hung):
    run, still, _ = hung["along"]
    refused("of the calibration's range", find_encoder_zero, model, rows(run)[still])
    refused("turns round 0 times", find_encoder_zero, model, rows(run))
    phase = np.linspace(0.0, 12.0, 1000)
    far = np.column_stack([10.0 * np.sin(phase), 3e-3 * np.sin(phase) + 1e-2])
    refused(r"0\.3 mm", find_encoder_zero, model, far)
