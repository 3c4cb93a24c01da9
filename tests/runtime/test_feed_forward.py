"""The inverse of a calibration along the way that is wanted."""

from __future__ import annotations

import numpy as np
import pytest

from truejoint.calibration import calibrate
from truejoint.errors import CommandRefused
from truejoint.estimators import Plays
from truejoint.recordings import Provenance, Recording
from truejoint.robots import get_robot
from truejoint.runtime import Compensator, Corrector, FeedForward

ROBOT = get_robot("forceps")
WIDTH = 0.03  # half of the play [rad]
RATE = 200.0


def played(motor):
    """A joint that stands still until its motor has come to the end of its play."""
    joint = np.empty(len(motor))
    last = motor[0]
    for k, angle in enumerate(motor):
        joint[k] = last = min(max(last, angle - WIDTH), angle + WIDTH)
    return joint


def recording(seconds=80.0):
    t = np.arange(round(seconds * RATE)) / RATE
    motor = 0.4 * np.sin(0.9 * t) * np.cos(0.13 * t) + 0.1 * np.sin(2.3 * t)
    columns = {"t": t, "measured/jaw": motor, "truth/jaw": played(motor)}
    columns["effort/jaw"] = np.cos(t)
    return Recording.from_columns(
        columns, Provenance("forceps", session="play"), {"effort/jaw": "Nm"}
    )


@pytest.fixture(scope="module")
def model():
    half_range = 0.5 * np.ptp(recording().column("measured/jaw"))
    plays = Plays(plays=(WIDTH / half_range,), pairs=())
    return calibrate(recording(), plays, features=["measured/jaw"], joints=["jaw"])


def tracked(model, forward):
    """Errors (n,) [rad] of a joint with play, its motor 20 ms late, that swings to and fro."""
    corrector = Corrector(model.without_redundant())
    corrector.set_homing(True)
    loop = Compensator(
        corrector, ROBOT, rate=RATE, lag=0.02, gain=0.3, time_constant=0.01, integral_time=np.inf,
        forward=FeedForward(model, ROBOT) if forward else None,
    )  # fmt: skip
    t = np.arange(round(12.0 * RATE)) / RATE
    wanted = 0.3 * np.sin(1.3 * t)
    motor, joint, error = 0.0, 0.0, np.zeros(len(t))
    loop.start([0.0])
    for k in range(1, len(t)):
        error[k - 1] = joint - wanted[k - 1]
        setpoint = loop.step(t[k - 1], [motor], [wanted[k]])[0]
        motor += (setpoint - motor) / (0.02 * RATE)
        joint = min(max(joint, motor - WIDTH), motor + WIDTH)
    return error[round(3.0 * RATE) : -1]


def test_a_joint_with_play_turns_back_sooner_where_its_play_is_fed_forward(model):
    fed, alone = (np.sqrt(np.mean(tracked(model, forward) ** 2)) for forward in (True, False))
    assert fed < 0.7 * alone


def test_what_is_lost_is_that_of_the_way_each_has_gone(model):
    """Motors that still go one way have lost one side's half width, set-points the other's."""
    ahead = FeedForward(model, ROBOT)
    ahead.start([0.0])
    way = np.concatenate([np.arange(0.0, 0.3, 0.002), np.arange(0.3, 0.1, -0.002)])
    for k, there in enumerate(way):
        ahead.step(1.0 / RATE, [way[max(k - 4, 0)]], [there])
        if there == pytest.approx(0.298):
            np.testing.assert_allclose(ahead.forward, -WIDTH, atol=0.1 * WIDTH)
    np.testing.assert_allclose(ahead.forward, WIDTH, atol=0.1 * WIDTH)
    np.testing.assert_allclose(ahead.expected, WIDTH, atol=0.1 * WIDTH)
    before = ahead.forward.copy()
    ahead.step(1.0 / RATE, [np.nan], [0.1])
    np.testing.assert_array_equal(ahead.forward, before)


def test_inputs_that_no_set_point_tells_are_refused(model):
    felt = calibrate(recording(), "linear", features=["measured/jaw", "effort/jaw"])
    with pytest.raises(CommandRefused, match="effort/jaw does not follow from where jaw are"):
        FeedForward(felt, ROBOT)
    corrector = Corrector(model.without_redundant())
    ahead = FeedForward(model, ROBOT)
    object.__setattr__(ahead, "joints", ("elbow",))
    with pytest.raises(CommandRefused, match="what is fed forward is of elbow, the corrector of"):
        Compensator(corrector, ROBOT, rate=RATE, lag=0.02, forward=ahead)
    with pytest.raises(CommandRefused, match="is a Calibration, not a FeedForward; give"):
        Compensator(corrector, ROBOT, rate=RATE, lag=0.02, forward=model)


def test_a_loop_made_like_another_shares_no_memory_with_it(model):
    paths = []
    for between in (False, True):
        corrector = Corrector(model.without_redundant())
        corrector.set_homing(True)
        loop = Compensator(corrector, ROBOT, rate=RATE, lag=0.02, forward=FeedForward(model, ROBOT))
        other = loop.around(corrector)
        loop.start([0.0])
        path = []
        for k in range(60):
            path.append(loop.step(k / RATE, [0.002 * k], [0.002 * (k + 1)]).copy())
            if between:
                other.start([0.1])
        paths.append(path)
    np.testing.assert_array_equal(paths[1], paths[0])
    assert loop.forward.forward.any()
