"""Row models: one signature for all families, also for one that remembers."""

from __future__ import annotations

import numpy as np
import pytest
from numba import njit
from tests.runtime.streams import stream, trained

from truejoint.errors import ModelFileError
from truejoint.models import row_models
from truejoint.models.families import EstimatorData
from truejoint.models.known_families import FAMILIES
from truejoint.models.row_model import RowModel
from truejoint.models.row_models import row_model
from truejoint.runtime import Corrector, Status


@njit
def remembering_row(numbers, memory, interval, features, out, half_width):
    """Time since the history started, and a half-width of its own for the first joint."""
    memory[0] = 0.0 if interval == 0.0 else memory[0] + interval
    for j in range(numbers[0]):
        out[j] = 1e-3 * memory[0] + 1e-6 * features[0]
    half_width[0] = 0.125


@njit
def helpless_row(numbers, memory, interval, features, out, half_width):
    """Knows that it knows nothing."""
    out[:] = np.nan


def looped(monkeypatch, function) -> Corrector:
    def build(_data, _n_features, n_outputs):
        return RowModel(function, np.array([n_outputs]), np.zeros(1))

    monkeypatch.setitem(row_models.BUILDERS, "linear", build)
    corrector = Corrector(trained())
    corrector.set_homing(True, "h1")
    return corrector


def test_a_model_may_remember_and_know_its_own_uncertainty(monkeypatch):
    corrector = looped(monkeypatch, remembering_row)
    t = np.array([5.0, 5.01, 5.03, 5.04, 15.04, 15.05])
    seconds = [0.0, 0.01, 0.03, 0.04, 0.0, 0.01]  # anew after the gap
    samples = stream(t)
    for i in range(len(t)):
        bad = np.full(4, np.nan)
        assert corrector.step(t[i] + 1e-3, bad) & Status.NOT_FINITE  # leaves no trace
        corrector.step(t[i] + 2e-3, samples[i])
        expected = 1e-3 * seconds[i] + 1e-6 * samples[i, 0]
        np.testing.assert_allclose(corrector.correction, expected, rtol=0, atol=1e-12)
        np.testing.assert_array_equal(corrector.half_width, [0.125, np.inf])


def test_a_model_that_gives_up_is_implausible(monkeypatch):
    corrector = looped(monkeypatch, helpless_row)
    sample = stream(np.zeros(1))[0]
    assert corrector.step(0.0, sample) == Status.IMPLAUSIBLE
    np.testing.assert_array_equal(corrector.position, sample[[0, 2]])


def test_every_causal_family_has_a_row_model():
    assert {name for name, family in FAMILIES.items() if family.causal} == set(row_models.BUILDERS)


def test_a_family_without_one_is_refused_by_name():
    with pytest.raises(ModelFileError, match=r"'oracle' has no kernel.*linear"):
        row_model(EstimatorData("oracle", {}, {}), 1, 1)
