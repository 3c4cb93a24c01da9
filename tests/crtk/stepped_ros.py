"""Robots on topics of this process, on a clock that goes on where a client would sleep."""

from types import SimpleNamespace

import numpy as np
from tests.local_ros import LocalRos

from truejoint.crtk import Arm
from truejoint.crtk.backends import ros
from truejoint.crtk.messages import JOINT_STATE, STRING_STAMPED


class SteppedRos(LocalRos):
    """A robot in namespace `space` that is at home, and has `report` called `rate` times a second.

    It takes each set-point in `take`, and any state command that CRTK has.
    """

    def __init__(self, monkeypatch, robot, space, rate):
        super().__init__()
        self.robot, self.space, self.rate, self.t = robot, space, rate, 100.0
        self.state, self.asked = "ENABLED", robot.home
        clock = {"monotonic": lambda: self.t, "perf_counter": lambda: self.t, "sleep": self.sleep}
        monkeypatch.setattr(ros, "time", SimpleNamespace(**clock))
        super().subscribe(f"{space}/servo_jp", JOINT_STATE, self.take)
        super().subscribe(f"{space}/state_command", STRING_STAMPED, self.obey)

    def arm(self, profile, **how):
        """Arm over its topics; a wait for them is a period long at most."""
        backend = ros.RosBackend(self, self.robot, profile, **how)
        backend._changed.wait = lambda timeout: self.sleep(min(timeout, 1.0 / self.rate))
        return Arm(backend)

    def now(self):
        return self.t

    def subscribe(self, *topic, **how):
        end = super().subscribe(*topic, **how)
        self.sleep(1.0 / self.rate)  # who reads it hears the next report
        return end

    def sleep(self, seconds):
        end = self.t + seconds
        first, last = (int(t * self.rate + 1e-6) for t in (self.t, end))
        for k in range(first + 1, last + 1):
            self.t = k / self.rate
            self.report()
        self.t = end

    def report(self):
        raise NotImplementedError

    def take(self, message):
        self.asked = np.array(message.position)

    def obey(self, message):
        self.state = {"pause": "PAUSED", "resume": "ENABLED"}[message.string]

    def say_state(self):
        state = self.stamped("crtk_msgs/OperatingState", self.t)
        state.state, state.is_homed = self.state, True
        self.send(f"{self.space}/operating_state", state)

    def say_joints(self, topic, position, t=None, **fields):
        joints = self.stamped(JOINT_STATE, self.t if t is None else t)
        for name, values in {"position": position, **fields}.items():
            setattr(joints, name, np.asarray(values).tolist())
        self.send(topic, joints)
