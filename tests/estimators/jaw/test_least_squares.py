import numpy as np
import pytest
from tests.estimators.conftest import columns, fitted, rms_deg, steps, target

from truejoint.estimators import CableLeastSquares
from truejoint.estimators.jaw.run import observe
from truejoint.estimators.jaw.signals import rational_error


def observation_matrix(run) -> np.ndarray:
    """W of (29), written out."""
    blocks = []
    for place in (run.column("cable/drive"), run.column("cable/reset")):
        speed = np.concatenate([[0.0], np.diff(place) / 5e-3])
        acceleration = np.concatenate([[0.0], np.diff(speed) / 5e-3])
        blocks += [place, speed, acceleration]
    return np.column_stack([*blocks, np.sign(blocks[4])])


@pytest.mark.parametrize("constant", [False, True])
def test_equation_29(pair, constant):
    run = pair.calibration
    W, known = observation_matrix(run), np.isfinite(target(run))
    if constant:
        W = np.column_stack([W, np.ones(len(W))])
    size = np.linalg.norm(W[known], axis=0)
    chi = np.linalg.lstsq(W[known] / size, run.column("truth/jaw")[known], rcond=None)[0] / size
    model = fitted(pair, CableLeastSquares(intercept=constant))
    estimate = model.predict(columns(run, model), steps(run))
    assert np.abs(estimate - W @ chi)[known].max() < 1e-6


def test_equation_30_takes_off_its_own_error_model(pair):
    test = pair.verification
    plain = fitted(pair, CableLeastSquares())
    model = fitted(pair, CableLeastSquares(compensated=True))
    estimate = model.predict(columns(test, model), steps(test))
    bare = plain.predict(columns(test, plain), steps(test))
    motor, reset = test.column("motor/jaw"), test.column("cable/reset")
    rows = zip(motor, reset, strict=True)
    taken = [rational_error(*row, model.scale_, model.error_coef_) for row in rows]
    assert np.abs(estimate - (bare - taken)).max() < 1e-9
    assert rms_deg(estimate, test) < 0.6 * rms_deg(bare, test)


def test_a_history_starts_at_rest():
    out = np.full(7, np.nan)
    observe(0.0, 0.01, 0.02, np.ones(4), out)
    np.testing.assert_array_equal(out, [0.01, 0.0, 0.0, 0.02, 0.0, 0.0, 0.0])
