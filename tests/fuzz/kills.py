"""Kill commands that write at random moments: no file may be lost or half-written.

    python -m tests.fuzz.kills [--count 500] [--seed N]

Each command runs in a process of its own, in a copy of a folder that holds its results already, and
is ended by SIGKILL, SIGINT or SIGTERM, or finds the disk full, or meets a second writer of the same
file. Afterwards every file of before must be there under its name, and every file under a good name
must be whole. Prints the seed and what went wrong; exit code 1 when there was any.
"""

import argparse
import contextlib
import os
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

import truejoint
from truejoint.motion import read_trajectory

from .cases import make_seeds, run

COMMANDS = {
    "calibrate": "calibrate training.parquet -e linear --joint elbow -o new.safetensors",
    "calibrate like": "calibrate training.parquet --like linear.safetensors -o like.safetensors",
    "rezero": "rezero linear.safetensors test.parquet -o zeroed.safetensors",
    "correct to csv": "correct linear.safetensors test.parquet -o corrected.csv",
    "correct": "correct linear.safetensors test.parquet -o corrected.parquet",
    "evaluate": "evaluate linear.safetensors test.parquet --report report.html --accept range",
    "extract": "extract state.bag --robot raven2 -o state.parquet",
    "trajectory": "trajectory zigzag --direction J2-J3 --sparsity 1/2 -o way.csv",
    "export": "export linear.safetensors --to c --out controller",
    "columns": "columns table.csv --robot raven2 -o sketch.toml",
    "collect": "collect way.csv --out session",
}
"""Commands that write, without --force."""
MOMENTS = ("SIGKILL", "SIGINT", "SIGTERM", "full disk", "two writers")
PACKAGE = Path(truejoint.__file__).parent
LIMIT = 120.0  # [s] for a command to end


def child(words: list[str], folder: Path, most_bytes: int = 0) -> int:
    """Run a command in a process of its own, whose files may hold so many bytes; its number."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    number = os.fork()
    if number:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        return number
    code = 99
    try:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        os.chdir(folder)
        if most_bytes:
            resource.setrlimit(resource.RLIMIT_FSIZE, (most_bytes,) * 2)
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        code, said = run(*words)
        if code not in {0, 1, 2, 130} or "Traceback" in said:
            sys.stderr.write(f"{words} {code} {said[-500:]}\n")
            code = 99
    except KeyboardInterrupt as error:  # 130 before the command has begun, or once it has ended
        places = [frame.filename for frame in traceback.extract_tb(error.__traceback__)]
        if any(str(PACKAGE) in place for place in places):
            traceback.print_exc()
        else:
            code = 130
    finally:
        os._exit(code)


def ended(number: int) -> int:
    """Wait for a process to end; its exit code, minus the signal that ended it."""
    _, status = os.waitpid(number, 0)
    return os.waitstatus_to_exitcode(status)


def is_whole(path: Path, good: Path) -> bool:
    """Whether a file is what its name says, or just as an undisturbed run wrote it."""
    if good.exists() and path.read_bytes() == good.read_bytes():
        return True
    readers: dict[str, Callable[[Path], object]] = {
        ".safetensors": truejoint.read_calibration,
        ".csv": read_trajectory,
        ".parquet": truejoint.read_recording,
        ".html": lambda page: page.read_text().rstrip().endswith("</html>") or 1 / 0,
    }
    try:
        readers[path.suffix](path)
    except (KeyError, ValueError, ZeroDivisionError):
        return False
    return True


class Kills:
    """A folder in which every command has run once, and how long each took.

    Good files of every kind may lie in its `base` before.
    """

    def __init__(self, folder: Path, names: Sequence[str] = tuple(COMMANDS)) -> None:
        self.base, self.trial = folder / "base", folder / "trial"
        if not self.base.exists():
            self.base.mkdir()
            make_seeds(self.base)
        self.seconds = {}
        for name, line in ((name, COMMANDS[name]) for name in names):
            with contextlib.chdir(self.base):  # what it imports and compiles, all others then have
                code, said = run(*line.split())
            began = time.monotonic()
            again = ended(child([*line.split(), "--force"], self.base))
            self.seconds[name] = time.monotonic() - began
            if not {code, again} <= {0, 1}:
                raise RuntimeError(f"{line}: ends with {code}, {again}, undisturbed: {said}")

    def one(self, rng: np.random.Generator) -> tuple[str, str]:
        """Disturb one command; what was done, and what went wrong, empty if nothing."""
        name = list(self.seconds)[int(rng.integers(len(self.seconds)))]
        moment = MOMENTS[int(rng.integers(len(MOMENTS)))]
        shutil.rmtree(self.trial, ignore_errors=True)
        shutil.copytree(self.base, self.trial)
        words = [*COMMANDS[name].split(), "--force"]
        wrong = []
        if moment == "full disk":
            code = ended(child(words, self.trial, int(10 ** rng.uniform(0.5, 4.5))))
            if code not in {0, 1, 2}:
                wrong.append(f"exit code {code}")
        elif moment == "two writers":
            pair = [child(words, self.trial) for _ in range(2)]
            wrong += [f"exit code {code}" for code in map(ended, pair) if code not in {0, 1, 2}]
        else:
            number = child(words, self.trial)
            time.sleep(rng.uniform(0.0, self.seconds[name]))
            os.kill(number, getattr(signal, moment))
            if (code := ended(number)) not in {0, 1, 130, -9, -15}:
                wrong.append(f"exit code {code}")
        return f"{name}, {moment}", "; ".join([*wrong, *self.damage(moment)])

    def damage(self, moment: str) -> list[str]:
        """Files of before that are gone, and files under a good name that are not whole."""
        wrong = []
        for good in (path for path in self.base.rglob("*") if path.is_file()):
            path = self.trial / good.relative_to(self.base)
            if not path.exists():
                wrong.append(f"{path.name} is gone")
            elif not is_whole(path, good):
                wrong.append(f"{path.name} is not whole")
        for path in self.trial.rglob("*"):
            is_new = not (self.base / path.relative_to(self.trial)).exists()
            # A recording that was stopped is kept under a name that says so.
            is_rest = path.suffix == ".part" or ".unfinished" in path.suffixes
            if is_new and path.is_file() and (not is_rest or moment == "two writers"):
                wrong.append(f"{path.name} is left")
            if is_rest and path.suffix == ".part" and moment in {"SIGINT", "full disk"}:
                wrong.append(f"{path.name} is left")
        return wrong


def main() -> int:
    """Disturb commands so many times; 1 when anything went wrong."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    rng, done, failures = np.random.default_rng(options.seed), Counter(), 0
    with tempfile.TemporaryDirectory() as name:
        kills = Kills(Path(name))
        for count in range(options.count):
            what, wrong = kills.one(rng)
            done[what.rpartition(", ")[2]] += 1
            if wrong:
                failures += 1
                sys.stdout.write(f"--seed {options.seed}, number {count}: {what}: {wrong}\n")
    kinds = ", ".join(f"{count} {kind}" for kind, count in sorted(done.items()))
    sys.stdout.write(
        f"{options.count} disturbed ({kinds}), seed {options.seed}: {failures} went wrong\n"
    )
    return int(failures > 0)


if __name__ == "__main__":
    sys.exit(main())
