"""A CRTK client: the calls of rospy that crtk_python_client 1.4 makes for an arm.

By what it documents of its `crtk.utils` (collaborative-robotics/crtk_python_client:README.md):
``add_measured_js`` and the others subscribe and publish topics of these names and types, a move's
handle waits until the arm is busy and then is no more. Run on a ROS 1, for an arm that is homed:
``python3 crtk_client.py /arm1``; it fails where the arm does not do as CRTK says.
"""

import sys
import time

import genpy.dynamic
import rospy
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import JointState

# Of crtk_msgs, which Debian does not package, as their .msg files say.
HEADER = "=" * 80 + "\nMSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n"
STATE, TEXT = "crtk_msgs/OperatingState", "crtk_msgs/StringStamped"
OperatingState = genpy.dynamic.generate_dynamic(
    STATE, f"Header header\nstring state\nbool is_homed\nbool is_busy\n{HEADER}"
)[STATE]
StringStamped = genpy.dynamic.generate_dynamic(TEXT, f"Header header\nstring string\n{HEADER}")[
    TEXT
]


def until(is_so, what):
    """Look again and again, for two minutes."""
    end = time.monotonic() + 120.0
    while not is_so():
        if time.monotonic() > end:
            raise SystemExit(f"waited in vain for {what}")
        time.sleep(0.01)


class Client:
    """What is asked of an arm and what it says."""

    def __init__(self, space):
        self.said = {"measured_js": [], "setpoint_js": [], "measured_cp": [], "operating_state": []}
        kinds = {"measured_cp": PoseStamped, "operating_state": OperatingState}
        for name, messages in self.said.items():
            rospy.Subscriber(f"{space}/{name}", kinds.get(name, JointState), messages.append)
        asked = {
            "servo_jp": JointState, "move_jp": JointState, "move_cp": PoseStamped,
            "state_command": StringStamped,
        }  # fmt: skip
        self.asked = {
            name: rospy.Publisher(f"{space}/{name}", kind, queue_size=10)
            for name, kind in asked.items()
        }
        until(lambda: all(self.said.values()), "what the arm says")
        until(lambda: all(p.get_num_connections() for p in self.asked.values()), "who listens")

    def last(self, name):
        """Newest message."""
        return self.said[name][-1]

    def move(self, name, message):
        """Ask for a move, and wait for its end."""
        states = self.said["operating_state"]
        first = len(states)
        self.asked[name].publish(message)
        until(
            lambda: any(m.is_busy for m in states[first:]) and not states[-1].is_busy,
            f"the end of {name}",
        )

    def command(self, text, state):
        """Send a state command, and wait for what it leads to."""
        self.asked["state_command"].publish(StringStamped(string=text))
        until(lambda: self.last("operating_state").state == state, state)


def main():
    """Move joint and tool, pause, go on, servo."""
    rospy.init_node("crtk_client", anonymous=True)
    arm = Client(sys.argv[1])
    goal = list(arm.last("measured_js").position)
    goal[0] += 0.02
    arm.move("move_jp", JointState(position=goal))
    until(lambda: abs(arm.last("measured_js").position[0] - goal[0]) < 3e-3, "the joint")
    pose = arm.last("measured_cp")
    there = pose.pose.position.x + 2e-3
    pose.pose.position.x = there
    arm.move("move_cp", pose)
    until(lambda: abs(arm.last("measured_cp").pose.position.x - there) < 5e-4, "the tool")
    arm.command("pause", "PAUSED")
    arm.command("resume", "ENABLED")
    goal = list(arm.last("setpoint_js").position)
    goal[1] += 1e-4
    arm.asked["servo_jp"].publish(JointState(position=goal))
    until(lambda: abs(arm.last("setpoint_js").position[1] - goal[1]) < 1e-9, "the set-point")


main()
