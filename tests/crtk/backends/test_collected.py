"""A calibration collected over topics is as good as one of a twin inside, on a stepped clock."""

import numpy as np
import pytest
from tests.crtk.stepped_ros import SteppedRos

import truejoint
from truejoint.crtk import Arm, SimulatedBackend
from truejoint.crtk.messages import JOINT_STATE, TRUTH_TOPIC, joint_state_fields, profile_of
from truejoint.motion import follow, random_motion
from truejoint.recordings import Recorder
from truejoint.simulation import make_twin

SECONDS = 20.0
PERIOD = 10  # [ms] of the topics
ARMS = {"raven2": ("left", "/arm1", "raven2_mended"), "dvrk_psm": ("psm1", "/PSM1", "")}


class ServedTwin(SteppedRos):
    """A homed twin on topics."""

    def __init__(self, monkeypatch, name):
        arm, space, self.profile = ARMS[name]
        self.twin = make_twin(name, arm, seed=3)
        self.twin.home()
        super().__init__(monkeypatch, self.twin.robot, space, 1e3 / PERIOD)
        self.here = self.robot.home
        self.publisher(TRUTH_TOPIC, JOINT_STATE)

    def client(self):
        return self.arm(self.profile, truth=TRUTH_TOPIC, rate=self.rate)

    def report(self):
        share = np.arange(1, PERIOD + 1)[:, None] / PERIOD
        rows, self.here = self.here + share * (self.asked - self.here), self.asked
        out = self.twin.run(rows)
        columns = out.rows(slice(-1, None)).columns()
        self.say_state()
        setpoint = [columns[f"setpoint/{name}"][0] for name in self.robot.joint_names]
        self.say_joints(f"{self.space}/setpoint_js", setpoint, name=self.robot.joint_names)
        self.say(f"{self.space}/measured_js", "measured", columns)
        for k, stamp in enumerate(out.truth.t):
            row = {
                f"truth/{n}": out.truth.position[k : k + 1, j] for j, n in enumerate(out.truth.name)
            }
            self.say(TRUTH_TOPIC, "truth", row, self.t + stamp - out.t[-1])

    def say(self, topic, quantity, columns, t=None):
        profile = profile_of(self.robot, self.profile)
        names, fields = joint_state_fields(self.robot, quantity, topic, columns, profile)
        said = {name: values[0] for name, values in fields.items()}
        self.say_joints(topic, t=t, name=names, **said)


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
