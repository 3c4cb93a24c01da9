"""Motions in the calibration workspace: zig-zags to calibrate, a random one to test (peng2024)."""

from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version
from numbers import Integral, Real
from typing import Any, Final, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from truejoint.array_types import Array
from truejoint.errors import TrajectoryError, unknown
from truejoint.motion.trajectory import Trajectory, workspace_of
from truejoint.robots import Robot, Workspace

DIRECTIONS: Final = ("J1", "J2", "J3", "J1-J2", "J2-J3", "J1-J3", "J1-J2-J3")
"""Joints that move along the strokes of a zig-zag; J1 to J3 are the positioning joints."""

PROFILES: Final = ("cosine", "laboratory")
"""How the speed of a random motion goes along a swing; see `random_motion`."""

_MOST_DIVISIONS: Final = 50
LONGEST: Final = 24 * 3600.0  # [s]

_NESTED: Final = (
    -1.0, 1.0, -1.0, -0.2, -0.7, -0.4, -0.6, 0.3, -0.2, 0.1, -0.1, 0.8, 0.3, 0.6, 0.4, 1.0, -1.0,
    1.0,
)  # fmt: skip
"""Where nested loops turn, as shares of half the workspace about its centre."""

# The laboratory's random motion: 1200 cycles of its loop of 500 Hz until full speed after a turn,
# and the time that the rest of the way would take at the speed of the moment [s].
_RAMP: Final = 2.4
_APPROACH: Final = 1.0

_EDGE: Final = 1.0 / np.sqrt(3.0)
_HALF_DIAGONAL: Final = 1.0 / np.sqrt(6.0)


def zigzag(
    robot: Robot,
    direction: str = "J2-J3",
    sparsity: float = 1 / 4,
    *,
    workspace: Workspace | None = None,
    published: bool = False,
) -> Trajectory:
    """Zig-zag path: strokes along `direction` on an even grid; 2 (1/sparsity + 1)^2 corners.

    Every direction has the same centre (peng2024 eq. 4) and covers the same volume, 1/sqrt(27)
    of the workspace: a box whose joint ranges are, as shares of the workspace's (eq. 5),
    1/sqrt(3) for a joint that moves alone, sqrt(2/3) for two that move together and 1 for three.

    A rigid turn of the unit cube (eq. 1 and 2) meets this exactly for one and two joints. But no
    rotation has equal extents of sqrt(3) along three axes, and scaling the turned cube to range 1
    (eq. 3) covers more volume than the other directions do. So for three joints the box is the one
    nearest to a cube that has range 1 and the common volume, both exactly; its edges are 1.3 %
    longer than the cube's and stand at 98.8 deg.

    Parameters
    ----------
    robot : Robot
        With three positioning joints.
    direction : str
        One of `DIRECTIONS`.
    sparsity : float
        Distance between neighbouring strokes as a share of the box, in [1/50, 1]. The box is
        divided evenly, so that 1/sparsity is rounded to the nearest whole number: 0.33 is 1/3.
    workspace : Workspace, optional
        Workspace to move in; by default `workspace_of(robot)`.
    published : bool
        Take the box of J1-J2-J3 that the laboratory's generator makes, a unit cube turned by 45 deg
        about three axes and stretched, with a third more volume
        (uw-biorobotics/raven2_CRTK_Python_controller:traj_generator/run_snake_generator.py). The
        other directions are the same either way.

    Raises
    ------
    TrajectoryError
        If the direction is unknown, the sparsity out of range or the robot has no workspace.

    Examples
    --------
    >>> zigzag(truejoint.get_robot("raven2"), "J2-J3", 1 / 4).joints
    ('shoulder', 'elbow', 'insertion')
    """
    if str(direction).upper() not in DIRECTIONS:
        raise TrajectoryError(unknown("direction", str(direction), DIRECTIONS))
    if not (isinstance(sparsity, Real) and 1.0 / _MOST_DIVISIONS <= sparsity <= 1.0):
        raise TrajectoryError(
            f"sparsity {sparsity!r:.40} must be within [1/{_MOST_DIVISIONS}, 1], as a number"
        )
    space = workspace_of(robot, workspace)
    if len(space.joints) != 3:
        raise TrajectoryError(
            f"a zig-zag needs 3 joints; the workspace has {', '.join(space.joints)}"
        )
    direction, divisions = direction.upper(), round(1.0 / sparsity)
    shares = (_unit_snake(divisions) - 0.5) @ zigzag_box(direction, published=published).T
    meta = {"kind": "zigzag", "direction": direction, "sparsity": 1.0 / divisions}
    if published and direction == DIRECTIONS[-1]:
        meta["published"] = True
    meta |= {"lower": space.lower.tolist(), "upper": space.upper.tolist()}
    name, positions = f"zigzag {direction} 1/{divisions}", space.centre + space.extent * shares
    return generated(robot, space, positions, name=name, meta=meta)


def random_motion(
    robot: Robot,
    duration: float = 1200.0,
    seed: int = 0,
    *,
    rate: float = 20.0,
    profile: str = "cosine",
    workspace: Workspace | None = None,
) -> Trajectory:
    """Random sinusoidal motion of the positioning joints, each on its own (peng2024 IV-A).

    Every joint swings between the two ends of its workspace. For each swing the turning point is
    drawn within a margin of the end and the peak speed from the joint's range of speeds. The
    motion starts at the centre and never leaves the workspace, which also states margins and
    speeds.

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
    profile : str
        One of `PROFILES`, the speed along a swing. ``"cosine"``: half a period, so that a joint
        dwells at the ends. ``"laboratory"``: constant, after a ramp of 2.4 s, until the rest would
        take one second, then in proportion to that rest, down to a last crawl (uw-biorobotics/
        raven2_CRTK_Python_controller:python_controller/run_r2_random_joint_movement.py).
    workspace : Workspace, optional
        Workspace to move in; by default `workspace_of(robot)`.

    Raises
    ------
    TrajectoryError
        If duration, rate, seed or profile is out of range or the robot's ranges are not known.

    Examples
    --------
    >>> random_motion(truejoint.get_robot("raven2"), duration=10.0, seed=1).joints
    ('shoulder', 'elbow', 'insertion')
    """
    times = _times(duration, rate, 1.0, LONGEST)
    check_seed(seed)
    if profile not in PROFILES:
        raise TrajectoryError(unknown("profile", profile, PROFILES))
    space = workspace_of(robot, workspace)
    streams = np.random.SeedSequence(seed).spawn(len(space.joints))
    bounds = np.column_stack([space.lower, space.upper, *space.swings])
    positions = [
        _swings(times, np.random.default_rng(stream), _SWINGS[profile], *bound)
        for bound, stream in zip(bounds, streams, strict=True)
    ]
    name = f"random {duration / 60:.3g} min, seed {seed}"
    meta = {"kind": "random", "duration": duration, "seed": seed, "profile": profile}
    return generated(robot, space, np.column_stack(positions), times, name=name, meta=meta)


def nested_motion(
    robot: Robot, duration: float = 65.0, *, rate: float = 20.0, workspace: Workspace | None = None
) -> Trajectory:
    """Loops of three sizes, one inside the other, of a robot with one joint.

    The joint goes over its whole workspace. Loops of a quarter of that lie in its lower, middle and
    upper part, and one of less than a tenth in each of these: friction and hysteresis depend on how
    far back a joint last turned, and on the tension there, which one amplitude does not show. Every
    swing is half a period of a cosine with the same peak speed; the motion starts at the centre.

    Parameters
    ----------
    robot : Robot
    duration : float
        Duration of the whole, 10 s to an hour.
    rate : float
        Points per second [Hz], 1 to 1000.
    workspace : Workspace, optional
        Workspace to move in; by default `workspace_of(robot)`.

    Raises
    ------
    TrajectoryError
        If a value is out of range, or the workspace has not one joint, or none is known.

    Examples
    --------
    >>> nested_motion(truejoint.get_robot("forceps")).joints
    ('jaw',)
    """
    space = workspace_of(robot, workspace)
    if len(space.joints) != 1:
        raise TrajectoryError(
            f"nested loops are for one joint; the workspace of {robot.title} has "
            f"{len(space.joints)}: use a zig-zag or a random motion"
        )
    times = _times(duration, rate, 10.0, 3600.0)
    middle, half = (space.upper[0] + space.lower[0]) / 2, (space.upper[0] - space.lower[0]) / 2
    knots = [middle, *(middle + share * half for share in _NESTED)]
    ways = np.abs(np.diff(knots))
    peak = np.pi * ways.sum() / (2.0 * duration)
    swings = [_cosine(way, peak, 0.0) for way in ways]
    meta = {"kind": "nested", "duration": duration}
    positions = _travelled(times, knots, swings)[:, None]
    return generated(robot, space, positions, times, name=f"nested {duration:g} s", meta=meta)


def check_seed(seed: int) -> None:
    """Raise TrajectoryError unless a seed is a whole number of 0 or more."""
    if not (isinstance(seed, Integral) and seed >= 0):
        raise TrajectoryError(f"seed is {seed!r:.40}; give a whole number of 0 or more")


def zigzag_box(direction: str, *, published: bool = False) -> Array:
    """Edges (3, 3) of the box that a zig-zag covers, as shares of the joints' ranges.

    A column each: along the strokes, along the strokes of a layer, along the layers.
    """
    moving = [int(part[1]) - 1 for part in direction.split("-")]
    if len(moving) == 3 and published:
        # The cube turned about z, x and y by 45 deg each; its rows are divided by sqrt(3), and the
        # first and the third then stretched to range 1; the second keeps 0.986.
        edges = Rotation.from_euler("zxy", [45.0, 45.0, 45.0], degrees=True).as_matrix() * _EDGE
        edges[[0, 2]] /= np.abs(edges[[0, 2]]).sum(axis=1, keepdims=True)
        return np.asarray(edges)
    if len(moving) == 3:
        # Rows have absolute sum 1, the volume is 1/sqrt(27). Signed cyclic shifts of (a, a, b) with
        # 2 a + b = 1 have the volume (a + b)^2 (2 a - b) = (1 - a)^2 (4 a - 1); the solution nearer
        # to a cube is taken: of all such boxes its edges' inner products deviate least from a
        # cube's.
        roots = np.roots([4.0, -9.0, 6.0, -1.0 - 1.0 / np.sqrt(27.0)]).real
        a = float(np.sort(roots)[0])
        b = 1.0 - 2.0 * a
        return np.array([[a, -b, a], [a, a, -b], [b, -a, -a]])
    if len(moving) == 1:
        # Joints in cyclic order from the one that moves: a turn of the whole cube.
        return np.asarray(np.roll(np.eye(3), moving[0], axis=0) * _EDGE)
    box = np.zeros((3, 3))
    box[moving, 0] = _HALF_DIAGONAL
    box[moving, 1] = -_HALF_DIAGONAL, _HALF_DIAGONAL
    box[3 - sum(moving), 2] = _EDGE
    return box


def _unit_snake(divisions: int) -> Array:
    """Corners (2 (divisions + 1)^2, 3) of a zig-zag through the unit cube.

    Strokes along the first axis turn back each time, rows along the second with each layer.
    """
    rows = divisions + 1
    stroke = np.arange(rows * rows)
    layer, row = np.divmod(stroke, rows)
    row = np.where(layer % 2 == 0, row, divisions - row)
    across = np.repeat(np.column_stack([row, layer]) / divisions, 2, axis=0)
    along = np.resize([0.0, 1.0, 1.0, 0.0], len(across))
    return np.column_stack([along, across])


def _times(duration: float, rate: float, shortest: float, longest: float) -> Array:
    """Time stamps (n,) [s] of a motion, or refuse its duration or rate."""
    if not shortest <= duration <= longest:
        raise TrajectoryError(
            f"duration {duration} s must be within [{shortest:g}, {longest:.0f}] s"
        )
    if not 1.0 <= rate <= 1000.0:
        raise TrajectoryError(f"rate {rate} Hz must be within [1, 1000] Hz")
    return np.arange(round(duration * rate) + 1) / rate


def _swings(
    times: Array,
    random: np.random.Generator,
    profile: "Callable[[float, float, float], _Swing]",
    lower: float,
    upper: float,
    *ranges: float,
) -> Array:
    """Positions (n,) at `times` (n,) of one joint that starts at the centre."""
    widest, slowest, fastest, crawl = ranges
    end, knots = 0.0, [(lower + upper) / 2]
    swings: list[_Swing] = []
    upwards = bool(random.integers(2))
    while end <= times[-1]:
        margin = random.uniform(0.0, widest)
        target = upper - margin if upwards else lower + margin
        peak = random.uniform(slowest, fastest)
        swings.append(profile(abs(target - knots[-1]), peak, crawl))
        end += swings[-1].duration
        knots.append(target)
        upwards = not upwards
    return _travelled(times, knots, swings)


def _travelled(times: Array, knots: Sequence[float], swings: "Sequence[_Swing]") -> Array:
    """Positions (n,) at `times` (n,) of a joint that swings from knot to knot."""
    turns = np.concatenate([[0.0], np.cumsum([swing.duration for swing in swings])])
    positions = np.empty(len(times))
    parts = np.split(np.arange(len(times)), np.searchsorted(times, turns[1:-1]))
    for part, begin, start, end, swing in zip(parts, turns, knots, knots[1:], swings, strict=False):
        way = swing.travelled(times[part] - begin)
        positions[part] = start + np.sign(end - start) * way
    return positions


class _Swing(NamedTuple):
    """Way of a joint from rest to rest: its duration [s], and what is travelled after times [s]."""

    duration: float
    travelled: Callable[[Array], Array]


def _cosine(distance: float, peak: float, _: float) -> _Swing:
    """Half a period of a cosine over a `distance` [rad or m], at most at speed `peak`."""
    duration = np.pi * distance / (2.0 * peak)
    return _Swing(duration, lambda t: distance * (1.0 - np.cos(np.pi * t / duration)) / 2.0)


def _laboratory(distance: float, peak: float, crawl: float) -> _Swing:
    """Constant speed `peak` between a ramp and an approach in proportion to what is left.

    Without the ramp, what is left of the way is a straight line, an exponential and a straight
    line of time; the ramp, a speed that grows with time, is a parabola in that time.
    """
    rest = min(distance, peak * _APPROACH)
    slow = min(rest, crawl * _APPROACH)
    first = (distance - rest) / peak
    second = first + _APPROACH * np.log(rest / slow)
    third = second + slow / crawl
    late = third + _RAMP / 2.0

    def travelled(t: Array) -> Array:
        now = np.where(t < _RAMP, t * t / (2.0 * _RAMP), t - _RAMP / 2.0)
        line = distance - peak * now
        curve = rest * np.exp((first - np.clip(now, first, second)) / _APPROACH)
        rests = np.select([now < first, now < second], [line, curve], crawl * (third - now))
        return distance - rests

    return _Swing(late if late > _RAMP else float(np.sqrt(2.0 * _RAMP * third)), travelled)


_SWINGS: Final = dict(zip(PROFILES, (_cosine, _laboratory), strict=True))


def generated(
    robot: Robot,
    space: Workspace,
    positions: Array,
    times: Array | None = None,
    *,
    name: str,
    meta: Mapping[str, Any],
) -> Trajectory:
    """Trajectory through `positions` (n, n_joints) [rad or m] of `space`, saying who made it."""
    units = tuple(robot.joint(joint).unit for joint in space.joints)
    origin = {"robot": robot.name, "arm": robot.arm, "version": version("truejoint")}
    return Trajectory(space.joints, units, positions, times, name, {**meta, **origin})
