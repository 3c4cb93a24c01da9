"""Runs of a virtual forceps: calibration and verification as in yan2020, and an unloaded pair."""

from functools import cache
from typing import NamedTuple, TypeVar

import numpy as np
import pytest
from tests.runtime.registered import forceps

from truejoint.estimators.jaw.learn import JawEstimator
from truejoint.recordings import Recording
from truejoint.simulation.forceps.load import LoadTest
from truejoint.simulation.forceps.specimens import specimen
from truejoint.studies.forceps.methods import record_forceps

Model = TypeVar("Model", bound=JawEstimator)

SETTLED = 2.2  # [s] that the swelling of the motion is left out


class Pair(NamedTuple):
    """Run on (27) and on (28)."""

    calibration: Recording
    verification: Recording


def columns(run: Recording, model: JawEstimator) -> np.ndarray:
    """Rows of what an estimator takes."""
    names = model.family.inputs(model.model_params())
    return np.column_stack([run.column(name) for name in names])


def target(run: Recording) -> np.ndarray:
    """Reference encoder, unknown while the motion swells."""
    return np.where(run.t > SETTLED, run.column("truth/jaw"), np.nan)


def steps(run: Recording) -> np.ndarray:
    return np.diff(run.t, prepend=run.t[0])


def rms_deg(estimate: np.ndarray, run: Recording) -> float:
    error = (estimate - run.column("truth/jaw"))[run.t > SETTLED]
    return float(np.degrees(np.sqrt(np.mean(error**2))))


def fitted(pair: Pair, model: Model) -> Model:
    """Fit to the calibration motion."""
    run = pair.calibration
    return model.fit(columns(run, model), target(run), dt=steps(run))


@pytest.fixture(scope="session")
def pair() -> Pair:
    return Pair(*forceps())


@cache
def loaded_run(test: LoadTest) -> Recording:
    """Run of the same specimen under a weight."""
    return record_forceps(specimen("B"), test, seed=3)
