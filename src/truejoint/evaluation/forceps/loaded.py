"""Table 3 of yan2020: weights hung on the jaw's tip, along the motion and against it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from truejoint.evaluation.forceps import paper
from truejoint.evaluation.forceps.errors import JawError, phase_rows
from truejoint.evaluation.forceps.methods import METHODS, fit_methods
from truejoint.evaluation.forceps.tables import TextTable, degrees_text, reported_text
from truejoint.evaluation.forceps.unloaded import calibration_run
from truejoint.robots.forceps_mechanism import LOAD_MASSES
from truejoint.simulation.forceps.load import LoadTest
from truejoint.simulation.forceps.parameters import ForcepsParameters
from truejoint.simulation.forceps.twin import ForcepsRun, simulate_load_test

Array = NDArray[np.float64]
Direction = Literal["opposing", "along"]

DIRECTIONS: Final[tuple[Direction, ...]] = ("opposing", "along")
TABLE_3_METHODS: Final = ("ukf_compensated", "play_reset", "play_gated", "ukf_friction")
_JUDGED: Final = ("I", "II", "IV")


@dataclass(frozen=True, eq=False)
class LoadCase:
    """One weight, hung one way.

    Attributes
    ----------
    mass : float
        [kg]
    direction : {"opposing", "along"}
        Against or along the motion before it.
    jaw_motion : float
        How far the weight turned the jaw, phase II to IV [rad].
    errors : dict of str to dict of str to JawError
        By method, then by phase I, II, IV.
    run : ForcepsRun
    estimates : dict of str to ndarray
        Jaw angle (n,) [rad] by method.
    """

    mass: float
    direction: Direction
    jaw_motion: float
    errors: dict[str, dict[str, JawError]]
    run: ForcepsRun = field(repr=False)
    estimates: dict[str, Array] = field(repr=False)

    def to_dict(self) -> dict[str, Any]:
        """Plain values, in grams and degrees where the name says so."""
        return {
            "mass_g": 1e3 * self.mass,
            "direction": self.direction,
            "jaw_motion_deg": float(np.degrees(self.jaw_motion)),
            "errors": {
                method: {phase: error.to_dict() for phase, error in phases.items()}
                for method, phases in self.errors.items()
            },
        }


@dataclass(frozen=True, eq=False)
class Loaded:
    """What the methods make of one specimen under loads: Table 3 of yan2020."""

    specimen: str
    seed: int
    cases: tuple[LoadCase, ...]

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "specimen": self.specimen,
            "seed": self.seed,
            "cases": [case.to_dict() for case in self.cases],
        }

    def worst(self, method: str, phase: str, direction: Direction | None = None) -> float:
        """Largest RMS error [rad] of a method in a phase over the weights."""
        return max(
            case.errors[method][phase].rms
            for case in self.cases
            if direction in (None, case.direction)
        )

    def table(self) -> TextTable:
        """Table 3, beside the paper's."""
        methods = list(self.cases[0].errors)
        rows = [self._row(case, methods) for case in self.cases]
        header = ("load", "jaw turns", "paper", *(METHODS[method].title for method in methods))
        notes = (
            "RMS error in degrees against the reference encoder in phases I, moving / II, still / "
            "IV, loaded. The paper's numbers are of its filter; which way it loaded it does not "
            "say.",
        )
        return TextTable(f"yan2020 Table 3, specimen {self.specimen}", header, tuple(rows), notes)

    def _row(self, case: LoadCase, methods: Sequence[str]) -> tuple[str, ...]:
        reported = paper.TABLE_3.get(case.mass, {})
        none = paper.Reported(np.nan)
        return (
            f"{1e3 * case.mass:.0f} g {case.direction}",
            degrees_text(case.jaw_motion, 2),
            _phases(reported_text(reported.get(phase, none).rms) for phase in _JUDGED),
            *(
                _phases(degrees_text(case.errors[method][phase].rms) for phase in _JUDGED)
                for method in methods
            ),
        )


def compare_loaded(
    parameters: ForcepsParameters,
    *,
    specimen: str = "",
    masses: Sequence[float] = LOAD_MASSES,
    directions: Sequence[Direction] = DIRECTIONS,
    methods: Sequence[str] = TABLE_3_METHODS,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Loaded:
    """Calibrate methods unloaded on (27), then hang weights on the jaw: Table 3 of yan2020.

    Parameters
    ----------
    parameters : ForcepsParameters
    specimen : str
        What it is called.
    masses : sequence of float
        Weights [kg].
    directions : sequence of {"opposing", "along"}
        Against or along the motion before the load.
    methods : sequence of str
        Keys of `METHODS`.
    seed : int
        Of the sensors' noise and the hand's wobble.
    progress : callable, optional
        Called with the fraction done, 0 to 1.
    """
    fitted = fit_methods(calibration_run(parameters, seed=2 * seed), methods)
    cases: list[LoadCase] = []
    for direction in directions:
        for mass in masses:
            test = LoadTest(mass, direction)
            run = simulate_load_test(parameters, test, seed=100 * seed + len(cases) + 1)
            estimates = {key: method.estimate(run) for key, method in fitted.items()}
            cases.append(_case(run, test, estimates))
            if progress is not None:
                progress(len(cases) / (len(directions) * len(masses)))
    return Loaded(specimen, seed, tuple(cases))


def _phases(texts: Iterable[str]) -> str:
    return "/".join(texts)


def _case(run: ForcepsRun, test: LoadTest, estimates: dict[str, Array]) -> LoadCase:
    rows = {phase: phase_rows(run, *test.phases[phase]) for phase in _JUDGED}
    return LoadCase(
        mass=test.mass,
        direction=test.direction,
        jaw_motion=float(run.jaw[rows["IV"]].mean() - run.jaw[rows["II"]].mean()),
        errors={
            key: {phase: JawError.of(estimate, run, rows[phase]) for phase in _JUDGED}
            for key, estimate in estimates.items()
        },
        run=run,
        estimates=estimates,
    )
