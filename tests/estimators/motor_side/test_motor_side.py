"""The unscented filter of an elastic joint, on joints whose friction and load are known."""

from dataclasses import replace

import numpy as np
import pytest
from sklearn.base import clone
from tests.refusals import refused

from truejoint import calibrate
from truejoint.estimators.filtered import Estimate, run_filter
from truejoint.estimators.jaw.learn import MIN_ROWS
from truejoint.estimators.motor_side.learn import ElasticJointFilter
from truejoint.estimators.motor_side.run import NOISE
from truejoint.features.feature_set import time_steps
from truejoint.recordings import Provenance, Recording

RATE = 100.0
WIDTHS = (0.01, 0.08)


def slide(driver, width):
    """Deflection of an element that sticks until the driver has gone `width`, by definition."""
    out, anchor = np.empty_like(driver), driver[0]
    for i, value in enumerate(driver):
        anchor = min(max(anchor, value - width), value + width)
        out[i] = (value - anchor) / width
    return out


def joint(seed, seconds=25.0, load=None):
    """Driver angle and torque, jaw angle and torque, and the load, of a jaw that rubs and gives."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * RATE)) / RATE
    swing = 0.8 + 0.2 * np.sin(0.3 * t + rng.uniform(0.0, 6.0))
    driver = 0.5 + 0.5 * swing * np.cos(2.0 * np.pi * rng.uniform(0.15, 0.5) * t)
    load = np.full(len(t), rng.uniform(0.02, 0.12)) if load is None else load(t)
    narrow, wide = (slide(driver, width) for width in WIDTHS)
    torque = load + 0.02 * narrow + (0.03 + 0.2 * load) * wide + 0.01 * (driver - 0.5)
    torque += 0.002 * rng.standard_normal(len(t))
    jaw = 1.1 - 0.88 * driver - load * (0.9 + 2.0 * load) - 0.0075 * narrow - 0.015 * wide
    return driver, torque, jaw, -1.1 * load - 0.01, load, t


def rows(seeds, **options):
    """Inputs (n, 2), targets (n, 2), steps (n,) and loads (n,) of several histories."""
    parts = [joint(seed, **options) for seed in seeds]
    X = np.concatenate([np.column_stack(part[:2]) for part in parts])
    y = np.concatenate([np.column_stack(part[2:4]) for part in parts])
    steps = np.concatenate([time_steps(part[5], 1.0) for part in parts])
    return X, y, steps, np.concatenate([part[4] for part in parts])


def fit(model, X, y, steps):
    """Fit to angle and torque, the columns of `y`."""
    return model.fit(X, y[:, :1], None, steps, loads=y[:, 1:])


def estimate(model, X, dt):
    """Angle and torque, and the load that would hold the jaw in the middle, by the filter."""
    run, load = run_filter(model.data, X, model.time_steps(dt, len(X))), int(model.elements)
    scale = model.scales_[2]
    return Estimate(
        np.hstack([run.outputs, run.beside[:, 0]]), np.hstack([run.deviations, run.beside[:, 1]]),
        run.x[:, load] * scale, np.sqrt(np.maximum(run.P[:, load, load], 0.0)) * scale, run.x,
    )  # fmt: skip


def recording(seed, seconds=25.0):
    driver, torque, jaw, jaw_torque, _, t = joint(seed, seconds)
    columns = {
        "t": t,
        "measured/jaw": 1.0 - 0.9 * driver,
        "driver/jaw": driver,
        "effort/jaw": torque,
        "truth/jaw": jaw,
        "truth_effort/jaw": jaw_torque,
    }
    units = dict.fromkeys(("effort/jaw", "truth_effort/jaw"), "Nm")
    return Recording.from_columns(columns, Provenance("davinci_grasper", session=str(seed)), units)


@pytest.fixture(scope="module")
def fitted():
    X, y, steps, _ = rows(range(5))
    return fit(ElasticJointFilter(elements=2), X, y, steps)


def test_it_finds_the_widths_of_the_friction(fitted):
    widths = fitted.widths_ * fitted.scales_[1]
    assert widths == pytest.approx(WIDTHS, rel=0.03)


def test_it_estimates_angle_torque_and_load_of_motions_that_it_never_saw(fitted):
    X, y, steps, load = rows([50, 51, 52])
    found = estimate(fitted, X, steps)
    error = found.angle - y
    # Torque noise of 2 mNm stands for 0.12 deg; a constant angle is off by 15 deg, and a jaw that
    # followed the driver's angle alone by its load's spread, 2 deg.
    assert np.degrees(error[:, 0].std()) < 0.08
    assert error[:, 1].std() < 1.5e-3
    assert (found.load - load).std() < 1.2e-3


def test_three_loads_are_no_reason_for_a_cubic():
    """What lies between them is told by the straight line that a stretched cable is."""
    loads, rng = (0.03, 0.05, 0.12), np.random.default_rng(0)

    def under(seeds, load):
        return rows(seeds, seconds=12.0, load=lambda t: np.full(len(t), load))

    parts = [under([10 * i + j], load) for i, load in enumerate(loads) for j in range(2)]
    X, y, steps, _ = (np.concatenate(own) for own in zip(*parts, strict=True))
    y[:, 0] += np.repeat(np.radians(rng.normal(0.0, 0.3, len(parts))), len(y) // len(parts))
    model = fit(ElasticJointFilter(elements=2), X, y, steps)
    X, y, steps, _ = under([90, 91], 0.09)
    assert abs(np.degrees((estimate(model, X, steps).angle - y)[:, 0].mean())) < 0.3


def test_what_it_states_of_its_errors_holds(fitted):
    X, y, steps, _ = rows(range(5))
    noise = 0.002 / np.sqrt(RATE) / fitted.scales_[2]
    model = fit(ElasticJointFilter(elements=2, torque_noise=noise), X, y, steps)
    wander = np.sqrt(model.noise_[NOISE.index("load_density")] / RATE) * model.scales_[2]
    rng = np.random.default_rng(7)
    X, y, steps, load = rows(
        range(70, 90), load=lambda t: 0.07 + np.cumsum(wander * rng.standard_normal(len(t)))
    )
    found = estimate(model, X, steps)
    for error, deviation in (
        *zip((found.angle - y).T, found.angle_deviation.T, strict=True),
        (found.load - load, found.load_deviation),
    ):
        assert 0.7 < np.sqrt(np.mean((error / deviation) ** 2)) < 1.3


def test_rows_without_truth_are_seen_and_not_fitted_to(fitted):
    X, y, steps, _ = rows(range(5))
    rng = np.random.default_rng(0)
    known = rng.random(len(y)) < 0.5
    model = fit(clone(fitted), X, np.where(known[:, None], y, np.nan), steps)
    Xt, yt, stepst, _ = rows([50])
    assert np.degrees((model.predict(Xt, stepst) - yt[:, :1]).std()) < 0.08


def test_the_torque_does_not_change_the_angle():
    X, y, steps, _ = rows(range(3), seconds=10.0)
    both = fit(ElasticJointFilter(elements=2), X, y, steps)
    alone = clone(both).fit(X, y[:, :1], None, steps)
    assert both.family.beside(both.model_params()) == {"torque": ()}
    assert alone.family.beside(alone.model_params()) == {}
    Xt, _, stepst, _ = rows([50])
    np.testing.assert_array_equal(alone.predict(Xt, stepst), both.predict(Xt, stepst))
    assert estimate(alone, Xt, stepst).angle.shape == (len(Xt), 1)


def test_a_torque_that_is_known_in_few_rows_is_not_told():
    X, y, steps, _ = rows(range(3), seconds=10.0)
    y[MIN_ROWS - 1 :, 1] = np.nan
    y[-800:, 1] = 0.0  # as where a recording has none
    model = fit(ElasticJointFilter(elements=2), X, y, steps)
    assert not model.model_params()["tells_torque"]


def test_a_torque_of_0_that_was_read_is_learnt():
    """Of a jaw that presses in one half of its travel alone."""
    X, y, steps, _ = rows(range(3), seconds=10.0)
    y[:, 1] = 0.1 * np.maximum(X[:, 0] - 0.5, 0.0)
    told = estimate(fit(ElasticJointFilter(elements=2), X, y, steps), X, steps).angle[:, 1]
    assert np.abs(told[y[:, 1] == 0.0]).mean() < 0.01  # the line of the other half is at -0.03


def test_a_torque_in_another_unit_is_refused():
    parts = [recording(seed) for seed in range(4)]
    parts[2] = replace(parts[2], units={**parts[2].units, "truth_effort/jaw": "N"})
    refused("'truth_effort/jaw' is in N, and is learnt in Nm", calibrate, parts, "ukf_elastic")


def never_back(X, y):
    X[:, 0] = np.linspace(0.0, 1.0, len(X))


def jumping(X, y):
    X[len(X) // 3 :, 0] += 3.0


def stuck(X, y):
    X[:, 1] = 0.07


def untrue(X, y):
    y[MIN_ROWS // 2 :] = np.nan


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (never_back, "reverses 0 times"),
        (jumping, "jumps between two rows"),
        (stuck, "effort/jaw never changes"),
        (untrue, "rows with a known position"),
    ],
)
def test_rows_that_teach_nothing_are_refused(spoil, words):
    X, y, steps, _ = rows(range(2))
    spoil(X, y)
    refused(words, fit, ElasticJointFilter(elements=1), X, y, steps)


def test_one_load_for_all_is_refused():
    X, y, steps, _ = rows(range(3), load=lambda t: np.full(len(t), 0.05))
    refused("add recordings under other loads", fit, ElasticJointFilter(elements=2), X, y, steps)


@pytest.mark.parametrize("name", ["scales", "noise", "widths"])
def test_a_model_that_was_edited_is_refused(fitted, name):
    arrays = {key: array.copy() for key, array in fitted.arrays_.items()}
    arrays[name][1] *= -1.0
    refused("not above 0", ElasticJointFilter.from_data, replace(fitted.data, arrays=arrays), 2, 1)
