import numpy as np
import pytest
from scipy import linalg

from truejoint.errors import TruejointError
from truejoint.robots.cable_mechanism import Forceps
from truejoint.simulation.forceps.parameters import (
    ForcepsParameters,
    eigenfrequencies,
    friction_at_pretension,
)

NOMINAL = ForcepsParameters.read()


def test_the_shipped_file_has_what_the_paper_states():
    assert NOMINAL.mechanism == Forceps()
    # Section IV-A. The motor's encoder has 1000 lines, which quadrature makes 4000 counts.
    assert NOMINAL.motor_encoder.counts == 4000
    assert NOMINAL.drive_encoder.resolution == 1e-6  # [m], scale RGS-40 with an RH100 head
    assert NOMINAL.reset_encoder.resolution == 1e-6
    assert NOMINAL.reference_encoder.counts == 4096  # RM08, 12 bit absolute
    # A third of 0.65 m of steel cable of 0.45 mm, 0.81 g/m.
    assert NOMINAL.drive_cable.mass == pytest.approx(0.65 * 0.81e-3 / 3, rel=0.03)


def test_modes_faster_than_the_integrator_are_refused():
    stiff = {"jaw.inertia": 1e-7, "jaw_friction.constant": 0.05, "jaw_friction.presliding": 1e-4}
    with pytest.raises(TruejointError, match=r"mode has \d+ Hz, .* presliding distance"):
        NOMINAL.with_values(stiff)


def test_eigenfrequencies_are_those_of_the_model_matrices():
    m = np.diag([1e-6, 0.05])
    r, k, spring = 4e-3, 14e3, 656.6
    stiffness = np.array([[2 * k * r * r, -k * r], [-k * r, k + spring]])
    sliding = np.sqrt(linalg.eigh(stiffness, m, eigvals_only=True)) / (2 * np.pi)
    np.testing.assert_allclose(eigenfrequencies(NOMINAL, stuck=False), sliding, rtol=1e-12)
    np.testing.assert_allclose(sliding, [52.4, 126.6], atol=0.05)
    held = stiffness + np.diag([1.56e-3 / 8.727e-4, 0.2 / 10e-6])
    stuck = np.sqrt(linalg.eigh(held, m, eigvals_only=True)) / (2 * np.pi)
    np.testing.assert_allclose(eigenfrequencies(NOMINAL, stuck=True), stuck, rtol=1e-12)
    np.testing.assert_allclose(stuck, [128.7, 240.1], atol=0.05)


def test_friction_at_pretension_adds_the_share_of_the_tensions():
    jaw, slider = friction_at_pretension(NOMINAL)
    assert jaw == pytest.approx(0.6e-3 + 0.015 * 2 * 8.0 * 4e-3)
    assert slider == pytest.approx(0.1 + 0.0125 * 8.0)
