from __future__ import annotations

import json
import re
from dataclasses import replace

import pytest

from truejoint.studies import run_study, write_study
from truejoint.studies.page import write_overview


@pytest.fixture
def folder(toy, tmp_path, monkeypatch, coarse):
    """Results of one of two known studies."""
    known = {"toy": toy.study, "other": replace(toy.study, name="other", title="Not run yet")}
    monkeypatch.setattr("truejoint.studies.page.STUDIES", known)
    write_study(run_study(toy.study), tmp_path / "toy")
    return tmp_path


def test_one_page_holds_every_claim_with_its_verdict(folder):
    page = write_overview(folder, command="truejoint study all").read_text()
    for verdict in ("agrees", "does not agree", "cannot be told"):
        assert f">{verdict}</span>" in page
    assert page.count("means differ") == 3
    assert 'href="toy/toy.html"' in page
    assert "1 of 2 studies" in page
    assert "truejoint study other" in page  # how to get what is missing
    assert "A toy &amp; its &lt;parts&gt;" in page
    assert not re.search(r"src=\"(?!data:)", page)


@pytest.mark.parametrize(
    "text",
    [
        "{",
        "[]",
        "3",
        '{"claims": []}',
        "[" * 100_000,
        '{"settings": {}, "claims": []}',
        '{"settings": {"preset": "full", "seed": 0, "options": {}}, "claims": [{}]}',
    ],
)
def test_a_damaged_result_counts_as_not_there(folder, text):
    (folder / "toy" / "toy.json").write_text(text)
    assert "0 of 2 studies" in write_overview(folder).read_text()


def test_options_that_are_not_those_of_the_preset_are_shown(toy, folder):
    assert "<td>full, seed 0</td>" in write_overview(folder).read_text()
    result = run_study(toy.study, {"count": 2})
    write_study(result, folder / "toy", overwrite=True)
    assert "<td>full, seed 0, count 2</td>" in write_overview(folder).read_text()


def test_claims_name_what_they_were_judged_on(toy, folder):
    path = folder / "toy" / "toy.json"
    result = json.loads(path.read_text())
    result["claims"][0]["on"] = "specimen Q"
    path.write_text(json.dumps(result))
    assert "specimen Q" in write_overview(folder).read_text()
