"""Faults put into the readings of a simulated arm: which redundancy shows them, and how soon.

    python -m benchmarks.faults [--seeds 20] [--seconds 30] [--estimator linear] [--small]
    python -m benchmarks.faults --healthy 60 [--seeds 20]

Each seed is an arm of its own, homed once, with a model of its zig-zags and an interval. Faults
begin ten seconds into a random motion, in one joint's reading at a time, with the motors and the
set point as they were: a fault between motor encoder and reading, or in one encoder of two. Each is
looked for with motors and set point, with the set point alone, and with neither. `--small` takes a
minute.

A fault is found with the first sample that is not OK. The time to it counts while the joint moves
faster than a tenth of its fastest. "Before 3 w": found before the reading is off by three times the
stated half-width, among the runs in which it ever is. "OK again": runs in which any sample is OK
later than 0.2 s after the first that is not, with the reading off by more than the half-width.

`--healthy` puts no fault in: each arm works for so many minutes, with a pause of ten seconds every
two minutes, and what is flagged is counted.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.loop_session import HOMING, Samples, simulated_session
from truejoint.calibration import Calibration
from truejoint.runtime import Corrector, Status

Row = NDArray[np.float64]

BEGIN = 10_000  # sample at which a fault begins
SETTLED = 200  # samples after the first flag in which a reading may still be OK
REDUNDANT = {"motors, set point": ("motor", "setpoint"), "set point": ("setpoint",), "none": ()}


@dataclass(frozen=True)
class Case:
    """A healthy stream and the joint to be hurt."""

    t: Row
    rows: Row
    signals: Sequence[str]
    joint: str
    other: str
    half_width: float

    def column(self, quantity: str, joint: str = "") -> int:
        """Where a signal stands in a sample."""
        return self.signals.index(f"{quantity}/{joint or self.joint}")

    def reading(self, values: Row) -> Row:
        """Give samples with these readings of the joint from the fault on."""
        rows = self.rows.copy()
        rows[BEGIN:, self.column("measured")] = values[BEGIN:]
        return rows


def true_reading(case: Case) -> Row:
    """Give the reading of the joint without a fault."""
    return np.array(case.rows[:, case.column("measured")])


def since(case: Case) -> Row:
    """Time since the fault began [s], 0 before."""
    return np.array(np.maximum(case.t - case.t[BEGIN], 0.0))


def stuck(case: Case) -> Row:
    """Stand still, but for noise of 1e-9."""
    noise = 1e-9 * np.random.default_rng(0).normal(size=len(case.t))
    return case.reading(true_reading(case)[BEGIN] + noise)


def jump(case: Case) -> Row:
    """Jump by five times the half-width."""
    return case.reading(true_reading(case) + 5.0 * case.half_width)


def drift(case: Case) -> Row:
    """Drift by the half-width in three seconds."""
    return case.reading(true_reading(case) + case.half_width / 3.0 * since(case))


def scale(case: Case) -> Row:
    """Show every movement 5 % too large."""
    q = true_reading(case)
    return case.reading(q + 0.05 * (q - q[BEGIN]))


def lost_counts(case: Case) -> Row:
    """Lose 2 % of the movement one way."""
    q = true_reading(case)
    up = np.maximum(np.diff(q, prepend=q[0]), 0.0)
    up[: BEGIN + 1] = 0.0
    return case.reading(q - 0.02 * np.cumsum(up))


def sign(case: Case) -> Row:
    """Show every movement the wrong way."""
    q = true_reading(case)
    return case.reading(2.0 * q[BEGIN] - q)


def delay(case: Case) -> Row:
    """Show the joint where it was 0.1 s ago."""
    return case.reading(np.roll(true_reading(case), 100))


def swap(case: Case) -> Row:
    """Show another joint's position, and that one this joint's."""
    rows = case.rows.copy()
    here, there = case.column("measured"), case.column("measured", case.other)
    rows[BEGIN:, [here, there]] = rows[BEGIN:, [there, here]]
    return rows


def dead_effort(case: Case) -> Row:
    """Show no effort, but for noise of 1e-9."""
    rows = case.rows.copy()
    noise = 1e-9 * np.random.default_rng(0).normal(size=len(case.t))
    rows[BEGIN:, case.column("effort")] = noise[BEGIN:]
    return rows


FAULTS: dict[str, Callable[[Case], Row]] = {
    "stuck": stuck, "jump": jump, "drift": drift, "scale": scale, "loss of counts": lost_counts,
    "sign": sign, "swap": swap, "delay": delay, "effort dead": dead_effort,
}  # fmt: skip


@dataclass(frozen=True)
class Outcome:
    """What came of one fault in one run."""

    found_after: float  # time of motion [s]; infinite if never
    in_time: float  # 1 found before three half-widths, 0 not; NaN if they were never reached
    was_ok_again: bool
    latched: bool


def outcome(case: Case, rows: Row, model: Calibration) -> Outcome:
    """Run a corrector along the samples."""
    corrector = Corrector(model)
    corrector.set_homing(True, HOMING)
    order = [case.signals.index(signal) for signal in corrector.signals]
    needed = list(np.ascontiguousarray(rows[:, order]))
    step = corrector.step
    bits = np.array([step(t, row) for t, row in zip(case.t.tolist(), needed, strict=True)])
    if bits[:BEGIN].any():
        print(f"  ({np.count_nonzero(bits[:BEGIN])} samples flagged before the fault)")
    q, flagged = true_reading(case), bits[BEGIN:] != 0
    off = np.abs(rows[:, case.column("measured")] - q)[BEGIN:]
    speed = np.abs(np.diff(q, prepend=q[0]))[BEGIN:]
    first = int(np.argmax(flagged)) if flagged.any() else len(flagged)
    moving = np.count_nonzero(speed[:first] > 0.1 * np.quantile(speed, 0.99))
    late = off > 3.0 * case.half_width
    later = ~flagged[first + SETTLED :] & (off[first + SETTLED :] > case.half_width)
    return Outcome(
        found_after=1e-3 * moving if flagged.any() else np.inf,
        in_time=float(first <= int(np.argmax(late))) if late.any() else np.nan,
        was_ok_again=bool(later.any()),
        latched=bool(bits[-1] & Status.ZERO_SUSPECT),
    )


def cases(model: Calibration, samples: Samples) -> list[Case]:
    """Give every joint in turn."""
    assert model.interval is not None  # noqa: S101
    widths = model.interval.half_width(0.9)
    t = np.array(samples.t)
    return [
        Case(t, samples.rows, samples.signals, joint, model.joints[k - 1], float(widths[k]))
        for k, joint in enumerate(model.joints)
    ]


def work_healthily(seed: int, minutes: float, estimator: str) -> None:
    """Print what is flagged of one arm's work."""
    session = simulated_session(seed)
    model = session.fit(estimator)
    corrector = Corrector(model)
    corrector.set_homing(True, HOMING)
    seen: Counter[int] = Counter()
    for part in range(max(1, round(minutes / 2))):
        samples = session.samples(corrector.signals, 110.0, seed=1000 * seed + part, pause=10.0)
        step = corrector.step
        seen.update(step(t, row) for t, row in zip(samples.t, samples.rows, strict=True))
    flagged = {repr(Status(bits)): n for bits, n in seen.items() if bits}
    print(f"seed {seed}: {sum(seen.values())} samples, {sum(flagged.values())} flagged {flagged}")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first-seed", type=int, default=100)
    parser.add_argument("--seconds", type=float, default=30.0, help="of motion with the fault")
    parser.add_argument("--estimator", default="linear")
    parser.add_argument("--small", action="store_true", help="two seeds, ten seconds: a minute")
    parser.add_argument("--healthy", type=float, metavar="MINUTES", help="no faults, so long")
    options = parser.parse_args()
    if options.healthy:
        for seed in range(options.first_seed, options.first_seed + options.seeds):
            work_healthily(seed, options.healthy, options.estimator)
        return
    if options.small:
        options.seeds, options.seconds = 2, 10.0
    seen: dict[tuple[str, str, str], list[Outcome]] = {}
    for seed in range(options.first_seed, options.first_seed + options.seeds):
        session = simulated_session(seed)
        models = {
            name: session.fit(options.estimator, quantities)
            for name, quantities in REDUNDANT.items()
        }
        whole = next(iter(models.values()))
        duration = 1e-3 * BEGIN + options.seconds
        samples = session.samples(whole.loop_signals, duration, seed=seed)
        for case in cases(whole, samples):
            for fault, put in FAULTS.items():
                rows = put(case)
                for name, model in models.items():
                    found = seen.setdefault((fault, case.joint, name), [])
                    found.append(outcome(case, rows, model))
    print(
        "| fault | joint | redundant | found | within 0.2 s | time of motion, 95 % [s] "
        "| before 3 w | OK again | kept in mind |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    for (fault, joint, name), found in seen.items():
        after = np.array([one.found_after for one in found])
        in_time = np.array([one.in_time for one in found])
        known = in_time[np.isfinite(in_time)]
        slowest = np.sort(after)[int(np.ceil(0.95 * len(after))) - 1]
        print(
            f"| {fault} | {joint} | {name} | {np.isfinite(after).sum()}/{len(after)} "
            f"| {(after <= 0.2).sum()} | {'-' if np.isinf(slowest) else f'{slowest:.2f}'} "
            f"| {f'{known.sum():.0f}/{len(known)}' if len(known) else '-'} "
            f"| {sum(one.was_ok_again for one in found)} | {sum(one.latched for one in found)} |"
        )


if __name__ == "__main__":
    main()
