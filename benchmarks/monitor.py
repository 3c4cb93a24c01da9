"""What watching an arm costs, and how soon the page shows what the arm does.

    python -m benchmarks.monitor [--minutes 10] [--seed 0]

A simulated RAVEN-II at the wall clock's pace, 1 kHz, moves at random with a linear model beside it,
first alone and then with the page open in a headless Chromium at 1280 x 800, which draws on the
processor, without graphics hardware. Pictures that the browser shows are changes of the clock on
the page; latency is from the stamp of the sample shown, on the arm's clock, until the page has it.
Load is the processor time of the thread that corrects and of the process that draws, as a share of
one core, Chromium's not among it; growth is the slope of both processes' memory over the second
half. Late periods of the
arm's loop are those above 1.5 ms.
"""

import itertools
import os
import tempfile
import threading
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
from tests.chromium import Chromium

import truejoint
from benchmarks import head, parsed, row
from benchmarks.arms import homed, recorded
from benchmarks.timing import TimedBackend, processor_time
from truejoint.crtk import Arm
from truejoint.errors import TruejointError
from truejoint.monitor import ArmPage
from truejoint.motion import follow, random_motion
from truejoint.simulation import make_twin

PIECE = 10.0  # [s] between two looks
# Notes in the page when it shows another clock, by a look every 2 ms.
NOTE = """(() => { window.seen = []; let last = '';
  setInterval(() => { const e = document.querySelector('#clock');
    if (e && e.dataset.t !== last) { last = e.dataset.t; seen.push([+last, Date.now() / 1e3]); }
  }, 2); })()"""


class Clock:
    """Which time of day the arm's clock stood for, noted as both run."""

    def __init__(self, arm: Arm) -> None:
        self._arm, self._over = arm, threading.Event()
        # All the memory at once: its own growth is not to be measured.
        self._pairs, self._noted = np.full((200_000, 2), np.nan), 0
        self._thread = threading.Thread(target=self._note, daemon=True)
        self._thread.start()

    def _note(self) -> None:
        while not self._over.wait(0.02):
            self._pairs[self._noted] = self._arm.time, time.time()
            self._noted += 1

    def ages(self, seen: np.ndarray) -> np.ndarray:
        """How old each stamp was when it was seen [s]."""
        robot, day = self._pairs[: self._noted].T
        t, at = seen.T
        return at - np.interp(t, robot, day)

    def stop(self) -> None:
        """End noting."""
        self._over.set()
        self._thread.join()


def spent(page: ArmPage) -> np.ndarray:
    """Processor time [s] of the monitor's threads here, and of the process that draws."""
    here = [t.native_id for t in threading.enumerate() if t.name.startswith("monitor")]
    ours = sum(processor_time(Path(f"/proc/self/task/{task}/stat")) for task in here)
    return np.array([ours, processor_time(Path(f"/proc/{page._page.pid}/stat"))])


def memory(page: ArmPage) -> float:
    """Memory of this process and of the one that draws, that is in use [MB]."""
    files = Path("/proc/self/statm"), Path(f"/proc/{page._page.pid}/statm")
    pages = sum(int(file.read_text().split()[1]) for file in files)
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def a_model(seed: int) -> truejoint.Calibration:
    """Linear model of the same arm, of a minute of random motion, faster than real time."""
    arm = homed(truejoint.crtk.simulated_arm("raven2", seed=seed))
    return truejoint.calibrate(recorded(arm, random_motion(arm.robot, 60.0, seed=seed)), "linear")


def move(arm: Arm) -> None:
    """Move at random until the arm is closed."""
    with suppress(TruejointError):
        for seed in itertools.count():
            follow(arm, random_motion(arm.robot, 120.0, seed=seed))


def main() -> None:
    """Watch for some minutes and print the table."""
    options = parsed(__doc__, minutes=10.0, seed=0)
    model = a_model(options.seed)
    backend = TimedBackend(make_twin("raven2", seed=options.seed))
    arm = homed(Arm(backend))
    threading.Thread(target=move, args=(arm,), daemon=True).start()
    time.sleep(PIECE)
    first = backend.passes
    time.sleep(3 * PIECE)
    alone, used, seen = backend.timing(first), [], []
    with (
        tempfile.TemporaryDirectory() as folder,
        ArmPage(arm, model, port=0) as page,
        Chromium(Path(folder)) as browser,
    ):
        browser.open(page.url)
        browser.until("document.querySelector('#clock') !== null")
        time.sleep(PIECE)
        clock = Clock(arm)
        browser.evaluate(NOTE)
        made, show = itertools.count(), page._page.show
        page._page.show = lambda *told: (next(made), show(*told))[1]  # type: ignore[method-assign]
        first, began, before = backend.passes, time.monotonic(), spent(page)
        while time.monotonic() < began + 60.0 * options.minutes:
            time.sleep(PIECE)
            # As an array at once: lists of every picture would be seven megabytes an hour.
            seen.append(np.array(browser.evaluate("seen.splice(0)")).reshape(-1, 2))
            used.append((time.monotonic() - began, memory(page)))
        duration = time.monotonic() - began
        share, watched = (spent(page) - before) / duration, backend.timing(first)
        clock.stop()
    arm.pause()
    arm.close()
    pictures = np.concatenate(seen)
    median, p95 = 1e3 * np.quantile(clock.ages(pictures), [0.5, 0.95])
    t, size = np.array(used).T
    later = t >= t[-1] / 2
    slope = np.polyfit(t[later] / 3600.0, size[later], 1)[0]
    head("what", "measured", "bar")
    for cells in (
        ("pictures/s that are made", f"{next(made) / duration:.1f}", "20"),
        ("pictures/s that the browser shows", f"{len(pictures) / duration:.1f}", "20"),
        ("share of a core", f"{share.sum():.3f}", "0.25"),
        ("of it in the arm's own process", f"{share[0]:.3f}", ""),
        ("latency arm to page, median [ms]", f"{median:.0f}", "100"),
        ("the same, of 95 % [ms]", f"{p95:.0f}", ""),
        (f"memory, {size[0]:.0f} to {size[-1]:.0f} MB: slope [MB/h]", f"{slope:.1f}", "0"),
        ("late periods of the arm alone [%]", f"{100 * alone.late_share:.2f}", ""),
        ("late periods of the arm watched [%]", f"{100 * watched.late_share:.2f}", ""),
        (f"errors on the console {browser.errors[:1]}"[:200], f"{len(browser.errors)}", "0"),
    ):  # fmt: skip
        row(*cells)
    print(f"\n{duration / 60:.1f} min, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}")


if __name__ == "__main__":
    main()
