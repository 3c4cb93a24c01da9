"""A calibration by every registered estimator, and what a loop would feed it."""

from __future__ import annotations

from functools import cache

import numpy as np
from tests.estimators.elastic_joint.test_filter import recording as grasper_recording

from truejoint.estimators import Calibration, NeuralNetwork, calibrate
from truejoint.estimators.registry import JAW_ESTIMATORS, MOTOR_SIDE_ESTIMATORS
from truejoint.motion.forceps_references import calibration_reference, verification_reference
from truejoint.recordings import Recording
from truejoint.recordings.forceps import record_forceps
from truejoint.runtime import Corrector
from truejoint.simulation.forceps.specimens import specimen
from truejoint.simulation.forceps.twin import simulate_forceps

from . import streams


@cache
def forceps() -> tuple[Recording, Recording]:
    """Calibration and verification motion of a virtual forceps."""
    references = calibration_reference(), verification_reference()
    calibration, verification = (
        record_forceps(simulate_forceps(specimen("B"), r.positions[:, 0], seed=seed))
        for seed, r in enumerate(references)
    )
    return calibration, verification


@cache
def model(name: str) -> Calibration:
    """Calibration by the estimator called `name`, without an interval."""
    if name in JAW_ESTIMATORS:
        return calibrate(forceps()[0], name)
    if name in MOTOR_SIDE_ESTIMATORS:
        return calibrate([grasper_recording(seed) for seed in range(4)], name)
    if name == "dnn":
        return streams.trained(NeuralNetwork(hidden_layer_sizes=(9, 7), epochs=2))
    return streams.trained(name)


def unseen(name: str) -> Recording:
    """Recording that the estimator was not fitted to, of the sample interval of its training."""
    if name in JAW_ESTIMATORS:
        return forceps()[1].rows(np.arange(500, 3500))
    if name in MOTOR_SIDE_ESTIMATORS:
        return grasper_recording(50)
    return streams.recording(np.arange(0.0, 60.0, 1 / 30), seed=5)


def ready(calibration, **options) -> Corrector:
    """Corrector (also of a file) of a robot that is homed as in training."""
    corrector = Corrector(calibration, **options)
    corrector.set_homing(True)
    return corrector
