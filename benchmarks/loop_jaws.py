"""Cable-driven jaws for measuring the control loop: a model by every estimator of one, samples."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from benchmarks.loop_session import Samples
from truejoint.calibration import Calibration, calibrate
from truejoint.estimators import estimator_names, get_estimator
from truejoint.models.elastic_joint import DRIVER
from truejoint.motion.forceps_trajectories import calibration_trajectory, verification_trajectory
from truejoint.recordings import Provenance, Recording
from truejoint.recordings.forceps import record_forceps
from truejoint.simulation.forceps.specimens import specimen


def jaw_models() -> Iterator[tuple[Calibration, Samples]]:
    """Each estimator of a jaw that runs in a loop, on a motion that it was not fitted to."""
    motions = calibration_trajectory(), verification_trajectory()
    cables = [
        record_forceps(specimen("B"), motion.positions[:, 0], seed=seed)
        for seed, motion in enumerate(motions)
    ]
    driven = [driven_jaw(seed) for seed in range(5)]
    for name in estimator_names():
        estimator = get_estimator(name)
        family = estimator.family
        if family.inputs is None or family.row is None:
            continue
        at_motor = DRIVER in family.inputs(estimator.model_params())
        training, unseen = (driven[:4], driven[4]) if at_motor else (cables[:1], cables[1])
        model = calibrate(training, estimator)
        rows = unseen.table[list(model.loop_signals)].to_numpy()
        yield model, Samples(model.loop_signals, unseen.t.tolist(), rows)


def driven_jaw(seed: int) -> Recording:
    """Make a minute at 200 Hz of a jaw that rubs and gives, under one load."""
    rng = np.random.default_rng(seed)
    t = np.arange(12_000) / 200.0
    driver = 0.5 + 0.45 * np.cos(2.0 * np.pi * 0.3 * t) * (0.8 + 0.2 * np.sin(0.3 * t))
    load = 0.02 + 0.02 * seed
    friction = np.tanh(np.gradient(driver, t) / 0.05)
    effort = load + 0.03 * friction + 0.01 * driver + 0.002 * rng.standard_normal(len(t))
    columns = {
        "t": t,
        "measured/jaw": 1.0 - 0.9 * driver,
        "driver/jaw": driver,
        "effort/jaw": effort,
        "truth/jaw": 1.1 - 0.88 * driver - 0.9 * load - 0.01 * friction,
        "truth_effort/jaw": -1.1 * load - 0.01 * friction,
    }
    origin = Provenance("davinci_grasper", session=str(seed))
    units = dict.fromkeys(("effort/jaw", "truth_effort/jaw"), "Nm")
    return Recording.from_columns(columns, origin, units)
