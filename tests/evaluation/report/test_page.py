import json
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from tests.chromium import FOUND, Chromium

from truejoint.errors import RecordingError, printable
from truejoint.evaluation import evaluate
from truejoint.evaluation.report.page import render_report, script_json, write_report
from truejoint.evaluation.results import TOOL
from truejoint.tables import decimals_for, fixed
from truejoint.units import display_unit

ROBOTS = ["raven2", "davinci_grasper"]  # with and without kinematics
_BREAKS = "document.documentElement.dataset.broken = 'yes'"
STRANGER = f"""<script>{_BREAKS}</script><img alt="x" src="data:," onerror="{_BREAKS}">
<img alt="x" src="http://127.0.0.1:9/x.png">"""
HOSTILE = "<script>alert(1)</script><img src=x onerror=alert(2)>\u2028\x1b'\".csv"


class _Page(HTMLParser):
    """What a page holds: text by element, and every place that could load something."""

    def __init__(self, page):
        super().__init__()
        self.loads: list[tuple[str, str, str]] = []
        self.ids: list[str] = []
        self.scripts: dict[str, str] = {}
        self.text: list[str] = []
        self.policy = ""
        self._script: str | None = None
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        values = {key: value or "" for key, value in attrs}
        for key in ("src", "href", "srcset", "data", "action", "poster"):
            if key in values:
                self.loads.append((tag, key, values[key]))
        assert not any(key.startswith("on") for key in values)
        if "id" in values:
            self.ids.append(values["id"])
        if values.get("http-equiv") == "Content-Security-Policy":
            self.policy = values["content"]
        if tag == "script":
            self._script = values.get("id", f"script-{len(self.scripts)}")

    def handle_endtag(self, tag):
        if tag == "script":
            self._script = None

    def handle_data(self, data):
        if self._script is not None:
            self.scripts[self._script] = self.scripts.get(self._script, "") + data
        else:
            self.text.append(data)

    @property
    def words(self):
        return " ".join(" ".join(self.text).split())


@pytest.fixture(scope="module", params=ROBOTS)
def report(request, recording_of, calibration_of):
    train = [recording_of(request.param, seed=i) for i in range(2)]
    test = [
        recording_of(request.param, seed=5, source=HOSTILE, session=HOSTILE),
        recording_of(request.param, seed=6, sha256="ab" * 32, seconds=15),
    ]
    seeds = [calibration_of(train, seed=s) for s in range(2)]
    evaluation = evaluate({"dnn": seeds}, test)
    page = render_report(evaluation, command=f"truejoint evaluate {HOSTILE}")
    return evaluation, _Page(page), page


def test_the_page_loads_nothing(report):
    _, page, text = report
    for tag, key, value in page.loads:
        assert value.startswith(("#", "data:")), (tag, key, value)
    assert "default-src 'none'" in page.policy
    assert "http" not in page.policy
    style = text[text.index("<style>") : text.index("</style>")]
    assert "url(" not in style
    assert "@import" not in style
    assert len(text) < 4e6


@pytest.mark.parametrize("report", ["raven2"], indirect=True)  # which has every figure
@pytest.mark.skipif(FOUND is None, reason="chromium is not installed; the page is not opened")
def test_everybody_can_read_the_page_and_it_prints_without_a_console_error(report, tmp_path):
    page, evaluation = tmp_path / "report.html", report[0]
    one = replace(evaluation, worst=evaluation.worst[:1])  # of six alike
    text = render_report(one, command=f"truejoint evaluate {HOSTILE}")
    page.write_text(text.replace("</body>", f"{STRANGER}</body>"))
    with Chromium(tmp_path) as browser:
        browser.open(page.as_uri())
        browser.until("document.querySelector('[data-drawn]') !== null")
        browser.evaluate("dispatchEvent(new Event('beforeprint'))")
        browser.evaluate("dispatchEvent(new Event('afterprint'))")
        body = browser.evaluate("document.documentElement.outerHTML")
        assert browser.faults() == []
    refused = [line for line in browser.errors if "Content Security Policy" in line]
    assert len(refused) == 3
    assert browser.errors == refused
    body = body.partition('<script type="application/json"')[0]
    assert "data-broken" not in body
    assert body.count("js-plotly-plot") >= len(evaluation.joints)
    assert "<canvas" not in body
    assert body.count('aria-pressed="true"') > len(evaluation.joints)


def test_hostile_names_stay_text(report):
    evaluation, page, text = report
    assert "<script>alert(1)" not in text
    assert "<img src=x" not in text
    assert len(page.scripts) == 3
    assert printable(evaluation.test[0]["name"]) in page.words
    assert "Recordings trained on (2)" in page.words
    assert "59.9 s" in page.words
    assert "{'" not in page.words
    assert f"truejoint evaluate {printable(HOSTILE)}" in page.words
    assert not set(text) & set("\x1b\u2028")


def test_the_tables_hold_the_numbers(report):
    evaluation, page, _ = report
    for joint, si in zip(evaluation.joints, evaluation.units, strict=True):
        unit = display_unit(si)
        leads = sorted(evaluation.estimators, key=lambda name: name != evaluation.chosen)
        scores = [evaluation.score(name, joint) for name in leads]
        decimals = decimals_for(unit.scale * score.rmse for score in scores)
        row = f"{joint} {unit.name} " + " .*?".join(
            re.escape(fixed(unit.scale * score.rmse, decimals)) for score in scores
        )
        assert re.search(row, page.words), row
    for word in ("Raw", "Fixed offset", "Linear", "2nd-order polynomial", "Neural network"):
        assert word in page.words
    assert " ".join(evaluation.verdict.text.split()) in page.words
    assert "ab" * 32 in page.words
    tool = evaluation.scores[evaluation.scores.joint == TOOL]
    every = 1e3 * tool[["x", "y", "z"]][1:].to_numpy().ravel()
    for value in tool.rmse:
        assert fixed(1e3 * value, decimals_for(every)) in page.words


def test_every_figure_has_its_place_and_its_data(report):
    evaluation, page, _ = report
    figures = json.loads(page.scripts["figures"])["figures"]
    keys = [figure["key"] for figure in figures]
    assert len(set(page.ids)) == len(page.ids)
    assert {f"figure-{key}" for key in keys} == {i for i in page.ids if i.startswith("figure-")}
    for joint in range(len(evaluation.joints)):
        assert f"time-{joint}" in keys
        assert f"residual-{joint}" in keys
    assert {"loops", "distribution", "stretch-0"} <= set(keys)
    for figure in figures:
        for variant in figure["variants"]:
            assert variant["data"]
            assert variant["layout"]["height"] >= 200


def test_every_link_leads_somewhere(report):
    _, page, _ = report
    links = [value for tag, key, value in page.loads if tag == "a" and key == "href"]
    targets = [link[1:] for link in links if link.startswith("#")]
    assert targets
    assert set(targets) <= set(page.ids)


def test_json_cannot_end_its_script():
    values = {"a": "</script><!--&", "b": [1, None], "\u2028": '\\u001b "\U0001f600\n'}
    text = script_json(values)
    assert not set(text) & set("<>&\u2028")
    assert json.loads(text) == values
    with pytest.raises(ValueError, match="Out of range"):
        script_json(float("nan"))


@pytest.fixture(scope="module")
def grasper(recording_of, calibration_of):
    """A model, and a recording to judge it on."""
    train, test = (recording_of("davinci_grasper", seed=seed) for seed in range(2))
    return calibration_of([train]), test


def test_a_report_is_written_whole_and_never_over_another(tmp_path, grasper):
    evaluation = evaluate(*grasper)
    target = tmp_path / "report.html"
    assert write_report(evaluation, target) == target
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]
    before = target.read_bytes()
    with pytest.raises(RecordingError, match=r"report.html: exists"):
        write_report(evaluation, target)
    assert target.read_bytes() == before
    write_report(evaluation, target, overwrite=True)
    with pytest.raises(RecordingError, match="does not exist"):
        write_report(evaluation, tmp_path / "nowhere" / "report.html")


def test_a_failed_verdict_opens_the_page(grasper):
    evaluation = evaluate(*grasper, tolerance={"jaw": float(np.radians(1e-6))})
    page = _Page(render_report(evaluation))
    assert page.words.index("Not passed") < page.words.index("Worst stretches")
    assert "is not good enough in the joint" in page.words


def test_a_further_objection_keeps_names_as_they_are_written(grasper):
    evaluation = evaluate(*grasper)
    verdict = replace(evaluation.verdict, objections=("one", "rows of Day_2.csv are STALE"))
    page = _Page(render_report(replace(evaluation, verdict=verdict)))
    assert "Rows of Day_2.csv are STALE." in page.words


def test_sessions_are_listed_without_rows_of_numbers(grasper):
    words = _Page(render_report(evaluate(*grasper))).words
    assert "Recordings trained on (1)" in words
    assert "probes" not in words
    assert "conditions" not in words.partition("Recordings trained on")[2]


def test_reservations_are_told_where_the_verdict_is(grasper):
    model, test = grasper
    table = test.table.copy()
    table.loc[table.index % 5 > 1, "truth/jaw"] = np.nan
    evaluation = evaluate(model, replace(test, table=table))
    words = _Page(render_report(evaluation)).words
    assert "Passed, with reservations" in words
    assert words.index("The data check failed: 60 %") < words.index("Worst stretches")
    advice, _, rest = evaluation.verdict.advice.partition("`")
    assert f"{advice}{rest.partition('`')[0]}" in words.replace("( ", "(")
