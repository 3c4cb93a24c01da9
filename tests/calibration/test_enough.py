"""Whether more data are expected to pay."""

from __future__ import annotations

import numpy as np
import pytest

from truejoint.calibration import calibrate, expected_gain
from truejoint.errors import CalibrationError
from truejoint.recordings import Recording

FEATURES = ("measured/jaw", "effort/jaw")


def motion(seed, rows, curve=0.0, noise=0.01):
    """A jaw that jumps about, and the truth with white noise and a curve."""
    random = np.random.default_rng(seed)
    jaw, effort = random.uniform(-1.0, 1.0, (2, rows))
    truth = 1.02 * jaw + 0.05 * effort + curve * jaw**2 + noise * random.standard_normal(rows)
    columns = {"t": np.arange(rows) / 50.0, "measured/jaw": jaw, "effort/jaw": effort}
    return Recording.from_columns({**columns, "truth/jaw": truth}, "davinci_grasper")


def test_it_is_what_twice_the_data_give():
    """Least squares with 3 coefficients: the error is noise times sqrt(1 + 3 / n)."""
    found = [expected_gain(motion(seed, 100), features=FEATURES)[0] for seed in range(6)]
    exact = 1.0 - np.sqrt((1.0 + 3.0 / 200.0) / (1.0 + 3.0 / 100.0))
    assert np.mean(found) == pytest.approx(exact, rel=0.5)
    test = motion(99, 2000, noise=0.0)
    won = []
    for seed in range(6):
        model, again = (calibrate(motion(seed, n), "linear", features=FEATURES) for n in (100, 200))
        squares = [
            np.mean((test.column("truth/jaw") - m.correct(test)[:, 0]) ** 2) for m in (model, again)
        ]
        won.append(squares)
    before, after = np.sqrt(1e-4 + np.mean(won, axis=0))
    assert np.mean(found) == pytest.approx(1.0 - after / before, rel=0.7)


def test_what_no_data_can_better_does_not_count():
    straight = expected_gain(motion(1, 300, noise=1e-4), features=FEATURES)
    curved = expected_gain(motion(1, 300, curve=0.2, noise=1e-4), features=FEATURES)
    assert curved.shape == (1,)
    assert (straight < 0.02).all()
    assert (curved < 0.02).all()
    assert expected_gain(motion(1, 60), features=FEATURES)[0] > 3 * straight[0] / 2


def test_too_little_is_refused():
    with pytest.raises(CalibrationError, match="rows"):
        expected_gain(motion(1, 20), features=FEATURES)
