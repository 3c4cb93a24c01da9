"""Networks that remember: that they are trained as they run."""

import sys
from importlib.util import find_spec

import numpy as np
import pytest
from sklearn.base import clone
from tests.refusals import refused

from truejoint.errors import TruejointError
from truejoint.estimators.network.learn import FLOOR, GRU, TCN, step_rows, window_rows, windows

pytestmark = pytest.mark.skipif(not find_spec("torch"), reason="the extra [torch] is not installed")

SMALL = GRU(units=5, period=0.005, window=16, epochs=3)
CONVOLUTION = TCN(layers=3, units=5, period=0.005, window=16, epochs=3)
ALL = [SMALL, CONVOLUTION]


def delayed(n: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Features, and targets that only the rows before tell."""
    X = np.random.default_rng(seed).normal(size=(n, 2))
    return X, np.column_stack([3.0 + np.roll(X[:, 0], 1), 0.1 * np.roll(X[:, 1], 2)])


@pytest.mark.parametrize("small", ALL, ids=lambda one: one.name)
def test_training_errs_as_the_row_does(small, monkeypatch):
    """Mean loss of a window that is the whole history is the error of the predictions.

    It begins with an output that sees the units: torch's forward pass is that of the row.
    """
    start = type(small)._start

    def all_drawn(self, weights, rng):
        start(self, weights, rng)
        weights["output_weights"][:] = rng.normal(size=weights["output_weights"].shape)

    monkeypatch.setattr(type(small), "_start", all_drawn)
    X, y = delayed(200)
    model = clone(small).set_params(window=200, epochs=1, learning_rate=1e-9, weight_decay=0.0)
    model.fit(X, y)
    squares = (((y - model.predict(X)) / model.target_scale_) ** 2).mean(axis=0)
    assert model.loss_curve_[0] == pytest.approx(np.log(squares + FLOOR).mean(), abs=1e-4)


def test_windows_cover_each_history_and_none_but_short_ones_go_beyond():
    first = np.repeat([0, 40, 45], [40, 5, 30])
    rng = np.random.RandomState(0)
    for _ in range(20):
        starts = windows(first, 16, rng)
        rows, within = window_rows(first, starts, 3, 16)
        assert (first[rows] == first[starts])[within].all()
        assert set(rows[3:][within[3:]]) == set(range(75))
        assert within[3:, starts != 40].all()


def test_without_torch_it_says_how_to_get_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(TruejointError, match=r"training gru needs torch.*truejoint\[torch\]"):
        SMALL.fit(*delayed(300))


@pytest.mark.parametrize(
    "model",
    [GRU(units=8, epochs=30), TCN(units=8, epochs=30, layers=6)],
    ids=lambda model: model.name,
)
def test_it_learns_hysteresis(model):
    """A play operator on a motion of changing amplitude, which a line cannot follow."""
    t = np.arange(2400) * 0.02
    X = (np.sin(2.0 * t) * np.sin(0.31 * t))[:, None]
    y = np.zeros(2400)
    for i in range(1, 2400):
        y[i] = np.clip(y[i - 1], X[i, 0] - 0.3, X[i, 0] + 0.3)
    dt = np.full(800, 0.02)
    model = clone(model).fit(X[:1600], y[:1600], dt=np.repeat(dt, 2))
    line = np.polynomial.Polynomial.fit(X[:1600, 0], y[:1600], 1)
    errors = model.predict(X[1600:], dt) - y[1600:], line(X[1600:, 0]) - y[1600:]
    assert np.std(errors[0]) < 0.85 * np.std(errors[1])  # as the worst of them
    assert model.loss_curve_[-1] < model.loss_curve_[0] - 1.0


def test_unknown_targets_are_seen_but_not_fitted():
    X, y = delayed(600)
    y[::3] = np.nan
    other = X.copy()
    other[::3] += 1.0
    model = clone(SMALL).fit(X, y)
    assert np.isfinite(model.predict(X)).all()
    assert model.predict(X).tobytes() != clone(SMALL).fit(other, y).predict(X).tobytes()


def test_a_row_of_each_period_is_trained_on_one_with_a_target_where_there_is_one():
    dt = np.where(np.arange(100) == 0, 0.0, 0.005)
    known = np.arange(100) % 5 == 1
    rows = step_rows(dt, known, 0.02)
    np.testing.assert_array_equal(rows // 4, np.arange(25))
    assert known[rows].sum() == 20  # all of them: no period holds two
    np.testing.assert_array_equal(step_rows(dt, np.ones(100, bool), 0.02), np.arange(0, 100, 4))


def test_seed_decides_the_network():
    X, y = delayed(300)

    def predict(seed):
        return clone(SMALL).set_params(random_state=seed).fit(X, y).predict(X).tobytes()

    assert predict(1) == predict(1)
    assert predict(1) != predict(2)


def test_a_constant_target_and_a_constant_feature():
    X, y = delayed(300)
    X[:, 1], y[:, 1] = 0.1, -4.0
    model = clone(SMALL).fit(X, y)
    moved = np.column_stack([X[:, 0], np.full(300, 1e6)])
    assert model.predict(moved).tobytes() == model.predict(X).tobytes()
    np.testing.assert_allclose(model.predict(X)[:, 1], -4.0, atol=0.1)


@pytest.mark.parametrize(("dt", "known", "said"), [
    (0.0, 1.0, "too few rows for a history: the longest has 1, .* and a window 16"),
    (0.005, 1.0, "too few rows for a history: the longest has 10,"),
    (0.005, np.nan, "0 have a target"),
])  # fmt: skip
def test_rows_that_teach_nothing_are_refused(dt, known, said):
    (X, y), steps = delayed(300), np.full(300, dt)
    steps[:: 300 if np.isnan(known) else 10] = 0.0
    refused(f"^gru: .*{said}", SMALL.fit, X, known * y, dt=steps)


def test_too_few_rows_are_refused():
    assert GRU().minimum_rows(4) == 1000
    assert GRU().minimum_rows(100) == 5000
