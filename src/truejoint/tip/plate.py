"""A block whose dimples a tool's tip touches: where they are, how large it is, where it stands."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from truejoint.array_types import Array, floats
from truejoint.errors import CalibrationError
from truejoint.files import write_atomically
from truejoint.toml_file import read_toml

PRINT_SD: Final = 5e-3
"""How far a print may be off in size, as a share of it, before it is measured."""
CALLIPER_SD: Final = 3e-5
"""Of a calliper's reading [m]."""
TOUCH_SD: Final = 2e-4
"""How far off its dimple a tip rests, per axis [m]."""
_LARGEST: Final = 1.0  # that a coordinate may be [m]
_MM: Final = 1e-3
_PLATE_KEYS: Final = (
    "name", "robot", "calliper_mm", "measured_mm", "points_mm", "rotation", "translation_mm",
)  # fmt: skip
_POSE_KEYS: Final = (
    "plate", "robot", "arm", "found", "homing_id", "model_sha256", "rotation", "translation_m",
    "covariance", "scale", "scale_sd", "joint_sd", "points_mm",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Plate:
    """Dimples of a block in its own frame.

    Attributes
    ----------
    name : str
        Which block this is.
    robot : str
        That its size is meant for.
    points : mapping of str to ndarray, shape (3,)
        Where the tip rests in each dimple, by the number beside it, as designed [m].
    calliper : float
        Length to measure, between two faces, as designed [m].
    measured : float
        What a calliper says of it [m]; NaN where nobody has measured.
    rotation, translation : ndarray, shape (3, 3) and (3,)
        Where it is meant to stand in the robot's base [m], within a hand's breadth.

    Raises
    ------
    CalibrationError
        If there are no dimples, a number is out of range, or the measured length is not within 3 %.

    Examples
    --------
    >>> points = {"1": np.zeros(3), "2": np.array([0.01, 0.0, 0.0])}
    >>> round(Plate("test", "raven2", points, calliper=0.08, measured=0.0802).scale, 4)
    1.0025
    """

    name: str
    robot: str
    points: Mapping[str, Array]
    calliper: float
    measured: float = math.nan
    rotation: Array = field(default_factory=lambda: np.eye(3))
    translation: Array = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        if not isinstance(self.points, Mapping) or not self.points:
            raise CalibrationError(f"plate {self.name}: it has no dimples; give its points by name")
        points = {
            name: floats(point, f"dimple {name}", CalibrationError)
            for name, point in self.points.items()
        }
        object.__setattr__(self, "points", points)
        for number, point in points.items():
            if point.shape != (3,) or not (np.abs(point) < _LARGEST).all():
                raise CalibrationError(
                    f"plate {self.name}: dimple {number} is at {point.tolist()} m; want three "
                    f"numbers of less than {_LARGEST:g} m"
                )
        if not 0.0 < self.calliper < _LARGEST:
            raise CalibrationError(f"plate {self.name}: calliper length {self.calliper:g} m")
        if not (math.isnan(self.measured) or abs(self.measured / self.calliper - 1.0) < 0.03):
            raise CalibrationError(
                f"plate {self.name}: the calliper says {self.measured / _MM:g} mm of "
                f"{self.calliper / _MM:g} mm; more than 3 % off is another print: measure again"
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
        strange = [number for number in dimples if number not in self.points]
        if strange:
            raise CalibrationError(
                f"plate {self.name} has no dimple {strange[0]!r:.20} (it has "
                f"{len(self.points)}); is this the plate that was touched?"
            )
        return np.array([self.points[number] for number in dimples])


@dataclass(frozen=True, eq=False)
class BlockPose:
    """Where a bolted block stands in a robot's base.

    Attributes
    ----------
    plate : Plate
    robot, arm : str
        Whose base it is.
    rotation : ndarray, shape (3, 3)
        Of the block in the base.
    translation : ndarray, shape (3,)
        Of its origin [m].
    covariance : ndarray, shape (6, 6)
        Of a turn about the block's axes [rad] and a shift along the base's [m].
    scale, scale_sd : float
        How much larger the print is than its design, and how surely.
    joint_sd : ndarray, shape (n_joints,)
        What the calibration leaves of each joint it corrects, as the touches that found the pose
        saw it [rad or m]; empty where they did not.
    found : str
        When, as ISO 8601.
    homing_id, model_sha256 : str
        Homing of the arm, and training data of the model, that it was found with.

    Examples
    --------
    >>> plate = Plate("test", "raven2", {"1": np.zeros(3)}, calliper=0.08)
    >>> where = np.eye(3), np.zeros(3), np.eye(6)
    >>> BlockPose(plate, "raven2", "left", *where, 1.0, 0.001).title
    'test in the base of raven2 left'
    """

    plate: Plate
    robot: str
    arm: str
    rotation: Array
    translation: Array
    covariance: Array
    scale: float
    scale_sd: float
    joint_sd: Array = field(default_factory=lambda: np.empty(0))
    found: str = ""
    homing_id: str = ""
    model_sha256: str = ""

    @property
    def title(self) -> str:
        """Plate and base for a person."""
        return f"{self.plate.name} in the base of {self.robot} {self.arm}".rstrip()


def read_plate(path: str | os.PathLike[str]) -> Plate:
    """Read a plate file (docs/touch.md); raises CalibrationError naming the key that is wrong.

    Examples
    --------
    >>> write_plate(Plate("test", "raven2", {"1": np.zeros(3)}, calliper=0.08), Path("p.toml"))
    >>> read_plate(Path("p.toml")).calliper
    0.08
    """
    path = Path(path)
    values = read_toml(path, CalibrationError)
    _check_keys(values, _PLATE_KEYS, ("name", "robot", "calliper_mm", "points_mm"), path)
    measured = values.get("measured_mm")
    try:
        return Plate(
            _text(values["name"], "name"),
            _text(values["robot"], "robot"),
            _points(values["points_mm"]),
            _number(values["calliper_mm"], "calliper_mm") * _MM,
            math.nan if measured is None else _number(measured, "measured_mm") * _MM,
            _rotation(values.get("rotation", np.eye(3).tolist())),
            _row(values.get("translation_mm", [0, 0, 0]), "translation_mm") * _MM,
        )
    except CalibrationError as error:
        raise CalibrationError(f"{path}: {error}") from None


def write_plate(plate: Plate, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
    """Write a plate file; raises CalibrationError where that cannot be.

    Examples
    --------
    >>> write_plate(Plate("test", "raven2", {"1": np.zeros(3)}, calliper=0.08), Path("p.toml"))
    """
    _write(Path(path), plate_text(plate), overwrite)


def plate_text(plate: Plate) -> str:
    """Text of a plate file, which `read_plate` reads."""
    measured = "" if math.isnan(plate.measured) else f"measured_mm = {plate.measured / _MM:.6g}\n"
    return (
        f"name = {json.dumps(plate.name)}\nrobot = {json.dumps(plate.robot)}\n"
        "# Measure the print here with a calliper and enter measured_mm = ... below.\n"
        f"calliper_mm = {plate.calliper / _MM:.6g}\n{measured}"
        "# Where it is meant to stand in the robot's base, within a hand's breadth.\n"
        f"rotation = {json.dumps(plate.rotation.round(12).tolist())}\n"
        f"translation_mm = {json.dumps((plate.translation / _MM).round(1).tolist())}\n\n"
        "# Where the tip rests in each dimple, in the block's frame.\n"
        f"[points_mm]\n{_points_text(plate)}"
    )


def read_pose(path: str | os.PathLike[str]) -> BlockPose:
    """Read the pose of a bolted block; raises CalibrationError naming the key that is wrong.

    Examples
    --------
    >>> plate = Plate("test", "raven2", {"1": np.zeros(3)}, calliper=0.08)
    >>> pose = BlockPose(plate, "raven2", "left", np.eye(3), np.zeros(3), np.eye(6), 1.0, 0.001)
    >>> write_pose(pose, Path("pose.toml"))
    >>> read_pose(Path("pose.toml")).title
    'test in the base of raven2 left'
    """
    path = Path(path)
    values = read_toml(path, CalibrationError)
    _check_keys(values, _POSE_KEYS, _POSE_KEYS, path)
    try:
        points = _points(values["points_mm"])
        plate = Plate(_text(values["plate"], "plate"), "", points, 0.1)
        texts = {
            key: _text(values[key], key)
            for key in ("robot", "arm", "found", "homing_id", "model_sha256")
        }
        rotation = _rotation(values["rotation"])
        covariance = _matrix(values["covariance"], (6, 6), "covariance")
        if not (np.linalg.eigvalsh(covariance) > 0.0).all():
            raise CalibrationError("covariance is none; was the file edited? Find the pose again")
        scale = _number(values["scale"], "scale")
        if not scale > 0.0:
            raise CalibrationError(f"scale is {scale:g}; was the file edited? Find the pose again")
        return BlockPose(
            plate,
            rotation=rotation,
            translation=_row(values["translation_m"], "translation_m"),
            covariance=covariance,
            scale=scale,
            scale_sd=_number(values["scale_sd"], "scale_sd"),
            joint_sd=_joint_sd(values["joint_sd"]),
            **texts,
        )
    except CalibrationError as error:
        raise CalibrationError(f"{path}: {error}") from None


def write_pose(pose: BlockPose, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
    """Write the pose of a bolted block as TOML; raises CalibrationError where that cannot be.

    Examples
    --------
    >>> plate = Plate("test", "raven2", {"1": np.zeros(3)}, calliper=0.08)
    >>> where = np.eye(3), np.zeros(3), np.eye(6)
    >>> write_pose(BlockPose(plate, "raven2", "left", *where, 1.0, 0.001), Path("pose.toml"))
    """
    texts = {
        "plate": pose.plate.name, "robot": pose.robot, "arm": pose.arm, "found": pose.found,
        "homing_id": pose.homing_id, "model_sha256": pose.model_sha256,
    }  # fmt: skip
    body = "".join(f"{key} = {json.dumps(text)}\n" for key, text in texts.items())
    body += f"scale = {float(pose.scale)!r}\nscale_sd = {float(pose.scale_sd)!r}\n"
    body += f"joint_sd = {json.dumps(pose.joint_sd.tolist())}\n"
    body += f"rotation = {json.dumps(pose.rotation.tolist())}\n"
    body += f"translation_m = {json.dumps(pose.translation.tolist())}\n"
    body += "# Of a turn about the block's axes [rad] and a shift along the base's [m].\n"
    body += f"covariance = {json.dumps(pose.covariance.tolist())}\n"
    body += f"\n[points_mm]\n{_points_text(pose.plate)}"
    _write(Path(path), body, overwrite)


def _write(path: Path, text: str, overwrite: bool) -> None:
    write = partial(Path.write_text, data=text, encoding="utf-8")
    write_atomically(path, write, overwrite=overwrite, error=CalibrationError)


def _points_text(plate: Plate) -> str:
    return "".join(
        f"{json.dumps(number)} = [{', '.join(f'{x / _MM:.4f}' for x in point)}]\n"
        for number, point in plate.points.items()
    )


def _check_keys(
    values: Mapping[str, Any], known: tuple[str, ...], needed: tuple[str, ...], path: Path
) -> None:
    odd = sorted(set(values) - set(known))
    missing = [key for key in needed if key not in values]
    if odd or missing:
        what = f"key {odd[0]!r:.40} is not known" if odd else f"{missing[0]} is missing"
        raise CalibrationError(f"{path}: {what}; it has {', '.join(known)}")


def _points(value: Any) -> dict[str, Array]:
    if not isinstance(value, Mapping) or len(value) > 1000:
        raise CalibrationError("points_mm: want a table of up to 1000 dimples, 1 = [x, y, z]")
    return {str(n): _row(xyz, f"points_mm.{n}") * _MM for n, xyz in value.items()}


def _row(value: Any, what: str) -> Array:
    return np.asarray(_matrix([value], (1, 3), what)[0])


def _joint_sd(value: Any) -> Array:
    sd = _matrix([value], (1, len(value) if isinstance(value, list) else 0), "joint_sd")[0]
    if not (sd >= 0.0).all():
        raise CalibrationError("joint_sd is below 0; was the file edited? Find the pose again")
    return np.asarray(sd)


def _rotation(value: Any) -> Array:
    rotation = _matrix(value, (3, 3), "rotation")
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-9 or np.linalg.det(rotation) < 0:
        raise CalibrationError("rotation is none; was the file edited? Make it again")
    return rotation


def _matrix(value: Any, shape: tuple[int, int], what: str) -> Array:
    rows = value if isinstance(value, list) else []
    good = len(rows) == shape[0] and all(isinstance(r, list) and len(r) == shape[1] for r in rows)
    if not good:
        raise CalibrationError(f"{what} is {value!r:.40}; want {shape[0]} x {shape[1]} numbers")
    return np.array([[_number(x, what) for x in row] for row in rows])


def _number(value: Any, what: str) -> float:
    good = isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e6
    if not good:
        raise CalibrationError(f"{what} is {value!r:.40}; want a number")
    return float(value)


def _text(value: Any, what: str) -> str:
    if not isinstance(value, str) or len(value) > 200:
        raise CalibrationError(f"{what} is {value!r:.40}; want a text")
    return value
