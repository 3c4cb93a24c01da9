"""Tests of the grasper: its opening is the sum of its jaws."""

import numpy as np
import pytest

from truejoint.crtk import Grasper, simulated_arm
from truejoint.errors import CommandRefused, RobotError


def test_opening_moves_the_jaws_evenly_and_nothing_else(lagging_arm):
    lagging_arm.move_jr([0, 0, 0, 0, 0, 0.1, -0.3]).wait(60.0)
    before = lagging_arm.setpoint_js().position
    grasper = Grasper(lagging_arm)
    opening = grasper.setpoint_js().position[0]
    assert opening == pytest.approx(before[5] + before[6])
    grasper.move_jp(1.0).wait(60.0)
    after = lagging_arm.setpoint_js().position
    assert np.array_equal(after[:5], before[:5])
    assert after[6] - after[5] == pytest.approx(before[6] - before[5])
    assert grasper.setpoint_js().position == pytest.approx([1.0])
    grasper.servo_jr(1e-3)
    grasper.servo_jv(1.0)
    grasper.servo_jp(grasper.setpoint_js().position[0] - 5e-4)
    assert grasper.setpoint_js().position == pytest.approx([1.0015])
    grasper.move_jr(-0.1).wait(60.0)
    assert grasper.setpoint_js().position == pytest.approx([0.9015])
    lagging_arm.wait(1.0)
    assert grasper.measured_js().position == pytest.approx([0.9015])
    assert grasper.measured_js().name == ("grasper",)


def test_refusals(lagging_arm):
    with pytest.raises(RobotError, match="forceps names no jaws"):
        Grasper(simulated_arm("forceps"))
    with pytest.raises(CommandRefused, match="outside its range"):
        Grasper(lagging_arm).move_jp(5.0)
