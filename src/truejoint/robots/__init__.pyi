from .catalogue import adopt_robot as adopt_robot
from .catalogue import get_robot as get_robot
from .catalogue import robot_names as robot_names
from .robot import Joint as Joint
from .robot import Kinematics as Kinematics
from .robot import Robot as Robot
from .robot import Transmission as Transmission
from .robot import Workspace as Workspace
