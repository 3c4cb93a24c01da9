"""A mechanism off by a fifth: what it costs the forceps' estimators, told of it and not told.

    python -m benchmarks.told_mechanism [--share 0.2]

Jaw radius, wheel radius, spring and gear of the specimens nominal and A are made larger and smaller
by that share in turn. Each method is calibrated on (27) of the changed forceps, told the mechanism
by the recording, and again on the same recording without it, which leaves Table 1. *Told* and *not
told* are RMS errors on (28) over those of the same specimen unchanged; *in the cable* counts the
errors of both as displacement, by the jaw's radius. *Beyond* is by how much an estimate leaves the
range of the jaw, also under 200 g along the motion [deg].
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from truejoint import calibrate
from truejoint.calibration import Calibration
from truejoint.robots import get_robot
from truejoint.simulation.forceps.parameters import ForcepsParameters
from truejoint.simulation.forceps.specimens import specimen
from truejoint.studies.forceps import methods as m
from truejoint.studies.forceps.mixed import load_test
from truejoint.studies.forceps.motions import record

Array = NDArray[np.float64]

METHODS = ("lsm", "ukf", "ukf_compensated", "play_reset", "play_both", "play_gated", "ukf_friction")
VALUES = ("jaw_radius", "wheel_radius", "spring_stiffness", "gear_ratio")


def rms(plant: ForcepsParameters, told: bool) -> tuple[Array, Array]:
    """RMS error of each method on (28) [rad], and how far it leaves the range of the jaw [rad]."""
    training = m.settled(record(plant, "calibration", seed=0))
    if not told:
        training = replace(training, robot=get_robot("forceps"))
    runs = [m.settled(record(plant, "verification", seed=1)),
            record(plant, load_test(200.0, "along"), seed=2)]  # fmt: skip
    models: dict[str, Calibration] = {
        key: calibrate(training, key, features=m.METHODS[key].inputs, target="position")
        for key in METHODS
    }
    judged = [m.judge(models, run) for run in runs]
    jaw = get_robot("forceps").joints[0]
    beyond = [
        max(max(e.max() - jaw.upper, jaw.lower - e.min(), 0.0)
            for e in (one.estimates[key] for one in judged))
        for key in METHODS
    ]  # fmt: skip
    errors = judged[0].errors()
    return np.array([errors[key]["rms"] for key in METHODS]), np.array(beyond)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--share", type=float, default=0.2)
    share = parser.parse_args().share
    print(f"| specimen, value | told | | {' | '.join(METHODS)} |")
    print(f"|---|---|---|{'---|' * len(METHODS)}")
    for name in ("nominal", "A"):
        plant = specimen(name)
        before = rms(plant, told=True)[0]
        for value in VALUES:
            for factor in (1.0 + share, 1.0 - share):
                changed = plant.with_values({
                    f"mechanism.{value}": factor * getattr(plant.mechanism, value)
                })  # fmt: skip
                for told in (True, False):
                    after, beyond = rms(changed, told)
                    what = f"{name}, {value} x {factor:g} | {'yes' if told else 'no'}"
                    rows = {"ratio": after / before, "beyond": np.degrees(beyond)}
                    if value == "jaw_radius":
                        rows["in the cable"] = factor * rows["ratio"]
                    for label, numbers in rows.items():
                        cells = " | ".join(f"{number:.2f}" for number in numbers)
                        print(f"| {what} | {label} | {cells} |", flush=True)


if __name__ == "__main__":
    main()
