"""Faults put into the readings of a simulated arm: which redundancy shows them, and how soon.

    python -m benchmarks.faults [--seeds 20] [--seconds 10] [--estimator linear] [--only swap]
    python -m benchmarks.faults --healthy 60 [--seeds 20]

What a seed gave is kept in a file of its own under `--out` and is not run again. Two seeds take a
minute.

Each seed is an arm of its own, homed once, with a model of its zig-zags and an interval. Faults
begin ten seconds into a random motion, in one joint's reading at a time, with the motors and the
set point as they were: a fault between motor encoder and reading, or in one encoder of two. Each is
looked for with motors and set point, with the set point alone, and with neither. `--only` names a
part of the names of faults.

A fault is found with the first sample that is not OK. The time to it counts while the joint moves
faster than a tenth of its fastest. "Before 3 w": found before the reading is off by three times the
stated half-width, among the runs in which it ever is. "OK again": runs in which any sample is OK
later than 0.2 s after the first that is not, with the reading off by more than the half-width.

`--healthy` puts no fault in: each arm works for so many minutes, with a pause of ten seconds every
two minutes and 200 g hung on it in the second half, and what is flagged is counted.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import head, parsed, row, stored
from benchmarks.loop import HOMING, Samples, simulated_session
from truejoint.array_types import Array
from truejoint.calibration import Calibration
from truejoint.runtime import Corrector, Status

BEGIN = 10_000  # sample at which a fault begins
SETTLED = 200  # samples after the first flag in which a reading may still be OK
REDUNDANT = {"motors, set point": ("motor", "setpoint"), "set point": ("setpoint",), "none": ()}


@dataclass(frozen=True)
class Case:
    """A healthy stream and the joint to be hurt."""

    t: Array
    rows: Array
    signals: Sequence[str]
    joint: str
    other: str
    half_width: float

    def column(self, quantity: str, joint: str = "") -> int:
        """Where a signal stands in a sample."""
        return self.signals.index(f"{quantity}/{joint or self.joint}")

    def shown(self, quantity: str, values: Array) -> Array:
        """Give samples with these values of a quantity of the joint from the fault on."""
        rows = self.rows.copy()
        rows[BEGIN:, self.column(quantity)] = values[BEGIN:]
        return rows


def true_reading(case: Case) -> Array:
    """Give the reading of the joint without a fault."""
    return np.array(case.rows[:, case.column("measured")])


def reading(values: Callable[[Case, Array], Array]) -> Callable[[Case], Array]:
    """Put a fault into the reading, by the case and the true one."""
    return lambda case: case.shown("measured", values(case, true_reading(case)))


def noise(case: Case) -> Array:
    """Give noise of 1e-9."""
    return 1e-9 * np.random.default_rng(0).normal(size=len(case.t))


def lost_counts(_: Case, q: Array) -> Array:
    """Lose 2 % of the movement one way."""
    up = np.maximum(np.diff(q, prepend=q[0]), 0.0)
    up[: BEGIN + 1] = 0.0
    return q - 0.02 * np.cumsum(up)


def swap(case: Case, quantity: str = "measured") -> Array:
    """Show another joint's position, and that one this joint's; or their efforts or motors."""
    rows = case.rows.copy()
    here, there = case.column(quantity), case.column(quantity, case.other)
    rows[BEGIN:, [here, there]] = rows[BEGIN:, [there, here]]
    return rows


FAULTS: dict[str, Callable[[Case], Array]] = {
    "stuck": reading(lambda c, q: q[BEGIN] + noise(c)),
    "jump": reading(lambda c, q: q + 5.0 * c.half_width),
    # By the half-width in three seconds.
    "drift": reading(lambda c, q: q + c.half_width / 3.0 * np.maximum(c.t - c.t[BEGIN], 0.0)),
    "scale": reading(lambda _, q: q + 0.05 * (q - q[BEGIN])),  # every movement 5 % too large
    "loss of counts": reading(lost_counts),
    "sign": reading(lambda _, q: 2.0 * q[BEGIN] - q),  # every movement the wrong way
    "swap": swap,
    "delay": reading(lambda _, q: np.roll(q, 100)),  # where the joint was 0.1 s ago
    "effort dead": lambda c: c.shown("effort", noise(c)),
    "efforts swapped": partial(swap, quantity="effort"),
    "motors swapped": partial(swap, quantity="motor"),
}


@dataclass(frozen=True)
class Outcome:
    """What came of one fault in one run."""

    found_after: float  # time of motion [s]; infinite if never
    in_time: float  # 1 found before three half-widths, 0 not; NaN if they were never reached
    was_ok_again: bool
    latched: bool


def outcome(case: Case, rows: Array, model: Calibration) -> Outcome:
    """Run a corrector along the samples."""
    corrector = Corrector(model)
    corrector.set_homing(True, HOMING)
    order = [case.signals.index(signal) for signal in corrector.signals]
    needed = list(np.ascontiguousarray(rows[:, order]))
    bits = np.array(list(map(corrector.step, case.t.tolist(), needed)))
    if bits[:BEGIN].any():
        print(f"  ({np.count_nonzero(bits[:BEGIN])} samples flagged before the fault)", flush=True)
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
        latched=bool(bits[-1] & int(Status.ZERO_SUSPECT)),
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


def piece(seed: int, seconds: float, estimator: str) -> dict[str, Any]:
    """Outcome of every fault in every joint of one arm, by fault, joint and redundancy."""
    session = simulated_session(seed)
    joints = session.training[0].joints_of("truth")
    models = {
        name: session.fit(estimator, redundant=[f"{q}/{joint}" for q in by for joint in joints])
        for name, by in REDUNDANT.items()
    }
    whole = next(iter(models.values()))
    samples = session.samples(whole.loop_signals, 1e-3 * BEGIN + seconds, seed=seed)
    return {
        f"{fault}, {case.joint}, {name}": asdict(outcome(case, rows, model))
        for case in cases(whole, samples)
        for fault, rows in ((fault, put(case)) for fault, put in FAULTS.items())
        for name, model in models.items()
    }


def work_healthily(seed: int, minutes: float, estimator: str) -> dict[str, Any]:
    """Count samples of one arm's work by their status."""
    session = simulated_session(seed)
    corrector = Corrector(session.fit(estimator))
    corrector.set_homing(True, HOMING)
    seen: Counter[str] = Counter()
    parts = max(1, round(minutes / 2))
    for part in range(parts):
        session.arm._backend.twin.load = 0.2 if 2 * part >= parts else 0.0  # type: ignore[attr-defined]
        samples = session.samples(corrector.signals, 110.0, seed=1000 * seed + part, pause=10.0)
        statuses = Counter(map(corrector.step, samples.t, samples.rows))
        seen.update({repr(Status(bits)): n for bits, n in statuses.items()})
    return dict(seen)


def fault_tables(found: Sequence[dict[str, Any]]) -> None:
    """Print what was found: a row for each fault, then one for each fault and joint."""
    names = list(REDUNDANT)
    joints = list(dict.fromkeys(key.split(", ")[1] for key in found[0]))
    print("Faults found, by what is read beside the position\n")
    head("fault of a reading", *names)
    for fault in FAULTS:
        row(fault, *(summary(found, fault, joints, name) for name in names))
    print("\nFaults found, joint by joint\n")
    head("fault", "joint", "redundant", "found")
    for fault, joint, name in product(FAULTS, joints, names):
        row(fault, joint, name, summary(found, fault, [joint], name))


def summary(found: Sequence[dict[str, Any]], fault: str, joints: Sequence[str], name: str) -> str:
    """Say in how many runs a fault was found, how soon, in time, and what came after."""
    runs = [Outcome(**one[f"{fault}, {joint}, {name}"]) for one in found for joint in joints]
    n, after = len(runs), np.sort([one.found_after for one in runs])
    if not np.isfinite(after).any():
        return "not seen"
    said = [f"{np.isfinite(after).sum()}/{n}"]
    slowest = after[int(np.ceil(0.95 * n)) - 1]
    if np.isfinite(slowest):
        said.append(f"95 % within {slowest:.2f} s" if slowest > 0.0 else "95 % at once")
    soon = (after <= 0.2).sum()
    if soon and slowest > 0.0:
        said.append(f"{soon}/{n} within 0.2 s")
    in_time = [one.in_time for one in runs if np.isfinite(one.in_time)]
    if in_time:
        said.append(f"in time {sum(in_time):.0f}/{len(in_time)}")
    again, latched = sum(one.was_ok_again for one in runs), sum(one.latched for one in runs)
    if again:
        said.append(f"OK again {again}")
    said.append(f"kept {latched}/{n}")
    return "; ".join(said)


def main() -> None:
    """Print the tables."""
    options = parsed(
        __doc__, seeds=20, first_seed=200, seconds=10.0, estimator="linear", healthy=0.0, only="",
        out=Path("bench/faults"),
    )  # fmt: skip
    for name in [name for name in FAULTS if options.only not in name]:
        del FAULTS[name]
    length = options.healthy or options.seconds
    run, kind = (work_healthily, "healthy") if options.healthy else (piece, "faults")
    found = []
    for seed in range(options.first_seed, options.first_seed + options.seeds):
        title = f"{kind}, {seed}, {options.estimator}, {length:g}{options.only}"
        found.append(stored(options.out, title, partial(run, seed, length, options.estimator)))
        if options.healthy:
            print(f"seed {seed}: {found[-1]}", flush=True)
    if options.healthy:
        together = sum((Counter(one) for one in found), Counter[str]())
        flagged = together.total() - together[repr(Status.OK)]
        print("\nHealthy work\n")
        head("samples", "flagged", "by status")
        row(together.total(), flagged, dict(together))
    else:
        fault_tables(found)


if __name__ == "__main__":
    main()
