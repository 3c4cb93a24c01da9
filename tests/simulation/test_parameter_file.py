"""Parameters of the twins: files laid over the nominal one, and refusal of what makes no sense."""

import math
import re
import sys
from pathlib import Path

import pytest

from truejoint.errors import TruejointError
from truejoint.robots.cable_mechanism import Forceps
from truejoint.simulation.dvrk_psm import DvrkPsmParameters
from truejoint.simulation.forceps.parameters import ForcepsParameters
from truejoint.simulation.raven2 import Raven2Parameters
from truejoint.simulation.wrist.parameters import WristParameters
from truejoint.toml_file import MAX_BYTES

KINDS = (DvrkPsmParameters, ForcepsParameters, Raven2Parameters, WristParameters)
SPECIMENS = [(kind, name) for kind in KINDS for name in kind.SPECIMENS]
VALUES = [
    (kind, section, key, value)
    for kind in KINDS
    for section, values in kind.read().to_dict().items()
    for key, value in values.items()
]


def refused(call, *arguments):
    with pytest.raises(TruejointError) as caught:
        call(*arguments)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def write(path, text):
    path.write_text(text, encoding="latin-1")
    return path


@pytest.mark.parametrize(("kind", "name"), SPECIMENS)
def test_a_shipped_file_is_commented_and_comes_back_from_plain_values(kind, name):
    path = Path(sys.modules[kind.__module__].__file__).with_name(f"{name.lower()}.toml")
    text = path.read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if "=" in line.split("#")[0]]
    if kind is Raven2Parameters:
        assert [line for line in lines if "#" not in line] == []
    parameters = kind.read(name)
    assert kind.from_dict(parameters.to_dict()) == parameters
    assert (parameters == kind.read()) == (name == "nominal")
    for section in parameters.to_dict().values():
        for value in section.values():
            numbers = value if isinstance(value, tuple) else (value,)
            assert all(math.isfinite(v) for v in numbers if not isinstance(v, str))


def test_a_file_states_only_what_differs(tmp_path):
    path = write(tmp_path / "stiff.toml", "[drive_cable]\nstiffness = 16000\n"
                 "[drive_encoder]\ninstalled = false\n")  # fmt: skip
    nominal, changed = ForcepsParameters.read(), ForcepsParameters.read(path)
    assert changed.drive_cable.stiffness == 16000.0
    assert not changed.drive_encoder.installed
    assert changed == nominal.with_values(
        {"drive_cable.stiffness": 16000.0, "drive_encoder.installed": False}
    )
    assert changed.reset_cable == nominal.reset_cable
    with pytest.raises(AttributeError):
        changed.jaw.inertia = 1.0


@pytest.mark.parametrize(("kind", "section", "key", "value"), VALUES)
def test_every_value_is_checked(kind, section, key, value):
    name, nominal = f"{section}.{key}", kind.read()
    for bad in (math.nan, math.inf, -1e13, 1e13, "14000", [1.0, 1.0], [], {}, None):
        repeated = (bad,) * len(value) if isinstance(value, tuple) else bad
        for changed in (bad, repeated):
            assert name in refused(nominal.with_values, {name: changed})
    wrong_kind = 1.0 if isinstance(value, bool) else True
    assert name in refused(nominal.with_values, {name: wrong_kind})
    if type(value) is int:
        assert "whole" in refused(nominal.with_values, {name: value + 0.5})


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[cable]\nstifness = [1.0]\n", "cable: no key called 'stifness'; did you mean 'stif"),
        ("[cables]\nstiffness = [1.0]\n", "no key called 'cables'; did you mean 'cable'"),
        ("stiffness = 3.0\n", "'stiffness' stands outside a section"),
        ("[cable\n", "is not TOML"),
        *((text, "is not TOML") for text in ("\x00", "\xff", "a = " + "[" * 100_000)),
        (f"[mass]\ninstrument = {'9' * 5000}\n", "is not TOML"),
        (f"[mass]\ninstrument = 1{'0' * 400}\n", "mass.instrument is 1000"),
        ("#" * (MAX_BYTES + 1), "holds more than"),
    ],
)
def test_a_bad_file_is_refused_in_one_line_that_names_it(tmp_path, text, says):
    message = refused(Raven2Parameters.read, write(tmp_path / "mine.toml", text))
    assert "mine.toml" in message
    assert says in message


def test_a_file_or_specimen_that_is_not_there_is_refused(tmp_path):
    message = refused(ForcepsParameters.read, tmp_path / "absent.toml")
    assert "absent.toml: cannot be read" in message
    message = refused(Raven2Parameters.read, "peng2042")
    assert "no specimen called 'peng2042'; did you mean 'peng2024'" in message


def test_the_shipped_forceps_has_what_the_paper_states():
    nominal = ForcepsParameters.read()
    assert nominal.mechanism == Forceps()
    # Section IV-A. The motor's encoder has 1000 lines, which quadrature makes 4000 counts.
    assert nominal.motor_encoder.counts == 4000
    assert nominal.drive_encoder.resolution == 1e-6  # [m], scale RGS-40 with an RH100 head
    assert nominal.reset_encoder.resolution == 1e-6
    assert nominal.reference_encoder.counts == 4096  # RM08, 12 bit absolute
    # A third of 0.65 m of steel cable of 0.45 mm, 0.81 g/m.
    assert nominal.drive_cable.mass == pytest.approx(0.65 * 0.81e-3 / 3, rel=0.03)


def test_modes_faster_than_the_integrator_are_refused():
    stiff = {"jaw.inertia": 1e-7, "jaw_friction.constant": 0.05, "jaw_friction.presliding": 1e-4}
    message = refused(ForcepsParameters.read().with_values, stiff)
    assert re.search(r"mode has \d+ Hz, .* presliding distance", message)
