import numpy as np
import pytest
from tests.estimators.conftest import columns, fitted, loaded_run
from tests.runtime.streams import stepped

from truejoint.estimators import GatedPlays, JawPlays
from truejoint.estimators.jaw_load.run import no_more, redescending
from truejoint.simulation.forceps.load import LoadTest


def test_its_deviation_grows_with_a_load_as_its_error_does(pair):
    model = fitted(pair, GatedPlays())
    test = LoadTest(0.2)
    run = loaded_run(test)
    X = columns(run, model)
    angles, widths = stepped(model, X, np.where(np.arange(len(X)) == 0, 0.0, 5e-3), 1.0)
    errors, widths = angles[:, 0] - run.column("truth/jaw"), widths[:, 0]
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
    model, at_rest, goes_on = fitted(pair, GatedPlays()), 2200, 2400
    X = columns(pair.verification, model)[np.minimum(np.arange(2500), 2000)]
    X[:, 1] += drift * np.clip((np.arange(2500) - at_rest) / 100.0, 0.0, 1.0)
    X[goes_on:, 0] += 0.02
    dt = np.r_[0.0, np.full(2499, 5e-3)]
    reset = fitted(pair, JawPlays(signals=("cable/reset",))).evaluate(X[:, 1:], dt)[:, 0]
    difference = fitted(pair, JawPlays()).evaluate(X, dt)[:, 0] - reset
    believed = model.evaluate(X, dt)[:, 0] - reset
    gate = float(model.arrays_["gate"][0])
    whole = np.array([redescending(d, gate) for d in difference])
    before, after = whole[at_rest], whole[goes_on - 1]
    assert abs(after - before) > 1e-4  # the load makes the sides differ otherwise than they did
    low, high = sorted((0.0, before))
    assert believed[goes_on - 1] == pytest.approx(np.clip(after, low, high), abs=1e-12)
    moves = np.flatnonzero(np.abs(np.diff(X[:, 0], prepend=X[0, 0])) > 5e-3)  # [rad] of the motor
    assert np.count_nonzero(moves) > 800
    assert goes_on in moves
    assert np.abs(believed - whole)[moves].max() < 1e-12


def test_gate_is_continuous_and_lets_go():
    sizes = np.linspace(-0.5, 0.5, 2001)
    values = np.array([redescending(d, 0.1) for d in sizes])
    inside = np.abs(sizes) <= 0.1
    assert np.array_equal(values[inside], sizes[inside])
    assert not values[np.abs(sizes) >= 0.2].any()
    assert np.abs(np.diff(values)).max() < 1.01 * (sizes[1] - sizes[0])
