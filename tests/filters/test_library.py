"""What a prototype needs: plain functions, noise by row, several sensors, a lag, a likelihood."""

from __future__ import annotations

import math
import re
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numba import njit

from truejoint.filters import (
    FilterError,
    FilterStatus,
    Gate,
    StateSpaceModel,
    UnscentedFilter,
    linear_model,
    maximum_likelihood,
)

DT = 0.01
PRIOR = {"x0": [0.3, 0.0], "P0": np.diag([1e-2, 1e-2])}
NOISE = np.diag([1e-8, 1e-6])


def swing(x, u, dt, parameters, out):
    out[0] = x[0] + dt * x[1]
    out[1] = x[1] - dt * parameters[0] * math.sin(x[0])


def encoder(x, u, parameters, out):
    out[0] = x[0]


def tip(x, u, parameters, out):
    out[0] = math.sin(x[0])
    out[1] = math.cos(x[0])


def pendulum(compiled=njit, **changes):
    given = {
        "transition": compiled(swing), "measurement": compiled(encoder), "process_noise": NOISE,
        "measurement_noise": [[1e-4]], "states": ("angle", "rate"), "measurements": ("encoder",),
        "parameters": (9.81,),
    }  # fmt: skip
    return StateSpaceModel(**(given | changes))


@pytest.fixture(scope="module")
def unscented():
    return UnscentedFilter(pendulum())


@pytest.fixture(scope="module")
def z():
    rng, x, rows = np.random.default_rng(3), np.array([0.4, 0.0]), []
    for _ in range(300):
        x = x + DT * np.array([x[1], -9.81 * math.sin(x[0])])
        rows.append(x[0] + rng.normal(0.0, 1e-2))
    return np.array(rows)[:, None]


def test_plain_functions_give_the_bits_of_compiled_ones_and_say_that_they_are_slow(unscented, z):
    with pytest.warns(RuntimeWarning, match="swing is plain Python, which is slow") as told:
        plain = UnscentedFilter(pendulum(lambda function: function))
    assert len(told) == 2
    assert Path(told[0].filename) == Path(__file__)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = plain.run(z, dt=DT, **PRIOR)
    np.testing.assert_array_equal(found.x, unscented.run(z, dt=DT, **PRIOR).x)


@pytest.mark.filterwarnings("ignore:.*plain Python")
def test_a_plain_function_that_raises_counts_as_failed(z, capfd):
    def fails(x, u, parameters, out):
        if x[0] < 0.1:
            raise ValueError("out of sight")
        out[0] = x[0]

    model = pendulum(measurement=fails)
    status = UnscentedFilter(model).run(z[:60], dt=DT, **PRIOR).status
    assert status[0] == 0
    assert status[-1] & FilterStatus.MEASUREMENT_FAILED
    assert "out of sight" not in "".join(capfd.readouterr())
    with pytest.raises(FilterError, match=r"measurement: .*takes 3 positional arguments"):
        pendulum(measurement=lambda x, u, out: None)
    with pytest.raises(FilterError, match="does not write element 0"):
        pendulum(measurement=lambda x, u, parameters, out: None)


def test_noise_may_vary_by_row(unscented, z):
    variances = np.where(np.arange(len(z)) < 150, 1e-4, 4e-2)[:, None]
    found = unscented.run(z, dt=DT, R=variances, **PRIOR)
    first = unscented.run(z[:150], dt=DT, **PRIOR)
    coarse = UnscentedFilter(replace(unscented.model, measurement_noise=[[4e-2]]))
    rest = coarse.run(z[150:], x0=first.x[-1], P0=first.P[-1], dt=DT)
    np.testing.assert_allclose(found.x, np.vstack([first.x, rest.x]), rtol=1e-12)
    np.testing.assert_allclose(found.loglik[150:], rest.loglik, rtol=1e-9)
    state = unscented.initial_state(**PRIOR)
    for k in range(len(z)):
        unscented.step(state, z[k], None, DT, R=[[4e-2]] if k >= 150 else None)
    np.testing.assert_array_equal(state.x, found.x[-1])
    # One step's noise is not the next one's.
    again = unscented.initial_state(**PRIOR)
    unscented.step(again, z[0], None, DT, R=[[1e6]])
    assert again.P[0, 0] == pytest.approx(0.01, rel=0.01)
    unscented.step(again, z[1], None, DT)
    assert again.P[0, 0] < 2e-4


@pytest.mark.parametrize(
    ("R", "message"),
    [
        (np.ones((9, 1)), r"R: shape is \(9, 1\), must be \(300, 1, 1\)"),
        (-np.ones((300, 1)), "R: variance -1 on the diagonal"),
        (np.full((300, 1), np.nan), "R: holds NaN"),
        ("no", "R: give numbers"),
    ],
)
def test_noise_that_is_none_is_refused(unscented, z, R, message):
    with pytest.raises(FilterError, match=message):
        unscented.run(z, dt=DT, R=R, **PRIOR)


@pytest.fixture(scope="module")
def both():
    return pendulum(
        measurement=(njit(encoder), njit(tip)),
        measurement_noise=([[1e-4]], np.diag([1e-3, 2e-3])),
        measurements=(("encoder",), ("east", "north")),
    )


def test_several_sensors_are_one_measurement(both, unscented, z):
    assert both.measurements == ("encoder", "east", "north")
    np.testing.assert_array_equal(np.diag(both.measurement_noise), [1e-4, 1e-3, 2e-3])
    seen = np.hstack([z, np.sin(z), np.cos(z)])
    fused = UnscentedFilter(both).run(seen, dt=DT, **PRIOR)
    alone = unscented.run(z, dt=DT, **PRIOR)
    assert (fused.P[:, 0, 0] < alone.P[:, 0, 0]).all()
    seen[:, 1:] = np.nan  # a camera that sees nothing
    blind = UnscentedFilter(both).run(seen, dt=DT, **PRIOR)
    np.testing.assert_allclose(blind.x, alone.x, rtol=1e-12)
    assert (blind.status == FilterStatus.PARTIAL).all()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"measurement_noise": ([[1.0]],)}, "2 measurement functions: give as many"),
        ({"measurements": ("a", "b")}, "2 measurement functions: give as many"),
        ({"measurements": (("a",), ("b",))}, "noise of b: shape is"),
        ({"measurements": (("a",), ("a", "b"))}, "different names"),
    ],
)
def test_sensors_that_do_not_fit_together_are_refused(changes, message):
    given = {
        "measurement": (njit(encoder), njit(tip)),
        "measurement_noise": ([[1e-4]], np.diag([1e-3, 2e-3])),
        "measurements": (("encoder",), ("east", "north")),
    }
    with pytest.raises(FilterError, match=message):
        pendulum(**given | changes)


@pytest.mark.parametrize("square_root", [False, True])
def test_a_lag_knows_just_the_rows_within_it(unscented, z, square_root):
    estimator = replace(unscented, square_root=square_root)
    seen = z[:60].copy()
    seen[20:30] = np.nan
    result = estimator.run(seen, dt=DT, **PRIOR)
    lagged = estimator.smooth(result, lag=7)
    for k in (0, 15, 25, 40, 59):
        known = estimator.run(seen[: k + 8], dt=DT, **PRIOR)
        truth = estimator.smooth(known)
        np.testing.assert_array_equal(lagged.x[k], truth.x[k])
        np.testing.assert_array_equal(lagged.P[k], truth.P[k])
    np.testing.assert_array_equal(estimator.smooth(result, lag=0).x, result.x)
    whole = estimator.smooth(result)
    np.testing.assert_array_equal(estimator.smooth(result, lag=1000).P, whole.P)
    assert (whole.P[:50, 0, 0] <= lagged.P[:50, 0, 0] * (1 + 1e-9)).all()
    with pytest.raises(FilterError, match="lag is -1"):
        estimator.smooth(result, lag=-1)


def noisy(parameters):
    model = linear_model(
        [[1.0]], [[]], [[1.0]], [[]], [[0.0]], [[parameters["variance"]]],
        states=("level",), measurements=("z",),
    )  # fmt: skip
    return UnscentedFilter(model)


def test_the_likelihood_of_a_constant_is_largest_at_the_sample_variance():
    """Known mean: variance sum(z^2) / N, of deviation variance sqrt(2 / N)."""
    z = np.random.default_rng(1).normal(0.0, 0.3, 500)
    known = {"x0": [0.0], "P0": [[0.0]], "dt": 1.0}
    fit = maximum_likelihood(noisy, {"variance": 5.0}, z, **known)
    best = float(np.mean(z**2))
    assert fit.values["variance"] == pytest.approx(best, rel=2e-4)
    assert fit.deviations["variance"] == pytest.approx(best * math.sqrt(2.0 / 500), rel=1e-3)
    there = -0.5 * 500 * (math.log(2.0 * math.pi * best) + 1.0)
    assert fit.loglik == pytest.approx(there, rel=1e-6)
    assert fit.unscented.model.measurement_noise[0, 0] == fit.values["variance"]


def test_a_pendulum_tells_its_parameter_within_what_it_states(unscented, z):
    def of(parameters):
        return replace(unscented, model=replace(unscented.model, parameters=[parameters["g"]]))

    fit = maximum_likelihood(of, {"g": 7.0}, z, dt=DT, **PRIOR)
    assert abs(fit.values["g"] - 9.81) < 3.0 * fit.deviations["g"] < 1.0


def test_what_a_record_does_not_tell_has_no_deviation():
    z = np.random.default_rng(1).normal(0.0, 0.3, 50)
    start = {"variance": 1.0, "idle": -2.0}
    fit = maximum_likelihood(noisy, start, z, x0=[0.0], P0=[[0.0]], dt=1.0)
    assert not np.isfinite(fit.deviations["idle"])
    assert fit.values["idle"] < 0.0


def test_a_likelihood_that_cannot_be_had_is_refused(unscented, z):
    with pytest.raises(FilterError, match="other than 0"):
        maximum_likelihood(noisy, {"variance": 0.0}, z, x0=[0.0], P0=[[0.0]], dt=1.0)
    for start in ({"variance": "1"}, {"variance": np.nan}):
        with pytest.raises(FilterError, match="other than 0"):
            maximum_likelihood(noisy, start, z)
    with pytest.raises(FilterError, match="'variance' is a str, not a mapping; give where each"):
        maximum_likelihood(noisy, "variance", z)
    with pytest.raises(FilterError, match="'noisy' is a str, not a function; give one"):
        maximum_likelihood("noisy", {"variance": 1.0}, z)
    with pytest.raises(FilterError, match="this is a dict, not a filter; filter_of is to"):
        maximum_likelihood(dict, {"variance": 1.0}, z)
    gated = replace(unscented, gate=Gate(0.99))
    with pytest.raises(FilterError, match="has a gate"):
        maximum_likelihood(lambda _: gated, {"g": 9.0}, z, dt=DT, **PRIOR)
    impossible = np.full((5, 1), np.inf)
    with pytest.raises(FilterError, match=r"gives .*INVALID_MEASUREMENT.*; start elsewhere"):
        maximum_likelihood(lambda _: unscented, {"g": 9.0}, impossible, dt=DT, **PRIOR)


def test_the_textbook_of_the_docs_gives_the_kernels_numbers(unscented, z):
    page = Path(__file__).parents[2] / "docs" / "filter.md"
    (code,) = (
        block
        for block in re.findall(r"```python\n(.*?)```", page.read_text("utf-8"), re.DOTALL)
        if "def textbook" in block
    )
    names: dict = {}
    exec(code, names)  # noqa: S102 - our own page

    def f(x):
        return np.array([x[0] + DT * x[1], x[1] - DT * 9.81 * math.sin(x[0])])

    states = names["textbook"](
        f, lambda x: x[:1], NOISE, np.array([[1e-4]]), z, np.array(PRIOR["x0"]), PRIOR["P0"]
    )
    np.testing.assert_allclose(unscented.run(z, dt=DT, **PRIOR).x, states, rtol=1e-9, atol=1e-12)
