"""Specimens, and recordings of them on the motions of yan2020."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, Literal, cast

import numpy as np

from truejoint.errors import TruejointError
from truejoint.motion.forceps_references import (
    CALIBRATION_TONES,
    calibration_reference,
    sine_reference,
    verification_reference,
)
from truejoint.recordings import Recording
from truejoint.recordings.forceps import record_forceps
from truejoint.simulation.forceps_load import LoadTest
from truejoint.simulation.forceps_parameters import ForcepsParameters
from truejoint.simulation.forceps_sensors import ZeroShift
from truejoint.simulation.forceps_specimens import SPECIMENS, specimen
from truejoint.simulation.forceps_twin import simulate_forceps, simulate_load_test

Direction = Literal["opposing", "along"]
Plain = Mapping[str, Mapping[str, Any]]

MOTIONS: Final = ("calibration", "verification", "cycle", "load")
_CYCLE: Final = 2.0 * math.pi / CALIBRATION_TONES[0][1]  # [s], one period of (27)


def plain_specimen(name: str) -> dict[str, dict[str, Any]]:
    """Plain values of a shipped specimen, or of a designer's TOML file, for `Part.arguments`."""
    if name in SPECIMENS or not name.endswith(".toml"):
        return specimen(name).to_dict()
    return ForcepsParameters.load(name).to_dict()


def title_of(name: str) -> str:
    """Name of a specimen, or of its file."""
    return Path(name).stem if name.endswith(".toml") else name


def built(forceps: Plain) -> ForcepsParameters:
    """Specimen of its plain values."""
    flat = {f"{section}.{key}": v for section, vs in forceps.items() for key, v in vs.items()}
    return ForcepsParameters.load().with_values(flat)


def record(
    forceps: ForcepsParameters,
    motion: str,
    *,
    specimen: str = "",
    load: float = 0.1,
    direction: str = "opposing",
    log_rate: float = 200.0,
    seed: int = 0,
    zero_shift: ZeroShift = ZeroShift(),  # noqa: B008  # frozen
) -> Recording:
    """Record a specimen on a motion of the paper.

    Parameters
    ----------
    forceps : ForcepsParameters
    motion : {"calibration", "verification", "cycle", "load"}
        (27), (28), one period of (27), or a load test (IV-D).
    specimen : str
        What it is called.
    load : float
        Weight of the load test [kg].
    direction : {"opposing", "along"}
        Of the load, against or along the motion before it.
    log_rate : float
        Rows per second [Hz].
    seed : int
        Of the sensors' noise and the hand's wobble.
    zero_shift : ZeroShift
        What homing got wrong.

    Raises
    ------
    TruejointError
        If the motion is unknown, or the plant refuses a value.
    """
    if motion not in MOTIONS:
        raise TruejointError(f"no motion {motion!r:.60}; choose one of {', '.join(MOTIONS)}")
    if motion == "load":
        test = LoadTest(load, cast("Direction", direction))
        run = simulate_load_test(forceps, test, seed=seed, log_rate=log_rate, zero_shift=zero_shift)
    else:
        trajectory = {
            "calibration": calibration_reference,
            "verification": verification_reference,
            "cycle": lambda: sine_reference(CALIBRATION_TONES, _CYCLE, name="one cycle of (27)"),
        }[motion]()
        run = simulate_forceps(
            forceps,
            trajectory.positions[:, 0],
            seed=seed,
            log_rate=log_rate,
            zero_shift=zero_shift,
        )
    return record_forceps(run, specimen=specimen, session=f"{motion} {seed}")


def changed(recording: Recording, name: str, values: Any) -> Recording:
    """Put another column `name` (n,) into a recording."""
    table = recording.table.assign(**{name: np.asarray(values, dtype=np.float64)})
    return Recording(table, recording.units, recording.provenance)
