"""Jaws that close until they grip as wanted, on something that gives way as springs do."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from truejoint.errors import CommandRefused
from truejoint.robots import get_robot
from truejoint.runtime import GripControl

ROBOT = get_robot("wrist")
STIFFNESS = 1.5  # [Nm/rad] of the contact
HELD = 0.25  # [rad]
RATE = 200.0
OPEN = np.array([0.1, -0.2, 0.2])


def loop(joints=("pitch", "jaw1", "jaw2"), grip=True):
    """As much of a compensator as a grip needs; what it knows is set by a test."""
    corrector = SimpleNamespace(
        joints=joints, beside={"grip": np.zeros(2)} if grip else {}, gives_way={}
    )
    return SimpleNamespace(
        corrector=corrector, rate=RATE, known=OPEN.copy(), believes=True,
        give_way=lambda now, wanted: None,
    )  # fmt: skip


def gripped(wanted, off=0.0, felt=1.0):
    """Grips (n,) [Nm] of jaws that go where they are told, and poses, a row a step of the loop.

    Their opening is known `off` [rad] too large, and their grip `felt` times as large.
    """
    compensator = loop()
    rows = np.tile(OPEN, (len(wanted), 1))
    grips, poses = [], []
    for piece in GripControl(compensator, ROBOT).pieces(rows, wanted, 1000.0):
        poses.append(piece[-1])
        # The loop takes what is known to where it is wanted, so that the jaws are `off` it.
        opening = piece[-1, 2] - piece[-1, 1] - off
        grips.append(STIFFNESS * max(HELD - opening, 0.0))
        compensator.known = piece[-1]
        compensator.corrector.beside["grip"][0] = felt * grips[-1]
    return np.array(grips), np.array(poses)


@pytest.mark.parametrize("off", [0.0, 0.03])
def test_jaws_close_until_they_grip_as_wanted_wherever_they_are_thought_to_be(off):
    wanted = np.concatenate([np.full(3000, 0.04), np.full(1500, 0.06)])
    grips, poses = gripped(wanted, off)
    assert grips[0] == 0.0
    np.testing.assert_allclose(grips[500:600], 0.04, rtol=1e-3)
    np.testing.assert_allclose(grips[-20:], 0.06, rtol=1e-3)
    assert grips.max() < 0.062
    np.testing.assert_allclose(poses[:, 1] + poses[:, 2], 0.0, atol=1e-12)  # the yaw stays
    np.testing.assert_array_equal(poses[:, 0], OPEN[0])


def test_who_feels_too_much_grips_too_little():
    grips, _ = gripped(np.full(4000, 0.04), felt=1.25)
    assert grips[-1] == pytest.approx(0.032, rel=1e-3)


def test_jaws_open_again_where_no_grip_is_wanted_as_fast_as_they_may():
    grips, poses = gripped(np.concatenate([np.full(3000, 0.04), np.zeros(2000)]))
    assert grips[-1] == 0.0
    np.testing.assert_allclose(poses[-1], OPEN, atol=1e-12)
    speed = np.abs(np.diff(poses[:, 1:], axis=0)).max() * RATE
    assert speed <= ROBOT.joints[1].max_speed * (1.0 + 1e-9)


@pytest.mark.parametrize("said", [0.0, np.nan])
def test_jaws_stay_as_they_are_while_the_grip_is_not_known_and_for_a_time_constant(said):
    """A filter is not believed and begins anew at none; a gauge is, and says nothing."""
    compensator, openings = loop(), []
    control = GripControl(compensator, ROBOT)
    pieces = control.pieces(np.tile(OPEN, (3000, 1)), np.full(3000, 0.04), 1000.0)
    for step, piece in enumerate(pieces):
        opening = float(piece[-1, 2] - piece[-1, 1])
        openings.append(opening)
        compensator.known = piece[-1]
        compensator.believes = bool(np.isnan(said)) or not 300 <= step < 320
        force = STIFFNESS * max(HELD - opening, 0.0)
        last = 330 if said == 0.0 else 320
        compensator.corrector.beside["grip"][0] = said if 300 <= step < last else force
    openings = np.array(openings)
    assert STIFFNESS * (HELD - openings[300]) == pytest.approx(0.04, rel=1e-3)
    np.testing.assert_array_equal(openings[301:340], openings[300])
    np.testing.assert_allclose(openings[340:], openings[300], atol=1e-5)


def test_motors_wind_up_by_what_a_grip_takes_of_the_joints():
    compensator, told = loop(), []
    compensator.corrector.gives_way["grip"] = np.array([0.0, -2.0, 2.0])
    compensator.corrector.beside["grip"][0] = 0.03
    compensator.give_way = lambda now, wanted: told.append((now, wanted))
    wanted = np.concatenate([np.zeros(10), np.full(10, 0.05)])
    list(GripControl(compensator, ROBOT).pieces(np.tile(OPEN, (20, 1)), wanted, 1000.0))
    np.testing.assert_array_equal(told[0], np.zeros((2, 3)))
    np.testing.assert_allclose(told[-1][0], [0.0, -0.06, 0.06])
    np.testing.assert_allclose(told[-1][1], [0.0, -0.1, 0.1])


def test_pieces_join_without_a_jump():
    pieces = list(
        GripControl(loop(), ROBOT).pieces(np.tile(OPEN, (103, 1)), np.full(103, 0.05), 1000.0)
    )
    assert [len(piece) for piece in pieces] == [5] * 20 + [3]
    steps = np.diff(np.vstack([OPEN, *pieces]), axis=0)
    assert np.abs(steps).max() <= ROBOT.joints[1].max_speed * 1e-3 * (1.0 + 1e-9)


@pytest.mark.parametrize(
    ("wanted", "grip", "rate", "match"),
    [
        (OPEN, np.zeros(3), 1000.0, "shape"),
        (np.tile(OPEN, (4, 1)), np.zeros(3), 1000.0, r"shape \(3,\) for 4 rows"),
        (np.zeros((0, 3)), np.zeros(0), 1000.0, "give a row or more"),
        (np.tile(OPEN, (3, 1)), [0.0, np.nan, 0.0], 1000.0, "not finite or below 0 Nm"),
        (np.tile(OPEN, (3, 1)), [0.0, -0.1, 0.0], 1000.0, "not finite or below 0 Nm"),
        (np.full((3, 3), np.nan), np.zeros(3), 1000.0, "pitch is nan"),
        (np.tile(OPEN, (3, 1)), np.zeros(3), 50.0, "50 rows a second for a loop at 200 Hz"),
        ("open", np.zeros(3), 1000.0, "give numbers"),
    ],
)
def test_what_is_no_grip_of_a_row_each_is_refused_before_it_begins(wanted, grip, rate, match):
    with pytest.raises(CommandRefused, match=match):
        GripControl(loop(), ROBOT).pieces(wanted, grip, rate)


def test_what_tells_no_grip_or_has_no_jaws_is_refused():
    with pytest.raises(CommandRefused, match="the model tells no load, not 'grip'; calibrate one"):
        GripControl(loop(grip=False), ROBOT)
    with pytest.raises(CommandRefused, match=r"raven2 .* states no jaws that meet"):
        GripControl(loop(), get_robot("raven2"))
    with pytest.raises(CommandRefused, match="does not correct jaw2"):
        GripControl(loop(("pitch", "jaw1")), ROBOT)
    with pytest.raises(CommandRefused, match=r"a time constant of 0\.001 s; give 0\.01 s"):
        GripControl(loop(), ROBOT, time_constant=1e-3)
