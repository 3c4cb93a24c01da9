"""Runs of a virtual forceps: calibration and verification as in yan2020, and an unloaded pair."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from truejoint.motion.forceps_references import calibration_reference, verification_reference
from truejoint.recordings import Recording
from truejoint.recordings.forceps import record_forceps
from truejoint.simulation.forceps_specimens import specimen
from truejoint.simulation.forceps_twin import ForcepsRun, simulate_forceps

SETTLED = 2.2  # [s] that the swelling of the motion is left out


@dataclass(frozen=True)
class Pair:
    """Run on (27) and on (28)."""

    calibration: ForcepsRun
    verification: ForcepsRun

    def recordings(self) -> tuple[Recording, Recording]:
        return record_forceps(self.calibration), record_forceps(self.verification)


def columns(run: ForcepsRun, names: tuple[str, ...]) -> np.ndarray:
    signals = {"motor/jaw": run.motor, "cable/drive": run.drive, "cable/reset": run.reset}
    return np.column_stack([signals[name] for name in names])


def target(run: ForcepsRun) -> np.ndarray:
    """EffortBaseline encoder, unknown while the motion swells."""
    return np.where(run.t > SETTLED, run.reference, np.nan)


def steps(run: ForcepsRun) -> np.ndarray:
    return np.diff(run.t, prepend=run.t[0])


def rms_deg(estimate: np.ndarray, run: ForcepsRun) -> float:
    error = (estimate - run.reference)[run.t > SETTLED]
    return float(np.degrees(np.sqrt(np.mean(error**2))))


@pytest.fixture(scope="session")
def pair() -> Pair:
    parameters = specimen("B")
    return Pair(
        simulate_forceps(parameters, calibration_reference().positions[:, 0], seed=0),
        simulate_forceps(parameters, verification_reference().positions[:, 0], seed=1),
    )
