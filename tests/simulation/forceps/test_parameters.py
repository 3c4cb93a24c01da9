import pytest

from truejoint.errors import TruejointError
from truejoint.robots.cable_mechanism import Forceps
from truejoint.simulation.forceps.parameters import (
    ForcepsParameters,
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
