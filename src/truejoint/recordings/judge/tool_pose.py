"""Whether a robot's own pose of its tool is where its joints put it, and if not, why."""

from collections.abc import Iterator
from typing import Final, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from truejoint.array_types import Array
from truejoint.crtk.cartesian import pose
from truejoint.recordings.judge.finding import Finding
from truejoint.recordings.read.track import Track
from truejoint.recordings.table.recording import Recording
from truejoint.robots import Robot, arm_names, get_robot
from truejoint.robots.chain import SerialChain

_AGREES: Final = 1e-3  # [m] RMS, beside what a late stamp makes of a moving tool
_EXPLAINS: Final = 0.1  # share of the difference that the right cause leaves, at most
_FEWEST: Final = 20  # poses beside joints
_ALIKE: Final = 1.5  # what two causes leave, of which the first one is named
_LEAST_MOTION: Final = 0.01  # [m] of the tool, below which any base frame would fit
_ROUNDS: Final = 5


def judge_tool_pose(recording: Recording, reported: Track | None) -> Finding | None:
    """Compare the pose that a robot reports with the forward kinematics of its measured joints.

    A base frame of its own is no fault. A wrong unit, arm or tool is tried, and named where it
    explains nine tenths of what the two differ by. None without `reported` poses
    (`read_tool_poses`), kinematics, all joints or motion.
    """
    robot, chain = recording.robot, recording.robot.kinematics
    if reported is None or chain is None:
        return None
    moves = np.abs(chain.jacobian(robot.home)).max(axis=0) > 0.0
    names = [robot.joint_names[k] for k in np.flatnonzero(moves)]
    t = reported.t - recording.provenance.start
    rows = np.flatnonzero((t >= recording.t[0]) & (t <= recording.t[-1]))
    if not set(names) <= set(recording.joints_of("measured")) or len(rows) < _FEWEST:
        return None
    joint = np.zeros((len(rows), len(robot.joints)))
    for name in names:
        column = recording.column(f"measured/{name}")
        joint[:, robot.joint_names.index(name)] = np.interp(t[rows], recording.t, column)
    position, expected = reported.position[rows], pose(chain, joint)
    if np.ptp(expected[:, :3, 3], axis=0).max() < _LEAST_MOTION:
        return None
    off = _rms(position - expected[:, :3, 3])
    rest, base = _registered(expected[:, :3, 3], position)
    says = "the tool that the robot reports is {:.3g} mm (RMS) from where its joints put it"
    if min(off, rest) < _AGREES:
        in_base = "" if off < _AGREES else f", in a base frame {base}"
        return Finding("good", "pose", says.format(1e3 * min(off, rest)) + in_base, "")
    causes = list(_causes(robot, joint, position))
    unexplained = min(causes)[0]
    cause = next(why for rms, why in causes if rms <= _ALIKE * unexplained)
    if unexplained > _EXPLAINS * rest:
        cause = "is the robot file (--robot) that of this arm and its instrument?"
    return Finding("fail", "pose", says.format(1e3 * rest) + ", whatever its base", "", cause)


def _causes(robot: Robot, joint: Array, position: Array) -> Iterator[tuple[float, str]]:
    """Give what each cause leaves [m] (RMS) of the difference, and its remedy."""
    chain = robot.known_kinematics("the pose of the tool")
    place = pose(chain, joint)[:, :3, 3]
    for unit, factor in {"mm": 1e-3, "cm": 1e-2}.items():
        remedy = f"it reports {unit}: convert its poses to m"
        yield _registered(place, factor * position)[0], remedy
    for other in [get_robot(robot.name, arm) for arm in arm_names(robot.name) if robot.arm]:
        if other.arm != robot.arm and other.kinematics is not None:
            remedy = f"it is of the {other.arm} arm: state --robot {robot.name}:{other.arm}"
            yield _registered(pose(other.kinematics, joint)[:, :3, 3], position)[0], remedy
    frames = chain.link_frames(joint) if isinstance(chain, SerialChain) else place[:, :0]
    place = chain.forward(joint)[:, :3, 3]
    for k in reversed(range(frames.shape[1])):
        turn, missing = frames[:, k, :3, :3], place
        longer = np.zeros(3)
        for _ in range(_ROUNDS):  # of Gauss and Newton: base frame and link together
            _, base = _registered(place + turn @ longer, position)
            registered = base.into(position)
            missing = registered - place
            turned = np.swapaxes(np.cross(np.eye(3), registered[:, None]), 1, 2)
            slopes = np.concatenate(
                [turned, np.broadcast_to(np.eye(3), turned.shape), turn], axis=2
            )
            solution = np.linalg.lstsq(slopes.reshape(-1, 9), missing.ravel(), rcond=None)[0]
            longer[:] = solution[6:]
        x, y, z = (1e3 * longer).round(1) + 0.0
        remedy = (
            f"the robot file behind axis {k + 1} is off by ({x:.1f}, {y:.1f}, {z:.1f}) mm in that"
        )
        yield _rms(missing - turn @ longer), f"{remedy} axis' frame: is it another instrument?"


class _Base(NamedTuple):
    """Where one frame stands in another."""

    turn: Rotation
    shift: Array  # (3,) [m]

    def __str__(self) -> str:
        x, y, z = (1e3 * self.shift).round(1) + 0.0
        angle = np.degrees(self.turn.magnitude())
        return f"turned by {angle:.3g} deg and shifted by ({x:.1f}, {y:.1f}, {z:.1f}) mm"

    def into(self, position: Array) -> Array:
        """Points (n, 3) [m] of the other frame in this one."""
        return np.asarray(self.turn.inv().apply(position - self.shift))


def _registered(place: Array, position: Array) -> tuple[float, _Base]:
    """Bring points (n, 3) [m] onto others: what is left [m] (RMS), and the base."""
    about, there = place.mean(axis=0), position.mean(axis=0)
    turn, _ = Rotation.align_vectors(position - there, place - about)
    base = _Base(turn, there - turn.apply(about))
    return _rms(base.into(position) - place), base


def _rms(difference: Array) -> float:
    return float(np.sqrt((difference**2).sum(axis=1).mean()))
