"""What is left of files when writing them is cut off, and of their values when bits flip.

    python -m benchmarks.disk_faults [--count 500] [--flips 10000] [--seed 0]

Commands that write are disturbed at random moments as `tests.fuzz.kills` does it: killed,
interrupted, ended, on a disk that is full, beside a second writer. Then single bits flip in a
recording, a model and a trajectory. Prints a Markdown table of how often which fault left what.
"""

from __future__ import annotations

import random
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
from tests.fuzz.kills import Kills

import truejoint
from benchmarks import parsed, table
from truejoint.calibration.model_file import encode, read_calibration
from truejoint.errors import TruejointError


def model_values(path: Path) -> str:
    """All that a model file holds, as text."""
    description, arrays = encode(read_calibration(path))
    return repr(description) + repr({name: array.tobytes() for name, array in arrays.items()})


def flips(folder: Path, count: int, rng: random.Random, tally: Counter[str]) -> None:
    """Flip single bits, and count what is read with other values."""
    readers: dict[str, Callable[[Path], object]] = {
        "test.parquet": lambda path: truejoint.read_recording(path).table.to_numpy().tobytes(),
        "linear.safetensors": model_values,
        "zigzag.csv": lambda path: truejoint.motion.read_trajectory(path).positions.tobytes(),
    }
    for name, read in readers.items():
        path = folder / name
        data, right = path.read_bytes(), read(path)
        flipped = path.with_stem("flipped")
        for _ in range(count // len(readers) + 1):
            changed = np.frombuffer(data, np.uint8).copy()
            changed[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
            flipped.write_bytes(changed.tobytes())
            tally[f"bits of {name}: flipped"] += 1
            try:
                tally[f"bits of {name}: read with other values"] += read(flipped) != right
            except TruejointError:
                tally[f"bits of {name}: refused"] += 1


def main() -> None:
    """Disturb, flip, and print how often which fault left what."""
    options = parsed(__doc__, count=500, flips=10_000, seed=0)
    tally: Counter[str] = Counter()
    rng = np.random.default_rng(options.seed)
    with tempfile.TemporaryDirectory() as name:
        kills = Kills(Path(name))
        for _ in range(options.count):
            what, wrong = kills.one(rng)
            moment = what.rpartition(", ")[2]
            tally[f"{moment}: runs"] += 1
            tally[f"{moment}: went wrong"] += bool(wrong)
            if wrong:
                print(f"{what}: {wrong}")
        flips(kills.base, options.flips, random.Random(options.seed), tally)  # noqa: S311  # no secret
    table(("what", "how often"), tally.items())


if __name__ == "__main__":
    main()
