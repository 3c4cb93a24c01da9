"""What the efforts alone show: false alarms of healthy work, and loads hung on the arm.

    python -m benchmarks.effort_monitor [--seeds 20] [--first-seed 12] [--hours 2] [--out FOLDER]

Each seed is an arm of its own, calibrated on its zig-zags (direction J2-J3) and then at work for
two hours of random motion; 200 g and 500 g are hung on it, once right after the calibration and
once after those hours. Counts how often an effort alarm (shift or friction) rises in the healthy
hours, and the time until one is up under the load. What a seed gave is kept in a file of its own
under `--out` and is not simulated again while that is there: one piece takes half a minute.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.automatic_choice import kept
from benchmarks.interval_coverage import homed_arm, record, training_session
from truejoint import calibrate
from truejoint.calibration import Calibration
from truejoint.crtk import Arm
from truejoint.motion import random_motion
from truejoint.recordings import Recording
from truejoint.runtime import Monitor, Reason

RATE = 10.0  # Hz
EFFORT = int(Reason.SHIFT | Reason.FRICTION)
LOADS = {"200 g": (0.2, 900.0), "500 g": (0.5, 300.0)}  # kg, s
WANTED = {"200 g": (15.0, 15), "500 g": (3.0, 20)}  # minutes, seeds of 20


def work(arm: Arm, duration: float, seed: int, load: float = 0.0) -> Recording:
    """Random motion, with so much hung on the arm from now on."""
    arm._backend.twin.load = load  # type: ignore[attr-defined]
    return record(arm, random_motion(arm.robot, duration, seed), "h", rate=RATE)


def sessions(seed: int, hours: float) -> tuple[Calibration, Recording, dict[str, Recording]]:
    """Calibration, healthy hours, and the motions under load that follow either, by name."""
    arm = homed_arm(seed)
    model = calibrate(training_session(arm, seed), "linear")
    healthy = work(arm, 3600.0 * hours, 7 + seed)
    loaded = {}
    for k, (name, (load, duration)) in enumerate(LOADS.items()):
        loaded[f"{name}, later"] = work(arm, duration, 500 + 100 * k + seed, load)
    for name, (load, duration) in LOADS.items():
        arm = homed_arm(seed)
        training_session(arm, seed)
        loaded[f"{name}, at once"] = work(arm, duration, 700 + seed, load)
    return model, healthy, loaded


def watched(model: Calibration, recordings: Sequence[Recording]) -> tuple[Any, Any]:
    """Whether an effort alarm was up, and the largest share of a limit, at each sample."""
    monitor = Monitor(model)
    up, share = [], []
    begin = 0.0
    for recording in recordings:
        rows = np.column_stack([recording.column(signal) for signal in model.signals])
        stamps = (begin + recording.t - recording.t[0]).tolist()
        begin = stamps[-1] + 60.0
        for t, row in zip(stamps, rows, strict=True):
            monitor.step(t, row)
            up.append(int(monitor.reasons) & EFFORT != 0)
            share.append(monitor.measures[:2].max())
    return np.array(up), np.array(share)


def judged(
    model: Calibration, healthy: Recording, loaded: dict[str, Recording]
) -> dict[str, float | None]:
    """Count false alarms; the largest share of a limit, and minutes to each load (None: never)."""
    up, share = watched(model, [healthy])
    found: dict[str, float | None] = {
        "false alarms": float(np.count_nonzero(np.diff(up.astype(int), prepend=0) > 0)),
        "highest": float(share.max()),
    }
    for name, recording in loaded.items():
        before = [healthy] if name.endswith("later") else []
        under = watched(model, [*before, recording])[0][-len(recording) :]
        since = recording.t - recording.t[0]
        found[name] = float(since[np.argmax(under)] / 60.0) if under.any() else None
    return found


def piece(seed: int, hours: float) -> dict[str, Any]:
    """All of one seed."""
    return judged(*sessions(seed, hours))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first-seed", type=int, default=12)
    parser.add_argument("--hours", type=float, default=2.0, help="of healthy work")
    parser.add_argument("--out", type=Path, default=Path("bench/effort_monitor"))
    options = parser.parse_args()
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    found = []
    for seed in seeds:
        title = f"{seed}, {options.hours:g} h"
        found.append(kept(options.out, title, partial(piece, seed, options.hours)))
        print(f"seed {seed}: {found[-1]}", flush=True)
    highest = [one["highest"] for one in found]
    alarms = sum(one["false alarms"] for one in found)
    print(
        f"\n{alarms:.0f} false alarms in {options.hours * len(found):g} healthy hours; highest "
        f"share of a limit, median {np.median(highest):.2f}, largest {max(highest):.2f}\n"
    )
    print("| hung on | found | within | median [min] | slowest [min] |\n|---|---|---|---|---|")
    for name in (f"{load}, {when}" for load in LOADS for when in ("at once", "later")):
        minutes, wanted = WANTED[name.split(",")[0]]
        times = np.array([np.inf if one[name] is None else one[name] for one in found])
        print(
            f"| {name} | {np.isfinite(times).sum()}/{len(times)} | {minutes:g} min: "
            f"{(times <= minutes).sum()}/{len(times)} (wanted: {wanted}/20) "
            f"| {np.median(times):.1f} | {times.max():.1f} |"
        )


if __name__ == "__main__":
    main()
