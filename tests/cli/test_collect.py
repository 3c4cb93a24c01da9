"""Tests of `truejoint collect` beyond those that all commands share."""

import json
from pathlib import Path

import numpy as np
import pytest

from truejoint.crtk import SimulatedBackend, TruthBlock
from truejoint.motion import Trajectory, read_trajectory, write_trajectory
from truejoint.recordings import joint_encoders, read_parquet, read_recording

SHORT = "0.5,1.55,0.4\n0.5,1.57,0.4\n"  # of RAVEN-II


@pytest.fixture
def jaw(call):
    """Call the command for the forceps, after a random motion of so many seconds was written."""

    def collect(name, duration_s, how="", run=call.good):
        if not Path(f"{name}.csv").exists():
            motion = f"trajectory random --robot forceps --duration-s {duration_s}"
            call.good(f"{motion} -o {name}.csv")
        return run(f"collect {name}.csv --robot forceps -o . {how}")

    return collect


def test_a_forceps_is_collected_and_calibrated(call, jaw):
    Path("mine.toml").write_text("[drive_encoder]\ninstalled = false\n")
    jaw("jaw", 12, "--twin mine.toml --load-grams 20 --state-rate-hz 200")
    recording = read_parquet("jaw.parquet")
    assert recording.robot.name == "forceps"
    assert recording.joints_of("cable") == ("reset",)
    assert recording.provenance.load == 0.02
    assert recording.provenance.command.startswith("truejoint collect jaw.csv")
    assert recording.provenance.homing_id == "seed 0, homing 1"
    call.good("calibrate jaw.parquet -e linear -o m.st")


def test_stopping_replaces_no_whole_recording(call, jaw, monkeypatch):
    jaw("jaw", 12)
    whole = Path("jaw.parquet").read_bytes()
    run, samples = SimulatedBackend.servo_jp, []

    def stop_on_the_way(self, position, go_on):
        samples.extend(position)
        if len(samples) > 3000:
            raise KeyboardInterrupt
        return run(self, position, go_on)

    monkeypatch.setattr(SimulatedBackend, "servo_jp", stop_on_the_way)
    stopped = jaw("jaw", 12, "--force", run=call)
    assert stopped.code != 0
    assert "jaw.unfinished.stream" in stopped.err
    assert Path("jaw.parquet").read_bytes() == whole
    fragment = read_recording("jaw.unfinished.stream")
    assert fragment.provenance.notes == "stopped by KeyboardInterrupt"


def test_it_goes_on_where_it_was_stopped(call, jaw):
    jaw("jaw", 12)
    before = Path("jaw.parquet").read_bytes()
    call.good("trajectory random --robot forceps --duration-s 6 -o other.csv")
    again = "collect jaw.csv other.csv --robot forceps -o . --resume"
    assert "jaw.parquet: recorded already" in call.good(again).err
    assert Path("jaw.parquet").read_bytes() == before
    assert len(read_parquet("other.parquet")) > 100
    said = call.good(again).err
    assert "nothing is left to record" in said
    assert "Homing" not in said
    assert call.json(again) == {"recordings": []}


def test_the_joint_itself_is_taken_along(call, jaw):
    jaw("jaw", 30, "--state-rate-hz 100")
    call.good("calibrate jaw.parquet -e play_reset -o jaw.st")
    made = jaw("way", 6, "--state-rate-hz 100 --compensate jaw.st --rezero-s 2 --seed 4")
    assert "steps of the loop by status: OK" in made.err
    recording, goal = read_parquet("way.parquet"), read_trajectory("way.csv").positions[-1, 0]
    truth, motor = (recording.column(f"{of}/jaw")[-1] for of in ("truth", "measured"))
    assert abs(truth - goal) < 0.2 * abs(motor - goal)
    Path("short.csv").write_text(SHORT)
    said = "the calibration of forceps is not for raven2 (left arm); give one"
    call.refuses(said, "collect short.csv --compensate jaw.st -o x")


def test_what_is_reported_keeps_to_the_trajectory(call):
    t, errors = np.arange(0.0, 4.0, 0.02), []
    swing = Trajectory(("jaw",), ("rad",), 0.3 * np.sin(1.5 * t)[:, None], t)
    write_trajectory(swing, "swing.csv")
    for folder, options in (("a", ""), ("b", "--closed-loop --lag-s 0.019")):
        made = call.good(f"collect swing.csv --robot forceps -o {folder} {options} --json")
        errors.append(json.loads(made.out)["recordings"][0]["tracking"]["rms"])
    assert "steps of the loop by status: OK 100.0 %" in made.err
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


def test_encoders_on_a_serial_line_are_registered_and_recorded(call, monkeypatch):
    monkeypatch.setattr(joint_encoders, "JointEncoders", FakeEncoders)
    Path("short.csv").write_text(SHORT)
    call.good("collect short.csv -o . --encoders /dev/ttyX")
    assert FakeEncoders.asked == [
        "/dev/ttyX", 3, "open", "start at 0 s", "register after 13 s", "unsubscribe", "close",
    ]  # fmt: skip
    recording = read_parquet("short.parquet")
    assert recording.joints_of("truth") == ("elbow",)
    assert np.nanmax(recording.column("truth/elbow")) == 1.25


def test_what_is_too_fast_is_refused_before_anything_moves(call):
    for name, times in {"slow": [0.0, 9.0], "fast": [0.0, 0.01]}.items():
        joints, units = ("shoulder", "elbow", "insertion"), ("rad", "rad", "m")
        path = [[0.5, 1.55, 0.4], [0.7, 1.57, 0.4]]
        write_trajectory(Trajectory(joints, units, path, times), f"{name}.csv")
    told = call.refuses("shoulder would move at", "collect slow.csv fast.csv -o out")
    assert "Homing" not in told
    assert not Path("out").exists()
