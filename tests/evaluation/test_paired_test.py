import numpy as np
import pytest
from scipy.signal import lfilter

from truejoint.evaluation.paired_test import compare, correlation_time


def _slow(random, n, memory):
    """First-order process of unit variance that forgets within `memory` rows."""
    rho = np.exp(-1.0 / memory)
    return lfilter([np.sqrt(1 - rho**2)], [1.0, -rho], random.normal(size=n + 2000))[2000:]


def test_rows_that_resemble_each_other_do_not_count_as_trials():
    random = np.random.default_rng(0)
    told = {"stretches": 0, "rows": 0}
    for _ in range(200):
        own, other = ([_slow(random, 3000, 40) for _ in range(2)] for _ in range(2))
        told["stretches"] += compare(own, other).outcome != "cannot be told"
        d = np.concatenate(own) ** 2 - np.concatenate(other) ** 2
        told["rows"] += abs(d.mean()) > 1.96 * d.std() / np.sqrt(len(d))
    assert told["rows"] > 80  # what samples would have claimed
    assert told["stretches"] <= 20  # 5 % are expected of equal models


def test_a_model_that_is_half_as_wrong_is_found():
    random = np.random.default_rng(1)
    own, other = ([_slow(random, 6000, 40) for _ in range(3)] for _ in range(2))
    found = compare([0.5 * e for e in own], other)
    assert found.outcome == "better"
    assert compare(other, [0.5 * e for e in own]).outcome == "worse"
    assert found.rows >= 5 * correlation_time([e**2 - 1 for e in own]) / 2


def test_too_few_stretches_tell_nothing():
    random = np.random.default_rng(2)
    slow = 3 + _slow(random, 500, 300)
    found = compare([slow], [0.1 * slow])
    assert found.outcome == "cannot be told"
    assert found.mean > 0
    assert found.high == np.inf


def test_constant_differences_and_empty_recordings():
    one, none = np.ones((40, 2)), np.ones((0, 2))
    found = compare([one, none], [2 * one, none])
    assert (found.outcome, found.mean) == ("better", -6.0)
    assert compare([one], [one]).outcome == "cannot be told"
    found = compare(*np.random.default_rng(4).normal(size=(2, 1, 103)))
    assert found.rows == -(-103 // found.stretches)  # of about one length
    with pytest.raises(ValueError, match="shape"):
        compare([one], [one[1:]])


@pytest.mark.parametrize("memory", [1e-3, 5.0, 30.0])
def test_the_correlation_time_of_a_known_process(memory):
    rho = np.exp(-1.0 / memory)
    found = correlation_time([_slow(np.random.default_rng(3), 200_000, memory)])
    assert found == pytest.approx((1 + rho) / (1 - rho), rel=0.15)
