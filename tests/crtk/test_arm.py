"""Tests of truejoint.crtk.arm, on a back end whose lag is known."""

import numpy as np
import pytest
from tests.conftest import homed

from truejoint.crtk import Arm, SimulatedBackend, StateBlock, TruthBlock
from truejoint.crtk.arm import joint_efforts
from truejoint.errors import CommandRefused
from truejoint.robots import get_robot
from truejoint.simulation import make_twin

LAG = 0.02  # of the lagging back end [s]


def refused_without_effect(arm, backend, match, call):
    """`call` raises CommandRefused, one line, and nothing reaches the robot."""
    sent, before = len(backend.sent), arm.setpoint_js().position.copy()
    with pytest.raises(CommandRefused, match=match) as refusal:
        call()
    assert "\n" not in str(refusal.value)
    assert len(backend.sent) == sent
    assert np.array_equal(arm.setpoint_js().position, before)


def test_a_new_arm_reports_nothing_until_homed(lagging_backend):
    arm = Arm(lagging_backend)
    state = arm.operating_state()
    assert (state.state, state.is_homed, state.is_busy) == ("DISABLED", False, False)
    for read in (arm.measured_js, arm.setpoint_js, arm.measured_cp):
        with pytest.raises(CommandRefused, match="not homed; send 'home' first"):
            read()
    with pytest.raises(CommandRefused, match="'home' refused: the arm is DISABLED"):
        arm.home()
    arm.enable()
    with pytest.raises(CommandRefused, match="move_jp refused: the arm is not homed"):
        arm.move_jp(arm.robot.home)
    arm.home()
    assert arm.operating_state().is_ready
    assert arm.measured_js().position == pytest.approx(arm.robot.home)
    assert arm.measured_js().name == arm.robot.joint_names
    arm.unhome()
    with pytest.raises(CommandRefused, match="not homed"):
        arm.measured_js()


@pytest.mark.parametrize(
    ("stop", "advice"), [("pause", "resume"), ("disable", "enable"), ("unhome", "home")]
)
@pytest.mark.parametrize("motion", ["servo_jp", "servo_jr", "servo_jp_stream", "move_jp"])
def test_motion_needs_a_ready_arm(lagging_arm, lagging_backend, motion, stop, advice):
    home = lagging_arm.robot.home
    goal = {"servo_jr": np.zeros(7), "servo_jp_stream": home[None]}.get(motion, home)
    lagging_arm.state_command(stop)
    sent = len(lagging_backend.sent)
    with pytest.raises(CommandRefused, match=f"{motion} refused: .*send '{advice}' first"):
        getattr(lagging_arm, motion)(goal)
    assert len(lagging_backend.sent) == sent


@pytest.mark.parametrize("motion", ["servo_jp", "servo_jr", "servo_jp_stream", "move_jp"])
def test_every_motion_refuses_bad_positions(lagging_arm, lagging_backend, motion):
    home, one = lagging_arm.robot.home, np.eye(7)
    base = np.zeros(7) if motion == "servo_jr" else home
    call = getattr(lagging_arm, motion)
    cases = [
        (base + one[4] * np.nan, "nan|NaN"),
        (base[:6], "want 7 values"),
        (base - one[0], r"shoulder at -27.3 deg .*range \[0, 90\] deg"),
        (base + one[2] * 0.2, r"insertion at 600 mm .*range \[230, 560\] mm"),
    ]
    if motion != "move_jp":
        step = "elbow would step by 0.1719 deg in 1 ms.*, more than 0.1432 deg"
        cases.append((base + one[1] * 0.003, step))
    for value, match in cases:
        goal = value[None] if motion == "servo_jp_stream" else value
        refused_without_effect(lagging_arm, lagging_backend, match, lambda g=goal: call(g))


def test_a_stream_is_checked_whole_before_its_first_sample(lagging_arm, lagging_backend):
    rows = np.tile(lagging_arm.robot.home, (15000, 1))
    rows[-1, 0] += 0.01
    refused_without_effect(
        lagging_arm, lagging_backend, "sample 14999", lambda: lagging_arm.servo_jp_stream(rows)
    )


def test_relative_positions_start_at_the_latest_setpoint(lagging_arm):
    step = np.array([1e-3, -1e-3, 1e-5, 0, 0, 0, 2e-3])
    for _ in range(5):
        lagging_arm.servo_jr(step)
    setpoint = lagging_arm.setpoint_js()
    assert setpoint.position == pytest.approx(lagging_arm.robot.home + 5 * step, abs=1e-15)
    # The lag keeps the measured position behind: were it the reference, motion would be lost.
    assert abs(lagging_arm.measured_js().position[0] - setpoint.position[0]) > 3e-3


def test_move_arrives_with_bounded_speed_and_acceleration(lagging_arm, lagging_backend):
    goal = lagging_arm.robot.home + np.array([0.2, -0.1, 0.01, 0.5, 0, 0, 0])
    lagging_arm.move_jp(goal).wait()
    lagging_arm.wait(1.0)
    assert lagging_arm.setpoint_js().position == pytest.approx(goal, abs=1e-12)
    assert lagging_arm.measured_js().position == pytest.approx(goal, abs=1e-9)
    path = np.vstack([lagging_arm.robot.home, *lagging_backend.sent])
    speed = np.diff(path, axis=0) * 1000.0
    caps = np.deg2rad([3, 3, 0, 10, 10, 10, 10])
    caps[2] = 0.01
    assert (np.abs(speed) <= caps + 1e-8).all()
    assert np.abs(speed).max(axis=0)[0] == pytest.approx(caps[0])
    assert (np.abs(np.diff(speed, axis=0)) * 1000.0 <= caps / 0.25 + 1e-4).all()


@pytest.mark.parametrize(("joint", "speed"), [(0, 0.0), (1, -1.0), (0, 2.6), (2, 0.051)])
def test_move_refuses_speeds_beyond_the_robot(lagging_arm, lagging_backend, joint, speed):
    caps = np.full(7, 0.04)
    caps[joint] = speed
    goal, name = lagging_arm.robot.home + np.eye(7)[0] * 0.1, lagging_arm.robot.joint_names[joint]
    said = f"speed of {name} is .*want more than 0 and at most"
    call = lambda: lagging_arm.move_jp(goal, speed=caps)  # noqa: E731
    refused_without_effect(lagging_arm, lagging_backend, said, call)


def test_a_move_is_busy_and_takes_no_other_command(lagging_arm):
    seen = []

    def nosy(block):
        state = lagging_arm.operating_state()
        with pytest.raises(CommandRefused, match="busy"):
            lagging_arm.servo_jr(np.zeros(7))
        seen.append(state.is_busy)

    lagging_arm.subscribe(nosy)
    lagging_arm.move_jp(lagging_arm.robot.home + np.eye(7)[0] * 0.1).wait()
    assert seen
    assert all(seen)
    assert not lagging_arm.operating_state().is_busy


def test_subscribers_get_all_in_order_and_in_small_blocks(lagging_arm):
    blocks: list[StateBlock | TruthBlock] = []
    lagging_arm.subscribe(blocks.append)
    start = lagging_arm.time
    lagging_arm.servo_jp_stream(np.tile(lagging_arm.robot.home, (1100, 1)))
    states = [block for block in blocks if isinstance(block, StateBlock)]
    truths = [block for block in blocks if isinstance(block, TruthBlock)]
    assert {len(block.t) for block in states} == {10}
    t = np.concatenate([block.t for block in states])
    assert t == pytest.approx(start + 1e-3 * np.arange(1, 1101))
    assert states[0].name == lagging_arm.robot.channels
    assert states[0].measured.shape == (10, 8)
    assert truths[0].name == lagging_arm.robot.positioning
    lagging_arm.unsubscribe(blocks.append)
    count = len(blocks)
    lagging_arm.wait(0.1)
    assert len(blocks) == count


def test_wait_servoes_when_ready_and_rests_on_the_brakes_otherwise(lagging_arm, lagging_backend):
    home = lagging_arm.robot.home
    lagging_arm.wait(6.0)
    lagging_arm.subscribe(lambda _: None, every=np.inf)  # no piece is longer for that
    lagging_arm.wait(6.0)
    assert {len(rows) for rows in lagging_backend.sent} == {500}
    assert all(np.array_equal(rows, np.tile(home, (len(rows), 1))) for rows in lagging_backend.sent)
    lagging_arm.pause()
    before = lagging_arm.time
    lagging_arm.wait(3600.0)
    assert lagging_backend.waited == 3600.0
    assert lagging_arm.time == before + 3600.0
    assert len(lagging_backend.sent) == 24
    for bad in (-1.0, np.nan, np.inf):
        with pytest.raises(CommandRefused, match="wait refused"):
            lagging_arm.wait(bad)


def test_tool_pose_is_in_the_frame_of_the_topics(lagging_arm):
    # Rotation: uw-biorobotics/raven2:src/raven/crtk_motion_api.cpp (gold arm).
    rotation = np.array([[0, -1, 0], [0, 0, -1], [1, 0, 0]])
    base = lagging_arm.robot.kinematics.forward(lagging_arm.robot.home)
    pose = lagging_arm.measured_cp()
    assert pose[:3, 3] == pytest.approx(rotation @ base[:3, 3])
    assert pose[:3, :3] == pytest.approx(rotation @ base[:3, :3])
    assert pose[3] == pytest.approx([0, 0, 0, 1])


def test_a_robot_that_states_no_effort_has_none():
    arm = homed(SimulatedBackend(make_twin("forceps", seed=1)))
    assert arm.measured_js().effort.shape == (0,)
    robot, rows = get_robot("bros"), np.array([[1.0, 2.0]])  # whose efforts are on the joints
    block = StateBlock(np.zeros(1), robot.channels, *[rows] * 6)
    np.testing.assert_array_equal(joint_efforts(robot, block), rows)
