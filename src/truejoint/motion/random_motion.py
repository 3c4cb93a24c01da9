"""The random motion that a calibration is tested on (peng2024 IV-A)."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.metadata import version
from typing import Final

import numpy as np

from truejoint.crtk.messages import Array
from truejoint.errors import TrajectoryError
from truejoint.motion.trajectory import Trajectory
from truejoint.motion.workspace import workspace_of
from truejoint.robots import Robot

_LONGEST: Final = 24 * 3600.0


@dataclass(frozen=True)
class _Bounce:
    """How one joint swings: it turns within `shrink` of either end, at a peak speed drawn anew."""

    shrink: float
    slowest: float
    fastest: float


# uw-biorobotics/raven2_CRTK_Python_controller:python_controller/run_r2_random_joint_movement.py
_RAVEN2: Final = {
    "shoulder": _Bounce(np.deg2rad(5.0), np.deg2rad(1.091), np.deg2rad(3.0)),
    "elbow": _Bounce(np.deg2rad(10.0), np.deg2rad(1.5), np.deg2rad(4.0)),
    "insertion": _Bounce(0.02, 0.0025, 0.007),
}


def random_motion(
    robot: Robot, duration: float = 1200.0, seed: int = 0, *, rate: float = 20.0
) -> Trajectory:
    """Random sinusoidal motion of the positioning joints, each on its own (peng2024 IV-A).

    Every joint swings between the two ends of its workspace. For each swing the turning point is
    drawn within a margin of the end and the peak speed from the joint's range of speeds; the
    swing is half a period of a cosine, so that the joint turns back smoothly. It starts at the
    centre and never leaves the workspace. Margins and speeds:
    uw-biorobotics/raven2_CRTK_Python_controller:
    python_controller/run_r2_random_joint_movement.py.

    Parameters
    ----------
    robot : Robot
        ``raven2``, the robot that the ranges are known for.
    duration : float
        Up to a day [s].
    seed : int
        The same seed gives the same motion; a longer one begins with the shorter one.
    rate : float
        Points per second [Hz]; straight lines between them deviate by less than 1e-3 deg at 20 Hz.

    Returns
    -------
    Trajectory
        With times.

    Raises
    ------
    TrajectoryError
        If duration or rate is out of range or the robot's ranges are not known.

    Examples
    --------
    >>> random_motion(truejoint.get_robot("raven2"), duration=10.0, seed=1).joints
    ('shoulder', 'elbow', 'insertion')
    """
    if not 1.0 <= duration <= _LONGEST:
        raise TrajectoryError(f"duration {duration} s must be within [1, {_LONGEST:.0f}] s")
    if not 1.0 <= rate <= 1000.0:
        raise TrajectoryError(f"rate {rate} Hz must be within [1, 1000] Hz")
    space = workspace_of(robot)
    times = np.arange(round(duration * rate) + 1) / rate
    streams = np.random.SeedSequence(seed).spawn(len(space.joints))
    positions = np.column_stack(
        [
            _swings(times, lower, upper, _RAVEN2[name], np.random.default_rng(stream))
            for name, lower, upper, stream in zip(
                space.joints, space.lower, space.upper, streams, strict=True
            )
        ]
    )
    return Trajectory(
        joints=space.joints,
        units=tuple(robot.joint(name).unit for name in space.joints),
        positions=positions,
        times=times,
        name=f"random {duration / 60:.3g} min, seed {seed}",
        meta={
            "kind": "random",
            "robot": robot.name,
            "arm": robot.arm,
            "duration": duration,
            "seed": seed,
            "version": version("truejoint"),
        },
    )


def _swings(
    times: Array, lower: float, upper: float, bounce: _Bounce, random: np.random.Generator
) -> Array:
    """Positions (n,) at `times` (n,) of one joint that starts at the centre."""
    turn, starts, ends, begins = 0.0, [], [], []
    position, upwards = (lower + upper) / 2, bool(random.integers(2))
    while turn <= times[-1]:
        margin = random.uniform(0.0, bounce.shrink)
        target = upper - margin if upwards else lower + margin
        peak = random.uniform(bounce.slowest, bounce.fastest)
        begins.append(turn)
        starts.append(position)
        ends.append(target)
        turn += np.pi * abs(target - position) / (2.0 * peak)
        position, upwards = target, not upwards
    begin = np.array([*begins, turn])
    swing = np.searchsorted(begin, times, side="right") - 1
    phase = np.pi * (times - begin[swing]) / np.diff(begin)[swing]
    start, end = np.array(starts)[swing], np.array(ends)[swing]
    return np.asarray(start + (end - start) * (1.0 - np.cos(phase)) / 2.0)
