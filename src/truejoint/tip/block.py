"""A block whose dimples a tool's tip touches: its points, where it stands, its shape to print.

A block of stairs is sized for a robot, and drawn as STL.
"""

import json
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay

from truejoint import schema
from truejoint.array_types import Array, Mask, floats
from truejoint.errors import CalibrationError
from truejoint.files import write_atomically
from truejoint.robots.chain import reach
from truejoint.robots.parts import Kinematics
from truejoint.robots.robot import Robot, as_robot
from truejoint.schema import Bounds, Key, Length, Positive, Shape
from truejoint.toml_file import read_toml

# Standard deviations: of a print's size before it is measured, as a share of it; of a calliper's
# reading [m]; and of a tip from its dimple at rest, per axis [m].
PRINT_SD: Final = 5e-3
CALLIPER_SD: Final = 3e-5
TOUCH_SD: Final = 2e-4
_COMMENTS: Final = {
    "calliper_mm": "Measure the print here with a calliper and enter measured_mm = ... below.",
    "rotation": "Where it stands in the robot's base.",
    "references_mm": "Dimples that are bolted down on their own.",
    "points_mm": "Place at which the tip rests in each dimple, in the block's frame.",
    "covariance": "Of a turn about the block's axes [rad] and a shift along the base's [m].",
}
_LARGEST: Final = 10.0  # coordinate [m]
PITCH: Final = 10e-3  # between dimples [m]
MOST: Final = 9  # dimples along a side
HIGHEST_STEP: Final = 12e-3  # m; a wrist reaches further beyond its shaft, which so passes it
LOWEST_STEP: Final = 1e-3  # m, of a workspace that is hardly deep: a plane leaves a turn open
BASE: Final = 10e-3  # below the lowest step [m]
CONE: Final = 2e-3  # radius and depth of a dimple [m]
_ROUND: Final = 24  # points of a dimple's rim
_INSIDE: Final = 0.05  # of the workspace that dimples keep from its ends, for what cables lose
_GRID: Final = 7
_MM: Final = 1e-3

_Text = Annotated[str, Length(0, 200)]


@dataclass(frozen=True, eq=False)
class Block:
    """Dimples of a block in its own frame.

    Attributes
    ----------
    name : str
        Which block this is.
    robot : str
        For whose size it was designed.
    points : mapping of str to ndarray, shape (3,)
        Place at which the tip rests in each dimple, by the number beside it, as designed [m].
    calliper : float
        Length to measure, between two faces, as designed [m].
    measured : float
        The same by a calliper [m]; NaN until somebody measures it.
    rotation, translation : ndarray, shape (3, 3) and (3,)
        Planned place in the robot's base [m], within a hand's breadth.
    references : mapping of str to ndarray, shape (3,)
        Dimples that are bolted down on their own, and show whether the block moves [m]: in its
        frame, within 20 mm, and in a `BlockPose` as they were found.

    Raises
    ------
    CalibrationError
        If there are no dimples, a number is out of range, the rotation is not a rotation matrix,
        or the measured length is not within 3 %.

    Examples
    --------
    >>> points = {"1": np.zeros(3), "2": np.array([0.01, 0.0, 0.0])}
    >>> round(Block("test", "raven2", points, calliper=0.08, measured=0.0802).scale, 4)
    1.0025
    """

    name: _Text
    robot: _Text
    points: Annotated[Mapping[str, Array], Key("points_mm", _MM), Length(0, 1000)]
    calliper: Annotated[float, Key("calliper_mm", _MM)]
    measured: Annotated[float, Key("measured_mm", _MM)] = math.nan
    rotation: Annotated[Array, Shape((3, 3))] = field(default_factory=lambda: np.eye(3))
    translation: Annotated[Array, Shape((3,)), Key("translation_mm", _MM)] = field(
        default_factory=lambda: np.zeros(3)
    )
    references: Annotated[Mapping[str, Array], Key("references_mm", _MM), Length(0, 100)] = field(
        default_factory=dict
    )

    def __post_init__(self) -> None:
        if not isinstance(self.points, Mapping) or not self.points:
            raise CalibrationError(f"block {self.name}: it has no dimples; give its points by name")
        if both := set(self.points) & set(self.references):
            raise CalibrationError(
                f"block {self.name}: {min(both)} is a dimple and a reference; name them apart"
            )
        for key in ("points", "references"):
            points = dict(getattr(self, key))
            for name, values in points.items():
                points[name] = at = floats(values, f"dimple {name}", CalibrationError)
                if at.shape != (3,) or not (np.abs(at) < _LARGEST).all():
                    raise CalibrationError(
                        f"block {self.name}: dimple {name} is at {at.tolist()} m; want three "
                        f"numbers of less than {_LARGEST:g} m"
                    )
            object.__setattr__(self, key, points)
        if not 0.0 < self.calliper < 1.0:
            raise CalibrationError(f"block {self.name}: calliper length {self.calliper:g} m")
        if not (math.isnan(self.measured) or abs(self.measured / self.calliper - 1.0) < 0.03):
            raise CalibrationError(
                f"block {self.name}: the calliper says {self.measured / _MM:g} mm of "
                f"{self.calliper / _MM:g} mm; more than 3 % off is another print: measure again"
            )
        check_rotation(self.rotation)

    def check_robot(self, robot: Robot) -> None:
        """Raise CalibrationError if it was designed for another robot."""
        if self.robot not in ("", robot.name):  # points of a tracker are for any
            raise CalibrationError(
                f"block {self.name} is for {self.robot}, not {robot.title}; design one for it"
            )

    @property
    def scale(self) -> float:
        """How much larger the print is than its design, by the calliper; 1 where unmeasured."""
        return 1.0 if math.isnan(self.measured) else self.measured / self.calliper

    @property
    def scale_sd(self) -> float:
        """Standard deviation of `scale`."""
        return PRINT_SD if math.isnan(self.measured) else CALLIPER_SD / self.calliper

    def at(self, dimples: tuple[str, ...]) -> Array:
        """Points (m, 3) of dimples by number [m]; raises CalibrationError for one it has not."""
        points = {**self.points, **self.references}
        strange = [number for number in dimples if number not in points]
        if strange:
            raise CalibrationError(
                f"block {self.name} has no dimple {strange[0]!r:.20}; is this the one touched?"
            )
        return np.array([points[number] for number in dimples])


@dataclass(frozen=True, eq=False)
class BlockPose:
    """Pose of a bolted block in a robot's base.

    Attributes
    ----------
    block : Block
    robot, arm : str
        Robot whose base it is.
    rotation : ndarray, shape (3, 3)
        Rotation of the block in the base.
    translation : ndarray, shape (3,)
        Place of its origin [m].
    covariance : ndarray, shape (6, 6)
        Covariance of a turn about the block's axes [rad] and a shift along the base's [m].
    scale, scale_sd : float
        How much larger the print is than its design, and the standard deviation of that.
    joint_sd : ndarray, shape (n_joints,)
        Error that the calibration leaves of each joint, by the touches that found the pose
        [rad or m]; empty if they did not show it.
    date : str
        When the pose was found, as ISO 8601.
    homing_id, model_sha256 : str
        Homing of the arm, and training data of the model, that it was found with.

    Raises
    ------
    CalibrationError
        If the rotation is not a rotation matrix, or the covariance not positive definite.

    Examples
    --------
    >>> block = Block("test", "raven2", {"1": np.zeros(3)}, calliper=0.08)
    >>> where = np.eye(3), np.zeros(3), np.eye(6)
    >>> BlockPose(block, "raven2", "left", *where, 1.0, 0.001).title
    'test in the base of raven2 left'
    """

    block: Block
    robot: _Text
    arm: _Text
    rotation: Annotated[Array, Shape((3, 3))]
    translation: Annotated[Array, Shape((3,)), Key("translation_m"), Bounds(-1e6, 1e6)]
    covariance: Annotated[Array, Shape((6, 6))]
    scale: Positive
    scale_sd: Annotated[float, Bounds(0.0, 1e6)]
    joint_sd: Annotated[Array, Shape((None,)), Bounds(0.0, 1e6)] = field(
        default_factory=lambda: np.empty(0)
    )
    date: _Text = ""
    homing_id: _Text = ""
    model_sha256: _Text = ""

    def __post_init__(self) -> None:
        check_rotation(self.rotation)
        if not (np.linalg.eigvalsh(self.covariance) > 0.0).all():
            raise CalibrationError("covariance is not positive definite; find the pose again")

    @property
    def title(self) -> str:
        """Block and base for a person."""
        return f"{self.block.name} in the base of {self.robot} {self.arm}".rstrip()


def check_rotation(rotation: Array) -> None:
    """Refuse a matrix (3, 3) that is not a rotation."""
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-9 or np.linalg.det(rotation) < 0:
        raise CalibrationError("rotation is not a rotation matrix; was the file edited?")


def read_block(path: str | os.PathLike[str]) -> Block:
    """Read a block file (docs/formats.md); raises CalibrationError naming the key that is wrong.

    Examples
    --------
    >>> text = block_text(Block("test", "raven2", {"1": np.zeros(3)}, calliper=0.08))
    >>> _ = Path("p.toml").write_text(text)
    >>> read_block(Path("p.toml")).calliper
    0.08
    """
    values = read_toml(Path(path), CalibrationError)
    return schema.read(Block, values, str(path), CalibrationError)


def block_text(block: Block) -> str:
    """Text of a block file, which `read_block` reads; lengths are rounded to 0.1 um."""
    return _toml(schema.plain(block), digits=4)


def read_pose(path: str | os.PathLike[str]) -> BlockPose:
    """Read the pose of a bolted block; raises CalibrationError naming the key that is wrong.

    Examples
    --------
    >>> read_pose("none.toml")
    Traceback (most recent call last):
    truejoint.errors.CalibrationError: ...
    """
    values = read_toml(Path(path), CalibrationError)
    return schema.read(BlockPose, values, str(path), CalibrationError)


def write_pose(pose: BlockPose, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
    """Write the pose of a bolted block as TOML; raises CalibrationError if that fails.

    Examples
    --------
    >>> block = Block("test", "raven2", {"1": np.zeros(3)}, calliper=0.08)
    >>> where = np.eye(3), np.zeros(3), np.eye(6)
    >>> write_pose(BlockPose(block, "raven2", "left", *where, 1.0, 0.001), "pose.toml")
    >>> read_pose("pose.toml").title
    'test in the base of raven2 left'
    """
    data = _toml(schema.plain(pose)).encode()
    write_atomically(Path(path), data, overwrite=overwrite, error=CalibrationError)


def _toml(values: Mapping[str, Any], name: str = "", digits: int | None = None) -> str:
    """Plain values as TOML, tables last; numbers of keys in mm are rounded to `digits`."""
    text, tables = "", ""
    for key, value in values.items():
        comment = f"# {_COMMENTS[key]}\n" if key in _COMMENTS else ""
        if isinstance(value, Mapping):
            path = f"{name}.{key}".lstrip(".")
            tables += f"\n{comment}[{path}]\n{_toml(value, path, digits)}"
            continue
        if digits is not None and (name + key).endswith("_mm"):
            value = np.round(value, digits).tolist()  # noqa: PLW2901
        written = json.dumps(value)
        text += f"{comment}{json.dumps(key) if name.endswith('_mm') else key} = {written}\n"
    return text + tables


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
        Planned place of the block in the robot's base [m].

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

    def stl(self) -> bytes:
        """Binary STL in millimetres, closed and all facets outward."""
        facets = np.array(_facets(self), dtype=np.float64) * 1e3
        normal = np.cross(facets[:, 1] - facets[:, 0], facets[:, 2] - facets[:, 0])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        kind = np.dtype([("normal", "<f4", 3), ("vertices", "<f4", (3, 3)), ("more", "<u2")])
        table = np.zeros(len(facets), dtype=kind)
        table["normal"], table["vertices"] = normal, facets
        head = f"truejoint block for {self.robot.name}, mm".encode()[:80].ljust(80)
        return head + len(facets).to_bytes(4, "little") + table.tobytes()

    def map(self) -> str:
        """Numbers of the dimples from above, as comments of a block's file."""
        numbers = np.zeros(self.level.shape, dtype=np.int64)
        numbers[self.reached] = np.arange(1, self.reached.sum() + 1)
        rows = ["".join(f"{k or '.':>4}" for k in row) for row in numbers.T[::-1].tolist()]
        head = "# Numbers of the dimples from above, x to the right, y up:"
        return "\n".join([head, *(f"# {row}" for row in rows)]) + "\n"

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
            f"{robot.title}: its file needs [kinematics] and [workspace], which size a block"
        )
    columns, pose = robot.index(space.joints), robot.home.copy()
    pose[columns] = space.centre
    ends = space.lower + _INSIDE * space.extent, space.upper - _INSIDE * space.extent
    joint = np.tile(pose, (_GRID ** len(columns), 1))
    joint[:, columns] = list(product(*np.linspace(*ends, _GRID).T))
    tip = chain.forward(joint)[:, :3, 3]
    rotation = _frame(robot, chain, pose, tip)
    low, high = np.percentile(tip @ rotation, [2.0, 98.0], axis=0)
    count = np.clip(np.floor((high - low)[:2] / PITCH).astype(int), 2, MOST)
    x, y = np.indices(count)
    top = (count - 1) * [0.35, 0.6]
    level = np.round(np.maximum(np.abs(x - top[0]), np.abs(y - top[1]))).astype(np.int64)
    deep = np.floor(1e3 * (high - low)[2] / level.max()) / 1e3
    step = float(np.clip(deep, LOWEST_STEP, HIGHEST_STEP))
    middle = chain.forward(pose)[:3, 3]
    everywhere = np.ones(level.shape, dtype=np.bool_)
    whole = BlockShape(robot, level, step, everywhere, rotation, middle)
    bottoms, shapes = whole.tops.reshape(-1, 3) - [0, 0, CONE], []
    # Stairs reach further down than up from the middle of a workspace that is a shell: try.
    for down in np.linspace(0.2, 0.8, 7):
        shift = rotation @ np.array([*(0.5 * count * PITCH), BASE + level.max() * step * down])
        there, is_near = reach(chain, columns, bottoms @ rotation.T + middle - shift, pose)
        moved = there[:, columns]
        reached = is_near & ((moved >= ends[0]) & (moved <= ends[1])).all(axis=1)
        at = reached.reshape(level.shape)
        shapes.append(replace(whole, reached=at, translation=middle - shift))
    shape = max(shapes, key=lambda each: each.reached.sum())
    if shape.reached.sum() < 12:
        raise CalibrationError(
            f"{robot.title}: only {shape.reached.sum()} dimples of a block can be reached; widen "
            "the workspace in its file"
        )
    return shape


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


def _facets(shape: BlockShape) -> list[Array]:
    """Triangles [m], corners counter-clockwise from outside.

    The block is a grid of boxes, cut at every step's height, so that facets meet along whole edges.
    """
    steps = shape.level.max() - shape.level
    heights = np.concatenate([[0.0], BASE + shape.step * np.arange(steps.max() + 1)])
    solid = np.pad(np.arange(steps.max() + 1) <= steps[..., None], 1)
    axes, facets = np.eye(3, dtype=np.int64), list[Array]()
    for axis, sign in product(range(3), (1, -1)):
        outside = ~np.roll(solid, -sign, axis)
        across, along = axes[(axis + 1) % 3], axes[(axis + 2) % 3]
        edges = (across, across + along, along) if sign > 0 else (along, across + along, across)
        for i, j, k in np.argwhere(solid & outside) - 1:
            if axis == 2 and sign > 0 and shape.reached[i, j]:
                facets.extend(_dimple(i, j, heights[k + 1]))
                continue
            first = np.array([i, j, k]) + (sign > 0) * axes[axis]
            x, y, z = np.array([first, *(first + edge for edge in edges)]).T
            corners = np.column_stack([x * PITCH, y * PITCH, heights[z]])
            facets += [corners[[0, 1, 2]], corners[[0, 2, 3]]]
    return facets


def _dimple(i: int, j: int, z: float) -> Array:
    """Triangles of the top of a cell with a conical dimple, whose bottom is its middle."""
    angle = 2 * np.pi * np.arange(_ROUND) / _ROUND
    rim = [0.5, 0.5] + CONE / PITCH * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    flat = np.vstack([[(0, 0), (1, 0), (1, 1), (0, 1)], rim, [0.5, 0.5]])
    points = np.column_stack([(flat + np.array([i, j])) * PITCH, np.full(len(flat), z)])
    points[-1, 2] -= CONE
    return np.asarray(points[Delaunay(flat).simplices])
