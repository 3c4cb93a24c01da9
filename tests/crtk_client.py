"""CRTK clients, written by what crtk_python_client 1.4 and dvrk_python 2.4 ask of an arm.

By the topics and types that they document (collaborative-robotics/crtk_python_client:README.md,
jhu-dvrk/dvrk_python:src/dvrk/arm.py and psm.py): a move's handle hears the operating state,
message by message, until the arm was busy and is no more. Run on a ROS 1, for an arm that is
homed: ``python3 crtk_client.py /arm1``; it fails where the arm does not do as CRTK says.
"""

import math
import os
import sys
import threading
import time

import genmsg.msg_loader
import genpy.dynamic
import rospy
from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion, TwistStamped, WrenchStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Empty, Float64, Float64MultiArray

# Of crtk_msgs, which Debian does not package, as their .msg and .srv files say.
RULE = "=" * 80 + "\n"
HEADER = f"{RULE}MSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n"
STATE, TEXT = "crtk_msgs/OperatingState", "crtk_msgs/StringStamped"
OperatingState = genpy.dynamic.generate_dynamic(
    STATE, f"Header header\nstring state\nbool is_homed\nbool is_busy\n{HEADER}"
)[STATE]
StringStamped = genpy.dynamic.generate_dynamic(TEXT, f"Header header\nstring string\n{HEADER}")[
    TEXT
]
FORWARD = """\
float64[] jp
geometry_msgs/Pose cp
---
geometry_msgs/Pose cp
bool result
string message
"""
INVERSE = """\
geometry_msgs/Pose cp
float64[] jp
---
float64[] jp
bool result
string message
"""

SAYS = {
    "operating_state": OperatingState, "setpoint_js": JointState, "measured_js": JointState,
    "setpoint_cp": PoseStamped, "measured_cp": PoseStamped, "measured_cv": TwistStamped,
    "local/setpoint_cp": PoseStamped, "local/measured_cp": PoseStamped,
    "body/jacobian": Float64MultiArray, "spatial/jacobian": Float64MultiArray,
    "trajectory_j/ratio": Float64,
    "body/measured_cf": WrenchStamped, "spatial/measured_cf": WrenchStamped,
    "jaw/measured_js": JointState, "jaw/setpoint_js": JointState,
}  # fmt: skip
ASKED = {
    "state_command": StringStamped, "hold": Empty, "free": Empty, "servo_jp": JointState,
    "servo_jr": JointState, "servo_cp": PoseStamped, "servo_jf": JointState, "move_jp": JointState,
    "move_jr": JointState, "move_cp": PoseStamped, "body/servo_cf": WrenchStamped,
    "spatial/servo_cf": WrenchStamped, "body/set_cf_orientation_absolute": Bool,
    "use_gravity_compensation": Bool, "trajectory_j/set_ratio": Float64,
    "jaw/servo_jp": JointState, "jaw/move_jp": JointState, "jaw/servo_jf": JointState,
    "emulate_tool_present": Bool, "servo_cv": TwistStamped,
}  # fmt: skip


def service(kind, text):
    """Type of a service, as genmsg's own rules make it of its .srv file."""
    context = genmsg.MsgContext.create_default()
    parts = {"geometry_msgs/Point": Point, "geometry_msgs/Quaternion": Quaternion}
    for name, part in (*parts.items(), ("geometry_msgs/Pose", Pose)):
        fields = zip(part.__slots__, part._slot_types, strict=True)
        own = "\n".join(f"{type_} {field}" for field, type_ in fields)
        context.register(name, genmsg.msg_loader.load_msg_from_string(context, own, name))
    spec = genmsg.msg_loader.load_srv_from_string(context, text, kind)

    class Service:
        _type, _md5sum = kind, genmsg.compute_md5(context, spec)

    for side, own in zip(("Request", "Response"), text.split("---\n"), strict=True):
        full = f"{own}{RULE}MSG: geometry_msgs/Pose\n{Pose._full_text}"
        made = genpy.dynamic.generate_dynamic(kind + side, full)[kind + side]
        setattr(Service, f"_{side.lower()}_class", made)
    return Service


def until(is_so, what):
    """Look again and again, for two minutes."""
    end = time.monotonic() + 120.0
    while not is_so():
        if time.monotonic() > end:
            raise SystemExit(f"waited in vain for {what}")
        time.sleep(0.01)


def check(is_so, what):
    """Fail where it is not so."""
    if not is_so:
        raise SystemExit(what)


class Client:
    """What is asked of an arm and what it says: all that dvrk_python's `psm` connects to."""

    def __init__(self, space):
        self.said, self.heard = {name: [] for name in SAYS}, threading.Condition()
        subscribers = [
            rospy.Subscriber(f"{space}/{name}", kind, self.hear, name)
            for name, kind in SAYS.items()
        ]
        self.asked = {
            name: rospy.Publisher(f"{space}/{name}", kind, queue_size=2000)
            for name, kind in ASKED.items()
        }
        every = [*subscribers, *self.asked.values()]
        until(
            lambda: all(one.get_num_connections() for one in every),
            "somebody at " + ", ".join(o.name for o in every if not o.get_num_connections()),
        )
        until(lambda: all(self.said.values()), "what the arm says")
        self.forward, self.local_forward, self.inverse = (
            rospy.ServiceProxy(f"{space}/{name}", service(f"crtk_msgs/{kind}", text))
            for name, kind, text in (
                ("forward_kinematics", "QueryForwardKinematics", FORWARD),
                ("local/forward_kinematics", "QueryForwardKinematics", FORWARD),
                ("inverse_kinematics", "QueryInverseKinematics", INVERSE),
            )
        )

    def hear(self, message, name):
        """Keep a message."""
        with self.heard:
            self.said[name].append(message)
            self.heard.notify_all()

    def last(self, name):
        """Newest message."""
        return self.said[name][-1]

    def wait(self, is_so, what):
        """Hear states, one by one, until they were as is wanted; crtk's client recurses for each.

        A thousand deep Python gives up, so there may be no more than they come by CRTK: on change,
        and some ten a second.
        """
        states = self.said["operating_state"]
        first = k = len(states)
        with self.heard:
            while not is_so(states[first:k]):
                check(self.heard.wait_for(lambda: len(states) > k, 120.0), f"no {what}")  # noqa: B023
                k += 1
        took = (states[k - 1].header.stamp - states[first].header.stamp).to_sec()
        check(k - first <= 10 + 12.0 * took, f"{what}: {k - first} states in {took} s")

    def move(self, name, message):
        """Ask for a move, and wait until the arm was busy and is no more."""
        self.asked[name].publish(message)
        self.wait(lambda new: any(m.is_busy for m in new) and not new[-1].is_busy, f"end of {name}")

    def command(self, text, state):
        """Send a state command, and wait for what it leads to."""
        self.asked["state_command"].publish(StringStamped(string=text))
        self.wait(lambda new: bool(new) and new[-1].state == state, state)

    def stream(self, rate):
        """Follow a wave of 1 deg for a second, to whose end the arm must come."""
        start = list(self.last("setpoint_js").position)
        pace = rospy.Rate(rate)
        for k in range(1, rate + 1):
            goal = list(start)
            goal[0] += math.radians(0.5) * (1.0 - math.cos(1.5 * math.pi * k / rate))
            self.asked["servo_jp"].publish(JointState(position=goal))
            pace.sleep()
        until(
            lambda: abs(self.last("setpoint_js").position[0] - goal[0]) < 1e-9,
            f"the last set-point of {rate} Hz",
        )


def check_kinematics(arm):
    """Forward, inverse and the Jacobians agree with each other and with the topics."""
    joints = list(arm.last("setpoint_js").position)
    there = arm.forward(jp=joints)
    check(there.result, there.message)
    local = arm.local_forward(jp=joints)
    check(str(local.cp) == str(there.cp), f"local/forward_kinematics says {local}")
    pose = arm.last("setpoint_cp").pose
    off = math.dist(*((p.position.x, p.position.y, p.position.z) for p in (pose, there.cp)))
    check(off < 1e-6, f"the tool is {off} m from where its joints take it")
    back = arm.inverse(cp=there.cp, jp=joints)
    check(back.result, back.message)
    again = arm.forward(jp=back.jp).cp.position
    check(abs(again.x - there.cp.position.x) < 1e-6, "inverse and forward kinematics differ")
    check(not arm.forward(jp=joints[:3]).result, "three joints were taken for all")
    far = Pose(position=Point(x=9.0), orientation=Quaternion(w=1.0))
    refusal = arm.inverse(cp=far, jp=joints)
    check(not refusal.result and refusal.message, "a pose out of reach was reached")
    for name in ("body/jacobian", "spatial/jacobian"):
        sizes = [dimension.size for dimension in arm.last(name).layout.dim]
        check(sizes == [6, len(joints)], f"{name} is {sizes}")
        check(len(arm.last(name).data) == 6 * len(joints), f"{name} has {arm.last(name).data}")
    for name in ("body/measured_cf", "spatial/measured_cf"):
        stamp = arm.last(name).header.stamp.to_sec()
        check(
            stamp == 0.0, f"{name} is stamped {stamp}, but a twin does not know the tool's forces"
        )


def main():
    """Move joint and tool, pause, go on, servo."""
    rospy.init_node("crtk_client", anonymous=True)
    arm = Client(sys.argv[1])
    check_kinematics(arm)
    goal = list(arm.last("setpoint_js").position)
    goal[0] += 0.02
    arm.move("move_jp", JointState(position=goal))
    off = 0.01  # [rad] half the way: friction keeps the twin off by up to .4 deg
    until(lambda: abs(arm.last("measured_js").position[0] - goal[0]) < off, "the joint")
    arm.move("move_jp", JointState(position=goal))  # it is there already
    arm.move("move_jr", JointState(position=[-0.02, *[0.0] * (len(goal) - 1)]))
    pose = arm.last("setpoint_cp")
    there = pose.pose.position.x + 2e-3
    pose.pose.position.x = there
    arm.move("move_cp", pose)
    until(lambda: abs(arm.last("setpoint_cp").pose.position.x - there) < 1e-5, "the tool")
    opening = arm.last("jaw/setpoint_js").position[0] + 0.1
    arm.move("jaw/move_jp", JointState(position=[opening]))
    until(lambda: abs(arm.last("jaw/setpoint_js").position[0] - opening) < 1e-9, "the jaw")
    arm.command("pause", "PAUSED")
    arm.command("resume", "ENABLED")
    for name in ("free", "servo_jf", "jaw/servo_jf", "body/servo_cf", "use_gravity_compensation"):
        arm.asked[name].publish(ASKED[name]())  # refused, and nothing comes of it
    for rate in (100, 500, 1000):
        arm.stream(rate)
    arm.asked["hold"].publish(Empty())
    check(arm.last("operating_state").state == "ENABLED", "what is refused stopped the arm")


try:
    main()
except SystemExit as failure:
    sys.stderr.write(f"{failure}\n")
    sys.stderr.flush()
    os._exit(1)  # rospy's threads would keep the program
