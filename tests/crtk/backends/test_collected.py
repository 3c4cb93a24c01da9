"""A calibration collected over topics is as good as one of a twin inside, on a stepped clock."""

from types import SimpleNamespace

import numpy as np
import pytest
from tests.local_ros import LocalRos

import truejoint
from truejoint.crtk import Arm, SimulatedBackend
from truejoint.crtk.backends import ros
from truejoint.crtk.messages import (
    JOINT_STATE,
    STRING_STAMPED,
    TRUTH_TOPIC,
    joint_state_fields,
    profile_of,
)
from truejoint.motion import follow, random_motion
from truejoint.recordings import Recorder
from truejoint.simulation import make_twin

SECONDS = 40.0
PERIOD = 8  # [ms] of the topics
ARMS = {"raven2": ("left", "/arm1", "raven2_mended"), "dvrk_psm": ("psm1", "/PSM1", "")}


class ServedTwin(LocalRos):
    """A homed twin on topics that goes on, a period at a time, where the client would wait."""

    def __init__(self, monkeypatch, name):
        super().__init__()
        self.arm, self.space, self.profile = ARMS[name]
        self.twin = make_twin(name, self.arm, seed=3)
        self.twin.home()
        self.goal = self.here = self.twin.robot.home
        self.ticks = 0
        clock = {"monotonic": lambda: self.t, "perf_counter": lambda: self.t, "sleep": self.sleep}
        monkeypatch.setattr(ros, "time", SimpleNamespace(**clock))
        self.state = "ENABLED"
        super().subscribe(f"{self.space}/servo_jp", JOINT_STATE, self.take)
        super().subscribe(f"{self.space}/state_command", STRING_STAMPED, self.obey)
        self.publisher(TRUTH_TOPIC, JOINT_STATE)

    @property
    def t(self):
        return 1e3 + 1e-3 * self.ticks

    def now(self):
        return self.t

    def client(self):
        how = {"truth": TRUTH_TOPIC, "rate": 1e3 / PERIOD}
        backend = ros.RosBackend(self, self.twin.robot, self.profile, **how)
        backend._changed.wait = lambda timeout: self.sleep(min(timeout, 1e-3 * PERIOD))
        return Arm(backend)

    def subscribe(self, *topic, **how):
        end = super().subscribe(*topic, **how)
        self.sleep(0.0)
        return end

    def take(self, message):
        self.goal = np.array(message.position)

    def obey(self, message):
        self.state = {"pause": "PAUSED"}[message.string]

    def sleep(self, seconds):
        for _ in range(max(round(1e3 * seconds / PERIOD), 1)):
            self.ticks += PERIOD
            share = np.arange(1, PERIOD + 1)[:, None] / PERIOD
            rows, self.here = self.here + share * (self.goal - self.here), self.goal
            self.report(self.twin.run(rows))

    def report(self, out):
        state = self.stamped("crtk_msgs/OperatingState", self.t)
        state.state, state.is_homed = self.state, True
        self.send(f"{self.space}/operating_state", state)
        columns, robot = out.rows(slice(-1, None)).columns(), self.twin.robot
        setpoint = {"position": [columns[f"setpoint/{name}"] for name in robot.joint_names]}
        self.say(f"{self.space}/setpoint_js", self.t, robot.joint_names, setpoint)
        self.say(f"{self.space}/measured_js", self.t, *self.fields("measured", columns))
        for k, stamp in enumerate(out.truth.t):
            row = {
                f"truth/{n}": out.truth.position[k : k + 1, j] for j, n in enumerate(out.truth.name)
            }
            self.say(TRUTH_TOPIC, self.t + stamp - out.t[-1], *self.fields("truth", row))

    def fields(self, quantity, columns):
        topic = TRUTH_TOPIC if quantity == "truth" else f"{self.space}/{quantity}_js"
        profile = profile_of(self.twin.robot, self.profile)
        return joint_state_fields(self.twin.robot, quantity, topic, columns, profile)

    def say(self, topic, t, names, fields):
        message = self.stamped(JOINT_STATE, t)
        message.name = [*names]
        for field, values in fields.items():
            setattr(message, field, np.ravel(values).tolist())
        self.send(topic, message)


def recorded(arm, seed=1):
    with Recorder(arm, session=str(seed)) as recorder:
        follow(arm, random_motion(arm.robot, SECONDS, seed))
    return recorder.recording()


@pytest.mark.parametrize("name", ARMS)
def test_a_calibration_collected_over_topics_is_within_5_percent(monkeypatch, name):
    twin = make_twin(name, ARMS[name][0], seed=3)
    with Arm(SimulatedBackend(twin)) as inside:
        inside.enable()
        inside.home()
        alone, test = recorded(inside), recorded(inside, 2)
    with ServedTwin(monkeypatch, name).client() as client:
        over = recorded(client)
    assert len(over) == pytest.approx(len(alone), rel=0.1)
    rmse = []
    for recording in (alone, over):
        model = truejoint.calibrate(recording, "linear")
        judged = test.with_truth(model.joints)
        errors = judged.columns("truth", model.joints) - model.correct(judged)
        rmse.append(np.sqrt((errors**2).mean(axis=0)))
    ratio = rmse[1] / rmse[0]
    assert np.exp(np.log(ratio).mean()) < 1.05, ratio
