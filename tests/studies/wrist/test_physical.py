"""How honest what is stated of joints and loads is."""

from __future__ import annotations

import numpy as np
import pytest

from truejoint.estimators.cables.learn import CableStates
from truejoint.recordings import Provenance, Recording
from truejoint.robots.wrist.instruments import JOINTS
from truejoint.studies.wrist.physical import LOADS, honesty


def test_what_errs_as_stated_is_honest_and_what_states_half_is_not():
    rng, n = np.random.default_rng(1), 4000
    angle, load = 0.01 * rng.normal(size=(n, 3)), 0.002 * rng.normal(size=(n, 3))
    columns = {f"truth_exact/{name}": np.zeros(n) for name in JOINTS}
    columns |= {f"truth_load/{name}": np.zeros(n) for name in LOADS}
    columns |= {f"measured/{name}": np.zeros(n) for name in JOINTS}
    test = Recording.from_columns({"t": 0.005 * np.arange(n), **columns}, Provenance("wrist"))
    deviations = np.full((n, 3), 0.01), np.full((n, 3), 0.001)
    angle[: n // 10] = 1.0  # before what counts
    found = CableStates(angle, deviations[0], load, deviations[1], np.zeros((n, 15)))
    honest = honesty(found, test, 0.1 * test.t[-1])
    assert honest["angle"]["nees"] == pytest.approx(1.0, abs=0.05)
    assert honest["angle"]["covered"] == pytest.approx(0.9, abs=0.02)
    assert honest["load"]["nees"] == pytest.approx(4.0, abs=0.2)
    assert honest["load"]["covered"] == pytest.approx(0.589, abs=0.02)
