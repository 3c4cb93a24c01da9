from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from truejoint.studies.verdicts import SINGLE, below, whole


@pytest.mark.parametrize("seed", range(20))
def test_sessions_are_told_apart_as_by_a_paired_t_test(seed):
    rng = np.random.default_rng(seed)
    low = rng.normal(1.0, 0.1, 6)
    high = low + rng.normal(0.1, 0.12, 6)
    told = stats.ttest_rel(low, high).pvalue < 0.05
    assert below(low, high) == ((high.mean() > low.mean()) if told else None)


def test_one_session_tells_what_differs_by_more_than_a_share():
    assert below([1.0], [1.0 + 0.9 * SINGLE]) is None
    assert below([1.0], [1.0 + 1.2 * SINGLE]) is True
    assert below([1.0 + 1.2 * SINGLE], [1.0]) is False


def test_of_several_one_that_fails_decides():
    assert whole(True, True) is True
    assert whole(True, None) is None
    assert whole(None, False, True) is False
