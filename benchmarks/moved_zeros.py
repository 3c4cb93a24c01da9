"""Zeros that move between recordings: what they cost, and what a fitted zero saves.

    python -m benchmarks.moved_zeros [--splits frequency load] [--fit dnn ukf_elastic] [--draws 1]

The da Vinci grasper, whole recordings held out (frequency index 3, or load indices 3 and 7). The
zero of every recording, of training and test alike, is moved by 1 to 3 deg to either side: that of
the truth, as if its sensor had been mounted anew, or that of the driver's encoder, and with it the
measured position, as if the robot had been homed. Each test recording is re-zeroed from its first
2 s of truth, and judged on the rest. Jaw RMSE in deg, over all test recordings together; of several
draws of the zeros, that with the largest last column.

The plain fit takes all recordings to share one zero, those beside it have one for each recording
or homing. As positions come, the plain one corrects whatever was fitted beside it.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np

from truejoint import Calibration, Recording, calibrate
from truejoint.calibration.zero import judged_error
from truejoint.estimators import get_estimator
from truejoint.recordings.datasets import get_dataset, read_dataset

DATASET = get_dataset("davinci_grasper_umn")
FITTED = {"dnn": ("linear", "poly2", "dnn"), "ukf_elastic": ("ukf_elastic",)}
"""What is fitted, and what of that is judged: the baselines are fitted along."""
START = 2.0
"""Truth [s] that re-zeroes a recording."""
SMALLEST, LARGEST = np.radians([1.0, 3.0])
"""How far a zero is moved [rad]."""
JAW = ("jaw",)


def moved(recording: Recording, what: str, by: float) -> Recording:
    """Move a zero; the driver's angle and the measured position are one encoder's."""
    table = recording.table.copy()
    if what == "truth":
        table["truth/jaw"] += by
    elif what == "measured":
        per_driver = np.polyfit(table["driver/jaw"], table["measured/jaw"], 1)[0]
        table["measured/jaw"] += by
        table["driver/jaw"] += by / per_driver
    return replace(recording, table=table)


def gather(what: str, draw: int) -> list[Recording]:
    """All recordings, each of a homing of its own, with the zeros of one draw."""
    random = np.random.default_rng(draw)
    recordings = read_dataset(DATASET.name, "Tool_4_Maryland_L_4/*")
    sizes = random.uniform(SMALLEST, LARGEST, len(recordings))
    zeros = sizes * random.choice([-1.0, 1.0], len(recordings))
    return [
        moved(
            replace(one, provenance=replace(one.provenance, homing_id=one.provenance.session)),
            what,
            zero,
        )
        for one, zero in zip(recordings, zeros, strict=True)
    ]


def fit(name: str, recordings: Sequence[Recording], zero: str) -> Calibration:
    """Calibrate as the data set suggests."""
    own = name == "ukf_elastic"
    return calibrate(
        recordings,
        get_estimator(name).set_params(**DATASET.settings.get(name, {})),
        features=None if own else DATASET.features,
        fit_rate=DATASET.fit_rate,
        zero=zero,
    )


def rmse(calibration: Calibration, recordings: Iterable[Recording], start: float) -> float:
    """Jaw RMSE [deg] over all rows that are judged."""
    errors = [judged_error(calibration, recording, start)[0] for recording in recordings]
    return float(np.degrees(np.sqrt(np.mean(np.concatenate(errors) ** 2))))


def judge(
    name: str, holds_out: Callable[[str], bool], what: str, zero: str, draw: int
) -> dict[str, tuple[float, float, float]]:
    """RMSE [deg] of plain fits as they come and re-zeroed, and of those with zeros, re-zeroed."""
    recordings = gather(what, draw)
    training = [r for r in recordings if not holds_out(r.provenance.session)]
    test = [r for r in recordings if holds_out(r.provenance.session)]
    both = fit(name, training, zero)
    found = {}
    for judged in FITTED[name]:
        plain, own = (
            used if judged == name else used.baselines[judged]
            for used in (both, both.for_rezeroing)
        )
        found[judged] = rmse(plain, test, 0.0), rmse(plain, test, START), rmse(own, test, START)
    return found


CASES = (
    ("none", "recording"), ("truth", "recording"), ("none", "homing"), ("measured", "homing"),
    ("measured", "recording"),
)  # fmt: skip


def main() -> None:
    """Print the table, row by row."""
    names = [split.name for split in DATASET.splits]
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--splits", nargs="+", choices=names, default=names)
    parser.add_argument("--fit", nargs="+", choices=FITTED, default=list(FITTED))
    parser.add_argument("--draws", type=int, default=1)
    options = parser.parse_args()
    columns = (
        "held out", "estimator", "zero moved", "zero fitted", "plain", "plain, re-zeroed",
        "with zeros, re-zeroed", "of unmoved",
    )  # fmt: skip
    print("| " + " | ".join(columns) + " |\n|" + "---|" * len(columns))
    for split in (DATASET.split(name) for name in options.splits):
        for name in options.fit:
            unmoved: dict[tuple[str, str], float] = {}
            for what, zero in CASES:
                draws = range(1 if what == "none" else options.draws)
                found = [judge(name, split.holds_out, what, zero, draw) for draw in draws]
                for judged in found[0]:
                    worst = max((values[judged] for values in found), key=lambda three: three[-1])
                    if what == "none":
                        unmoved[judged, zero] = worst[-1]
                    ratio = worst[-1] / unmoved[judged, zero]
                    cells = (split.name, judged, what, zero, *(f"{v:.2f}" for v in worst))
                    print("| " + " | ".join(cells) + f" | {ratio:.2f} |", flush=True)


if __name__ == "__main__":
    main()
