import json
import re
from dataclasses import replace

import pytest
from rich.console import Console
from tests.chromium import FOUND, Chromium

from truejoint.errors import StudyError
from truejoint.studies import run_study, write_overview, write_study
from truejoint.studies.study import Statement


@pytest.fixture
def result(toy, coarse):
    return run_study(toy.study)


def test_a_study_leaves_page_table_numbers_and_pictures(result, tmp_path):
    files = write_study(result, tmp_path / "new", command="truejoint study toy")
    assert [file.name for file in files] == ["toy.html", "toy.md", "toy.json", "toy.png"]
    page, markdown, numbers, picture = (file.read_bytes() for file in files)
    assert picture.startswith(b"\x89PNG\r\n")
    assert rb"| part-0 |" in markdown
    assert rb"a | note" in markdown
    values = json.loads(numbers)
    assert values["origin"]["command"] == "truejoint study toy"
    assert values["parts"]["part-3"] == result.parts["part-3"].rows
    assert [claim["verdict"] for claim in values["claims"]][1] == "does not"
    text = page.decode()
    for verdict in ("holds", "does not", "cannot be told"):
        assert f">{verdict}</span>" in text
    assert "A toy &amp; its &lt;parts&gt;" in text
    assert "<b>" not in text
    assert "truejoint study toy" in text
    assert "default-src 'none'" in text
    assert not re.search(r"(src|href)=\"(?!data:|#)", text), "the page needs nothing else"
    if FOUND:
        with Chromium(tmp_path) as browser:
            browser.open(files[0].as_uri())
            browser.until("document.querySelector('#provenance') !== null")
            assert browser.faults() == []


def test_results_of_other_settings_are_not_written_over(toy, result, tmp_path):
    write_study(result, tmp_path)
    write_study(result, tmp_path)  # the same again
    other = run_study(toy.study, seed=1)
    with pytest.raises(StudyError, match=r"toy.json: is of other settings"):
        write_study(other, tmp_path)
    write_study(other, tmp_path, overwrite=True)
    for broken in ("{", "[]", '{"settings": 3}', "[" * 100_000):
        (tmp_path / "toy.json").write_text(broken)
        with pytest.raises(StudyError, match="other settings"):
            write_study(other, tmp_path)


def test_the_terminal_shows_brackets_as_they_are(result):
    console = Console(width=100)
    with console.capture() as shown:
        console.print(result.summary.tables[0].rich())
    for text in ("Means [1] <b>", "mean [/x]", "a | note"):
        assert text in shown.get()


@pytest.fixture
def folder(toy, tmp_path, monkeypatch, coarse):
    """Results of one of two known studies."""
    known = {"toy": toy.study, "other": replace(toy.study, name="other", title="Not run yet")}
    monkeypatch.setattr("truejoint.studies.page.STUDIES", known)
    write_study(run_study(toy.study), tmp_path / "toy")
    return tmp_path


def test_one_page_holds_every_claim_with_its_verdict(folder):
    page = write_overview(folder, command="truejoint study all").read_text()
    for verdict in ("holds", "does not", "cannot be told"):
        assert f">{verdict}</span>" in page
    assert page.count("means differ") == 4
    assert "2 (1 better)" in page
    assert page.count('badge fail">') == 1, "what is better here is not red"
    assert 'href="toy/toy.html"' in page
    assert 'href="#toy"' in page
    assert '<section id="toy">' in page
    assert "1 of 2 studies" in page
    assert "truejoint study other" in page  # how to get what is missing
    assert "A toy &amp; its &lt;parts&gt;" in page
    assert not re.search(r"src=\"(?!data:)", page)


def test_a_damaged_result_counts_as_not_there(folder):
    good = '{"settings": {"preset": "full", "seed": 0, "options": {}}, "claims": [{}]}'
    for text in ("{", "[]", "3", '{"claims": []}', "[" * 100_000, good.replace('"seed": 0, ', "")):
        (folder / "toy" / "toy.json").write_text(text)
        assert "0 of 2 studies" in write_overview(folder).read_text()
    (folder / "toy" / "toy.json").write_text(good)
    assert "0 of 2 studies" in write_overview(folder).read_text(), "a claim without its text"


def test_options_of_their_own_and_what_claims_were_judged_on_are_shown(toy, folder):
    assert "<td>full, seed 0</td>" in write_overview(folder).read_text()
    result = run_study(toy.study, {"count": 2})
    write_study(result, folder / "toy", overwrite=True)
    path = folder / "toy" / "toy.json"
    result = json.loads(path.read_text())
    result["claims"][0]["on"] = "specimen Q"
    path.write_text(json.dumps(result))
    page = write_overview(folder).read_text()
    assert "<td>full, seed 0, count 2</td>" in page
    assert "specimen Q" in page


def test_claims_stand_in_one_list_with_their_numbers(folder, monkeypatch):
    from truejoint.studies import page  # noqa: PLC0415

    known = {"a": Statement("means differ", "toy2020", "toy", number="T1")}
    known["b"] = Statement("never tried", "toy2020", "other", number="T2")
    monkeypatch.setattr(page, "CLAIMS", known)
    path = folder / "toy" / "toy.json"
    result = json.loads(path.read_text())
    result["claims"][0] |= {"number": "T1", "test": "Student's t at 95 %, n = 3"}
    path.write_text(json.dumps(result))
    text = write_overview(folder, command="truejoint study all").with_name("claims.md").read_text()
    assert "truejoint study all" in text
    assert (
        "| T1 | means differ | toy2020 | `toy` | holds | so | Student's t at 95 %, n = 3 |" in text
    )
    assert "| T2 | never tried | toy2020 | `other` | not run |" in text
    assert result["origin"]["source"].startswith("source ")
    assert result["origin"]["source"] in text
    assert "data:image/png;base64," in (folder / "index.html").read_text()
