"""A lab's day on a real ROS of either version: a robot, a recording, calibration, correction."""

import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from threading import Event
from typing import Any, NamedTuple

import numpy as np
import pytest
from tests.ros_master import Master, environment, free_port, needs_ros

import truejoint
from truejoint.calibration import Calibration
from truejoint.cli.app import main
from truejoint.crtk import Arm, simulated_arm
from truejoint.crtk.backends import ros as ros_backend
from truejoint.crtk.backends.ros import RosBackend
from truejoint.crtk.messages import (
    JOINT_STATE,
    OPERATING_STATES,
    PROFILES,
    STRING_STAMPED,
    TRUTH_TOPIC,
)
from truejoint.crtk.ros import StateStream, Transport, open_transport
from truejoint.errors import CommandRefused, RosError
from truejoint.export import export_ros
from truejoint.motion import Trajectory, follow, workspace_of, zigzag
from truejoint.recordings import Recorder
from truejoint.recordings.judge.finding import HEADINGS
from truejoint.robots import get_robot
from truejoint.runtime import Corrector
from truejoint.runtime.correction import LONGEST_MOVE

ROBOT = get_robot("raven2")
PROFILE = "raven2_mended"
UNITS = tuple(ROBOT.joint(name).unit for name in ROBOT.positioning)
SPEED = 9.0 * workspace_of(ROBOT).speed
ZIGZAG = zigzag(ROBOT, "J1-J2-J3", 1.0)  # so fast it takes 6 s
LONG = 60.0  # [s], on a busy machine
TOPICS = ("measured_js", "setpoint_js", "operating_state")
DOMAIN = {
    "ROS_DOMAIN_ID": str(2 + os.getpid() % 100), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"
}  # fmt: skip


ROS_1 = pytest.param(1, marks=needs_ros)
on_ros_1 = pytest.mark.parametrize("version", [ROS_1], indirect=True)


@pytest.fixture(scope="module", params=[ROS_1, 2])
def version(request) -> int:
    """Number of the ROS that the day is spent on."""
    return int(request.param)


@pytest.fixture(scope="module")
def master(version, tmp_path_factory) -> Iterator[Master | None]:
    """A network of our own, found by this process and what it starts; ROS 1 has a master in it."""
    logs, port = tmp_path_factory.mktemp("ros"), free_port()
    with pytest.MonkeyPatch.context() as patch:
        for name, value in {**environment(port, logs), **DOMAIN}.items():
            patch.setenv(name, value)
        if version == 2:
            yield None
            return
        with pytest.raises(RosError, match=f"no ROS master answers at .*{port}: start roscore"):
            open_transport(1)
        with Master(port, logs) as running:
            yield running


@pytest.fixture(scope="module")
def ros(master, version) -> Iterator[Transport]:
    """This process as a node."""
    transport = open_transport(version)
    yield transport
    transport.close()


@contextmanager
def program(*command: str | Path) -> Iterator[subprocess.Popen[str]]:
    """A program meanwhile, ended as gently as Ctrl-C does; what it says is in its `stderr`."""
    process = subprocess.Popen(  # noqa: S603 - lines of our own
        [str(word) for word in command], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        yield process
    finally:
        process.terminate()  # as Ctrl-C, which programs in the background do not hear
        process.communicate(timeout=120)


def said(process: subprocess.Popen[str], words: str) -> str:
    """The first line that has these words."""
    assert process.stderr is not None
    for line in process.stderr:
        if words in line:
            return line
    raise AssertionError(f"ended without saying {words!r}")


def module(*arguments: str | Path) -> tuple[str | Path, ...]:
    return (sys.executable, "-m", "truejoint", *arguments)


def simulate(version: int, *words: str) -> tuple[str | Path, ...]:
    return module("node", "simulate", "--state-rate-hz", "100", "--ros", str(version), *words)


def correct(version: int, model: Path) -> tuple[str | Path, ...]:
    return module("node", "correct", model, "--profile", PROFILE, "--ros", str(version))


class Package(NamedTuple):
    """A model, its ROS package, and the program that builds it; on Debian that is ROS 1."""

    model: Calibration
    folder: Path
    build: subprocess.Popen[str] | None

    def built(self) -> Path:
        """Its program, once that is built."""
        assert self.build is not None
        told, _ = self.build.communicate(timeout=300)
        assert self.build.returncode == 0, told
        return next(path for path in self.folder.rglob("correct") if path.is_file())


class Simulator(ExitStack):
    """The program of a simulated robot; once it is closed, another may come up in its place."""

    def __init__(self, version: int) -> None:
        super().__init__()
        self._version = version

    def start(self, *words: str) -> None:
        self.process = self.enter_context(program(*simulate(self._version, *words)))


@pytest.fixture(scope="module")
def simulator(ros, version) -> Iterator[Simulator]:
    with Simulator(version) as made:
        made.start("--homed", "--seed", "3")
        yield made


@pytest.fixture(scope="module")
def package(simulator, version, tmp_path_factory) -> Iterator[Package]:
    """Debian's catkin builds it while the day goes on."""
    arm = simulated_arm(seed=3)
    arm.enable()
    arm.home()
    with Recorder(arm, state_rate=100.0) as recorder:
        run_along(arm, ZIGZAG)
    model = truejoint.calibrate(recorder.recording(), "linear").without_redundant()
    folder = tmp_path_factory.mktemp("package")
    export_ros(model, folder)
    if version == 2:
        yield Package(model, folder, None)
        return
    variables = {**os.environ, "PATH": f"/usr/bin:{os.environ['PATH']}", "ROS_VERSION": "1"}
    configure = f"cmake -S {folder} -B {folder}/build -DCMAKE_BUILD_TYPE=Debug"
    with subprocess.Popen(  # noqa: S602 - a line of our own
        f"{configure} -DPYTHON_EXECUTABLE=/usr/bin/python3 && cmake --build {folder}/build",
        shell=True, env=variables, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
    ) as build:  # fmt: skip
        yield Package(model, folder, build)
        build.kill()


@pytest.fixture(scope="module")
def robot(ros, simulator, package) -> Iterator[Arm]:
    """The simulated one, which has come up while the package was made."""
    said(simulator.process, "/arm1/measured_js")
    # Others may have the processor for seconds.
    patience, newest = pytest.MonkeyPatch(), Arm.newest_state
    for name in ("SILENCE", "CONNECT_TIMEOUT"):
        patience.setattr(ros_backend, name, LONG)
    for name in ("_STILL", "_IN_FLIGHT"):
        patience.setattr(ros_backend, name, 1.0)  # by which the robot may be behind
    patience.setattr("truejoint.crtk.arm.SILENCE", LONG)
    patience.setattr(Arm, "newest_state", lambda arm, name, age: newest(arm, name, max(age, LONG)))
    near = {"rad": np.radians(1.0), "m": 1e-3}  # its friction keeps the twin's motors off
    with Arm(RosBackend(ros, ROBOT, PROFILE, truth=TRUTH_TOPIC, tolerance=near)) as arm:
        yield arm
    patience.undo()


@pytest.fixture
def truejoint_(monkeypatch, capsys) -> Callable[..., str]:
    """A command of truejoint, here in this process; gives what it prints."""

    def run(*arguments: str | int | Path, codes: tuple[int, ...] = (0,)) -> str:
        monkeypatch.setattr(sys, "argv", ["truejoint", *map(str, arguments)])
        with pytest.raises(SystemExit) as stop:
            main()
        told = capsys.readouterr()
        assert stop.value.code in codes, told
        return str(told.out)

    return run


@contextmanager
def recorded(
    version: int, robot: Arm, path: Path, truejoint_: Callable[..., str]
) -> Iterator[None]:
    """Keep what is published meanwhile: by ROS 1's own tool, or by the arm's recorder."""
    if version == 2:
        with Recorder(robot, state_rate=100.0) as recorder:
            yield
        truejoint.write_parquet(recorder.recording(), path)
        return
    bag, topics = path.with_suffix(".bag"), [*(f"/arm1/{name}" for name in TOPICS), TRUTH_TOPIC]
    with program("rosbag", "record", "-O", bag, *topics):
        wait_for_readers(topics)
        yield
    truejoint_("extract", bag, "-o", path, "--robot", "raven2", "--profile", PROFILE)


def test_a_labs_day(version, package, ros, robot, truejoint_, tmp_path):
    recording, path = tmp_path / "day.parquet", tmp_path / "model.safetensors"
    live = ("doctor", "live", "--ros", version, "--duration-s", "2", "--profile", PROFILE, "--json")
    with recorded(version, robot, recording, truejoint_), ThreadPoolExecutor(1) as pool:
        motion = pool.submit(run_along, robot, ZIGZAG)
        printed: list[str] = []  # nothing where a topic was silent
        until(lambda: printed.append(truejoint_(*live, codes=(0, 1, 2))) or printed[-1], "topics")
        found = levels(printed[-1])  # while it moves
        motion.result()
    assert found.keys() == set(HEADINGS)  # a busy machine spoils stamps and rates
    assert found["homing"] == "good"
    assert "fail" not in (found["unit"], found["effort"])
    said = truejoint_("doctor", recording, "--json", codes=(0, 1))
    assert levels(said).keys() == set(HEADINGS[1:])
    promised = promised_factors(recording, path)

    heard: dict[str, list[tuple[float, ...]]] = {}
    ends = [
        ros.subscribe(topic, JOINT_STATE, keeper(ros, heard.setdefault(topic, [])))
        for topic in ("/arm1/measured_js", "/arm1/corrected/measured_js", TRUTH_TOPIC, "/arm1/c")
    ]
    states: list[tuple[float, Any]] = []
    stream = StateStream(
        ros, ROBOT, PROFILES[PROFILE], lambda _, t, columns: states.append((t, columns))
    )
    stream.start()
    model = truejoint.read_calibration(path).without_redundant()

    def believed() -> np.ndarray:
        """Stamps at which the node put out its model's estimate; its correction moves slowly."""
        ours = replayed(model, list(states))
        corrected = np.array(heard["/arm1/corrected/measured_js"])
        stamps = np.intersect1d(ours[:, 0], corrected[:, 0])
        return stamps[alike(corrected, ours[:, 0], ours[:, 5:])]

    in_c = ("__ns:=/arm1", "_homed:=true", "corrected/measured_js:=c", "__name:=in_c")
    with ExitStack() as programs:
        programs.enter_context(program(*correct(version, path)))
        if version == 1:
            programs.enter_context(program(package.built(), *in_c))
            for who in ("truejoint_correct", "in_c"):
                wait_for_readers(["/arm1/measured_js"], who)
        until(lambda: heard["/arm1/corrected/measured_js"], "the node")
        until(lambda: run_along(robot, waves(8.0)) or len(believed()) > 300, "corrected joints")
    for end in (*ends, stream.close):
        end()
    raw, corrected, truth, by_c = (np.array(rows) for rows in heard.values())
    if version == 1:
        assert_corrected_alike(package.model, states, by_c)
    t = believed()
    t = t[(t > truth[0, 0]) & (t < truth[-1, 0])]
    reached = error(raw, truth, t) / error(corrected, truth, t)
    assert len(t) > 200
    # Another motion than the one that the promise was made on, so a quarter of it; and of an error
    # a tenth of the raw one much is what stamps say of when, which a busy machine makes worse.
    least = np.minimum(0.25 * promised, 4.0)
    assert (reached > least).all(), f"promised {promised}, reached {reached}"


def replayed(model: Calibration, states: list[tuple[float, Any]]) -> np.ndarray:
    """Give stamp, status, position and estimate for each message, by a corrector here."""
    corrector = Corrector(model)
    corrector.set_homing(True)
    rows = []
    for t, columns in states:
        status = int(corrector.step(t, [columns[name][0] for name in corrector.signals]))
        measured = [columns[f"measured/{joint}"][0] for joint in corrector.joints]
        rows.append((t, status, *corrector.position, *(measured + corrector.correction)))
    return np.array(rows)


def alike(heard: np.ndarray, stamps: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """Whether the joints are those that were heard, for each stamp that both have."""
    _, mine, theirs = np.intersect1d(stamps, heard[:, 0], return_indices=True)
    return np.isclose(joints[mine], heard[theirs, 1:], rtol=0.0, atol=1e-6).all(axis=1)


def assert_corrected_alike(
    model: Calibration, states: list[tuple[float, Any]], by_c: np.ndarray
) -> None:
    """The node in C answers as a corrector here that began at the same message.

    That is the first message that it answered, or an earlier one if nobody heard its first answers.
    The correction moves slowly from there to the estimate.
    """
    first = [t for t, _ in states].index(by_c[0, 0])
    for start in range(first, -1, -1):
        ours = replayed(model, states[start:])
        same = alike(by_c, ours[:, 0], ours[:, 2:5])
        if same[0]:
            break
    assert (ours[:, 1] == 0).mean() > 0.3  # so that there is something to compare
    assert len(same) > 200
    assert same.mean() > 0.95


def levels(said: str) -> dict[str, str]:
    """Worst level under each heading of a doctor; findings come worst first."""
    return {f["heading"]: f["level"] for f in reversed(json.loads(said)["findings"])}


def promised_factors(recording: Path, model: Path) -> np.ndarray:
    """Raw RMSE over that of the model, joint by joint, of the middle of the day's recording."""
    whole = truejoint.read_recording(recording)
    part = truejoint.evaluation.part_by_time
    held_out = part(whole, 0.4, 0.6)  # within, so that the rest covers the whole range
    calibration = truejoint.calibrate([part(whole, 0.0, 0.4), part(whole, 0.6, 1.0)], "linear")
    truejoint.write_calibration(calibration, model)
    scores = truejoint.evaluate(calibration, held_out).scores
    rmse = scores.pivot(index="joint", columns="estimator", values="rmse").loc[
        [*calibration.joints]
    ]
    return (rmse["raw"] / rmse["linear"]).to_numpy()


def run_along(arm: Arm, trajectory: Trajectory) -> None:
    """Follow a trajectory, and go to its start, both fast."""
    start = np.concatenate([trajectory.positions[0], ROBOT.home[3:]])
    arm.move_jp(start, speed=[*SPEED, *np.ones(4)]).wait()
    follow(arm, trajectory, speed=SPEED)


def waves(seconds: float) -> Trajectory:
    """A motion within the zig-zag, of so many seconds at its own pace."""
    space, t = workspace_of(ROBOT), np.arange(0.0, seconds, 0.1)[:, None]
    rows = space.centre + 0.25 * np.sin(t * [1.6, 2.1, 2.6]) * space.extent
    return Trajectory(ROBOT.positioning, UNITS, rows)


def keeper(ros: Transport, rows: list[tuple[float, ...]]) -> Callable[[Any], None]:
    """Keep stamp and positioning joints of every message."""
    return lambda message: rows.append((ros.seconds(message), *message.position[:3]))


def error(rows: np.ndarray, truth: np.ndarray, t: np.ndarray) -> np.ndarray:
    """RMS over the stamps `t`, joint by joint."""
    found = [
        np.interp(t, rows[:, 0], rows[:, k]) - np.interp(t, truth[:, 0], truth[:, k])
        for k in (1, 2, 3)
    ]
    return np.sqrt(np.mean(np.square(found), axis=1))


def wait_for_writers(topics: list[str]) -> None:
    """Until the master knows who writes the topics."""
    until(lambda: set(topics) <= set(connections(0)), f"who writes {topics}")


def wait_for_readers(topics: list[str], who: str = "record") -> None:
    """Until a node of this name reads the topics; rosbag calls itself record."""

    def is_there() -> bool:
        readers = connections(1)
        return all(any(who in name for name in readers.get(topic, [])) for topic in topics)

    until(is_there, f"{who} to read {topics}")


def connections(side: int) -> dict[str, list[str]]:
    """Nodes that write (0) or read (1) each topic or serve (2) it, as the master knows."""
    import rosgraph  # noqa: PLC0415  # Debian's

    return dict(rosgraph.Master("/test").getSystemState()[side])


def until(is_so: Callable[[], bool], what: str) -> None:
    """Look again and again, for minutes: programs of others tell nobody when they are ready."""
    end = time.monotonic() + 200.0
    while not is_so():
        assert time.monotonic() < end, f"waited in vain for {what}"
        time.sleep(0.05)


@on_ros_1
def test_others_tools_read_what_is_published(robot):
    command = [str(shutil.which("rostopic")), "echo", "-n", "1", "/arm1/measured_js"]
    done = subprocess.run(  # noqa: S603 - a line of our own
        command, capture_output=True, text=True, timeout=200, check=True
    )
    assert "gold_shoulder" in done.stdout


@on_ros_1
def test_clients_of_crtk_and_dvrk_move_it_by_their_own_calls(simulator):
    """In a program of its own, on Debian's Python, which knows nothing of truejoint."""
    client = Path(__file__).with_name("crtk_client.py")
    done = subprocess.run(  # noqa: S603 - a line of our own
        ["/usr/bin/python3", client, "/arm1"],
        capture_output=True, text=True, timeout=600, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr


WRITER = """
import signal, sys
from truejoint.crtk.ros import open_transport
ros, (topic, kind) = open_transport(1, "writer"), sys.argv[1:]
message = ros.message(kind)
message.state = kind
ros.publisher(topic, kind, latched=True).publish(message)
signal.pause()
"""


@on_ros_1
def test_the_old_and_the_new_name_of_a_message_are_read_on_one_topic(ros):
    topic, heard = "/both/operating_state", set()
    end = ros.subscribe(topic, OPERATING_STATES[0], lambda m: heard.add(m.state))
    with ExitStack() as on:
        for kind in OPERATING_STATES:
            on.enter_context(program(sys.executable, "-c", WRITER, topic, kind))
        until(lambda: heard == set(OPERATING_STATES), "states of both names")
    end()


@on_ros_1
def test_a_master_that_starts_anew_is_told_all_topics_and_services(master, ros, robot):
    master.__exit__()
    before = robot.measured_js().t  # connections that stand outlive it
    master.__enter__()
    wait_for_writers(["/arm1/measured_js", "/arm1/servo_jp"])  # theirs and ours
    until(lambda: "/arm1/forward_kinematics" in connections(2), "the robot's services")
    until(lambda: robot.measured_js().t > before, "the joints")
    robot.move_jp(ROBOT.home + np.eye(7)[0] * 0.01).wait()


def test_a_client_in_the_loop_a_robot_that_stops_and_the_next_morning(
    version, ros, simulator, robot, package, truejoint_, tmp_path
):
    day, morning = tmp_path / "day.safetensors", tmp_path / "morning.safetensors"
    truejoint.write_calibration(package.model, day)
    assert moves(robot)  # to where the model knows it
    raw, corrected, said = [], [], []
    of_topics = {"measured_js": raw, "corrected/measured_js": corrected}
    ends = [
        *(ros.subscribe(f"/arm1/{n}", JOINT_STATE, keeper(ros, r)) for n, r in of_topics.items()),
        ros.subscribe("/arm1/corrected/status", STRING_STAMPED, lambda m: said.append(m.string)),
    ]
    with program(*correct(version, day)):
        until(lambda: said[-1:] == ["OK"], "the first corrected joints")
        began = len(corrected)
        steer(ros)
        steps = [largest_step(rows) for rows in in_common(raw, corrected[began:])]
        assert (steps[1] <= 3.0 * steps[0]).all()  # the noise of efforts is in it
        simulator.close()
        until(lambda: said[-1] == "SILENT", "the node to say that the robot has stopped")
        last = len(corrected) - 1
        with program(*simulate(version)):  # not homed, and then homed without the 13 s of it
            until(lambda: not robot.operating_state().is_homed, "a robot switched on")
        simulator.start("--homed", "--seed", "8")
        until(lambda: said[-1] == "HOMED_AGAIN", "another homing")
        until(lambda: moves(robot), "the robot to take set-points")
        with ThreadPoolExecutor(1) as pool:
            moved = pool.submit(run_along, robot, waves(2.0))
            over_ros = ("--ros", version, "--profile", PROFILE, "--truth", TRUTH_TOPIC)
            truejoint_("rezero", day, *over_ros, "--duration-s", "3", "-o", morning)
            moved.result()
        before, after = in_common(raw, corrected[last:])  # of a robot that is elsewhere now,
        assert (largest_step(after - before) < LARGEST_MOVE).all()  # the correction alone
    with program(*correct(version, morning)):
        until(lambda: said[-1] == "OK", "corrected joints after the homing")
    for end in ends:
        end()


NEAR = np.array([*np.radians([1.0, 1.0]), 1e-3])
LARGEST_MOVE = 1.1 * LONGEST_MOVE * np.array([*np.radians([2.0, 2.0]), 2e-3])


def moves(arm: Arm) -> bool:
    """Whether it does as it is told; one that has just come up may not hear of it yet."""
    with suppress(CommandRefused):
        if arm.operating_state().state == "PAUSED":  # by the move before, which it did not hear
            arm.resume()
        arm.move_jp(ROBOT.home + np.eye(7)[0] * 0.01).wait()
        return True
    return False


def steer(ros: Transport) -> None:
    """A client with the corrected joints in its loop, until they are where it wants them."""
    out = ros.publisher("/arm1/servo_jp", JOINT_STATE)
    until(lambda: out.readers > 0, "the robot to read servo_jp")
    lost, left, began, over = np.zeros(3), np.zeros(3), [], Event()

    def take(message: Any) -> None:
        began.append(ros.seconds(message))
        t = began[-1] - began[0]
        wanted = ROBOT.home.copy()
        wanted[:3] += EXTENT * np.sin(min(2.0 * t, np.pi)) ** 2
        left[:] = wanted[:3] - message.position[:3]
        lost[:] += 0.04 * left
        wanted[:3] += lost
        command = ros.stamped(JOINT_STATE, ros.now())
        command.position = wanted.tolist()
        out.publish(command)
        if t > 3.0 and (np.abs(left) < NEAR).all():  # sooner or later, as the machine is busy
            over.set()

    end = ros.subscribe("/arm1/corrected/measured_js", JOINT_STATE, take)
    assert over.wait(LONG), left
    end()
    out.close()


EXTENT = np.array([0.1, 0.1, 0.01])  # [rad, m]


def in_common(
    first: list[tuple[float, ...]], second: list[tuple[float, ...]]
) -> tuple[np.ndarray, np.ndarray]:
    """Joints (n, 3) of the stamps that both have."""
    a, b = np.array(first), np.array(second)
    _, of_a, of_b = np.intersect1d(a[:, 0], b[:, 0], return_indices=True)
    return a[of_a, 1:], b[of_b, 1:]


def largest_step(rows: np.ndarray) -> np.ndarray:
    return np.asarray(np.abs(np.diff(rows, axis=0)).max(axis=0))
