import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import linalg

from truejoint.errors import TruejointError
from truejoint.robots.forceps import (
    CABLE_LENGTH,
    CABLE_MASS_PER_LENGTH,
    LINEAR_ENCODER_RESOLUTION,
    MOTOR_ENCODER_COUNTS,
    REFERENCE_ENCODER_COUNTS,
    Forceps,
)
from truejoint.simulation.forceps.parameters import (
    ForcepsParameters,
    eigenfrequencies,
    friction_at_pretension,
)

NOMINAL = ForcepsParameters.read()
NAMES = [
    (section, key, value)
    for section, values in NOMINAL.to_dict().items()
    for key, value in values.items()
]


def refused(call, *args):
    with pytest.raises(TruejointError) as caught:
        call(*args)
    message = str(caught.value)
    assert "\n" not in message
    return message


def test_the_shipped_file_has_what_the_paper_states():
    assert NOMINAL.mechanism == Forceps()
    assert NOMINAL.motor_encoder.counts == MOTOR_ENCODER_COUNTS
    assert NOMINAL.drive_encoder.resolution == LINEAR_ENCODER_RESOLUTION
    assert NOMINAL.reset_encoder.resolution == LINEAR_ENCODER_RESOLUTION
    assert NOMINAL.reference_encoder.counts == REFERENCE_ENCODER_COUNTS
    third = CABLE_LENGTH * CABLE_MASS_PER_LENGTH / 3
    assert NOMINAL.drive_cable.mass == pytest.approx(third, rel=0.03)


def test_a_file_overlays_the_nominal_instrument(tmp_path):
    path = tmp_path / "stiff.toml"
    path.write_text("[drive_cable]\nstiffness = 16000\n[drive_encoder]\ninstalled = false\n")
    changed = ForcepsParameters.read(path)
    assert changed.drive_cable.stiffness == 16000.0
    assert not changed.drive_encoder.installed
    assert changed == NOMINAL.with_values(
        {"drive_cable.stiffness": 16000.0, "drive_encoder.installed": False}
    )
    assert changed.reset_cable == NOMINAL.reset_cable


def test_parameters_are_frozen():
    with pytest.raises(AttributeError):
        NOMINAL.jaw.inertia = 1.0


@pytest.mark.parametrize(("section", "key", "value"), NAMES)
def test_every_value_is_checked(section, key, value):
    name = f"{section}.{key}"
    for bad in (math.nan, math.inf, -1e12, 1e12, "14000", [1.0]):
        assert name in refused(NOMINAL.with_values, {name: bad})
    wrong_kind = 1.0 if isinstance(value, bool) else True
    assert name in refused(NOMINAL.with_values, {name: wrong_kind})


def test_a_count_is_a_whole_number():
    message = refused(NOMINAL.with_values, {"motor_encoder.counts": 4000.5})
    assert "motor_encoder.counts" in message
    assert "whole" in message


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[drive_cable]\nstifness = 9000.0\n", "drive_cable: no key called 'stifness'"),
        ("[drive_cabel]\nstiffness = 9000.0\n", "drive_cabel"),
        ("stiffness = 9000.0\n", "stiffness"),
        ("[drive_cable\n", "TOML"),
        ("[drive_cable]\nstiffness = -9000.0\n", "drive_cable.stiffness"),
        ("[drive_cable]\nstiffness = '9000'\n", "drive_cable.stiffness"),
        ("[reset_encoder]\ninstalled = 1\n", "reset_encoder.installed"),
        ("#" * 1_100_000, "holds more"),
    ],
)
def test_a_bad_file_is_refused_in_one_line_that_names_it(tmp_path, text, says):
    path = tmp_path / "mine.toml"
    path.write_text(text)
    message = refused(ForcepsParameters.read, path)
    assert "mine.toml" in message
    assert says in message


def test_a_missing_file_is_refused(tmp_path):
    assert "absent.toml" in refused(ForcepsParameters.read, tmp_path / "absent.toml")


@settings(max_examples=30)
@given(data=st.one_of(st.binary(max_size=200), st.text(max_size=200).map(lambda s: s.encode())))
def test_garbage_never_gets_past_the_door(tmp_path, data):
    path = tmp_path / "garbage.toml"
    path.write_bytes(data)
    refusal = ""
    try:
        loaded = ForcepsParameters.read(path)
    except TruejointError as error:
        loaded, refusal = NOMINAL, str(error)
    assert loaded == NOMINAL  # nothing but comments and blanks is accepted
    assert "\n" not in refusal


@settings(max_examples=60)
@given(
    section=st.sampled_from(sorted(NOMINAL.to_dict())),
    key=st.text(min_size=1, max_size=20),
    value=st.one_of(st.floats(), st.integers(), st.text(max_size=5), st.booleans(), st.none()),
)
def test_unknown_keys_are_refused_whatever_they_are_called(section, key, value):
    if key in NOMINAL.to_dict()[section]:
        return
    assert section in refused(NOMINAL.with_values, {f"{section}.{key}": value})


def test_modes_faster_than_the_integrator_are_refused():
    message = refused(
        NOMINAL.with_values,
        {"jaw.inertia": 1e-7, "jaw_friction.constant": 0.05, "jaw_friction.presliding": 1e-4},
    )
    assert "Hz" in message
    assert "presliding" in message


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
