"""A block whose dimples a tool's tip touches: where they are, how large it is, where it stands."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np

from truejoint import schema
from truejoint.array_types import Array, floats
from truejoint.errors import CalibrationError
from truejoint.files import write_atomically
from truejoint.schema import Bounds, Key, Length, Positive, Shape
from truejoint.toml_file import read_toml

PRINT_SD: Final = 5e-3
"""Standard deviation of a print's size before it is measured, as a share of it."""
CALLIPER_SD: Final = 3e-5
"""Standard deviation of a calliper's reading [m]."""
TOUCH_SD: Final = 2e-4
"""Standard deviation of a tip from its dimple at rest, per axis [m]."""
_COMMENTS: Final = {
    "calliper_mm": "Measure the print here with a calliper and enter measured_mm = ... below.",
    "rotation": "Where it stands in the robot's base.",
    "references_mm": "Dimples that are bolted down on their own.",
    "points_mm": "Where the tip rests in each dimple, in the block's frame.",
    "covariance": "Of a turn about the block's axes [rad] and a shift along the base's [m].",
}
_LARGEST: Final = 10.0  # coordinate [m]
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
        Where the tip rests in each dimple, by the number beside it, as designed [m].
    calliper : float
        Length to measure, between two faces, as designed [m].
    measured : float
        The same by a calliper [m]; NaN until somebody measures it.
    rotation, translation : ndarray, shape (3, 3) and (3,)
        Where it is meant to stand in the robot's base [m], within a hand's breadth.
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
            object.__setattr__(self, key, self._checked(getattr(self, key)))
        if not 0.0 < self.calliper < 1.0:
            raise CalibrationError(f"block {self.name}: calliper length {self.calliper:g} m")
        if not (math.isnan(self.measured) or abs(self.measured / self.calliper - 1.0) < 0.03):
            raise CalibrationError(
                f"block {self.name}: the calliper says {self.measured / _MM:g} mm of "
                f"{self.calliper / _MM:g} mm; more than 3 % off is another print: measure again"
            )
        check_rotation(self.rotation)

    def _checked(self, stated: Mapping[str, Array]) -> dict[str, Array]:
        points: dict[str, Array] = {}
        for number, values in stated.items():
            points[number] = point = floats(values, f"dimple {number}", CalibrationError)
            if point.shape != (3,) or not (np.abs(point) < _LARGEST).all():
                raise CalibrationError(
                    f"block {self.name}: dimple {number} is at {point.tolist()} m; want three "
                    f"numbers of less than {_LARGEST:g} m"
                )
        return points

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
                f"block {self.name} has no dimple {strange[0]!r:.20} (it has "
                f"{len(self.points)}); is this the block that was touched?"
            )
        return np.array([points[number] for number in dimples])


@dataclass(frozen=True, eq=False)
class BlockPose:
    """Where a bolted block stands in a robot's base.

    Attributes
    ----------
    block : Block
    robot, arm : str
        Whose base it is.
    rotation : ndarray, shape (3, 3)
        Of the block in the base.
    translation : ndarray, shape (3,)
        Of its origin [m].
    covariance : ndarray, shape (6, 6)
        Of a turn about the block's axes [rad] and a shift along the base's [m].
    scale, scale_sd : float
        How much larger the print is than its design, and the standard deviation of that.
    joint_sd : ndarray, shape (n_joints,)
        What the calibration leaves of each joint it corrects, by the touches that found the pose
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
            raise CalibrationError(
                "covariance is not positive definite; was the file edited? Find the pose again"
            )

    @property
    def title(self) -> str:
        """Block and base for a person."""
        return f"{self.block.name} in the base of {self.robot} {self.arm}".rstrip()


def check_rotation(rotation: Array) -> None:
    """Refuse a matrix (3, 3) that is not a rotation."""
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-9 or np.linalg.det(rotation) < 0:
        raise CalibrationError(
            "rotation is not a rotation matrix; was the file edited? Make it again"
        )


def read_block(path: str | os.PathLike[str]) -> Block:
    """Read a block file (docs/touch.md); raises CalibrationError naming the key that is wrong.

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
    >>> block = Block("test", "raven2", {"1": np.zeros(3)}, calliper=0.08)
    >>> pose = BlockPose(block, "raven2", "left", np.eye(3), np.zeros(3), np.eye(6), 1.0, 0.001)
    >>> write_pose(pose, Path("pose.toml"))
    >>> read_pose(Path("pose.toml")).title
    'test in the base of raven2 left'
    """
    values = read_toml(Path(path), CalibrationError)
    return schema.read(BlockPose, values, str(path), CalibrationError)


def write_pose(pose: BlockPose, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
    """Write the pose of a bolted block as TOML; raises CalibrationError if that fails.

    Examples
    --------
    >>> block = Block("test", "raven2", {"1": np.zeros(3)}, calliper=0.08)
    >>> where = np.eye(3), np.zeros(3), np.eye(6)
    >>> write_pose(BlockPose(block, "raven2", "left", *where, 1.0, 0.001), Path("pose.toml"))
    """
    write = partial(Path.write_text, data=_toml(schema.plain(pose)), encoding="utf-8")
    write_atomically(Path(path), write, overwrite=overwrite, error=CalibrationError)


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
