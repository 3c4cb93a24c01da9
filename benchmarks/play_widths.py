"""Half-widths of the plays in the forceps' estimators, compared on a mixed population.

    python -m benchmarks.play_widths [--seed 303] [--count 12]

Each specimen is calibrated on 65 s of nested loops with each set of widths. *Unloaded* is the RMS
error on (28) of the plays on motor and reset cable, *loaded* that of the plays on the reset cable
while 30, 100 and 250 g hang still, both ways: the two estimates that the gated plays go between.
Judge what you choose here on another seed, by ``truejoint study forceps-mixed``.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from truejoint import calibrate
from truejoint.estimators import Play
from truejoint.estimators.plays.jaw_bank import DRIVE_WIDTHS, RESET_WIDTHS
from truejoint.simulation.forceps.parameters import ForcepsParameters
from truejoint.simulation.forceps.specimens import population
from truejoint.studies.forceps import methods as m
from truejoint.studies.forceps.mixed import load_test
from truejoint.studies.forceps.motions import record

Array = NDArray[np.float64]
Widths = tuple[tuple[float, ...], tuple[float, ...]]

MASSES = (30.0, 100.0, 250.0)  # g
SETS: dict[str, Widths] = {
    "as they are": (RESET_WIDTHS, DRIVE_WIDTHS),
    "half as wide": (tuple(0.5 * w for w in RESET_WIDTHS), tuple(0.5 * w for w in DRIVE_WIDTHS)),
    "twice as wide": (tuple(2.0 * w for w in RESET_WIDTHS), tuple(2.0 * w for w in DRIVE_WIDTHS)),
    "1 um beside": ((1e-6, *RESET_WIDTHS), (2e-6, *DRIVE_WIDTHS)),
    "400 um, 1 mm beside": ((*RESET_WIDTHS, 400e-6), (*DRIVE_WIDTHS, 1e-3)),
    "every other": (RESET_WIDTHS[::2], DRIVE_WIDTHS[::2]),
    "one more between two": (
        tuple(np.geomspace(RESET_WIDTHS[0], RESET_WIDTHS[-1], 13)),
        tuple(np.geomspace(DRIVE_WIDTHS[0], DRIVE_WIDTHS[-1], 17)),
    ),
}


def errors(plant: ForcepsParameters, number: int) -> Iterator[tuple[float, list[float]]]:
    """RMS errors [rad] of a specimen, unloaded and under each weight, by set of widths."""
    training = m.settled(record(plant, "nested", seed=2 * number))
    run = m.settled(record(plant, "verification", seed=2 * number + 1))
    hung = []
    for mass in MASSES:
        for direction in ("along", "opposing"):
            test = load_test(mass, direction)
            hung.append((record(plant, test, seed=100 * number + round(mass)), test.phases["IV"]))
    for reset, drive in SETS.values():
        models = {}
        for key, displacements in (("play_both", ("reset", "motor")), ("play_reset", ("reset",))):
            play = Play(displacements=displacements, reset_widths=reset, drive_widths=drive)
            models[key] = calibrate(training, play, features=m.METHODS[key].inputs)
        both, alone = ({key: model} for key, model in models.items())
        loaded = [m.judge(alone, one).errors(*still)["play_reset"]["rms"] for one, still in hung]
        yield m.judge(both, run).errors()["play_both"]["rms"], loaded


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=303)
    parser.add_argument("--count", type=int, default=12)
    options = parser.parse_args()
    every = [
        list(errors(plant, number))
        for number, plant in enumerate(population(options.count, options.seed, "mixed"))
    ]
    print("| widths | unloaded: median | 95 % | worst | loaded: median | 90 % | worst |")
    print("|---|---|---|---|---|---|---|")
    for k, name in enumerate(SETS):
        unloaded = np.degrees([one[k][0] for one in every])
        loaded = np.degrees([one[k][1] for one in every]).ravel()
        shares = (*np.quantile(unloaded, [0.5, 0.95, 1.0]), *np.quantile(loaded, [0.5, 0.9, 1.0]))
        print(f"| {name} | {' | '.join(f'{share:.4f}' for share in shares)} |")


if __name__ == "__main__":
    main()
