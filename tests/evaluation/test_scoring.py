import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from truejoint.evaluation.judge import worst_windows


def test_a_burst_of_error_is_the_worst_window() -> None:
    t = np.arange(1000) / 10
    error = np.full(1000, 0.01)
    error[420:450] = 1.0
    (first, end, rmse), *_ = worst_windows(t, error, 10.0, 3)
    assert first <= 420
    assert end >= 450
    assert rmse == pytest.approx(np.sqrt(np.mean(error[first:end] ** 2)))


@settings(deadline=None)
@given(st.integers(2, 80), st.floats(0.5, 30.0), st.integers(0, 1000))
def test_windows_match_a_search_by_hand(n: int, window: float, seed: int) -> None:
    random = np.random.default_rng(seed)
    t = np.cumsum(random.uniform(0.1, 1.0, n))
    error = random.normal(size=n)
    found = worst_windows(t, error, window, 4)
    parts = [(t >= start) & (t <= start + window) for start in t]
    long_enough = [p for p in parts if np.ptp(t[p]) >= 0.5 * min(window, t[-1] - t[0])]
    by_hand = max(np.sqrt(np.mean(error[p] ** 2)) for p in long_enough or parts)
    assert found[0][2] == pytest.approx(by_hand, rel=1e-9)
    assert [f[2] for f in found] == sorted((f[2] for f in found), reverse=True)
    taken = np.zeros(n)
    for first, end, _ in found:
        taken[first:end] += 1
    assert taken.max() == 1


def test_a_recording_shorter_than_the_window_is_one_window() -> None:
    t = np.arange(50) / 10
    assert worst_windows(t, np.ones(50), 10.0, 3) == [(0, 50, 1.0)]
