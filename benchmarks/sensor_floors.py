"""How exactly the truth of recordings of real joints is known, and how alike equal motions are.

    python -m benchmarks.sensor_floors

No estimator can be better than the sensor that judges it, nor than a joint that comes back to
another place after the same motion. For each data set and joint: the truth's smallest step over the
root of 12 (the noise of rounding), its noise while all motors stand (the deviation of what changes
from one row to the next, over the root of 2), and, where a motion repeats itself, the deviation
between the errors one period apart, over the root of 2. Nothing is fitted. Prints a Markdown table,
in degrees or millimetres.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from benchmarks.automatic_choice import read
from truejoint.recordings import Recording
from truejoint.units import display_unit

Values = NDArray[np.float64]

SETS = {
    "davinci_grasper_umn": ("Tool_4_Maryland_L_4/*", "Tool_4_Maryland_L_Roll_3/*"),
    "dvrk_psm_berkeley": ("random", "peg_transfer"),
    "bros_dual_encoder": ("*",),
    "kuka_kr300_dual_encoder": ("*",),
    "kflex_tendon_sheath": ("[0-9]*",),
}
RATE = 100.0  # [Hz] that recordings are thinned to
PERIODS = 1.0, 12.0  # [s] that are looked for
ALIKE = 0.995  # correlation of the motion with itself a period before
STILL = 1e-4  # share of its range that no position moves by where the motors stand,
STILL_ROWS = 9  # in so many rows
LEAST_ROWS = 20


def step(recordings: list[Recording], joint: str) -> float:
    """Smallest change of a truth that changes."""
    found = [np.abs(np.diff(one.column(f"truth/{joint}"))) for one in recordings]
    changes = np.concatenate(found)
    return float(changes[changes > 1e-9].min())


def at_rest(recordings: list[Recording], joint: str) -> float:
    """Deviation of the truth's change between two rows in which no motor moves; NaN if too few."""
    found = []
    for one in recordings:
        measured = one.columns("measured", one.joints_of("measured"))
        moved = np.abs(np.diff(measured, axis=0)) / np.maximum(np.ptp(measured, axis=0), 1e-9)
        still = np.convolve((moved < STILL).all(axis=1), np.ones(STILL_ROWS), "same")
        found.append(np.diff(one.column(f"truth/{joint}"))[still == STILL_ROWS])
    changes = np.concatenate(found)
    changes = changes[np.isfinite(changes)]
    return float(changes.std() / np.sqrt(2.0)) if len(changes) >= LEAST_ROWS else np.nan


def period_rows(measured: Values, dt: float) -> int:
    """Rows after which a motion repeats itself; 0 where it does not, or not twice."""
    lags = np.arange(round(PERIODS[0] / dt), min(round(PERIODS[1] / dt), len(measured) // 2))
    alike = [np.corrcoef(measured[n:], measured[:-n])[0, 1] for n in lags]
    peaks = [
        int(lag) for lag, before, here, after in
        zip(lags[1:-1], alike, alike[1:], alike[2:], strict=False)
        if here >= ALIKE and before <= here >= after
    ]  # fmt: skip
    return peaks[0] if peaks else 0


def repeated(recordings: list[Recording], joint: str) -> float:
    """Deviation of the errors of equal motions, a period apart; NaN where none repeats itself."""
    found = []
    for one in recordings:
        measured, error = one.column(f"measured/{joint}"), one.error([joint])[:, 0]
        n = period_rows(measured, one.duration / (len(one) - 1))
        if n:
            found.append(error[2 * n :] - error[n:-n])  # the first period starts from rest
    changes = np.concatenate(found) if found else np.empty(0)
    return float(np.nanstd(changes) / np.sqrt(2.0)) if len(changes) else np.nan


def main() -> None:
    """Print the table."""
    print("| recordings | joint | unit | step / √12 | at rest | a period later |")
    print("|---" * 6 + "|")
    for dataset, patterns in SETS.items():
        for pattern in patterns:
            recordings = read(dataset, pattern, RATE)
            for joint in recordings[0].joints_of("truth"):
                unit = display_unit(recordings[0].units[f"truth/{joint}"])
                values = (
                    step(recordings, joint) / np.sqrt(12.0),
                    at_rest(recordings, joint),
                    repeated(recordings, joint),
                )
                cells = ["-" if np.isnan(v) else f"{v * unit.scale:.2g}" for v in values]
                print(
                    f"| {dataset}, `{pattern}` | {joint} | {unit.name} | {' | '.join(cells)} |",
                    flush=True,
                )


if __name__ == "__main__":
    main()
