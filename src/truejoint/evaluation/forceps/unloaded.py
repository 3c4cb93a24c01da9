"""Figure 6 and Table 2 of yan2020: calibrate on (27), verify on (28)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from truejoint.evaluation.forceps import paper
from truejoint.evaluation.forceps.errors import JawError
from truejoint.evaluation.forceps.methods import METHODS, SETTLED, fit_methods
from truejoint.evaluation.forceps.tables import TextTable, degrees_text, reported_text
from truejoint.motion.forceps_references import calibration_reference, verification_reference
from truejoint.simulation.forceps.parameters import ForcepsParameters
from truejoint.simulation.forceps.sensors import ZeroShift
from truejoint.simulation.forceps.twin import ForcepsRun, simulate_forceps

Array = NDArray[np.float64]

TABLE_2_METHODS: Final = (
    "rigid", "lsm", "lsm_intercept", "lsm_compensated", "poly2", "ukf", "ukf_compensated",
    "play_reset", "play_both", "play_gated", "ukf_friction", "ukf_friction_smoothed",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Unloaded:
    """What the methods make of one specimen without a load.

    Attributes
    ----------
    specimen : str
    seed : int
    calibration_errors, verification_errors : dict of str to JawError
        On (27), which the methods were fitted to, and on (28), by method.
    calibration, verification : ForcepsRun
    estimates : dict of str to (ndarray, ndarray)
        Jaw angle [rad] in every row of both runs, by method.
    """

    specimen: str
    seed: int
    calibration_errors: dict[str, JawError]
    verification_errors: dict[str, JawError]
    calibration: ForcepsRun = field(repr=False)
    verification: ForcepsRun = field(repr=False)
    estimates: dict[str, tuple[Array, Array]] = field(repr=False)

    def to_dict(self) -> dict[str, Any]:
        """Plain values, in degrees where the name says so."""
        return {
            "specimen": self.specimen,
            "seed": self.seed,
            "calibration": {k: e.to_dict() for k, e in self.calibration_errors.items()},
            "verification": {k: e.to_dict() for k, e in self.verification_errors.items()},
            "paper": {k: vars(r) for k, r in paper.TABLE_2.items()},
        }

    def table(self) -> TextTable:
        """Table 2, beside the paper's."""
        rows = []
        for key, error in self.verification_errors.items():
            reported = paper.TABLE_2.get(key, paper.Reported(np.nan))
            calibration = self.calibration_errors[key]
            fit_reported = paper.FIGURE_6B.get(key, paper.Reported(np.nan))
            rows.append(
                (
                    METHODS[key].title,
                    degrees_text(error.rms),
                    reported_text(reported.rms),
                    degrees_text(error.largest, 2),
                    reported_text(reported.largest),
                    degrees_text(error.smallest, 2),
                    reported_text(reported.smallest),
                    degrees_text(calibration.rms),
                    reported_text(fit_reported.rms),
                    degrees_text(error.exact_rms),
                )
            )
        header = (
            "method", "RMS", "paper", "max", "paper", "min", "paper", "RMS on (27)", "paper",
            "RMS to the jaw",
        )  # fmt: skip
        notes = (
            "Degrees, on trajectory (28) against the reference encoder at the jaw, from 2.2 s on; "
            "fitted on (27).",
            "The last column is against the jaw itself: it holds the encoder's own error, which "
            "every calibrated method learns.",
        )
        title = f"yan2020 Table 2 and figure 6, specimen {self.specimen}"
        return TextTable(title, header, tuple(rows), notes)


def calibration_run(
    parameters: ForcepsParameters,
    *,
    seed: int = 0,
    log_rate: float = 200.0,
    zero_shift: ZeroShift | None = None,
) -> ForcepsRun:
    """Run (27) on a specimen."""
    reference = calibration_reference().positions[:, 0]
    return simulate_forceps(
        parameters, reference, seed=seed, log_rate=log_rate, zero_shift=zero_shift or ZeroShift()
    )


def verification_run(
    parameters: ForcepsParameters,
    *,
    seed: int = 0,
    log_rate: float = 200.0,
    zero_shift: ZeroShift | None = None,
) -> ForcepsRun:
    """Run (28) on a specimen."""
    reference = verification_reference().positions[:, 0]
    return simulate_forceps(
        parameters, reference, seed=seed, log_rate=log_rate, zero_shift=zero_shift or ZeroShift()
    )


def compare_unloaded(
    parameters: ForcepsParameters,
    *,
    specimen: str = "",
    methods: Sequence[str] = TABLE_2_METHODS,
    seed: int = 0,
) -> Unloaded:
    """Calibrate methods on (27) and judge them on (28): figure 6 and Table 2 of yan2020.

    Parameters
    ----------
    parameters : ForcepsParameters
    specimen : str
        What it is called.
    methods : sequence of str
        Keys of `METHODS`.
    seed : int
        Of the sensors' noise; the two runs have noise of their own.

    Returns
    -------
    Unloaded
    """
    calibration = calibration_run(parameters, seed=2 * seed)
    verification = verification_run(parameters, seed=2 * seed + 1)
    fitted = fit_methods(calibration, methods)
    estimates = {
        key: (method.estimate(calibration), method.estimate(verification))
        for key, method in fitted.items()
    }
    return Unloaded(
        specimen,
        seed,
        {key: settled_error(e[0], calibration) for key, e in estimates.items()},
        {key: settled_error(e[1], verification) for key, e in estimates.items()},
        calibration,
        verification,
        estimates,
    )


def settled_error(estimate: Array, run: ForcepsRun) -> JawError:
    """Error of an estimate (n,) [rad] once the motion has swollen."""
    return JawError.of(estimate, run, np.asarray(run.t > SETTLED))
