"""The population study: every method on many virtual specimens, kept as it goes."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from truejoint.errors import TruejointError
from truejoint.evaluation.forceps.errors import JawError
from truejoint.evaluation.forceps.methods import BEST, METHODS, PAPERS_BEST, fit_methods
from truejoint.evaluation.forceps.tables import TextTable, degrees_text
from truejoint.evaluation.forceps.unloaded import (
    TABLE_2_METHODS,
    calibration_run,
    settled_error,
    verification_run,
)
from truejoint.simulation.forceps.parameters import ForcepsParameters
from truejoint.simulation.forceps.sensors import ZeroShift
from truejoint.simulation.forceps.specimens import population

Array = NDArray[np.float64]

MAX_FILE_BYTES: Final = 200_000_000
ORDERINGS: Final = (
    ("lsm", "lsm_compensated", "ukf_compensated"),
    ("lsm", "ukf_compensated"),
    ("lsm_intercept", "ukf_compensated"),
    ("poly2", "ukf_compensated"),
    ("ukf_compensated", "play_reset"),
    ("ukf_compensated", BEST),
)
"""Claims to count: each method's RMS error is larger than that of the next."""


@dataclass(frozen=True, eq=False)
class PopulationStudy:
    """Errors of every method on every specimen.

    Attributes
    ----------
    seed : int
        Of the population.
    homing_deviation : float
        Standard deviation of the cable encoders' zeros between the two runs [m].
    methods : tuple of str
    rms, exact_rms : ndarray, shape (n, n_methods)
        On (28) [rad], against the reference encoder and against the jaw.
    """

    seed: int
    homing_deviation: float
    methods: tuple[str, ...]
    rms: Array
    exact_rms: Array

    def of(self, method: str) -> Array:
        """RMS errors (n,) [rad] of a method."""
        return np.asarray(self.rms[:, self.methods.index(method)])

    def share(self, *methods: str) -> float:
        """Share of specimens in which each method's error is larger than the next one's."""
        errors = np.column_stack([self.of(method) for method in methods])
        return float(np.mean((np.diff(errors, axis=1) < 0.0).all(axis=1)))

    def median_ratio(self, worse: str, better: str) -> float:
        """Median over specimens of one method's error over another's."""
        return float(np.median(self.of(worse) / self.of(better)))

    def to_dict(self) -> dict[str, Any]:
        """Plain values [deg]."""
        return {
            "seed": self.seed,
            "specimens": len(self.rms),
            "homing_deviation_um": 1e6 * self.homing_deviation,
            "rms_deg": {m: np.degrees(self.of(m)).tolist() for m in self.methods},
            "exact_rms_deg": {
                m: np.degrees(self.exact_rms[:, i]).tolist() for i, m in enumerate(self.methods)
            },
            "orderings": {" > ".join(o): self.share(*o) for o in self._orderings()},
            "median_ratio_to_best": {m: self.median_ratio(m, BEST) for m in self.methods}
            if BEST in self.methods
            else {},
        }

    def table(self) -> TextTable:
        """Distribution of each method's RMS over the specimens, and how it stands to the UKF."""
        rows = []
        for method in self.methods:
            error = self.of(method)
            quantiles = [float(np.quantile(error, q)) for q in (0.05, 0.25, 0.5, 0.75, 0.95, 1.0)]
            rows.append(
                (
                    METHODS[method].title,
                    *(degrees_text(value) for value in quantiles),
                    *self._against(method),
                )
            )
        header = (
            "method", "5 %", "25 %", "median", "75 %", "95 %", "worst", "beats the UKF in",
            "median UKF / method",
        )  # fmt: skip
        notes = [
            f"RMS error in degrees on (28) against the reference encoder, {len(self.rms)} "
            f"specimens of seed {self.seed}, homing deviation {1e6 * self.homing_deviation:g} um.",
            *(
                f"{' > '.join(METHODS[m].title for m in ordering)}: "
                f"{100 * self.share(*ordering):.0f} % of specimens"
                for ordering in self._orderings()
            ),
        ]
        return TextTable("Population of virtual forceps", header, tuple(rows), tuple(notes))

    def _against(self, method: str) -> tuple[str, str]:
        if PAPERS_BEST not in self.methods or method == PAPERS_BEST:
            return "", ""
        share, ratio = self.share(PAPERS_BEST, method), self.median_ratio(PAPERS_BEST, method)
        return f"{100 * share:.0f} %", f"{ratio:.2f}"

    def _orderings(self) -> list[tuple[str, ...]]:
        return [o for o in ORDERINGS if set(o) <= set(self.methods)]


def study_population(
    count: int = 100,
    *,
    seed: int = 0,
    methods: Sequence[str] = TABLE_2_METHODS,
    homing_deviation: float = 0.0,
    keep: Path | None = None,
    progress: Callable[[float], None] | None = None,
) -> PopulationStudy:
    """Calibrate and verify every method on specimens drawn from the priors.

    Parameters
    ----------
    count : int
        Specimens.
    seed : int
        Of the population; a larger one begins with the smaller one.
    methods : sequence of str
        Keys of `METHODS`.
    homing_deviation : float
        Standard deviation of the cable encoders' zeros [m], drawn anew for the verification, as
        if the instrument had been homed in between.
    keep : Path, optional
        File of one line a specimen; what it holds of the same study is not done again.
    progress : callable, optional
        Called with the fraction done, 0 to 1.

    Raises
    ------
    TruejointError
        If `keep` holds another study, or is not such a file.
    """
    key = {"seed": seed, "methods": list(methods), "homing_deviation": homing_deviation}
    done = _read(keep, key) if keep is not None else {}
    specimens = population(count, seed)
    for number, parameters in enumerate(specimens):
        if number not in done:
            errors = _trial(parameters, methods, homing_deviation, number)
            done[number] = [(error.rms, error.exact_rms) for error in errors]
            if keep is not None:
                _append(keep, key, number, done[number])
        if progress is not None:
            progress((number + 1) / count)
    values = np.array([done[number] for number in range(count)], dtype=np.float64)
    return PopulationStudy(seed, homing_deviation, tuple(methods), values[..., 0], values[..., 1])


def _trial(
    parameters: ForcepsParameters, methods: Sequence[str], homing_deviation: float, number: int
) -> list[JawError]:
    calibration = calibration_run(parameters, seed=2 * number)
    zero = ZeroShift.drawn(homing_deviation, number) if homing_deviation > 0.0 else None
    verification = verification_run(parameters, seed=2 * number + 1, zero_shift=zero)
    fitted = fit_methods(calibration, methods)
    return [settled_error(fitted[m].estimate(verification), verification) for m in methods]


def _append(
    path: Path, key: dict[str, Any], number: int, values: list[tuple[float, float]]
) -> None:
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps({**key, "specimen": number, "rms": values}) + "\n")


def _read(path: Path, key: dict[str, Any]) -> dict[int, list[tuple[float, float]]]:
    """Trials that a file holds; a last line cut short by a crash is done again."""
    if not path.exists():
        return {}
    if path.stat().st_size > MAX_FILE_BYTES:
        raise TruejointError(f"{path}: larger than any population study; choose another file")
    done: dict[int, list[tuple[float, float]]] = {}
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    for i, line in enumerate(lines):
        try:
            entry = json.loads(line)
            values = [(float(a), float(b)) for a, b in entry["rms"]]
            number, own = int(entry["specimen"]), {name: entry[name] for name in key}
        except (ValueError, KeyError, TypeError):
            if i == len(lines) - 1:
                path.write_text("".join(f"{kept}\n" for kept in lines[:-1]), encoding="utf-8")
                break
            raise TruejointError(
                f"{path}: line {i + 1} is not a trial of a population study; choose another file"
            ) from None
        if own != key or len(values) != len(key["methods"]):
            raise TruejointError(
                f"{path}: line {i + 1} is of another study (seed, methods or homing deviation); "
                "choose another file"
            )
        done[number] = values
    return done
