import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import least_squares
from tests.refusals import refused

from truejoint.estimators.jaw.learn import SMALLEST_DENOMINATOR, fit_rational
from truejoint.estimators.jaw.signals import bounded_error, rational_error


def loop(n: int = 1200) -> tuple[np.ndarray, np.ndarray]:
    """Motor angle and displacement along a hysteresis loop."""
    phase = np.linspace(0.0, 4.0 * np.pi, n)
    motor = 12.0 * np.sin(phase)
    return motor, 3e-3 * (np.sin(phase) - 0.05 * np.cos(phase) + 0.02 * np.sin(3.0 * phase))


def printed_form(p: np.ndarray, phi: np.ndarray, x2: np.ndarray) -> np.ndarray:
    """(25) of yan2020 as it is printed."""
    above = p[0] + p[2] * phi + p[4] * x2 + p[6] * phi**2 + p[8] * x2**2 + p[10] * phi * x2
    below = 1 + p[1] * phi + p[3] * x2 + p[5] * phi**2 + p[7] * x2**2 + p[9] * phi**2 * x2
    return above / below


def predicted(model: dict[str, np.ndarray], motor: np.ndarray, reset: np.ndarray) -> np.ndarray:
    phi, x2 = (value * scale for value, scale in zip((motor, reset), model["scale"], strict=True))
    return printed_form(model["error_coef"], phi, x2)


TRUE = np.array([0.01, 0.1, 0.02, -0.2, -0.03, 0.3, 0.01, -0.1, -0.005, 0.05, 0.004])


def test_evaluation_is_equation_25():
    motor, reset = loop(50)
    scale = np.array([0.08, 300.0])
    found = [rational_error(*row, scale, TRUE) for row in zip(motor, reset, strict=True)]
    assert np.allclose(found, printed_form(TRUE, 0.08 * motor, 300.0 * reset), rtol=1e-13)


def test_projection_reaches_the_optimum_of_a_plain_search():
    motor, reset = loop()
    rng = np.random.default_rng(1)
    scale = np.array([1.0 / 12.0, 1.0 / np.abs(reset).max()])
    u, v = motor * scale[0], reset * scale[1]
    error = printed_form(TRUE, u, v) + rng.normal(0.0, 1e-4, len(motor))
    model = fit_rational(motor, reset, error)
    found = float(np.sum((predicted(model, motor, reset) - error) ** 2))
    plain = least_squares(lambda p: printed_form(p, u, v) - error, TRUE)
    assert found < 1.01 * 2.0 * plain.cost
    reach = np.array([error.min(), error.max()]) + 0.25 * np.ptp(error) * np.array([-1.0, 1.0])
    assert model["error_range"] == pytest.approx(reach, rel=1e-12)


def test_denominator_stays_away_from_zero_round_the_data():
    motor, reset = loop()
    sharp = 0.01 / (1.02 + 0.99 * motor / 12.0)  # wants a pole at the end of the range
    model = fit_rational(motor, reset, sharp)
    u, p = motor * model["scale"][0], model["error_coef"][1::2]
    for side in (-0.15, 0.0, 0.15):
        v = (reset + side * 3e-3) * model["scale"][1]
        below = 1.0 + p[0] * u + p[1] * v + p[2] * u**2 + p[3] * v**2 + p[4] * u**2 * v
        assert below.min() > 0.9 * SMALLEST_DENOMINATOR


def test_a_pole_gives_a_finite_number():
    coefficients = np.zeros(11)
    coefficients[[0, 1]] = 1.0, -1.0  # 1 / (1 - u)
    assert np.isfinite(rational_error(1.0, 0.0, np.ones(2), coefficients))
    for beside in (1e-9, -1e-9):  # each side keeps its sign
        assert rational_error(1.0 - beside, 0.0, np.ones(2), coefficients) * beside > 0.0


@pytest.mark.parametrize(
    ("motor", "message"), [(np.linspace(0, 1, 50), "50 rows"), (np.ones(500), "never move")]
)
def test_what_cannot_be_fitted_is_refused(motor, message):
    refused(message, fit_rational, motor, np.linspace(0, 1e-3, len(motor)), np.zeros(len(motor)))


ANY = st.floats(allow_nan=False, allow_infinity=False)


@given(ANY, ANY, st.lists(st.floats(-10.0, 10.0), min_size=11, max_size=11))
def test_the_error_stays_within_what_calibration_saw(motor, reset, coefficients):
    """Whatever the denominator does; and where it is cut off, that is said."""
    seen, half_width = np.array([-0.02, 0.03]), np.array([0.01])
    p = np.array(coefficients)
    kept = bounded_error(motor, reset, np.ones(2), p, seen, half_width)
    whole = rational_error(motor, reset, np.ones(2), p)
    if seen[0] <= whole <= seen[1]:
        assert (kept, half_width[0]) == (whole, 0.01)
    else:
        assert math.isnan(whole) or seen[0] <= kept <= seen[1]
        assert math.isnan(half_width[0])
