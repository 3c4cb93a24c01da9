"""Every robot by name: truejoint's own, those of other packages, those of files."""

import os
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from importlib.resources import as_file, files
from pathlib import Path
from pkgutil import resolve_name
from types import FunctionType
from typing import TYPE_CHECKING, Any, Final

from truejoint.errors import RobotError, meant, unknown
from truejoint.plugins import call_plugin, load_plugin, plugins
from truejoint.toml_file import read_differences, shipped_table

if TYPE_CHECKING:  # a list of the names needs no NumPy
    from truejoint.robots.robot import Robot

_MODELS: Final = files(__package__) / "models"
INSTRUMENTS: Final = "instruments.toml"  # of a robot whose arms are instruments
DEFAULT: Final = "raven2"  # the robot of a command or a twin where none is named
# Without a name the arm of a RAVEN-II is the left, the one that peng2024 used.
_CODED: Final[Mapping[str, Mapping[str, str]]] = {
    "raven2": {"": "left", "left": "left", "gold": "left", "right": "right", "green": "right"},
    "wrist": {},  # its arms are the instruments of a file
}
"""Robots of which a part is computed: arm by every name it goes by. The package of that name,
imported when first asked for, has a `build` that takes an arm."""
_OWN: Final = (*_CODED, *sorted(f.name.removesuffix(".toml") for f in _MODELS.iterdir()))


def robot_names() -> tuple[str, ...]:
    """Names that `get_robot` knows without a file.

    Examples
    --------
    >>> "raven2" in robot_names()
    True
    """
    return (*_OWN, *plugins("truejoint.robots", _OWN))


def arm_names(name: str) -> tuple[str, ...]:
    """Names that `get_robot` takes for the arms of a robot of truejoint's own, or of a robot file.

    Raises RobotError if the file cannot be read.

    Examples
    --------
    >>> arm_names("raven2")
    ('left', 'gold', 'right', 'green')
    """
    model = name.strip().lower()
    if model in _CODED:
        return tuple(filter(None, _arms(model)))
    if not model.endswith(".toml") and model not in _OWN:
        return ()
    with as_file(_MODELS / f"{model}.toml" if model in _OWN else Path(name.strip())) as path:
        arms = read_differences(path, RobotError).get("arms", [])
    return tuple(map(str, arms)) if isinstance(arms, list) else ()


def get_robot(name: "str | os.PathLike[str] | Robot", arm: str = "") -> "Robot":
    """Robot arm by name, the same object each time, or of a robot file.

    Parameters
    ----------
    name : str, path-like or Robot
        One of `robot_names`, in any case, or the path of a TOML file, see docs/robots.md. A robot
        is given back.
    arm : str
        Name of the arm in any case; empty for the robot's default. The arms of ``raven2`` are
        ``left`` (or ``gold``, the default) and ``right`` (or ``green``), those of ``dvrk_psm``
        ``psm1`` to ``psm3``, those of ``wrist`` instruments by model number: ``420006``.

    Raises
    ------
    RobotError
        If there is no such robot or arm, the message then names those that exist, the file
        breaks a rule, or either is no text.

    Examples
    --------
    >>> get_robot("raven2", "gold").title
    'raven2 (left arm)'
    """
    from truejoint.robots.robot import Robot, read_robot  # noqa: PLC0415  # as above

    if isinstance(name, Robot) and arm in ("", name.arm):
        return name
    if not isinstance(name, str | os.PathLike) or not isinstance(arm, str):
        raise RobotError(
            f"robot {name!r:.60}, arm {arm!r:.60}: give the robot's name or the path of a robot "
            "file, and the arm's name, empty for the robot's default"
        )
    text = os.fspath(name).strip()
    if text.lower().endswith(".toml"):
        robot = read_robot(Path(text), arm)
        if (
            robot.name in robot_names()
            and robot.to_dict() != _build(robot.name.lower(), robot.arm).to_dict()
        ):
            raise RobotError(
                f"{text}: describes another robot called {robot.name!r} than truejoint or a "
                "package; give it another name"
            )
        return robot
    return _build(text.lower(), arm.strip().lower())


def robot_of(values: Mapping[str, Any], source: str) -> "Robot":
    """Robot that a file carries by `Robot.to_dict`; no name is made known by it.

    A robot of `robot_names` is the one that `get_robot` gives, whose kinematics may be code, with
    the cables that the file states.

    Raises RobotError if the description breaks a rule.

    Examples
    --------
    >>> robot_of(get_robot("bros").to_dict(), "a recording") is get_robot("bros")
    True
    """
    from truejoint import schema  # noqa: PLC0415  # as above
    from truejoint.robots.robot import Robot  # noqa: PLC0415

    robot = Robot.from_dict(values, source)
    if robot.name not in robot_names():
        return robot
    try:
        original = _build(robot.name.lower(), robot.arm)
    except RobotError as error:
        raise RobotError(f"{source}: {error}") from None
    cables = schema.plain(robot.mechanism)
    if cables is None or cables == schema.plain(original.mechanism):
        return original
    return replace(original, mechanism=robot.mechanism, transmission=robot.transmission)


@cache
def _arms(name: str) -> Mapping[str, str]:
    """Arm of a robot of which a part is computed, by every name it goes by."""
    if _CODED[name]:
        return _CODED[name]
    rows = shipped_table(__package__, f"{name}/{INSTRUMENTS}").values()
    arms = [str(arm) for row in rows for arm in row["names"]]
    return {"": arms[0], **{arm: arm for arm in arms}}


@cache
def _build(name: str, arm: str) -> "Robot":
    from truejoint.robots.robot import Robot, read_robot  # noqa: PLC0415  # as above

    if name in _CODED:
        arms = _arms(name)
        if arm not in arms:
            near, choices = meant(arm, arms), ", ".join(arm_names(name))
            raise RobotError(f"{name} has no arm called {arm!r};{near} its arms: {choices}")
        robot: Robot = resolve_name(f"truejoint.robots.{name}:build")(arms[arm])
        return robot
    if name in _OWN:
        with as_file(_MODELS / f"{name}.toml") as path:
            return read_robot(path, arm, source=name)
    point = plugins("truejoint.robots", _OWN).get(name)
    if point is None:
        raise RobotError(
            f"{unknown('robot', name, robot_names())}, or the path of a robot file (.toml)"
        )
    plugin = load_plugin(point, (Path, FunctionType))
    robot = read_robot(plugin, arm) if isinstance(plugin, Path) else call_plugin(point, plugin, arm)
    if not isinstance(robot, Robot) or robot.name != name:
        raise RobotError(f"truejoint.robots {name!r} of {point.value}: is no robot of that name")
    return robot
