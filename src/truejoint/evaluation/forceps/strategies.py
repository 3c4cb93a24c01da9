"""Which sensor to install where: strategies 1, 2 and 3 of yan2020, II-B."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

from truejoint.evaluation.forceps.errors import JawError
from truejoint.evaluation.forceps.loaded import Loaded, compare_loaded
from truejoint.evaluation.forceps.methods import METHODS
from truejoint.evaluation.forceps.tables import TextTable, degrees_text
from truejoint.evaluation.forceps.unloaded import compare_unloaded
from truejoint.simulation.forceps.parameters import ForcepsParameters

STRATEGY_METHODS: Final = (
    "rigid", "poly2_motor", "play_motor",
    "poly2", "ukf_compensated", "play_reset", "play_both", "play_gated",
    "ukf_friction",
    "lsm", "lsm_compensated", "play_cables",
)  # fmt: skip
STRATEGY_MASSES: Final = (0.05, 0.1, 0.2)
_SENSORS: Final = {1: "motor only", 2: "and x2", 3: "and x1, x2"}


@dataclass(frozen=True, eq=False)
class Strategies:
    """Accuracy that each choice of sensors buys on one specimen.

    Attributes
    ----------
    specimen : str
    unloaded : dict of str to JawError
        On (28), by method.
    loaded : Loaded
        Under weights, both directions.
    """

    specimen: str
    unloaded: dict[str, JawError]
    loaded: Loaded

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "specimen": self.specimen,
            "unloaded": {key: error.to_dict() for key, error in self.unloaded.items()},
            "loaded": self.loaded.to_dict(),
        }

    def table(self) -> TextTable:
        """Methods by strategy: RMS unloaded, and the worst loaded phase in both directions."""
        rows = [
            (
                METHODS[key].title,
                str(METHODS[key].strategy),
                _SENSORS[METHODS[key].strategy],
                degrees_text(error.rms),
                degrees_text(self.loaded.worst(key, "IV", "opposing")),
                degrees_text(self.loaded.worst(key, "IV", "along")),
            )
            for key, error in self.unloaded.items()
        ]
        header = (
            "method", "strategy", "sensors", "RMS unloaded", "worst IV opposing", "worst IV along",
        )  # fmt: skip
        masses = sorted({case.mass for case in self.loaded.cases})
        notes = (
            "RMS error in degrees against the reference encoder: unloaded on (28); IV is still "
            f"under a load of up to {1e3 * masses[-1]:.0f} g.",
        )
        title = f"Sensor strategies, specimen {self.specimen}"
        return TextTable(title, header, tuple(rows), notes)


def compare_strategies(
    parameters: ForcepsParameters,
    *,
    specimen: str = "",
    methods: Sequence[str] = STRATEGY_METHODS,
    masses: Sequence[float] = STRATEGY_MASSES,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Strategies:
    """Judge each choice of sensors without and with loads; parameters as `compare_loaded`."""
    unloaded = compare_unloaded(parameters, specimen=specimen, methods=methods, seed=seed)
    loaded = compare_loaded(
        parameters, specimen=specimen, masses=masses, methods=methods, seed=seed, progress=progress
    )
    return Strategies(specimen, unloaded.verification_errors, loaded)
