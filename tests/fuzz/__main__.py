"""Look for what breaks: random cases until the time is up, in processes with bounded memory.

    python -m tests.fuzz [--minutes 5] [--seed N] [--case NUMBER]

Prints its seed and each case that ends in a traceback, takes longer than 20 s of processor time,
waits for minutes, or needs more than 1 GiB beyond what was loaded before; exit code 1 when there
was any. `--case` shows a single one.
"""

import argparse
import json
import mmap
import os
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter
from pathlib import Path

from .cases import everything, make, make_seeds

MEMORY = 1 << 30  # bytes
LONGEST = 20  # s of processor time
LONGEST_WAIT = 200  # s by the clock: for what waits for something that never comes
BATCH = 500  # cases in one process
COVERED: Counter[str] = Counter()  # how often the cases of this process tried what


class TooLongError(BaseException):
    """A case took too long; a BaseException, so that nobody takes it for an error of his own."""


def run_case(seed: int, number: int, seeds: Path, folder: Path) -> str | None:
    """Run a case; what went wrong, with its last lines, or None."""

    def stop(*_: object) -> None:
        raise TooLongError

    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    os.chdir(folder)
    what, case, covered = make(seed, number, seeds, folder)
    COVERED.update(covered)
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
    return None


def run_batch(seed: int, first: int, seeds: Path, folder: Path, at: mmap.mmap, ends: float) -> None:
    """Run cases in this process, which ends after them; `at` tells which one it is at."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + MEMORY,) * 2)
    for number in range(first, first + BATCH):
        at[:8] = number.to_bytes(8, "little")
        if time.monotonic() > ends:
            note_covered(seeds)
            os._exit(1)
        wrong = run_case(seed, number, seeds, folder)
        if wrong:
            with (seeds.parent / "found.jsonl").open("a") as file:
                file.write(json.dumps([number, wrong]) + "\n")
    note_covered(seeds)
    os._exit(0)


def note_covered(seeds: Path) -> None:
    """Add what the cases of this process tried to that of all."""
    with (seeds.parent / "covered.jsonl").open("a") as file:
        file.write(json.dumps(COVERED) + "\n")


def report_covered(seeds: Path) -> None:
    """Print how much of what can be tried was tried, by its kind."""
    covered: Counter[str] = Counter()
    for line in (seeds.parent / "covered.jsonl").read_text().splitlines():
        covered.update(json.loads(line))
    whole = everything(seeds)
    for kind in sorted({name.split()[0] for name in whole}):
        names = {name for name in whole if name.split()[0] == kind}
        tried = sum(covered[name] for name in names)
        print(f"  {kind}: {len(names & set(covered))} of {len(names)}, {tried} times")
        for name in sorted(names - set(covered))[:20]:
            print(f"    not tried: {name}")


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
        for warm in range(30):  # kernels and modules, before the memory is counted
            run_case(0, warm, seeds, folder)
        COVERED.clear()
        at, ends, number = mmap.mmap(-1, 8), time.monotonic() + 60 * options.minutes, 0
        while time.monotonic() < ends:
            child = os.fork()
            if child == 0:
                try:
                    run_batch(options.seed, number, seeds, folder, at, ends)
                except BaseException:  # noqa: BLE001  # the folder is the parent's to remove
                    traceback.print_exc()
                    os._exit(2)
            _, code = os.waitpid(child, 0)
            ended = os.waitstatus_to_exitcode(code)
            number = int.from_bytes(at[:8], "little") + (ended != 1)
            if ended not in {0, 1}:
                with (seeds.parent / "found.jsonl").open("a") as file:
                    file.write(json.dumps([number - 1, f"its process ended with {ended}"]) + "\n")
            print(f"{number} cases", end="\r", flush=True)
        os.chdir("/")
        found = seeds.parent / "found.jsonl"
        lines = found.read_text().splitlines() if found.exists() else []
        for line in lines:
            case, wrong = json.loads(line)
            print(f"\n--seed {options.seed} --case {case}: {wrong}")
        print(f"\n{number} cases, seed {options.seed}: {len(lines)} went wrong")
        report_covered(seeds)
    return bool(lines)


if __name__ == "__main__":
    sys.exit(main())
