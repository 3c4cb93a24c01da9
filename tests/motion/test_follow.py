"""Tests of truejoint.motion.follow: against a known lag, and on the digital twin."""

import re
import sys
import time
from types import SimpleNamespace

import numpy as np
import pytest

from truejoint.crtk import StateBlock, simulated_arm, time_law
from truejoint.errors import CommandRefused, MotionStopped, RobotError, TrajectoryError
from truejoint.motion import (
    Trajectory,
    follow,
    nominal_duration,
    random_motion,
    workspace_of,
    zigzag,
)
from truejoint.robots import get_robot
from truejoint.runtime import Status, motor_loop

JOINTS, UNITS = ("shoulder", "elbow", "insertion"), ("rad", "rad", "m")
LAG = 0.02  # of the lagging arm [s]
SPACE = workspace_of(get_robot("raven2"))


def line(*points, times=None):
    return Trajectory(JOINTS, UNITS, np.array(points, dtype=float), times)


def of(joint):
    return Trajectory((joint,), ("rad",), np.array([[0.0], [0.1]]))


CENTRE = SPACE.centre
STROKE = line(CENTRE, CENTRE + np.array([0.1, 0.0, 0.0]))


def at_rest_at(arm, point):
    arm.move_jp([*point, *arm.setpoint_js().position[3:]]).wait()
    arm.wait(1.0)


def test_tracking_error_of_a_known_lag(lagging_arm):
    at_rest_at(lagging_arm, CENTRE)
    shares, lengths = [], []
    lagging_arm.subscribe(lambda block: lengths.append(len(block.t)))
    report = follow(lagging_arm, STROKE, progress=shares.append)
    assert max(lengths) == 10
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    cap = SPACE.speed[0]
    # Sampled: the error of a first-order lag at constant speed is v dt / (exp(dt / lag) - 1).
    expected = cap * 1e-3 / np.expm1(1e-3 / LAG)
    assert report.max[0] == pytest.approx(expected, rel=1e-3)
    assert report.max[1:] == pytest.approx([0.0, 0.0], abs=1e-12)
    assert 0.9 * expected < report.rms[0] < expected
    assert report.max_speed[0] == pytest.approx(cap, rel=1e-6)
    assert report.duration == pytest.approx(0.1 / cap + 0.25)
    assert re.fullmatch(r".*shoulder 0.04.* deg RMS.*insertion 0.000 mm RMS.*", str(report))
    values = report.to_dict()
    assert values["rms"] == report.rms.tolist()
    assert values["units"] == ["rad", "rad", "m"]


def test_a_loop_around_the_motors_keeps_their_reports_to_the_trajectory(lagging_arm):
    at_rest_at(lagging_arm, CENTRE)
    zigzag_line = line(CENTRE, np.add(CENTRE, [0.1, 0.05, 0.01]), CENTRE)
    alone = follow(lagging_arm, zigzag_line)
    said = []
    lagging_arm.subscribe(said.append)
    loop = motor_loop(lagging_arm.robot, lag=LAG)
    report = follow(lagging_arm, zigzag_line, steering=loop)
    lagging_arm.unsubscribe(said.append)
    assert (report.rms < 0.3 * alone.rms).all()
    measured = np.vstack([block.measured for block in said if isinstance(block, StateBlock)])
    n = round(report.duration * 1000.0)
    law = time_law(zigzag_line.positions, SPACE.speed)
    missed = law.at(np.arange(1, n + 1) / 1e3) - measured[-n:, :3]
    # Told at the steps of the loop, it is what the reports say at each millisecond.
    assert report.rms == pytest.approx(np.sqrt((missed**2).mean(axis=0)), rel=0.05)
    assert report.max == pytest.approx(np.abs(missed).max(axis=0), rel=0.05)


def test_a_loop_around_motors_believes_no_old_message():
    loop = motor_loop(get_robot("forceps")).corrector
    assert loop.step(1.0, [0.1]) == Status.OK
    assert loop.step(1.0, [0.2]) == Status.STALE
    assert loop.step(2.0, [np.nan]) == Status.NOT_FINITE
    assert loop.step(np.nan, [0.1]) == Status.NOT_FINITE
    assert loop.step(2.0, [0.1, 0.2]) == Status.WRONG_SIZE
    assert loop.step(2.0, [[0.1], [0.1, 0.2]]) == Status.WRONG_SIZE
    assert loop.step(None, [0.1]) == Status.WRONG_SIZE
    assert loop.step(2.0, [0.3]) == Status.OK
    assert loop.step(3.0, [np.nan]) == Status.NOT_FINITE
    assert loop.position == [0.3]
    loop.release()  # to another arm, whose clock is earlier
    assert loop.step(1.0, [0.4]) == Status.OK


def test_set_points_keep_to_the_path_its_caps_and_accelerations(lagging_arm, lagging_backend):
    path = zigzag(lagging_arm.robot, "J1-J2-J3", 1.0)
    at_rest_at(lagging_arm, path.positions[0])
    sent = len(lagging_backend.sent)
    tool = lagging_arm.setpoint_js().position[3:].copy()
    report = follow(lagging_arm, path, speed=0.5 * SPACE.speed)
    rows = np.vstack(lagging_backend.sent[sent:])
    assert np.array_equal(rows[:, 3:], np.tile(tool, (len(rows), 1)))
    rows = rows[:, :3]
    speed = np.diff(rows, axis=0) * 1e3
    caps = SPACE.speed * 0.5
    assert (np.abs(speed) <= caps + 1e-8).all()
    assert (np.abs(np.diff(speed, axis=0)) * 1e3 <= 8 * caps + 1e-4).all()
    for corner in path.positions:  # passed, but for the rounding and a sample's way
        assert (np.abs(rows - corner) <= caps * (0.25 / 4 + 1e-3)).all(axis=1).any()
    assert rows[-1] == pytest.approx(path.positions[-1], abs=1e-12)
    nominal = nominal_duration(path, lagging_arm.robot)
    assert report.duration - 0.25 == pytest.approx(2.0 * (nominal - 0.25))


def test_times_are_kept(lagging_arm, lagging_backend):
    motion = random_motion(lagging_arm.robot, 15.0, seed=1)
    report = follow(lagging_arm, motion)
    rows = np.vstack(lagging_backend.sent)[-round(report.duration * 1000) :, :3]
    # The blend delays by half its length.
    t = np.arange(2.0, 14.0, 0.5)
    wanted = np.column_stack([np.interp(t, motion.times, q) for q in motion.positions.T])
    assert rows[np.round((t + 0.125) * 1000).astype(int) - 1] == pytest.approx(wanted, abs=2e-4)
    assert report.duration == pytest.approx(15.25)


@pytest.mark.parametrize(
    ("trajectory", "options", "match"),
    [
        (line(CENTRE, [2.0, 1.4, 0.4]), {}, r"shoulder spans .* outside the range \[0, 90\] deg"),
        (line(CENTRE, CENTRE + np.array([0, 0, 1.0])), {}, "insertion spans"),
        *((STROKE, {"speed": speed}, "must be 3 positive values")
          for speed in ([0.1, 0.1], [0.1, -0.1, 0.1], [0.1, np.nan, 0.01])),
        (STROKE, {"speed": [0.1, 0.1, 0.06]}, "insertion would move at 60 mm/s, above 50"),
        (of("roll"), {}, "no speed cap is known for roll"),
        (line(CENTRE, CENTRE + 0.05, times=[0.0, 0.01]), {}, "shoulder would move at"),
        (line(CENTRE, CENTRE + 0.01, times=[0.0, 9.0]), {"speed": [0.1, 0.1, 0.01]}, "has times"),
    ],
)  # fmt: skip
def test_what_cannot_be_followed_is_refused_before_moving(
    lagging_arm, lagging_backend, trajectory, options, match
):
    with pytest.raises(TrajectoryError, match=match):
        follow(lagging_arm, trajectory, **options)
    assert lagging_backend.sent == []


def test_unknown_joints_and_unready_arms_are_refused(lagging_arm, lagging_backend):
    with pytest.raises(RobotError, match="no joint called 'knee'"):
        follow(lagging_arm, of("knee"))
    lagging_arm.pause()
    with pytest.raises(CommandRefused, match="follow refused: the arm is PAUSED"):
        follow(lagging_arm, STROKE)
    assert lagging_backend.sent == []


def test_an_interrupted_run_leaves_no_subscriber(lagging_arm, lagging_backend):
    def stop(share):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        follow(lagging_arm, STROKE, progress=stop)
    assert lagging_arm._subscriptions == []
    assert lagging_arm.operating_state().state == "PAUSED"
    lagging_arm.resume()
    follow(lagging_arm, STROKE)


def test_a_pause_in_the_middle_goes_on_where_it_was_left(lagging_arm, lagging_backend, monkeypatch):
    at_rest_at(lagging_arm, CENTRE)
    sent = len(lagging_backend.sent)
    whole = follow(lagging_arm, STROKE)
    planned = np.vstack(lagging_backend.sent[sent:])
    at_rest_at(lagging_arm, CENTRE)
    sent, stops, listening = len(lagging_backend.sent), [1.0, 1.3], []

    def stop(block):
        if stops and lagging_arm.time - start > stops[0]:
            stops.pop(0)
            lagging_arm.pause()

    def resume(_):
        listening.append([subscription.callback for subscription in lagging_arm._subscriptions])
        lagging_arm.resume()

    clock = SimpleNamespace(sleep=resume, monotonic=time.monotonic)
    monkeypatch.setattr(sys.modules[follow.__module__], "time", clock)
    start = lagging_arm.time
    lagging_arm.subscribe(stop)
    report = follow(lagging_arm, STROKE, resume_within=30.0)
    assert listening == [[stop], [stop]]  # a pause counts for nothing in the tracking error
    rows = np.vstack(lagging_backend.sent[sent:])
    speed = np.diff(rows, axis=0) * 1e3
    assert report.duration == whole.duration
    assert rows[-1] == pytest.approx(planned[-1], abs=1e-12)
    # It never strays from the line, and its speed changes no faster than a stop or a start needs.
    assert rows[:, 1:] == pytest.approx(np.tile(planned[0, 1:], (len(rows), 1)), abs=1e-12)
    assert (np.abs(speed[:, 0]) <= SPACE.speed[0] + 1e-8).all()
    assert np.abs(np.diff(speed[:, 0])).max() <= SPACE.speed[0] * 1e-3 / 0.05 * 1.01


def test_a_pause_that_nobody_ends_ends_the_run(lagging_arm):
    lagging_arm.subscribe(lambda block: lagging_arm.pause())
    with pytest.raises(MotionStopped, match=r"stopped at t = .* s, \d+% done: PAUSED"):
        follow(lagging_arm, STROKE)


def test_an_arm_that_was_switched_off_for_an_hour_is_followed_with():
    arm = simulated_arm("forceps", seed=1)
    arm.enable()
    arm.home()
    arm.disable()
    arm.wait(3600.0)
    arm.enable()
    assert follow(arm, of("jaw")).rms[0] < 0.05


def test_on_the_twin_the_same_seed_gives_the_same_report():
    reports = []
    for _ in range(2):
        arm = simulated_arm("raven2", "left", seed=7)
        arm.enable()
        arm.home()
        reports.append(follow(arm, line(CENTRE, CENTRE + np.array([0.1, 0.1, 0.005]))))
    first, second = reports
    assert first.to_dict() == second.to_dict()
    # It follows within a degree and a millimetre, as a PD loop at these speeds does.
    assert (first.max < [np.deg2rad(1.0), np.deg2rad(1.0), 1e-3]).all()
    assert (first.rms > 0.0).all()
    assert (first.max_speed <= SPACE.speed * 1.3).all()
