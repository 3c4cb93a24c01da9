"""What an automatic choice picks on recordings of real joints, beside the best in hindsight.

    python -m benchmarks.automatic_choice [--harder] [--out bench/automatic_choice]

Each data set is split as it recommends (20 joints) and, with ``--harder``, in other ways too: other
frequencies and loads, one motion against another, recordings exchanged, a sheath left out. On the
training side `truejoint.calibrate` chooses; every candidate is fitted to that side as well, and the
network with its 200 epochs. All are judged on the other side. Prints Markdown tables. Each split is
kept in a file of its own under ``--out`` and is not run again while that is there.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.accuracy_recordings import sides
from truejoint import calibrate, evaluate
from truejoint.calibration import Automatic
from truejoint.errors import CalibrationError
from truejoint.estimators import NeuralNetwork, candidates
from truejoint.recordings.datasets import DATASETS, HeldOut

WITHIN = (1.10, 1.15, 1.20)
MARGIN = 0.1  # share of its range by which a feature is outside it
OUTSIDE = 0.1  # share of the rows, from which on a range was never seen


@dataclass(frozen=True)
class Split:
    """What is trained on and what is judged, of one data set."""

    dataset: str
    name: str
    files: str
    test: str = ""  # pattern of what is held out; without one, as the data set recommends

    @property
    def title(self) -> str:
        """Data set and split for a table."""
        return f"{self.dataset}, {self.name}"


def recommended() -> Iterator[Split]:
    """Give the splits that the data sets recommend."""
    for dataset in DATASETS.values():
        for split in dataset.splits:
            yield Split(dataset.name, split.name, split.files)


def harder() -> Iterator[Split]:
    """Give splits of our own."""
    tool = "Tool_4_Maryland_L_4/"
    for index in (0, 1, 2, 4):
        yield Split("davinci_grasper_umn", f"frequency {index}", tool + "*", f"{tool}{index}?")
    for loads in ("01", "45", "89"):
        yield Split("davinci_grasper_umn", f"loads {loads}", tool + "*", f"{tool}?[{loads}]")
    yield Split("dvrk_psm_berkeley", "on peg_transfer", "*", "peg_transfer")
    yield Split("dvrk_psm_berkeley", "on random", "*", "random")
    yield Split("bros_dual_encoder", "first file", "*", "part1")
    yield Split("kuka_kr300_dual_encoder", "first motion", "*", "FF_A")
    for angle in (0, 60, 120, 180, 240):
        yield Split("kflex_tendon_sheath", f"sheath at {angle} deg", "[0-9]*", f"{angle}")


def judged(split: Split) -> dict[str, Any]:
    """RMSE by joint and estimator on what was held out, and what was chosen."""
    dataset = DATASETS[split.dataset]
    held_out = HeldOut(split.name, split.files, split.test) if split.test else None
    training, testing = sides(dataset, held_out or dataset.split(split.name))
    settings = dataset.settings.get("dnn", {})
    tried = candidates()
    for one in tried:
        if isinstance(one, NeuralNetwork):
            one.set_params(**settings)
    how = {"features": list(dataset.features), "fit_rate": dataset.fit_rate}
    began = time.perf_counter()
    chosen = calibrate(training, Automatic(tried, default_features=True), **how)
    took = time.perf_counter() - began
    models = {"auto": chosen}
    if chosen.feature_set.names == dataset.features:
        models[chosen.estimator] = chosen
    for one in [*tried, NeuralNetwork(**settings)]:
        name = one.name + (" 200" if getattr(one, "epochs", 0) else "")
        with suppress(CalibrationError):  # too few rows for it
            models[name] = models.get(name) or calibrate(training, one, **how)
    rmse: dict[str, dict[str, float]] = {}
    for name, model in models.items():
        for score in evaluate(model, testing).scores:
            if score.estimator in (model.estimator, "raw"):
                key = name if score.estimator == model.estimator else "raw"
                rmse.setdefault(score.joint, {})[key] = score.rmse
    excess = np.concatenate([chosen.range_excess(one) for one in testing])
    return {
        "title": split.title,
        "rmse": rmse,
        "chosen": chosen.estimator,
        "features": len(chosen.feature_set),
        "outside": float((excess > MARGIN).mean()),
        "seconds": took,
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
        line = (
            f"| {found['title']} | {joint} | {found['chosen']}, {found['features']} | {best} "
            f"| {mark} | {to_linear:.2f} | {to_raw:.2f} | {100 * found['outside']:.0f} % "
            f"| {found['seconds']:.0f} |"
        )
        yield line, ratio, to_linear, to_raw, found["outside"]


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--harder", action="store_true", help="other splits too")
    parser.add_argument("--datasets", nargs="+", default=list(DATASETS), choices=list(DATASETS))
    parser.add_argument("--out", type=Path, default=Path("bench/automatic_choice"))
    options = parser.parse_args()
    print(
        "| data set, held out | joint | chosen, features | best in hindsight | to it | to linear "
        "| to raw | outside | time [s] |\n" + "|---" * 9 + "|"
    )
    splits = [*recommended(), *(harder() if options.harder else ())]
    ratios = []
    for split in splits:
        if split.dataset not in options.datasets:
            continue
        for line, *numbers in rows(kept(options.out, split.title, partial(judged, split))):
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
