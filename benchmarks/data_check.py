"""What the data check finds: faults put into recordings, and findings where nothing is wrong.

    python -m benchmarks.data_check [--sets NAME ...] [--faults NAME ...] [--seeds FROM:TO]
                                    [--healthy FROM:TO] [--out FOLDER]

Each fault goes into a random joint and recording of each public data set under ``TRUEJOINT_DATA``
and of a session of the digital twin, once for each seed, and counts as found when a finding of its
name names that joint. Without options it takes one seed, a minute; docs/data_check.md quotes
``--seeds 0:20 --healthy 100:150``. Each result is kept in a file under ``--out``, and what stands
there is not made again.
"""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import head, parsed, row, stored
from benchmarks.arms import homed
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
    arm = homed(simulated_arm("raven2", "left", seed=seed))
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
    ) -> "Case":
        """Case with a column changed in the chosen recording, or in all."""
        new = [
            replace(r, table=r.table.assign(**{column: change(r.column(column).copy())}))
            if everywhere or k == self.which
            else r
            for k, r in enumerate(self.recordings)
        ]
        return replace(self, recordings=new)


def _outliers(case: Case, rows: Callable[[int], Any]) -> Case:
    spread = left_out_zeros(case.recordings, explain(case.recordings, case.joint))[2]
    size = spread * (12.0 if case.slow else 10.0)

    def change(truth: Array) -> Array:
        chosen = rows(len(truth))
        blocks = np.cumsum(np.diff(chosen, prepend=chosen[:1] - 2) > 1)
        truth[chosen] += size * case.random.choice([-1.0, 1.0], blocks.max() + 1)[blocks]
        return truth

    return case.changed(f"truth/{case.joint}", change)


def _bursts(case: Case, n: int) -> Array:
    """Rows in bursts of 5 to 20, a fiftieth of all."""
    chosen: set[int] = set()
    while len(chosen) < n // 50:
        first = int(case.random.integers(1, n - 22))
        chosen |= set(range(first, first + int(case.random.integers(5, 21))))
    return np.array(sorted(chosen))


def _scaled(case: Case, *quantities: str, everywhere: bool = True) -> Case:
    """Quantities in degrees or millimetres."""
    scale = 1e3 if case.one.robot.joint(case.joint).unit == "m" else 180.0 / np.pi
    for quantity in quantities:
        case = case.changed(f"{quantity}/{case.joint}", lambda x: scale * x, everywhere)
    return case


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


def _zero(case: Case) -> Case:
    """Truth of one recording moved by four spreads, and three scatters of the set's zeros."""
    explained = explain(case.recordings, case.joint)
    zeros, _, spread = left_out_zeros(case.recordings, explained)
    scatter = robust_spread(zeros) if len(case.recordings) > 2 else 0.0
    shift = max(4.0 * spread, 3.0 * scatter) * case.random.choice([-1.0, 1.0])
    return _truth(case, lambda x: x + shift)


def _redundant(case: Case, share: float) -> Case | None:
    """Motor encoder of one recording off by a degree of the joint, from a share of its rows on."""
    name = f"motor/{case.joint}"
    if name not in case.one.units or case.one.robot.joint(case.joint).unit != "rad":
        return None
    ratio = np.ptp(case.one.column(name)) / np.ptp(case.one.column(f"measured/{case.joint}"))
    shift = np.radians(1.0) * ratio * case.random.choice([-1.0, 1.0])
    return case.changed(name, lambda x: x + shift * (np.arange(len(x)) >= int(share * len(x))))


def _frozen(case: Case, truth: Array) -> Array:
    first = int(case.random.uniform(0.1, 0.7) * len(truth))
    truth[first : first + len(truth) // 5] = truth[first]
    return truth


def _truth(case: Case, change: Callable[[Array], Array], everywhere: bool = False) -> Case:
    return case.changed(f"truth/{case.joint}", change, everywhere)


FAULTS: dict[str, tuple[str, Callable[[Case], Case | None]]] = {
    # One row off by ten spreads, twelve where rows are steps; as many in a fiftieth of the rows.
    "one_outlier": ("outliers", lambda c: _outliers(c, lambda n: c.random.integers(1, n - 1, 1))),
    "two_percent": ("outliers", lambda c: _outliers(
        c, lambda n: np.sort(c.random.choice(np.arange(1, n - 1), max(1, n // 50), False))
    )),
    "bursts": ("outliers", lambda c: _outliers(c, lambda n: _bursts(c, n))),
    "sign_everywhere": ("sign", lambda c: _truth(c, lambda x: -x, everywhere=True)),
    "sign_of_one": ("sign", lambda c: _truth(c, lambda x: -x)),
    "sign_about_mean": ("sign", lambda c: _truth(c, lambda x: 2 * np.nanmean(x) - x, True)),
    "unit_of_truth": ("unit", lambda c: _scaled(c, "truth")),
    "unit_of_one": ("unit", lambda c: _scaled(c, "truth", everywhere=False)),
    "unit_of_measured": ("unit", lambda c: _scaled(c, "measured")),
    "unit_of_both": ("unit", lambda c: _scaled(c, "truth", "measured")),
    "delay": ("delay", lambda c: _late(c, everywhere=True)),
    "delay_of_one": ("delay", lambda c: _late(c, everywhere=False)),
    "zero": ("zero", _zero),
    "redundant_file": ("redundant", lambda c: _redundant(c, 0.0)),
    "redundant_row": ("redundant", lambda c: _redundant(c, c.random.uniform(0.2, 0.8))),
    # The truth stands for a fifth of the time, or ends at four fifths of its range.
    "frozen": ("frozen saturated", lambda c: _truth(c, lambda x: _frozen(c, x))),
    "saturated": ("frozen saturated", lambda c: _truth(
        c, lambda x: np.minimum(x, 0.2 * np.nanmin(x) + 0.8 * np.nanmax(x))
    )),
}  # fmt: skip
"""By name: findings that count as found, and what puts the fault in."""


def named(check: DataCheck) -> list[tuple[str, str]]:
    """Name and place of each finding that says that something is wrong."""
    return [(f.name, f.where) for f in check.findings if f.name not in TOLD and f.level != "info"]


@lru_cache(maxsize=1)
def healthy_names(name: str, seed: int) -> frozenset[str]:
    """Names of what is found where nothing was put in."""
    return frozenset(finding for finding, _ in named(check_data(recordings_of(name, seed))))


def inject(name: str, fault: str, seed: int) -> dict[str, object]:
    """Put a fault into a set; what the check says of it, nothing where it does not apply."""
    whole = recordings_of(name, seed)
    random = np.random.default_rng([seed, *fault.encode()])
    joints = whole[0].joints_of("truth")
    case = Case(whole, str(random.choice(joints)), int(random.integers(len(whole))), random)
    kinds, change = set(FAULTS[fault][0].split()), FAULTS[fault][1]
    changed = change(case)
    if changed is None:
        return {}
    check = check_data(changed.recordings)
    found = [f for f in check.findings if f.name in kinds and f"/{case.joint}" in f.where]
    if fault == "delay_of_one":
        found = [f for f in found if " in " in f.where]
    also = sorted({finding for finding, _ in named(check)} - kinds - healthy_names(name, seed))
    what = found[0].what if found else ""
    return {"joint": case.joint, "found": bool(found), "what": what, "also": also}


def healthy(name: str, seed: int) -> dict[str, object]:
    """Say what is found in a set where nothing was put in."""
    whole = public(name) if name in PUBLIC else twin_session(seed)
    return {"findings": named(check_data(whole)), "recordings": len(whole), "seed": seed}


def main() -> None:
    """Print what was found of what was put in, and what was found where nothing was."""
    options = parsed(
        __doc__, sets=SETS, faults=tuple(FAULTS), seeds="0:1", healthy="100:102",
        out=Path("bench/data_check"),
    )  # fmt: skip
    seeds, good = (range(*map(int, span.split(":"))) for span in (options.seeds, options.healthy))
    head("put in", *options.sets)
    for fault in options.faults:
        cells = []
        for name in options.sets:
            rows = [
                stored(options.out, f"{name}, {fault}, {seed}", partial(inject, name, fault, seed))
                for seed in seeds
            ]
            rows = [found for found in rows if found]
            also = Counter(word for found in rows for word in found["also"])
            beside = "".join(f", {word} {number}" for word, number in also.items())
            hits = sum(found["found"] for found in rows)
            cells.append(f"{hits} of {len(rows)}{beside}" if rows else "-")
        row(fault.replace("_", " "), *cells)
    print("\nWhere nothing was put in:")
    for name in options.sets:
        rows = [
            stored(options.out, f"{name}, healthy, {seed}", partial(healthy, name, seed))
            for seed in ([0] if name in PUBLIC else good)
        ]
        count = Counter(finding for one in rows for finding, _ in one["findings"])
        total = sum(one["recordings"] for one in rows)
        print(f"- {name}, {total} recordings: {dict(count) or 'nothing'}")
        for one in rows:
            for finding, where in one["findings"]:
                print(f"  - {finding}: {where} (seed {one['seed']})")


if __name__ == "__main__":
    main()
