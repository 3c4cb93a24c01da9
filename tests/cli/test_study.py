from __future__ import annotations

import json
from dataclasses import replace

import pytest

from truejoint.cli import study as command
from truejoint.errors import StudyError
from truejoint.studies import STUDIES


def test_without_a_name_the_studies_are_listed(call):
    result = call("study")
    assert result.code == 0
    for study in STUDIES.values():
        assert study.name in result.out
        assert all(f"--set {option.name}=" in result.out for option in study.options)
    assert list(json.loads(call("study", "--json").out)) == list(STUDIES)


def test_a_word_names_one_study_or_those_of_the_forceps():
    names = [study.name for study in command._named("forceps")]
    assert names == [name for name in STUDIES if name.startswith("forceps-")]
    for name in STUDIES:  # some of which are how others begin
        assert [study.name for study in command._named(name)] == [name]
    with pytest.raises(StudyError, match="no study called 'state'"):
        command._named("state")


@pytest.mark.usefixtures("coarse")
def test_a_study_prints_json_and_leaves_files(call, tmp_path):
    arguments = ("study", "forceps-unloaded", "--set", "methods=lsm", "-o", tmp_path)
    result = call(*arguments, "--json", "--jobs", "1")
    assert result.code == 0
    assert json.loads(result.out)["settings"]["options"]["specimen"] == "A"
    folder = tmp_path / "forceps-unloaded"
    names = {p.name for p in folder.iterdir()}
    assert names == {"parts", *(f"forceps-unloaded.{s}" for s in ("html", "md", "json", "png"))}
    assert "truejoint study forceps-unloaded" in (folder / "forceps-unloaded.html").read_text()
    again = call(*arguments)
    assert "computed now: 0" in again.err
    assert "least squares (29)" in again.out
    other = call(*arguments, "--set", "specimen=B")
    assert other.code == 2
    assert "of other settings; choose another --out, or --force" in other.err


@pytest.mark.usefixtures("coarse")
def test_a_designers_own_file_is_taken(call, tmp_path):
    path = tmp_path / "stiff.toml"
    path.write_text("[drive_cable]\nstiffness = 16000.0\n", encoding="utf-8")
    result = call(
        "study", "forceps-unloaded", "--set", f"specimen={path}", "--set", "methods=lsm",
        "--set", "draws=1", "-o", tmp_path, "--jobs", "1",
    )  # fmt: skip
    assert result.code == 0
    assert "specimen stiff" in (tmp_path / "forceps-unloaded" / "forceps-unloaded.md").read_text()


@pytest.fixture
def two_studies(monkeypatch, tmp_path):
    """The only studies there are: one of a forceps with one method, and one that is refused."""
    one = STUDIES["forceps-unloaded"]
    few = [replace(o, small=("lsm",)) if o.name == "methods" else o for o in one.options]
    known = {one.name: replace(one, options=tuple(few)), "real": STUDIES["real"]}
    for module in ("truejoint.cli.study", "truejoint.studies.page"):
        monkeypatch.setattr(f"{module}.STUDIES", known)
    monkeypatch.setattr("truejoint.recordings.datasets.store.data_folders", lambda: [tmp_path])


@pytest.mark.usefixtures("two_studies", "coarse")
def test_all_studies_leave_one_page_though_one_is_refused(call, tmp_path):
    result = call("study", "all", "--preset", "small", "-o", tmp_path, "--jobs", "1", "--json")
    assert result.code == 2
    assert list(json.loads(result.out)) == ["forceps-unloaded"]
    assert "truejoint datasets dvrk_psm_berkeley --fetch" in " ".join(result.err.split())
    assert "not done: real" in result.err.splitlines()[-1]
    page = (tmp_path / "index.html").read_text()
    assert "1 of 2 studies" in page
    assert 'href="forceps-unloaded/forceps-unloaded.html"' in page
    assert "truejoint study all --preset small" in page


def test_an_interrupt_says_how_to_go_on(call, tmp_path, monkeypatch):
    def interrupted(*_arguments, **_options):
        raise KeyboardInterrupt

    monkeypatch.setattr("truejoint.studies.runner.run_study", interrupted)
    result = call("study", "forceps-unloaded", "-o", tmp_path)
    assert result.code == 130
    assert "the same command goes on from there" in " ".join(result.err.split())
