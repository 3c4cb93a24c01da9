"""Recordings of the virtual forceps on the paper's motions."""

from __future__ import annotations

from truejoint.errors import TruejointError
from truejoint.evaluation.forceps.unloaded import calibration_run, verification_run
from truejoint.recordings import Recording
from truejoint.recordings.forceps import record_forceps
from truejoint.simulation.forceps.load import LoadTest
from truejoint.simulation.forceps.parameters import ForcepsParameters
from truejoint.simulation.forceps.twin import simulate_load_test

MOTIONS = ("calibration", "verification", "load")


def record_motion(
    parameters: ForcepsParameters,
    motion: str,
    *,
    specimen: str = "",
    load: float = 0.1,
    direction: str = "opposing",
    log_rate: float = 200.0,
    seed: int = 0,
) -> Recording:
    """Record a specimen on (27), (28) or a load test.

    Parameters
    ----------
    parameters : ForcepsParameters
    motion : {"calibration", "verification", "load"}
    specimen : str
        What it is called.
    load : float
        Weight of the load test [kg].
    direction : {"opposing", "along"}
        Of the load, against or along the motion before it.
    log_rate : float
        Rows per second [Hz].
    seed : int

    Raises
    ------
    TruejointError
        If the motion is unknown, or the plant refuses a value.
    """
    if motion == "calibration":
        run = calibration_run(parameters, seed=seed, log_rate=log_rate)
    elif motion == "verification":
        run = verification_run(parameters, seed=seed, log_rate=log_rate)
    elif motion == "load":
        test = LoadTest(load, direction)  # type: ignore[arg-type]  # checked there
        run = simulate_load_test(parameters, test, seed=seed, log_rate=log_rate)
    else:
        raise TruejointError(f"no motion {motion!r}; choose one of {', '.join(MOTIONS)}")
    return record_forceps(run, specimen=specimen, session=f"{motion} {seed}")
