"""Calibrations of synthetic recordings, and seeds of one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from truejoint.calibration import Calibration, calibrate
from truejoint.recordings.table.recording import Recording


def make_calibration(recordings: Sequence[Recording], *, seed: int = 0) -> Calibration:
    """Fit the error to signals and the way of motion, its coefficients shaken by a seed."""
    first = recordings[0]
    measured = [f"measured/{name}" for name in first.robot.positioning]
    efforts = [f"effort/{name}" for name in first.robot.positioning]
    features = [*measured, *(name for name in efforts if name in first.units)]
    features += [f"play({name}, 0.005)" for name in measured]
    calibration = calibrate(recordings, "poly2_ridge", features=features)
    arrays = dict(calibration.fitted.arrays)
    shake = np.random.default_rng(seed).normal(size=arrays["coef"].shape)
    arrays["coef"] = arrays["coef"] * (1 + 0.002 * shake)
    return replace(calibration, fitted=replace(calibration.fitted, arrays=arrays))


@pytest.fixture(scope="session")
def calibration_of() -> Callable[..., Calibration]:
    return make_calibration
