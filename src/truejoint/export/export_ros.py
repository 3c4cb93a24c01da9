"""Write a calibration as a ROS package: its C source, and a node around it for ROS 1 and 2."""

from __future__ import annotations

import os
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from truejoint.calibration.calibration import as_calibration
from truejoint.errors import ExportError
from truejoint.export.export_c import Precision, default_prefix, render, source_files, write_files
from truejoint.robots import Robot

if TYPE_CHECKING:
    from truejoint.calibration import Calibration

_TEMPLATES: Final = {
    "package.xml": "ros/package.xml.j2",
    "CMakeLists.txt": "ros/CMakeLists.txt.j2",
    "{}_joints.hpp": "ros/joints.hpp.j2",
    "{}_ros1.cpp": "ros/ros1.cpp.j2",
    "{}_ros2.cpp": "ros/ros2.cpp.j2",
}


def export_ros(
    calibration: Calibration,
    folder: str | os.PathLike[str],
    *,
    prefix: str | None = None,
    precision: Precision = "double",
    overwrite: bool = False,
    **how: Any,
) -> tuple[Path, ...]:
    """Write a calibration as a package of catkin and ament: subscribe, correct, publish.

    The node reads ``measured_js``, and ``setpoint_js`` where the model has set-points. Signals
    that only check measured positions are left out where no joint state has them.

    Parameters
    ----------
    calibration : Calibration
    folder : path-like
        Of the package; made if it does not exist.
    prefix, precision, overwrite, **how
        As `export_c` takes them.

    Returns
    -------
    tuple of Path
        What `export_c` gives, then the files of the package.

    Raises
    ------
    ExportError
        As `export_c`, or if the model takes a signal that is in no joint state.

    Examples
    --------
    >>> [path.name for path in export_ros(model, "package", prefix="jaw")][-3:]
    ['jaw_joints.hpp', 'jaw_ros1.cpp', 'jaw_ros2.cpp']
    """
    robot = as_calibration(calibration).machine
    if not all(_value(robot, signal) for signal in calibration.loop_signals):
        calibration = calibration.without_redundant()
    prefix = default_prefix(calibration) if prefix is None else prefix
    context = _context(calibration, robot, prefix)
    texts = {
        name.format(prefix): render(template, context, precision)
        for name, template in _TEMPLATES.items()
    }
    contents = source_files(calibration, prefix, precision, **how)
    contents |= {name: text.encode("ascii") for name, text in texts.items()}
    return write_files(folder, contents, overwrite=overwrite)


def _context(calibration: Calibration, robot: Robot, prefix: str) -> dict[str, Any]:
    signals = calibration.loop_signals
    values = [_value(robot, signal) for signal in signals]
    lacking = [name for name, value in zip(signals, values, strict=True) if not value]
    if lacking:
        raise ExportError(
            f"no joint state has {', '.join(lacking)}, which the model takes: calibrate on "
            "others (--feature), or use --to c"
        )
    return {
        "version": version("truejoint"),
        "title": calibration.title,
        "prefix": prefix,
        "guard": prefix.upper(),
        "inputs": [{"name": n, "value": v} for n, v in zip(signals, values, strict=True)],
        "joint_names": robot.joint_names,
        "corrected": robot.index(list(calibration.joints)),
        "corrected_names": calibration.joints,
        # Takes efforts on the joints to those at the motors.
        "motor_effort": None
        if robot.transmission is None or not _any(values, "motor")
        else robot.transmission.motor_effort(np.eye(len(robot.joint_names))),
        "needs_velocity": _any(values, "in.velocity"),
        "needs_effort": _any(values, "in.effort") or _any(values, "motor"),
        "needs_setpoint": _any(values, "setpoint_"),
    }


def _any(values: Sequence[str], array: str) -> bool:
    return any(value.startswith(array) for value in values)


def _value(robot: Robot, signal: str) -> str:
    """C++ of a signal in a joint state; empty where it is in none."""
    quantity, _, channel = signal.partition("/")
    effort = "in.effort" if robot.effort == "joint" or robot.transmission is None else "motor"
    arrays = {
        "measured": "in.position", "velocity": "in.velocity", "effort": effort,
        "setpoint": "setpoint_",
    }  # fmt: skip
    if quantity not in arrays:
        return ""
    if channel in robot.unused_channels:
        return "0.0"
    return f"{arrays[quantity]}[{robot.joint_names.index(channel)}]"
