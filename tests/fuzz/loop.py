"""Feed hostile samples to the loop, in C and in Python, and compare all that comes out.

    python -m tests.fuzz.loop [--count 10000000] [--seed N]

Each of several estimators is exported, compiled and run on the same samples as the corrector: a
motion with numbers that are none, infinite, tiny or huge, jumps, repeated samples, and stamps that
repeat or go back. Status, position, half-width and correction must have the same bits. A sample
that is not finite must never be corrected, and what is corrected must be finite. Prints the counts;
exit code 1 when anything was wrong.
"""

import argparse
import os
import sys
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np
from tests.export.library import SAME_BITS, expected, exported
from tests.export.test_registered_c import with_interval
from tests.runtime.registered import model, unseen
from tests.runtime.streams import ready

from truejoint.runtime import Status

NAMES = (
    "linear", "poly2", "dnn", "gp", "rich_trees", "play_both", "coupled_play", "ukf_friction",
    "ukf_compensated", "ukf_elastic", "hybrid", "gru",
)  # fmt: skip
ROWS = 20_000  # of one stream
ODD = (
    np.nan, -np.nan, np.inf, -np.inf, 5e-324, -5e-324, 1e-308, 0.0, -0.0, 1.7976931348623157e308,
    -3.4e38, 1e20,
)  # fmt: skip


def hostile(name: str, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Stamps (n,) and samples (n, n_signals) that do harm in few of the rows or in half."""
    rng = np.random.default_rng(seed)
    np.seterr(over="ignore", invalid="ignore")  # that is what is wanted
    recording = unseen(name)
    rows = np.resize(np.arange(len(recording)), ROWS)
    samples = recording.table[list(model(name).loop_signals)].to_numpy()[rows].copy()
    t = np.arange(ROWS) * float(np.median(np.diff(recording.t))) + rng.choice([0.0, 1e9])
    period, span = t[1] - t[0], np.ptp(samples, axis=0)
    for row in np.flatnonzero(rng.random(ROWS) < rng.choice([0.0005, 0.01, 0.5])):
        kind, column = rng.integers(9), rng.integers(samples.shape[1])
        few = slice(row, row + rng.integers(1, 30))
        if kind == 0:
            samples[row, column] = rng.choice(ODD)
        elif kind == 1:
            samples[row] = np.frombuffer(rng.bytes(8 * samples.shape[1]))
        elif kind == 2:
            samples[few, column] = samples[row, column]
        elif kind == 3:
            samples[few] = samples[row]
        elif kind == 4:
            samples[row:, column] += rng.normal() * span[column]
        elif kind == 5:
            samples[row, column] *= 2.0 ** rng.integers(-64, 64)
        elif kind == 6:
            t[row] = rng.choice([*ODD, t[row - 1], (1.0 + 1e-15) * t[row - 1]])
        elif kind == 7:
            t[row:] += period * rng.choice([-90.0, -1.0, 0.5, 20.0])
        else:
            t[few] = t[row]
    return t, samples


def wrong(t: np.ndarray, samples: np.ndarray, came: tuple, wanted: tuple) -> str:
    """What is wrong with what came of samples; empty if nothing."""
    for name, one, other in zip(("status", "position", "half-width", "correction"), came, wanted,
                                strict=True):  # fmt: skip
        if not np.array_equal(one, other, equal_nan=True):
            return f"{name} differs between C and Python in row {np.argwhere(one != other)[0]}"
    status, position, half_width, _ = wanted
    good = status == Status.OK
    if not (np.isfinite(t) & np.isfinite(samples).all(axis=1))[good].all():
        return "a sample that is not finite was corrected"
    if not np.isfinite(position[good]).all() or not (half_width[good] >= 0.0).all():
        return "what was corrected is not finite"
    if np.isfinite(half_width[~good & (status != int(Status.OTHER_THREAD))]).any():
        return "a sample in doubt has a half-width"
    return ""


def main() -> int:
    """Run so many samples; 1 when anything was wrong."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=10_000_000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    done, found, fine = Counter[str](), [], 0
    with tempfile.TemporaryDirectory() as folder:
        os.environ.setdefault("TRUEJOINT_TEST_MODELS", folder)
        libraries = {}
        for name in NAMES:
            calibration = with_interval(model(name), 0.0)
            made = exported(Path(folder, name), calibration, flags=SAME_BITS)
            libraries[name] = calibration, made
        stream = options.seed
        while done.total() < options.count:
            for name, (calibration, made) in libraries.items():
                t, samples = hostile(name, stream)
                stream += 1
                made.functions.start()
                came = made.run(t, samples, len(calibration.joints))
                wanted = expected(ready(calibration), t, samples)
                done[name] += len(t)
                fine += np.count_nonzero(wanted[0] == 0)
                if why := wrong(t, samples, came, wanted):
                    found.append(f"{name}, stream {stream - 1}: {why}")
    sys.stdout.write(
        "\n".join([*found, f"{done.total()} samples of {len(done)} estimators, {fine} of them "
                   f"corrected, seed {options.seed}: {len(found)} streams went wrong\n"])
    )  # fmt: skip
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main())
