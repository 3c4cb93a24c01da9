from __future__ import annotations

import json
from contextlib import suppress
from importlib import import_module
from inspect import signature

import pytest
from hypothesis import given
from hypothesis import strategies as st

from truejoint.errors import StudyError
from truejoint.studies import (
    STUDIES,
    Option,
    Part,
    PartResult,
    Results,
    Settings,
    Study,
    get_study,
)
from truejoint.studies.study import shown

NUMBERS = st.floats(allow_nan=False, allow_infinity=False)
TEXTS = st.text("abcdefg_0123", min_size=1)


@given(st.one_of(NUMBERS, TEXTS, st.lists(NUMBERS, min_size=1, unique=True).map(tuple)))
def test_a_value_is_read_back_from_its_text(value):
    default = (1.0,) if isinstance(value, tuple) else value
    assert Option("x", default, "").parse(shown(value)) == value


@given(st.text())
def test_any_text_is_a_value_or_refused(text):
    for default in (1, 1.0, (1.0, 2.0)):
        with suppress(StudyError):
            assert type(Option("x", default, "meaning").parse(text)) is type(default)


@pytest.mark.parametrize(
    ("default", "value"),
    [(1, "1.5"), (1.0, "nan"), ("a", " "), ((1.0,), ""), ((1.0,), "2,2.0"), ((1.0,), 3)],
)
def test_what_is_not_like_the_default_is_refused(default, value):
    with pytest.raises(StudyError, match=r"x=.*: write it like"):
        Option("x", default, "meaning").parse(value)


def test_presets_choose_the_defaults():
    study = Study("s", "t", "", "m", (Option("count", 100, "", small=10), Option("x", 1.0, "")))
    assert study.settings("small").options == {"count": 10, "x": 1.0}
    assert study.settings("small", options={"count": "7"})["count"] == 7
    assert study.settings().to_dict() == {
        "preset": "full", "seed": 0, "options": {"count": "100", "x": "1.0"}
    }  # fmt: skip


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"preset": "tiny"}, "no preset 'tiny'; choose one of small, full"),
        ({"seed": -1}, "seed -1; it must be 0 to"),
        ({"options": {"cuont": 3}}, "no option 'cuont'; it has count"),
        ({"options": {"count": "x"}}, "count=x: write it like"),
    ],
)
def test_wrong_settings_are_refused(arguments, message):
    with pytest.raises(StudyError, match=message):
        get_study("forceps-population").settings(**arguments)


def test_an_unknown_study_names_the_known():
    with pytest.raises(StudyError, match="no study called 'table2'; known: directions"):
        get_study("table2")


@pytest.mark.parametrize("study", STUDIES.values(), ids=STUDIES)
def test_parts_can_be_sent_to_a_worker_and_labelled(study):
    small, full = (study.parts(study.settings(preset)) for preset in ("small", "full"))
    assert 1 <= len(small) <= len(full)
    assert len({part.key for part in full}) == len(full)
    for part in small:
        module = import_module(part.compute.__module__)
        assert getattr(module, part.compute.__name__) is part.compute
        assert json.loads(json.dumps(part.arguments)).keys() == part.arguments.keys()
        signature(part.compute).bind(**part.arguments)
        assert all(isinstance(value, int | float | str) for value in part.labels.values())


def test_rows_have_the_labels_of_their_parts():
    parts = [Part(key, max, {}, {"specimen": key.upper()}) for key in "ab"]
    results = {"a": PartResult([{"rms": 1.0}, {"rms": 2.0}]), "b": PartResult([{"rms": 3.0}])}
    rows = Results.of(Settings("small", 0, {}), parts, results).rows
    assert rows.values.tolist() == [["a", "A", 1.0], ["a", "A", 2.0], ["b", "B", 3.0]]
