"""The virtual wrist as an arm takes it."""

import numpy as np
import pytest
from tests.robots.test_cable_mechanism import TOOL

from truejoint.errors import CommandRefused, RobotError, TruejointError
from truejoint.simulation.wrist.specimens import FAMILIES, family_of, population
from truejoint.simulation.wrist.twin import WristTwin


def path(rows=300):
    return WristTwin().robot.home + np.linspace(0.0, 0.2, rows)[:, None] * np.array([1, -0.5, 0.5])


def homed(**how):
    twin = WristTwin(seed=3, **how)
    twin.home()
    return twin


def test_measured_is_what_rigid_cables_would_give_and_the_joints_lag():
    twin = homed()
    out = twin.run(path())
    rigid = twin.robot.transmission.joint_from_motor(out.motor)
    np.testing.assert_allclose(out.measured, rigid)
    assert np.degrees(np.abs(out.joint - out.measured)).max() > 0.3


def test_pitch_drags_the_jaws_by_their_coupling():
    twin = homed()
    motor = twin.run(twin.robot.home + np.linspace(0.0, 0.3, 400)[:, None] * [1.0, 0, 0]).motor
    turned = motor[-1] - motor[0]
    np.testing.assert_allclose(turned[1:] / turned[0], 0.688098, atol=0.02)


def test_homing_draws_new_zeros_and_the_seed_repeats_them():
    twin = homed()
    first = twin._zero
    again = twin.home()
    assert np.abs(twin._zero - first).max() > 1e-4
    assert np.abs(again.velocity).max() < 3.0  # a new zero is no motion
    np.testing.assert_array_equal(homed()._zero, first)


def test_a_load_pulls_the_pitch_down_and_a_force_is_reported():
    free, loaded = homed(), homed(load=0.2)
    still = np.tile(free.robot.home, (400, 1))
    assert loaded.run(still).joint[-1, 0] < free.run(still).joint[-1, 0] - 0.005
    free.tip_force = lambda t: np.tile([1.0, 0.5], (len(t), 1))
    extra = free.run(still).extra
    assert extra["truth_load/pitch"][-1] == pytest.approx(19e-3)
    assert extra["truth_load/yaw"][-1] == pytest.approx(5e-3)


def test_jaws_close_on_what_is_held():
    twin = homed()
    twin.held = lambda t: np.full(len(t), 0.5)
    assert twin.run(np.tile(twin.robot.home, (500, 1))).extra["truth_load/grip"][-1] > 0.05


def test_what_a_mechanism_lacks_is_not_ignored(tmp_path):
    path = tmp_path / "finger.toml"
    path.write_text(TOOL)
    twin = WristTwin(robot=str(path))
    with pytest.raises(RobotError, match="finger states no arm that a load pulls at"):
        twin.load = 0.1
    twin.held = lambda t: np.zeros(len(t))
    with pytest.raises(RobotError, match="finger states no jaws that hold"):
        twin.run(np.zeros((2, 1)))


def test_what_cannot_be_is_refused():
    twin = WristTwin()
    with pytest.raises(CommandRefused, match=r"pitch at 114\.6 deg is outside its range \[-81"):
        twin.run(np.array([[2.0, 0.0, 0.0]]))
    twin.held = lambda t: np.zeros(3)
    with pytest.raises(TruejointError, match=r"held gave shape \(3,\); want \(11,\)"):
        twin.run(np.zeros((10, 3)))
    with pytest.raises(RobotError, match="bros states no cables"):
        WristTwin(robot="bros")


def test_a_larger_population_begins_with_the_smaller_one():
    few, many = population(2, seed=4), population(5, seed=4)
    assert few == many[:2]
    assert [family_of(n) for n in range(4)] == [*FAMILIES, FAMILIES[0]]
    for n, specimen in enumerate(many):
        low, high = {"cable_only": (25e3, 45e3), "endowrist": (70e3, 150e3)}.get(
            family_of(n), (135e3, 180e3)
        )
        assert low <= specimen.cables.stiffness <= high
    with pytest.raises(TruejointError, match="no family called 'rods'"):
        population(1, family="rods")
    with pytest.raises(TruejointError, match="a population of 0"):
        population(0)
