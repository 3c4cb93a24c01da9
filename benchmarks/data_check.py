"""What the data check finds: faults put into recordings, and findings where nothing is wrong.

    python -m benchmarks.data_check [--sets NAME ...] [--faults NAME ...] [--seeds FROM:TO]
                                    [--healthy FROM:TO] [--keep FILE]

Each fault goes into a random joint and recording of each public data set under ``TRUEJOINT_DATA``
and of a session of the digital twin, once for each seed, and counts as found when a finding of its
name names that joint. Without options it takes one seed, a minute; docs/data_check.md quotes
``--seeds 0:20 --healthy 100:150``. ``--keep`` appends each result to a file of JSON lines, and what
stands there is not made again.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from truejoint.array_types import Array
from truejoint.crtk import simulated_arm
from truejoint.motion import random_motion, zigzag
from truejoint.recordings import DataCheck, Recording, check_data
from truejoint.recordings.datasets import read_dataset
from truejoint.recordings.join.explained import SLOW, explain, robust_spread
from truejoint.recordings.judge.positions import left_out_zeros
from truejoint.studies.raven2.sessions import record

PUBLIC = {
    "grasper": ("davinci_grasper_umn", "Tool_4_Maryland_L_4/*"),
    "dvrk": ("dvrk_psm_berkeley", "*"),
    "bros": ("bros_dual_encoder", "*"),
    "kuka": ("kuka_kr300_dual_encoder", "*"),
    "kflex": ("kflex_tendon_sheath", "[0-9]*"),
}
SETS = (*PUBLIC, "twin")
GRASPER_FILES = 10
# Names that say what was recorded rather than that something is wrong with it.
TOLD = {"load", "homing", "travel", "hole", "standstill", "directions", "dropped", "gap", "clock"}


@lru_cache(maxsize=1)
def twin_session(seed: int) -> tuple[Recording, ...]:
    """One zig-zag and two times three minutes of random motion after one homing."""
    arm = simulated_arm("raven2", "left", seed=seed)
    arm.enable()
    arm.home()
    paths = [zigzag(arm.robot, "J2-J3", 0.25)]
    paths += [random_motion(arm.robot, 180.0, seed=2 * seed + k) for k in (1, 2)]
    return tuple(record(arm, path) for path in paths)


@lru_cache(maxsize=8)
def public(name: str) -> tuple[Recording, ...]:
    """All recordings of a public data set."""
    return tuple(read_dataset(*PUBLIC[name]))


def recordings_of(name: str, seed: int) -> list[Recording]:
    """Read the recordings of a set; of the grasper's some that the seed chooses."""
    if name == "twin":
        return list(twin_session(seed))
    every = public(name)
    if name != "grasper":
        return list(every)
    chosen = np.random.default_rng(seed).choice(len(every), GRASPER_FILES, replace=False)
    return [every[k] for k in chosen]


@dataclass
class Case:
    """Recordings, and where a fault goes."""

    recordings: list[Recording]
    joint: str
    which: int
    random: np.random.Generator

    @property
    def one(self) -> Recording:
        """The recording that the fault goes into."""
        return self.recordings[self.which]

    @property
    def slow(self) -> bool:
        """Whether rows are steps of a motion."""
        return bool(np.median(np.diff(self.one.t)) > SLOW)

    def changed(
        self, column: str, change: Callable[[Array], Array], everywhere: bool = False
    ) -> Case:
        """Case with a column changed in the chosen recording, or in all."""
        new = [
            replace(r, table=r.table.assign(**{column: change(r.column(column).copy())}))
            if everywhere or k == self.which
            else r
            for k, r in enumerate(self.recordings)
        ]
        return replace(self, recordings=new)


def _outliers(case: Case, rows: Callable[[int], Array]) -> Case:
    spread = left_out_zeros(case.recordings, explain(case.recordings, case.joint))[2]
    size = spread * (12.0 if case.slow else 10.0)

    def change(truth: Array) -> Array:
        chosen = rows(len(truth))
        blocks = np.cumsum(np.diff(chosen, prepend=chosen[:1] - 2) > 1)
        truth[chosen] += size * case.random.choice([-1.0, 1.0], blocks.max() + 1)[blocks]
        return truth

    return case.changed(f"truth/{case.joint}", change)


def one_outlier(case: Case) -> Case:
    """One row off by ten spreads, twelve where rows are steps."""
    return _outliers(case, lambda n: case.random.integers(1, n - 1, 1))


def two_percent(case: Case) -> Case:
    """As many in a fiftieth of the rows."""
    return _outliers(
        case, lambda n: np.sort(case.random.choice(np.arange(1, n - 1), max(1, n // 50), False))
    )


def bursts(case: Case) -> Case:
    """As many in bursts of 5 to 20 rows."""

    def rows(n: int) -> Array:
        chosen: set[int] = set()
        while len(chosen) < n // 50:
            first = int(case.random.integers(1, n - 22))
            chosen |= set(range(first, first + int(case.random.integers(5, 21))))
        return np.array(sorted(chosen))

    return _outliers(case, rows)


def sign_everywhere(case: Case) -> Case:
    """All truth of the other sign."""
    return case.changed(f"truth/{case.joint}", lambda x: -x, everywhere=True)


def sign_of_one(case: Case) -> Case:
    """Truth of one recording of the other sign."""
    return case.changed(f"truth/{case.joint}", lambda x: -x)


def sign_about_mean(case: Case) -> Case:
    """All truth mirrored at its mean."""
    return case.changed(f"truth/{case.joint}", lambda x: 2 * np.nanmean(x) - x, everywhere=True)


def _scaled(case: Case, quantities: Sequence[str], everywhere: bool) -> Case:
    scale = 1e3 if case.one.robot.joint(case.joint).unit == "m" else 180.0 / np.pi
    for quantity in quantities:
        case = case.changed(f"{quantity}/{case.joint}", lambda x: scale * x, everywhere)
    return case


def unit_of_truth(case: Case) -> Case:
    """All truth in degrees or millimetres."""
    return _scaled(case, ["truth"], everywhere=True)


def unit_of_one(case: Case) -> Case:
    """Truth of one recording in degrees or millimetres."""
    return _scaled(case, ["truth"], everywhere=False)


def unit_of_measured(case: Case) -> Case:
    """All measured positions in degrees or millimetres."""
    return _scaled(case, ["measured"], everywhere=True)


def unit_of_both(case: Case) -> Case:
    """Truth and measured positions in degrees or millimetres."""
    return _scaled(case, ["truth", "measured"], everywhere=True)


def _late(case: Case, everywhere: bool) -> Case | None:
    """Truth 30 ms late; where rows are steps of a motion there is only a value, not a judgement."""
    if case.slow:
        return None
    for joint in case.one.joints_of("truth"):
        new = []
        for k, recording in enumerate(case.recordings):
            truth = recording.column(f"truth/{joint}")
            known = np.isfinite(truth)
            late = np.interp(recording.t - 0.03, recording.t[known], truth[known])
            table = recording.table.assign(**{f"truth/{joint}": late})
            spoilt = everywhere or k == case.which
            new.append(replace(recording, table=table) if spoilt else recording)
        case = replace(case, recordings=new)
    return case


def delay(case: Case) -> Case | None:
    """All truth joints 30 ms late in all recordings."""
    return _late(case, everywhere=True)


def delay_of_one(case: Case) -> Case | None:
    """Let one recording alone be late by as much."""
    return _late(case, everywhere=False)


def zero(case: Case) -> Case:
    """Truth of one recording moved by four spreads, and three scatters of the set's zeros."""
    explained = explain(case.recordings, case.joint)
    zeros, _, spread = left_out_zeros(case.recordings, explained)
    scatter = robust_spread(zeros) if len(case.recordings) > 2 else 0.0
    shift = max(4.0 * spread, 3.0 * scatter) * case.random.choice([-1.0, 1.0])
    return case.changed(f"truth/{case.joint}", lambda x: x + shift)


def _redundant(case: Case, first: Callable[[int], int]) -> Case | None:
    name = f"motor/{case.joint}"
    if name not in case.one.units or case.one.robot.joint(case.joint).unit != "rad":
        return None
    ratio = np.ptp(case.one.column(name)) / np.ptp(case.one.column(f"measured/{case.joint}"))
    shift = np.radians(1.0) * ratio * case.random.choice([-1.0, 1.0])
    return case.changed(name, lambda x: x + shift * (np.arange(len(x)) >= first(len(x))))


def redundant_file(case: Case) -> Case | None:
    """Motor encoder of one recording off by a degree of the joint."""
    return _redundant(case, lambda _n: 0)


def redundant_row(case: Case) -> Case | None:
    """Shift it from a row on."""
    row = case.random.uniform(0.2, 0.8)
    return _redundant(case, lambda n: int(row * n))


def frozen(case: Case) -> Case:
    """Let the truth stand for a fifth of the time."""

    def change(truth: Array) -> Array:
        first = int(case.random.uniform(0.1, 0.7) * len(truth))
        truth[first : first + len(truth) // 5] = truth[first]
        return truth

    return case.changed(f"truth/{case.joint}", change)


def saturated(case: Case) -> Case:
    """End the truth at four fifths of its range."""

    def change(truth: Array) -> Array:
        low, high = np.nanmin(truth), np.nanmax(truth)
        return np.minimum(truth, low + 0.8 * (high - low))

    return case.changed(f"truth/{case.joint}", change)


FAULTS = {
    "one_outlier": (one_outlier, "outliers"),
    "two_percent": (two_percent, "outliers"),
    "bursts": (bursts, "outliers"),
    "sign_everywhere": (sign_everywhere, "sign"),
    "sign_of_one": (sign_of_one, "sign"),
    "sign_about_mean": (sign_about_mean, "sign"),
    "unit_of_truth": (unit_of_truth, "unit"),
    "unit_of_one": (unit_of_one, "unit"),
    "unit_of_measured": (unit_of_measured, "unit"),
    "unit_of_both": (unit_of_both, "unit"),
    "delay": (delay, "delay"),
    "delay_of_one": (delay_of_one, "delay"),
    "zero": (zero, "zero"),
    "redundant_file": (redundant_file, "redundant"),
    "redundant_row": (redundant_row, "redundant"),
    "frozen": (frozen, "frozen saturated"),
    "saturated": (saturated, "frozen saturated"),
}


def named(check: DataCheck) -> list[tuple[str, str]]:
    """Name and place of each finding that says that something is wrong."""
    return [(f.name, f.where) for f in check.findings if f.name not in TOLD and f.level != "info"]


@lru_cache(maxsize=1)
def healthy_names(name: str, seed: int) -> frozenset[str]:
    """Names of what is found where nothing was put in."""
    return frozenset(finding for finding, _ in named(check_data(recordings_of(name, seed))))


def inject(name: str, fault: str, seed: int) -> dict[str, object] | None:
    """Put a fault into a set; what the check says of it, None where it does not apply."""
    whole = recordings_of(name, seed)
    random = np.random.default_rng([seed, *fault.encode()])
    joints = whole[0].joints_of("truth")
    case = Case(whole, str(random.choice(joints)), int(random.integers(len(whole))), random)
    change, kinds = FAULTS[fault][0], set(FAULTS[fault][1].split())
    changed = change(case)
    if changed is None:
        return None
    check = check_data(changed.recordings)
    found = [f for f in check.findings if f.name in kinds and f"/{case.joint}" in f.where]
    if fault == "delay_of_one":
        found = [f for f in found if " in " in f.where]
    also = sorted({finding for finding, _ in named(check)} - kinds - healthy_names(name, seed))
    what = found[0].what if found else ""
    return {"joint": case.joint, "found": bool(found), "what": what, "also": also}


def results(options: argparse.Namespace) -> Iterator[dict[str, object]]:
    """Yield the results asked for, those kept first."""
    keep: Path | None = options.keep
    old = [] if keep is None or not keep.exists() else keep.read_text().splitlines()
    kept = {(r["set"], r["fault"], r["seed"]): r for r in map(json.loads, old)}

    def fresh(key: tuple[str, str, int], make: Callable[[], dict[str, object] | None]) -> Iterator:
        if key not in kept:
            made = make() or {"skipped": True}
            kept[key] = dict(zip(("set", "fault", "seed"), key, strict=True)) | made
            if keep is not None:
                with keep.open("a") as file:
                    file.write(json.dumps(kept[key]) + "\n")
        yield kept[key]

    for seed in range(*options.seeds):
        for name in options.sets:
            for fault in options.faults:
                yield from fresh((name, fault, seed), lambda: inject(name, fault, seed))  # noqa: B023
    for seed in range(*options.healthy):
        yield from fresh(
            ("twin", "healthy", seed),
            lambda: {"findings": named(check_data(twin_session(seed))), "recordings": 3},  # noqa: B023
        )
    for name in (name for name in options.sets if name in PUBLIC):
        yield from fresh(
            (name, "healthy", 0),
            lambda: {
                "findings": named(check_data(public(name))),  # noqa: B023
                "recordings": len(public(name)),  # noqa: B023
            },
        )


def _span(text: str) -> tuple[int, int]:
    first, _, last = text.partition(":")
    return int(first), int(last)


def main() -> None:
    """Print what was found of what was put in, and what was found where nothing was."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sets", nargs="*", default=list(SETS), choices=SETS)
    parser.add_argument("--faults", nargs="*", default=list(FAULTS), choices=list(FAULTS))
    parser.add_argument("--seeds", type=_span, default=(0, 1), metavar="FROM:TO")
    parser.add_argument("--healthy", type=_span, default=(100, 102), metavar="FROM:TO")
    parser.add_argument("--keep", type=Path)
    options = parser.parse_args()
    found: dict[tuple[str, str], list[dict]] = {}
    for result in results(options):
        if "skipped" not in result:
            found.setdefault((result["fault"], result["set"]), []).append(result)
    print("| put in | " + " | ".join(options.sets) + " |")
    print("|---|" + "---|" * len(options.sets))
    for fault in options.faults:
        cells = []
        for name in options.sets:
            rows = found.get((fault, name), [])
            also = Counter(word for row in rows for word in row["also"])
            beside = "".join(f", {word} {number}" for word, number in also.items())
            hits = sum(row["found"] for row in rows)
            cells.append(f"{hits} of {len(rows)}{beside}" if rows else "-")
        print(f"| {fault.replace('_', ' ')} | " + " | ".join(cells) + " |")
    print("\nWhere nothing was put in:")
    for name in options.sets:
        rows = found.get(("healthy", name), [])
        count = Counter(finding for row in rows for finding, _ in row["findings"])
        total = sum(row["recordings"] for row in rows)
        print(f"- {name}, {total} recordings: {dict(count) or 'nothing'}")
        for row in rows:
            for finding, where in row["findings"]:
                print(f"  - {finding}: {where} (seed {row['seed']})")


if __name__ == "__main__":
    main()
