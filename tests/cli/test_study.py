import json
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import pytest

from truejoint.cli import study as command
from truejoint.errors import StudyError
from truejoint.studies import STUDIES


def test_without_a_name_the_studies_are_listed(call):
    said = call.good("study").out
    for study in STUDIES.values():
        assert study.name in said
        assert all(f"--set {option.name}=" in said for option in study.options)
    assert list(call.json("study")) == list(STUDIES)


def test_a_word_names_one_study_or_those_of_the_forceps():
    names = [study.name for study in command._named("forceps")]
    assert names == [name for name in STUDIES if name.startswith("forceps-")]
    for name in STUDIES:  # some of which are how others begin
        assert [study.name for study in command._named(name)] == [name]
    with pytest.raises(StudyError, match="no study called 'state'"):
        command._named("state")


@pytest.mark.usefixtures("coarse")
def test_a_study_of_a_designers_own_file_prints_json_and_leaves_files(call):
    Path("stiff.toml").write_text("[drive_cable]\nstiffness = 16000.0\n", encoding="utf-8")
    line = "study forceps-unloaded --set methods=lsm --set draws=1 -o ."
    stiff = f"{line} --set specimen=stiff.toml --jobs 1"
    assert call.json(stiff)["settings"]["options"]["specimen"] == "stiff.toml"
    folder = Path("forceps-unloaded")
    names = {p.name for p in folder.iterdir()}
    assert names == {f"forceps-unloaded.{s}" for s in ("html", "md", "json", "png")}
    assert len(list(Path("parts").iterdir())) == 1, "which other studies may take"
    assert "truejoint study forceps-unloaded" in (folder / "forceps-unloaded.html").read_text()
    assert "specimen stiff" in (folder / "forceps-unloaded.md").read_text()
    again = call.good(stiff)
    assert "computed now: 0" in again.err
    assert "least squares (29)" in again.out
    call.refuses("of other settings; choose another --out, or --force", line)


@pytest.fixture
def two_studies(monkeypatch, tmp_path):
    """The only studies there are: one of a forceps with one method, and one that is refused."""
    one = STUDIES["forceps-unloaded"]
    small = {"methods": ("lsm",), "draws": 1}
    few = [replace(o, small=small.get(o.name, o.small)) for o in one.options]
    known = {one.name: replace(one, options=tuple(few)), "real": STUDIES["real"]}
    for module in ("truejoint.cli.study", "truejoint.studies.page"):
        monkeypatch.setattr(f"{module}.STUDIES", known)
    monkeypatch.setattr("truejoint.recordings.datasets.store.data_folders", lambda: [tmp_path])


@pytest.mark.usefixtures("two_studies", "coarse")
def test_all_studies_leave_one_page_though_one_is_refused(call):
    result = call("study all --preset small -o . --jobs 1 --json")
    assert result.code == 2
    assert list(json.loads(result.out)) == ["forceps-unloaded"]
    assert "truejoint datasets dvrk_psm_berkeley --fetch" in " ".join(result.err.split())
    assert "not done: real" in result.err.splitlines()[-1]
    page = Path("index.html").read_text()
    assert "1 of 2 studies" in page
    assert 'href="forceps-unloaded/forceps-unloaded.html"' in page
    assert "truejoint study all --preset small" in page


@pytest.mark.parametrize("how", ["--preset smal", "--seed -1", "-o file.txt"])
def test_what_no_study_can_be_made_with_is_one_line(call, how):
    Path("file.txt").touch()
    result = call(f"study all {how}")
    assert result.code == 2
    assert len(result.err.splitlines()) == 1
    assert not Path("studies").exists()


def test_an_interrupt_says_how_to_go_on(call, monkeypatch):
    interrupted = Mock(side_effect=KeyboardInterrupt)
    monkeypatch.setattr("truejoint.studies.runner.run_study", interrupted)
    result = call("study forceps-unloaded -o .")
    assert result.code == 130
    assert "the same command goes on from there" in " ".join(result.err.split())
