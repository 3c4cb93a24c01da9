"""How far off the tip is said to be against how far off it is, on arms drawn by numbers.

    python -m benchmarks.tip_error [--arms 50] [--fault-arms 20] [--first 0]

An arm has zeros, scale, coupling, gravity stretch, backlash and run-out of its own
(``tests/drawn_arm.py``); nothing of it is in the terms that are fitted. Thirty dimples of the
printed block, or thirty shots of a tracker, calibrate it, with the noise stated right, half and
double, and with six touches made twice or none. Judged is the tip at new rests, in the dimples and
all over the workspace. Then each fault is tried: how often the session is refused or the fault is
named, and how many times as far off as stated the tip is where it is taken. Then a bolted block
moves before six touches re-zero a model, with four, eight or no references.
"""

import numpy as np
from tests.drawn_arm import FAULTS, NOISE, DrawnArm, block_session, tracker_session, way

from benchmarks import head, parsed, row
from truejoint.array_types import Array
from truejoint.errors import CalibrationError
from truejoint.tip import calibrate_by_touch, find_block, zero_by_touch

MAKE = {"block": block_session, "tracker": tracker_session}
NEAR = 1.6


def stated(kind: str, repeats: int, factor: float, seeds: range) -> None:
    """Print stated against true errors, with a noise stated `factor` times too large."""
    ratios: list[list[float]] = []
    for seed in seeds:
        session = MAKE[kind](DrawnArm(seed), 30, repeats)
        noise = factor * NOISE[kind]
        try:
            model, report = calibrate_by_touch(
                session.recording, session.touches, session.block, touch_sd=noise
            )
        except CalibrationError as error:
            print(f"arm {seed}: {error}")
            continue
        near, far = (session.tip_error(model, near=there) for there in (True, False))
        shares = report.tip.rms / near, report.workspace.rms / far, report.left_out_rms / near
        ratios.append([*shares, 1e3 * near, 1e3 * far])
    found = np.array(ratios)
    inside = (np.abs(np.log(found[:, :2])) < np.log(NEAR)).mean(axis=0)
    middle = np.median(found, axis=0)
    cells = [f"{middle[3]:.2f}", f"{middle[0]:.2f}", f"{inside[0]:.0%}", f"{middle[2]:.2f}"]
    cells += [f"{middle[4]:.2f}", f"{middle[1]:.2f}", f"{inside[1]:.0%}"]
    zero = int((found[:, :2] <= 0.0).sum())
    row(kind, repeats, f"{factor:g}", *cells, zero, len(found))


def fault(kind: str, name: str, seeds: range) -> None:
    """Print how often a fault is refused or named, and how far off it is where it is taken."""
    make, word = FAULTS[kind, name]
    refused, named, off = 0, 0, [0.0]
    for seed in seeds:
        session = make(DrawnArm(seed))
        try:
            model, report = calibrate_by_touch(
                session.recording, session.touches, session.block, touch_sd=NOISE[kind]
            )
        except CalibrationError as error:
            refused += 1
            named += word in str(error)
            continue
        named += any(word in text for text in report.not_seen)
        off.append(session.tip_error(model, near=True) / report.tip.rms)
    row(f"{kind}, {name}", refused, named, f"{max(off):.1f}", len(seeds))


def rezeroed(seed: int, references: int, millimetres: float) -> float | None:
    """Largest error of a zero in its stated deviations; None where a moved block is refused."""
    arm, rng = DrawnArm(seed), np.random.default_rng([seed, 31])
    model, day = arm.model(), block_session(arm, 30, 0, references=references)
    pose, _ = find_block(model, day.recording, day.touches, day.block)
    homing: Array = rng.standard_normal(3) * [np.deg2rad(0.3), np.deg2rad(0.5), 4e-4]
    today = DrawnArm(seed, moved=way(seed, millimetres), homing=homing)
    few = block_session(today, 6, 0, references=references, day=1)
    try:
        zero, _ = zero_by_touch(model, few.recording, few.touches, pose)
    except CalibrationError:
        return None
    return float((np.abs(zero.offset - homing) / zero.deviation).max())


def main() -> None:
    """Measure and print."""
    options = parsed(__doc__, arms=50, fault_arms=20, first=0)
    seeds = range(options.first, options.first + options.arms)
    head(
        "by", "repeats", "noise stated / true", "near [mm]", "stated / true", "within 1.6",
        "left out / true", "workspace [mm]", "stated / true", "within 1.6", "zero", "arms",
    )  # fmt: skip
    for kind in MAKE:
        for repeats in (6, 0):
            for factor in (1.0, 0.5, 2.0):
                stated(kind, repeats, factor, seeds)
    seeds = range(options.first, options.first + options.fault_arms)
    print()
    head("fault", "refused", "named", "true / stated, worst taken", "arms")
    for kind, name in FAULTS:
        fault(kind, name, seeds)
    print()
    worst = "error of a zero in its deviations, worst taken"
    head("bolted block moved by [mm]", "references", "refused", worst, "arms")
    for millimetres in (0.0, 0.5, 1.0, 2.0, 5.0):
        for references in (0, 4, 8):
            off = [rezeroed(seed, references, millimetres) for seed in seeds]
            taken = [value for value in off if value is not None]
            worst = f"{max(taken):.1f}" if taken else "-"
            row(f"{millimetres:g}", references, off.count(None), worst, len(off))


if __name__ == "__main__":
    main()
