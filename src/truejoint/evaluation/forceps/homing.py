"""What a homing that sets the reset encoder's zero wrong costs, and what re-zeroing mends."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from truejoint.estimators.jaw_load import JawLoad
from truejoint.estimators.jaw_zero import find_zero
from truejoint.evaluation.digits import fixed
from truejoint.evaluation.forceps.errors import JawError
from truejoint.evaluation.forceps.methods import METHODS, SETTLED, columns, fit_methods
from truejoint.evaluation.forceps.tables import TextTable, degrees_text
from truejoint.evaluation.forceps.unloaded import (
    calibration_run,
    settled_error,
    verification_run,
)
from truejoint.motion.forceps_references import CALIBRATION_TONES, RAMP, sine_reference
from truejoint.simulation.forceps_parameters import ForcepsParameters
from truejoint.simulation.forceps_sensors import ZeroShift
from truejoint.simulation.forceps_twin import simulate_forceps

SHIFTS: Final = (0.0, 2e-6, 5e-6, 10e-6, 20e-6)
REZEROED_METHODS: Final = ("ukf_compensated", "play_reset", "play_gated", "ukf_friction")
CYCLE: Final = 2.0 * math.pi / CALIBRATION_TONES[0][1]
"""One period of (27) [s]: the motion from which the zero is found."""


@dataclass(frozen=True)
class HomingCase:
    """One wrong zero.

    Attributes
    ----------
    shift, found : float
        By how much ``x2`` reads too much, truly and as found [m].
    before, after : dict of str to JawError
        On (28) by method, without and with the found zero.
    """

    shift: float
    found: float
    before: dict[str, JawError]
    after: dict[str, JawError]


@dataclass(frozen=True)
class Homing:
    """Wrong zeros on one specimen."""

    specimen: str
    cases: tuple[HomingCase, ...]

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "specimen": self.specimen,
            "cases": [
                {
                    "shift_um": 1e6 * case.shift,
                    "found_um": 1e6 * case.found,
                    "before": {key: error.to_dict() for key, error in case.before.items()},
                    "after": {key: error.to_dict() for key, error in case.after.items()},
                }
                for case in self.cases
            ],
        }

    def table(self) -> TextTable:
        """RMS error of each method before and after re-zeroing."""
        methods = list(self.cases[0].before)
        rows = [
            (
                f"{1e6 * case.shift:.0f} um",
                f"{fixed(1e6 * case.found, 1)} um",
                *(
                    f"{degrees_text(case.before[m].rms)} -> {degrees_text(case.after[m].rms)}"
                    for m in methods
                ),
            )
            for case in self.cases
        ]
        header = ("zero off by", "found", *(METHODS[m].title for m in methods))
        notes = (
            "RMS error in degrees on (28), before -> after re-zeroing from one unloaded cycle of "
            "(27) with no sensor at the jaw.",
        )
        title = f"Re-zeroing after homing, specimen {self.specimen}"
        return TextTable(title, header, tuple(rows), notes)


def compare_homing(
    parameters: ForcepsParameters,
    *,
    specimen: str = "",
    shifts: Sequence[float] = SHIFTS,
    methods: Sequence[str] = REZEROED_METHODS,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Homing:
    """Calibrate, home with a wrong zero of the reset encoder, find it, and judge on (28).

    Parameters
    ----------
    parameters : ForcepsParameters
    specimen : str
        What it is called.
    shifts : sequence of float
        Wrong zeros [m].
    methods : sequence of str
        Keys of `METHODS`.
    seed : int
        Of the sensors' noise.
    progress : callable, optional
        Called with the fraction done, 0 to 1.
    """
    calibration = calibration_run(parameters, seed=2 * seed)
    fitted = fit_methods(calibration, methods)
    load = JawLoad(mechanism=parameters.mechanism).fit(
        columns(calibration, JawLoad.inputs),
        np.where(calibration.t > SETTLED, calibration.effort_baseline, np.nan),
    )
    cases = []
    for shift in shifts:
        zero = ZeroShift(reset=shift)
        cycle = sine_reference(CALIBRATION_TONES, CYCLE, name="one cycle of (27)")
        short = simulate_forceps(
            parameters, cycle.positions[:, 0], seed=2 * seed + 50, zero_shift=zero
        )
        found = find_zero(load, columns(short, JawLoad.inputs)[short.t >= RAMP])
        run = verification_run(parameters, seed=2 * seed + 1, zero_shift=zero)
        before, after = {}, {}
        for key, method in fitted.items():
            before[key] = settled_error(method.estimate(run), run)
            after[key] = settled_error(method.estimate(run, found.shift), run)
        cases.append(HomingCase(shift, found.shift, before, after))
        if progress is not None:
            progress(len(cases) / len(shifts))
    return Homing(specimen, tuple(cases))
