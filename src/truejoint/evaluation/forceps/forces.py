"""The external load that the estimators see, its dead band, and what one known weight mends."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from truejoint.estimators.friction_filter import FrictionFilter
from truejoint.estimators.jaw_load import JawLoad, Stiffness, identify_stiffness
from truejoint.evaluation.digits import fixed
from truejoint.evaluation.forceps.errors import phase_rows
from truejoint.evaluation.forceps.loaded import DIRECTIONS, Direction
from truejoint.evaluation.forceps.methods import SETTLED, columns
from truejoint.evaluation.forceps.tables import TextTable
from truejoint.evaluation.forceps.unloaded import calibration_run
from truejoint.robots.forceps_mechanism import LOAD_MASSES
from truejoint.simulation.forceps_load import GRAVITY, LoadTest
from truejoint.simulation.forceps_parameters import ForcepsParameters
from truejoint.simulation.forceps_twin import ForcepsRun, simulate_load_test

Array = NDArray[np.float64]

CALIBRATION_WEIGHT: Final = 0.2
"""Known weight that identifies the stiffness, hung along the motion [kg]."""


@dataclass(frozen=True)
class LoadEstimate:
    """One weight, hung one way: torques [Nm] while it hangs still.

    Attributes
    ----------
    mass : float
        [kg]
    direction : {"opposing", "along"}
    torque : float
        True.
    assumed, identified : float
        Estimates with the stiffness assumed and with that found by the known weight.
    filtered : float
        Estimate of the filter that carries the load in its state, with the stiffness found.
    """

    mass: float
    direction: Direction
    torque: float
    assumed: float
    identified: float
    filtered: float


@dataclass(frozen=True, eq=False)
class Forces:
    """External loads on one specimen.

    Attributes
    ----------
    specimen : str
    arm : float
        Lever of the weights [m].
    stiffness : Stiffness
        Found with `CALIBRATION_WEIGHT`.
    dead_band : float
        Torque that may hang against the last motion without showing [Nm].
    estimates : tuple of LoadEstimate
    """

    specimen: str
    arm: float
    stiffness: Stiffness
    dead_band: float
    estimates: tuple[LoadEstimate, ...]

    def to_dict(self) -> dict[str, Any]:
        """Plain values, SI but where the name says so."""
        return {
            "specimen": self.specimen,
            "arm_mm": 1e3 * self.arm,
            "stiffness": vars(self.stiffness),
            "dead_band_mNm": 1e3 * self.dead_band,
            "dead_band_g": self._grams(self.dead_band),
            "estimates": [vars(estimate) for estimate in self.estimates],
        }

    def table(self) -> TextTable:
        """List loads as they are and as they are estimated, in mNm and grams."""
        rows = [
            (
                f"{1e3 * e.mass:.0f} g {e.direction}",
                *(
                    f"{fixed(1e3 * torque, 1)} ({fixed(self._grams(torque), 0)})"
                    for torque in (e.torque, e.assumed, e.identified, e.filtered)
                ),
            )
            for e in self.estimates
        ]
        header = ("load", "true", "K_d assumed", "K_d identified", "filter, K_d identified")
        found = self.stiffness
        notes = (
            f"Torque in mNm (grams at {1e3 * self.arm:.1f} mm). Identified with "
            f"{1e3 * CALIBRATION_WEIGHT:.0f} g along the motion: K_d = "
            f"{found.drive_stiffness / 1e3:.1f} +- {found.deviation / 1e3:.1f} kN/m, "
            f"{found.ratio:.2f} of the assumed.",
            f"Dead band: up to {1e3 * self.dead_band:.1f} mNm ({self._grams(self.dead_band):.0f} "
            "g) against the last motion may not show, since the jaw's friction holds them.",
        )
        return TextTable(f"External load, specimen {self.specimen}", header, tuple(rows), notes)

    def _grams(self, torque: float) -> float:
        return 1e3 * torque / (GRAVITY * self.arm)


def compare_forces(
    parameters: ForcepsParameters,
    *,
    specimen: str = "",
    masses: Sequence[float] = LOAD_MASSES,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Forces:
    """Estimate hung weights, before and after the stiffness is found with one known weight.

    Parameters
    ----------
    parameters : ForcepsParameters
    specimen : str
        What it is called.
    masses : sequence of float
        Weights [kg], hung against the motion and along it.
    seed : int
        Of the sensors' noise and the hand's wobble.
    progress : callable, optional
        Called with the fraction done, 0 to 1.

    Raises
    ------
    CalibrationError
        If the known weight does not show above the jaw's friction.
    """
    calibration = calibration_run(parameters, seed=2 * seed)
    target = np.where(calibration.t > SETTLED, calibration.effort_baseline, np.nan)
    X, steps = columns(calibration, JawLoad.inputs), _steps(calibration)
    assumed = JawLoad(mechanism=parameters.mechanism).fit(X, target, steps)
    stiffness = _identified(parameters, assumed, seed)
    identified = assumed.with_stiffness(stiffness.drive_stiffness)
    carried = FrictionFilter(drive_stiffness=stiffness.drive_stiffness).fit(X, target, steps=steps)
    estimates: list[LoadEstimate] = []
    for direction in DIRECTIONS:
        for mass in masses:
            test = LoadTest(mass, direction)
            run = simulate_load_test(parameters, test, seed=100 * seed + len(estimates) + 1)
            still = phase_rows(run, *test.phases["IV"])
            X, steps = columns(run, JawLoad.inputs), _steps(run)
            estimates.append(
                LoadEstimate(
                    mass,
                    direction,
                    torque=float(run.external_torque[still].mean()),
                    assumed=float(assumed.predict(X, steps)[still].mean()),
                    identified=float(identified.predict(X, steps)[still].mean()),
                    filtered=float(carried.states(X, steps).load[still].mean()),
                )
            )
            if progress is not None:
                progress(len(estimates) / (len(DIRECTIONS) * len(masses)))
    return Forces(
        specimen, parameters.jaw.load_arm, stiffness, identified.dead_band, tuple(estimates)
    )


def _identified(parameters: ForcepsParameters, load: JawLoad, seed: int) -> Stiffness:
    test = LoadTest(CALIBRATION_WEIGHT, "along")
    run = simulate_load_test(parameters, test, seed=100 * seed + 99)
    after = phase_rows(run, *test.phases["IV"])
    torque = float(run.external_torque[after].mean())
    before = phase_rows(run, *test.phases["II"])
    return identify_stiffness(
        load, columns(run, JawLoad.inputs), before, after, torque, _steps(run)
    )


def _steps(run: ForcepsRun) -> Array:
    return np.diff(run.t, prepend=run.t[0])
