import numpy as np
import pytest
from tests.estimators.conftest import columns, fitted, loaded_run, rms_deg

from truejoint.errors import CalibrationError
from truejoint.estimators import GatedPlays, JawPlays
from truejoint.estimators.plays.run import follow_rows
from truejoint.estimators.polynomial.learn import ridge
from truejoint.simulation.forceps.load import LoadTest

RESET = JawPlays(signals=("cable/reset",))
BOTH = JawPlays(signals=("motor/jaw", "cable/reset"))


def test_plays_are_followed_from_the_middle_of_their_bands():
    rng = np.random.default_rng(0)
    values = np.cumsum(rng.normal(0.0, 1e-5, 500))
    dt = np.full(500, 5e-3)
    dt[[0, 200]] = 0.0
    widths = np.array([5e-6, 4e-5])
    out = np.empty((500, 2))
    follow_rows(dt, values, widths, out)
    for column, width in enumerate(widths):
        output = 0.0
        for i, value in enumerate(values):
            output = value if i in (0, 200) else min(max(output, value - width), value + width)
            assert out[i, column] == pytest.approx((value - output) / width, abs=1e-9)


def test_ridge_does_not_penalise_the_constant():
    rng = np.random.default_rng(0)
    columns_ = rng.normal(5.0, 2.0, (400, 3))
    y = 100.0 + columns_ @ [1.0, -2.0, 0.5]
    weights, constant = ridge(columns_, y, 1e3)
    assert np.abs(weights).max() < 0.01
    assert (columns_ @ weights + constant).mean() == pytest.approx(y.mean())
    weights, constant = ridge(columns_, y, 0.0)
    assert np.allclose(weights, [1.0, -2.0, 0.5])
    assert constant == pytest.approx(100.0)


def test_hysteresis_is_learnt(pair):
    run = pair.verification
    error = {
        model.name: rms_deg(fitted(pair, model).predict(columns(run, model)), run)
        for model in (RESET, BOTH, GatedPlays())
    }
    assert max(error.values()) <= 0.05  # the reference encoder itself: 0.032
    assert error["play_both"] < error["play_reset"]


def test_a_load_is_not_taken_for_a_motion(pair):
    test = LoadTest(0.2)
    run = loaded_run(test)
    still = run.t >= test.phases["IV"][0]
    worst = {}
    for model in (BOTH, GatedPlays()):
        error = fitted(pair, model).predict(columns(run, model)) - run.column("truth/jaw")
        worst[model.name] = np.degrees(np.sqrt(np.mean(error[still] ** 2)))
    assert worst["play_both"] > 0.3
    assert worst["play_gated"] < 0.15


@pytest.mark.parametrize(
    "signals",
    [
        (),
        ("cable/reset", "cable/reset"),
        ("motor/jaw", "cable/drive", "cable/reset"),
        ("cable/reset", "motor/jaw"),
        ("jaw",),
        "cable/reset",
    ],
)
def test_signals_are_one_or_two_of_three(signals):
    with pytest.raises(CalibrationError, match="one or two of motor/jaw, cable/drive, cable/reset"):
        JawPlays(signals=signals).fit(np.zeros((500, 1)), np.zeros(500))


def test_a_motion_of_one_amplitude_is_not_fitted_beyond_its_size(pair):
    """A penalty by cross-validation on it is too small: errors of degrees on any other motion."""
    model = fitted(pair, RESET)
    X = columns(pair.verification, model)
    assert np.abs(model.predict(1.1 * X) - 1.1 * model.predict(X)).max() < np.radians(3.0)
