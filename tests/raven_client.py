"""RAVEN-II's controller, written by what uw-biorobotics/raven2_CRTK_Python_controller sends.

Its interface alone: `servo_jr` of fifteen increments, at most 500 a second, from ``measured_js`` of
/arm2, which has the left arm's joints. Go-to, random motion and following are by the numbers of
python_controller/run_r2_goto.py, run_r2_random_joint_movement.py and run_r2_trajectory_follow.py.
Run beside ``truejoint node simulate --homed --quirks``: ``python3 raven_client.py SECONDS``; it
prints how far off the path the joints were (RMS of three), and fails where the arm does not follow.
"""

import math
import os
import random
import sys
import threading

import rospy
from sensor_msgs.msg import JointState

RATE = 500.0
STEP = 1e-3  # [s] of motion a message
SPEED = (math.radians(3.0), math.radians(3.0), 0.01)
NEAR = (math.radians(1.0), math.radians(1.0), 5e-3)
LOW = (math.radians(20.0), math.radians(55.0), 0.33)
HIGH = (math.radians(60.0), math.radians(110.0), 0.42)
MOST = (math.radians(2.182), math.radians(3.0), 5e-3)


class Controller:
    """Increments out, joints in."""

    def __init__(self):
        self.joints, self.heard = None, threading.Event()
        rospy.Subscriber("/arm2/measured_js", JointState, self.hear)
        self.out = rospy.Publisher("/arm1/servo_jr", JointState, queue_size=1, latch=True)
        self.pace = rospy.Rate(RATE)
        if not self.heard.wait(120.0):
            raise SystemExit("no /arm2/measured_js")

    def hear(self, message):
        """Keep the joints."""
        self.joints = message.position
        self.heard.set()

    def move(self, speed):
        """Send one increment of three joints, at these speeds [rad/s or m/s]."""
        self.out.publish(JointState(position=[*(STEP * v for v in speed), *[0.0] * 12]))
        self.pace.sleep()

    def go_to(self, goal):
        """Go there as fast as is allowed; a joint that is near stands."""
        for _ in range(round(60.0 * RATE)):
            left = [g - j for g, j in zip(goal, self.joints)]
            if all(abs(e) < near for e, near in zip(left, NEAR)):
                return
            self.move(
                [
                    0.0 if abs(e) < near else max(-v, min(v, e / STEP))
                    for e, near, v in zip(left, NEAR, SPEED)
                ]
            )
        raise SystemExit(f"go-to ends {left} off")

    def wander(self, seconds):
        """Swing each joint between places drawn anew; an arm that turns has come there."""
        goals, turns = list(HIGH), 0
        for _ in range(round(seconds * RATE)):
            speed = []
            for k, (low, high) in enumerate(zip(LOW, HIGH)):
                if abs(goals[k] - self.joints[k]) < NEAR[k]:
                    goals[k] = random.uniform(low, high)  # noqa: S311  # a motion
                    turns += 1
                speed.append(math.copysign(SPEED[k], goals[k] - self.joints[k]))
            self.move(speed)
            if not all(a - n <= j <= b + n for a, j, b, n in zip(LOW, self.joints, HIGH, NEAR)):
                raise SystemExit(f"random motion left the range: {self.joints[:3]}")
        return turns

    def follow(self, path, seconds):
        """Follow a path: on to the nearest of the next ten points, a hundred points ahead."""
        at, stuck, squares = 0, 0, [0.0] * 3
        count = round(seconds * RATE)
        for _ in range(count):
            last = len(path) - 1
            near = min(range(at, min(at + 10, last) + 1), key=lambda k: self.away(path[k]))
            stuck = (stuck + 1) % 10 if near == at else 0
            at = min(near + (near == at and not stuck), last)
            squares = [s + (p - j) ** 2 for s, p, j in zip(squares, path[at], self.joints)]
            ask = [2.0 * (g - j) for g, j in zip(path[min(at + 100, last)], self.joints)]
            self.move([max(-v, min(v, a)) for a, v in zip(ask, MOST)])
        return [math.sqrt(s / count) for s in squares], at

    def away(self, point):
        """Square of how far off a point of the path is, radians and metres alike."""
        return sum((p - j) ** 2 for p, j in zip(point, self.joints))


def main():
    """Go there, wander, follow a zig-zag."""
    seconds = float(sys.argv[1])
    rospy.init_node("raven_client", anonymous=True)
    random.seed(1)
    arm = Controller()
    start = [j + 1.5 * n for j, n in zip(arm.joints, NEAR)]
    arm.go_to(start)
    turns = arm.wander(seconds)
    arm.go_to(start)
    start, path = arm.joints, []
    for k in range(round(seconds * 150.0)):  # up and down, slowly sideways
        swing = abs((k / 1000.0 + 1.0) % 2.0 - 1.0)
        path.append([start[0] + 2e-5 * k, start[1] + 0.2 * swing, start[2] + 2e-6 * k])
    off, at = arm.follow(path, seconds)
    shoulder, elbow, insertion = math.degrees(off[0]), math.degrees(off[1]), 1e3 * off[2]
    sys.stdout.write(
        f"{turns} turns; off the path by {shoulder:.3f} deg, {elbow:.3f} deg, {insertion:.3f} mm; "
        f"{at} of {len(path)} points\n"
    )
    if at < len(path) // 4 or shoulder > 1.0 or elbow > 1.0 or insertion > 1.0:
        raise SystemExit("the arm does not follow")


try:
    main()
except SystemExit as failure:
    sys.stderr.write(f"{failure}\n")
    sys.stderr.flush()
    os._exit(1)  # rospy's threads would keep the program
