"""Tests of the limits that an arm enforces."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from truejoint.crtk.limits import JITTER, check_steps, jump_of
from truejoint.errors import CommandRefused
from truejoint.robots import get_robot
from truejoint.robots.blocks import check_range

ROBOT = get_robot("raven2", "left")
HOME = ROBOT.home


@given(st.integers(0, 6), st.floats(1e-6, 10.0), st.booleans())
def test_range_is_refused_just_outside_and_kept_on_it(joint, excess, above):
    edge = ROBOT.upper[joint] if above else ROBOT.lower[joint]
    rows, away = np.tile(HOME, (3, 1)), 1.0 if above else -1.0
    rows[1:, joint] = edge + away * 1e-10  # as rounding has it
    check_range(ROBOT, rows, "servo_jp")
    rows[1:, joint] = edge + away * excess
    with pytest.raises(CommandRefused, match=f"{ROBOT.joint_names[joint]} at .* at sample 1 of 3"):
        check_range(ROBOT, rows, "servo_jp")


@pytest.mark.parametrize(
    ("joint", "limit", "shown"), [(0, 0.0025, "0.1432 deg"), (2, 5e-5, "0.05 mm")]
)
def test_steps_are_limited_per_millisecond(joint, limit, shown):
    # Limits: branch crtk of uw-biorobotics/raven2.
    rows = np.tile(HOME, (3, 1))
    rows[1:, joint] += limit
    check_steps(ROBOT, 1000.0, HOME, rows, "servo_jp_stream")
    rows[1:, joint] += 1e-6
    with pytest.raises(CommandRefused, match=f"in 1 ms at sample 1 of 3, more than {shown}"):
        check_steps(ROBOT, 1000.0, HOME, rows, "servo_jp_stream")


def test_a_report_that_jumps_further_than_its_joint_moves_is_named():
    still = np.tile(HOME, (4, 1))
    t = 1e-3 * np.arange(4)
    most = 2e-3 * ROBOT.joints[1].max_speed  # twice a millisecond's way
    for size, match in ((0.99 * most, ""), (1.01 * most, "elbow jumped by .* at t = 0.002 s")):
        rows = still + np.outer([0, 0, 1, 1], size * np.eye(7)[1])
        assert re.match(match or "$", jump_of(ROBOT, 1000.0, t, rows))
    gap = np.array([0.0, 1e-3, 2.0, 2.001])  # it may have moved meanwhile
    assert jump_of(ROBOT, 1000.0, gap, rows) == ""


@given(
    st.lists(st.floats(-0.4, 0.4), min_size=60, max_size=60),
    st.sampled_from([1e-3, 2e-3, 1e-2]),
    st.integers(1, 60),
    st.integers(0, 6),
    st.booleans(),
)
def test_jitter_of_stamps_is_no_jump_and_hides_none(jitter, period, piece, joint, slips):
    top = ROBOT.joints[joint].max_speed
    true = period * np.arange(60)
    t = true + period * np.array(jitter)
    way = 0.98 * top * np.maximum(true - 3 * period, 0.0)  # from rest
    rows = HOME + np.outer(way, np.eye(7)[joint])
    if slips:
        rows[45:, joint] += 3.0 * top * period
    said = []
    for begin in range(0, 60, piece):  # as messages come, one by one or in blocks
        end = min(begin + piece, 60)
        stamps, first = t[max(begin - JITTER, 0) : end], max(begin - 1, 0)
        if end - first > 1:
            said.append(jump_of(ROBOT, 1000.0, stamps, rows[first:end]))
    assert len([text for text in said if text]) == slips
