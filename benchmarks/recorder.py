"""What a recorder drops in minutes of real time, and what it loses when its program is killed.

    python -m benchmarks.recorder [--minutes 10] [--kills 200] [--at-once 4] [--seed 0]

`--minutes`: a simulated RAVEN-II at the pace of the wall clock moves at random, its state recorded
at 1 kHz and its joint encoders at 100 Hz; what arrived is compared with what is in the file.
`--kills`: programs that record such blocks, in pieces of 10 ms by the wall clock, are each ended by
`kill -9` at a random time, from 0.1 to 8 s after they began. Lost is the time from the last state
in the file to the kill; a file that cannot be read is a miss, but for one without any row
where the kill came within the second that may be lost.
"""

import multiprocessing
import tempfile
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import head, parsed, row
from benchmarks.arms import homed
from benchmarks.timing import TimedBackend
from truejoint.crtk import Arm, StateBlock, TruthBlock
from truejoint.crtk.handle import Subscription
from truejoint.errors import TruejointError
from truejoint.motion import follow, random_motion
from truejoint.recordings import Recorder, read_recording
from truejoint.robots import get_robot
from truejoint.robots.blocks import QUANTITIES
from truejoint.simulation import make_twin

ALLOWED = 1.0  # s
EARLIEST, LATEST = 0.1, 8.0  # s


def at_real_time(minutes: float, seed: int, folder: Path) -> None:
    """Record for minutes, and print what arrived, what was kept, and how large it is."""
    backend = TimedBackend(make_twin("raven2", "left", seed=seed))
    path, told = folder / "long.parquet", Counter[type]()

    def count(block: StateBlock | TruthBlock) -> None:
        told[TruthBlock if isinstance(block, TruthBlock) else StateBlock] += len(block.t)

    with Arm(backend) as arm:
        homed(arm)
        motion = random_motion(arm.robot, 60 * minutes, seed)
        with Recorder(arm, state_rate=np.inf, path=path) as recorder:
            arm.subscribe(count)
            start = time.perf_counter()
            follow(arm, motion)
            taken = time.perf_counter() - start
            arm.unsubscribe(count)
        timing = backend.timing()
    rows = len(read_recording(path))
    truths = sum(len(piece.t) for piece in recorder._pieces["truth"])
    head("wall time [s]", "states told", "kept", "truth told", "kept", "file [MB]", "late periods")
    size, late = f"{path.stat().st_size / 1e6:.1f}", f"{100 * timing.late_share:.2f} %"
    row(f"{taken:.0f}", told[StateBlock], rows, told[TruthBlock], truths, size, late)


class Source:
    """An arm that only tells: RAVEN-II's blocks by the wall clock."""

    homing_id = "1"
    stretch = 0.5

    def __init__(self) -> None:
        self.robot = get_robot("raven2", "left")
        self.tell: Any = None

    def subscribe(self, callback: Any, every: float = 0.0) -> None:
        """Tell this one."""
        self.tell = Subscription(callback, every)

    def unsubscribe(self, callback: Any) -> None:  # noqa: ARG002  # an Arm's
        """Tell nobody."""
        self.tell = None

    def deliver(self, callback: Any) -> None:  # noqa: ARG002  # an Arm's
        """Tell what is kept."""
        if self.tell:
            self.tell.flush()

    def go_on(self, start: float) -> None:
        """Tell a piece after the other, stamped by the wall clock from `start` on, for ever."""
        names, told = self.robot.channels, 0
        waves: Any = np.random.default_rng(0).normal(size=(10, len(names)))
        while True:
            now = time.monotonic() - start
            if now < (told + 10) * 1e-3:
                time.sleep((told + 10) * 1e-3 - now)
            t: Any = 1e-3 * np.arange(told, told + 10)
            self.tell(StateBlock(t, names, **dict.fromkeys(QUANTITIES, waves + t[:, None])))
            self.tell(TruthBlock(t[:1], self.robot.positioning, waves[:1, :3]))
            told += 10


def victim(path: Path, pipe: Connection) -> None:
    """Record until killed; says when it began."""
    source: Any = Source()
    with Recorder(source, state_rate=np.inf, path=path):
        start = time.monotonic()
        pipe.send(start)
        source.go_on(start)


def kill_one(folder: Path, number: int, delay: float) -> float:
    """Time that is missing in the file of a program killed after `delay` [s]; infinite for all."""
    context = multiprocessing.get_context("forkserver")
    ours, theirs = context.Pipe()
    path = folder / f"run{number}.parquet"
    process = context.Process(target=victim, args=(path, theirs))
    process.start()
    start = ours.recv()
    time.sleep(max(0.0, start + delay - time.monotonic()))
    killed = time.monotonic() - start
    process.kill()
    process.join()
    left = sorted(folder.glob(f"run{number}.unfinished*"))
    try:
        last = float(read_recording(left[0]).t[-1]) if left else np.nan
    except TruejointError as error:
        if killed < ALLOWED and "row" in str(error):
            return killed  # it opens, and holds nothing yet
        print(f"run {number}, killed after {killed:.2f} s: {error}")
        return np.inf
    return killed - last if np.isfinite(last) else np.inf


def kills(number: int, at_once: int, seed: int, folder: Path) -> None:
    """Kill programs that record, and print what is lost."""
    multiprocessing.get_context("forkserver").set_forkserver_preload(["truejoint.recordings"])
    delays = np.random.default_rng(seed).uniform(EARLIEST, LATEST, number).tolist()
    with ThreadPoolExecutor(at_once) as pool:
        lost = np.array(list(pool.map(lambda k: kill_one(folder, k, delays[k]), range(number))))
    head("killed", "opened", "lost, median [s]", "longest [s]", "allowed [s]", "misses")
    opened, misses = int(np.isfinite(lost).sum()), int((~(lost <= ALLOWED)).sum())
    median, longest = np.median(lost), lost.max()
    row(number, opened, f"{median:.2f}", f"{longest:.2f}", f"{ALLOWED:g}", misses)


def main() -> None:
    """Run what is asked for."""
    options = parsed(__doc__, minutes=10.0, kills=200, at_once=4, seed=0)
    with tempfile.TemporaryDirectory() as folder:
        if options.kills:
            kills(options.kills, options.at_once, options.seed, Path(folder))
        if options.minutes:
            at_real_time(options.minutes, options.seed, Path(folder))


if __name__ == "__main__":
    main()
