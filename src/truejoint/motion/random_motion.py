"""The random motion that a calibration is tested on (peng2024 IV-A)."""

from __future__ import annotations

from typing import Final

import numpy as np

from truejoint.array_types import Array
from truejoint.errors import TrajectoryError
from truejoint.motion.trajectory import Trajectory, generated, workspace_of
from truejoint.robots import Robot

_LONGEST: Final = 24 * 3600.0


def random_motion(
    robot: Robot, duration: float = 1200.0, seed: int = 0, *, rate: float = 20.0
) -> Trajectory:
    """Random sinusoidal motion of the positioning joints, each on its own (peng2024 IV-A).

    Every joint swings between the two ends of its workspace. For each swing the turning point is
    drawn within a margin of the end and the peak speed from the joint's range of speeds; the
    swing is half a period of a cosine, so that the joint turns back smoothly. It starts at the
    centre and never leaves the workspace, which also states margins and speeds.

    Parameters
    ----------
    robot : Robot
        One whose calibration workspace is known.
    duration : float
        Up to a day [s].
    seed : int
        The same seed gives the same motion; a longer one begins with the shorter one.
    rate : float
        Points per second [Hz]; straight lines between them deviate by less than 1e-3 deg at 20 Hz.

    Returns
    -------
    Trajectory
        Of the joints of the workspace, with times.

    Raises
    ------
    TrajectoryError
        If duration, rate or seed is out of range or the robot's ranges are not known.

    Examples
    --------
    >>> random_motion(truejoint.get_robot("raven2"), duration=10.0, seed=1).joints
    ('shoulder', 'elbow', 'insertion')
    """
    if not 1.0 <= duration <= _LONGEST:
        raise TrajectoryError(f"duration {duration} s must be within [1, {_LONGEST:.0f}] s")
    if not 1.0 <= rate <= 1000.0:
        raise TrajectoryError(f"rate {rate} Hz must be within [1, 1000] Hz")
    if seed < 0:
        raise TrajectoryError(f"seed is {seed}; give a whole number of 0 or more")
    space = workspace_of(robot)
    times = np.arange(round(duration * rate) + 1) / rate
    streams = np.random.SeedSequence(seed).spawn(len(space.joints))
    bounds = np.column_stack([space.lower, space.upper, *space.swings])
    positions = [
        _swings(times, np.random.default_rng(stream), *bound)
        for bound, stream in zip(bounds, streams, strict=True)
    ]
    name = f"random {duration / 60:.3g} min, seed {seed}"
    meta = {"kind": "random", "duration": duration, "seed": seed}
    return generated(robot, space, np.column_stack(positions), times, name=name, meta=meta)


def _swings(
    times: Array, random: np.random.Generator, lower: float, upper: float, *ranges: float
) -> Array:
    """Positions (n,) at `times` (n,) of one joint that starts at the centre."""
    widest, slowest, fastest = ranges
    turns, knots = [0.0], [(lower + upper) / 2]
    upwards = bool(random.integers(2))
    while turns[-1] <= times[-1]:
        margin = random.uniform(0.0, widest)
        target = upper - margin if upwards else lower + margin
        peak = random.uniform(slowest, fastest)
        turns.append(turns[-1] + np.pi * abs(target - knots[-1]) / (2.0 * peak))
        knots.append(target)
        upwards = not upwards
    begin, knot = np.array(turns), np.array(knots)
    swing = np.searchsorted(begin, times, side="right") - 1
    phase = np.pi * (times - begin[swing]) / np.diff(begin)[swing]
    start, end = knot[swing], knot[swing + 1]
    return np.asarray(start + (end - start) * (1.0 - np.cos(phase)) / 2.0)
