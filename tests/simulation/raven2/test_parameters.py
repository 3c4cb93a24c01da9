"""Parameters of the RAVEN-II twin: round trip, and refusal of what makes no sense."""

from __future__ import annotations

import math
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from truejoint.errors import TruejointError
from truejoint.simulation.raven2 import Raven2Parameters
from truejoint.toml_file import MAX_BYTES

in_tmp_path = settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


def keys() -> list[str]:
    shipped = Raven2Parameters.read().to_dict()
    return [f"{section}.{key}" for section, values in shipped.items() for key in values]


def write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("shipped", Raven2Parameters.SPECIMENS.values())
def test_every_number_of_the_shipped_files_is_commented(shipped: str) -> None:
    import truejoint.simulation as package  # noqa: PLC0415 - only this test needs its folder

    text = (Path(package.__file__).parent / shipped).read_text(encoding="utf-8")
    uncommented = [
        line for line in text.splitlines() if "=" in line.split("#")[0] and "#" not in line
    ]
    assert uncommented == []


def test_a_file_states_only_what_differs(tmp_path: Path) -> None:
    path = write(tmp_path / "my.toml", "[mass]\ninstrument = 0.55\n")
    parameters = Raven2Parameters.read(path)
    assert parameters.mass.instrument == 0.55
    assert parameters.cable == Raven2Parameters.read().cable


@in_tmp_path
@given(factor=st.floats(0.5, 1.0), key=st.sampled_from(keys()))
def test_round_trip_through_toml(tmp_path: Path, factor: float, key: str) -> None:
    section, name = key.split(".")
    value = Raven2Parameters.read().to_dict()[section][name]
    scaled: Any = (
        tuple(v * factor for v in value) if isinstance(value, tuple) else max(1.0, value * factor)
    )
    try:
        parameters = Raven2Parameters.read().with_values({key: scaled})
    except TruejointError:
        return  # out of bounds, which another test looks at
    path = write(tmp_path / "copy.toml", parameters.to_toml())
    assert Raven2Parameters.read(path) == parameters


@in_tmp_path
@given(
    key=st.sampled_from(keys()),
    value=st.one_of(
        st.sampled_from(["nan", "inf", "-inf", "true", '"0.1"', "[]", "[1.0, 2.0]", "{}"]),
        st.floats(1e13, 1e300).map(repr),
        st.integers(10**400, 10**401).map(repr),
    ),
    in_list=st.booleans(),
)
def test_bad_values_are_refused_in_one_line(
    tmp_path: Path, key: str, value: str, in_list: bool
) -> None:
    section, name = key.split(".")
    text = f"[{value}, {value}, {value}]" if in_list else value
    path = write(tmp_path / "bad.toml", f"[{section}]\n{name} = {text}\n")
    with pytest.raises(TruejointError, match=rf"bad\.toml: .*{name}") as caught:
        Raven2Parameters.read(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("[cables]\nstiffness = [1.0]\n", "no key called 'cables'; did you mean 'cable'"),
        (
            "[cable]\nstifness = [1.0]\n",
            "cable: no key called 'stifness'; did you mean 'stiffness'",
        ),
        ("stiffness = 3.0\n", "outside a section"),
        ("[cable\n", "is not TOML"),
        ("\x00", "is not TOML"),
        (f"[mass]\ninstrument = {'9' * 5000}\n", "is not TOML"),
    ],
)
def test_files_of_the_wrong_form_are_refused(tmp_path: Path, text: str, reason: str) -> None:
    with pytest.raises(TruejointError, match=reason):
        Raven2Parameters.read(write(tmp_path / "twin.toml", text))


def test_an_unknown_specimen_is_refused_naming_the_known() -> None:
    with pytest.raises(TruejointError, match=r"no specimen called 'peng2042'; did you mean"):
        Raven2Parameters.read("peng2042")


def test_a_missing_or_huge_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(TruejointError, match="cannot be read"):
        Raven2Parameters.read(tmp_path / "nowhere.toml")
    with pytest.raises(TruejointError, match="holds more than"):
        Raven2Parameters.read(write(tmp_path / "huge.toml", "#" * (MAX_BYTES + 1)))


def test_a_specimen_goes_by_its_name() -> None:
    like_the_papers = Raven2Parameters.read("peng2024")
    assert like_the_papers.pulleys != Raven2Parameters.read().pulleys
    assert like_the_papers.cable == Raven2Parameters.read("nominal").cable
    assert Raven2Parameters.read() == Raven2Parameters.read("nominal")


@pytest.mark.parametrize("specimen", Raven2Parameters.SPECIMENS)
def test_every_shipped_value_is_within_its_bounds_and_finite(specimen: str) -> None:
    parameters = Raven2Parameters.read(specimen)
    assert {f.name for f in fields(parameters)} == set(parameters.to_dict())
    for values in parameters.to_dict().values():
        for value in values.values():
            assert all(math.isfinite(v) for v in (value if isinstance(value, tuple) else (value,)))
