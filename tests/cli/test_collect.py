"""Tests of `truejoint collect` beyond those that all commands share."""

import json

import numpy as np
import pytest

from truejoint.crtk import SimulatedBackend, TruthBlock
from truejoint.motion import Trajectory, read_trajectory, write_trajectory
from truejoint.recordings import joint_encoders, read_parquet, read_recording

SHORT = "0.5,1.55,0.4\n0.5,1.57,0.4\n"  # of RAVEN-II


@pytest.fixture
def motion(call, tmp_path):
    return random_motion(call, tmp_path / "jaw.csv", 12)


def random_motion(call, path, duration_s):
    made = call(
        "trajectory", "random", "--robot", "forceps", "--duration-s", duration_s, "-o", path
    )
    assert made.code == 0
    return path


def test_a_forceps_is_collected_and_calibrated(call, motion, tmp_path):
    mine = tmp_path / "mine.toml"
    mine.write_text("[drive_encoder]\ninstalled = false\n")
    arguments = ("--robot", "forceps", "--twin", mine, "--load-grams", 20, "-o", tmp_path)
    assert call("collect", motion, *arguments, "--state-rate-hz", 200).code == 0
    recording = read_parquet(tmp_path / "jaw.parquet")
    assert recording.robot.name == "forceps"
    assert recording.joints_of("cable") == ("reset",)
    assert recording.provenance.load == 0.02
    assert recording.provenance.homing_id == "seed 0, homing 1"
    fitted = call("calibrate", tmp_path / "jaw.parquet", "-e", "linear", "-o", tmp_path / "m.st")
    assert fitted.code == 0, fitted.err


def test_stopping_replaces_no_whole_recording(call, motion, tmp_path, monkeypatch):
    arguments = ("collect", motion, "--robot", "forceps", "-o", tmp_path, "--force")
    assert call(*arguments).code == 0
    whole = (tmp_path / "jaw.parquet").read_bytes()
    run, samples = SimulatedBackend.servo_jp, []

    def stop_on_the_way(self, position, go_on):
        samples.extend(position)
        if len(samples) > 3000:
            raise KeyboardInterrupt
        return run(self, position, go_on)

    monkeypatch.setattr(SimulatedBackend, "servo_jp", stop_on_the_way)
    stopped = call(*arguments)
    assert stopped.code != 0
    assert "jaw.unfinished.stream" in stopped.err
    assert (tmp_path / "jaw.parquet").read_bytes() == whole
    fragment = read_recording(tmp_path / "jaw.unfinished.stream")
    assert fragment.provenance.notes == "stopped by KeyboardInterrupt"


def test_it_goes_on_where_it_was_stopped(call, motion, tmp_path):
    other = random_motion(call, tmp_path / "other.csv", 6)
    arguments = ("--robot", "forceps", "-o", tmp_path)
    assert call("collect", motion, *arguments).code == 0
    before = (tmp_path / "jaw.parquet").read_bytes()
    resumed = call("collect", motion, other, *arguments, "--resume")
    assert resumed.code == 0, resumed.err
    assert "jaw.parquet: recorded already" in resumed.err
    assert (tmp_path / "jaw.parquet").read_bytes() == before
    assert len(read_parquet(tmp_path / "other.parquet")) > 100
    nothing = call("collect", motion, other, *arguments, "--resume", "--json")
    assert nothing.code == 0
    assert json.loads(nothing.out) == {"recordings": []}
    assert "nothing is left to record" in nothing.err
    assert "Homing" not in nothing.err


def test_the_joint_itself_is_taken_along(call, tmp_path):
    motion = random_motion(call, tmp_path / "jaw.csv", 30)
    arguments = ("--robot", "forceps", "-o", tmp_path, "--state-rate-hz", 100)
    assert call("collect", motion, *arguments).code == 0
    model = tmp_path / "jaw.st"
    recording = tmp_path / "jaw.parquet"
    assert call("calibrate", recording, "-e", "play_reset", "-o", model).code == 0
    way = random_motion(call, tmp_path / "way.csv", 6)
    steered = ("--compensate", model, "--rezero-s", 2, "--seed", 4)
    made = call("collect", way, *arguments, *steered)
    assert made.code == 0, made.err
    assert "steps of the loop by what was said of the sample: OK" in made.err
    jaw = read_parquet(tmp_path / "way.parquet")
    wanted = read_trajectory(way).positions[-1, 0]
    truth, motor = (jaw.column(f"{of}/jaw")[-1] for of in ("truth", "measured"))
    assert abs(truth - wanted) < 0.2 * abs(motor - wanted)
    path = tmp_path / "short.csv"
    path.write_text(SHORT)
    refused = call("collect", path, "--compensate", model, "-o", tmp_path / "x")
    assert refused.code == 2
    assert "the calibration of forceps is not for raven2 (left arm); give one" in refused.err


def test_what_is_reported_keeps_to_the_trajectory(call, tmp_path):
    path, errors = tmp_path / "swing.csv", []
    t = np.arange(0.0, 4.0, 0.02)
    swing = Trajectory(("jaw",), ("rad",), 0.3 * np.sin(1.5 * t)[:, None], t)
    write_trajectory(swing, path)
    for number, options in enumerate(((), ("--closed-loop", "--lag-s", "0.019"))):
        folder = tmp_path / str(number)
        made = call("collect", path, "--robot", "forceps", "-o", folder, *options, "--json")
        assert made.code == 0, made.err
        errors.append(json.loads(made.out)["recordings"][0]["tracking"]["rms"])
    assert "steps of the loop by what was said of the sample: OK 100.0 %" in made.err
    assert (np.array(errors[1]) < 0.2 * np.array(errors[0])).all()


class FakeEncoders:
    """Says what is asked of joint encoders on a serial line, and tells one reading."""

    def __init__(self, port, encoders, *, clock):
        self.asked = FakeEncoders.asked = [port, len(encoders)]
        self.clock = clock

    def __enter__(self):
        self.asked.append("open")
        return self

    def __exit__(self, *_):
        self.asked.append("close")

    def start_registration(self):
        self.asked.append(f"start at {self.clock():.0f} s")

    def register(self):
        self.asked.append(f"register after {self.clock():.0f} s")

    def subscribe(self, callback):
        for t in (self.clock() + 0.1, self.clock() + 0.14):
            callback(TruthBlock(np.array([t]), ("elbow",), np.array([[1.25]])))

    def unsubscribe(self, callback):
        self.asked.append("unsubscribe")


def test_encoders_on_a_serial_line_are_registered_and_recorded(call, tmp_path, monkeypatch):
    monkeypatch.setattr(joint_encoders, "JointEncoders", FakeEncoders)
    path = tmp_path / "short.csv"
    path.write_text(SHORT)
    made = call("collect", path, "-o", tmp_path, "--encoders", "/dev/ttyX")
    assert made.code == 0, made.err
    assert FakeEncoders.asked == [
        "/dev/ttyX", 3, "open", "start at 0 s", "register after 13 s", "unsubscribe", "close",
    ]  # fmt: skip
    recording = read_parquet(tmp_path / "short.parquet")
    assert recording.joints_of("truth") == ("elbow",)
    assert np.nanmax(recording.column("truth/elbow")) == 1.25
