import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from truejoint.errors import TruejointError
from truejoint.simulation.forceps.load import LoadTest

T = np.arange(36_001) / 1000


def test_it_moves_at_the_papers_speed_to_the_papers_angle():
    angles = LoadTest(0.1).angles(T)
    speed = np.gradient(angles, T)
    assert math.degrees(speed[(T > 2.1) & (T < 17.9)].mean()) == pytest.approx(1.875)
    assert angles[0] == 0.0
    assert math.degrees(angles[-1]) == pytest.approx(30.0)
    np.testing.assert_array_equal(angles[T >= 18.001], angles[-1])


def test_the_jaw_rocks_under_the_weight_at_the_same_speed():
    test = LoadTest(0.1, rock=math.radians(7.5))
    angles = np.degrees(test.angles(T))
    plain = np.degrees(LoadTest(0.1).angles(T))
    np.testing.assert_array_equal(angles[T < 28.0], plain[T < 28.0])
    np.testing.assert_allclose(np.interp([28.0, 30.0, 32.0, 34.0, 36.0], T, angles),
                               [30.0, 26.25, 22.5, 26.25, 30.0], atol=2e-3)  # fmt: skip
    speed = np.gradient(angles, T)[T > 28.01]
    assert np.median(np.abs(speed)) == pytest.approx(1.875)


@pytest.mark.parametrize(("direction", "sign"), [("opposing", -1.0), ("along", 1.0)])
@pytest.mark.parametrize("angle", [30.0, -30.0])
def test_the_weight_hangs_on_the_side_asked_for(direction, sign, angle):
    force = LoadTest(0.2, direction, math.radians(angle)).force(T, seed=1)
    np.testing.assert_allclose(force[T >= 26.5], sign * math.copysign(0.2 * 9.81, angle))
    assert not force[T <= 24.0].any()


@given(mass=st.floats(0.0, 2.0), seed=st.integers(0, 2**32 - 1))
def test_the_line_pulls_and_never_pushes(mass, seed):
    force = LoadTest(mass, "along").force(T[::10], seed)
    assert force.min() >= 0.0
    assert force.max() <= 2.0 * mass * 9.81 + 1e-12


def test_the_hand_wobbles_differently_under_each_seed_only_while_it_holds():
    test = LoadTest(0.1)
    one, two, again = test.force(T, 1), test.force(T, 2), test.force(T, 1)
    np.testing.assert_array_equal(one, again)
    held = (T > 24.0) & (T < 26.5)
    assert np.abs(one - two)[held].max() > 0.1 * 0.1 * 9.81
    np.testing.assert_allclose(one[~held], two[~held], rtol=1e-12)
    assert (np.diff(np.abs(one[held])) < 0).any()


def test_the_phases_are_those_of_the_paper_in_order():
    phases = LoadTest(0.1).phases
    assert list(phases) == ["I", "II", "III", "IV"]
    assert phases["I"] == (2.0, 18.0)
    edges = [edge for phase in phases.values() for edge in phase]
    assert edges == sorted(edges)
    assert phases["IV"][1] == 36.0


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        *(({"mass": mass}, "kg") for mass in (-0.1, math.nan, 50.0)),
        ({"direction": "up"}, "opposing"),
        ({"loaded_from": 5.0}, "times"),
        *(({"end": end}, "times") for end in (25.0, math.inf, math.nan)),
        *(({"speed": speed}, "speed") for speed in (0.0, math.nan)),
        ({"angle": math.inf}, "speed"),
        *(({"rock": rock}, "rocks") for rock in (1.0, -0.1)),
    ],
)
def test_an_impossible_test_is_refused(arguments, says):
    with pytest.raises(TruejointError, match=says) as caught:
        LoadTest(**{"mass": 0.1} | arguments)
    assert "\n" not in str(caught.value)
