"""Parameters of the twins: files laid over the nominal one, and refusal of what makes no sense."""

import math
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import truejoint.simulation as package
from truejoint.errors import TruejointError
from truejoint.simulation.forceps.parameters import ForcepsParameters
from truejoint.simulation.raven2 import Raven2Parameters
from truejoint.simulation.wrist.parameters import WristParameters
from truejoint.toml_file import MAX_BYTES

KINDS = (ForcepsParameters, Raven2Parameters, WristParameters)
SPECIMENS = [(kind, name) for kind in KINDS for name in kind.SPECIMENS]
VALUES = [
    (kind, section, key, value)
    for kind in KINDS
    for section, values in kind.read().to_dict().items()
    for key, value in values.items()
]
in_tmp_path = settings(max_examples=40, deadline=None)


def refused(call, *arguments):
    with pytest.raises(TruejointError) as caught:
        call(*arguments)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def write(path, text):
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(("kind", "name"), SPECIMENS)
def test_a_shipped_file_is_commented_and_comes_back_from_plain_values(kind, name):
    path = Path(package.__file__).parent / kind.FOLDER / f"{name.lower()}.toml"
    text = path.read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if "=" in line.split("#")[0]]
    if kind is Raven2Parameters:
        assert [line for line in lines if "#" not in line] == []
    parameters = kind.read(name)
    assert kind.from_dict(parameters.to_dict()) == parameters
    for section in parameters.to_dict().values():
        for value in section.values():
            numbers = value if isinstance(value, tuple) else (value,)
            assert all(math.isfinite(v) for v in numbers if not isinstance(v, str))


def test_specimens_differ_and_share_what_they_do_not_state():
    like_the_papers = Raven2Parameters.read("peng2024")
    assert like_the_papers.pulleys != Raven2Parameters.read().pulleys
    assert like_the_papers.cable == Raven2Parameters.read("nominal").cable
    assert Raven2Parameters.read() == Raven2Parameters.read("nominal")


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
    for bad in (math.nan, math.inf, -1e13, 1e13, "14000", [1.0], [], {}, None):
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
        (
            "[cable]\nstifness = [1.0]\n",
            "cable: no key called 'stifness'; did you mean 'stiffness'",
        ),
        ("[cables]\nstiffness = [1.0]\n", "no key called 'cables'; did you mean 'cable'"),
        ("stiffness = 3.0\n", "'stiffness' stands outside a section"),
        ("[cable\n", "is not TOML"),
        ("\x00", "is not TOML"),
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
    assert "absent.toml: cannot be read" in refused(
        ForcepsParameters.read, tmp_path / "absent.toml"
    )
    message = refused(Raven2Parameters.read, "peng2042")
    assert "no specimen called 'peng2042'; did you mean 'peng2024'" in message


@in_tmp_path
@given(data=st.one_of(st.binary(max_size=200), st.text(max_size=200).map(str.encode)))
def test_garbage_never_gets_past_the_door(tmp_path_factory, data):
    path = tmp_path_factory.mktemp("garbage") / "garbage.toml"
    path.write_bytes(data)
    refusal, loaded = "", WristParameters.read()
    try:
        loaded = WristParameters.read(path)
    except TruejointError as error:
        refusal = str(error)
    assert loaded == WristParameters.read()  # nothing but comments and blanks is accepted
    assert "\n" not in refusal


@in_tmp_path
@given(
    section=st.sampled_from(sorted(WristParameters.read().to_dict())),
    key=st.text(min_size=1, max_size=20).map(lambda text: f"{text}_"),
    value=st.one_of(st.floats(), st.integers(), st.text(max_size=5), st.booleans(), st.none()),
)
def test_unknown_keys_are_refused_whatever_they_are_called(section, key, value):
    assert section in refused(WristParameters.read().with_values, {f"{section}.{key}": value})
