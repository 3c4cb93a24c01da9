"""Set-points that put the joint itself where it is wanted, with the corrected position in the loop.

A motor that is sent where the joint should be leaves the joint behind by what the cables lose. The
compensator adds that loss, as the corrector tells it, and a share of what is still missing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from truejoint.array_types import Array, Integers
from truejoint.crtk.arm import Arm
from truejoint.crtk.protocol import SERVO_RATE
from truejoint.errors import CommandRefused
from truejoint.robots import Robot
from truejoint.robots.blocks import StateBlock, TruthBlock
from truejoint.robots.joint_rows import SETPOINT_DT, checked_rows
from truejoint.runtime.corrector import Corrector
from truejoint.runtime.status import Status

GAIN_MARGIN: Final = 2.0
"""By how much the loop's gain may grow at least before a joint that follows its motor swings."""
SPEED_SHARE: Final = 0.8
"""Of the speed from which the corrector sees a spike, the share that set-points keep to."""
SETTLING: Final = 0.1
"""Time constant with which set-points go on where a joint shall stand still [s]: friction and
backlash would make a loop swing there that is quick enough for reversals."""


class Compensator:
    """Inverts a calibration in the loop: wanted joint positions in, set-points of the motors out.

    ``setpoint = wanted + lag d(wanted)/dt - lost + gain (wanted - corrected)``, where `lost` is the
    corrected less the measured position, low-passed. While friction holds the joint, that makes it
    an integrator; it cannot wind up at a limit, because it follows what the motor did rather than
    what it was told. Where the corrector's status is not OK, `lost` is held, and nothing else is
    fed back. Where a joint is wanted to stand still, set-points go on slowly.

    Parameters
    ----------
    corrector : Corrector
        Its homing is told there. Its signals hold no set-point, which this one writes: make it of
        ``calibration.without_redundant()``.
    robot : Robot
        Whose limits of position and speed the set-points keep.
    rate : float
        Steps per second [Hz].
    lag : float
        Time by which the measured position follows a set-point that moves evenly [s].
    gain : float
        Share of the remaining error that is added to the set-point, 0 or more.
    time_constant : float
        Of the low-pass [s].
    dead_band : float
        Error [rad or m] that is let be where a joint is wanted to stand still: friction would make
        the loop hunt for the rest of it.
    believed : Status
        Bits with which a sample is corrected all the same, where the estimator is known to hold:
        ``Status.OUT_OF_DOMAIN | Status.IMPLAUSIBLE`` for one that knows loads that it never saw.

    Attributes
    ----------
    setpoint : ndarray, shape (n_joints,)
        For the corrector's joints [rad or m]; copy what you want to keep.
    gain : float
        May be changed between steps.
    lost : ndarray, shape (n_joints,)
        True less measured position, as it is made up for [rad or m].
    is_limited : ndarray of bool, shape (n_joints,)
        Whether a limit of position or speed held the set-point back at the last step.
    status : Status
        Of the last sample.

    Raises
    ------
    CommandRefused
        If the loop is too slow for its gain and the lag, a number is out of range, or the corrector
        checks a set-point.

    Examples
    --------
    >>> robot = truejoint.get_robot("forceps")
    >>> Compensator(Corrector(model), robot, rate=250.0, lag=0.02).setpoint
    array([0.])
    """

    def __init__(
        self,
        corrector: Corrector,
        robot: Robot,
        *,
        rate: float,
        lag: float,
        gain: float = 1.5,
        time_constant: float = 0.005,
        dead_band: float = 0.0,
        believed: Status = Status.OK,
    ) -> None:
        numbers = {"gain": gain, "time constant": time_constant, "lag": lag, "dead band": dead_band}
        for name, value in numbers.items():
            if not 0.0 <= value < math.inf:
                raise CommandRefused(f"compensator: {name} is {value}; give a number of 0 or more")
        check_rate(rate, lag, gain)
        if written := [name for name in corrector.signals if name.startswith("setpoint/")]:
            raise CommandRefused(
                f"compensator: the corrector checks {', '.join(written)}, which a compensator "
                "writes; make it of calibration.without_redundant()"
            )
        self.corrector: Final = corrector
        self.rate: Final = float(rate)
        joints = robot.index(corrector.joints)
        self._lower, self._upper = robot.lower[joints], robot.upper[joints]
        top = np.array([robot.joints[i].max_speed for i in joints])
        self._step = np.minimum(top, SPEED_SHARE * corrector.spike_speed) / self.rate
        self._lead, self.gain = lag * self.rate, gain
        self._share = 1.0 / (1.0 + time_constant * self.rate)
        self._measured = [corrector.signals.index(f"measured/{name}") for name in corrector.joints]
        self.setpoint, self.lost, self._wanted = np.zeros((3, len(joints)))
        self.is_limited, self._rests = np.zeros((2, len(joints)), dtype=bool)
        self._dead_band, self._settle = dead_band, 1.0 / (1.0 + SETTLING * self.rate)
        self._doubted = ~int(believed)
        self.status = Status.OK

    def start(self, setpoint: ArrayLike) -> None:
        """Begin at rest from set-points (n_joints,) [rad or m] that the arm already has."""
        self.setpoint[:] = self._wanted[:] = setpoint
        self.lost[:] = 0.0

    def step(self, t: float, sample: ArrayLike, wanted: ArrayLike) -> Array:
        """Set-points (n_joints,) for where the joints are `wanted` (n_joints,) at the next step.

        The `sample` (n_signals,) of the corrector was taken at `t` [s]; where a wanted position is
        not finite, the one before goes on. Raises nothing; see `status` and `is_limited`.
        """
        goal = np.asarray(wanted, dtype=np.float64)
        goal = np.where(np.isfinite(goal), goal, self._wanted)
        self.status = self.corrector.step(t, sample)
        ahead = goal + self._lead * (goal - self._wanted)
        stands = goal == self._wanted
        self._rests &= stands
        correction = self.corrector.correction + self.corrector.offset
        if self.status & self._doubted == 0 and np.isfinite(correction).all():
            measured = np.asarray(sample, dtype=np.float64)[self._measured]
            self.lost += self._share * (correction - self.lost)
            missing = self._wanted - measured - correction
            ahead += self.gain * missing
            self._rests = stands & (np.abs(missing) < self._dead_band)
        asked = ahead - self.lost
        slowly = self.setpoint + self._settle * (asked - self.setpoint)
        asked = np.where(stands, np.where(self._rests, self.setpoint, slowly), asked)
        kept = np.clip(asked, self.setpoint - self._step, self.setpoint + self._step)
        np.clip(kept, self._lower, self._upper, out=self.setpoint)
        np.not_equal(self.setpoint, asked, out=self.is_limited)
        self._wanted[:] = goal
        return self.setpoint


def loop_margin(rate: float, lag: float, gain: float = 1.0) -> float:
    """Factor by which the gain of a `Compensator` may grow until a joint that moves freely swings.

    The motor counts as two equal lags of `lag` / 2 [s], and sampling at `rate` [Hz] as a delay of
    one and a half periods: the loop's phase reaches -180 degrees where
    ``2 atan(w lag / 2) + 1.5 w / rate = pi``.

    Examples
    --------
    >>> round(loop_margin(rate=250.0, lag=0.019, gain=1.5), 1)
    2.6
    """
    low, high = 0.0, 2.0 * math.pi * rate
    for _ in range(60):  # the phase falls with the frequency, so halving finds it
        middle = 0.5 * (low + high)
        phase = 2.0 * math.atan(0.5 * middle * lag) + 1.5 * middle / rate
        low, high = (middle, high) if phase < math.pi else (low, middle)
    return math.inf if gain == 0.0 else (1.0 + (0.5 * low * lag) ** 2) / gain


def check_rate(rate: float, lag: float, gain: float) -> None:
    """Raise CommandRefused where `rate` [Hz] is too slow for a loop's `gain` and a `lag` [s]."""
    if not 0.0 < rate <= SERVO_RATE:
        raise CommandRefused(f"compensator: {rate} Hz; give a rate from 0 to {SERVO_RATE:g} Hz")
    margin = loop_margin(rate, lag, gain)
    if margin < GAIN_MARGIN:
        raise CommandRefused(
            f"compensator: {rate:g} Hz is too slow for a gain of {gain:g} on a plant that lags by "
            f"{1e3 * lag:.0f} ms: it would swing at {margin:.1f} times the gain, not at "
            f"{GAIN_MARGIN:g} times; run it faster, or lower the gain to "
            f"{gain * margin / GAIN_MARGIN:.2f}"
        )


@dataclass(frozen=True, eq=False)
class TrackedMotion:
    """What `track` did, a row for each step of the compensator.

    Attributes
    ----------
    t : ndarray, shape (n,)
        Stamps of the samples [s].
    wanted, setpoint, corrected : ndarray, shape (n, n_joints)
        Where the joints were wanted, set-points sent, and `Corrector.position` [rad or m].
    status : ndarray, shape (n,)
        Bits of `Status`.

    Examples
    --------
    >>> TrackedMotion(np.zeros(1), *np.zeros((3, 1, 1)), np.zeros(1, int)).status
    array([0])
    """

    t: Array
    wanted: Array
    setpoint: Array
    corrected: Array
    status: Integers


def track(arm: Arm, compensator: Compensator, wanted: ArrayLike) -> TrackedMotion:
    """Put an arm's joints where they are wanted, row by row through a compensator; blocks.

    Between two steps set-points are interpolated; joints that the calibration does not correct hold
    still. What the arm measures reaches its subscribers, for instance a `Recorder`, meanwhile.

    Parameters
    ----------
    arm : Arm
        Enabled and homed, and the compensator's corrector told so.
    compensator : Compensator
    wanted : array_like, shape (n, n_joints)
        True positions of the corrector's joints at 1 kHz [rad or m].

    Raises
    ------
    CommandRefused
        If the arm is not ready or does not report a signal, a row is not finite, or the
        compensator's rate does not divide 1 kHz.

    Examples
    --------
    >>> arm = truejoint.crtk.simulated_arm("forceps", seed=1)
    >>> arm.enable()
    >>> arm.home()
    >>> compensator = Compensator(Corrector(model), arm.robot, rate=250.0, lag=0.02)
    >>> track(arm, compensator, np.zeros((8, 1))).t.shape  # doctest: +SKIP
    (2,)
    """
    joints = arm.robot.index(compensator.corrector.joints)
    pose = arm.setpoint_js().position.copy()
    rows = np.atleast_2d(np.asarray(wanted, dtype=np.float64))
    full = np.tile(pose, (len(rows), 1))
    full[:, joints] = rows
    checked_rows(arm.robot, full, "track")
    period = SERVO_RATE / compensator.rate
    if abs(period - round(period)) > 1e-9:
        raise CommandRefused(
            f"track: a loop at {compensator.rate:g} Hz; its rate must divide {SERVO_RATE:g} Hz"
        )
    latest: list[StateBlock] = []

    def keep(block: StateBlock | TruthBlock) -> None:
        if isinstance(block, StateBlock):
            latest[:] = [block]

    per_step, signals = round(period), compensator.corrector.signals
    compensator.start(pose[joints])
    arm.subscribe(keep)
    try:
        arm.wait(SETPOINT_DT)
        told = []
        if missing := [name for name in signals if name not in latest[0].columns()]:
            raise CommandRefused(f"track: {arm.robot.title} does not report {', '.join(missing)}")
        for goal in rows[per_step - 1 :: per_step]:
            before = compensator.setpoint.copy()
            columns, t = latest[0].columns(), float(latest[0].t[-1])
            after = compensator.step(t, [columns[name][-1] for name in signals], goal)
            corrected = compensator.corrector.position.copy()
            told.append((t, goal, after.copy(), corrected, int(compensator.status)))
            between = np.tile(pose, (per_step, 1))
            between[:, joints] = np.linspace(before, after, per_step + 1)[1:]
            arm.servo_jp_stream(between)
    finally:
        arm.unsubscribe(keep)
    return TrackedMotion(*(np.array(part) for part in zip(*told, strict=True)))
