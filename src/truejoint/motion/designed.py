"""A motion designed to calibrate on: every line is the one expected to tell most a second."""

from itertools import combinations_with_replacement
from typing import Final

import numpy as np
from numpy.polynomial import legendre

from truejoint.array_types import Array, Integers
from truejoint.errors import TrajectoryError
from truejoint.motion.calibration_motions import LONGEST, check_seed, generated
from truejoint.motion.trajectory import Trajectory, workspace_of
from truejoint.robots import Robot, Workspace

# What is assumed of a joint's error before it is measured, as shares of what a linear model
# explains of it: the standard deviation over the workspace of each curved term by its degree, of
# how friction varies along each joint, and of what no term explains, which changes with time.
_CURVED: Final = (0.2, 0.15, 0.1, 0.1, 0.1)  # degrees 2 to 6
_MIXED: Final = 3  # highest degree of products of several joints
_FRICTION: Final = 0.1
NOISE: Final = 0.1
_APART: Final = 1.0  # [s] after which that is another

_CANDIDATES: Final = 256  # lines that are compared
_POINTS: Final = 12  # of a line that are looked at
_BEYOND: Final = 1.3  # half ranges within which ends are drawn; those outside are put on the edge
_SHORTEST: Final = 1.0  # [s], of a line that is not the last, where one so long is drawn


def designed_motion(
    robot: Robot, duration: float = 150.0, seed: int = 0, *, workspace: Workspace | None = None
) -> Trajectory:
    """Motion that lowers the expected error of a calibration fastest, within ranges and speeds.

    Among random straight lines the joints follow the best one. After it a linear model of the error
    (positions, and friction by the direction and the speed of each joint) is expected to be off
    least over the whole workspace, for the time that it takes; and so on from its end. The
    expectation holds the effect of noise on the coefficients. It also holds that of curves of the
    error, which a linear model lacks, where the motion is uneven (Box and Draper, A basis for the
    selection of a response surface design, Journal of the American Statistical Association 54,
    1959). A longer motion begins with the shorter one of the same seed, but for its last line:
    whenever it is stopped, it was designed for the time that it had.

    Parameters
    ----------
    robot : Robot
    duration : float
        10 s to a day [s].
    seed : int
        Number of lines that are compared.
    workspace : Workspace, optional
        Workspace to move in, on every line with one joint at a speed between those of a random
        motion; by default `workspace_of(robot)`.

    Raises
    ------
    TrajectoryError
        If duration or seed is out of range, or the robot has no workspace, or one that is crossed
        within a second.

    Examples
    --------
    >>> designed_motion(truejoint.get_robot("raven2"), 30.0).times[-1]
    np.float64(30.0)
    """
    if not 10.0 <= duration <= LONGEST:
        raise TrajectoryError(f"duration {duration} s must be within [10, {LONGEST:.0f}] s")
    check_seed(seed)
    space = workspace_of(robot, workspace)
    n_joints, random = len(space.joints), np.random.default_rng(seed)
    half, (_, slowest, fastest, _) = space.extent / 2.0, space.swings
    if (space.extent / fastest).max() < _SHORTEST:
        raise TrajectoryError(
            f"the workspace is crossed in less than {_SHORTEST:g} s; give a larger one or lower "
            "speeds"
        )
    degrees, spreads = curved_terms(n_joints)
    n_linear = 1 + 3 * n_joints
    information, mixed = NOISE**2 * np.eye(n_linear), np.zeros((n_linear, len(spreads)))
    now, places, stamps = float(n_linear), [np.zeros(n_joints)], [0.0]
    along = (np.arange(_POINTS)[:, None] + 0.5) / _POINTS
    while stamps[-1] < duration:
        draws = random.uniform(-_BEYOND, _BEYOND, (_CANDIDATES, n_joints))
        ways = np.clip(draws, -1.0, 1.0) - places[-1]
        paces = slowest + random.uniform(0.0, 1.0, (_CANDIDATES, 1)) * (fastest - slowest)
        times = (np.abs(ways) * half / paces).max(axis=1)
        long = times >= min(_SHORTEST, times.max())
        ways, times = ways[long], times[long]
        lines = places[-1] + along * ways[:, None]
        speeds = scaled_speed(np.abs(ways) * half / times[:, None], slowest, fastest)
        linear, curved = terms(lines, np.sign(ways)[:, None], speeds[:, None], degrees)
        weighted = linear.swapaxes(1, 2) * (times / _APART / _POINTS)[:, None, None]
        all_known, all_mixed = information + weighted @ linear, mixed + weighted @ curved
        errors = expected_error(all_known, all_mixed, spreads)
        best = int(np.argmin(np.log(errors / now) / times))
        information, mixed, now = all_known[best], all_mixed[best], float(errors[best])
        remaining_s = duration - stamps[-1]
        places.append(places[-1] + ways[best] * min(remaining_s / times[best], 1.0))
        stamps.append(min(duration, stamps[-1] + times[best]))
    meta = {"kind": "designed", "duration": duration, "seed": seed}
    positions = np.clip(space.centre + np.array(places) * half, space.lower, space.upper)
    name = f"designed {duration / 60:.3g} min, seed {seed}"
    return generated(robot, space, positions, np.array(stamps), name=name, meta=meta)


def curved_terms(n_joints: int) -> tuple[Integers, Array]:
    """Degrees (n, n_joints) of what a linear model does not know, and spreads (n + n_joints^2,).

    Those are of the coefficients: of the smooth terms, then of each joint's friction along each.
    """
    highest = len(_CURVED) + 1
    kinds = [
        np.bincount(chosen, minlength=n_joints)
        for degree in range(2, highest + 1)
        for chosen in combinations_with_replacement(range(n_joints), degree)
        if degree <= _MIXED or len(set(chosen)) == 1
    ]
    degrees = np.array(kinds)
    smooth = np.array(_CURVED)[degrees.sum(axis=1) - 2]
    return degrees, np.concatenate([smooth, np.full(n_joints**2, _FRICTION)])


def scaled_speed(speed: Array, slowest: Array, fastest: Array) -> Array:
    """Speeds (n, k) [rad/s or m/s] about the mean of a range, in standard deviations over it."""
    deviation = np.maximum(fastest - slowest, 1e-6 * fastest) / np.sqrt(12.0)
    return np.asarray((speed - (slowest + fastest) / 2.0) / deviation)


def terms(z: Array, direction: Array, speed: Array, degrees: Integers) -> tuple[Array, Array]:
    """Give terms (..., 1 + 3 k) of a linear model, and those (..., m) that it does not know.

    At positions `z` (..., k) as shares of half the range about the centre, moving in `direction`
    (..., k) of signs at `scaled_speed` (..., k). Over a workspace that is visited evenly, in all
    directions and at all speeds of the range, the mean product of two terms is 1 for a term with
    itself and else 0.
    """
    k = z.shape[-1]
    direction, speed = (np.broadcast_to(values, z.shape) for values in (direction, speed))
    powers = legendre.legvander(z, len(_CURVED) + 1)
    powers = powers * np.sqrt(2.0 * np.arange(powers.shape[-1]) + 1.0)
    first, constant = powers[..., 1], np.ones((*z.shape[:-1], 1))
    linear = np.concatenate([constant, first, direction, direction * speed], axis=-1)
    smooth = np.prod(powers[..., np.arange(k), degrees], axis=-1)
    friction = (direction[..., :, None] * first[..., None, :]).reshape(*z.shape[:-1], k * k)
    return linear, np.concatenate([smooth, friction], axis=-1)


def expected_error(information: Array, mixed: Array, spreads: Array) -> Array:
    """Mean square (...) over the workspace by which a fitted linear model is off the best one.

    `information` (..., p, p) are sums of products of its terms, with the noise's variance on the
    diagonal; `mixed` (..., p, m) of these with the terms that it does not know, of `spreads` (m,).
    """
    inverse = np.linalg.inv(information)
    noise = NOISE**2 * np.trace(inverse, axis1=-2, axis2=-1)
    bias = ((inverse @ mixed * spreads) ** 2).sum(axis=(-2, -1))
    return np.asarray(noise + bias)
