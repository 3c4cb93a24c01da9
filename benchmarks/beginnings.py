"""Re-zeroing from beginnings of motions: what they say of a zero, and what is made of that.

    python -m benchmarks.beginnings [--only PATTERN ...] [--seconds 2] [--rests 0 2]

From 24 starts in what is held out, each as if nothing were known of what was before, the first
seconds re-zero the minute that follows. Prints for each joint, in deg or mm: the deviation that the
calibration states of such an offset, and that found about the mean of the rest; and the RMSE of the
rest, not re-zeroed, by the whole offset, and by what is believed of it. Splits are of recordings
that no row of docs/results.md's table of histories judges, or of parts of such. Before the arm
moves, it rests at each start for as long as ``--rests`` says: the first row again and again.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from fnmatch import fnmatch

import numpy as np
from numpy.typing import NDArray

from benchmarks.automatic_choice import Split
from benchmarks.histories import RATE, development
from truejoint import Calibration, Recording, calibrate
from truejoint.calibration import find_zero
from truejoint.recordings.datasets import DATASETS
from truejoint.units import display_unit

STARTS = 24
LONGEST = 60.0  # [s] that is judged from each start


def splits() -> Iterator[tuple[Split, str]]:
    """Give what is held out, and what is fitted."""
    dvrk, early, late = "dvrk_psm_berkeley", (0.0, 0.5), (0.55, 0.7)
    for motion in ("random", "peg_transfer"):
        yield Split(dvrk, f"{motion}, middle", motion, "", early, late), "coupled_play"
    bros = Split("bros_dual_encoder", "first file", "part1", "", (0.0, 0.6), (0.65, 1.0))
    yield bros, "coupled_play"
    yield (
        Split("kuka_kr300_dual_encoder", "first file", "FF_A", "", early, (0.55, 1.0)),
        "rich_play",
    )
    for split in development():
        yield split, "rich_trees"


def pieces(recordings: list[Recording]) -> Iterator[Recording]:
    """Give a minute, or half of a recording, from each start."""
    for one in recordings:
        length = min(LONGEST, 0.5 * one.duration)
        for start in np.linspace(one.t[0], one.t[-1] - length, -(-STARTS // len(recordings))):
            yield one.rows((one.t >= start) & (one.t < start + length))


def rested(piece: Recording, seconds: float) -> Recording:
    """Let a piece begin with its first row for so long."""
    step = piece.duration / (len(piece) - 1)
    held = np.arange(round(seconds / step)) * step
    table = piece.table.iloc[np.maximum(np.arange(-len(held), len(piece)), 0)]
    t = np.concatenate([piece.t[0] + held, piece.t + len(held) * step])
    return replace(piece, table=table.reset_index(drop=True).assign(t=t))


def judge(model: Calibration, piece: Recording, seconds: float) -> NDArray[np.float64]:
    """Variance of the offset, stated and found, and mean squares (5, n_joints) of what is left."""
    zero = find_zero(model, piece, seconds)
    error = piece.columns("truth", model.joints) - model.correct(piece)
    rest = error[piece.t - piece.t[0] >= seconds]
    rest = rest[np.isfinite(rest).all(axis=1)]
    squares = [np.mean((rest - off) ** 2, axis=0) for off in (0.0, zero.offset, zero.believed)]
    return np.array([zero.sd**2, (zero.offset - rest.mean(axis=0)) ** 2, *squares])


def judged(
    model: Calibration, testing: list[Recording], seconds: float, rests: list[float]
) -> Iterator[tuple[str, float, NDArray[np.float64]]]:
    """Give roots of what `judge` says, of each joint after each rest."""
    begun = [*pieces(testing)]
    found = [[judge(model, rested(piece, rest), seconds) for piece in begun] for rest in rests]
    roots = np.sqrt(np.mean(found, axis=1))
    for j, joint in enumerate(model.joints):
        for rest, values in zip(rests, roots[:, :, j], strict=True):
            yield joint, rest, values


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="+", default=["*"], help="patterns of titles")
    parser.add_argument("--seconds", type=float, default=2.0)
    parser.add_argument("--rests", nargs="+", type=float, default=[0.0, 2.0])
    options = parser.parse_args()
    columns = (
        "held out", "estimator", "joint", "rest [s]", "stated sd", "found", "not re-zeroed",
        "whole", "believed",
    )  # fmt: skip
    print(f"| {' | '.join(columns)} |\n" + "|---" * len(columns) + "|")
    for split, name in splits():
        if not any(fnmatch(split.title, pattern) for pattern in options.only):
            continue
        training, testing = split.sides(RATE)
        model = calibrate(training, name, fit_rate=DATASETS[split.dataset].fit_rate)
        for joint, rest, values in judged(model, testing, options.seconds, options.rests):
            unit = display_unit(model.units[f"measured/{joint}"])
            cells = " | ".join(f"{value:.3g}" for value in (rest, *(values * unit.scale)))
            print(f"| {split.title} | {name} | {joint} [{unit.name}] | {cells} |", flush=True)


if __name__ == "__main__":
    main()
