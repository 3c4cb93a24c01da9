"""The shape of a printed block of stairs with dimples: sized for a robot, as STL and as SVG."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Final

import numpy as np
from numpy.typing import NDArray

from truejoint.array_types import Array, Mask
from truejoint.errors import CalibrationError
from truejoint.robots.parts import Kinematics
from truejoint.robots.reach import reach
from truejoint.robots.robot import Robot, as_robot
from truejoint.tip.block import Block

PITCH: Final = 10e-3  # between dimples [m]
MOST: Final = 9  # dimples along a side
HIGHEST_STEP: Final = 12e-3
"""A wrist reaches further than this beyond its shaft, which so passes the next step [m]."""
LOWEST_STEP: Final = 1e-3
"""Of a workspace that is hardly deep [m]: one plane would leave a turn open."""
BASE: Final = 10e-3  # below the lowest step [m]
CONE: Final = 2e-3  # radius and depth of a dimple [m]
_ROUND: Final = 24  # points of a dimple's rim; a multiple of 4
_INSIDE: Final = 0.05  # of the workspace that dimples keep from its ends, for what cables lose
_GRID: Final = 7
_MM: Final = 1e3


@dataclass(frozen=True, eq=False)
class BlockShape:
    """A ziggurat of square cells whose top stands off its middle, so that no turn repeats it.

    Attributes
    ----------
    robot : Robot
    level : ndarray of int, shape (n_x, n_y)
        Steps below the top of each cell.
    step : float
        Height of a step [m].
    reached : ndarray of bool, shape (n_x, n_y)
        Which cells carry a dimple: those that the robot's workspace reaches.
    rotation, translation : ndarray, shape (3, 3) and (3,)
        Where the block is to stand in the robot's base [m].

    Examples
    --------
    >>> design_block(truejoint.get_robot("raven2")).block().name
    'raven2 stairs 9 x 8'
    """

    robot: Robot
    level: NDArray[np.int64]
    step: float
    reached: Mask
    rotation: Array
    translation: Array

    @property
    def tops(self) -> Array:
        """Middle of each cell's top (n_x, n_y, 3) in the block's frame [m], origin at a corner."""
        n_x, n_y = self.level.shape
        x, y = np.meshgrid(np.arange(n_x) + 0.5, np.arange(n_y) + 0.5, indexing="ij")
        height = BASE + (self.level.max() - self.level) * self.step
        return np.stack([x * PITCH, y * PITCH, height], axis=2)

    @property
    def size(self) -> Array:
        """Length, width and height (3,) [m]."""
        n_x, n_y = self.level.shape
        return np.array([n_x * PITCH, n_y * PITCH, BASE + self.level.max() * self.step])

    def block(self) -> Block:
        """Points of the dimples, numbered row by row, and the length to measure: along x."""
        tops = self.tops[self.reached]
        points = {str(k): top - [0.0, 0.0, CONE] for k, top in enumerate(tops, 1)}
        name = f"{self.robot.name} stairs {self.level.shape[0]} x {self.level.shape[1]}"
        return Block(
            name, self.robot.name, points, self.level.shape[0] * PITCH,
            rotation=self.rotation, translation=self.translation,
        )  # fmt: skip


def design_block(robot: Robot) -> BlockShape:
    """Size a block of stairs for the workspace of a robot, and stand it amid that.

    Its dimples look against the last way in which the tool comes: along a joint that slides, or the
    tool's own z axis. Raises CalibrationError if kinematics or workspace are not known, or fewer
    than twelve dimples can be reached.

    Examples
    --------
    >>> shape = design_block(truejoint.get_robot("raven2"))
    >>> len(shape.block().points) > 40
    True
    """
    chain, space = as_robot(robot).kinematics, robot.workspace
    if chain is None or space is None:
        raise CalibrationError(
            f"{robot.title}: a block takes known kinematics and a workspace; give its robot file "
            "the tables [kinematics] and [workspace]"
        )
    columns = robot.index(space.joints)
    pose = robot.home.copy()
    pose[columns] = space.centre
    axes = [np.linspace(a, b, _GRID) for a, b in zip(*_box(robot), strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(columns))
    joint = np.tile(pose, (len(grid), 1))
    joint[:, columns] = grid
    tip = chain.forward(joint)[:, :3, 3]
    rotation = _frame(robot, chain, pose, tip)
    points = tip @ rotation
    low, high = np.percentile(points, [2.0, 98.0], axis=0)
    count = np.clip(np.floor((high - low)[:2] / PITCH).astype(int), 2, MOST)
    x, y = np.meshgrid(np.arange(count[0]), np.arange(count[1]), indexing="ij")
    top = (count - 1) * [0.35, 0.6]
    level = np.round(np.maximum(np.abs(x - top[0]), np.abs(y - top[1]))).astype(np.int64)
    deep = np.floor(_MM * (high - low)[2] / level.max()) / _MM
    step = float(np.clip(deep, LOWEST_STEP, HIGHEST_STEP))
    middle = chain.forward(pose)[:3, 3]
    best = BlockShape(robot, level, step, np.ones(level.shape, dtype=np.bool_), rotation, middle)
    shape = None
    # Stairs reach further down than up from the middle of a workspace that is a shell: try.
    for down in np.linspace(0.2, 0.8, 7):
        height = BASE + level.max() * step * down
        shift = rotation @ np.array([*(0.5 * count * PITCH), height])
        stands = middle - shift
        reached = _reached(robot, best.tops.reshape(-1, 3) - [0, 0, CONE], rotation, stands, pose)
        if shape is None or reached.sum() > shape.reached.sum():
            shape = BlockShape(robot, level, step, reached.reshape(level.shape), rotation, stands)
    assert shape is not None  # noqa: S101  # seven were tried
    if shape.reached.sum() < 12:
        raise CalibrationError(
            f"{robot.title}: only {shape.reached.sum()} dimples of a block can be reached within "
            "its workspace; widen it in the robot file"
        )
    return shape


def block_stl(shape: BlockShape) -> bytes:
    """Block as a binary STL in millimetres, closed and all facets outward.

    Examples
    --------
    >>> shape = design_block(truejoint.get_robot("raven2"))
    >>> len(block_stl(shape)) % 50 == 84 % 50
    True
    """
    facets = np.array(_facets(shape), dtype=np.float64) * _MM
    normal = np.cross(facets[:, 1] - facets[:, 0], facets[:, 2] - facets[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    kind = np.dtype([("normal", "<f4", 3), ("vertices", "<f4", (3, 3)), ("more", "<u2")])
    table = np.zeros(len(facets), dtype=kind)
    table["normal"], table["vertices"] = normal, facets
    head = f"truejoint block for {shape.robot.name}, mm".encode()[:80].ljust(80)
    return head + len(facets).to_bytes(4, "little") + table.tobytes()


def block_svg(shape: BlockShape) -> str:
    """Drawing of the block from above, in true size: the number of each dimple, and its height.

    Examples
    --------
    >>> block_svg(design_block(truejoint.get_robot("raven2"))).startswith("<svg")
    True
    """
    n_x, n_y = shape.level.shape
    side, tops = PITCH * _MM, shape.tops * _MM
    numbers = iter(range(1, shape.level.size + 1))
    parts = []
    for i in range(n_x):
        for j in range(n_y):
            x, y = i * side, (n_y - 1 - j) * side
            grey = 235 - 22 * int(shape.level[i, j])
            parts.append(
                f'<rect x="{x:g}" y="{y:g}" width="{side:g}" height="{side:g}" '
                f'fill="rgb({grey},{grey},{grey})" stroke="#444" stroke-width="0.2"/>'
            )
            if not shape.reached[i, j]:
                continue
            middle = x + side / 2, y + side / 2
            radius = CONE * _MM
            ink = "#000" if grey > 150 else "#fff"
            parts.append(
                f'<circle cx="{middle[0]:g}" cy="{middle[1]:g}" r="{radius:g}" fill="none" '
                f'stroke="{ink}" stroke-width="0.2"/><text x="{middle[0]:g}" y="{y + 2.6:g}" '
                f'font-size="2.4" fill="{ink}" text-anchor="middle">{next(numbers)}</text>'
            )
    low, high = float(tops[..., 2].min()), float(tops[..., 2].max())
    wide, deep = n_x * side, n_y * side
    words = (
        f"{shape.block().name}, numbers as in the block's file",
        f"x to the right, {wide:g} mm: measure it",
        f"tops from {low:g} (dark) to {high:g} mm (light)",
    )
    for k, line in enumerate(words):
        parts.append(f'<text x="0" y="{deep + 4.5 + 4 * k:g}" font-size="3">{line}</text>')
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{wide + 4:g}mm" '
        f'height="{deep + 18:g}mm" viewBox="-2 -2 {wide + 4:g} {deep + 18:g}" '
        'font-family="sans-serif">\n' + "\n".join(parts) + "\n</svg>\n"
    )


def _box(robot: Robot) -> tuple[Array, Array]:
    """Give the ends of the workspace that dimples keep to (n_joints,) [rad or m]."""
    space = robot.workspace
    assert space is not None  # noqa: S101  # looked for by `design_block`
    return space.lower + _INSIDE * space.extent, space.upper - _INSIDE * space.extent


def _frame(robot: Robot, chain: Kinematics, pose: Array, tip: Array) -> Array:
    """Axes (3, 3) of the block: z against the tool's way in, x along where it reaches furthest."""
    sliding = [k for k, joint in enumerate(robot.joints) if joint.kind == "prismatic"]
    way = chain.jacobian(pose)[:3, sliding[0]] if sliding else chain.forward(pose)[:3, 2]
    z = -way / np.linalg.norm(way)
    across = (tip - tip.mean(axis=0)) @ (np.eye(3) - np.outer(z, z))
    x = np.linalg.svd(across, full_matrices=False)[2][0]
    x = x - (x @ z) * z
    x = x / np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


def _reached(robot: Robot, points: Array, rotation: Array, stands: Array, pose: Array) -> Mask:
    """Which points (m, 3) of the block the tip reaches within the workspace."""
    space = robot.workspace
    assert space is not None  # noqa: S101  # looked for by `design_block`
    joint, there = reach(robot, points @ rotation.T + stands, pose, space.joints)
    low, high = _box(robot)
    moved = joint[:, robot.index(space.joints)]
    return np.asarray(there & ((moved >= low) & (moved <= high)).all(axis=1))


def _facets(shape: BlockShape) -> list[list[Array]]:
    """Triangles [m], corners counter-clockwise from outside.

    The block is a grid of boxes, cut at every step's height, so that facets meet along whole edges.
    """
    steps = shape.level.max() - shape.level
    heights = np.concatenate([[0.0], BASE + shape.step * np.arange(steps.max() + 1)])
    solid = np.pad(np.arange(steps.max() + 1) <= steps[..., None], 1)
    axes, facets = np.eye(3, dtype=np.int64), []
    for axis, sign in product(range(3), (1, -1)):
        outside = ~np.roll(solid, -sign, axis)
        across, along = axes[(axis + 1) % 3], axes[(axis + 2) % 3]
        edges = (across, across + along, along) if sign > 0 else (along, across + along, across)
        for i, j, k in np.argwhere(solid & outside) - 1:
            if axis == 2 and sign > 0 and shape.reached[i, j]:
                facets += _dimple(i, j, heights[k + 1])
                continue
            first = np.array([i, j, k]) + (sign > 0) * axes[axis]
            a, b, c, d = (
                np.array([x * PITCH, y * PITCH, heights[z]])
                for x, y, z in (first, *(first + edge for edge in edges))
            )
            facets += [[a, b, c], [a, c, d]]
    return facets


def _dimple(i: int, j: int, z: float) -> list[list[Array]]:
    """Top of a cell with a conical dimple."""
    corners = [
        np.array([(i + a) * PITCH, (j + b) * PITCH, z]) for a, b in ((0, 0), (1, 0), (1, 1), (0, 1))
    ]
    middle = np.array([(i + 0.5) * PITCH, (j + 0.5) * PITCH, z])
    # The rim begins towards the first corner.
    angle = -0.75 * np.pi + 2 * np.pi * np.arange(_ROUND) / _ROUND
    rim = middle + CONE * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    tip, facets, quarter = middle - [0.0, 0.0, CONE], [], _ROUND // 4
    for k in range(_ROUND):
        a, b = rim[k], rim[(k + 1) % _ROUND]
        facets.append([a, b, tip])
        side, along = divmod(k, quarter)
        near = corners[side] if 2 * along < quarter else corners[(side + 1) % 4]
        facets.append([near, b, a])
        if 2 * along == quarter - 2 + quarter % 2:
            facets.append([corners[side], corners[(side + 1) % 4], b])
    return facets
