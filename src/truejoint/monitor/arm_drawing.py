"""An arm as tubes and balls, drawn from its kinematics alone."""

import itertools
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from truejoint.array_types import Array
from truejoint.errors import RobotError
from truejoint.robots import Robot
from truejoint.robots.chain import SerialChain

_MEETS: Final = 1e-6  # [m]
_SHORTEST: Final = 1e-5  # of a tube [m]
_ARC_PIECES: Final = 8
# Shares of the arm's size.
_ARC_RADIUS: Final = 0.55
_TUBE: Final = 0.012
_ARC_TUBE: Final = 0.02
_FINGER: Final = 0.06
_BALL: Final = 1.35  # radius of a ball by that of its tube


@dataclass(frozen=True, eq=False)
class Drawing:
    """What an arm looks like in several poses, in the frame of its CRTK topics."""

    tubes: Array  # (k, n, 2, 3), both ends of each straight piece [m]
    radii: Array  # (n,), of the tubes [m]
    balls: Array  # (k, m, 3), where joints are and, last, the tool [m]
    ball_radii: Array  # (m,) [m]

    def cylinders(self) -> tuple[Array, Array, Array]:
        """Place cylinders of radius and length 1 along z as the tubes.

        Gives positions (k, n, 3) [m], orientations (k, n, 4) as quaternions with the real part
        first, and scales (k, n, 3).
        """
        along = self.tubes[..., 1, :] - self.tubes[..., 0, :]
        length = np.maximum(np.linalg.norm(along, axis=-1), _SHORTEST)
        # A turn by pi about the line half-way between z and the tube takes one to the other.
        half = along / length[..., None] + np.array([0.0, 0.0, 1.0])
        size = np.linalg.norm(half, axis=-1, keepdims=True)
        half = np.where(size > 1e-6, half / np.maximum(size, 1e-6), np.array([1.0, 0.0, 0.0]))
        wxyz = np.concatenate([np.zeros_like(size), half], axis=-1)
        radii = np.broadcast_to(self.radii, length.shape)
        return self.tubes.mean(axis=-2), wxyz, np.stack([radii, radii, length], axis=-1)


class ArmDrawing:
    """Draws an arm in any pose.

    A link is a tube along its Denavit-Hartenberg lengths. Where the first axes all meet in the
    base's origin, a remote centre of motion, the links between them are arcs about it, as those of
    RAVEN-II are, and the instrument passes through. Jaws are two fingers.

    Its `size` is the largest distance between two of its axes' origins at home [m]. Raises
    RobotError if nothing says where its links are.
    """

    def __init__(self, robot: Robot) -> None:
        chain = robot.kinematics
        if not isinstance(chain, SerialChain):
            raise RobotError(f"the kinematics of {robot.title} are not known: nothing to draw")
        self._chain = chain
        self._opening, self._finger = _jaws(robot)
        frames = chain.link_frames(robot.home)
        origins = np.vstack([np.zeros(3), frames[:, :3, 3]])
        reach = np.linalg.norm(origins[:, None] - origins[None], axis=-1).max()
        self.size = float(max(reach, 0.05))
        self._finger = self._finger or _FINGER * self.size
        # First axes that meet in the base's origin, up to one that slides; 0 for fewer than 3.
        at, z = frames[:, :3, 3], frames[:, :3, 2]
        off = np.linalg.norm(at - (at * z).sum(axis=1, keepdims=True) * z, axis=1) > _MEETS
        slides = np.concatenate([[False], np.linalg.norm(at[:-1], axis=1) > _MEETS])
        ends = np.flatnonzero(off | slides)
        count = int(ends[0]) if len(ends) else len(frames)
        self._n_meeting = count if count >= 3 else 0
        self._arcs = _arcs(frames[: self._n_meeting]) * _ARC_RADIUS * self.size

    def at(self, joints: ArrayLike) -> Drawing:
        """Draw the poses at `joints` (k, n_joints) [rad or m]."""
        rows = np.asarray(joints, dtype=float)
        frames, poses = self._chain.link_frames(rows), self._chain.forward(rows)
        tool, first = poses[:, :3, 3], self._n_meeting
        # An arc is rigid in the frame of the axis that it starts at.
        arcs = np.einsum("klij,lpj->klpi", frames[:, : len(self._arcs), :3, :3], self._arcs)
        pieces = np.stack([arcs[:, :, :-1], arcs[:, :, 1:]], axis=-2).reshape(len(rows), -1, 2, 3)
        links, balls = [], list(np.moveaxis(arcs[:, :, 0], 1, 0))
        balls += [arcs[:, -1, -1]] if first else []
        before = frames[:, first - 1, :3, 3] if first else np.zeros_like(tool)
        for frame in np.moveaxis(frames[:, first:], 1, 0):
            here, z = frame[:, :3, 3], frame[:, :3, 2]
            corner = here - ((here - before) * z).sum(axis=1, keepdims=True) * z
            links += [(before, corner), (corner, here)]
            balls.append(here)
            before = here
        links.append((before, tool))
        if self._opening.any():  # both jaws, as far open as they are, about the last axis
            half = 0.5 * (rows @ self._opening)[:, None]
            x, y = np.cos(half) * frames[:, -1, :3, 0], np.sin(half) * frames[:, -1, :3, 1]
            links += [(tool, tool + self._finger * (x + side * y)) for side in (1.0, -1.0)]
        tubes = np.concatenate([pieces, np.array(links).transpose(2, 0, 1, 3)], axis=1)
        radii = np.where(np.arange(tubes.shape[1]) < pieces.shape[1], _ARC_TUBE, _TUBE)
        turn, shift = self._chain.crtk_from_base[:3, :3].T, self._chain.crtk_from_base[:3, 3]
        every = np.stack([*balls, tool], axis=1)
        thick = np.where(np.arange(every.shape[1]) < first, _ARC_TUBE, _TUBE)
        ball_radii = _BALL * thick * self.size
        return Drawing(tubes @ turn + shift, radii * self.size, every @ turn + shift, ball_radii)


def can_draw(robot: Robot) -> bool:
    """Whether the robot's kinematics say where its links are."""
    return isinstance(robot.kinematics, SerialChain)


def _jaws(robot: Robot) -> tuple[Array, float]:
    """Give the opening of the jaws per joint position (n_joints,), and their length [m] or 0."""
    cables = robot.mechanism
    if cables is not None and cables.contact is not None:
        arms = [float(np.abs(cables.row(arm)).sum()) for arm in cables.arms.values()]
        return cables.row(cables.contact.opening), min(arms, default=0.0)
    opening = np.zeros(len(robot.joints))
    opening[robot.index(robot.grasper)] = 1.0
    return opening, 0.0


def _arcs(meeting: Array) -> Array:
    """Points (links, points, 3) of arcs of radius 1 between axes, in the frame that each starts at.

    The last axis carries on the side where its origin lies; of the others, the nearer ends count.
    """
    z = meeting[:, :3, 2].copy()
    if len(z):
        z[-1] *= -1.0 if meeting[-1, :3, 3] @ z[-1] < 0 else 1.0
    for k in reversed(range(len(z) - 1)):
        z[k] *= -1.0 if z[k] @ z[k + 1] < -_MEETS else 1.0
    arcs = np.zeros((max(len(z) - 1, 0), _ARC_PIECES + 1, 3))
    share = np.linspace(0.0, 1.0, _ARC_PIECES + 1)[:, None]
    for k, (a, b) in enumerate(itertools.pairwise(z)):
        angle = float(np.arccos(np.clip(a @ b, -1.0, 1.0)))
        aside = (b - np.cos(angle) * a) / max(np.sin(angle), _MEETS)
        arcs[k] = (np.cos(share * angle) * a + np.sin(share * angle) * aside) @ meeting[k, :3, :3]
    return arcs
