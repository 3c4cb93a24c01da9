"""A model of an arm, and touches of a block on the day of its calibration."""

from __future__ import annotations

import pytest
from tests.tip.touched_arm import Touched, fitted, touched

from truejoint import Calibration


@pytest.fixture(scope="package")
def model() -> Calibration:
    return fitted()


@pytest.fixture(scope="package")
def first() -> Touched:
    return touched(24)
