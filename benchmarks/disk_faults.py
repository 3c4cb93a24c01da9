"""What is left of files when writing them is cut off, and of their values when bits flip.

    python -m benchmarks.disk_faults [--kills 200] [--interrupts 50] [--full 50] [--flips 10000]

Each command that writes runs again and again with ``--force`` over files that stand for good ones
(in processes forked from one that has just run it), and is killed (SIGKILL) at a random
time after it opened its first file for writing; or interrupted (SIGINT) at a random time of its
whole run; or allowed files of a random size only, as on a disk that is full. Afterwards each file
must be the one from before or a whole new one. Then pairs of the same command start at once without
``--force``: one may win. Last, single bits flip in a recording, a model and a trajectory.
"""

from __future__ import annotations

import argparse
import io
import os
import random
import resource
import select
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import truejoint
from truejoint.calibration.model_file import encode, read_calibration
from truejoint.cli.app import INTERRUPTED, main
from truejoint.errors import TruejointError

GOOD = b"the good file from before\n"
CRASHED = 99
STUDY = ("--preset", "small", "--jobs", "1", "--set", "methods=lsm")


@dataclass(frozen=True)
class Case:
    """A command, and the files that it writes."""

    words: tuple[str, ...]
    targets: tuple[str, ...]

    @property
    def name(self) -> str:
        """What the table calls it."""
        return f"{self.words[0]} -> {Path(self.targets[0]).suffix}"


CASES = (
    Case(("trajectory", "zigzag", "-o", "out/z.csv"), ("out/z.csv",)),
    Case(("trajectory", "show", "z.csv", "--plot", "out/z.html"), ("out/z.html",)),
    Case(("collect", "z.csv", "-o", "out"), ("out/z.parquet",)),
    Case(("calibrate", "z.parquet", "-e", "linear", "-o", "out/m.st"), ("out/m.st",)),
    Case(("check", "m.st", "z.parquet", "--rezero", "out/n.st"), ("out/n.st",)),
    Case(("correct", "m.st", "z.parquet", "-o", "out/c.csv"), ("out/c.csv",)),
    Case(("correct", "m.st", "z.parquet", "-o", "out/c.parquet"), ("out/c.parquet",)),
    Case(("evaluate", "m.st", "z.parquet", "--report", "out/r.html"), ("out/r.html",)),
    Case(
        ("evaluate", "m.st", "z.parquet", "--tables", "out"),
        tuple(f"out/{j}.{s}" for j in ("shoulder", "elbow", "insertion") for s in ("csv", "tex")),
    ),
    Case(
        ("export", "m.st", "--to", "c", "-o", "out", "--prefix", "m"),
        ("out/m.c", "out/m.h", "out/m_main.c", "out/m_vectors.h"),
    ),
    Case(("export", "m.st", "--to", "onnx", "-o", "out", "--prefix", "m"), ("out/m.onnx",)),
    Case(
        ("join", "robot.parquet", "truth.csv", "--offset-s", "0", "-o", "out/j.parquet"),
        ("out/j.parquet",),
    ),
    Case(("columns", "run.csv", "--robot", "raven2", "-o", "out/m.toml"), ("out/m.toml",)),
    Case(("bag", "z.parquet", "-o", "out/z.bag"), ("out/z.bag",)),
    Case(("bag", "z.parquet", "-o", "out/z.mcap"), ("out/z.mcap",)),
    Case(("extract", "z.mcap", "--robot", "raven2", "-o", "out/e.parquet"), ("out/e.parquet",)),
    Case(("compare", "m.st", "o.st", "z.parquet", "--report", "out/p.html"), ("out/p.html",)),
    Case(("study", "forceps-unloaded", *STUDY, "-o", "out"), ("out/forceps-unloaded/parts",)),
)


@dataclass
class Run:
    """A command in a process of its own."""

    pid: int
    opened: int  # a pipe that gets a byte when the first file is opened for writing
    printed: int  # a pipe that gets what the command prints
    said: str = ""

    def wait_for_writing(self) -> None:
        """Wait until it writes, or has ended."""
        select.select([self.opened], [], [])

    def end(self) -> int:
        """Exit code, negative for a signal."""
        with os.fdopen(self.printed, errors="replace") as printed:
            self.said = printed.read()
        _, status = os.waitpid(self.pid, 0)
        os.close(self.opened)
        return os.waitstatus_to_exitcode(status)


def fork(call: Callable[[], int | None]) -> Run:
    """Run `call` in a process; its value is the exit code."""
    (opened, told), (printed, prints) = os.pipe(), os.pipe()
    pid = os.fork()
    if pid:
        os.close(told)
        os.close(prints)
        return Run(pid, opened, printed)
    for number, name in ((1, "stdout"), (2, "stderr")):
        os.dup2(prints, number)
        setattr(sys, name, os.fdopen(number, "w", closefd=False))

    def tell(event: str, arguments: tuple[object, ...]) -> None:
        if event == "open" and str(arguments[0]).endswith(".part"):
            os.write(told, b"w")

    sys.addaudithook(tell)
    code = CRASHED
    try:
        try:
            code = call() or 0
        except SystemExit as stop:
            code = int(stop.code or 0)
        except Exception:  # noqa: BLE001  # what reaches this is a fault
            traceback.print_exc()
        sys.stderr.flush()
    finally:  # a late Ctrl-C must not carry on with what the parent does
        os._exit(code)


def command(words: tuple[str, ...], limit: int | None = None) -> Callable[[], None]:
    """Make a call of the command line that may write `limit` bytes into a file."""

    def call() -> None:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        if limit is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
        sys.argv = ["truejoint", *words]
        main()

    return call


def is_whole(path: Path, healthy: bytes) -> bool:
    """Whether a file is one that the command writes when nothing disturbs it."""
    data = path.read_bytes()
    if data == healthy:
        return True
    read = {".parquet": truejoint.read_recording, ".st": truejoint.read_calibration}
    if path.suffix in read:
        read[path.suffix](path)
        return True
    # A page tells when it was made.
    return len(data) > 0.9 * len(healthy) and data[-20:] == healthy[-20:]


def fault_of(path: Path, healthy: bytes) -> str:
    """Say what is wrong with a file that a command was to write over; empty where nothing is."""
    if not path.exists():
        return "lost"
    if path.read_bytes() == GOOD:
        return ""
    try:
        return "" if is_whole(path, healthy) else "a fragment"
    except TruejointError as error:
        return str(error)


def broken(healthy: dict[str, bytes], remnants_allowed: bool) -> list[str]:
    """Say what is wrong with the files that a command left."""
    faults = {name: fault_of(Path(name), content) for name, content in healthy.items()}
    found = [f"{name}: {fault}" for name, fault in faults.items() if fault]
    for path in Path("out").rglob("*"):
        if ".partial" in path.name:
            truejoint.read_recording(path)
        elif path.suffix == ".part" and path.name.startswith(".") and not remnants_allowed:
            found.append(f"{path}: left behind")
    return found


def prepared(case: Case) -> None:
    """Empty the folder and put good files where the command writes."""
    for path in sorted(Path("out").rglob("*"), reverse=True):
        path.rmdir() if path.is_dir() else path.unlink()
    for name in case.targets:
        if Path(name).suffix:
            Path(name).write_bytes(GOOD)


def judged(case: Case, healthy: dict[str, bytes], remnants_allowed: bool) -> int:
    """Tell how many of its files are broken, and what they are; in a process of its own."""

    def call() -> int:
        found = broken(healthy, remnants_allowed)
        for line in found:
            print(f"{case.name}: {line}")
        sys.stdout.flush()
        return len(found)

    run = fork(call)
    count = run.end()
    print(run.said, end="", file=sys.stderr)
    return count


def warm(case: Case) -> None:
    """Run a command in this process, so that those forked from it need not load its kernels."""
    prepared(case)
    sys.argv = ["truejoint", *case.words, "--force"]
    with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()), suppress(SystemExit):
        main()


def trials(case: Case, counts: dict[str, int], rng: random.Random, tally: Counter[str]) -> None:
    """Disturb one command as often as `counts` says, and count what came of it."""
    warm(case)
    prepared(case)
    words = (*case.words, "--force")
    began = time.monotonic()
    run = fork(command(words))
    run.wait_for_writing()
    writing = time.monotonic()
    code = run.end()
    whole, write = time.monotonic() - began, time.monotonic() - writing
    if code not in (0, 1):
        raise SystemExit(f"{case.name}: exit code {code}\n{run.said}")
    healthy = {n: Path(n).read_bytes() for n in case.targets if Path(n).is_file()}
    sizes = [p.stat().st_size for p in Path("out").rglob("*") if p.is_file()]
    for kind, count in counts.items():
        for _ in range(count):
            prepared(case)
            limit = rng.randrange(max(sizes)) if kind == "disk full" else None
            run = fork(command(words, limit))
            if kind == "kill -9":
                run.wait_for_writing()
                time.sleep(rng.uniform(0, write))
                os.kill(run.pid, signal.SIGKILL)
            elif kind == "Ctrl-C":
                time.sleep(rng.uniform(0, whole))
                os.kill(run.pid, signal.SIGINT)
            code = run.end()
            tally[f"{kind}: runs"] += 1
            tally[f"{kind}: ended before it was done"] += code not in (0, 1)
            tally[f"{kind}: files lost or broken"] += judged(case, healthy, kind == "kill -9")
            known = {"kill -9": (-9, 0, 1), "Ctrl-C": (INTERRUPTED, 0, 1), "disk full": (2, 0, 1)}
            if code not in known[kind] or "Traceback" in run.said:
                tally[f"{kind}: another exit code, or a traceback"] += 1
                print(f"{case.name}: {kind}: exit code {code}: {run.said[-600:]}", file=sys.stderr)


def races(case: Case, count: int, tally: Counter[str]) -> None:
    """Start pairs of a command at once, without ``--force``."""
    for _ in range(count):
        prepared(case)
        for name in case.targets:
            Path(name).unlink(missing_ok=True)
        codes = sorted(run.end() for run in [fork(command(case.words)) for _ in range(2)])
        tally["two at once: runs"] += 1
        tally["two at once: both believe to have written"] += codes[1] in (0, 1)


def model_values(path: Path) -> str:
    """All that a model file holds, as text."""
    description, arrays = encode(read_calibration(path))
    return repr(description) + repr({name: one.tobytes() for name, one in arrays.items()})


def flips(count: int, rng: random.Random, tally: Counter[str]) -> None:
    """Flip single bits, and count what is read with other values."""
    readers: dict[str, Callable[[Path], object]] = {
        "short.parquet": lambda path: truejoint.read_recording(path).table.to_numpy().tobytes(),
        "m.st": model_values,
        "z.csv": lambda path: truejoint.motion.read_trajectory(path).positions.tobytes(),
    }
    whole = truejoint.read_recording("z.parquet")
    truejoint.write_parquet(whole.rows(slice(200)), "short.parquet")
    for name, read in readers.items():
        data, right = Path(name).read_bytes(), read(Path(name))
        flipped = Path(f"flipped{Path(name).suffix}")
        for _ in range(count // len(readers) + 1):
            changed = np.frombuffer(data, np.uint8).copy()
            changed[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
            flipped.write_bytes(changed.tobytes())
            tally[f"bits of {name}: flipped"] += 1
            try:
                tally[f"bits of {name}: read with other values"] += read(flipped) != right
            except TruejointError:
                tally[f"bits of {name}: refused"] += 1


def shorten() -> None:
    """Keep as many rows of the recording as it takes, and its truth in a file of its own."""
    short = truejoint.read_recording("z.parquet").rows(slice(600))
    truejoint.write_parquet(short, "z.parquet", overwrite=True)
    truth = [name for name in short.table.columns if name.startswith("truth/")]
    short.table[["t", *truth]].dropna().to_csv("truth.csv", index=False)
    alone = short.table.drop(columns=truth)
    robot = truejoint.Recording.from_columns(alone, short.provenance, short.units)
    truejoint.write_parquet(robot, "robot.parquet")


def measure(options: argparse.Namespace, tally: Counter[str]) -> None:
    """Run all trials in the current folder, and count what came of them."""
    rng = random.Random(options.seed)  # noqa: S311  # no secret
    Path("out").mkdir()
    Path("run.csv").write_text("stamp_ms,elbow_pos_deg\n0,5\n1,6\n")
    for words in (
        ("trajectory", "zigzag", "--direction", "J1", "--sparsity", "1", "-o", "z.csv"),
        ("collect", "z.csv", "-o", "."),
        ("calibrate", "z.parquet", "-e", "linear", "-o", "m.st"),
        ("calibrate", "z.parquet", "-e", "offset", "-o", "o.st"),
        ("bag", "z.parquet", "-o", "z.mcap"),
    ):
        run = fork(command(words))
        if run.end():
            raise SystemExit(run.said)
        if words[0] == "collect":
            fork(shorten).end()
    wanted = {"kill -9": options.kills, "Ctrl-C": options.interrupts, "disk full": options.full}
    for place, case in enumerate(CASES):
        share = {kind: len(range(place, n, len(CASES))) for kind, n in wanted.items()}
        trials(case, share, rng, tally)
        print(f"{case.name}: done", file=sys.stderr)
    for case in (CASES[0], CASES[2], CASES[3], CASES[5]):
        races(case, options.pairs, tally)
    flips(options.flips, rng, tally)


def parsed() -> argparse.Namespace:
    """Read the options of the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    for name, default in (("kills", 200), ("interrupts", 50), ("full", 50), ("pairs", 5)):
        parser.add_argument(f"--{name}", type=int, default=default)
    parser.add_argument("--flips", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    return parser.parse_args()


def run() -> None:
    """Print how often which fault left what."""
    options = parsed()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # until a run takes it
    tally: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            measure(options, tally)
        finally:  # what was counted until something failed
            os.chdir("/")
            print("| what | how often |\n|---|---|")
            for what, count in tally.items():
                print(f"| {what} | {count} |")


if __name__ == "__main__":
    run()
