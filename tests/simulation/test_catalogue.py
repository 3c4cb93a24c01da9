"""Tests of truejoint.simulation.catalogue: one contract for every twin."""

import numpy as np
import pytest

from truejoint.errors import RobotError
from truejoint.simulation import Twin, make_twin


@pytest.mark.parametrize("name", ["raven2", "forceps", "wrist"])
def test_every_twin_keeps_the_contract(name, tmp_path):
    twin: Twin = make_twin(name.upper(), seed=4)
    robot, names = twin.robot, len(twin.robot.channels)
    assert (robot.name, twin.seed, twin.time, twin.homing_count) == (name, 4, 0.0, 0)
    homed = twin.home()
    assert twin.homing_count == 1
    home = robot.index(robot.positioning)
    assert homed.joint[-1] == pytest.approx(robot.home[home], abs=0.2)
    begin = twin.time
    out = twin.run(np.tile(robot.home, (200, 1)))
    assert twin.time == pytest.approx(begin + 0.2)
    assert out.name == robot.channels
    assert out.joint.shape == (200, len(robot.positioning))
    assert out.truth.position.shape[1] == len(out.truth.name) == len(robot.positioning)
    for rows in (out.measured, out.velocity, out.setpoint, out.motor, out.motor_velocity):
        assert rows.shape == (200, names)
        assert np.isfinite(rows).all()
    assert out.effort.shape in ((200, names), (200, 0))
    assert {values.shape for values in out.extra.values()} <= {(200,)}
    assert (np.diff(np.concatenate([homed.t, out.t])) > 0.0).all()
    twin.load = 0.1
    assert twin.load == 0.1
    path = tmp_path / "mine.toml"
    path.write_text("# nothing differs\n")
    again = make_twin(name, seed=4, parameters=path)
    np.testing.assert_array_equal(again.home().measured, homed.measured)


def test_a_robot_without_a_twin_is_refused():
    with pytest.raises(RobotError, match="no digital twin of 'kflex'; there is one of 'raven2'"):
        make_twin("kflex")
