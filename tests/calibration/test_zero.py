"""The zero of a calibration, and how much of an offset is believed."""

import numpy as np
import pytest

from truejoint.calibration.zero import believed


def test_what_is_believed_of_an_offset_does_little_harm_whatever_the_zeros_spread():
    """Against the best share in hindsight: what errors explain is not taken for a zero."""
    rng, sd = np.random.default_rng(0), np.ones(20_000)
    for spread in (0.0, 0.5, 1.0, 3.0, 20.0):
        zeros = spread * rng.normal(size=len(sd))
        found = zeros + rng.normal(size=len(sd))
        left, all_of_it = (np.mean((own - zeros) ** 2) for own in (believed(found, sd), found))
        best = spread**2 / (spread**2 + 1.0)
        assert left < (0.15 if spread < 0.5 else 1.0 if spread < 2.0 else 1.45) * all_of_it
        assert left < best + 0.5
        assert left < np.mean(zeros**2) + 0.13  # it never harms by more
    errors = rng.normal(size=len(sd))
    for zero, times in ((0.0, 0.12), (1.1, 1.0), (2.6, 2.2)):  # as its docstring says
        left = np.mean((believed(zero + errors, sd) - zero) ** 2)
        assert left / np.mean(errors**2) == pytest.approx(times, rel=0.1)
    assert believed([1.0, 0.0, 2.0], [np.nan, 1.0, 0.0]).tolist() == [1.0, 0.0, 2.0]
