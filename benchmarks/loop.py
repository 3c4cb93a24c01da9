"""A control loop in real time, beside an empty loop, and how soon an arm stands.

    python -m benchmarks.loop [--parts corrector paced stopping] [--minutes 10] [--pauses 1000]

corrector  A plain Python loop at 1 kHz sleeps until each deadline, takes the next sample of the
           simulated arm, corrects it, reads the outcome and writes a log of lists. Half seconds of
           it take turns with an empty loop. A period is missed when its work is not done by the
           next deadline.
paced      A `PacedBackend` at 1 kHz with a corrector behind it, beside a process that only sleeps.
           A period is late when it takes more than 1.5 ms.
stopping   A thread asks for a pause at a random moment of a random command. The robot's clock
           counts from the first state message after the request to the last one; 20 ms and the
           braking are allowed.

Prints Markdown tables.
"""

import gc
import multiprocessing
import os
import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from benchmarks import head, parsed, row
from benchmarks.arms import blocks_of, homed, recorded
from benchmarks.timing import LoopTiming, TimedBackend
from truejoint.array_types import Array
from truejoint.calibration import Calibration, calibrate
from truejoint.calibration.conformal import with_interval
from truejoint.crtk import Arm, StateBlock, TruthBlock, simulated_arm
from truejoint.crtk.arm import BRAKING
from truejoint.errors import CommandRefused
from truejoint.estimators import JointRegressor, NeuralNetwork
from truejoint.motion import follow, random_motion, zigzag
from truejoint.recordings import Recording
from truejoint.runtime import Corrector, Status
from truejoint.simulation import make_twin

HOMING = "1"
TRAJECTORIES = 10  # for the interval: enough for 90 %
PERIOD = 1e-3
BLOCK = 10_000  # samples taken from the simulated arm at a time
STRETCH = 500  # periods
SLACK = 200e-6  # before a deadline it waits actively, as sleeping wakes late
ALLOWED = 0.02 + BRAKING  # [s] until an arm stands
LATEST = 4.0  # of the robot's clock [s] after a command began
SLOW = np.array([0.005, 0.005, 0.001, 0.02, 0.02, 0.02, 0.02])  # [rad/s, m/s]


@dataclass
class Samples:
    """Samples as a loop gets them, and what the arm reported: stamps [s], rows of signals."""

    signals: tuple[str, ...]
    t: list[float]
    rows: Array


@dataclass
class Session:
    """One homing of the left arm, with recordings to train on and to make intervals of."""

    arm: Arm
    training: list[Recording]
    held_back: list[Recording]

    def fit(self, estimator: str | JointRegressor, **how: Any) -> Calibration:
        """Calibration with an interval, `how` as `calibrate` takes it."""
        return with_interval(calibrate(self.training, estimator, **how), self.held_back)

    def samples(
        self, signals: tuple[str, ...], duration: float, seed: int = 7, pause: float = 0.0
    ) -> Samples:
        """Go on moving at random for `duration` [s], then hold for `pause`; take every sample."""
        with blocks_of(self.arm, StateBlock) as blocks:
            follow(self.arm, random_motion(self.arm.robot, duration=duration, seed=seed))
            if pause > 0.0:
                self.arm.wait(pause)
        columns = [block.columns() for block in blocks]
        rows = [np.column_stack([one[name] for name in signals]) for one in columns]
        stamps = np.concatenate([block.t for block in blocks])
        return Samples(signals, stamps.tolist(), np.concatenate(rows))


def simulated_session(seed: int = 0) -> Session:
    """Zig-zags for training, and short random motions for the interval."""
    arm = homed(simulated_arm("raven2", "left", seed=seed))
    paths = [zigzag(arm.robot, "J1-J2-J3", 1 / n) for n in (4, 5)]
    paths += [random_motion(arm.robot, 60, seed=100 + i) for i in range(TRAJECTORIES)]
    made = [recorded(arm, path, session=path.name, homing_id=HOMING) for path in paths]
    return Session(arm, made[:2], made[2:])


def wait_until(deadline: float) -> None:
    """Sleep, then spin, until a time of the monotonic clock [s]."""
    remaining = deadline - time.perf_counter() - SLACK
    if remaining > 0:
        time.sleep(remaining)
    while time.perf_counter() < deadline:
        pass


class Loop:
    """Counts of one loop over all its stretches."""

    def __init__(self) -> None:
        self.missed: list[int] = []
        self.worst = 0.0
        self.busy: list[Array] = []
        self.statuses: Counter[int] = Counter()
        self.log: list[list[float]] = []

    def run(self, corrector: Corrector | None, stamps: list[float], rows: list[Array]) -> None:
        """Run one stretch; without a corrector, an empty one."""
        busy, steps = np.zeros(STRETCH), [0] * STRETCH
        log, missed = self.log, 0
        deadline = time.perf_counter() + 10 * PERIOD
        for i in range(STRETCH):
            wait_until(deadline)
            position = 0.0
            if corrector is not None:
                start = time.perf_counter()
                steps[i] = corrector.step(stamps[i], rows[i])
                position = float(corrector.position[0])
                busy[i] = time.perf_counter() - start
            log.append([deadline, position])
            late = time.perf_counter() - deadline
            deadline += PERIOD
            if late > PERIOD:
                skipped = int(late / PERIOD)
                missed += skipped
                self.worst = max(self.worst, late)
                deadline += skipped * PERIOD
        self.missed.append(missed)
        self.busy.append(busy)
        self.statuses.update(steps)
        if not np.isfinite(log).all():
            raise SystemExit("a position was not finite")
        if len(log) >= BLOCK:
            log.clear()

    def report(self, name: str) -> None:
        """Print a row of the table."""
        periods, missed = STRETCH * len(self.missed), sum(self.missed)
        row(name, periods, missed, f"{100 * missed / periods:.4f} %", f"{1e3 * self.worst:.1f}")


def corrector_part(minutes: float, name: str) -> None:
    """Print how often a loop with a corrector misses a period, and an empty one."""
    session = simulated_session()
    model = session.fit(NeuralNetwork(epochs=5) if name == "dnn" else name)
    corrector = Corrector(model)
    corrector.set_homing(True, HOMING)
    empty, correcting = Loop(), Loop()
    gc.enable()
    collections = sum(generation["collections"] for generation in gc.get_stats())
    for index in range(max(1, round(minutes * 60 / (BLOCK * PERIOD)))):
        samples = session.samples(model.loop_signals, BLOCK * PERIOD, seed=index)
        for first in range(0, BLOCK, STRETCH):
            part = slice(first, first + STRETCH)
            empty.run(None, [], [])
            correcting.run(corrector, samples.t[part], list(samples.rows[part]))
    collections = sum(generation["collections"] for generation in gc.get_stats()) - collections
    head("loop at 1 kHz", "periods", "missed", "share", "worst lateness, ms")
    empty.report("empty")
    correcting.report(f"truejoint {model.estimator}")
    difference = 100 * (np.array(correcting.missed) - np.array(empty.missed)) / STRETCH
    error = difference.std(ddof=1) / np.sqrt(len(difference))
    busy = 1e6 * np.concatenate(correcting.busy)
    median, p99, p999 = np.percentile(busy, [50, 99, 99.9])
    print(f"\nDifference: {difference.mean():+.4f} +- {error:.4f} % (0.01 % allowed).")
    print(f"Correcting and reading: median {median:.1f} us, p99 {p99:.1f} us, p99.9 {p999:.1f} us.")
    shown = {repr(Status(bits)): count for bits, count in correcting.statuses.items()}
    print(f"Statuses: {shown}. Garbage collections: {collections}.")


def empty(seconds: float, pipe: Connection) -> None:
    """Sleep from millisecond to millisecond, and send how evenly that went."""
    starts = np.empty(round(seconds / PERIOD) + 1)
    due = time.perf_counter()
    for k in range(len(starts)):
        starts[k] = time.perf_counter()
        due += PERIOD
        late = time.perf_counter() - due
        if late < 0.0:
            time.sleep(-late)
        elif late > 0.1:
            due += late
    pipe.send(LoopTiming.of(starts, PERIOD))


def paced_part(minutes: float, name: str) -> None:
    """Print how even the periods of a paced arm are, and those of an empty loop."""
    seconds = 60 * minutes
    model = simulated_session().fit(name).without_redundant()
    corrector = Corrector(model)
    corrector.set_homing(True, HOMING)
    corrected = 0

    def correct(block: StateBlock | TruthBlock) -> None:
        nonlocal corrected
        if isinstance(block, StateBlock):
            columns = block.columns()
            sample = [columns[name][-1] for name in corrector.signals]
            corrected += corrector.step(float(block.t[-1]), sample) == 0

    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    backend = TimedBackend(make_twin("raven2", "left", seed=1))
    with Arm(backend) as arm:
        homed(arm)
        arm.subscribe(correct)
        beside = context.Process(target=empty, args=(seconds, theirs))
        beside.start()
        before = backend.timing().periods
        follow(arm, random_motion(arm.robot, seconds, seed=3))
        loop = backend.timing()
    rows = {"arm and corrector": loop, "empty loop": ours.recv()}
    beside.join()
    print(f"load of the machine: {os.getloadavg()[1]:.1f}; {corrected} samples corrected;")
    print(f"{before} periods of the arm are of its homing\n")
    head("loop", "periods", "median [ms]", "99 % [ms]", "longest [ms]", "late")
    for title, timing in rows.items():
        times = (f"{1e3 * v:.3f}" for v in (timing.median, timing.p99, timing.worst))
        row(title, timing.periods, *times, f"{100 * timing.late_share:.3f} %")


def commands(arm: Arm, rng: np.random.Generator) -> dict[str, Callable[[], object]]:
    """Every kind of command, none over within a minute: a thread is not woken at once."""
    home = arm.robot.home
    way = 0.5 * rng.choice([-1.0, 1.0], 7) * np.array([0.5, 0.5, 0.1, 1.0, 1.0, 0.5, 0.5])
    rows = home + np.linspace(0.0, 0.5, 60_000)[:, None] * way

    def move_cp() -> None:
        pose = arm.setpoint_cp()
        pose[:3, 3] += rng.choice([-1.0, 1.0], 3) * [0.01, 0.008, 0.01]
        arm.move_cp(pose, 0.1 * SLOW).wait()

    return {
        "home": arm.home,
        "move_jp": lambda: arm.move_jp(home + way, SLOW).wait(),
        "move_jr": lambda: arm.move_jr(way, SLOW).wait(),
        "move_cp": move_cp,
        "servo_jp_stream": lambda: arm.servo_jp_stream(rows),
        "wait": lambda: arm.wait(60.0),
        "follow": lambda: follow(arm, zigzag(arm.robot, "J1-J2-J3", 1 / 2)),
    }


def pause_one(
    arm: Arm, name: str, call: Callable[[], object], delay: float, every: float
) -> tuple[float, bool]:
    """Time until the arm stood [s], and whether all is as it should be."""
    start, due, asked = arm.time, threading.Event(), []

    def look(_: StateBlock | TruthBlock) -> None:
        if arm.time >= start + delay:
            due.set()

    def pause() -> None:
        while name == "home" and arm.time < start + delay:  # reports nothing
            pass
        due.wait(60.0) if name != "home" else None
        asked.append(arm.time)
        arm.pause()

    arm.subscribe(look, every)
    thread = threading.Thread(target=pause)
    thread.start()
    said = False
    try:
        call()
    except CommandRefused:  # stopped, or not begun where the pause came while it was planned
        said = True
    thread.join(60.0)
    arm.unsubscribe(look)
    took = arm.time - asked[0]
    rests = name == "home" or not arm.setpoint_js(np.inf).velocity.any()
    return took, said and rests and arm.operating_state().state == "PAUSED"


def stopping_part(pauses: int, seed: int) -> None:
    """Pause again and again, and print what went wrong."""
    rng = np.random.default_rng(seed)
    arm = homed(simulated_arm(seed=seed))
    names = list(commands(arm, rng))
    times: dict[str, list[float]] = {name: [] for name in names}
    misses = dict.fromkeys(names, 0)
    for _ in range(pauses):
        name = names[rng.integers(len(names))]
        delay, every = float(rng.uniform(0.0, LATEST)), float(rng.choice([0.0, 0.5]))
        took, good = pause_one(arm, name, commands(arm, rng)[name], delay, every)
        times[name].append(took)
        misses[name] += not good or took > ALLOWED + 1e-9
        arm.resume()
        if not arm.operating_state().is_homed:
            arm.home()
        arm.move_jp(arm.robot.home, np.full(7, 0.04)).wait()
    head("command", "pauses", "median [ms]", "longest [ms]", "allowed [ms]", "misses")
    for name, laps in times.items():
        if laps:
            shown = (f"{1e3 * t:.0f}" for t in (np.median(laps), max(laps), ALLOWED))
            row(name, len(laps), *shown, misses[name])


def main() -> None:
    """Print the tables that are asked for."""
    parts = ("corrector", "paced", "stopping")
    options = parsed(__doc__, parts=parts, minutes=10.0, estimator="linear", pauses=1000, seed=0)
    if "corrector" in options.parts:
        corrector_part(options.minutes, options.estimator)
    if "paced" in options.parts:
        paced_part(options.minutes, options.estimator)
    if "stopping" in options.parts:
        stopping_part(options.pauses, options.seed)


if __name__ == "__main__":
    main()
