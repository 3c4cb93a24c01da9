"""What a step of every registered estimator costs, from Python and in C, of 1, 3 and 6 joints.

    python -m benchmarks.step_speed [--estimators NAME ...] [--joints 1 3 6] [--calls 6000]

One joint is a jaw at its driver (or, for estimators of cables, a virtual forceps), three are a
simulated RAVEN-II with 16 features, six a made-up arm of a dVRK, of which the positions are
features, and efforts where an estimator insists on them.
Networks are fitted for two epochs only: weights do not change the speed. A step is all that a
control loop pays for: checks, features, model and interval. Prints a Markdown table of the median
in us: of the quickest tenth of the calls from Python, and of batches of 64 in C; a dash where an
estimator does not take the recordings, with the reason below. What is above the bars is bold.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.corrector_speed import PARTS, time_corrector
from benchmarks.exported_c_speed import build, forceps_session, some_interval
from benchmarks.loop_session import Samples, simulated_session
from truejoint.calibration import Calibration, calibrate
from truejoint.errors import TruejointError
from truejoint.estimators import JointRegressor, estimator_names, get_estimator
from truejoint.recordings import Provenance, Recording
from truejoint.robots import get_robot

BARS = {"Python": 25.0, "C": 12.0}  # us
QUICK = {"epochs": 2}
LEAST_CORRECTED = 90.0  # %
SIX = 6


def driven_jaw(seed: int) -> Recording:
    """Make a minute at 200 Hz of a jaw that rubs and gives, under one load."""
    rng = np.random.default_rng(seed)
    t = np.arange(12_000) / 200.0
    driver = 0.5 + 0.45 * np.cos(2.0 * np.pi * 0.3 * t) * (0.8 + 0.2 * np.sin(0.3 * t))
    load = 0.02 + 0.02 * seed
    friction = np.tanh(np.gradient(driver, t) / 0.05)
    effort = load + 0.03 * friction + 0.01 * driver + 0.002 * rng.standard_normal(len(t))
    columns = {
        "t": t,
        "measured/jaw": 1.0 - 0.9 * driver,
        "driver/jaw": driver,
        "effort/jaw": effort,
        "truth/jaw": 1.1 - 0.88 * driver - 0.9 * load - 0.01 * friction,
        "truth_effort/jaw": -1.1 * load - 0.01 * friction,
    }
    origin = Provenance("davinci_grasper", session=str(seed))
    units = dict.fromkeys(("effort/jaw", "truth_effort/jaw"), "Nm")
    return Recording.from_columns(columns, origin, units)


def six_joints(seed: int) -> Recording:
    """Make five minutes at 50 Hz of an arm whose joints lag behind their motors by a play."""
    robot, rng = get_robot("dvrk_psm"), np.random.default_rng(seed)
    t = np.arange(15_000) / 50.0
    columns = {"t": t}
    for joint in robot.joints[:SIX]:
        waves = np.sin(np.outer(t, rng.uniform(0.2, 1.5, 3)) + rng.uniform(0.0, 6.0, 3)).mean(1)
        columns[f"measured/{joint.name}"] = joint.lower + (joint.upper - joint.lower) * (
            0.5 + 0.4 * waves
        )
    for joint in robot.joints[:SIX]:
        q = columns[f"measured/{joint.name}"]
        friction = np.tanh(np.gradient(q, t) / (0.1 * np.ptp(q)))
        columns[f"effort/{joint.name}"] = friction + 0.1 * rng.standard_normal(len(t))
        columns[f"truth/{joint.name}"] = q - 0.01 * np.ptp(q) * friction
    units = {f"effort/{j.name}": "N" if j.unit == "m" else "Nm" for j in robot.joints[:SIX]}
    return Recording.from_columns(columns, Provenance("dvrk_psm", session=str(seed)), units)


def recordings() -> dict[int, tuple[list[Recording], Recording]]:
    """Training, and a motion that is not in it, by the number of joints; 0: of a jaw's cables."""
    jaws = [driven_jaw(seed) for seed in range(5)]
    raven = simulated_session()
    six = [six_joints(seed) for seed in range(3)]
    cables = forceps_session()
    return {
        0: ([cables], cables),
        1: (jaws[:4], jaws[4]),
        3: (raven.training, raven.held_back[0]),
        SIX: (six[:2], six[2]),
    }


def unfitted(name: str) -> JointRegressor:
    """Estimator of that name, quick to fit."""
    estimator = get_estimator(name)
    own = estimator.get_params()
    return estimator.set_params(**{k: v for k, v in QUICK.items() if k in own})


def steps(model: Calibration, unseen: Recording, calls: int) -> dict[str, float]:
    """Cost of a step [us] from Python and in C; TruejointError if samples are mostly flagged."""
    rows = unseen.table[list(model.loop_signals)].to_numpy()
    laps = time_corrector(
        model, Samples(model.loop_signals, unseen.t.tolist(), rows), min(calls, len(rows))
    )
    least = min(float(np.median(part)) for part in np.array_split(laps, PARTS))
    with tempfile.TemporaryDirectory() as folder:
        program = build(model, unseen, Path(folder), "double", "gcc")
        told = subprocess.run([str(program)], check=True, capture_output=True, text=True).stdout
    median, corrected = re.findall(r"median ([\d.]+) us|([\d.]+) % of the samples", told)
    if float(corrected[1]) < LEAST_CORRECTED:
        raise TruejointError(f"{corrected[1]} % of the samples were corrected, too few to time")
    return {"Python": least, "C": float(median[0])}


def cells(
    name: str,
    recorded: dict[int, tuple[list[Recording], Recording]],
    joints: list[int],
    calls: int,
) -> Iterator[tuple[dict[str, float], str]]:
    """Give costs for each number of joints, or none and the reason."""
    estimator = unfitted(name)
    if estimator.family.row is None:
        yield from (({}, f"it {estimator.family.offline}") for _ in joints)
        return
    for n in joints:
        training, unseen = recorded[n]
        own = estimator.family.inputs
        if n == 1 and own and not set(own(estimator.model_params())) <= set(unseen.table.columns):
            training, unseen = recorded[0]
        positions = [f"measured/{joint}" for joint in unseen.joints_of("measured")]
        features = positions if n == SIX and not own else None
        try:
            model = calibrate(training, estimator, features=features)
            model = replace(model, interval=some_interval(len(model.joints)))
            yield steps(model, unseen, calls), ""
        except TruejointError as reason:
            yield {}, f"{n} joints: {reason}"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--estimators", nargs="+", default=estimator_names())
    parser.add_argument("--joints", nargs="+", type=int, default=[1, 3, SIX], choices=[1, 3, SIX])
    parser.add_argument("--calls", type=int, default=6000)
    options = parser.parse_args()
    head = [f"{n} joint{'s' * (n > 1)}, {where}" for n in options.joints for where in BARS]
    print(f"| estimator | {' | '.join(head)} |\n{'|---' * (1 + len(head))}|")
    recorded, reasons = recordings(), []
    for name in options.estimators:
        row = [name]
        for found, reason in cells(name, recorded, options.joints, options.calls):
            for where, bar in BARS.items():
                took = found.get(where)
                shown = "-" if took is None else f"{took:.2f}"
                row.append(f"**{shown}**" if took is not None and took > bar else shown)
            reasons += [f"{name}: {reason}"] * bool(reason)
        print(f"| {' | '.join(row)} |", flush=True)
    print("\n" + "\n".join(reasons))


if __name__ == "__main__":
    main()
