"""A model of an arm, and touches of a block on the day of its calibration."""

import pytest
from tests.tip.test_touch_calibration import session, without_truth
from tests.tip.touched_arm import Touched, fitted, touched

from truejoint import Calibration
from truejoint.tip import TouchReport, calibrate_by_touch


@pytest.fixture(scope="package")
def model() -> Calibration:
    return fitted()


@pytest.fixture(scope="package")
def first() -> Touched:
    return touched(24)


@pytest.fixture(scope="package")
def calibrated() -> tuple[Calibration, TouchReport]:
    recording, touches, block, _ = session()
    return calibrate_by_touch(without_truth(recording), touches, block)
