import math

import numpy as np
import pytest

from truejoint.errors import CommandRefused, TruejointError
from truejoint.simulation.forceps.load import LoadTest
from truejoint.simulation.forceps.specimens import specimen
from truejoint.simulation.forceps.twin import ForcepsTwin, ZeroShift, simulate_forceps

NOMINAL = specimen()
T = np.arange(4001) / 1000
MOTION = np.radians(20.0) * np.sin(2.0 * T) * np.minimum(T, 1.0)


def columns(output):
    flat = {**vars(output), **output.extra, "truth": output.truth.position}
    return {name: values for name, values in flat.items() if isinstance(values, np.ndarray)}


def test_a_run_is_a_table_at_the_log_rate_that_starts_at_zero():
    run, shifted = (
        simulate_forceps(NOMINAL, MOTION, zero_shift=ZeroShift(reset=shift)) for shift in (0, 50e-6)
    )
    assert {len(a) for a in columns(run).values()} == {801}
    np.testing.assert_allclose(run.t, np.arange(801) / 200, atol=1e-12)
    assert run.joint[0] == run.motor[0] == 0.0
    np.testing.assert_allclose(run.setpoint[:, 0], MOTION[::5], atol=1e-12)
    tensions = [run.extra[f"truth_tension/{cable}"][0] for cable in ("drive", "reset")]
    np.testing.assert_allclose(tensions, 8.0, rtol=0.01)
    # The jaw lags the motor by stretch and friction only, and knows of no shifted zero.
    assert 0.2 < math.degrees(np.abs(run.measured - run.joint).max()) < 4.0
    drive = run.motor[:, 0] * NOMINAL.mechanism.wheel_radius / NOMINAL.mechanism.gear_ratio
    assert np.abs(drive - run.extra["cable/drive"]).max() < 31e-6  # gear torsion, run-out, counts
    np.testing.assert_array_equal(shifted.joint, run.joint)
    seen = shifted.extra["cable/reset"] - run.extra["cable/reset"]
    assert seen.mean() == pytest.approx(50e-6, abs=0.1e-6)


@pytest.mark.parametrize("rate", [50.0, 1000.0])
def test_the_log_rate_changes_which_rows_are_kept_and_nothing_else(rate):
    run, base = simulate_forceps(NOMINAL, MOTION, log_rate=rate), simulate_forceps(NOMINAL, MOTION)
    slow, fast = (run, base) if rate < 200 else (base, run)
    every = round(slow.t[1] / fast.t[1])
    np.testing.assert_array_equal(slow.joint, fast.joint[::every])
    np.testing.assert_allclose(slow.t, fast.t[::every], atol=1e-12)


def test_a_setpoint_that_starts_elsewhere_is_approached_from_rest():
    run = simulate_forceps(NOMINAL, np.full(3001, 0.3))
    assert run.motor[0] == 0.0
    assert np.abs(np.diff(run.motor[:, 0])).max() * 200 <= 400.0
    assert run.joint[-1, 0] == pytest.approx(0.3, abs=math.radians(2.5))


def test_a_load_test_carries_its_torque():
    test = LoadTest(0.1, "opposing", start=0.2, speed=math.radians(30), loaded_from=2.0,
                    loaded_to=2.5, end=4.5)  # fmt: skip
    run = simulate_forceps(NOMINAL, test, seed=4)
    torque = run.extra["truth_load/jaw"]
    late = run.t >= test.phases["IV"][0]
    wanted = -0.1 * 9.81 * NOMINAL.jaw.load_arm * np.cos(run.joint[:, 0] - test.angle)
    # The plant's angle counts from where the pulley's run-out lets it rest, 0.02 deg off.
    np.testing.assert_allclose(torque[late], wanted[late], rtol=1e-3)
    assert not torque[run.t <= 2.0].any()
    other = simulate_forceps(NOMINAL, test, seed=5)
    assert not np.array_equal(torque, other.extra["truth_load/jaw"])


@pytest.mark.parametrize(
    ("setpoint", "rate", "says"),
    [
        (np.zeros(1), 200.0, "setpoint"),
        (np.zeros((10, 2)), 200.0, "setpoint"),
        (np.r_[0.0, math.nan, 0.0], 200.0, "setpoint refused: jaw is nan at sample 1 of 3"),
        (np.full(10, 2.0), 200.0, "114.6 deg"),
        *((np.zeros(10), rate, "log rate") for rate in (300.0, 0.0, -200.0, math.nan, 20_000.0)),
    ],
)
def test_bad_input_is_refused_in_one_line(setpoint, rate, says):
    with pytest.raises(TruejointError, match=says) as caught:
        simulate_forceps(NOMINAL, setpoint, log_rate=rate)
    assert "\n" not in str(caught.value)


def test_the_twin_and_a_run_are_the_same_forceps():
    run = simulate_forceps(NOMINAL, MOTION, seed=3, log_rate=1000.0)
    twin = ForcepsTwin(NOMINAL)
    output = twin.run(MOTION[1:, None])
    np.testing.assert_array_equal(output.joint, run.joint[1:])
    np.testing.assert_array_equal(output.motor, run.motor[1:])
    np.testing.assert_allclose(output.t, run.t[1:], atol=1e-12)
    assert twin.time == pytest.approx(4.0)
    np.testing.assert_array_equal(output.setpoint[:, 0], MOTION[1:])
    assert output.effort.shape == (4000, 0)


def test_homing_zeroes_the_cables_where_the_jaw_stands_and_errs():
    parameters = NOMINAL.with_values({"homing.registration_sd": 20e-6})
    zeros = []
    for seed in (1, 1, 2):
        twin = ForcepsTwin(parameters, seed=seed)
        twin.run(MOTION[:, None])
        homed = twin.home()
        assert twin.homing_count == 1
        zeros.append(homed.extra["cable/reset"][-100:].mean())
        assert homed.measured[-1, 0] == pytest.approx(0.0, abs=1e-3)
        # The truth stays on the jaw: friction left it off its first zero.
        assert 1e-6 < abs(homed.joint[-1, 0]) < math.radians(1.0)
    assert zeros[0] == zeros[1] != zeros[2]
    assert all(1e-7 < abs(zero) < 80e-6 for zero in zeros)


def test_a_weight_shuts_the_jaw_and_stretches_the_drive_cable():
    twin = ForcepsTwin(NOMINAL, load=0.1)
    out = twin.run(np.zeros((2000, 1)))
    torque = -0.1 * 9.81 * NOMINAL.jaw.load_arm
    assert out.extra["truth_load/jaw"][-1] == pytest.approx(torque, rel=3e-3)
    assert math.degrees(out.joint[-1, 0]) < -0.5
    twin.load = 0.0
    assert twin.run(np.zeros((2000, 1))).joint[-1, 0] > out.joint[-1, 0]


def test_a_load_test_is_the_same_behind_the_twin():
    test = LoadTest(0.1, start=0.1, speed=math.radians(60), loaded_from=1.0, loaded_to=1.2, end=2.0)
    run = simulate_forceps(NOMINAL, test, seed=4, log_rate=1000.0)
    twin = ForcepsTwin(NOMINAL, seed=4)
    twin.tip_force, twin.line_angle = lambda t: test.force(t, 4), test.angle
    out = twin.run(test.angles(run.t)[1:, None])
    np.testing.assert_allclose(out.joint, run.joint[1:], atol=1e-9)
    torque = run.extra["truth_load/jaw"][1:]
    np.testing.assert_allclose(out.extra["truth_load/jaw"], torque, atol=1e-9)
    with pytest.raises(CommandRefused, match=r"jaw at 80\.21 deg .*\[-75, 75\] deg"):
        twin.run(np.full((3, 1), 1.4))
    twin.tip_force = lambda t: np.zeros(3)
    with pytest.raises(TruejointError, match=r"tip_force gave shape \(3,\); want \(6,\)"):
        twin.run(np.zeros((5, 1)))
    for force in (1e300, math.nan):
        twin.tip_force = lambda t, force=force: np.full(t.shape, force)
        with pytest.raises(TruejointError, match=r"diverged at \d\.\d{3} s"):
            twin.run(np.zeros((100, 1)))
