"""The linear model, unless another is better on recordings that its fit did not see."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from sklearn.linear_model import Ridge
from sklearn.svm import SVR
from sklearn.tree import DecisionTreeRegressor
from tests.calibration.test_folds import jaw

import truejoint
from truejoint.calibration import Automatic, calibrate, read_calibration, write_calibration
from truejoint.calibration.choose import (
    Candidate,
    CrossValidation,
    at_most,
    decoupled,
    relative_error,
    share_of,
    stacking_weights,
)
from truejoint.errors import CalibrationError
from truejoint.estimators import NeuralNetwork, Polynomial, candidates, get_estimator
from truejoint.estimators.polynomial.learn import Raw
from truejoint.estimators.registry import PRESETS
from truejoint.features.feature_set import FeatureSet
from truejoint.recordings import Provenance, Recording

of_one_zero = partial(calibrate, zero="shared")
"""Whether zeros move is judged in `test_zero_validation`."""


def bent(seed: int, bend: float) -> Recording:
    """Jaw whose error has a slope, a bend and noise."""
    rng = np.random.default_rng(seed)
    t = np.arange(400) / 30.0
    q = 0.4 * np.sin(rng.uniform(0.8, 1.2) * t + seed)
    error = 0.01 + 0.05 * q + bend * q**2 + rng.normal(0.0, 1e-3, len(t))
    columns = {"t": t, "measured/jaw": q, "effort/jaw": np.cos(t + seed), "truth/jaw": q + error}
    return Recording.from_columns(columns, jaw(session=f"s{seed}").provenance)


def choose(bend: float, tried, count: int = 4):
    """Choose among some models of two features: the choice of features is tested by itself."""
    recordings = [bent(seed, bend) for seed in range(count)]
    return of_one_zero(recordings, Automatic(tried), features=["measured/jaw", "effort/jaw"])


def told(model):
    """What is said of each estimator, with the features that it is chosen with if it is."""
    tried = model.metadata["choice"]["tried"]
    return {
        trial["estimator"]: trial
        for trial in sorted(tried, key=lambda t: sum(t["weights"].values()))
    }


def test_what_is_better_on_unseen_recordings_is_chosen():
    jaws = get_estimator("ukf_elastic")  # which takes columns that these recordings lack
    model = choose(0.2, [jaws, Polynomial(2), DecisionTreeRegressor()])
    assert model.estimator == "poly2"
    tried = told(model)
    assert set(tried) == {"linear", "offset", "raw", "poly2", "DecisionTreeRegressor"}
    assert [name for name, trial in tried.items() if trial["weights"]["jaw"]] == ["poly2"]
    assert tried["linear"]["ratio"] == 1.0
    assert tried["poly2"]["ratio"] < 0.3
    assert tried["poly2"]["rmse"]["jaw"] == pytest.approx(1e-3, rel=0.1)
    assert tried["raw"]["rmse"]["jaw"] > 0.01
    assert model.metadata["choice"]["left_out"] == [f"recordings {k}" for k in (2, 4, 1, 3)]
    chosen = model.metadata["choice"]["chosen"]
    assert chosen["beyond"] == chosen["rmse"]
    assert chosen["inside"]["jaw"] == pytest.approx(1e-3, rel=0.1)
    unseen = chosen["median"]["jaw"]
    assert model.effort_baseline.residual[0] >= unseen > 0.5e-3  # what the fit did not see
    plain = calibrate([bent(seed, 0.2) for seed in range(4)], "poly2")
    unseen = bent(9, 0.2)
    np.testing.assert_array_equal(model.correct(unseen), plain.correct(unseen))


@pytest.mark.parametrize(
    ("count", "stated"), [(1, {"inside"}), (2, {"inside", "beyond"}), (10, {"beyond"})]
)
def test_errors_inside_recordings_and_beyond_them_are_stated_apart(count, stated):
    chosen = choose(0.2, [Polynomial(2)], count).metadata["choice"]["chosen"]
    assert {"inside", "beyond"} & set(chosen) == stated


@pytest.mark.parametrize("held", [True, False])
def test_a_member_is_held_to_its_range_where_it_errs_less_so(held):
    def farther(seed: int, amplitude: float) -> Recording:
        t = np.arange(400) / 30.0
        q = amplitude * np.sin(0.9 * t + seed)
        error = 0.2 * np.minimum(q**2, 0.04 if held else 1.0)
        noise = np.random.default_rng(seed).normal(0.0, 1e-4, len(t))
        columns = {"t": t, "measured/jaw": q, "truth/jaw": q + error + noise}
        return Recording.from_columns(columns, jaw(session=f"s{seed}").provenance)

    recordings = [farther(seed, 0.2 + 0.05 * seed) for seed in range(4)]
    model = of_one_zero(recordings, Automatic([Polynomial(2)]), features=["measured/jaw"])
    assert told(model)["poly2"]["held"] is held
    unseen = farther(9, 0.7)
    q, correction = unseen.column("measured/jaw"), model.correct(unseen) - unseen.measured
    alone = calibrate(recordings, "poly2", features=["measured/jaw"])
    went_on = alone.correct(unseen) - unseen.measured
    beyond = q > 0.36
    assert np.ptp(went_on[beyond]) > 0.02
    if held:
        assert np.ptp(correction[beyond]) < 1e-15
    else:
        np.testing.assert_array_equal(correction, went_on)


def two_joints(seed: int) -> Recording:
    """Two joints of which one has a bend in its error, the other noise."""
    rng = np.random.default_rng(seed)
    one, other = bent(seed, 0.3), bent(seed + 20, 0.0)
    columns = {f"{q}/elbow": other.column(f"{q}/jaw") for q in ("measured", "truth")}
    columns |= {f"{q}/shoulder": one.column(f"{q}/jaw") for q in ("measured", "truth")}
    columns |= {"t": one.t, "effort/elbow": rng.normal(size=len(one.t))}
    return Recording.from_columns(columns, Provenance("raven2", arm="left", session=f"s{seed}"))


def test_each_joint_gets_what_suits_it(tmp_path):
    recordings = [two_joints(seed) for seed in range(4)]
    model = calibrate(recordings, Automatic([Polynomial(2)]))
    assert model.estimator == "stack"
    tried = told(model)
    assert tried["poly2"]["weights"] == {"shoulder": 1.0, "elbow": 0.0}
    assert tried["linear"]["weights"] == {"shoulder": 0.0, "elbow": 1.0}
    assert model.metadata["choice"]["chosen"]["ratio"] < 0.6
    unseen = two_joints(9)
    alone = [calibrate(recordings, name).correct(unseen) for name in ("poly2", "linear")]
    for j in range(2):
        np.testing.assert_allclose(model.correct(unseen)[:, j], alone[j][:, j], rtol=0, atol=1e-8)
    write_calibration(model, tmp_path / "m.safetensors")
    read = read_calibration(tmp_path / "m.safetensors")
    np.testing.assert_array_equal(read.correct(unseen), model.correct(unseen))


@given(arrays(float, (40, 4), elements=st.floats(-1.0, 1.0)))
def test_weights_are_convex_and_no_member_alone_is_better(errors):
    products = errors.T @ errors / len(errors) + 1e-6 * np.eye(4)
    weights = stacking_weights(products)
    assert weights.sum() == pytest.approx(1.0)
    assert not ((weights != 0.0) & (weights < 0.05)).any()
    assert weights @ products @ weights <= 1.25 * np.diag(products).min()


def test_what_was_not_tried_everywhere_is_no_member():
    products = np.diag([4.0, 1.0, np.nan])
    np.testing.assert_allclose(stacking_weights(products), [0.2, 0.8, 0.0])


@given(arrays(float, (14, 6), elements=st.floats(0.0, 1.0)), st.integers(6, 14))
def test_a_model_has_no_more_members_than_a_mean_takes_and_each_joint_its_first(shares, count):
    weights = (shares + 1e-3) / (shares + 1e-3).sum(axis=0)
    kept = at_most(count, weights)
    assert np.count_nonzero(kept.any(axis=1)) == count
    np.testing.assert_allclose(kept.sum(axis=0), 1.0)
    assert np.all(kept[weights.argmax(axis=0), range(6)] > 0.0)
    few = np.where(np.arange(14)[:, None] < 6, weights, 0.0)
    assert at_most(count, few) is few


def test_a_part_that_is_easy_for_all_weighs_no_more_than_another():
    moving, resting = np.diag([100.0, 1.0]), np.diag([1e-4, 4e-4])
    table = errors_of(candidates()[3:4], [moving, moving, resting], count=2)
    assert table.weights()[1, 0] > 0.5


@pytest.mark.parametrize(("shared", "members", "left"), [(1.2, 1, 1.0), (0.0, 2, 2.0 / 3.0)])
def test_a_mean_is_taken_where_errors_differ_and_one_alone_where_they_do_not(shared, members, left):
    """By hand: of squares 1 and 2, weights 2/3 and 1/3 leave 2/3 where nothing is shared."""
    products = np.diag([100.0, 100.0, 100.0, 1.0, 2.0])
    products[3, 4] = products[4, 3] = shared
    table = errors_of(candidates()[3:5], [products * scale for scale in (1.0, 2.0, 3.0)], count=5)
    weights, square = table.combined()
    assert np.count_nonzero(weights) == members
    assert weights.sum() == pytest.approx(1.0)
    assert square[0, 0] == pytest.approx(left)


def test_an_error_is_relative_to_that_of_its_own_joint():
    squares = np.array([[4.0, 9e-6], [16.0, 1e-6]])  # folds, joints
    np.testing.assert_allclose(relative_error(squares, np.array([1.0, 1e-6])), [3.0, 2.0])


def errors_of(models, products, count: int) -> CrossValidation:
    """Table of three folds of one joint, of the first `count` candidates."""
    t = np.arange(20.0)
    part = Part(t, np.full(20, 1.0), np.sin(t)[:, None])
    usual = [get_estimator("linear"), get_estimator("offset"), Raw()]
    named = [*((model, True) for model in usual), *((model, False) for model in models)][:count]
    tried = [Candidate(model, ("measured/jaw",), "error", simple) for model, simple in named]
    table = CrossValidation([part], tried, 100)
    for candidate in table.candidates:
        candidate.folds = [0, 1, 2]
    table.products = [product[None] for product in products]
    return table


class Part:
    """Stands for rows of a recording."""

    feature_set = FeatureSet.parse(["measured/jaw"])

    def __init__(self, t: np.ndarray, dt: np.ndarray, targets: np.ndarray) -> None:
        self.t, self.dt, self.X, self.targets = t, dt, t[:, None], targets
        self.measured, self.recording = np.zeros_like(targets), None

    def __len__(self) -> int:
        return len(self.t)

    def fitted_targets(self, _target: str) -> np.ndarray:
        return self.targets


@given(st.lists(st.integers(1, 500), min_size=1, max_size=8), st.integers(8, 2000))
def test_short_recordings_give_all_rows_and_long_ones_share_the_rest(sizes, most):
    share = share_of(sizes, most)
    given_rows = sum(min(size, share) for size in sizes)
    assert given_rows <= most or sum(sizes) <= most
    assert given_rows == sum(sizes) or given_rows > most - len(sizes)


def test_the_linear_model_stays_where_nothing_is_better():
    tried = [Polynomial(2), DecisionTreeRegressor(), Ridge(1e-9), SVR(C=-1.0)]
    model = choose(0.0, tried)
    assert model.estimator == "linear"
    assert told(model)["DecisionTreeRegressor"]["note"] == "given up after 2 folds"
    assert told(model)["Ridge"]["ratio"] == pytest.approx(1.0)
    assert told(model)["SVR"]["folds"] == 0
    assert "cannot be fitted" in told(model)["SVR"]["note"]


def shifted(seed: int, zero: float) -> Recording:
    """Jaw whose error is noise about a zero."""
    recording = bent(seed, 0.0)
    noise = np.random.default_rng(seed).normal(0.0, 1e-3, len(recording))
    truth = recording.column("measured/jaw") + zero + noise
    return replace(recording, table=recording.table.assign(**{"truth/jaw": truth}))


def test_nothing_is_corrected_where_zeros_differ_and_nothing_else():
    recordings = [shifted(seed, zero) for seed, zero in enumerate((0.01, -0.01, 0.01, -0.01))]
    model = calibrate(recordings, Automatic([Polynomial(2)]))
    assert model.estimator == "raw"
    unseen = shifted(9, 0.0)
    np.testing.assert_array_equal(model.correct(unseen)[:, 0], unseen.column("measured/jaw"))
    assert truejoint.evaluate(model, unseen).score("raw", "jaw").rmse < 2e-3


def together(seed: int, *, coupled: bool) -> Recording:
    """Jaw whose load follows it but for a little that the error follows too, and one that does not.

    What the error follows is a motion of the base that no signal tells.
    """
    t = np.arange(1200) / 30.0
    base = np.sin(2.3 * t + seed)
    q = 0.4 * np.sin(0.7 * t + seed)
    effort = q + 0.01 * base if coupled else 0.4 * np.cos(1.1 * t)
    truth = q + 0.02 + 0.005 * base
    columns = {"t": t, "measured/jaw": q, "effort/jaw": effort, "truth/jaw": truth}
    return Recording.from_columns(columns, jaw(session=f"s{seed}").provenance)


def test_signals_that_always_move_together_are_not_set_against_each_other():
    recordings = [together(seed, coupled=True) for seed in range(2)]
    model = of_one_zero(recordings, Automatic([Polynomial(2)]))
    assert model.estimator == "offset"
    tried = told(model)
    for name in ("linear", "poly2"):
        assert tried[name]["note"] == "needs signals that move together: jaw"
        assert tried[name]["rmse"]["jaw"] < 0.3 * tried["offset"]["rmse"]["jaw"]
    unseen = together(9, coupled=False)
    linear = calibrate(recordings, "linear")
    assert np.std(unseen.error(("jaw",))) < 0.1 * np.std(
        unseen.column("truth/jaw") - linear.correct(unseen)[:, 0]
    )


def test_one_of_two_recordings_may_be_short_and_have_another_zero():
    few, many = shifted(0, 0.5).rows(np.arange(60)), shifted(1, 0.0)
    model = of_one_zero([few, many], Automatic([Polynomial(2)]))
    assert model.estimator in {"linear", "offset", "raw"}
    assert told(model)["offset"]["note"] == told(model)["raw"]["note"] == ""


def test_of_positions_the_linear_model_stays_where_no_other_can_be_used():
    recordings = [together(seed, coupled=True) for seed in range(2)]
    model = of_one_zero(recordings, Automatic([Polynomial(2)]), target="position")
    assert set(told(model)) == {"linear", "poly2"}
    assert sum(trial["weights"].get("jaw", 0.0) for trial in told(model).values()) == 1.0


@pytest.mark.parametrize(
    ("names", "moves"),
    [
        (["measured/jaw", "effort/jaw", "rate(measured/jaw, 0.1)"], [0, 5, 0]),
        (["measured/jaw", "cable/reset", "effort/jaw"], [0, 0, 5]),  # sensors of one joint
    ],
)
def test_the_features_of_one_signal_or_joint_come_apart_from_others_alike(names, moves):
    rows = np.arange(10.0)[:, None] + np.array([0.0, 10.0, 20.0])
    moved = decoupled(rows, FeatureSet.parse(names))
    for column, before, by in zip(moved.T, rows.T, moves, strict=True):
        np.testing.assert_array_equal(column, np.roll(before, by))


def test_what_is_believed_holds_weights_back():
    products, belief = np.diag([4.0, 1.0, 1.2]), np.array([0.5, 0.5, 0.0])
    free, held = stacking_weights(products), stacking_weights(products, belief)
    assert abs(held - belief).sum() < abs(free - belief).sum()
    assert held.sum() == pytest.approx(1.0)
    assert held[0] > free[0]


def test_where_time_runs_short_three_parts_are_judged_and_the_others_named():
    model = of_one_zero(
        [bent(seed, 0.2) for seed in range(6)], Automatic([Polynomial(2)], seconds=0)
    )
    choice = model.metadata["choice"]
    assert len(choice["left_out"]) == 3
    assert choice["not_judged"] == ["recordings 3", "recordings 5"]
    assert model.estimator == "poly2"


@pytest.mark.parametrize("seconds", [True, -1.0, np.nan])
def test_a_time_that_is_none_is_refused(seconds):
    with pytest.raises(CalibrationError, match="give a time"):
        Automatic([Polynomial(2)], seconds=seconds)


class Demanding(Polynomial):
    """A polynomial that asks for more rows than it takes."""

    needed = 0

    def minimum_rows(self, n_features: int) -> int:
        return self.needed


@pytest.mark.parametrize(("rows", "needed", "folds"), [
    ((100, 100, 100, 400), 350, 3),  # too few without the long one alone
    ((100, 300, 300, 300), 750, 1),  # enough without the short one alone
    ((200, 200, 200, 200), 700, 0),
])  # fmt: skip
def test_what_lacks_rows_without_one_recording_is_judged_by_the_others(
    monkeypatch, rows, needed, folds
):
    monkeypatch.setattr(Demanding, "needed", needed)
    recordings = [bent(seed, 0.2).rows(np.arange(n)) for seed, n in enumerate(rows)]
    model = of_one_zero(recordings, Automatic([Demanding(2)]))
    tried = told(model)["poly2"]
    n_rows, _, rest = tried["note"].partition(
        " rows with truth beside a part left out; poly2 needs "
    )
    assert int(n_rows) < needed
    assert rest.startswith(f"{needed}: record for longer")
    assert tried["folds"] == folds
    assert ("ratio" in tried) == (folds > 0)  # of what was fitted, not of what stands in for it
    assert model.estimator == ("poly2" if folds == 3 else "linear")


@pytest.mark.parametrize(
    ("tried", "said"),
    [
        (NeuralNetwork(hidden_layer_sizes=(8,) * 9), "it must be 1 to 8 layers"),
        (get_estimator("ukf_elastic"), "none of ukf_elastic can be tried"),
    ],
    ids=["a wrong parameter", "columns that recordings lack"],
)
def test_a_candidate_that_cannot_be_tried_is_refused(tried, said):
    with pytest.raises(CalibrationError, match=said):
        choose(0.2, [tried])


def test_what_only_works_offline_is_not_chosen():
    model = choose(0.2, [SVR(C=5.0, epsilon=0.05), Polynomial(3)])
    assert model.estimator == "polynomial"
    assert told(model)["SVR"]["note"].startswith("only works offline")


def with_current(seed: int) -> Recording:
    """Jaw whose error follows the motor's current."""
    recording = bent(seed, 0.0)
    current = np.random.default_rng(seed).normal(size=len(recording))
    moved = recording.column("truth/jaw") + 0.05 * current
    table = recording.table.assign(**{"current/jaw": current, "truth/jaw": moved})
    return replace(recording, table=table, units={**recording.units, "current/jaw": "A"})


def test_motor_currents_are_tried_where_no_features_are_asked_for():
    tried, seen = Automatic([Polynomial(2)]), list[float]()
    recordings = [with_current(seed) for seed in range(3)]
    model = calibrate(recordings, tried, progress=seen.append)
    assert model.feature_set.names[-1] == "current/jaw"
    assert seen == sorted(seen)  # though several sets of features are tried
    assert seen[-1] == 1.0
    some = [recordings[0], bent(1, 0.0), recordings[2]]
    assert of_one_zero(some, tried).feature_set.names[-1] == "effort/jaw"


def viscous(seed: int, rate_hz: float = 30.0) -> Recording:
    """Jaw that lags behind its motor by 60 ms."""
    t = np.arange(0.0, 14.0, 1.0 / rate_hz)
    pace = np.random.default_rng(seed).uniform(1.5, 2.5)
    q = 0.4 * np.sin(pace * t + seed)
    late = 0.4 * np.sin(pace * (t - 0.06) + seed)
    columns = {"t": t, "measured/jaw": q, "effort/jaw": np.cos(0.3 * t), "truth/jaw": late}
    return Recording.from_columns(columns, jaw(session=f"s{seed}").provenance)


def test_rates_are_tried_where_no_features_are_asked_for():
    recordings, tried = [viscous(seed) for seed in range(3)], Automatic([Polynomial(2)])
    model = of_one_zero(recordings, tried)
    assert model.feature_set.names[-1] == "rate(measured/jaw, 0.02)"
    tenth = [one.rows(np.arange(0, len(one), 3)) for one in recordings]  # 0.1 s, but for rounding
    features = [one["features"] for one in of_one_zero(tenth, tried).metadata["choice"]["tried"]]
    assert "rate(measured/jaw, 0.02)" in features[-1]
    asked = of_one_zero(recordings, tried, features=["measured/jaw", "effort/jaw"])
    assert asked.feature_set.names == ("measured/jaw", "effort/jaw")
    for rate_hz in (30.0, 1000.0):  # trained at 30 Hz
        unseen = viscous(9, rate_hz)
        left = (model.correct(unseen) - unseen.columns("truth", ["jaw"]))[len(unseen) // 10 :]
        assert np.sqrt(np.mean(left**2)) < 0.2 * np.sqrt(np.mean(unseen.error(["jaw"]) ** 2))


def test_features_that_do_not_help_are_tried_and_have_no_weight():
    recordings = [with_current(seed) for seed in range(4)]
    for one in recordings:
        one.table["truth/jaw"] -= 0.05 * one.table["current/jaw"]
    found = of_one_zero(recordings, Automatic([Polynomial(2)]))
    for feature in ("rate(measured/jaw, 0.02)", "current/jaw"):
        beside = [t for t in found.metadata["choice"]["tried"] if t["features"][-1] == feature]
        assert [trial["weights"] for trial in beside] == [{"jaw": 0.0}] * len(beside) != []
    assert found.feature_set.names == ("measured/jaw", "effort/jaw")


def test_a_column_that_one_recording_lacks_is_not_learnt_of_and_told():
    first, *others = (bent(seed, 0.2) for seed in range(3))
    table = first.table.drop(columns="effort/jaw")
    units = {k: v for k, v in first.units.items() if k != "effort/jaw"}
    recordings = [replace(first, table=table, units=units), *others]
    model = of_one_zero(recordings, Automatic([Polynomial(2)]))
    assert model.feature_set.names == ("measured/jaw",)
    assert model.metadata["choice"]["not_in_all"] == ["effort/jaw"]


def test_a_copy_of_a_recording_is_not_judged_by_the_other():
    once = [bent(0, 0.2), bent(1, 0.2)]
    alone, twice = (
        of_one_zero(ones, Automatic([Polynomial(2)])) for ones in (once, [*once, *once])
    )
    assert told(twice)["poly2"]["rmse"] == told(alone)["poly2"]["rmse"]
    assert twice.metadata["choice"]["left_out"] == alone.metadata["choice"]["left_out"]


def test_features_that_take_more_rows_than_there_are_are_left_out():
    recordings = [with_current(seed).rows(np.arange(18)) for seed in range(3)]
    model = of_one_zero(recordings, Automatic([Polynomial(2)]))
    assert model.feature_set.names == ("measured/jaw", "effort/jaw")
    assert [trial["folds"] for trial in model.metadata["choice"]["tried"]] == [3, 3, 3, 0, 0]


def test_a_name_has_it_choose_and_progress_is_told(monkeypatch):
    few = {name: PRESETS[name] for name in ("offset", "linear", "poly2_ridge")}
    monkeypatch.setattr("truejoint.estimators.wrapped.PRESETS", few)
    seen = []
    model = truejoint.calibrate([bent(0, 0.2)], "auto", progress=seen.append)
    assert model.estimator == "poly2_ridge"
    assert seen == sorted(seen)
    assert len(set(seen)) > 5  # parts left out, each with its candidates, then the fit
    assert seen[-1] == 1.0
    assert set(told(model)) == {"linear", "offset", "raw", "poly2_ridge"}


def test_of_many_rows_some_are_run_over_and_each_history_still_starts():
    t = np.arange(1000) * 0.01
    dt = np.where(np.isin(np.arange(1000), [0, 501]), 0.0, 0.01)
    targets = np.where(np.arange(1000) % 30 == 7, 1.0, np.nan)[:, None]
    part = Part(t, dt, targets)
    rows = CrossValidation([part], [], 50)
    kept = rows.rows
    assert 50 <= len(kept) <= 100
    assert np.isfinite(rows.targets).sum() == 34
    np.testing.assert_array_equal(rows.X[:, 0], t[kept])
    fresh = np.flatnonzero(rows.dt == 0.0)
    assert fresh.tolist() == [0, np.searchsorted(kept, 501)]
    np.testing.assert_allclose(np.diff(t[kept])[rows.dt[1:] > 0], rows.dt[rows.dt > 0])
    whole = CrossValidation([part], [], 1000)
    np.testing.assert_array_equal(whole.rows, np.arange(1000))
    np.testing.assert_allclose(whole.dt, dt, atol=1e-12)


class Counting(Polynomial):
    """A polynomial that counts samples."""

    @property
    def family(self):
        return replace(super().family, counts_samples=True)


def test_rows_that_are_left_out_do_not_move_what_is_judged(monkeypatch):
    tried = [Polynomial(2)]
    every = told(choose(0.2, tried, count=2))["poly2"]["rmse"]["jaw"]
    monkeypatch.setattr("truejoint.calibration.choose.MOST_ROWS", 200)
    few = told(choose(0.2, tried, count=2))["poly2"]["rmse"]["jaw"]
    counting = [*tried, Counting(3)]  # of rows that are one step apart
    assert told(choose(0.2, counting, count=2))["poly2"]["rmse"]["jaw"] == every
    assert few != every
    assert few == pytest.approx(every, rel=0.2)


def test_a_part_without_which_a_feature_never_changes_is_judged_without_the_feature():
    recording = bent(0, 0.2)
    effort = np.where(recording.t < 2.0, recording.column("effort/jaw"), 1.0)
    table = recording.table.assign(**{"effort/jaw": effort})
    model = of_one_zero(replace(recording, table=table), Automatic([Polynomial(2)]))
    assert model.metadata["choice"]["left_out"] == [f"time {k}" for k in (2, 4, 1, 3, 5)]
    tried = [one for one in model.metadata["choice"]["tried"] if len(one["features"]) == 2]
    assert [one["folds"] for one in tried] == [5, 5, 5, 5]


def test_a_recording_too_short_for_it_is_refused():
    with pytest.raises(CalibrationError, match="too few"):
        calibrate([jaw(n=40)], "auto")
    short, lags = bent(0, 0.2), [f"lag(measured/jaw, {k})" for k in range(1, 7)]
    short = short.rows(short.t < 2.0)
    said = r"\d+ rows with truth beside a part left out; linear needs 90: record for longer, or"
    with pytest.raises(CalibrationError, match=said):
        calibrate([short], "auto", features=["measured/jaw", "effort/jaw", *lags])
