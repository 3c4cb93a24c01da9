"""The corrector at 1 kHz for minutes: periods that it misses, beside those of an empty loop.

    python -m benchmarks.soak [--minutes 10] [--estimator dnn]

A plain Python loop sleeps until each absolute deadline, takes the next sample of the simulated
arm, corrects it, reads the outcome and writes a log of lists, so that garbage is collected. Half
seconds of it take turns with an empty loop, which only sleeps and writes the log, so that both
meet the same machine. A period is missed when its work is not done by the next deadline.
`--minutes` is the time of the corrector; the whole takes somewhat more than twice that. The
samples start anew every ten seconds: one TIME_JUMP each.
"""

from __future__ import annotations

import argparse
import gc
import time
from collections import Counter

import numpy as np
from numpy.typing import NDArray

from benchmarks.loop_session import HOMING, simulated_session
from truejoint.estimators import JointRegressor, NeuralNetwork
from truejoint.runtime import Corrector, Status

Row = NDArray[np.float64]

PERIOD = 1e-3
BLOCK = 10_000  # samples taken from the simulated arm at a time
STRETCH = 500  # periods
SLACK = 200e-6  # before a deadline it waits actively, as sleeping wakes late


def wait_until(deadline: float) -> None:
    """Sleep, then spin, until a time of the monotonic clock [s]."""
    left = deadline - time.perf_counter() - SLACK
    if left > 0:
        time.sleep(left)
    while time.perf_counter() < deadline:
        pass


class Loop:
    """Counts of one loop over all its stretches."""

    def __init__(self) -> None:
        self.missed: list[int] = []
        self.worst = 0.0
        self.busy: list[NDArray[np.float64]] = []
        self.seen: Counter[int] = Counter()
        self.log: list[list[float]] = []

    def run(self, corrector: Corrector | None, stamps: list[float], rows: list[Row]) -> None:
        """Run one stretch; without a corrector, an empty one."""
        busy, statuses = np.zeros(STRETCH), [0] * STRETCH
        log, missed = self.log, 0
        deadline = time.perf_counter() + 10 * PERIOD
        for i in range(STRETCH):
            wait_until(deadline)
            position = 0.0
            if corrector is not None:
                start = time.perf_counter()
                statuses[i] = corrector.step(stamps[i], rows[i])
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
        self.seen.update(statuses)
        if not np.isfinite(log).all():
            raise SystemExit("a position was not finite")
        if len(log) >= BLOCK:
            log.clear()

    def report(self, name: str) -> None:
        """Print a row of the table."""
        periods, missed = STRETCH * len(self.missed), sum(self.missed)
        share = 100 * missed / periods
        print(f"| {name} | {periods} | {missed} | {share:.4f} % | {1e3 * self.worst:.1f} |")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--estimator", default="dnn", choices=("offset", "linear", "poly2", "dnn"))
    options = parser.parse_args()
    session = simulated_session()
    chosen: str | JointRegressor = options.estimator
    model = session.fit(NeuralNetwork(epochs=5) if chosen == "dnn" else chosen)
    corrector = Corrector(model)
    corrector.set_homing(True, HOMING)
    empty, correcting = Loop(), Loop()
    gc.enable()
    collections = sum(generation["collections"] for generation in gc.get_stats())
    for index in range(max(1, round(options.minutes * 60 / (BLOCK * PERIOD)))):
        samples = session.samples(model.loop_signals, BLOCK * PERIOD, seed=index)
        for first in range(0, BLOCK, STRETCH):
            part = slice(first, first + STRETCH)
            empty.run(None, [], [])
            correcting.run(corrector, samples.t[part], list(samples.rows[part]))
    collections = sum(generation["collections"] for generation in gc.get_stats()) - collections
    print("| loop at 1 kHz | periods | missed | share | worst lateness, ms |")
    print("|---|---|---|---|---|")
    empty.report("empty")
    correcting.report(f"truejoint {model.estimator}")
    difference = 100 * (np.array(correcting.missed) - np.array(empty.missed)) / STRETCH
    error = difference.std(ddof=1) / np.sqrt(len(difference))
    busy = 1e6 * np.concatenate(correcting.busy)
    median, p99, p999 = np.percentile(busy, [50, 99, 99.9])
    print(f"\nDifference: {difference.mean():+.4f} +- {error:.4f} % (0.01 % allowed).")
    print(f"Correcting and reading: median {median:.1f} us, p99 {p99:.1f} us, p99.9 {p999:.1f} us.")
    shown = {repr(Status(bits)): count for bits, count in correcting.seen.items()}
    print(f"Statuses: {shown}. Garbage collections: {collections}.")


if __name__ == "__main__":
    main()
