"""Set-points that put the joint itself where it is wanted, with the corrected position in the loop.

A motor that is sent where the joint should be leaves the joint behind by what the cables lose. The
compensator adds that loss, as the corrector tells it, and what is still missing after that.
"""

import logging
import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from numbers import Real
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from truejoint.array_types import Array, Integers, Mask, floats
from truejoint.calibration.compatibility import check_robot
from truejoint.crtk.arm import Arm
from truejoint.crtk.limits import move_speed
from truejoint.crtk.planning import time_law
from truejoint.errors import CommandRefused, other_kind
from truejoint.robots import Robot
from truejoint.robots.blocks import checked_rows
from truejoint.robots.robot import as_robot
from truejoint.runtime import compensation as at
from truejoint.runtime.compensation import begin, compensate
from truejoint.runtime.corrector import Corrector
from truejoint.runtime.status import Status
from truejoint.units import shown, shown_range

LAG: Final = 0.05
"""Time by which the simulated RAVEN-II's measured position follows even set-points [s]."""
GAIN_MARGIN: Final = 2.0
"""By how much the loop's gain may grow at least before a joint that follows its motor swings."""
QUICK_SHARE: Final = 0.5
"""Of a lag divided by the time constant, the gain that a loop around a corrector may have at most:
around the twin of peng2024 all steps were OK at half of it, and 68 to 96 % at the whole of it."""
SPEED_SHARE: Final = 0.8
"""Of the speed from which the corrector sees a spike, the share that set-points keep to."""
SETTLING: Final = 0.1
"""Time constant with which set-points go on where a joint shall stand still [s]: friction and
backlash would make a loop swing there that is quick enough for reversals."""
_LOOK: Final = 0.1  # [s] for which an arm is looked at before its joints are moved
_PATIENCE: Final = 0.2  # [s] for which a set-point may stand at the end of a joint's range
_LASTING: Final = 2.0  # [s] of fall-back, less half of the time between, that end a motion
_UNREAD: Final = Status.WRONG_SIZE | Status.OTHER_THREAD  # of a sample that may be anything
_INTEGRAL_TIMES: Final = 4.0  # after which a joint has come to where it is wanted
_log = logging.getLogger(__name__)
_Listener = Callable[[float, Array, Array], None]


class MotorReadings:
    """Gives a compensator the measured positions as they are."""

    def __init__(self, robot: Robot) -> None:
        self.made_for: Final = robot.name, robot.arm
        self.joints: Final = robot.joint_names
        self.signals: Final = tuple(f"measured/{name}" for name in self.joints)
        self.spike_speed: Final = np.full(len(self.joints), math.inf)
        self.position, self.correction, self.offset = np.zeros((3, len(self.joints)))
        self._t = -math.inf

    def step(self, t: float, sample: ArrayLike) -> Status:
        """Take the `sample` (n_joints,) of `t` [s] as it is, unless it is old or not finite."""
        try:
            values, stamp = np.asarray(sample, dtype=np.float64), float(t)
        except (TypeError, ValueError):
            return Status.WRONG_SIZE
        if values.shape != self.position.shape:
            return Status.WRONG_SIZE
        if not (math.isfinite(stamp) and np.isfinite(values).all()):
            return Status.NOT_FINITE
        self.position[:] = values
        is_stale = stamp <= self._t
        self._t = max(self._t, stamp)
        return Status.STALE if is_stale else Status.OK

    def release(self) -> None:
        """Forget the last stamp: another arm's clock may be earlier."""
        self._t = -math.inf


class Compensator:
    """Inverts a calibration in the loop: wanted joint positions in, set-points of the motors out.

    ``setpoint = wanted + lag d(wanted)/dt - lost + gain e + (integral of e) / integral_time``,
    where ``e = wanted - corrected`` and `lost` is the corrected less the measured position,
    low-passed. Neither can wind up at a limit: `lost` follows what the motor did rather than what
    it was told, and the integral waits where a limit holds the set-point back. If the corrector's
    status is not OK both are held, and nothing is fed back; before it first was, the set-points go
    as far as what is wanted goes. If a joint is to stand still, they continue slowly.

    If fewer than half of the steps were OK, by a low-pass of one second, the loop falls back:
    nothing is fed back, `lost` stays as it was last learnt, and the integral fades within seconds.
    Signals that stand still with a joint that shall do so do not count. Once three quarters are OK
    it feeds back again.

    By default the loop is slow, and makes up for what changes slowly: errors of cables, and what
    friction and load keep a motor from its set-point. An estimator that knows the joint within
    milliseconds may have a quick one, of a `gain` and a short `time_constant`.

    Parameters
    ----------
    corrector : Corrector, optional
        None for a loop around the motors, which keeps what they report to where they shall be: it
        makes up for friction and the robot's own controller, and knows nothing of cables. Tell the
        corrector the homing. Its signals hold no set-point, which this one writes: make it of
        ``calibration.without_redundant()``.
    robot : Robot
        Robot whose limits of position and speed the set-points keep.
    rate : float
        Steps per second [Hz].
    lag : float
        Time by which the measured position follows a set-point that moves evenly [s]; by default
        that of a RAVEN-II.
    gain : float
        Share of the remaining error that is added to the set-point: 0 or more, and at most half of
        `lag` / `time_constant` around a corrector, or it moves so fast that it sees spikes.
    time_constant : float
        Time constant of the low-pass [s].
    integral_time : float
        In which a remaining error is made up for [s]; infinite for none. With it, the first
        set-point is that which the arm has.
    dead_band : float
        Error [rad or m] that is let be where a joint is wanted to stand still: friction would make
        the loop hunt for the rest of it.
    believed : Status
        Bits with which a sample is corrected nevertheless, where the estimator is known to hold:
        ``Status.OUT_OF_DOMAIN | Status.IMPLAUSIBLE`` for one that knows loads that it never saw.

    Attributes
    ----------
    setpoint : ndarray, shape (n_joints,)
        For the corrector's joints [rad or m]; copy what you want to keep.
    lost : ndarray, shape (n_joints,)
        True less measured position, as it is made up for [rad or m].
    measured : list of int
        Places of the joints' measured positions in a sample.
    is_limited : ndarray of int, shape (n_joints,)
        1 where a limit of position or speed held the set-point back at the last step.
    status : Status
        Status of the last sample.
    statuses : Counter of Status
        How many steps had each status.

    Raises
    ------
    CommandRefused
        If the loop is too slow for its gain and the lag, a number is out of range, or the corrector
        checks a set-point.
    CalibrationError
        If the corrector's model is of another arm than `robot`.

    Examples
    --------
    >>> robot = truejoint.get_robot("davinci_grasper")
    >>> Compensator(Corrector(model), robot, rate=250.0, lag=0.02).setpoint
    array([0.])
    """

    def __init__(
        self,
        corrector: Corrector | None,
        robot: Robot,
        *,
        rate: float = 250.0,
        lag: float = LAG,
        gain: float = 0.0,
        time_constant: float = 0.5,
        integral_time: float = 0.5,
        dead_band: float = 0.0,
        believed: Status = Status.OK,
    ) -> None:
        inner = MotorReadings(as_robot(robot)) if corrector is None else corrector
        numbers = {"gain": gain, "time constant": time_constant, "lag": lag, "dead band": dead_band}
        _check(inner, robot, numbers, integral_time)
        check_rate(rate, lag, gain)
        if np.isfinite(inner.spike_speed).any() and gain * time_constant > QUICK_SHARE * lag:
            raise CommandRefused(
                f"compensator: a gain of {gain:g} with a time constant of {time_constant:g} s "
                f"makes motors that lag by {1e3 * lag:.0f} ms faster than the corrector believes; "
                f"lower the gain to {QUICK_SHARE * lag / time_constant:.2g}, or the time constant "
                f"to {1e3 * QUICK_SHARE * lag / gain:.2g} ms"
            )
        self.corrector: Final[Corrector | MotorReadings] = inner
        self.rate: Final = float(rate)
        self._integral_time = integral_time
        self._how: dict[str, Any] = {
            "rate": rate, "lag": lag, "gain": gain, "time_constant": time_constant,
            "integral_time": integral_time, "dead_band": dead_band, "believed": believed,
        }  # fmt: skip
        self._robot = robot
        joints = robot.index(inner.joints)
        top = np.array([robot.joints[i].max_speed for i in joints])
        self.memory: Final = at.LAYOUT.pack(
            doubted=~int(believed), still=int(Status.FROZEN), lead=lag * rate, gain=gain,
            forget=1.0 / (1.0 + rate),
            share=1.0 / (1.0 + time_constant * rate), integral=1.0 / (integral_time * rate),
            settle=1.0 / (1.0 + SETTLING * rate), dead_band=dead_band,
            lower=robot.lower[joints], upper=robot.upper[joints],
            step=np.minimum(top, SPEED_SHARE * inner.spike_speed) / rate,
        )  # fmt: skip
        view = self.memory.view
        self.setpoint: Array = view("setpoint")
        self.lost: Array = view("lost")
        self.is_limited: Integers = view("is_limited")
        self._lower, self._upper = view("lower"), view("upper")
        self._wanted, self._measured = view("wanted"), view("measured")
        self._correction = view("correction")
        self.joints: Final = inner.joints
        self.measured: Final = [inner.signals.index(f"measured/{n}") for n in inner.joints]
        self.status = Status.OK
        self.statuses: Counter[Status] = Counter()
        self.start(0.0)

    @property
    def at_limit(self) -> Mask:
        """Whether each set-point (n_joints,) is held back by the range of its joint."""
        at_end = (self.setpoint <= self._lower) | (self.setpoint >= self._upper)
        return np.asarray(at_end & (self.is_limited != 0))

    def around(self, corrector: Corrector | MotorReadings) -> "Compensator":
        """Give the same loop, before its start, around another corrector of the same joints."""
        inner = None if isinstance(corrector, MotorReadings) else corrector
        return Compensator(inner, self._robot, **self._how)

    @property
    def gain(self) -> float:
        """Share of the remaining error that is added; may be changed between steps."""
        return float(self.memory.memory[at.GAIN])

    @gain.setter
    def gain(self, share: float) -> None:
        self.memory.memory[at.GAIN] = share

    @property
    def knows_lost(self) -> bool:
        """Whether the corrector was believed since the start."""
        return bool(self.memory.numbers[at.KNOWS_LOST])

    @property
    def falls_back(self) -> bool:
        """Whether nothing is fed back, as too few of the last second's steps were OK."""
        return bool(self.memory.numbers[at.FALLS_BACK])

    @property
    def trouble(self) -> str:
        """Why it falls back, and by which status most, for a person; empty where it does not."""
        if not self.falls_back:
            return ""
        doubted = ~int(self._how["believed"])
        seen = [status for status in self.statuses if status & doubted] or [self.status]
        most = max(seen, key=self.statuses.__getitem__)
        return (
            "fewer than half of its steps were OK for a second, and most of the others "
            f"{most.name} ({most.words}), so it feeds nothing back"
        )

    def start(self, setpoint: ArrayLike) -> None:
        """Begin at rest from set-points (n_joints,) [rad or m] that the arm already has."""
        self.setpoint[:] = setpoint
        begin(self.memory.numbers, self.memory.memory)

    def step(self, t: float, sample: ArrayLike, wanted: ArrayLike) -> Array:
        """Set-points (n_joints,) for where the joints are `wanted` (n_joints,) at the next step.

        The `sample` (n_signals,) of the corrector was taken at `t` [s]; where a wanted position is
        not finite, the one before goes on. No sample makes it raise; see `status` and `is_limited`.
        """
        self.status = self.corrector.step(t, sample)
        self.memory.numbers[at.STATUS] = self.status
        self._wanted[:] = wanted
        if not self.status & _UNREAD:
            self._measured[:] = np.asarray(sample, dtype=np.float64)[self.measured]
        np.add(self.corrector.correction, self.corrector.offset, out=self._correction)
        compensate(self.memory.numbers, self.memory.memory)
        self.statuses[self.status] += 1
        return self.setpoint

    def approach(self, arm: Arm, wanted: ArrayLike) -> None:
        """Take an arm to a pose `wanted` (n,) of all its joints [rad or m], through the loop.

        Raises CommandRefused as `setpoints`, and if the corrector's status was not OK on the way.
        """
        goal, joints = np.asarray(wanted, dtype=np.float64), arm.robot.index(self.corrector.joints)
        now = arm.setpoint_js(math.inf).position.copy()
        for _ in range(round(_LOOK * self.rate)):
            arm.wait(1.0 / self.rate)
            self.corrector.step(*self._newest(arm))
        now[joints] = self.corrector.position
        law = time_law([now, goal], move_speed(arm.robot, None, "approach"))
        settled = 0.0 if math.isinf(self._integral_time) else _INTEGRAL_TIMES * self._integral_time
        rest = np.tile(goal, (round(settled * arm.rate), 1))
        pieces = self.setpoints(arm, [*law.blocks(arm.rate), rest])
        arm.stream(pieces, law.duration + settled, "approach").wait()
        if not self.knows_lost:
            raise self._untrusted()

    def drive(self, arm: Arm, wanted: ArrayLike, tell: _Listener | None = None) -> None:
        """Put an arm's joints where they are `wanted`, row by row; blocks.

        The rows (n, n_joints) are true positions of the corrector's joints at `Arm.rate` [rad or
        m]; others hold still. For a trajectory, `truejoint.motion.follow` makes the way to the
        first row too. Raises CommandRefused as `setpoints`, or if a row is not finite or of other
        joints.
        """
        rows, joints = floats(wanted, "compensator", CommandRefused), self.corrector.joints
        if rows.ndim != 2 or rows.shape[1] != len(joints) or not len(rows):
            raise CommandRefused(
                f"compensator: wanted positions of shape {rows.shape}; give a row or more of "
                f"{', '.join(joints)}"
            )
        full = np.tile(arm.setpoint_js(math.inf).position, (len(rows), 1))
        full[:, arm.robot.index(joints)] = rows
        checked_rows(arm.robot, full, "compensator")
        pieces = self.setpoints(arm, [full], tell)
        arm.stream(pieces, len(rows) / arm.rate, "compensator").wait()

    def setpoints(
        self, arm: Arm, pieces: Iterable[Array], tell: _Listener | None = None
    ) -> Iterator[Array]:
        """Turn wanted positions of all joints into set-points, a piece a step, for `Arm.stream`.

        Each is worked out of what the arm tells when the one before has been sent, and between two
        steps set-points are interpolated. Joints that are not corrected get what is wanted.

        The `arm` is enabled and homed, and the corrector told so; the `pieces` (n, n_joints) are
        wanted positions at `Arm.rate` [rad or m]. `tell` is called after each step with the
        sample's stamp [s], where the corrected joints are wanted at the next step, and where they
        are (n_corrected,) [rad or m]: to be copied.

        Raises CommandRefused if the rate does not divide the arm's, or the arm does not report a
        signal; on the way, if a set-point stands at the end of its joint's range for 0.2 s; or if
        the loop falls back for more than half of 2 s, which is logged once.
        """
        period = arm.rate / self.rate
        if round(period) < 1 or abs(period - round(period)) > 1e-9 * period:
            raise CommandRefused(
                f"compensator: a loop at {self.rate:g} Hz; its rate must divide the {arm.rate:g} "
                f"set-points a second that {arm.robot.title} takes"
            )
        self._newest(arm)
        return self._stepped(arm, pieces, round(period), tell)

    def _newest(self, arm: Arm) -> tuple[float, list[float]]:
        """Stamp [s] and signals of the newest message; raises CommandRefused if it lacks one."""
        block, signals = arm.newest_state("compensator", math.inf), self.corrector.signals
        columns = block.columns()
        if missing := [name for name in signals if name not in columns]:
            raise CommandRefused(
                f"compensator: {arm.robot.title} does not report {', '.join(missing)}"
            )
        return float(block.t[-1]), [float(columns[name][-1]) for name in signals]

    def _stepped(
        self, arm: Arm, pieces: Iterable[Array], period: int, tell: _Listener | None
    ) -> Iterator[Array]:
        joints = arm.robot.index(self.corrector.joints)
        self.start(arm.setpoint_js(math.inf).position[joints])
        self.corrector.release()  # to the thread that moves the arm
        share = np.arange(1, period + 1)[:, None] / period
        held = np.zeros(len(joints))  # for so many steps
        lasts, is_told = 0.0, False
        for piece in pieces:
            for first in range(0, len(piece), period):
                rows = piece[first : first + period].copy()
                before, (t, sample) = self.setpoint.copy(), self._newest(arm)
                after = self.step(t, sample, rows[-1, joints])
                if self.falls_back and not is_told:
                    _log.warning("compensator: %s", self.trouble)
                    is_told = True
                lasts = lasts + 1.0 if self.falls_back else max(lasts - 0.5, 0.0)
                if lasts > _LASTING * self.rate:
                    raise self._untrusted()
                held = np.where(self.at_limit, held + 1, 0)
                if held.max() > _PATIENCE * self.rate:
                    raise self._unreachable(int(np.argmax(held)))
                if tell is not None:
                    tell(t, rows[-1, joints], self.corrector.position)
                rows[:, joints] = before + share[: len(rows)] * (after - before)
                if len(rows) == period:
                    rows[-1, joints] = after
                else:  # the end of a piece is no faster than the rest
                    after[:] = rows[-1, joints]
                yield rows

    def _untrusted(self) -> CommandRefused:
        why, advice = self.trouble, "lower its gain, lengthen its integral time"
        if not self.knows_lost:
            why = f"it is not known where the joints are: {self.status.name}"
            advice = "home the arm, re-zero the model after the homing"
        return CommandRefused(f"compensator: {why}; {advice}, and stay where it was trained")

    def _unreachable(self, k: int) -> CommandRefused:
        """Error that no set-point takes the joint `k` of the corrector's where it is wanted."""
        joint = self._robot.joint(self.corrector.joints[k])
        return CommandRefused(
            f"compensator: {joint.name} is wanted at {shown(self._wanted[k], joint.unit)}, which "
            f"no set-point within {shown_range(joint.lower, joint.upper, joint.unit)} reaches: "
            f"{shown(self.lost[k], joint.unit)} are lost on the way; stay further inside"
        )


def motor_loop(robot: Robot, rate: float = 100.0, lag: float = LAG) -> Compensator:
    """Loop for `truejoint.motion.follow` that keeps what an arm reports to a trajectory.

    A `Compensator` without a corrector. `rate` [Hz] must divide the arm's.

    Examples
    --------
    >>> path = truejoint.motion.Trajectory(("elbow",), ("rad",), np.array([[1.5], [1.52]]))
    >>> report = truejoint.motion.follow(arm, path, steering=motor_loop(arm.robot))
    >>> bool(report.rms[0] < 1e-3)
    True
    """
    return Compensator(None, robot, rate=rate, lag=lag)


def _check(
    corrector: Corrector | MotorReadings,
    robot: Robot,
    numbers: Mapping[str, float],
    integral_time: float,
) -> None:
    """Refuse a corrector and a robot that make no loop, and numbers that are none, or negative."""
    if not hasattr(corrector, "made_for"):
        advice = "give Corrector(model)"
        raise CommandRefused(f"compensator: {other_kind(corrector, 'Corrector', advice)}")
    check_robot(corrector.made_for, robot)
    if written := [name for name in corrector.signals if name.startswith("setpoint/")]:
        raise CommandRefused(
            f"compensator: the corrector checks {', '.join(written)}, which a compensator "
            "writes; make it of calibration.without_redundant()"
        )
    for name, value in numbers.items():
        if not (isinstance(value, Real) and 0.0 <= value < math.inf):
            raise CommandRefused(
                f"compensator: {name} is {value!r:.40}; give a number of 0 or more"
            )
    if not (isinstance(integral_time, Real) and integral_time > 0.0):
        raise CommandRefused(
            f"compensator: integral time is {integral_time!r:.40} s; give more than 0 s, or "
            "infinity"
        )


def loop_margin(rate: float, lag: float, gain: float = 1.0) -> float:
    """Factor by which the gain of a `Compensator` may grow until a joint that moves freely swings.

    The motor counts as two equal lags of `lag` / 2 [s], and sampling at `rate` [Hz] as a delay of
    one and a half periods: the loop's phase reaches -180 degrees where
    ``2 atan(w lag / 2) + 1.5 w / rate = pi``. Raises CommandRefused where there is no such loop.

    Examples
    --------
    >>> round(loop_margin(rate=250.0, lag=0.019, gain=1.5), 1)
    2.6
    """
    are_numbers = isinstance(rate, Real) and isinstance(lag, Real)
    if not (are_numbers and 0.0 < rate < math.inf and 0.0 <= lag < math.inf):
        raise CommandRefused(
            f"compensator: {rate!r:.40} Hz, a lag of {lag!r:.40} s; give a rate above 0 and a lag "
            "of 0 or more"
        )
    low, high = 0.0, 2.0 * math.pi * rate
    for _ in range(60):  # the phase falls with the frequency, so halving finds it
        middle = 0.5 * (low + high)
        phase = 2.0 * math.atan(0.5 * middle * lag) + 1.5 * middle / rate
        low, high = (middle, high) if phase < math.pi else (low, middle)
    return math.inf if gain == 0.0 else (1.0 + (0.5 * low * lag) ** 2) / gain


def check_rate(rate: float, lag: float, gain: float) -> None:
    """Raise CommandRefused where `rate` [Hz] is too slow for a loop's `gain` and a `lag` [s]."""
    margin = loop_margin(rate, lag, gain)
    if margin < GAIN_MARGIN:
        raise CommandRefused(
            f"compensator: {rate:g} Hz is too slow for a gain of {gain:g} on a plant that lags by "
            f"{1e3 * lag:.0f} ms: it would swing at {margin:.1f} times the gain, not at "
            f"{GAIN_MARGIN:g} times; run it faster, or lower the gain to "
            f"{gain * margin / GAIN_MARGIN:.2f}"
        )
