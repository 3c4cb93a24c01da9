"""What estimators with a filter within them share."""

import numpy as np

from truejoint.estimators.filtered import FAULTS, histories
from truejoint.filters import FilterStatus


def test_a_row_is_lost_with_whatever_leaves_no_estimate():
    kept = {status for status in FilterStatus if not status & FAULTS}
    assert kept & {
        FilterStatus.INVALID_INPUT, FilterStatus.INVALID_MEASUREMENT, FilterStatus.OUT_OF_RANGE,
        FilterStatus.TRANSITION_FAILED, FilterStatus.MEASUREMENT_FAILED, FilterStatus.SINGULAR,
    } == set()  # fmt: skip
    assert kept, "an estimate may be flagged and yet be one"


def test_a_history_goes_from_one_start_to_the_next():
    found = histories(np.array([0.0, 0.1, 0.1, 0.0, 0.2]))
    assert found == [slice(0, 3), slice(3, 5)]
