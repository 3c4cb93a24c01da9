import numpy as np
import pytest

import truejoint
from truejoint.motion import nested_motion

FORCEPS = truejoint.get_robot("forceps")


def test_it_covers_the_workspace_from_its_centre_in_its_time():
    motion = nested_motion(FORCEPS, rate=200.0)
    jaw, t = np.degrees(motion.positions[:, 0]), motion.times
    assert (jaw[0], t[-1]) == (0.0, 65.0)
    assert (jaw.min(), jaw.max()) == pytest.approx((-50.0, 50.0), abs=0.01)
    assert 18.0 < np.abs(np.gradient(jaw, t)).max() < 25.0


def test_it_holds_loops_of_three_sizes_in_every_third():
    jaw = np.degrees(nested_motion(FORCEPS, rate=200.0).positions[:, 0])
    turns = jaw[1:-1][np.diff(np.sign(np.diff(jaw))) != 0]
    size, middle = np.abs(np.diff(turns)), (turns[1:] + turns[:-1]) / 2
    for low, high in ((-50, -15), (-15, 15), (15, 50)):
        inside = size[(low < middle) & (middle < high)]
        assert ((inside > 5) & (inside < 12)).any()
        assert ((inside > 20) & (inside < 30)).any()
    assert (size > 99).sum() == 3


def test_a_longer_one_is_slower():
    short, long = (nested_motion(FORCEPS, duration) for duration in (65.0, 130.0))
    np.testing.assert_allclose(long.positions[::2], short.positions, atol=1e-12)
