"""What an automatic choice picks on recordings of real joints, beside the best in hindsight.

    python -m benchmarks.automatic_choice [--harder | --development] [--plain]

Each data set is split as it recommends (20 joints) and, with ``--harder``, in other ways too: other
frequencies, loads and stops, other instruments, one motion against another, recordings exchanged, a
sheath left out. The rule of the choice was made on the splits of ``--development``, whose test rows
no other split of the same recordings judges. On the training side `truejoint.calibrate` chooses;
every candidate is fitted to that side as well, and so are the default network and boosted trees.
All are judged on the other side. Prints Markdown tables. Each split is kept in a file of its own
under ``--out`` and is not run again while that is there.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from fnmatch import fnmatch
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.ensemble import HistGradientBoostingRegressor

from truejoint import calibrate
from truejoint.calibration import Automatic, Calibration
from truejoint.calibration.zero import judged_error
from truejoint.errors import CalibrationError
from truejoint.estimators import NeuralNetwork, WrappedRegressor, candidates
from truejoint.recordings import Recording
from truejoint.recordings.datasets import DATASETS, read_dataset

WITHIN = (1.10, 1.15, 1.20)
MARGIN = 0.1  # share of its range by which a feature is outside it
OUTSIDE = 0.1  # share of the rows, from which on a range was never seen
REZERO = 2.0  # [s] of the start of a recording, from which it is re-zeroed
MOST_HZ = 250.0  # of a recording

Share = tuple[float, float]


@dataclass(frozen=True)
class Split:
    """What is trained on and what is judged, of one data set."""

    dataset: str
    name: str
    files: str
    test: str = ""  # pattern of what is held out; without one, a part of each recording
    train_part: Share = (0.0, 1.0)  # of the time of each recording
    test_part: Share = (0.0, 1.0)

    @property
    def title(self) -> str:
        """Data set and split for a table."""
        return f"{self.dataset}, {self.name}"

    def sides(self, most_hz: float = MOST_HZ) -> tuple[list[Recording], list[Recording]]:
        """Training and held-out recordings, thinned to `most_hz`."""
        found = read(self.dataset, self.files, most_hz)
        training, testing = found, found
        if self.test:
            out = [fnmatch(one.provenance.session, self.test) for one in found]
            training = [one for one, is_out in zip(found, out, strict=True) if not is_out]
            testing = [one for one, is_out in zip(found, out, strict=True) if is_out]
        return cut(training, self.train_part), cut(testing, self.test_part)


@cache
def read(dataset: str, files: str, most_hz: float) -> list[Recording]:
    """Read a data set, at most at `most_hz`: more rows would only take longer."""
    every = [
        (one, max(1, round(len(one) / one.duration / most_hz)))
        for one in read_dataset(dataset, files)
    ]
    return [one.rows(np.arange(0, len(one), step)) for one, step in every]


def cut(recordings: list[Recording], part: Share) -> list[Recording]:
    """Give that share of the time of each recording."""
    if part == (0.0, 1.0):
        return recordings
    shares = [(r.t - r.t[0]) / r.duration for r in recordings]
    pairs = zip(recordings, shares, strict=True)
    return [r.rows(np.flatnonzero((s >= part[0]) & (s <= part[1]))) for r, s in pairs]


def recommended() -> Iterator[Split]:
    """Give the splits that the data sets recommend."""
    for dataset in DATASETS.values():
        for split in dataset.splits:
            if split.test:
                yield Split(dataset.name, split.name, split.files, split.test)
            else:
                end = 1.0 - split.test_fraction
                yield Split(
                    dataset.name, split.name, split.files, "", (0.0, end), (end, 1.0)
                )  # fmt: skip


def harder() -> Iterator[Split]:
    """Give splits of our own."""
    grasper, tool = "davinci_grasper_umn", "Tool_4_Maryland_L_4/"
    for index in (0, 1, 2, 4):
        yield Split(grasper, f"frequency {index}", tool + "*", f"{tool}{index}?")
    for loads in ("01", "45", "89"):
        yield Split(grasper, f"loads {loads}", tool + "*", f"{tool}?[{loads}]")
    roll = "Tool_4_Maryland_L_Roll_3/*"
    for stop in (1, 3):
        yield Split(grasper, f"roll, stop {stop}", roll, f"*/{stop}??")
    yield Split(grasper, "roll, load 2", roll, "*/??2")
    for motion in ("peg_transfer", "random"):
        yield Split("dvrk_psm_berkeley", f"on {motion}", "*", motion)
        yield Split(
            "dvrk_psm_berkeley", f"{motion}, first part", motion, "", (0.3, 1.0), (0.0, 0.3)
        )
    yield Split("bros_dual_encoder", "first file", "*", "part1")
    yield Split("kuka_kr300_dual_encoder", "first motion", "*", "FF_A")
    for angle in (0, 60, 120, 180, 240):
        yield Split("kflex_tendon_sheath", f"sheath at {angle} deg", "[0-9]*", f"{angle}")
    halves = (0.0, 0.5), (0.5, 1.0)
    yield Split("kflex_tendon_sheath", "period of 0 deg alone", "0", "", *halves)


def development() -> Iterator[Split]:
    """Give the splits on which the rule of the choice was made."""
    tool = "Tool_4_Maryland_L_4/"
    for motion in ("random", "peg_transfer"):
        yield Split("dvrk_psm_berkeley", f"{motion}, middle", motion, "", (0.0, 0.5), (0.5, 0.7))
    yield Split("davinci_grasper_umn", "loads 26", f"{tool}[0124]?", f"{tool}?[26]")
    yield Split("bros_dual_encoder", "within the first", "part1", "", (0.0, 0.6), (0.65, 1.0))
    yield Split("kuka_kr300_dual_encoder", "within the first", "FF_A", "", (0.0, 0.6), (0.65, 1.0))
    yield Split("kflex_tendon_sheath", "first half", "[0-9]*", "", (0.0, 0.3), (0.3, 0.5))


def left(model: Calibration, testing: list[Recording], rezero: float) -> NDArray[np.float64]:
    """RMSE (n_joints,) of recordings, re-zeroed from the first seconds [s] of each."""
    errors = [judged_error(model, recording, rezero)[0] for recording in testing]
    return np.sqrt(np.mean(np.concatenate(errors) ** 2, axis=0))


def judged(split: Split, *, plain: bool) -> dict[str, Any]:
    """RMSE by joint and estimator on what was held out, and what was chosen."""
    dataset = DATASETS[split.dataset]
    training, testing = split.sides()
    settings = {} if plain else dataset.settings.get("dnn", {})
    features = None if plain else dataset.features
    tried = candidates()
    for one in tried:
        if isinstance(one, NeuralNetwork):
            one.set_params(**settings)
    fit = partial(calibrate, training, features=features, fit_rate=dataset.fit_rate)
    began = time.perf_counter(), time.process_time()
    chosen = fit(Automatic(tried))
    took = time.perf_counter() - began[0], time.process_time() - began[1]
    joints = chosen.joints
    raw = np.concatenate([recording.error(joints) for recording in testing])
    rmse = {"raw": np.sqrt(np.nanmean(raw**2, axis=0)), "auto": left(chosen, testing, 0.0)}
    boosted = HistGradientBoostingRegressor(early_stopping=False, random_state=0)
    for one in [*tried, NeuralNetwork(**settings), WrappedRegressor(boosted)]:
        name = one.name + (" 200" if getattr(one, "epochs", 0) else "")
        with suppress(CalibrationError):  # too few rows for it
            rmse[name] = left(fit(one), testing, 0.0)
    excess = np.concatenate([chosen.range_excess(one) for one in testing])
    rezeroed = left(chosen, testing, REZERO)
    return {
        "title": split.title,
        "rmse": {
            joint: {name: float(values[k]) for name, values in rmse.items()}
            for k, joint in enumerate(joints)
        },
        "rezeroed": dict(zip(joints, rezeroed.tolist(), strict=True)),
        "outside": float((excess > MARGIN).mean()),
        "seconds": took[0],
        "cpu_seconds": took[1],
        "choice": chosen.metadata["choice"],
    }


def kept(out: Path, title: str, make: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """Give what `make` gives, from its file in a folder where there is one."""
    path = out / f"{title.replace(', ', '-').replace(' ', '_')}.json"
    if not path.exists():
        out.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(make()))
    found: dict[str, Any] = json.loads(path.read_text())
    return found


def rows(found: dict[str, Any]) -> Iterator[tuple[str, float, float, float, float]]:
    """Table row, error over the best in hindsight, over linear and over raw, share outside."""
    for joint, rmse in found["rmse"].items():
        single = {name: value for name, value in rmse.items() if name not in ("auto", "raw")}
        best = min(single, key=lambda name: single[name])
        ratio = rmse["auto"] / min(rmse["auto"], single[best])
        to_linear, to_raw = rmse["auto"] / rmse["linear"], rmse["auto"] / rmse["raw"]
        mark = f"{ratio:.2f}" if ratio <= WITHIN[1] else f"**{ratio:.2f}**"
        shares = [
            (one["estimator"], one["weights"].get(joint, 0.0)) for one in found["choice"]["tried"]
        ]
        members = " + ".join(
            name if weight == 1.0 else f"{weight:.2f} {name}" for name, weight in shares if weight
        )
        line = (
            f"| {found['title']} | {joint} | {members} | {best} | {mark} | {to_linear:.2f} "
            f"| {to_raw:.2f} | {100 * found['outside']:.0f} % | {found['cpu_seconds']:.0f} |"
        )
        yield line, ratio, to_linear, to_raw, found["outside"]


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--harder", action="store_true", help="other splits instead")
    parser.add_argument("--development", action="store_true", help="those of the rule instead")
    parser.add_argument("--plain", action="store_true", help="default features and settings")
    parser.add_argument("--only", nargs="+", default=["*"], help="patterns of titles, in turn")
    parser.add_argument("--datasets", nargs="+", default=list(DATASETS), choices=list(DATASETS))
    parser.add_argument("--out", type=Path, default=Path("bench/automatic_choice"))
    options = parser.parse_args()
    print(
        "| data set, held out | joint | chosen | best in hindsight | to it | to linear "
        "| to raw | outside | CPU [s] |\n" + "|---" * 9 + "|"
    )
    out = options.out / "plain" if options.plain else options.out
    wanted = development if options.development else harder if options.harder else recommended
    ratios = []
    for split in (one for only in options.only for one in wanted() if fnmatch(one.title, only)):
        if split.dataset not in options.datasets:
            continue
        for line, *numbers in rows(
            kept(out, split.title, partial(judged, split, plain=options.plain))
        ):
            print(line, flush=True)
            ratios.append(numbers)
    to_best, to_linear, to_raw, outside = np.array(ratios).T
    shares = ", ".join(f"{100 * (to_best <= most).mean():.0f} %" for most in WITHIN)
    seen = outside <= OUTSIDE
    print(f"\n{len(ratios)} joints; within 10, 15, 20 % of the best: {shares}")
    for name, ratio, most in (("linear by > 5 %", to_linear, 1.05), ("raw", to_raw, 1.0)):
        print(
            f"worse than {name}: {int((ratio > most).sum())}, of which in ranges that were seen: "
            f"{int(((ratio > most) & seen).sum())}"
        )


if __name__ == "__main__":
    main()
