"""Calibrations of synthetic recordings, and seeds of one."""

from dataclasses import replace

import numpy as np
import pytest

from truejoint.calibration import calibrate


def make_calibration(recordings, *, seed=0):
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
def calibration_of():
    return make_calibration
