"""The filter of a wrist's cables with plays beside it: what it tells and states."""

import numpy as np
from tests.runtime.registered import fit, model, ready, unseen, wrist
from tests.runtime.streams import OneByOne

from truejoint.estimators.cables.learn import CableFilter
from truejoint.estimators.cables.loops import LOAD, PIN
from truejoint.estimators.cables.run import FAMILY
from truejoint.estimators.family import EstimatorData
from truejoint.features.feature_set import time_steps
from truejoint.recordings import Recording
from truejoint.robots.wrist.instruments import JOINTS

LOADS = ("grip", "tip_first", "tip_second")
TRUE_LOADS = ("grip", "pitch", "yaw")


def rms(values):
    return np.sqrt(np.mean(np.square(values), axis=0))


def rows_of(recording, calibration=None):
    """Features, and time since the row before, of the calibration's recording."""
    calibration = calibration or model("hybrid_cables")
    gap = calibration.gap_limit
    return calibration.feature_set.compute(recording, gap), time_steps(recording.t, gap)


def filter_of(hybrid):
    """Filter within, whose plays say nothing."""
    arrays = {name: hybrid.arrays_[name] for name in FAMILY.shapes({}, 6, 3)}
    params = {"channels": hybrid.channels}
    return CableFilter.from_data(EstimatorData(FAMILY.name, params, arrays), 6, 3)


def test_it_is_nearer_than_the_filter_it_contains():
    run = unseen("hybrid_cables")
    truth, late = run.columns("truth_exact", JOINTS), run.t - run.t[0] > 2.0
    own = rms((model("hybrid_cables").correct(run) - truth)[late])
    filtered = rms((model("ukf_cables").correct(run) - truth)[late])
    assert own.mean() < 0.9 * filtered.mean()


def test_it_tells_a_grip_it_was_not_fitted_to():
    run = unseen("hybrid_cables")
    trace = ready(model("hybrid_cables").without_redundant(), range_margin=1.0).run(run)
    grip, late = run.column("truth_load/grip"), run.t - run.t[0] > 2.0
    assert rms((trace.beside["grip"][:, 0] - grip)[late]) < 0.3 * rms(grip[late])
    assert (trace.beside["grip"][late, 1] > 0.0).all()


def test_the_loop_tells_and_states_what_plays_were_fitted_to():
    calibration, (X, dt) = model("hybrid_cables"), rows_of(unseen("hybrid_cables").rows(range(200)))
    one, whole = calibration.model, calibration.model.states(X, dt)
    found = filter_of(one).states(X, dt)
    raw = X[:, :3] @ one.arrays_["parameters"][:9].reshape(3, 3).T
    states = found.states[:, LOAD:], found.states[:, PIN:LOAD]
    expected = np.hstack([raw, X, found.angle - raw, *states])
    state = OneByOne(one, 1.0)
    for i, row in enumerate(X):
        angle = state.step(dt[i], row)
        np.testing.assert_allclose(state.memory.view("sighted"), expected[i], rtol=1e-9, atol=1e-12)
        np.testing.assert_array_equal(angle, whole.angle[i])
        loads, widths = np.transpose([state.memory.view(name) for name in LOADS])
        np.testing.assert_array_equal(loads, whole.load[i])
        for half_width, deviation in (
            (state.half_width, whole.angle_deviation[i]),
            (widths, whole.load_deviation[i]),
        ):
            np.testing.assert_array_equal(half_width, deviation)


def test_it_begins_anew_with_what_its_plays_remember_after_a_row_that_is_none():
    X, dt = rows_of(unseen("hybrid_cables").rows(range(60)))
    one = model("hybrid_cables").model
    state = OneByOne(one)
    for i in range(30):
        state.step(dt[i], X[i])
    assert np.isnan(state.step(dt[30], np.full(6, 1e6))).all()
    fresh = OneByOne(one)
    for i in range(31, 60):
        expected = fresh.step(0.0 if i == 31 else dt[i], X[i])
        np.testing.assert_array_equal(state.step(dt[i], X[i]), expected)


def test_errors_in_calibration_are_stated_as_large_as_they_are():
    """With margins: for what plays were not fitted to, and under loads 2.0 for other motions.

    Free of loads they are wider than that, as the filter then sees small loads that are none.
    """
    ratios = []
    for run in wrist()[:2]:
        late = run.t - run.t[0] > 2.0
        own = model("hybrid_cables").model.states(*rows_of(run))
        truth = run.columns("truth_exact", JOINTS), run.columns("truth_load", TRUE_LOADS)
        stated = rms(np.hstack([own.angle_deviation, own.load_deviation])[late])
        ratios.append(stated / rms((np.hstack([own.angle, own.load]) - np.hstack(truth))[late]))
    free, loaded = ratios
    assert (np.minimum(free, loaded) > 1.0).all()
    assert (np.maximum(free, loaded) < 5.0).all()
    margins = (loaded / free)[3:]
    assert ((margins > 1.06) & (margins < 1.06 * np.sqrt(2.0))).all()


def test_of_a_load_that_calibration_did_not_have_it_says_what_the_filter_says():
    runs = [Recording(run.table.assign(**{"truth_load/yaw": 0.0}), run.units, run.provenance)
            for run in (run.rows(range(900)) for run in wrist()[:2])]  # fmt: skip
    calibration = fit("hybrid_cables", runs)
    X, dt = rows_of(unseen("hybrid_cables"), calibration)
    own = calibration.model.states(X, dt)
    expected = filter_of(calibration.model).states(X, dt).load[:, 2]
    assert rms(own.load[:, 2] - expected) < 0.1 * rms(expected)
    assert (own.load_deviation > 0.0).all()
