from __future__ import annotations

import numpy as np
import pytest
from tests.estimators.conftest import columns, rms_deg, steps, target

from truejoint.estimators.cable_least_squares import (
    CompensatedJawLeastSquares,
    JawLeastSquares,
    JawLeastSquaresIntercept,
)


def observation_matrix(run) -> np.ndarray:
    """W of (29), written out."""
    blocks = []
    for place in (run.drive, run.reset):
        speed = np.concatenate([[0.0], np.diff(place) / 5e-3])
        acceleration = np.concatenate([[0.0], np.diff(speed) / 5e-3])
        blocks += [place, speed, acceleration]
    return np.column_stack([*blocks, np.sign(blocks[4])])


@pytest.mark.parametrize(
    ("model", "constant"), [(JawLeastSquares(), False), (JawLeastSquaresIntercept(), True)]
)
def test_equation_29(pair, model, constant):
    run = pair.calibration
    W, known = observation_matrix(run), np.isfinite(target(run))
    if constant:
        W = np.column_stack([W, np.ones(len(W))])
    size = np.linalg.norm(W[known], axis=0)
    chi = np.linalg.lstsq(W[known] / size, run.reference[known], rcond=None)[0] / size
    model.fit(columns(run, model.inputs), target(run), steps=steps(run))
    estimate = model.predict(columns(run, model.inputs), steps(run))
    assert np.abs(estimate - W @ chi)[known].max() < 1e-6


def test_equation_30_takes_off_its_own_error_model(pair):
    run, test = pair.calibration, pair.verification
    plain = JawLeastSquares().fit(
        columns(run, JawLeastSquares.inputs), target(run), steps=steps(run)
    )
    model = CompensatedJawLeastSquares()
    model.fit(columns(run, model.inputs), target(run), steps=steps(run))
    estimate = model.predict(columns(test, model.inputs), steps(test))
    bare = plain.predict(columns(test, plain.inputs), steps(test))
    taken = model.error_model_(test.motor, test.reset)
    assert np.abs(estimate - (bare - taken)).max() < 1e-9
    assert rms_deg(estimate, test) < 0.6 * rms_deg(bare, test)


@pytest.mark.parametrize("model", [JawLeastSquaresIntercept(), CompensatedJawLeastSquares()])
def test_steps_give_the_bits_of_the_whole(pair, model):
    run = pair.calibration
    model.fit(columns(run, model.inputs), target(run), steps=steps(run))
    X, intervals = columns(run, model.inputs)[:300], steps(run)[:300]
    intervals[100] = 0.0
    state = model.start()
    online = [model.step(state, dt, row) for dt, row in zip(intervals, X, strict=True)]
    assert np.array_equal(np.array(online), model.evaluate(X, intervals))
