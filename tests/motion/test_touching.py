"""A hand that steers a twin seats its tip where the dimple is, from the side that was asked for."""

import numpy as np
import pytest

from truejoint.crtk import StateBlock, simulated_arm
from truejoint.errors import CommandRefused, RobotError
from truejoint.motion.touching import REST, SimulatedHand, joints_at
from truejoint.simulation import TwinOutput

TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


@pytest.fixture(scope="module")
def arm():
    arm = simulated_arm("raven2", seed=3)
    arm.enable()
    arm.home()
    return arm


def test_the_tip_rests_in_its_dimple_after_coming_from_a_side(arm):
    robot, blocks = arm.robot, []
    place = robot.home.copy()
    place[:3] = robot.workspace.centre
    origin = robot.kinematics.forward(place)[:3, 3]
    hand = SimulatedHand(arm, TURN, origin, seat_sd=0.0)
    point = np.array([0.004, -0.006, 0.003])
    for side in (np.array([1.0, -1.0, 1.0]), np.array([-1.0, 1.0, -1.0])):
        arm.subscribe(blocks.append)
        t = hand.touch(point, side)
        arm.unsubscribe(blocks.append)
        rows = [b for b in blocks if isinstance(b, StateBlock)]
        assert t == pytest.approx(rows[-1].t[-1], abs=0.01)
        true = np.tile(robot.home, (len(rows), 1))
        true[:, :3] = [b.joint[-1] for b in rows if isinstance(b, TwinOutput)]
        off = robot.kinematics.forward(true[-1])[:3, 3] - TURN @ point - origin
        assert np.abs(off).max() < 1.5e-4
        resting = np.concatenate([b.joint for b in rows])[-round(0.5 * REST * 1000) :]
        assert np.ptp(resting, axis=0).max() < 1e-4
        away = np.concatenate([b.joint for b in rows]) - rows[-1].joint[-1]
        out = np.flatnonzero((np.abs(away) > np.deg2rad(1.0)).any(axis=1))[-1]
        assert (np.sign(away[out]) == side).all()
        blocks.clear()


def test_what_is_out_of_reach_or_no_twin_is_refused(arm, lagging_arm):
    with pytest.raises(RobotError, match="cannot reach"):
        joints_at(arm.robot, np.array([0.0, 0.0, 0.1]), arm.robot.home)
    with pytest.raises(CommandRefused, match="touch by hand"):
        SimulatedHand(lagging_arm, TURN, np.zeros(3))
