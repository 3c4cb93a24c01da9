"""What holds over a real ROS 1 link: corrected steps, moves, streams, pauses, a path followed.

    python -m benchmarks.ros_link [--parts added steps moves rest pauses path] [--minutes 10]
        [--busy 1] [--ros 2]

added   Joint states of the simulated RAVEN-II go to `truejoint node correct` at 1 kHz. Added is the
        time from the arrival of one at a subscriber to that of the corrected one at the same: what
        a client of the corrected topic waits longer. Core is the node's processor time over the
        time that passed. This part alone goes over DDS as well (`--ros 2`).
steps   A RAVEN-II's joint states, of a zig-zag at 10 deg/s and 7 mm/s, go to `truejoint node
        correct` and to the exported C++ node, with a linear model; 1 % are lost, and 20 % are 1-5
        periods late, so that others go before them. A step is between two messages as they
        arrive. Beside it is what the same model does to the recording, from one row to the next,
        with nothing late: efforts are noisy.
moves   A `RosBackend` moves `truejoint node simulate`; the joints are looked at when `wait`
        returns. A move is silently off where it ends beyond .15 deg, .15 mm without an error.
rest    The arm's clock from the last of 5,000 `servo_jp` to the last change of its set-point.
pauses  The same from `pause` by another program, while moves and streams go on.
path    A zig-zag on `node simulate --quirks`, at the default speed, followed with `motor_loop`:
        where the joints are wanted less what is reported. Alone it is the set-point less that.

`--busy` keeps so many cores busy meanwhile. Prints Markdown tables. `load` is what the machine was
busy with, divided by its cores.
"""

import math
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from tests.ros_master import Master, environment, free_port

import truejoint
from benchmarks import head, parsed, row
from benchmarks.arms import homed
from benchmarks.timing import processor_time
from truejoint.array_types import Array
from truejoint.crtk import Arm, RosBackend, simulated_arm
from truejoint.crtk.backends.ros import TOLERANCE
from truejoint.crtk.messages import JOINT_STATE, OPERATING_STATE, STRING_STAMPED
from truejoint.crtk.ros import Publisher, Transport, open_transport
from truejoint.errors import CommandRefused, NotArrived
from truejoint.export import export_ros
from truejoint.motion import follow, zigzag
from truejoint.robots import get_robot
from truejoint.runtime import Corrector, motor_loop
from truejoint.runtime.node import SILENT

ROBOT = get_robot("raven2")
RATES = 200.0, 500.0, 1000.0
LIMIT = np.array([TOLERANCE[joint.unit] for joint in ROBOT.joints])
EXTENT = np.array([0.2, 0.2, 0.02, 0.3, 0.3, 0.2, 0.2])  # of the motions [rad or m]
SPEED = 0.4 * np.array([joint.max_speed for joint in ROBOT.joints])
LATE, LOST, MOST = 0.2, 0.01, 5  # shares, periods
SETPOINT, RAW = "/arm1/setpoint_js", "/arm1/measured_js"
CORRECTED = "/arm1/corrected/measured_js"


def session(order: str, faster: float, rate: float) -> truejoint.Recording:
    """Record a zig-zag of the twin, `rate` times a second, faster than the workspace's speeds."""
    arm = homed(simulated_arm("raven2", seed=3))
    speed = faster * truejoint.motion.workspace_of(arm.robot).speed
    with truejoint.recordings.Recorder(arm, state_rate=rate) as recorder:
        follow(arm, zigzag(arm.robot, order, 1 / 2), speed=speed)
    return recorder.recording()


def both_ways(recording: truejoint.Recording) -> tuple[Array, Array]:
    """Positions and efforts (n, 7) of a recording and back again, as joint states have them."""
    rows, efforts = (recording.columns(q, ROBOT.joint_names) for q in ("measured", "effort"))
    efforts = ROBOT.transmission.joint_effort(efforts)
    return np.r_[rows, rows[::-1]], np.r_[efforts, efforts[::-1]]


def send(ros: Transport, joints: Publisher, t: float, position: Array, effort: Array) -> float:
    """Publish a joint state; gives its stamp [s]."""
    message = ros.stamped(JOINT_STATE, t)
    message.position, message.effort = position.tolist(), effort.tolist()
    joints.publish(message)
    return ros.seconds(message)


def say_homed(ros: Transport, states: Publisher) -> None:
    """Publish that the robot is homed, once somebody listens."""
    until(lambda: states.readers >= 1)
    state = ros.stamped(OPERATING_STATE, ros.now())
    state.state, state.is_homed = "ENABLED", True
    states.publish(state)
    time.sleep(1.0)


def spent(pid: int | None = None) -> float:
    """Processor time of a process, or of all programs over all cores [s]."""
    if pid is not None:
        return processor_time(Path(f"/proc/{pid}/stat"))
    ticks = [int(f) for f in Path("/proc/stat").read_text().split("\n", 1)[0].split()[1:]]
    return (sum(ticks[:3]) + sum(ticks[5:8])) / os.sysconf("SC_CLK_TCK")


def node(*words: str) -> AbstractContextManager[subprocess.Popen[bytes]]:
    """Run a node of truejoint meanwhile."""
    return program(sys.executable, "-m", "truejoint", "node", *words)


@contextmanager
def program(*words: str | Path) -> Iterator[subprocess.Popen[bytes]]:
    """Run a program of our own meanwhile."""
    process = subprocess.Popen([str(word) for word in words])
    try:
        yield process
    finally:
        process.terminate()
        process.wait()


def built(model: truejoint.calibration.Calibration, folder: Path) -> Path:
    """Program of the exported ROS package, built with Debian's catkin."""
    export_ros(model.without_redundant(), folder)
    variables = {**os.environ, "PATH": f"/usr/bin:{os.environ['PATH']}", "ROS_VERSION": "1"}
    for line in (
        f"cmake -S {folder} -B {folder}/build -DPYTHON_EXECUTABLE=/usr/bin/python3",
        f"cmake --build {folder}/build",
    ):
        subprocess.run(line.split(), env=variables, check=True, capture_output=True)
    return next(path for path in folder.rglob("correct") if path.is_file())


@contextmanager
def busy_with(name: str) -> Iterator[None]:
    """Say what the machine was busy with meanwhile."""
    began, before = time.perf_counter(), spent()
    yield
    load = (spent() - before) / (time.perf_counter() - began) / (os.cpu_count() or 1)
    print(f"\n{name}: load {load:.0%}\n", flush=True)


def until(is_so: Callable[[], object]) -> None:
    """Look again and again, for a minute."""
    end = time.monotonic() + 60.0
    while not is_so():
        if time.monotonic() > end:
            raise SystemExit("waited in vain for a node")
        time.sleep(0.01)


def paced(rate: float, count: int) -> Iterator[int]:
    """Count, `rate` times a second."""
    began = time.perf_counter()
    for k in range(count):
        time.sleep(max(began + k / rate - time.perf_counter(), 0.0))
        yield k


def added_part(ros: Transport, folder: Path, minutes: float, version: int) -> None:
    """Print how much later than the measured joints the corrected ones arrive."""
    recording, path = session("J2", 8.0, 1000.0), folder / "model.safetensors"
    truejoint.write_calibration(truejoint.calibrate(recording, "linear"), path)
    rows, efforts = both_ways(recording)
    joints = ros.publisher(RAW, JOINT_STATE)
    states = ros.publisher("/arm1/operating_state", OPERATING_STATE)
    arrived: dict[str, dict[float, float]] = {RAW: {}, CORRECTED: {}}
    ends = [
        ros.subscribe(
            topic, JOINT_STATE, lambda m, at=at: at.__setitem__(ros.seconds(m), time.perf_counter())
        )
        for topic, at in arrived.items()
    ]  # fmt: skip
    words = "correct", str(path), "--profile", "raven2_mended", "--ros", str(version)
    with node(*words) as process:
        until(lambda: joints.readers >= 2)
        say_homed(ros, states)
        began, before = time.perf_counter(), spent(process.pid)
        sent = [
            send(ros, joints, 1e9 + k / 1000.0, rows[k % len(rows)], efforts[k % len(rows)])
            for k in paced(1000.0, round(60_000 * minutes))
        ]
        passed = time.perf_counter() - began
        core = (spent(process.pid) - before) / passed
        time.sleep(1.0)
        process.send_signal(signal.SIGTERM)
        process.wait()
    for end in (*ends, joints.close, states.close):
        end()
    raw, corrected = arrived[RAW], arrived[CORRECTED]
    lost = sum(stamp not in corrected for stamp in sent)
    added = np.array([corrected[s] - raw[s] for s in sent if s in corrected and s in raw])
    median, p99, worst = np.quantile(added, [0.5, 0.99, 1.0]) * 1e3
    head("sent", "rate [Hz]", "lost", "added: median [ms]", "p99 [ms]", "worst [ms]", "core")
    shown = f"{median:.2f}", f"{p99:.2f}", f"{worst:.1f}", f"{core:.0%}"
    row(len(sent), f"{len(sent) / passed:.0f}", lost, *shown)


def steps_part(ros: Transport, folder: Path, minutes: float) -> None:
    """Print how far the corrected joints step, and the raw ones."""
    largest = "largest corrected / raw step"
    head("rate [Hz]", "messages", "corrected", largest, "in C++", "nothing late", "statuses",
         "SILENT after [s]")  # fmt: skip
    for rate in (200.0, 1000.0):
        recording, path = session("J1-J2-J3", 4.0, rate), folder / f"{rate:g}.safetensors"
        model = truejoint.calibrate(recording, "linear")
        truejoint.write_calibration(model, path)
        rows, efforts = both_ways(recording)
        corrector = Corrector(model)
        corrector.set_homing(True)
        alone = corrector.run(recording).position
        heard: dict[str, list[tuple[float, ...]]] = {RAW: [], CORRECTED: [], "/arm1/c": []}
        in_c = "__ns:=/arm1", "_homed:=true", "corrected/measured_js:=c", "__name:=in_c"
        package = built(model, folder / f"package_{rate:g}")
        said: list[tuple[float, str]] = []
        ends = [
            ros.subscribe(
                topic, JOINT_STATE,
                lambda m, kept=kept: kept.append((ros.seconds(m), *m.position[:3])),
            )
            for topic, kept in heard.items()
        ]  # fmt: skip
        status = ros.subscribe(
            "/arm1/corrected/status", STRING_STAMPED,
            lambda m, said=said: said.append((time.perf_counter(), m.string)),
        )  # fmt: skip
        joints = ros.publisher(RAW, JOINT_STATE)
        states = ros.publisher("/arm1/operating_state", OPERATING_STATE)
        with node("correct", str(path), "--profile", "raven2_mended"), program(package, *in_c):
            until(lambda out=joints: out.readers >= 3)
            say_homed(ros, states)
            _send_late(ros, joints, rows, efforts, rate, minutes)
            end_of_all = time.perf_counter()
            until(lambda said=said: said[-1][1] == SILENT)
        for end in (*ends, status, joints.close, states.close):
            end()
        raw, corrected, by_c = (np.array(kept)[:, 1:] for kept in heard.values())
        shown = (
            ", ".join(f"{ratio:.2f}" for ratio in largest_step(a) / largest_step(b))
            for a, b in ((corrected, raw), (by_c, raw), (alone, rows[:, :3]))
        )
        counts = Counter(name for _, name in said)
        texts = ", ".join(f"{name} {count}" for name, count in counts.items())
        silent = said[-1][0] - end_of_all
        messages = f"{rate:.0f}", len(raw), f"{len(corrected)}, {len(by_c)}"
        row(*messages, *shown, texts, f"{silent:.2f}")


def largest_step(rows: Array) -> Array:
    """Largest change (n,) between two rows."""
    return np.asarray(np.abs(np.diff(rows, axis=0)).max(axis=0))


def _send_late(
    ros: Transport, joints: Publisher, rows: Array, efforts: Array, rate: float, minutes: float
) -> None:
    """Publish as a bad network delivers: each message in the period in which it arrives."""
    rng, count = np.random.default_rng(1), round(60.0 * minutes * rate)
    late = np.where(rng.random(count) < LATE, rng.integers(1, MOST + 1, count), 0)
    arrival = np.arange(count) + late
    order = np.argsort(arrival, kind="stable")
    order = order[rng.random(count) >= LOST]
    epoch, at = ros.now(), 0
    for period in paced(rate, count + MOST):
        while at < len(order) and arrival[order[at]] <= period:
            k = int(order[at])
            send(ros, joints, epoch + k / rate, rows[k % len(rows)], efforts[k % len(rows)])
            at += 1


def moves_part(ros: Transport, moves: int) -> None:
    """Print where the joints are when a move is said to be over."""
    head("rate [Hz]", "moves", "furthest off", "6 s later", "not arrived", "others", "silent")
    for rate in RATES:
        rng, off, refused, others = np.random.default_rng(2), [np.zeros(7)], 0, 0
        later = np.zeros(7)
        with (
            node("simulate", "--homed", "--state-rate-hz", f"{rate:g}"),
            Arm(_backend(ros, "raven2_mended", rate=rate)) as arm,
        ):
            for k in range(moves):
                goal = ROBOT.home + EXTENT * rng.uniform(-1.0, 1.0, 7)
                try:
                    arm.move_jp(goal, SPEED).wait()
                except NotArrived:
                    refused += 1
                    continue
                except CommandRefused as error:
                    print(error, file=sys.stderr)
                    others += 1
                    continue
                off.append(np.abs(arm.measured_js(math.inf).position - goal))
                if k % 10 == 0:
                    time.sleep(6.0)
                    gone = np.abs(arm.measured_js(math.inf).position - goal)
                    later = np.maximum(later, gone)
        silent = sum(bool((far > LIMIT).any()) for far in off)
        shown = (
            f"{np.degrees(np.delete(worst, 2).max()):.3f} deg, {1e3 * worst[2]:.3f} mm"
            for worst in (np.max(off, axis=0), later)
        )
        row(f"{rate:.0f}", moves, *shown, refused, others, silent)


def _backend(ros: Transport, profile: str, **how: Any) -> RosBackend:
    """Link to the simulated robot, once that is there."""
    until(lambda: "/arm1/operating_state" in ros.topics())
    time.sleep(1.0)
    return RosBackend(ros, ROBOT, profile, **how)


class Robot:
    """A served arm's set-points as they are reported, and what is sent to it as CRTK's clients do.

    Attributes
    ----------
    changes : list of (float, ndarray)
        Stamp [s] and set-point whenever it changed.
    """

    def __init__(self, ros: Transport) -> None:
        self.ros, self.changes, self.states = ros, [(0.0, np.zeros(7))], [""]
        self._ends = [
            ros.subscribe(SETPOINT, JOINT_STATE, self._on_setpoint),
            ros.subscribe(
                "/arm1/operating_state", OPERATING_STATE, lambda m: self.states.append(m.state)
            ),
        ]
        self._out = {n: ros.publisher(f"/arm1/{n}", JOINT_STATE) for n in ("servo_jp", "move_jp")}
        self._state = ros.publisher("/arm1/state_command", STRING_STAMPED)
        until(lambda: len(self.changes) > 1 and all(out.readers for out in self._out.values()))
        until(lambda: self._state.readers)

    def _on_setpoint(self, message: Any) -> None:
        now = np.array(message.position)
        if not np.array_equal(now, self.changes[-1][1]):
            self.changes.append((self.ros.seconds(message), now))

    def ask(self, name: str, position: Array) -> float:
        """Send joints; gives when."""
        t = self.ros.now()
        message = self.ros.stamped(JOINT_STATE, t)
        message.position = position.tolist()
        self._out[name].publish(message)
        return t

    def command(self, word: str, state: str) -> float:
        """Send a state command and wait for what it leads to; gives when it was sent."""
        t = self.ros.now()
        message = self.ros.stamped(STRING_STAMPED, t)
        message.string = word
        self._state.publish(message)
        until(lambda: self.states[-1] == state)
        return t

    def rest_after(self, t: float) -> float:
        """Wait until it stands; gives how long after `t` that was [s]."""
        until(lambda: self.ros.now() - self.changes[-1][0] > 0.3)
        return max(self.changes[-1][0] - t, 0.0)

    def close(self) -> None:
        """Give up the topics."""
        for end in (*self._ends, *(out.close for out in (*self._out.values(), self._state))):
            end()


def wave(t: float) -> Array:
    """Where a stream is at `t` [s]; it begins and goes on about the home pose."""
    return np.asarray(ROBOT.home + EXTENT * np.sin(2.0 * t))


def rest_part(ros: Transport, streams: int) -> None:
    """Print how soon an arm stands after the last of a stream that ends while it moves."""
    with node("simulate", "--homed"):
        robot, took = Robot(ros), []
        for _ in range(streams):
            robot.ask("move_jp", wave(0.0))
            robot.rest_after(0.0)
            sent = 0.0
            for k in paced(1000.0, 5000):
                sent = robot.ask("servo_jp", wave(k / 1000.0))
            took.append(1e3 * robot.rest_after(sent))
        robot.close()
    shown = ", ".join(f"{ms:.0f}" for ms in took)
    print(f"Last of 5,000 `servo_jp` at 1 kHz to rest, {streams} streams: {shown} ms.")


def pauses_part(ros: Transport, pauses: int) -> None:
    """Print how soon an arm stands when another client pauses it."""
    kinds = ("move_jp", *(f"servo_jp at {rate:.0f} Hz" for rate in RATES))
    took: dict[str, list[float]] = {kind: [] for kind in kinds}
    rng = np.random.default_rng(3)
    with node("simulate", "--homed"):
        robot = Robot(ros)
        for k in range(pauses):
            kind, over = kinds[k % len(kinds)], threading.Event()
            robot.ask("move_jp", ROBOT.home)
            robot.rest_after(0.0)
            rate = RATES[k % len(kinds) - 1]

            def send(kind: str = kind, rate: float = rate, over: threading.Event = over) -> None:
                if kind == "move_jp":
                    robot.ask("move_jp", ROBOT.home + 2.0 * EXTENT)
                    return
                for i in paced(rate, 10_000):
                    if over.is_set():
                        return
                    robot.ask("servo_jp", wave(i / rate))

            sender = threading.Thread(target=send)
            sender.start()
            time.sleep(float(rng.uniform(0.4, 1.2)))
            asked = robot.command("pause", "PAUSED")
            took[kind].append(1e3 * robot.rest_after(asked))
            over.set()
            sender.join()
            robot.command("resume", "ENABLED")
        robot.close()
    head("pause during", "pauses", "median [ms]", "99 % [ms]", "worst [ms]")
    took["all"] = [ms for times in took.values() for ms in times]
    for kind, times in took.items():
        row(kind, len(times), *(f"{ms:.0f}" for ms in np.quantile(times, [0.5, 0.99, 1.0])))


def path_part(ros: Transport) -> None:
    """Print how far off a zig-zag the reported joints are."""
    path = zigzag(ROBOT, "J1-J2-J3", 1.0)
    head("zig-zag", "RMS of wanted less reported: shoulder, elbow, insertion")
    with (
        node("simulate", "--homed", "--quirks"),
        Arm(_backend(ros, "raven2", tolerance={"rad": math.inf, "m": math.inf})) as arm,
    ):
        for name, steering in {"alone": None, "motor_loop": motor_loop(ROBOT)}.items():
            report = follow(arm, path, steering=steering)
            a, b, c = report.rms
            row(name, f"{np.degrees(a):.3f} deg, {np.degrees(b):.3f} deg, {1e3 * c:.3f} mm")


def main() -> None:
    """Run a master of our own, on this computer alone, and print the tables asked for."""
    parts = ("added", "steps", "moves", "rest", "pauses", "path")
    chosen = parsed(
        __doc__, parts=parts, minutes=10.0, moves=70, streams=5, pauses=200, busy=0, ros=1
    )
    with tempfile.TemporaryDirectory() as text:
        folder, port = Path(text), free_port()
        os.environ.update(environment(port, folder))
        with ExitStack() as on:
            on.enter_context(Master(port, folder))
            for _ in range(chosen.busy):
                on.enter_context(program(sys.executable, "-c", "while True: pass"))
            ros = open_transport(chosen.ros, "benchmark")
            calls: dict[str, Callable[[], None]] = {
                "added": lambda: added_part(ros, folder, chosen.minutes, chosen.ros),
                "steps": lambda: steps_part(ros, folder, chosen.minutes),
                "moves": lambda: moves_part(ros, chosen.moves),
                "rest": lambda: rest_part(ros, chosen.streams),
                "pauses": lambda: pauses_part(ros, chosen.pauses),
                "path": lambda: path_part(ros),
            }
            for part in chosen.parts:
                with busy_with(part):
                    calls[part]()


if __name__ == "__main__":
    main()
