"""The compensator on a joint whose loss is known, and on the virtual forceps."""

import threading
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from truejoint.crtk import BLEND, Arm
from truejoint.crtk.backends.simulated import SimulatedBackend
from truejoint.errors import CalibrationError, CommandRefused
from truejoint.motion import Trajectory, follow
from truejoint.motion.forceps_trajectories import verification_trajectory
from truejoint.robots import get_robot
from truejoint.runtime import Compensator, Corrector, Status, compensation, loop_margin
from truejoint.runtime.compensator import MotorReadings
from truejoint.simulation.forceps.specimens import specimen
from truejoint.simulation.forceps.twin import ForcepsTwin

from .registered import model as registered

FORCEPS = get_robot("forceps")
LAG = 0.0191  # of the nominal motor loop [s]


def test_each_joint_of_three_is_compensated_as_if_it_were_alone():
    rng = np.random.default_rng(0)
    scalars = {"doubted": 1, "lead": 4.0, "gain": 0.5, "share": 0.3, "integral": 0.1,
               "settle": 0.05, "dead_band": 0.01}  # fmt: skip
    limits = {"lower": [-0.2, -0.5, -0.1], "upper": [0.3, 0.1, 0.6], "step": [0.05, 0.02, 0.1]}
    states = ("wanted", "measured", "correction", "setpoint", "last_wanted", "lost", "made_up")

    def packed(joints):
        n = len(joints)
        memory = compensation.LAYOUT.pack(
            n_joints=n, **scalars, **{name: np.array(v)[joints] for name, v in limits.items()},
            **dict.fromkeys((*states, "is_limited", "rests"), np.zeros(n)),
        )  # fmt: skip
        compensation.begin(memory.numbers, memory.memory)
        return joints, memory

    loops = [packed([0, 1, 2]), packed([0]), packed([1]), packed([2])]
    goals = np.repeat(np.cumsum(rng.normal(0.0, 0.03, (60, 3)), axis=0), 3, axis=0)  # and stays
    seen = {"is_limited": set(), "rests": set()}
    for goal in goals:
        told = {"wanted": goal, "measured": goal + rng.normal(0.0, 0.02, 3),
                "correction": rng.normal(0.02, 0.005, 3)}  # fmt: skip
        for joints, memory in loops:
            for name, values in told.items():
                memory.view(name)[:] = values[joints]
            compensation.compensate(memory.numbers, memory.memory)
        together, *alone = (memory for _, memory in loops)
        for name in (*states, *seen):
            each = np.concatenate([memory.view(name) for memory in alone])
            np.testing.assert_array_equal(together.view(name), each)
        for name, values in seen.items():
            values |= set(enumerate(together.view(name).tolist()))
    assert all(len(values) == 6 for values in seen.values())


class Told:
    """A corrector that says what it is told: the joint is `loss` off the measured position."""

    made_for, joints, signals = ("forceps", ""), ("jaw",), ("measured/jaw",)
    spike_speed = np.array([10.0])
    offset = position = np.zeros(1)

    def __init__(self, loss=0.0, status=Status.OK):
        self.correction, self.status = np.array([loss]), status

    def step(self, t, sample):
        return self.status

    def release(self):
        pass


class Insertion(Told):
    """One of a RAVEN-II's insertion, which also says where that is, and counts its steps."""

    made_for, joints, signals = ("raven2", "left"), ("insertion",), ("measured/insertion",)
    steps = 0

    def step(self, t, sample):
        self.steps += 1
        self.position = np.asarray(sample) + self.correction
        return self.status


def quick(corrector, robot=FORCEPS, **how):
    """A loop that makes up for what is lost within milliseconds."""
    fast = {"lag": LAG, "gain": 1.5, "time_constant": 0.005, "integral_time": np.inf}
    return Compensator(corrector, robot, **fast | how)


def settled_at(compensator, wanted, steps=400):
    """Set-point after `steps` of a motor that follows it late."""
    measured = compensator.setpoint[0]
    for k in range(steps):
        setpoint = compensator.step(k / compensator.rate, [measured], [wanted])[0]
        measured += 0.2 * (setpoint - measured)
    return compensator.setpoint[0]


def test_the_set_point_makes_up_for_what_is_lost():
    compensator = quick(Told(-0.05))
    setpoint = settled_at(compensator, 0.3)
    assert setpoint == pytest.approx(0.35)
    assert compensator.lost == pytest.approx([-0.05])
    assert not compensator.is_limited.any()


@pytest.mark.parametrize("lag", [0.0, LAG, 0.05])
def test_set_points_of_an_even_motion_are_ahead_by_the_time_that_motors_need(lag):
    compensator, speed = quick(Told(-0.05), gain=0.0, lag=lag), 0.3
    for k in range(50):
        wanted = speed * k / 250.0
        ahead = compensator.step(k / 250.0, [wanted], [wanted])[0] - wanted
    assert ahead == pytest.approx(0.05 + lag * speed, abs=1e-9)


def test_a_joint_that_friction_holds_is_pulled_until_it_comes():
    """The true joint stands still: all that the motor moves is lost, and the loop integrates."""
    told = Told()
    compensator = quick(told, gain=0.0)
    measured, path = 0.0, []
    for k in range(20):
        told.correction = np.array([0.0 - measured])
        goal = 0.01 + 1e-9 * k  # it is not to stand still
        measured = float(compensator.step(k / 250.0, [measured], [goal])[0])
        path.append(measured)
    assert (np.diff(path[1:]) > 0.0).all()
    assert path[-1] > 0.05


@pytest.mark.parametrize("make", [quick, partial(Compensator, robot=FORCEPS)])
def test_a_limit_winds_nothing_up(make):
    compensator = make(Told(-0.5))
    setpoint = settled_at(compensator, 1.0, steps=4000)
    assert setpoint == pytest.approx(FORCEPS.upper[0])
    assert compensator.is_limited.all()
    back = settled_at(compensator, 0.3, steps=1500 if make is not quick else 100)
    assert back == pytest.approx(0.8, abs=1e-3)


def test_where_a_joint_shall_stand_still_set_points_go_on_slowly_and_let_a_little_be():
    told = Told()
    compensator = quick(told, dead_band=0.01)
    settled_at(compensator, 0.3)
    there = compensator.setpoint.copy()
    told.correction = np.array([0.008])
    assert compensator.step(9.0, [0.3], [0.3]) == there
    told.correction = np.array([-0.05])
    step = compensator.step(9.1, [0.3], [0.3])[0] - there[0]
    assert 0.0 < step < 0.06 / 10
    # A joint at rest stays there where the corrector is not sure: all its signals stand still.
    told.correction = np.array([0.002])
    compensator.step(9.2, [0.3], [0.3])
    told.status, told.correction = Status.FROZEN, np.array([np.nan])
    before = compensator.setpoint.copy()
    assert compensator.step(9.3, [0.3], [0.3]) == before


def test_set_points_keep_below_the_speed_of_a_spike():
    told = Told()
    told.spike_speed = np.array([1.0])
    compensator = quick(told)
    compensator.step(0.0, [0.0], [0.5])
    at = compensator.setpoint.copy()
    assert compensator.step(4e-3, [0.0], [0.6]) - at == pytest.approx([0.8 / 250.0])


def test_what_is_lost_is_held_where_the_corrector_is_not_sure():
    told = Told(-0.05)
    compensator = quick(told)
    settled_at(compensator, 0.3)
    told.correction, told.status = np.array([0.4]), Status.OUT_OF_DOMAIN
    assert settled_at(compensator, 0.2) == pytest.approx(0.25)
    assert compensator.status == Status.OUT_OF_DOMAIN
    believing = quick(told, believed=Status.OUT_OF_DOMAIN)
    assert settled_at(believing, 0.2) == pytest.approx(-0.2)
    told.correction = np.array([np.nan])
    assert np.isfinite(believing.step(9.0, [0.1], [np.nan])).all()


@pytest.mark.parametrize("rate", [100.0, 250.0, 1000.0])
@pytest.mark.parametrize("lag", [0.005, 0.019])
def test_the_margin_is_that_of_a_simulated_loop(rate, lag):
    """Two lags and a delay, simulated: still at 0.8 times the margin, swinging at 1.3 times."""
    margin, fine = loop_margin(rate, lag), 40
    peaks = []
    for gain in (0.8 * margin, 1.3 * margin):
        x, y, held, asked, late = 0.0, 0.0, 0.0, 0.0, []
        for k in range(round(3.0 * rate) * fine):
            if k % fine == 0:  # what was worked out a period ago goes out now
                held, asked = asked, gain * ((1.0 if k < 5 * fine else 0.0) - y)
            h = 1.0 / (rate * fine * 0.5 * lag)
            x += h * (held - x)
            y += h * (x - y)
            late.append(y)
        peaks.append(np.ptp(late[-fine * round(0.2 * rate) :]))
    assert peaks[0] < 1e-2 < peaks[1]


def fallen(compensator, believed):
    """Whether it has fallen back after each of many steps of an even motion."""
    found = []
    for k, is_believed in enumerate(believed):
        compensator.corrector.status = Status.OK if is_believed else Status.SPIKE
        compensator.step(k / compensator.rate, [0.0], [1e-6 * k])
        found.append(compensator.falls_back)
    return np.array(found)


@pytest.mark.parametrize("rate", [250.0, 1000.0])
def test_it_falls_back_where_half_of_a_second_is_doubted_and_goes_on_by_itself(rate):
    compensator = Compensator(Told(), FORCEPS, rate=rate, lag=LAG)
    assert compensator.trouble == ""
    seconds = round(rate)
    found = fallen(compensator, [True] * seconds + [False] * seconds + [True] * 2 * seconds)
    steps = np.flatnonzero(np.diff(found.astype(int))) + 1
    spent = np.log(2.0)  # [s] until a low-pass of one second has fallen to a half
    assert steps[0] == pytest.approx((1.0 + spent) * rate, abs=2)
    trust = np.exp(-1.0)  # after the second that is doubted
    assert steps[1:] == pytest.approx([(2.0 + np.log((1.0 - trust) / 0.25)) * rate], abs=3)
    assert not found[-1]


def test_a_loop_that_falls_back_holds_what_is_lost_and_lets_go_of_the_rest_without_a_leap():
    told = Told(-0.05)
    compensator = Compensator(told, FORCEPS, rate=250.0, lag=0.0)
    compensator.start([0.3])
    made_up, path, backs = compensator.memory.view("made_up"), [], []
    for k in range(3500):
        told.status = Status.OK if k < 500 or k >= 1500 else Status.SPIKE
        # A motor that stands still: the integral grows until nothing is fed back.
        path.append(compensator.step(k / 250.0, [0.3], [0.31 + 1e-9 * k])[0])
        backs.append((compensator.falls_back, made_up[0], compensator.lost[0]))
    falls = np.flatnonzero([back for back, _, _ in backs])[0]
    assert np.abs(np.diff(path)).max() < 1e-3
    assert backs[falls][1] > 0.1
    assert abs(backs[1499][1]) < 0.04 * backs[falls][1]
    assert backs[1499][2] == pytest.approx(backs[499][2], abs=1e-12) == pytest.approx(-0.05)
    assert path[1499] == pytest.approx(0.36, abs=0.01)
    assert not backs[-1][0]
    assert "SPIKE (a signal changed faster" not in compensator.trouble


def test_a_loop_that_fell_back_before_it_knew_the_joint_begins_as_any_other():
    told = Told(-0.05, Status.HOMED_AGAIN)
    compensator = Compensator(told, FORCEPS, rate=250.0, lag=0.0)
    compensator.start([0.1])
    path = []
    for k in range(1500):
        told.status = Status.HOMED_AGAIN if k < 500 else Status.OK
        path.append(compensator.step(k / 250.0, [0.1], [0.5 + 1e-6 * k])[0])
    assert np.abs(np.diff(path)).max() < 0.01
    assert compensator.knows_lost


def test_the_gain_comes_back_slowly_after_a_fall_back():
    told = Told()
    compensator = quick(told)
    fallen(compensator, [True] * 10 + [False] * 300)
    assert "most of the others SPIKE (a signal changed" in compensator.trouble
    told.correction, path = np.array([-0.02]), []  # an error that a step feeds back at once
    told.status = Status.OK
    for k in range(310, 1500):
        path.append(compensator.step(k / 250.0, [0.0], [1e-6 * k])[0])
        if compensator.falls_back:
            first = len(path)
    assert np.abs(np.diff(path[first - 1 :])).max() < 0.02 * 2.5 / 50
    assert path[-1] - path[first - 1] > 0.5 * 0.02 * 1.5


def test_messages_that_come_again_are_no_doubt():
    """A robot that reports more seldom than the loop steps; a corrector calls these OK."""
    told = Told(-0.05)
    compensator = Compensator(told, FORCEPS, rate=250.0, lag=LAG)
    for k in range(600):
        told.correction = np.array([np.nan if k % 4 else -0.05])
        compensator.step(k / 250.0, [0.0], [1e-6 * k])
    assert not compensator.falls_back
    assert compensator.lost == pytest.approx([-0.05])


@pytest.mark.parametrize(("status", "speed", "falls"), [
    (Status.FROZEN, 0.0, False), (Status.FROZEN, 1e-6, True), (Status.SPIKE, 0.0, True),
    (Status.FROZEN | Status.OUT_OF_RANGE, 0.0, True),
])  # fmt: skip
def test_signals_that_stand_still_with_their_joint_do_not_count(status, speed, falls):
    compensator = Compensator(Told(status=status), FORCEPS, rate=250.0, lag=LAG)
    for k in range(400):
        compensator.step(k / 250.0, [0.0], [speed * k])
    assert compensator.falls_back == falls


def doubting(lagging_arm, spans):
    """Loop around an arm whose corrector doubts the steps in some spans [s], and a slow way."""

    class Doubting(Insertion):
        @property
        def status(self):
            k = self.steps / 250.0
            return Status.IMPLAUSIBLE if any(a <= k < b for a, b in spans) else Status.OK

        @status.setter
        def status(self, _):
            """Leave it to the spans."""

    wanted = lagging_arm.robot.home[2] + np.linspace(0.0, 0.02, 9_000)
    return Compensator(Doubting(0.002), lagging_arm.robot, lag=0.02), wanted[:, None]


def test_a_short_fall_back_is_told_once_and_passes(lagging_arm, caplog):
    loop, wanted = doubting(lagging_arm, [(1.0, 2.0), (4.5, 5.5)])
    loop.drive(lagging_arm, wanted)
    (line,) = [record.getMessage() for record in caplog.records]
    assert line.startswith("compensator: fewer than half of its steps were OK for a second")
    assert "IMPLAUSIBLE" in line
    assert not loop.falls_back


@pytest.mark.parametrize("spans", [[(1.0, 99.0)], [(k, k + 1.0) for k in np.arange(0.5, 9, 2.8)]])
def test_a_fall_back_that_lasts_or_comes_again_and_again_ends_the_motion(lagging_arm, spans):
    loop, wanted = doubting(lagging_arm, spans)
    with pytest.raises(CommandRefused, match=r"others IMPLAUSIBLE \(the correction .* lower its"):
        loop.drive(lagging_arm, wanted)
    if len(spans) == 1:
        assert loop.corrector.steps / 250.0 == pytest.approx(1.0 + np.log(2.0) + 2.0, abs=0.02)
    assert lagging_arm.operating_state().state == "PAUSED"


def test_no_set_point_is_faster_at_the_end_of_a_piece_that_is_no_whole_step(lagging_arm):
    loop, _ = doubting(lagging_arm, [])
    far = np.tile(lagging_arm.robot.home, (31, 1))
    far[:, 2] += 0.05 + 1e-6 * np.arange(31)
    far[0] = lagging_arm.robot.home
    rows = np.concatenate(list(loop.setpoints(lagging_arm, [far[:10], far[10:21], far[21:]])))
    assert rows.shape == far.shape
    step = loop.memory.view("step")[0] / 4
    assert np.abs(np.diff(rows[:, 2])).max() == pytest.approx(step)


@pytest.mark.parametrize(
    ("how", "said"),
    [({"rate": 50.0, "gain": 1.5}, r"50 Hz is too slow for a gain of 1.5 .* lags by 19"),
     ({"gain": 0.5}, r"lower the gain to 0\.019, or the time"),
     ({"gain": 0.02}, r"lower the gain to 0\.019, or the time"), ({"gain": np.nan}, "gain is nan"),
     ({"lag": "0.05"}, r"lag is '0\.05'; give a number"), ({"lag": -1.0}, r"lag is -1\.0; give"),
     *(({"rate": rate}, "Hz, .*give a rate above 0") for rate in ("250", 0.0, np.nan, np.inf)),
     ({"integral_time": None}, "integral time is None s; give more than 0 s")],
)  # fmt: skip
def test_numbers_that_cannot_work_are_refused(how, said):
    with pytest.raises(CommandRefused, match=said):
        Compensator(Told(), FORCEPS, **{"lag": LAG} | how)


def test_what_makes_no_loop_is_refused():
    Compensator(None, FORCEPS, lag=LAG, gain=0.5)  # which sees no spikes
    checking = SimpleNamespace(signals=("measured/jaw", "setpoint/jaw"), joints=("jaw",))
    checking.made_for = "forceps", ""
    with pytest.raises(CommandRefused, match="checks setpoint/jaw"):
        Compensator(checking, FORCEPS, lag=LAG)
    grasper = get_robot("davinci_grasper")  # whose joint is called jaw too
    with pytest.raises(CalibrationError, match="of forceps is not for davinci_grasper; give one"):
        Compensator(Told(), grasper, lag=LAG)
    with pytest.raises(CommandRefused, match=r"a lag of -1\.0 s; give a rate above 0 and a lag"):
        loop_margin(250.0, -1.0)


def test_any_arm_is_tracked_and_joints_that_are_not_corrected_hold_still(lagging_arm):
    """A RAVEN-II whose insertion is 2 mm further out than its motor says."""
    robot = lagging_arm.robot
    compensator = quick(Insertion(0.002), robot, rate=500.0, lag=0.02, gain=0.5)
    place = robot.index(["insertion"])[0]
    start = robot.home[place]
    wanted = start + 0.01 * (1.0 - np.cos(np.arange(2000) * 2e-3 * np.pi)) / 2.0
    blocks = []
    lagging_arm.subscribe(blocks.append)
    goals = []
    compensator.drive(lagging_arm, wanted[:, None], lambda _t, goal, _: goals.append(goal[0]))
    assert np.array_equal(goals, wanted[1::2])
    states = [block for block in blocks if hasattr(block, "measured")]
    measured = np.concatenate([block.measured for block in states])
    column = robot.channels.index("insertion")
    error = measured[:, column] + 0.002 - wanted
    assert np.abs(error[300:]).max() < 2e-4
    others = np.delete(measured, column, axis=1)
    assert np.ptp(others, axis=0).max() == 0.0


def test_who_is_held_back_by_speed_is_not_at_the_end_of_the_range():
    compensator = quick(Told(0.0))
    compensator.start([0.0])
    for wanted in (0.0, 0.5):  # faster than the joint may go
        compensator.step(0.0, [0.0], [wanted])
    assert compensator.is_limited.any()
    assert not compensator.at_limit.any()
    compensator.setpoint[:] = compensator._upper
    assert compensator.at_limit.all()


def test_the_first_set_point_is_the_arms_and_the_rest_is_made_up_for_slowly():
    """An arm that stands 0.1 rad from where it is wanted is not thrown there."""
    compensator = Compensator(Told(-0.05), FORCEPS, rate=250.0, lag=LAG)
    compensator.start([0.35])
    measured, path = 0.35, []
    for k in range(1000):
        path.append(float(compensator.step(k / 250.0, [measured], [0.4 + 1e-9 * k])[0]))
        measured += 0.2 * (path[-1] - measured)
    assert path[0] == pytest.approx(0.35, abs=1e-9)
    assert np.abs(np.diff(path)).max() < 0.1 / (0.5 * 250.0) + 1e-6
    assert path[-1] == pytest.approx(0.45, abs=1e-4)


@pytest.mark.usefixtures("hasty")
def test_a_trajectory_is_followed_by_the_joint_itself_and_taken_up_after_a_pause(
    lagging_arm, monkeypatch
):
    """The insertion is 2 mm further out than its motor says, and its motor 20 ms behind."""
    robot = lagging_arm.robot
    start = robot.home[2]
    path = Trajectory(("insertion",), ("m",), start + np.array([[0.0], [0.006], [0.002]]))
    true, shares, paused, follower = [], [], [], threading.current_thread()

    def keep(block):
        if hasattr(block, "measured"):
            true.extend(block.measured[:, robot.channels.index("insertion")] + 0.002)
            if not paused and true[-1] > start + 0.004:
                paused.append(len(true))
                lagging_arm.pause()

    def resume(_):
        # Not other threads of this process that sleep.
        if len(paused) == 1 and threading.current_thread() is follower:
            paused.append(len(true))
            lagging_arm.resume()

    monkeypatch.setattr("time.sleep", resume)
    lagging_arm.subscribe(keep)
    follow(
        lagging_arm, path, steering=Compensator(Insertion(0.002), robot, lag=0.02),
        progress=shares.append, speed=[0.004], resume_within=60.0,
    )  # fmt: skip
    true, (_, again) = np.array(true), paused
    assert true[again:].argmax() > 0
    assert true[again:][: true[again:].argmax()].min() > start + 0.0038  # it does not go back
    cut = 0.004 * BLEND / 4  # of the corner
    assert true.max() == pytest.approx(start + 0.006 - cut, abs=1e-4)
    assert true[-1] == pytest.approx(start + 0.002, abs=2e-4)
    assert shares[-1] == pytest.approx(1.0)


@pytest.mark.usefixtures("hasty")
def test_where_no_set_point_takes_the_joint_the_arm_is_stopped_and_why_is_said(lagging_arm):
    wanted = lagging_arm.robot.home.copy()
    wanted[2] = 0.55
    with pytest.raises(CommandRefused, match=r"insertion is wanted at 5.* no set-point within"):
        Compensator(Insertion(-0.02), lagging_arm.robot).approach(lagging_arm, wanted)
    assert lagging_arm.operating_state().state == "PAUSED"


@pytest.mark.usefixtures("hasty")
def test_an_arm_whose_joints_are_not_known_is_not_taken_along(lagging_arm):
    told = Insertion(0.002, Status.HOMED_AGAIN)
    with pytest.raises(CommandRefused, match="not known where the joints are: HOMED_AGAIN"):
        Compensator(told, lagging_arm.robot).approach(lagging_arm, lagging_arm.robot.home)


def test_the_jaw_follows_and_the_motor_does_not():
    """Specimen B on three seconds of (28): the loop leaves a tenth of what open loop misses."""
    model = registered("play_gated").without_redundant()
    wanted = verification_trajectory().positions[:4000]
    errors = {}
    for loop in (False, True):
        arm = Arm(SimulatedBackend(ForcepsTwin(specimen("B"), seed=3)))
        arm.enable()
        arm.home()
        found = []
        arm.subscribe(lambda block, found=found: found.append(getattr(block, "position", None)))
        if loop:
            corrector = Corrector(model)
            corrector.set_homing(True)
            compensator = quick(corrector)
            stamps = []
            compensator.drive(arm, wanted, lambda t, *_, stamps=stamps: stamps.append(t))
            assert compensator.statuses == {Status.OK: 1000}
            assert stamps == pytest.approx(stamps[0] + np.arange(1000) / 250.0)
            with pytest.raises(CommandRefused, match="compensator refused: jaw is nan"):
                compensator.drive(arm, [[0.0], [np.nan]])
            needy = SimpleNamespace(joints=("jaw",), signals=("measured/jaw", "effort/jaw"))
            needy.made_for, needy.spike_speed = ("forceps", ""), np.ones(1)
            with pytest.raises(CommandRefused, match="does not report effort/jaw"):
                Compensator(needy, arm.robot, rate=250.0, lag=LAG).drive(arm, wanted)
            odd = Compensator(corrector, arm.robot, rate=300.0, lag=LAG)
            with pytest.raises(CommandRefused, match="must divide the 1000 set-points"):
                odd.drive(arm, wanted)
        else:
            arm.servo_jp_stream(wanted)
        truth = np.concatenate([block for block in found if block is not None])[:4000, 0]
        errors[loop] = np.sqrt(np.mean((truth - wanted[:, 0])[2200:] ** 2))
    assert errors[True] < 0.1 * errors[False]
    assert np.degrees(errors[True]) < 0.15


def test_motor_readings_go_forward_until_another_arm_is_read():
    readings = MotorReadings(FORCEPS)
    told = [readings.step(t, [0.1]) for t in (2.0, 2.0, 1.0, 1.5)]
    assert told == [Status.OK, *[Status.STALE] * 3]
    readings.release()
    assert readings.step(1.0, [0.1]) == Status.OK


@pytest.mark.parametrize("sample", ["ab", [0.1, 0.2, 0.3], None])
def test_no_sample_makes_a_step_raise(sample):
    unread = Compensator(Told(status=Status.WRONG_SIZE), FORCEPS, lag=LAG)
    unread.start([0.1])
    np.testing.assert_array_equal(unread.step(0.0, sample, [0.1]), [0.1])
    assert unread.status == Status.WRONG_SIZE


@pytest.mark.parametrize("wanted", [0.1, [0.1, 0.2], np.zeros((3, 2)), np.zeros((0, 1)), "up"])
def test_wanted_positions_are_a_row_of_the_correctors_joints_each(wanted):
    with pytest.raises(CommandRefused, match="compensator: "):
        quick(Told()).drive(None, wanted)
