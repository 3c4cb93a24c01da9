"""Look for what breaks: random cases until the time is up, in processes with bounded memory.

    python -m tests.fuzz [--minutes 5] [--seed N] [--case NUMBER]

Prints its seed and each case that ends in a traceback, takes longer than 20 s of processor time,
waits for minutes, or needs more than 1 GiB beyond what was loaded before; exit code 1 when there
was any. `--case` shows a single one.
"""

import argparse
import mmap
import os
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
from pathlib import Path

from tests.synthetic import build_recording

import truejoint

from .cases import make, make_seeds

MEMORY = 1 << 30  # bytes
LONGEST = 20  # s of processor time
LONGEST_WAIT = 200  # s by the clock: for what waits for something that never comes
BATCH = 500  # cases in one process


class TooLongError(BaseException):
    """A case took too long; a BaseException, so that nobody takes it for an error of his own."""


def run_case(seed: int, number: int, seeds: Path, folder: Path) -> str:
    """Run a case; what went wrong, with its last lines, empty if nothing."""

    def stop(*_: object) -> None:
        raise TooLongError

    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    os.chdir(folder)
    what, case = make(seed, number, seeds, folder)
    signal.signal(signal.SIGVTALRM, stop)
    signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_VIRTUAL, LONGEST)
    signal.setitimer(signal.ITIMER_REAL, LONGEST_WAIT)
    try:
        case()
    except BaseException:  # noqa: BLE001  # whatever it is, it is reported
        return f"{what}\n{''.join(traceback.format_exc().splitlines(keepends=True)[-6:])}"
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0)
        signal.setitimer(signal.ITIMER_REAL, 0)
    return ""


def run_batch(seed: int, first: int, seeds: Path, folder: Path, at: mmap.mmap, ends: float) -> None:
    """Run cases in this process, which ends after them.

    `at` holds which one it is at, and how many went wrong in all.
    """
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + MEMORY,) * 2)
    for number in range(first, first + BATCH):
        at[:8] = number.to_bytes(8, "little")
        if time.monotonic() > ends:
            os._exit(1)
        if wrong := run_case(seed, number, seeds, folder):
            report(seed, number, wrong, at)
    os._exit(0)


def report(seed: int, number: int, wrong: str, at: mmap.mmap) -> None:
    """Print what went wrong, and count it."""
    print(f"\n--seed {seed} --case {number}: {wrong}", flush=True)
    at[8:] = (int.from_bytes(at[8:], "little") + 1).to_bytes(8, "little")


def main() -> int:
    """Fuzz until the time is up; 1 when anything was found."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=float(os.environ.get("FUZZ_MINUTES", "5")))
    parser.add_argument("--seed", type=int, default=time.time_ns() % 10**6)
    parser.add_argument("--case", type=int)
    options = parser.parse_args()
    # A shell's background ignores Ctrl-C, by which cases end what would serve for ever.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    with tempfile.TemporaryDirectory() as name:
        seeds, folder = Path(name, "seeds"), Path(name, "case")
        seeds.mkdir()
        make_seeds(seeds)
        if options.case is not None:
            print(run_case(options.seed, options.case, seeds, folder) or "nothing wrong")
            os.chdir("/")
            return 0
        print(f"seed {options.seed}, {options.minutes:g} minutes", flush=True)
        truejoint.calibrate(build_recording(300, 0))  # compiles what the choice tries
        for warm in range(30):  # kernels and modules, before the memory is counted
            run_case(0, warm, seeds, folder)
        at, ends, number = mmap.mmap(-1, 16), time.monotonic() + 60 * options.minutes, 0
        while time.monotonic() < ends:
            child = os.fork()
            if child == 0:
                try:
                    run_batch(options.seed, number, seeds, folder, at, ends)
                except BaseException:  # noqa: BLE001  # the folder is the parent's to remove
                    traceback.print_exc()
                    os._exit(2)
            ended = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
            number = int.from_bytes(at[:8], "little") + (ended != 1)
            if ended not in {0, 1}:
                report(options.seed, number - 1, f"its process ended with {ended}", at)
            print(f"{number} cases", end="\r", flush=True)
        os.chdir("/")
    failures = int.from_bytes(at[8:], "little")
    print(f"\n{number} cases, seed {options.seed}: {failures} went wrong")
    return int(failures > 0)


if __name__ == "__main__":
    sys.exit(main())
