"""Rich plays: what the model sees, and what is refused."""

import numpy as np
import pytest
from tests.refusals import refused
from tests.runtime.streams import SIGNALS, recording

from truejoint.calibration import calibrate
from truejoint.errors import CalibrationError
from truejoint.estimators import Plays, Polynomial
from truejoint.estimators.plays import run as play_bank
from truejoint.estimators.plays.learn import capstan_turns
from truejoint.estimators.plays.run import expand_rows
from truejoint.estimators.polynomial.learn import blocks
from truejoint.features.feature_set import FeatureSet, time_steps
from truejoint.robots import get_robot

T = np.arange(0.0, 40.0, 0.02)


def slack(seed: int = 0, n: int = 2000) -> tuple[np.ndarray, np.ndarray]:
    """Positions and load (n, 2), and an error that is a loop whose width grows with the load."""
    rng = np.random.default_rng(seed)
    phase = np.cumsum(rng.uniform(0.2, 1.8, n)) * 0.02
    X = np.column_stack([np.sin(phase), np.cos(0.37 * phase + seed)])
    return X, 0.05 * np.sign(np.gradient(X[:, 0])) * (1.5 + X[:, 1])


def test_the_model_sees_scaled_features_plays_and_low_passes():
    signals = ("measured/shoulder", "effort/shoulder")
    run = recording(T[:300])
    run = run.rows(np.r_[0:150, 200:300])
    X = FeatureSet.parse(signals).compute(run)
    dt = time_steps(run.t, 0.2)
    low, high = X.min(axis=0), X.max(axis=0)
    arrays = {"centre": (low + high) / 2, "inverse_half_range": 2 / (high - low)}
    params = {**play_bank.BARE, "plays": (0.1, 0.4), "time_constants": (0.3,)}
    kept = np.arange(len(X)) % 3 == 1
    seen = expand_rows(params, arrays, X, dt, kept)
    half = (high - low) / 2
    widths = [(s, float(w * h)) for s, h in zip(signals, half, strict=True) for w in (0.1, 0.4)]
    names = [f"play({s}, {width!r})" for s, width in widths]
    names += [f"lowpass({s}, 0.3)" for s in signals]
    history = FeatureSet.parse(names).compute(run, 0.2)
    scaled = (X - arrays["centre"]) / half
    of = [0, 0, 1, 1, 0, 1]
    size = np.array([0.1, 0.4, 0.1, 0.4, 1.0, 1.0]) * half[of]
    expected = np.column_stack([scaled, (history - X[:, of]) / size])
    np.testing.assert_allclose(seen, expected[kept], atol=1e-9)
    assert np.abs(scaled).max() == pytest.approx(1.0)
    assert seen.shape == (int(kept.sum()), play_bank.n_seen(params, 2))


def test_of_capstans_the_angles_are_seen():
    X, _ = slack(n=50)
    turns = ((11.0, 0.0), (1.5, -9.0))
    arrays = {"centre": np.full(2, 0.3), "inverse_half_range": np.array([1.0, 0.5])}
    own = {"plays": (0.1,), "time_constants": (0.3,), "turns": turns}
    params = play_bank.BARE | own
    seen = expand_rows(params, arrays, X, np.full(50, 0.02), np.ones(50, bool))
    angles = X @ np.transpose(turns)
    expected = np.stack([np.cos(angles), np.sin(angles)], axis=2).reshape(50, 4)
    np.testing.assert_allclose(seen[:, 6:10], expected, atol=1e-14)
    assert seen.shape == (50, play_bank.n_seen(params, 2)) == (50, 6 + 4)


def test_capstans_turn_as_the_transmission_says():
    raven = get_robot("raven2")
    names = ("effort/elbow", "measured/shoulder", "measured/elbow")
    turns = capstan_turns(names, raven, ("shoulder", "elbow", "insertion"))
    motors = raven.transmission.motor_from_joint([0.3, 0.7, 0.1, 0.0, 0.0, 0.0, 0.0])
    at_capstans = motors / raven.transmission.gear
    # Features do not tell where the insertion is, which turns its own capstan.
    np.testing.assert_allclose(np.dot(turns, [5.0, 0.3, 0.7]), at_capstans[:2], rtol=1e-12)
    assert capstan_turns(names, get_robot("davinci_grasper"), ("jaw",)) == ()


def eccentric(q: np.ndarray) -> np.ndarray:
    """Error of two joints on capstans of 11 and 10 turns a turn, the first of which pulls both."""
    angles = q @ np.array([[11.0, 1.5], [0.0, 10.0]])
    return 0.02 * q[:, ::-1] ** 2 + 0.004 * np.cos(angles + np.array([0.4, 2.0]))


def test_capstans_that_run_out_are_known_on_motion_that_was_not_trained():
    zigzag = np.interp(np.linspace(0.0, 24.0, 3000), range(25), 0.4 * (-1.0) ** np.arange(25))
    rows = np.column_stack([zigzag, np.linspace(-0.4, 0.4, 3000)])
    other = np.random.default_rng(0).uniform(-0.4, 0.4, (500, 2))
    model = Plays(turn=True, turns=((11.0, 0.0), (1.5, 10.0)))
    fresh = np.zeros(500)
    left, without = (
        np.std(m.fit(rows, eccentric(rows)).predict(other, fresh) - eccentric(other))
        for m in (model, Plays())
    )
    assert left < 0.3 * without  # the plays of which explain the zig-zag alone


def test_products_of_positions_that_turn_capstans_are_seen_behind_an_effort_too():
    random = np.random.default_rng(0)
    q, effort = random.uniform(-0.4, 0.4, (800, 2)), random.normal(size=(800, 1))
    model = Plays(turn=True, turns=((0.0, 11.0, 0.0), (0.0, 1.5, 10.0)))
    model.fit(np.hstack([effort, q])[:400], eccentric(q[:400]))
    left = model.predict(np.hstack([effort, q])[400:], np.zeros(400)) - eccentric(q[400:])
    assert np.std(left) < 1e-3  # of 6e-3 that are squares of positions


@pytest.mark.parametrize("turns", [None, ()])
def test_where_capstans_are_not_known_it_says_what_to_do(turns):
    with pytest.raises(CalibrationError, match="run_out must know how capstans turn; take a robot"):
        Plays(turn=True, turns=turns).fit(*slack())


@pytest.mark.parametrize(("histories", "seen"), [(5, 1), (4, 4)])
def test_a_recording_that_is_hidden_changes_no_blocks_of_the_ridge(monkeypatch, histories, seen):
    """Of five, four are cut as five are: a choice judges what it then fits to all."""
    (X, y), told = slack(0), []
    dt = np.where(np.arange(2000) % (2000 // histories) == 0, 0.0, 0.02)
    y = np.where(np.arange(2000) >= 1600, np.nan, y)
    monkeypatch.setattr(
        "truejoint.estimators.polynomial.learn.blocks", lambda own: told.append(own) or blocks(own)
    )
    Plays().fit(X, y, dt=dt)
    assert (told[0].size, (told[0] == 0.0).sum()) == (1600, seen)


def test_it_knows_a_loop_whose_width_grows_with_the_load():
    (X, y), (X_new, y_new) = slack(0), slack(1)
    linear = Polynomial(1).fit(X, y)
    rich = Plays().fit(X, y)
    left, before = (np.std(y_new - m.predict(X_new)) for m in (rich, linear))
    assert left < 0.5 * before


def test_trees_learn_what_the_ridge_before_them_is_not_fitted_to():
    X, y = slack()
    far = np.flatnonzero((X[:, 0] > 0.9) & (X[:, 1] > 0.6))
    assert 0 < len(far) < 0.05 * len(X)
    burst = y.copy()
    burst[far] += 3.0
    elsewhere = np.setdiff1d(np.arange(len(X)), far)
    model = Plays("trees").fit(X, burst)
    left = model.predict(X) - burst
    assert np.std(left[far]) < 0.3
    ridge, _ = model.model_.members_
    assert ridge.trimmed
    assert np.std(left[elsewhere]) < 0.5 * np.std(y)


def test_what_never_changes_is_not_learnt_of():
    X, y = slack()
    constant = np.column_stack([X, np.full(len(X), 3.0)])
    model = Plays().fit(constant, y)
    moved = constant + np.array([0.0, 0.0, 5.0])
    np.testing.assert_array_equal(model.predict(moved), model.predict(constant))


def test_rows_beyond_the_most_are_left_out_of_the_fit_alone():
    X, y = slack()
    few = Plays(rows=500).fit(X, y)
    known = np.where(np.arange(len(y)) % 4 == 0, y, np.nan)
    low_high = known.copy()
    low_high[[X[:, 0].argmin(), X[:, 0].argmax()]] = np.nan
    again = Plays().fit(X, known)
    np.testing.assert_allclose(few.predict(X), again.predict(X), atol=0.02)


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ({"learner": "forest"}, "learner is 'forest'; it must be one of ridge, trees"),
        ({"plays": (0.0,)}, "plays is .*; it must be 0 to 32 half-widths"),
        ({"plays": (1.1,)}, "plays is .*; it must be 0 to 32 half-widths"),
        ({"time_constants": (0.0,)}, "time_constants is .*; it must be 0 to 8 times"),
        ({"rows": 0}, "rows is 0; it must be an integer from 1"),
        ({"turns": ((1.0, 0.0),)}, "turns are given; they take turn=True as well"),
        ({"positions": (0, 1)}, "positions are given; they take couple=True as well"),
        ({"couple": True, "positions": 2}, "positions is 2; it must be places of features"),
        ({"couple": True, "positions": (0, 2)}, "positions .*; it must be of features 0 to 1"),
    ],
)
def test_a_wrong_parameter_is_refused(how, said):
    fitted = Plays().fit(*slack(n=600))
    for model in (Plays(**how), fitted.set_params(**how)):
        refused(said, model.fit, *slack(n=600))


def test_a_gaussian_process_knows_which_way_the_joint_goes():
    t = np.arange(0.0, 40.0, 0.02)
    q = np.sin(1.3 * t)[:, None]
    late = 0.05 * np.cos(1.3 * t) * (1.0 + q[:, 0])
    model = Plays(learner="gaussian_process").fit(q[:1500], late[:1500], dt=np.full(1500, 0.02))
    assert model.name == "gp_lowpass"
    left = late[1500:] - model.predict(q[1500:], np.full(500, 0.02))
    assert np.std(left[50:]) < 0.1 * np.std(late)


def test_too_few_rows_are_refused():
    with pytest.raises(CalibrationError, match="rows with truth; rich_play with 4 features needs"):
        calibrate(recording(T[:200]), "rich_play", features=SIGNALS)


def test_a_model_with_a_memory_or_for_some_outputs_alone_is_refused():
    params = dict(Plays().fit(*slack(n=600)).model_params())
    remembers = params | {"members": (("plays", params, ()),)}
    refused("it must be one without a memory", play_bank.FAMILY.shapes, remembers, 2, 1)
    ((family, own, _),) = params["members"]
    some = params | {"members": ((family, own, (0,)),)}
    refused("its parameters and no outputs", play_bank.FAMILY.check_params, some)
