"""The estimators that the studies of the forceps compare, calibrated and judged as any other."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final, cast

import numpy as np
from pandas import DataFrame

from truejoint.array_types import Array, Mask
from truejoint.calibration import Calibration, calibrate
from truejoint.errors import StudyError
from truejoint.estimators.jaw.signals import DRIVE, RESET
from truejoint.recordings import Recording
from truejoint.simulation.forceps.parameters import ForcepsParameters
from truejoint.studies.forceps.motions import changed, record, tensioned
from truejoint.studies.study import Rows, Settings
from truejoint.toml_file import shipped_table

SETTLED: Final = 2.2
"""Time from which errors count [s]: the motion swells for the first 2 s."""


@dataclass(frozen=True)
class Method:
    """One row of the tables: an estimator, columns that it takes, and its colour in figures."""

    title: str
    inputs: tuple[str, ...]
    colour: str = "0.7"
    estimator: str = ""  # where that is not the method's key

    @property
    def sensors(self) -> tuple[str, ...]:
        """Where sensors must sit: one on a cable is strategy 2 of yan2020, II-B, both are 3."""
        cables = ((DRIVE, "x1"), (RESET, "x2"))
        return ("motor", *(x for name, x in cables if name in self.inputs))


_ROWS: Final = shipped_table(__package__, "methods.toml")
METHODS: Final = {key: Method(**row) for key, row in _ROWS.items()}
"""By the key that stands in options and numbers, in the order of the tables."""
TITLES: Final = {key: method.title for key, method in METHODS.items()}
COLOURS: Final = {method.title: method.colour for method in METHODS.values()}
"""By the title of a method."""

BEST: Final = "play_gated"
"""What to calibrate a forceps with: of ours that stay right under a load, the most exact."""
PAPERS_BEST: Final = "ukf_compensated"
PAPERS: Final = ("lsm", "lsm_compensated", PAPERS_BEST)
"""The methods of the paper, worst first as it finds them."""


def common_arguments(settings: Settings) -> dict[str, Any]:
    """Specimen, methods and seed, which most parts take."""
    settings.check_names("method", "methods", METHODS)
    plant = ForcepsParameters.read(settings["specimen"])
    forceps = tensioned(plant, cast("float", settings.options.get("tension", 1.0))).to_dict()
    return {"forceps": forceps, "methods": settings["methods"], "seed": settings.seed}


def settled(recording: Recording) -> Recording:
    """Take the truth before `SETTLED` away, so that those rows neither teach nor count."""
    truth = np.where(recording.t > SETTLED, recording.column("truth/jaw"), np.nan)
    return changed(recording, "truth/jaw", truth)


@lru_cache(maxsize=4)
def calibrated(
    forceps: ForcepsParameters, methods: tuple[str, ...], seed: int, motion: str = "calibration"
) -> dict[str, Calibration]:
    """Calibrations of a specimen on a motion, (27), by method; parts of one process share them.

    Methods whose sensor is not installed are left out; raises StudyError when none is left.
    """
    recording = settled(record(forceps, motion, seed=2 * seed))
    models = {
        key: calibrate(
            recording,
            METHODS[key].estimator or key,
            features=METHODS[key].inputs,
            target="error" if key == "rigid" else "position",
        )
        for key in methods
        if set(METHODS[key].inputs) <= set(recording.units)
    }
    if not models:
        raise StudyError(f"no sensors for {', '.join(methods)}; install one, or choose others")
    return models


def rms(errors: Any) -> float:
    """Root mean square of errors (n,)."""
    return float(np.sqrt(np.mean(np.square(errors))))


def within(t: Array, first: float, last: float) -> Mask:
    """Rows (n,) from `first` to `last` [s]."""
    return np.asarray((t >= first) & (t <= last))


def judge(models: Mapping[str, Calibration], recording: Recording) -> dict[str, Array]:
    """Estimate the jaw's angle (n,) [rad] by each method, on a recording that none of them saw.

    In the rows that have a truth; beside are their ``t`` [s], that ``truth``, which the reference
    encoder reads, as in the paper, and the jaw itself, ``exact``.
    """
    truth = recording.column("truth/jaw")
    columns = {"t": recording.t, "truth": truth, "exact": recording.column("truth_exact/jaw")}
    columns |= {key: model.correct(recording)[:, 0] for key, model in models.items()}
    return {name: values[np.isfinite(truth)] for name, values in columns.items()}


def errors(
    judged: Mapping[str, Array], first: float = -np.inf, last: float = np.inf, **labels: Any
) -> Rows:
    """Estimate minus truth from `first` to `last` [s], a row a method, with the `labels`.

    ``rms``, ``largest`` and ``smallest`` are against the reference encoder; ``exact_rms`` is
    against the jaw itself, so it holds the encoder's own error [rad]; ``deviation`` is the error's
    standard deviation [rad].
    """
    chosen, rows = within(judged["t"], first, last), Rows()
    for key in filter(METHODS.__contains__, judged):
        error, exact = ((judged[key] - judged[name])[chosen] for name in ("truth", "exact"))
        sizes = {"rms": rms(error), "largest": float(error.max())}
        sizes |= {"smallest": float(error.min()), "exact_rms": rms(exact)}
        sizes["deviation"] = float(error.std())
        rows.append({**labels, "method": key, **sizes})
    return rows


def note_left_out(settings: Settings, rows: DataFrame) -> tuple[str, ...]:
    """Note on the methods that were asked for and have no rows, if there are any."""
    names = [TITLES[key] for key in settings["methods"] if key not in set(rows.method)]
    return (f"Left out, since a sensor is not installed: {', '.join(names)}.",) if names else ()
