"""A simulated arm at the wall clock's pace with a corrector in its loop, beside an empty loop.

    python -m benchmarks.paced_loop [--minutes 10] [--estimator linear]

Two programs run at the same time: a `PacedBackend` at 1 kHz whose messages a corrector corrects as
they come, while the arm moves at random; and a loop that only sleeps until the next millisecond.
A period is late when it takes more than 1.5 ms.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import time
from multiprocessing.connection import Connection

import numpy as np

from benchmarks.loop_session import HOMING, simulated_session
from truejoint.crtk import Arm, PacedBackend, StateBlock, TruthBlock
from truejoint.crtk.backends.paced import LoopTiming
from truejoint.motion import follow, random_motion
from truejoint.runtime import Corrector
from truejoint.simulation import make_twin

PERIOD = 1e-3


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


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--estimator", default="linear")
    options = parser.parse_args()
    seconds = 60 * options.minutes
    model = simulated_session().fit(options.estimator).without_redundant()
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
    backend = PacedBackend(make_twin("raven2", "left", seed=1))
    with Arm(backend) as arm:
        arm.enable()
        arm.home()
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
    print("| loop | periods | median [ms] | 99 % [ms] | longest [ms] | late |")
    print("|---|---:|---:|---:|---:|---:|")
    for name, timing in rows.items():
        times = " | ".join(f"{1e3 * v:.3f}" for v in (timing.median, timing.p99, timing.worst))
        print(f"| {name} | {timing.periods} | {times} | {100 * timing.late_share:.3f} % |")


if __name__ == "__main__":
    main()
