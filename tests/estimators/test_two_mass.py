"""The filter of motor and link, on joints whose stretch and friction are known."""

from __future__ import annotations

import numpy as np
import pytest

from truejoint import calibrate
from truejoint.errors import CalibrationError
from truejoint.estimators import LinearRegressor, TwoMassFilter
from truejoint.recordings import Provenance, Recording

MOTOR, LINK, STIFFNESS = 0.3, 0.1, 12.0  # Coulomb frictions [Nm], and the cable's [Nm/rad]


def joint(seed, count=1500, dt=0.02):
    """Motor, effort and link of a slow joint under a load that changes, from statics alone."""
    rng = np.random.default_rng(seed)
    t = dt * np.arange(count)
    pace = rng.uniform(0.5, 0.7)
    motor = 0.8 + 0.5 * np.sin(pace * t) + 0.3 * np.sin(2.3 * pace * t + seed)
    load = 0.4 * np.cos(motor) + 0.3 * np.sin(0.31 * pace * t + 1.0)
    turned = np.sign(np.gradient(motor))
    carried = load + LINK * turned
    effort = carried + MOTOR * turned + 0.02 * rng.standard_normal(count)
    return t, motor, effort, motor - carried / STIFFNESS


def rows(seed, **how):
    t, motor, effort, link = joint(seed, **how)
    dt = np.diff(t, prepend=t[0])
    return np.column_stack([motor, effort]), link, dt


def recording(seed, sign=1.0, **more):
    t, motor, effort, link = joint(seed)
    columns = {"t": t, "measured/jaw": motor, "effort/jaw": sign * effort, "truth/jaw": link}
    columns |= more
    units = {"effort/jaw": "Nm"} if "effort/jaw" in columns else {}
    return Recording.from_columns(columns, Provenance("davinci_grasper"), units)


@pytest.fixture(scope="module")
def fitted():
    X, y, dt = rows(0)
    return TwoMassFilter().fit(X, y, dt=dt)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_it_tells_what_the_cable_carries_from_what_brakes_the_motor(fitted, seed):
    X, y, dt = rows(seed)
    linear = LinearRegressor().fit(*rows(0)[:2])
    left = np.std((fitted.predict(X, dt) - y)[50:])
    assert left < 0.6 * np.std((linear.predict(X) - y)[50:])


def test_an_effort_of_the_other_sign_is_the_same_joint(fitted):
    X, y, dt = rows(0)
    X[:, 1] *= -1.0
    other = TwoMassFilter().fit(X, y, dt=dt)
    np.testing.assert_allclose(other.predict(X, dt), fitted.predict(rows(0)[0], dt), atol=1e-9)


def test_a_position_that_is_none_is_told_and_forgotten(fitted):
    X, _, dt = rows(1, count=300)
    X[100, 0] = 1e3
    found = fitted.predict(X, dt)
    assert np.isnan(found[100])
    assert np.isfinite(np.delete(found, 100)).all()
    dt[101] = 0.0  # after it, the filter starts anew
    np.testing.assert_array_equal(found[101:], fitted.predict(X[101:], dt[101:]))


def test_efforts_that_are_none_do_not_stop_a_fit(fitted, monkeypatch):
    monkeypatch.setattr("truejoint.estimators.motor_side.two_mass_rows._STRONGEST", 8.0)
    X, y, dt = rows(0)
    X[[400, 900], 1] = 4.0
    odd = TwoMassFilter().fit(X, y, dt=dt)
    assert np.flatnonzero(np.isnan(odd.predict(X, dt))).tolist() == [400, 900]
    X, y, dt = rows(1)
    error, usual = (np.std((one.predict(X, dt) - y)[50:]) for one in (odd, fitted))
    assert error < 2.0 * usual


def test_the_joints_are_those_with_truth():
    model = calibrate([recording(0)], "ukf_two_mass")
    assert model.target == "position"
    assert model.feature_set.names == ("measured/jaw", "effort/jaw")


def test_without_an_effort_it_is_refused_in_one_line():
    t, motor, _, link = joint(0)
    columns = {"t": t, "measured/jaw": motor, "truth/jaw": link}
    bare = Recording.from_columns(columns, Provenance("davinci_grasper"))
    with pytest.raises(CalibrationError, match="no effort/jaw; ukf_two_mass reads"):
        calibrate([bare], "ukf_two_mass")


def test_an_effort_that_never_changes_is_refused():
    X, y, dt = rows(0)
    X[:, 1] = 0.5
    with pytest.raises(CalibrationError, match="effort/jaw never changes"):
        TwoMassFilter().fit(X, y, dt=dt)


def test_histories_too_short_to_settle_are_refused():
    X, y, dt = rows(0)
    dt[::45] = 0.0
    with pytest.raises(CalibrationError, match="record longer motions without a gap"):
        TwoMassFilter().fit(X, y, dt=dt)
