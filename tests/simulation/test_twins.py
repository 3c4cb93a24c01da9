"""What every digital twin does alike: shapes, seeds, pieces, time, going back, and refusals."""

import math
from copy import deepcopy
from itertools import pairwise

import numpy as np
import pytest

from truejoint.errors import CommandRefused, RobotError, TruejointError
from truejoint.simulation import TwinOutput, make_twin

SIZES = {"raven2": [0.05, 0.05, 5e-3, 0.05, 0.05, 0.05, 0.05], "forceps": [0.3], "wrist": 0.1}
SIZES["dvrk_psm"] = SIZES["raven2"]
CUTS = (0, 1, 1, 2, 777, 1400, 1401, 2000)


def moved(name, seed=3, cuts=(0, 2000)):
    """Homed twin, and what it reports of a motion in pieces, with something at the tip."""
    twin = make_twin(name, seed=seed)
    twin.home()
    if name == "forceps":
        twin.tip_force = np.sin
    t = np.arange(2000)[:, None] / 2000
    goal = twin.robot.home + np.sin(7.0 * t) * np.array(SIZES[name])
    return twin, TwinOutput.joined([twin.run(goal[a:b]) for a, b in pairwise(cuts)])


def arrays(output):
    flat = {**vars(output), **output.extra, "encoder_t": output.truth.t}
    flat["encoder"] = output.truth.position
    return {name: values for name, values in flat.items() if isinstance(values, np.ndarray)}


def assert_same(output, other):
    for name, values in arrays(output).items():
        # A matrix product of a single row rounds otherwise than one of many.
        tolerance = 1e-14 if name in ("measured", "velocity") else 0.0
        np.testing.assert_allclose(
            values, arrays(other)[name], rtol=tolerance, atol=tolerance, err_msg=name
        )


@pytest.fixture(params=["raven2", "dvrk_psm", "forceps", "wrist"], scope="module")
def name(request):
    return request.param


@pytest.fixture(scope="module")
def whole(name):
    """Twin that has moved, and what it reported; a test that goes on with it takes a copy."""
    return moved(name)


def test_every_twin_keeps_the_contract(name, tmp_path):
    twin = make_twin(name.upper(), seed=4)
    robot, names = twin.robot, len(twin.robot.channels)
    assert (robot.name, twin.seed, twin.time, twin.homing_count) == (name, 4, 0.0, 0)
    homed = twin.home()
    assert twin.homing_count == 1
    assert homed.joint[-1] == pytest.approx(robot.home[robot.index(robot.positioning)], abs=0.2)
    begin = twin.time
    out = twin.run(np.tile(robot.home, (200, 1)))
    assert twin.time == pytest.approx(begin + 0.2)
    assert out.name == robot.channels
    assert out.joint.shape == (200, len(robot.positioning))
    assert out.truth.position.shape[1] == len(out.truth.name) == len(robot.positioning)
    motors = names if robot.transmission else 0
    assert out.motor.shape == out.motor_velocity.shape == (200, motors)
    for rows in (out.measured, out.velocity, out.setpoint, out.motor, out.motor_velocity):
        assert np.isfinite(rows).all()
    assert out.measured.shape == out.velocity.shape == out.setpoint.shape == (200, names)
    assert out.effort.shape in ((200, names), (200, 0))
    assert {values.shape for values in out.extra.values()} <= {(200,)}
    assert (np.diff(np.concatenate([homed.t, out.t])) > 0.0).all()
    path = tmp_path / "mine.toml"
    path.write_text("# nothing differs\n")
    again = make_twin(name, seed=4, parameters=path)
    np.testing.assert_array_equal(again.home().measured, homed.measured)


def test_a_robot_without_a_twin_is_refused():
    with pytest.raises(RobotError, match="no digital twin of 'kflex'; there is one of 'raven2'"):
        make_twin("kflex")


def test_the_same_seed_gives_the_same_numbers_however_a_motion_is_cut(name, whole):
    assert_same(whole[1], moved(name, cuts=CUTS)[1])
    assert not np.array_equal(whole[1].truth.position, moved(name, seed=4)[1].truth.position)


def test_a_twin_goes_back_to_what_was_noted(whole):
    twin, _ = deepcopy(whole)
    back, time = twin.saved(), twin.time
    goal = np.tile(twin.robot.home, (300, 1))
    first = twin.run(goal)
    back()
    assert twin.time == time
    assert_same(first, twin.run(goal))


def test_time_passes_at_rest(whole):
    twin, out = deepcopy(whole)
    twin.idle(3600.0)
    assert twin.time == pytest.approx(out.t[-1] + 3600.0, abs=2e-3)
    after = twin.run(np.tile(twin.robot.home, (5, 1)))
    assert after.t[0] - out.t[-1] == pytest.approx(3600.0, abs=2e-3)
    np.testing.assert_allclose(np.diff(after.t), 1e-3, atol=1e-9)
    assert twin.homing_count == 1


def test_bad_calls_are_refused(name):
    for load in (-1, math.nan, 1e3):
        with pytest.raises(TruejointError, match=f"load is {load} kg; it must lie in"):
            make_twin(name, load=load)
    for seed in (-1, 2**63, True, 1.0):
        with pytest.raises(TruejointError, match=f"seed is {seed}; give a whole number"):
            make_twin(name, seed=seed)
    with pytest.raises(RobotError, match="no arm called 'middle'"):
        make_twin(name, "middle")
    twin = make_twin(name)
    n = len(twin.robot.joints)
    with pytest.raises(CommandRefused, match=rf"shape \({n + 1},\) per sample, want {n} values"):
        twin.run(np.zeros((5, n + 1)))
    bad = np.tile(twin.robot.home, (5, 1))
    bad[3, -1] = math.nan
    with pytest.raises(CommandRefused, match=f"{twin.robot.joint_names[-1]} is nan at sample 3 of"):
        twin.run(bad)
    for duration in (-1.0, math.nan, math.inf):
        with pytest.raises(TruejointError, match=f"duration is {duration}; give a finite number"):
            twin.idle(duration)
    assert twin.time == 0.0
