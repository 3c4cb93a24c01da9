import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from truejoint.errors import TruejointError
from truejoint.simulation.forceps.specimens import specimen
from truejoint.simulation.forceps.twin import ZeroShift, quantised, read_encoders, reference_error
from truejoint.simulation.parameter_file import random_streams

NOMINAL = specimen()
N = 20_000
RAMP = np.linspace(-1.0, 1.0, N)
EXACT = (RAMP * 12.5, RAMP * 3.5e-3, RAMP * 3.3e-3, RAMP * 0.9)


def read(parameters=NOMINAL, zero=ZeroShift(), seed=0):  # noqa: B008 - a frozen value
    return read_encoders(parameters, random_streams(4, seed), np.array(EXACT), zero)


@given(st.lists(st.floats(-10, 10), min_size=1, max_size=50), st.floats(1e-6, 0.1))
def test_quantised_values_are_the_nearest_multiples(values, resolution):
    exact = np.array(values)
    seen = quantised(exact, resolution)
    assert np.abs(seen - exact).max() <= 0.5 * resolution * (1 + 1e-6)
    np.testing.assert_allclose(seen / resolution, np.round(seen / resolution), atol=1e-6)


@pytest.mark.parametrize(
    ("channel", "resolution"),
    [(0, 2 * math.pi / 4000), (1, 1e-6), (2, 1e-6), (3, 2 * math.pi / 4096)],
)
def test_each_sensor_has_the_resolution_of_the_paper(channel, resolution):
    counts = read()[channel] / resolution
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)
    steps = np.unique(np.round(np.abs(np.diff(counts))))
    assert 1.0 in steps


def test_noise_comes_on_top_of_the_rounding():
    resolution, noise = 2 * math.pi / 4096, math.radians(0.02)
    error = read()[3] - EXACT[3] - reference_error(EXACT[3], NOMINAL.reference_encoder)
    assert error.std() == pytest.approx(math.hypot(resolution / math.sqrt(12), noise), rel=0.02)
    assert math.degrees(error.std()) == pytest.approx(0.0324, abs=0.001)  # the floor of any method
    cable = read()[2] - EXACT[2]
    assert cable.std() == pytest.approx(math.hypot(1e-6 / math.sqrt(12), 0.1e-6), rel=0.02)


def test_changing_one_sensor_leaves_the_others_alone():
    louder = NOMINAL.with_values({"drive_encoder.noise": 5e-6, "motor_encoder.noise": 1e-3})
    before, after = read(), read(louder)
    assert not np.array_equal(before[0], after[0])
    assert not np.array_equal(before[1], after[1])
    np.testing.assert_array_equal(before[2], after[2])
    np.testing.assert_array_equal(before[3], after[3])


def test_a_zero_shift_moves_what_it_names():
    before, after = read(), read(zero=ZeroShift(motor=0.1, drive=20e-6, reset=-10e-6))
    assert (after[0] - before[0]).mean() == pytest.approx(0.1, rel=1e-3)
    assert (after[1] - before[1]).mean() == pytest.approx(20e-6, rel=1e-3)
    assert (after[2] - before[2]).mean() == pytest.approx(-10e-6, rel=1e-3)
    np.testing.assert_array_equal(before[3], after[3])


def test_zero_shifts_are_drawn_with_the_deviation_asked_for():
    drawn = [ZeroShift.drawn(5e-6, seed) for seed in range(400)]
    assert np.std([z.reset for z in drawn]) == pytest.approx(5e-6, rel=0.12)
    assert np.std([z.drive for z in drawn]) == pytest.approx(5e-6, rel=0.12)
    assert drawn[0] == ZeroShift.drawn(5e-6, 0)
    assert ZeroShift.drawn(0.0, 1) == ZeroShift()
    for bad in (-1e-6, math.nan, math.inf):
        with pytest.raises(TruejointError, match="homing"):
            ZeroShift.drawn(bad, 0)


@pytest.mark.parametrize("name", ["nominal", "A", "B"])
def test_the_references_error_is_two_harmonics_that_vanish_at_zero(name):
    encoder = specimen(name).reference_encoder
    assert reference_error(0.0, encoder) == pytest.approx(0.0, abs=1e-15)
    turn = np.arange(256) * 2 * math.pi / 256
    spectrum = np.abs(np.fft.rfft(reference_error(turn, encoder))) / 128
    wanted = [encoder.first_harmonic, encoder.second_harmonic]
    np.testing.assert_allclose(spectrum[1:3], wanted, rtol=1e-9)
    assert spectrum[3:].max() < 1e-12
