"""Following a trajectory with an arm, and how well the arm did."""

import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import ArrayLike

from truejoint.array_types import Array
from truejoint.crtk import BLOCK_DURATION, Arm, StateBlock, TruthBlock
from truejoint.crtk.arm import as_arm
from truejoint.crtk.planning import BLEND, TimeLaw, time_law
from truejoint.crtk.states import check_ready
from truejoint.errors import CommandRefused, MotionStopped, NotArrived, TrajectoryError
from truejoint.motion.trajectory import Trajectory, as_trajectory, workspace_of
from truejoint.robots import Robot
from truejoint.robots.robot import as_robot
from truejoint.units import display_unit, shown

if TYPE_CHECKING:  # it stands above, and drives an arm through its loop
    from truejoint.runtime import Compensator

_POLL: Final = 0.02  # [s] between two looks at the state of a paused arm
_SPEED_WINDOW: Final = 0.1  # [s] that a measured speed is the mean over, to hide encoder counts


@dataclass(frozen=True, eq=False)
class TrackingReport:
    """How closely an arm kept to a trajectory, as measured at the motors.

    Attributes
    ----------
    name : str
        Title of the trajectory.
    joints, units : tuple of str
        The joints that the trajectory moved, and ``"rad"`` or ``"m"`` for each.
    rms, max : ndarray, shape (n_joints,)
        Error of set-point minus measured position [rad or m]; `max` is of the absolute value. Error
        of joints that were steered: of wanted minus corrected position at the steps of the loop
        that know it. Pauses do not count.
    max_speed : ndarray, shape (n_joints,)
        Highest speed as measured, mean over 0.1 s [rad/s or m/s].
    duration : float
        Time from rest to rest, without the way to the start [s].

    Examples
    --------
    >>> follow(arm, zigzag(arm.robot, "J2", 1 / 2)).units
    ('rad', 'rad', 'm')
    """

    name: str
    joints: tuple[str, ...]
    units: tuple[str, ...]
    rms: Array
    max: Array
    max_speed: Array
    duration: float

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON, SI units."""
        return {name: np.asarray(value).tolist() for name, value in vars(self).items()}

    def __str__(self) -> str:
        parts = []
        for k, joint in enumerate(self.joints):
            unit = display_unit(self.units[k])
            rms, most, speed = np.array([self.rms[k], self.max[k], self.max_speed[k]]) * unit.scale
            up_to = f"{most:.3f} max, up to {speed:.2f} {unit.name}/s"
            parts.append(f"{joint} {rms:.3f} {unit.name} RMS ({up_to})")
        return f"{self.name}, {self.duration / 60:.1f} min, tracking error: {'; '.join(parts)}"


def follow(
    arm: Arm,
    trajectory: Trajectory,
    *,
    speed: ArrayLike | None = None,
    resume_within: float = 0.0,
    progress: Callable[[float], None] | None = None,
    steering: "Compensator | None" = None,
) -> TrackingReport:
    """Move an arm to the start of a trajectory and along it; blocks until it is at rest again.

    A path is followed at the speed caps, so that on every line one joint moves at its cap; a
    trajectory with times keeps to them. Either way corners are rounded
    (`truejoint.crtk.TimeLaw`): acceleration stays below eight times the cap per second. Joints
    that the trajectory does not name hold still. Set-points are made in blocks of 10 s, whatever
    the duration.

    `Arm.pause`, from another thread, stops the arm within 20 ms and the time that it needs to
    brake. After a `resume` it goes back to where it left the trajectory, and on from there.

    Parameters
    ----------
    arm : Arm
        Enabled and homed.
    trajectory : Trajectory
    speed : array_like, shape (n_joints,), optional
        Speed caps along a path [rad/s or m/s]; by default those of `workspace_of(arm.robot)`.
        A trajectory with times needs none.
    resume_within : float
        How long a pause may last [s, this computer's clock]; by default a pause ends the run.
    progress : callable, optional
        Called with the share done, from 0 to 1; in the thread that moves the arm.
    steering : Compensator, optional
        Takes the joints themselves along the trajectory, or `truejoint.runtime.motor_loop` what
        the motors report; without it the trajectory is their set-point.

    Raises
    ------
    TrajectoryError
        Before any motion, if the trajectory leaves the arm's limits or speeds are out of range.
    CommandRefused
        If the arm is not ready, or stops being so on the way (MotionStopped).

    Examples
    --------
    >>> follow(arm, zigzag(arm.robot, "J2", 1 / 2)).joints
    ('shoulder', 'elbow', 'insertion')
    """
    check_ready(as_arm(arm).operating_state(), "follow")
    as_trajectory(trajectory).check_within(arm.robot)
    run = _Run(arm, trajectory, speed, progress, steering)
    run.approach(0.0)
    while not run.is_over:
        try:
            run.go_on()
        except MotionStopped:
            end = time.monotonic() + resume_within
            while (state := arm.operating_state().state) == "PAUSED" and time.monotonic() < end:
                time.sleep(_POLL)
            if state != "ENABLED":
                raise
    return run.report()


@dataclass(eq=False)
class _Run:
    """One passage of an arm along a time law, however often it is stopped on the way.

    Sums are over the blocks of the run, each (n_joints,); no more is kept than it looks back for.
    """

    arm: Arm
    trajectory: Trajectory
    speed: ArrayLike | None
    progress: Callable[[float], None] | None
    steering: "Compensator | None"
    is_over: bool = False

    def __post_init__(self) -> None:
        robot, joints = self.arm.robot, self.trajectory.joints
        self._law = _time_law(robot, self.trajectory, self.speed)
        self._columns = robot.index(joints)
        self._pose = self.arm.setpoint_js(np.inf).position.copy()  # however long it has stood
        self._pose[self._columns] = self.trajectory.positions[0]
        self._at = 0.0  # of the law [s]
        self._channels = [robot.channels.index(name) for name in joints]
        steered = () if self.steering is None else self.steering.joints
        self._steered = [k for k, name in enumerate(joints) if name in steered]
        self._followed = [k for k in range(len(joints)) if k not in self._steered]
        self._among = [steered.index(joints[k]) for k in self._steered]
        self._counts, self._squares, self._max, self._max_speed = np.zeros((4, len(joints)))
        self._t, self._measured = np.empty(0), np.empty((0, len(joints)))

    def approach(self, t: float) -> None:
        """Go to where the trajectory is taken up, at a time of the law [s]."""
        pose = self._rows(np.array([t]))[0] if t > 0.0 else self._pose
        if self.steering is None:
            with suppress(NotArrived):  # where it is at the end is in the report
                self.arm.move_jp(pose).wait()
        else:
            self.steering.approach(self.arm, pose)

    def go_on(self) -> None:
        """Move from where the arm was stopped to the end; raises MotionStopped if stopped again."""
        arm, start = self.arm, self._at
        if start > 0.0:
            self.approach(start)
        lost = BLEND / 2 if start > 0.0 else 0.0  # while the speed builds up again
        duration = self._law.duration - start + lost
        pieces = self._pieces(start, duration)
        if self.steering is not None:
            pieces = self.steering.setpoints(arm, pieces, self._leg())
        arm.subscribe(self._look, every=arm.stretch)  # not while it stands, which may be for long
        try:
            motion = arm.stream(pieces, duration, "follow")
            try:
                with suppress(NotArrived):
                    motion.wait()
                self.is_over = True
            finally:
                self._at = float(self._time(start, np.array([motion.elapsed]))[0])
        finally:
            arm.unsubscribe(self._look)

    def report(self) -> TrackingReport:
        """Say how the trajectory was kept; raises CommandRefused if no state message came."""
        if not self._counts.all():
            raise CommandRefused("follow ended without a state message; is the robot reporting?")
        path = self.trajectory
        return TrackingReport(
            path.name, path.joints, path.units, np.sqrt(self._squares / self._counts), self._max,
            self._max_speed, self._law.duration,
        )  # fmt: skip

    def _pieces(self, start: float, duration: float) -> Iterator[Array]:
        rate = self.arm.rate
        periods = round(np.ceil(duration * rate - 1e-6))
        size = int(BLOCK_DURATION * rate)
        for first in range(0, periods, size):
            elapsed = np.arange(first + 1, min(first + size, periods) + 1) / rate
            yield self._rows(self._time(start, elapsed))
            if self.progress is not None:
                done = self._time(start, elapsed[-1:])[0] / self._law.duration
                self.progress(min(float(done), 1.0))

    def _time(self, start: float, elapsed: Array) -> Array:
        """Time of the law (n,) [s], `elapsed` after it was taken up at `start`."""
        if start == 0.0:
            return elapsed  # the law starts at rest
        soft = np.where(elapsed < BLEND, elapsed**2 / (2 * BLEND), elapsed - BLEND / 2)
        return np.asarray(start + soft)

    def _rows(self, t: Array) -> Array:
        rows = np.tile(self._pose, (len(t), 1))
        rows[:, self._columns] = self._law.at(t)
        return rows

    def _look(self, block: StateBlock | TruthBlock) -> None:
        if isinstance(block, TruthBlock):
            return
        measured = block.measured[:, self._channels]
        error = block.setpoint[:, self._channels] - measured
        self._add(self._followed, error[:, self._followed])
        old = len(self._t)
        t, path = np.concatenate([self._t, block.t]), np.vstack([self._measured, measured])
        before = np.searchsorted(t, t[old:] - _SPEED_WINDOW + 1e-9, side="right") - 1
        after = np.arange(old, len(t))[before >= 0]
        before = before[before >= 0]
        if len(after):
            travel, since = np.abs(path[after] - path[before]), t[after] - t[before]
            self._max_speed = np.maximum(self._max_speed, (travel / since[:, None]).max(axis=0))
        recent = t > t[-1] - _SPEED_WINDOW - 1e-6
        self._t, self._measured = t[recent], path[recent]

    def _leg(self) -> Callable[[float, Array, Array], None]:
        """Give what is to be told the steps of a loop, from one start to the next stop."""
        wanted: Array | None = None

        def tell(_: float, goal: Array, here: Array) -> None:
            nonlocal wanted
            if wanted is not None and np.isfinite(here).all():
                self._add(self._steered, (wanted - here)[None, self._among])
            wanted = goal.copy()

        return tell

    def _add(self, joints: list[int], error: Array) -> None:
        """Add up errors (n, len(joints)) [rad or m]."""
        if not joints:
            return
        self._counts[joints] += len(error)
        self._squares[joints] += (error**2).sum(axis=0)
        self._max[joints] = np.maximum(self._max[joints], np.abs(error).max(axis=0))


def nominal_duration(trajectory: Trajectory, robot: Robot) -> float:
    """Time that `follow` will take from start to end [s]; raises as it does.

    Examples
    --------
    >>> robot = truejoint.get_robot("raven2")
    >>> nominal_duration(zigzag(robot, "J2", 1 / 2), robot) > 10.0
    True
    """
    return _time_law(robot, trajectory, None).duration


def _time_law(robot: Robot, trajectory: Trajectory, speed: ArrayLike | None) -> TimeLaw:
    """Time law of a trajectory; raises TrajectoryError if a joint would be too fast."""
    name, joints, times = as_trajectory(trajectory).name, trajectory.joints, trajectory.times
    top = np.array([as_robot(robot).joint(joint).max_speed for joint in joints])
    if times is not None:
        if speed is not None:
            raise TrajectoryError(f"{name}: has times; give no speed")
        slopes = np.abs(np.diff(trajectory.positions, axis=0)) / np.diff(times)[:, None]
        caps, law = slopes.max(axis=0), TimeLaw(times - times[0], trajectory.positions)
    else:
        if speed is None:
            space = workspace_of(robot)
            if missing := ", ".join(joint for joint in joints if joint not in space.joints):
                raise TrajectoryError(f"{name}: no speed cap is known for {missing}; give speed")
            speed = space.speed[[space.joints.index(joint) for joint in joints]]
        caps = np.asarray(speed, dtype=float)
        if caps.shape != (len(joints),) or not (caps > 0.0).all():
            raise TrajectoryError(
                f"{name}: speed {caps.tolist()} must be {len(joints)} positive values"
            )
        law = time_law(trajectory.positions, caps)
    fast = ~((caps <= top) & np.isfinite(caps))
    if fast.any():
        k = int(np.argmax(fast))
        asked, most = (shown(speeds[k], trajectory.units[k] + "/s") for speeds in (caps, top))
        raise TrajectoryError(f"{name}: {joints[k]} would move at {asked}, above {most}; slow down")
    return law
