from dataclasses import replace

import numpy as np
import pytest
from tests.estimators.conftest import columns, fitted, loaded_run, rms_deg, steps
from tests.runtime.registered import model as registered

from truejoint.estimators import FrictionFilter
from truejoint.estimators.jaw.signals import FLICKER, SLIDING
from truejoint.estimators.jaw_load import run as friction_filter
from truejoint.estimators.jaw_load.run import DEGREE, SHOWN, TURNING, UNSHOWN, hidden_load
from truejoint.runtime import Corrector, Status
from truejoint.simulation.forceps.load import LoadTest


@pytest.fixture(scope="module")
def model(pair):
    return fitted(pair, FrictionFilter())


def test_without_sliding_it_is_a_kalman_filter(pair, model, monkeypatch):
    """Elements that do not reach their ends are linear: an ordinary Kalman filter must agree."""
    widths = np.array(model.widths) * 5e3
    params = {**model.model_params(), "widths": tuple(widths.tolist())}
    wide = FrictionFilter.from_data(replace(model.data, params=params), 2, 1)
    prior = np.zeros(5), np.diag([1e-6] * 4 + [4e-12])
    monkeypatch.setattr(friction_filter, "friction_prior", lambda _elements: prior)
    X = columns(pair.verification, wide)[:1500]
    dt = steps(pair.verification)[:1500]
    n = len(widths)
    x, covariance = prior
    weights = np.append(wide.drive_[1 + DEGREE :], 1.0)
    noise = wide.misfit_[0] ** 2 * max(wide.error_time / wide.dt_[0], 1.0)
    drift = np.append(np.full(n, wide.friction_drift**2), wide.stretch_drift**2)
    stretch = np.empty(len(X))
    for k, (motor, reset) in enumerate(X):
        moved = reset - X[k - 1, 1] if k else 0.0
        x = x + np.append(moved / widths, 0.0)
        covariance = covariance + np.diag(drift) * dt[k]
        place = reset * wide.scale_[0]
        expected = wide.drive_[0] + wide.drive_[1 : 1 + DEGREE] @ place ** np.arange(1, DEGREE + 1)
        innovation = motor * wide.wheel_radius / wide.gear_ratio - expected - weights @ x
        gain = covariance @ weights / (weights @ covariance @ weights + noise)
        x = x + gain * innovation
        covariance = covariance - np.outer(gain, weights @ covariance)
        stretch[k] = x[-1]
    states = wide.states(X, dt)
    assert np.abs(states.states[:, -1] - stretch).max() < 1e-4 * np.abs(stretch).max()
    # Of the angle it says what its elements and its fit leave open, and friction at rest hides.
    bare = wide.angle_[1 + DEGREE :] @ covariance[:n, :n] @ wide.angle_[1 + DEGREE :]
    known = np.sqrt(bare + wide.misfit_[1] ** 2)
    assert known <= states.angle_deviation[-1] < 1.2 * known


def test_angle_and_load_under_a_weight(pair, model):
    for test in (LoadTest(0.2, "opposing"), LoadTest(0.2, "along")):
        run = loaded_run(test)
        still = run.t >= test.phases["IV"][0]
        states = model.states(columns(run, model), steps(run))
        error = np.degrees((states.angle - run.column("truth/jaw"))[still])
        assert np.sqrt(np.mean(error**2)) < 0.15
        off = np.abs((states.load - run.column("truth_load/jaw"))[still]).mean()
        hidden = 2.0 * model.jaw_friction * (test.direction == "opposing")
        assert off < hidden + 0.3 * run.column("truth_load/jaw")[still].max()
    assert rms_deg(
        model.predict(columns(pair.verification, model)), pair.verification
    ) < 0.05  # fmt: skip


def test_smoothing_agrees_at_the_end_and_is_surer_before(pair, model):
    run = pair.verification
    X, dt = columns(run, model)[:3000], steps(run)[:3000]
    filtered, smoothed = model.states(X, dt), model.states(X, dt, smoothed=True)
    assert smoothed.load[-1] == pytest.approx(filtered.load[-1], abs=1e-9)
    assert smoothed.load_deviation.mean() < filtered.load_deviation.mean()
    assert smoothed.states[:, -1].std() < filtered.states[:, -1].std()


def test_what_stands_hides_more_than_what_moves(pair, model):
    """The stated deviations of a jaw at rest hold the friction that may have turned round."""
    test = LoadTest(0.05, "opposing")
    run = loaded_run(test)
    states = model.states(columns(run, model), steps(run))
    moving, still = (
        (run.t > test.phases[phase][0] + 2.0) & (run.t < test.phases[phase][1])
        for phase in ("I", "IV")
    )
    assert states.load_deviation[still].min() > SHOWN * model.jaw_friction
    assert np.median(states.load_deviation[moving]) < 0.5 * model.jaw_friction
    error = np.abs(states.load - run.column("truth_load/jaw"))
    assert (error < 1.645 * states.load_deviation)[still].mean() > 0.8
    angle = np.abs(states.angle - run.column("truth/jaw"))
    assert (angle < 1.645 * states.angle_deviation)[run.t > 3.0].mean() > 0.8
    assert states.angle_deviation[still].max() < np.radians(0.3)


def test_the_loop_tells_the_load():
    """The same numbers, sample by sample, and OK under a load that training never saw."""
    test = LoadTest(0.2, "along")
    run = loaded_run(test)
    calibration = registered("ukf_friction")
    corrector = Corrector(calibration, level=0.9)
    corrector.set_homing(True, run.provenance.homing_id)
    trace = corrector.run(run)
    under = run.t > test.loaded_to
    assert (trace.status[under] == Status.OK).all()
    states = calibration.model.states(columns(run, calibration.model), steps(run))
    assert np.allclose(trace.beside["load"][:, 0], states.load, rtol=1e-6, atol=1e-9)
    half_width = 1.6448536 * states.load_deviation
    assert np.allclose(trace.beside["load"][:, 1], half_width, rtol=1e-6, atol=1e-9)
    half_width = 1.6448536 * states.angle_deviation
    assert np.allclose(trace.half_width[under, 0], half_width[under], rtol=1e-6, atol=1e-9)


def test_a_load_that_nothing_shows_may_be_as_large_as_friction_holds():
    """Moving, at rest, and turned by a load, by the definitions."""
    hold = np.zeros(5)
    step, still, part = 50e-6, np.zeros(200), 5e-6

    def after(drive, reset, fresh=False):
        dt = np.r_[0.0 if fresh else 5e-3, np.full(len(drive) - 1, 5e-3)]
        return [hidden_load(*row, hold) for row in zip(dt, drive, reset, strict=True)][-1]

    moving = np.arange(200) * step
    assert after(moving, moving, fresh=True) < 0.01
    turning, end = moving[-1] - moving, moving[-1] + still
    assert after(turning[:100], end[:100]) == pytest.approx(TURNING)
    place = float(turning[99])
    assert after(place + still, end) == pytest.approx(UNSHOWN) == pytest.approx(2.0 / 3.0**0.5)
    assert after(place + still, end - part) == pytest.approx(
        np.hypot(UNSHOWN * np.exp(x := -(part - 2.0 * FLICKER) / SLIDING), SHOWN * -np.expm1(x))
    )
    assert after(place + still, end - 20 * part) == pytest.approx(SHOWN, rel=0.01)
    # The motor goes on, and what was shown is of another place.
    after(place + moving, end - moving)
    assert after(place + moving[-1] + still, end - moving[-1]) == pytest.approx(UNSHOWN)
    # So it is where a history begins.
    assert after(place + moving[-1] + still, end - 2 * moving[-1]) == pytest.approx(SHOWN)
    assert after(place + still, end, fresh=True) == pytest.approx(UNSHOWN)
