"""A calibration by every registered estimator, and what a loop would feed it."""

import fcntl
import os
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from tests.estimators.motor_side.test_motor_side import recording as grasper_recording

from truejoint.calibration import Calibration, calibrate, read_calibration, write_calibration
from truejoint.estimators import Plays, registry
from truejoint.estimators.cables import learn as cable_filter
from truejoint.estimators.network.learn import SequenceNetwork
from truejoint.estimators.registry import estimator_names
from truejoint.estimators.wrapped import get_estimator
from truejoint.motion.forceps_trajectories import calibration_trajectory, verification_trajectory
from truejoint.recordings import Recording
from truejoint.runtime import Status
from truejoint.simulation.forceps.specimens import specimen
from truejoint.simulation.wrist.twin import WristTwin
from truejoint.studies.forceps.methods import record_forceps
from truejoint.studies.wrist import accuracy as motions

from . import streams
from .streams import ready

FEW_PLAYS = Plays(plays=(0.01, 0.1), time_constants=(0.02,))


@cache
def forceps() -> tuple[Recording, Recording]:
    """Calibration and verification motion of a virtual forceps."""
    motions = calibration_trajectory(), verification_trajectory()
    calibration, verification = (
        record_forceps(specimen("B"), motion.positions[:, 0], seed=seed)
        for seed, motion in enumerate(motions)
    )
    return calibration, verification


@cache
def wrist() -> tuple[Recording, ...]:
    """Virtual wrist, free and under loads, and on another motion, at 100 Hz."""
    twin = WristTwin(seed=2)
    twin.home()
    runs = [motions.record(twin, motions.paused_sines, 16.0, 4, load) for load in (False, True)]
    runs.append(motions.record(twin, motions.steps, 16.0, 5, load=True))
    return tuple(run.rows(np.arange(0, len(run), 2)) for run in runs)


ALIKE = {"play_drive", "play_reset", "play_cables"}
"""Plays that are `play_motor` or `play_both` but for the sensors: long tests try these two."""


def in_loop() -> list[str]:
    """Names of the estimators that run in a loop."""
    return [name for name in estimator_names() if get_estimator(name).family.row is not None]


def inputs(name: str) -> tuple[str, ...]:
    """Features that the estimator insists on; empty where it takes any."""
    estimator = get_estimator(name)
    own = estimator.family.inputs
    return own(estimator.model_params()) if own else ()


def at_the_motor(name: str) -> bool:
    """Whether it insists on signals of a jaw's motor or cables."""
    return any(not feature.startswith(("measured/", "effort/")) for feature in inputs(name))


@cache
def training(name: str) -> tuple[Recording, ...]:
    """Recordings that the estimator called `name` can be fitted to."""
    if "motor/jaw1" in inputs(name):
        return wrist()[:2]
    if "driver/jaw" in inputs(name):
        return tuple(grasper_recording(seed, 12.0) for seed in range(4))
    return (forceps()[0],) if at_the_motor(name) else (streams.recording(streams.MINUTE),)


def fit(name: str, recordings: Sequence[Recording], **how: Any) -> Calibration:
    """Calibrate by the estimator called `name`, a small one where it has a size."""
    estimator = get_estimator(name)
    small = {
        "hidden_layer_sizes": (9, 7), "epochs": 2, "units": 5, "layers": 3, "random_state": 0
    }  # fmt: skip
    estimator.set_params(**{k: v for k, v in small.items() if k in estimator.get_params()})
    with (
        patch.dict(registry.BOOSTED, max_iter=5),
        patch.object(SequenceNetwork, "_train", drawn),
        patch.object(cable_filter, "_ROUNDS", 2),
        patch.object(cable_filter, "WRIST_PLAYS", FEW_PLAYS),
    ):
        if inputs(name):
            return calibrate(recordings, name, **how)
        return streams.trained(estimator, recordings=recordings, **how)


def drawn(network, arrays, _steps, _decay, _progress) -> None:
    """Stand for the training of a network that remembers, which needs torch: draw the arrays."""
    rng = np.random.RandomState(0)
    network._start(arrays, rng)
    arrays["output_weights"][:] = 0.1 * rng.normal(size=arrays["output_weights"].shape)


@cache
def model(name: str) -> Calibration:
    """Calibration by the estimator called `name`, without an interval.

    It is fitted once in a run of the tests, whichever of its processes asks first; the others read
    its file.
    """
    path = Path(os.environ["TRUEJOINT_TEST_MODELS"]) / f"{name}.safetensors"
    with path.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if path.exists():
            return read_calibration(path)
        calibration = fit(name, training(name))
        write_calibration(calibration, path)
    return calibration


@cache
def unseen(name: str) -> Recording:
    """Recording that the estimator was not fitted to, of the time step of its training."""
    if "motor/jaw1" in inputs(name):
        return wrist()[2]
    if "driver/jaw" in inputs(name):
        return grasper_recording(50)
    if at_the_motor(name):
        return forceps()[1].rows(np.arange(500, 3500))
    return streams.recording(np.arange(0.0, 60.0, 1 / 30), seed=5)


def unseen_samples(name: str, rows: int = 10**9) -> tuple[Calibration, Recording, np.ndarray]:
    """Calibration, unseen rows from the first on, and their samples (n, n_signals)."""
    calibration, recording = model(name), unseen(name)
    recording = recording.rows(np.arange(min(len(recording), rows)))
    return calibration, recording, recording.table[list(calibration.loop_signals)].to_numpy()


def good_rows(calibration: Any, recording: Recording, whole: np.ndarray, most: int = 10**9) -> int:
    """Count good samples, until there are so many: each has the bits of its row of `whole`."""
    corrector, good = ready(calibration, range_margin=1.0), 0
    samples = recording.table[list(corrector.signals)].to_numpy()
    for i, t in enumerate(recording.t.tolist()):
        if corrector.step(t, samples[i]) == Status.OK:
            np.testing.assert_array_equal(corrector.position, whole[i])
            good += 1
        if good == most:
            break
    return good
