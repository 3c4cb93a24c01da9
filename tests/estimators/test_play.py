from __future__ import annotations

import numpy as np
import pytest
from tests.estimators.conftest import columns, fitted, loaded_run, rms_deg

from truejoint.errors import CalibrationError
from truejoint.estimators import GatedPlay, Play
from truejoint.estimators.plays.gated_rows import LAYOUT, no_more, redescending
from truejoint.estimators.plays.jaw_bank import bank_columns
from truejoint.estimators.plays.jaw_plays import ridge
from truejoint.simulation.forceps.load import LoadTest

RESET = Play(("reset",))
BOTH = Play(("reset", "motor"))


def test_bank_is_powers_and_plays():
    rng = np.random.default_rng(0)
    values = np.cumsum(rng.normal(0.0, 1e-5, 500))
    dt = np.full(500, 5e-3)
    dt[[0, 200]] = 0.0
    widths = np.array([5e-6, 4e-5])
    out = np.empty((500, 5))
    bank_columns(dt, values, 1e4, widths, out)
    for column, width in enumerate(widths):
        output = 0.0
        for i, value in enumerate(values):
            if i in (0, 200):
                output = value
            elif value - output > width:
                output = value - width
            elif output - value > width:
                output = value + width
            assert out[i, 3 + column] == pytest.approx((value - output) / width, abs=1e-9)
    assert np.allclose(out[:, 2], (1e4 * values) ** 3, rtol=1e-12)


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
        for model in (RESET, BOTH, GatedPlay())
    }
    assert max(error.values()) <= 0.05  # the reference encoder itself: 0.032
    assert error["play_both"] < error["play_reset"]


def test_a_load_is_not_taken_for_a_motion(pair):
    test = LoadTest(0.2)
    run = loaded_run(test)
    still = run.t >= test.phases["IV"][0]
    worst = {}
    for model in (BOTH, GatedPlay()):
        error = fitted(pair, model).predict(columns(run, model)) - run.column("truth/jaw")
        worst[model.name] = np.degrees(np.sqrt(np.mean(error[still] ** 2)))
    assert worst["play_both"] > 0.3
    assert worst["play_gated"] < 0.15


def test_its_deviation_grows_with_a_load_as_its_error_does(pair):
    model = fitted(pair, GatedPlay())
    test = LoadTest(0.2)
    run = loaded_run(test)
    state, angles, widths = model.start(), [], []
    state.memory.memory[LAYOUT.fields["deviations"].index] = 1.0
    for i, row in enumerate(columns(run, model)):
        angles.append(model.step(state, 5e-3 if i else 0.0, row)[0])
        widths.append(state.half_width[0])
    errors, widths = np.array(angles) - run.column("truth/jaw"), np.array(widths)
    moving, hung = (
        (run.t >= test.phases[phase][0]) & (run.t <= test.phases[phase][1]) for phase in ("I", "IV")
    )
    together, alone = model.arrays_["misfit"]
    before, after = widths[moving].mean(), widths[hung].mean()
    assert together <= before < 1.2 * together
    # Left alone, and standing, where a load may turn it unseen.
    assert after == pytest.approx(np.linalg.norm([together, alone, alone]), rel=1e-3)
    inside = np.abs(errors) <= 1.645 * widths  # a stated 90 %
    assert 0.85 < inside[moving].mean() < 0.95


@pytest.mark.parametrize(
    ("value", "before", "left"),
    [(0.3, 0.1, 0.1), (0.1, 0.3, 0.1), (-0.2, 0.1, 0.0), (-0.3, -0.1, -0.1), (0.2, 0.0, 0.0)],
)
def test_what_is_believed_may_fall_and_not_grow(value, before, left):
    assert no_more(value, before) == left


@pytest.mark.parametrize("drift", [-8e-6, 8e-6])
def test_what_the_sides_come_to_differ_by_while_the_motor_stands_is_not_believed(pair, drift):
    """A load that moves the reset cable alone, on a jaw at rest; then the motor goes on."""
    model, at_rest, goes_on = fitted(pair, GatedPlay()), 2200, 2400
    X = columns(pair.verification, model)[np.minimum(np.arange(2500), 2000)]
    X[:, 1] += drift * np.clip((np.arange(2500) - at_rest) / 100.0, 0.0, 1.0)
    X[goes_on:, 0] += 0.02
    dt = np.r_[0.0, np.full(2499, 5e-3)]
    reset = fitted(pair, RESET).evaluate(X[:, 1:], dt)[:, 0]
    difference = fitted(pair, BOTH).evaluate(X, dt)[:, 0] - reset
    believed = model.evaluate(X, dt)[:, 0] - reset
    gate = float(model.arrays_["gate"][0])
    whole = np.array([redescending(d, gate) for d in difference])
    before, after = whole[at_rest], whole[goes_on - 1]
    assert abs(after - before) > 1e-4  # the load makes the sides differ otherwise than they did
    low, high = sorted((0.0, before))
    assert believed[goes_on - 1] == pytest.approx(np.clip(after, low, high), abs=1e-12)
    for rows in (slice(1100, 2000), slice(goes_on, None)):  # it moves
        assert np.abs(believed - whole)[rows].max() < 1e-12


def test_gate_is_continuous_and_lets_go():
    sizes = np.linspace(-0.5, 0.5, 2001)
    values = np.array([redescending(d, 0.1) for d in sizes])
    inside = np.abs(sizes) <= 0.1
    assert np.array_equal(values[inside], sizes[inside])
    assert not values[np.abs(sizes) >= 0.2].any()
    assert np.abs(np.diff(values)).max() < 1.01 * (sizes[1] - sizes[0])


@pytest.mark.parametrize(
    "model",
    [
        Play(("reset",), degree=0),
        Play(("reset",), reset_widths=()),
        Play(("reset",), reset_widths=(1e-5, -1e-5)),
        Play(drive_widths=(0.0,)),
        Play(penalty=-1.0),
        GatedPlay(gate=0.0),
    ],
)
def test_wrong_parameters_are_refused(pair, model):
    with pytest.raises(CalibrationError):
        fitted(pair, model)


@pytest.mark.parametrize(
    "displacements", [(), ("reset", "reset"), ("reset", "motor", "drive"), ("jaw",), "reset"]
)
def test_displacements_are_one_or_two_of_three(displacements):
    with pytest.raises(CalibrationError, match="one or two of motor, drive, reset"):
        Play(displacements).fit(np.zeros((500, 1)), np.zeros(500))
