"""What a robot is: joints, units, limits, transmission and kinematics."""

from truejoint.robots.catalogue import adopt_robot, get_robot, robot_names
from truejoint.robots.robot import Joint, Kinematics, Robot, Transmission
from truejoint.robots.workspace import Workspace

__all__ = [
    "Joint",
    "Kinematics",
    "Robot",
    "Transmission",
    "Workspace",
    "adopt_robot",
    "get_robot",
    "robot_names",
]
