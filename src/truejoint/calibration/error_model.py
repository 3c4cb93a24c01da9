"""What a robot would report of true positions: a calibration turned round, for simulators."""

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Final

import numpy as np

from truejoint.array_types import Array
from truejoint.calibration.calibration import Calibration
from truejoint.calibration.fit import calibrate
from truejoint.errors import CalibrationError
from truejoint.estimators.registry import ERROR_MODELS
from truejoint.recordings.table.recording import Recording, as_recordings
from truejoint.robots import Robot

_HELD_OUT: Final = 0.25  # of each recording, at its end
_LONGEST: Final = 60.0  # correlation time [s]


def learn_error_model(
    recordings: Recording | Iterable[Recording], estimator: str = ""
) -> Calibration:
    """Learn which positions a robot reports where its joints truly are.

    It is a calibration whose inputs are true positions, of a robot called ``<name>_true``, so that
    nothing takes it for a correction. It sees no efforts, as simulators of kinematics have none.
    Its metadata have ``noise``: by joint, the standard deviation [rad or m] and the correlation
    time [s] of held-out residuals. They are those of a fit without each recording's last quarter.
    Unless an `estimator` is named it has plays, coupled where several joints have truth.

    Raises CalibrationError as `calibrate`, and where a recording has no truth.

    Examples
    --------
    >>> model = learn_error_model(training, "linear")
    >>> model.robot, sorted(model.metadata["noise"])
    ('davinci_grasper_true', ['jaw'])
    """
    turned = [_turned(recording) for recording in as_recordings(recordings)]
    estimator = estimator or ERROR_MODELS[len(turned[0].joints_of("truth")) > 1]
    cuts = [round((1.0 - _HELD_OUT) * len(recording)) for recording in turned]
    trial = calibrate([r.rows(slice(0, n)) for r, n in zip(turned, cuts, strict=True)], estimator)
    ends = [r.rows(slice(n, len(r))) for r, n in zip(turned, cuts, strict=True)]
    residuals = [end.columns("truth", trial.joints) - trial.correct(end) for end in ends]
    dt, noise = float(np.median([np.median(np.diff(end.t)) for end in ends])), {}
    for k, joint in enumerate(trial.joints):
        parts = [residual[:, k] for residual in residuals]
        rms = float(np.sqrt(np.mean(np.concatenate(parts) ** 2)))
        noise[joint] = [rms, _correlation(parts, dt)]
    return calibrate(turned, estimator).with_metadata(truth="reported", noise=noise)


def _turned(recording: Recording) -> Recording:
    """Exchange measured and true positions of a recording."""
    joints = recording.joints_of("truth")
    if not joints:
        raise CalibrationError(f"{recording.provenance.source}: it has no truth; add joint sensors")
    with_truth, robot = recording.with_truth(joints), recording.robot
    free = (replace(robot.joint(name), lower=-math.inf, upper=math.inf) for name in joints)
    true = Robot(f"{robot.name}_true", tuple(free), robot.arm)
    columns = {"t": with_truth.t}
    for name, other in (("measured", "truth"), ("truth", "measured")):
        columns |= {f"{name}/{joint}": with_truth.column(f"{other}/{joint}") for joint in joints}
    origin = replace(with_truth.provenance, robot=true.name, arm=true.arm)
    return Recording.from_columns(columns, origin, robot=true)


def _correlation(residuals: list[Array], dt: float) -> float:
    """Time [s] after which a residual has forgotten itself, of a first-order process."""
    products = sum(float(r[1:] @ r[:-1]) for r in residuals)
    share = products / max(sum(float(r @ r) for r in residuals), 1e-300)
    return float(min(_LONGEST, -dt / math.log(min(max(share, 1e-6), 1.0 - 1e-9))))
