"""Tests of the arm that a command drives or looks at: over topics, and what is asked before."""

import json
import sys
import threading
from contextlib import ExitStack, suppress
from types import SimpleNamespace

import numpy as np
import pytest
import typer
from tests.crtk.instant_twin import InstantTwin
from tests.local_ros import LocalRos

import truejoint
from truejoint.cli import driven_arm, monitor
from truejoint.crtk import Arm, PacedBackend, protocol
from truejoint.crtk.backends import ros as backends
from truejoint.crtk.server import ArmServer
from truejoint.crtk.states import OperatingState
from truejoint.monitor import pages
from truejoint.robots.blocks import TruthBlock
from truejoint.simulation import TwinOutput

TRUTH = "/ext_jpos"
OFFSET = np.array([0.02, -0.03, 0.001])  # of the served joints from what the motors say
INPUTS = ["measured/shoulder", "measured/elbow", "measured/insertion"]
LONG = 60.0  # [s]


class OffTwin(InstantTwin):
    """A twin whose joints stand off, and whose sensors say so."""

    def run(self, setpoint):
        out = super().run(setpoint)
        joint, trembles = out.joint + OFFSET, 1e-6 * np.sin(1e3 * out.t)[:, None]
        truth = TruthBlock(out.t, self.robot.positioning, joint)
        said = {"measured": out.measured + trembles, "effort": out.effort + trembles}
        return TwinOutput(**{**vars(out), **said, "truth": truth, "joint": joint})


@pytest.fixture
def arm(monkeypatch):
    """An arm that is homed and served in this process; commands find its topics."""
    for place in (backends, sys.modules["truejoint.crtk.arm"], protocol):
        monkeypatch.setattr(place, "SILENCE", LONG)  # on a busy machine
    monkeypatch.setattr(backends, "CONNECT_TIMEOUT", LONG)
    ros = LocalRos()
    ros.close = lambda: None
    monkeypatch.setattr("truejoint.crtk.ros.open_transport", lambda *_: ros)
    with ExitStack() as stack:
        served = stack.enter_context(Arm(PacedBackend(OffTwin(), homed=True)))
        stack.enter_context(ArmServer(served, ros, "raven2_mended", rate=100.0))
        served.ros = ros
        yield served


@pytest.fixture(scope="module")
def model(session, tmp_path_factory):
    """A model of that arm as it was before it stood off, with no more than its fixed offset."""
    raw = truejoint.read_recording(session / "zigzag.parquet")
    table = raw.table.copy()
    for joint in raw.joints_of("truth"):
        table[f"truth/{joint}"] = table[f"measured/{joint}"]
    still = truejoint.Recording(table, raw.units, raw.provenance)
    path = tmp_path_factory.mktemp("model") / "m.safetensors"
    truejoint.write_calibration(truejoint.calibrate(still, "offset", features=INPUTS), path)
    return path


OVER = "--ros 2 --profile raven2_mended"
BRIEF = f"{OVER} --duration-s 1 --truth"


@pytest.mark.parametrize("typed", ["raven2", "raven2:left"])
def test_it_moves_once_its_name_is_typed(call, session, monkeypatch, typed):
    joined = []

    def join(*how):
        joined.append(how)
        raise typer.Abort

    monkeypatch.setattr(sys.stdin, "isatty", lambda: True)
    monkeypatch.setattr(typer, "prompt", lambda *_, **__: typed)
    monkeypatch.setattr(driven_arm, "joined", join)
    told = call(f"collect {session}/random.csv -o new --ros 2")
    if typed == "raven2":
        assert told.code == 2
        assert "nothing was moved" in told.err
    assert bool(joined) == (typed == "raven2:left")


def test_check_looks_on_and_rezero_mends(call, arm, model, monkeypatch):
    commands = []
    for name, kind in (("state_command", "crtk_msgs/StringStamped"), ("servo_jp", None)):
        arm.ros.subscribe(f"/arm1/{name}", kind or "sensor_msgs/JointState", commands.append)
    said = call.good(f"check {model} {BRIEF} {TRUTH} --json")
    assert "Recording raven2 (left arm) for 1 s ..." in said.err
    offsets = [joint["offset"] for joint in json.loads(said.out)["joints"]]
    assert offsets == pytest.approx(OFFSET, abs=2e-3)
    done = call.good(f"rezero {model} {BRIEF} {TRUTH} -o mended.safetensors")
    assert f"re-zeroed by the truth of {TRUTH}" in done.out
    mended = truejoint.read_calibration("mended.safetensors")
    assert mended.offset == pytest.approx(OFFSET, abs=2e-3)
    assert not commands
    assert arm.operating_state().state == "ENABLED"

    def subscribe(topic, *what, **how):
        end = LocalRos.subscribe(arm.ros, topic, *what, **how)
        if topic == "/arm1/io/pot/measured_js":
            arm.ros.send(topic, SimpleNamespace(position=[], name=[]))
        return end

    monkeypatch.setattr(arm.ros, "subscribe", subscribe)
    line = f"rezero {model} {OVER} --duration-s 1 --potentiometers -o new.st"
    call.refuses("keeps no reference of potentiometers", line)  # and needs no truth


def test_the_monitor_shows_it_and_leaves_it(call, arm, model, monkeypatch):
    conditions, corrected = [], []

    class Page:
        url = "http://127.0.0.1:0"

        def __init__(self, robot, on_command, **place):
            self.press = on_command

        def show(self, row, condition):
            conditions.append(condition.state)
            if row is not None and np.isfinite(row.corrected).any():
                corrected.append(row)

        def close(self):
            pass

    shown = []
    monkeypatch.setattr(
        pages, "PageProcess", lambda *a, **k: shown.append(Page(*a, **k)) or shown[-1]
    )

    def look():
        arm.ros.wait_for("/arm1/measured_js", lambda _: len(corrected) > 2)
        for button, state in (("pause", "PAUSED"), ("resume", "ENABLED")):
            shown[0].press(button)
            assert arm.operating_state().state == state
        raise KeyboardInterrupt

    monkeypatch.setattr(monitor, "_wait", look)
    said = call.good(f"monitor {OVER} --truth {TRUTH} --model {model} --port 0")
    assert "Open http" in said.out
    assert "Homing" not in said.err
    off = corrected[-1].truth[0, :3] - corrected[-1].reported[0, :3]
    assert off == pytest.approx(OFFSET, abs=1e-5)
    assert truejoint.read_calibration(model).redundant  # motors, of which topics do not tell
    assert arm.operating_state().state == "ENABLED"  # as it was before


def test_a_person_touches_with_it_while_it_is_looked_at(call, arm, model, tmp_path, monkeypatch):
    asked, commands = [], []
    arm.ros.subscribe("/arm1/state_command", "crtk_msgs/StringStamped", commands.append)
    monkeypatch.setattr(typer, "prompt", lambda text, **_: asked.append(text))
    call.good("touch block raven2 -o .")
    touches, line = tmp_path / "touches.csv", f"touch run {model} --block block.toml {OVER}"
    call.good(f"{line} --count 6 -o touches.csv")
    dimples = [line.split(",")[1] for line in touches.read_text().splitlines()[1:]]
    assert dimples == list(dict.fromkeys(text.split(",")[0].split()[1] for text in asked))
    reported = truejoint.read_recording(tmp_path / "touches.parquet").table["measured/elbow"]
    assert reported.to_numpy() == pytest.approx(arm.robot.home[1], abs=1e-3)
    assert not commands
    call.refuses("--ros and --twin: give one of the two", f"{line} --twin worn -o touches.csv")


@pytest.mark.usefixtures("hasty")
def test_it_goes_where_it_is_told(call, arm):
    goals = "--go-to shoulder=40 --go-to insertion=385mm"
    said = call.good(f"teleop {OVER} {goals} --yes-move-it")
    reached = said.out.partition("shoulder ")[2].split()[0]
    assert float(reached) == pytest.approx(40.0, abs=0.15)
    now = arm.setpoint_js(LONG).position
    assert now[[0, 2]] == pytest.approx([np.radians(40.0), 0.385], abs=1e-3)
    assert now[1] == pytest.approx(arm.robot.home[1], abs=1e-3)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("--namespace /arn1", "arms report under /arm1: did you mean '/arm1'?"),
        ("--robot dvrk_psm --namespace /arm1", "_js: dvrk_psm: no joint called '"),
        ("--profile raven_mended", "did you mean 'raven2_mended'?"),
    ],
)
def test_another_arm_than_is_there_is_one_line(call, arm, monkeypatch, line, said):
    monkeypatch.setattr(backends, "CONNECT_TIMEOUT", 1.0)
    assert call.refuses(said, f"monitor --ros 2 {line} --port 0").count("\n") == 1


def test_where_nobody_reports_and_where_another_moves_it(call, arm, model, monkeypatch):
    said = "/none: no truth is published there; joint states: /arm1/jaw/measured_js, "
    call.refuses(said, f"check {model} {BRIEF} /none")
    said = "/ext_pos: no truth is published there; did you mean '/ext_jpos'?"
    call.refuses(said, f"rezero {model} {BRIEF} /ext_pos -o new.st")
    with suppress(truejoint.errors.MotionStopped):
        there = arm.robot.home + (arm.robot.upper - arm.robot.home) * np.eye(7)[0]
        motion = arm.move_jp(there, speed=np.full(7, 0.004))  # for longer than it takes to look
        told = call(f"teleop {OVER} --go-to elbow=80 --yes-move-it")
        motion.cancel()
    assert told.code == 2
    assert "is moving: another program controls it" in told.err
    assert arm.operating_state().state == "ENABLED"  # nobody has paused it
    arm.unhome()
    arm.ros.wait_for("/arm1/operating_state", lambda m: not m.is_homed)
    call.refuses("is not homed: home it first", f"check {model} {BRIEF} /ext_jpos")
    monkeypatch.setattr("truejoint.crtk.ros.open_transport", lambda *_: LocalRos())
    monkeypatch.setattr(backends, "CONNECT_TIMEOUT", 0.3)
    said = "no arm reports: start the node of the robot"
    call.refuses(said, f"check {model} {BRIEF} /none")


@pytest.mark.parametrize("state", ["DISABLED", "PAUSED"])
def test_the_robots_button_is_waited_for_and_named(monkeypatch, state):
    asked, pressed = [], threading.Event()

    class Waiting:
        robot = truejoint.get_robot("raven2")

        def operating_state(self):
            return OperatingState(state, is_homed=True, is_busy=False, t=0.0)

        def enable(self, timeout):
            asked.append(("DISABLED", timeout))
            assert pressed.wait(LONG)

        def resume(self, timeout):
            asked.append(("PAUSED", timeout))
            assert pressed.wait(LONG)

    def say(text):
        assert "press its button or pedal" in text
        pressed.set()

    monkeypatch.setattr(driven_arm, "say", say)
    monkeypatch.setattr(driven_arm, "_SOON", 0.0)
    driven_arm.home(Waiting(), None)
    assert asked == [(state, 120.0)]


def test_motors_that_stand_off_their_set_point_are_moved_by_nobody():
    """A PSM's motors sag by half a degree, and its joints may be heard before its set-point."""

    class Late:
        robot, t = truejoint.get_robot("dvrk_psm", "psm1"), 0.0

        def operating_state(self):
            return OperatingState("ENABLED", is_homed=True, is_busy=False, t=self.t)

        def wait(self, duration):
            self.t += duration

        def setpoint_js(self, _):
            position = np.zeros(7) + (np.radians(0.5) if self.t < 0.1 else 0.0)
            return SimpleNamespace(t=self.t, position=position)

    assert not driven_arm._is_moved(Late())
