import json
import re
from contextlib import suppress
from importlib import import_module
from inspect import signature
from itertools import chain
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

import truejoint.studies
from truejoint.errors import StudyError, TruejointError
from truejoint.studies import STUDIES, Option, Part, PartResult, Results, Settings, Study, get_study
from truejoint.studies.forceps import paper
from truejoint.studies.raven2 import lasting, rivals, training
from truejoint.studies.study import CLAIMS, TESTS, shown

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


@pytest.mark.parametrize(
    ("study", "options", "message"),
    [
        ("directions", {"directions": "J4"}, "no direction called 'J4'"),
        ("directions", {"fine": "4+x"}, "write 4\\+5\\+6"),
        ("sparsity", {"sets": "2,4+4"}, "write 4\\+5\\+6"),
        ("endurance", {"works": "resting"}, "no kind of work"),
        ("endurance", {"load_g": "3000"}, "up to 2000"),
        ("endurance", {"hours": "0"}, "hours=0"),
        ("homing", {"training": "4"}, "two zig-zags or more"),
        ("state-of-the-art", {"models": "transformer"}, "no model called 'transformer'"),
        ("state-of-the-art", {"hours": "1"}, "at least 2"),
        ("timing", {"samples": "10"}, "1000 or more"),
        ("features", {"models": "deep"}, "no model called"),
        ("real", {"estimators": "transformer"}, "no estimator called"),
        ("real", {"datasets": "lab"}, "no data set called"),
        ("wrist", {"estimators": "plays"}, "no estimator called 'plays'"),
        ("wrist", {"family": "rods"}, "no family called 'rods'"),
        ("wrist", {"instrument": "42"}, "no arm called '42'"),
        ("wrist", {"free_s": "-1"}, r"free_s=-1\.0; it must be above 0"),
        ("wrist", {"test_s": "1"}, "test_s=1; it must be above 2"),
        ("forceps-unloaded", {"methods": ("lsm", "svm")}, "no method called 'svm'"),
        ("forceps-population", {"count": 0}, "a population of 0"),
        ("forceps-population", {"homing_um": -1}, "homing deviation"),
        ("forceps-mixed", {"prior": "dahl"}, "no prior called 'dahl'"),
        ("forceps-mixed", {"masses_g": "9000"}, "a load of 9 kg"),
        ("forceps-closed-loop", {"rate_hz": 50}, "50 Hz is too slow"),
        ("forceps-sweep", {"layouts": "x9"}, "no layout called 'x9'"),
        ("forceps-sweep", {"resolutions_um": "-1"}, "above 0"),
    ],
)
def test_what_cannot_be_asked_of_a_study_is_one_line(study, options, message):
    asked = get_study(study)
    with pytest.raises(TruejointError, match=message) as caught:
        asked.parts(asked.settings(options=options))
    assert "\n" not in str(caught.value)


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


def test_every_claim_of_the_papers_is_judged_by_a_study():
    """A claim that no code names would be listed and never judged."""
    folder = Path(truejoint.studies.__file__).parent
    code = "".join(path.read_text() for path in folder.glob("*/*.py"))
    named = re.compile(r"""CLAIMS\[f?"([^"]+)"\]""").findall(code)
    for module in (lasting, paper, rivals, training):
        named += chain(*(table for name, table in vars(module).items() if name.endswith("_CLAIMS")))
    patterns = [re.compile(re.sub(r"\{[^}]*\}", ".+", name) + "$") for name in named]
    for key, stated in CLAIMS.items():
        assert any(pattern.match(key) for pattern in patterns), key
        assert stated.study in STUDIES
        assert stated.test in TESTS
    assert all(any(pattern.match(key) for key in CLAIMS) for pattern in patterns)
    numbers = [stated.number for stated in CLAIMS.values()]
    assert len(set(numbers)) == len(numbers)
