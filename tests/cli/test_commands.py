"""Every command as a person calls it: what it makes, says and returns."""

import html
import json
import re
import shlex
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from truejoint import read_calibration, read_recording, write_parquet
from truejoint.cli.commands import COMMANDS, GROUPS, command
from truejoint.estimators.registry import estimator_names
from truejoint.recordings.read.map_sketch import QUANTITIES
from truejoint.robots import robot_names


@pytest.mark.parametrize("name", ["", *{**GROUPS, **COMMANDS}])
def test_help_ends_in_an_example_that_is_understood(call, name):
    said = call.good(f"{name} --help").out
    example = " ".join(said.partition("Example: ")[2].split()).removesuffix(
        " shows the whole way on a simulated RAVEN-II."
    )
    called = shlex.split(example)
    assert called[: len(name.split()) + 1] == ["truejoint", *name.split()]
    line = f"{shlex.join(called[1:])} "
    longest = max((n for n in COMMANDS if line.startswith(f"{n} ")), key=len)
    command(longest).make_context("truejoint", called[1 + len(longest.split()) :])


def test_evaluate_judges_and_reports(call, session):
    judge = f"evaluate {session}/m.st {session}/random.parquet --accept range"
    values = call.json(f"{judge} --tolerance elbow=5 --report report.html")
    assert values["verdict"]["passed"] is True
    assert values["verdict"]["deploy"] in {"", *values["estimators"]}
    report = Path("report.html").read_text()
    assert values["verdict"]["advice"] in re.sub("</?code>", "`", html.unescape(report))
    assert values["domain"]["inside"] > 0.5
    assert {row["estimator"] for row in values["scores"]} >= {"raw", "offset", "linear"}
    assert "truejoint evaluate" in report
    missed = call(f"{judge} --tolerance elbow=0.0001")
    assert missed.code == 1
    assert "elbow" in missed.out
    anyhow = judge.removesuffix(" --accept range")
    assert call(f"{anyhow} --tolerance elbow=5").code == 1, "outside the range of training"
    known = call(f"evaluate {session}/m.st {session}/zigzag.parquet")
    assert known.code == 1
    assert "trained on" in known.out


def test_zeros_are_fitted_and_judged_as_they_are_used(call, session):
    training = f"{session}/zigzag.parquet {session}/random.parquet"
    call.good(f"calibrate {training} -e linear --zero recording -o m.st")
    assert len(read_calibration("m.st").origin.zeros) == 2
    judge = f"evaluate {session}/m.st {session}/random.parquet --rezero-s"
    values = json.loads(call(f"{judge} 5 --json").out)
    assert values["rezero"] == 5.0
    assert any("first 5 s of each recording" in remark for remark in values["verdict"]["remarks"])
    call.refuses("after the 1000 s that re-zero it", f"{judge} 1000")


def test_a_failed_data_check_ends_in_one_line_unless_accepted(call, session):
    recording = read_recording(session / "zigzag.parquet")
    truth = recording.column("truth/elbow").copy()
    truth[100:4000:100] += 0.5
    spoiled = replace(recording, table=recording.table.assign(**{"truth/elbow": truth}))
    write_parquet(spoiled, "spoiled.parquet")
    line = "calibrate spoiled.parquet -e linear -o m.st"
    refused = call(line)
    assert refused.code == 1
    assert "fail: outliers: truth/elbow in" in refused.err
    assert refused.err.splitlines()[-1] == (
        "truejoint: the data check failed (outliers): mend the data, or go on with "
        "--accept outliers"
    )
    assert not Path("m.st").exists()
    findings = call.json(line, code=1)["check"]["findings"]
    assert [f["name"] for f in findings if f["level"] == "fail"] == ["outliers"]
    call.good(f"{line} --accept outliers")
    judged = call.json(f"evaluate {session}/m.st spoiled.parquet", code=1)
    assert judged["check"]["findings"][0]["name"] == "outliers"


def test_parts_of_one_recording(call, session):
    recording = session / "random.parquet"
    call.good(f"calibrate {recording} -e linear --part 0:0.7 -o m.st")
    late = call(f"evaluate m.st {recording} --part 0.75:1 --json")
    objections = json.loads(late.out)["verdict"]["objections"]
    assert all("of a motion unlike it" in said for said in objections), "parts of one motion differ"


def test_settings_reach_the_estimator(call, session):
    how = "-e dnn --set epochs=2 --set hidden_layer_sizes=7,5"
    call.good(f"calibrate {session}/zigzag.parquet {how} -o m.st")
    parameters = read_calibration("m.st").model.get_params()
    assert parameters["epochs"] == 2
    assert tuple(parameters["hidden_layer_sizes"]) == (7, 5)


def test_robots_are_listed_with_what_a_column_map_names(call):
    listed = call.json("robots")["robots"]
    assert [robot["name"] for robot in listed] == [*robot_names()]
    said = call("robots dvrk_psm").out
    for word in ("outer_insertion", "240", "mm", "<quantity>/<joint>", *QUANTITIES):
        assert word in said
    assert "which it may name too: unused" in call("robots raven2:right").out
    assert call("show dvrk_psm").out == said


def test_estimators_are_listed_with_their_parameters(call):
    said, listed = call("estimators").out, call.json("estimators")["estimators"]
    assert [*listed] == [*estimator_names()]
    for name, facts in listed.items():
        assert re.search(rf"{name} +│ {facts['what'][:20]}.*{facts['auto']}", said)
    shown = call.json("estimators dnn")
    assert shown["parameters"]["hidden_layer_sizes"] == "(100, 100)"
    assert (shown["what"], shown["auto"]) == (listed["dnn"]["what"], "no")


def test_data_sets_are_listed(call):
    assert "davinci_grasper_umn" in {entry["name"] for entry in call.json("datasets")["datasets"]}
    shown = call.json("show dvrk_psm_berkeley")
    assert shown == call.json("datasets dvrk_psm_berkeley")
    assert shown["upstream"].startswith("BerkeleyAutomation/dvrkCalibration @ ")
    first = shown["recordings"][0]
    assert call.json(f"datasets dvrk_psm_berkeley:{first}")["recordings"] == [first]


ACCEPT = "--accept missing --accept frozen --accept unit"


@pytest.mark.parametrize(
    ("column", "rows", "value", "said"),
    [
        ("t", 10, 0.0, "back"),
        ("measured/elbow", 10, "high", "line 12"),
        ("measured/elbow", slice(None), 0.0, "measured/elbow"),
        ("truth/elbow", slice(600, None), np.nan, "truth/elbow"),
    ],
)
def test_bad_values_are_one_line_and_exit_code_2(call, session, column, rows, value, said):
    table = pd.read_parquet(session / "random.parquet").head(2000).astype(object)
    table.loc[rows, column] = value
    table.to_csv("run.csv", index=False)
    call.refuses(said, f"calibrate run.csv --robot raven2 -e linear -o m.st {ACCEPT}")
    assert not Path("m.st").exists()


def test_damaged_files_are_named(call, session):
    Path("empty.csv").touch()
    cut = (session / "random.parquet").read_bytes()[:-200]
    Path("truncated.parquet").write_bytes(cut)
    pd.read_parquet(session / "random.parquet")[:20].to_csv("short.csv", index=False)
    for name, said in {
        "empty.csv": "empty",
        "truncated.parquet": "trunc",
        "short.csv": "rows",
    }.items():
        call.refuses(said, f"calibrate {name} --robot raven2 -e linear -o m.st {ACCEPT}")
    content = bytearray((session / "m.st").read_bytes())
    content[-3] ^= 1
    Path("bad.st").write_bytes(content)
    call.refuses("bad.st", f"evaluate bad.st {session}/random.parquet")


def test_nothing_is_overwritten_unasked(call, session):
    before = (session / "m.st").read_bytes()
    call.refuses("--force", f"calibrate {session}/zigzag.parquet -e linear -o {session}/m.st")
    assert (session / "m.st").read_bytes() == before
    call.refuses("zigzag.parquet", f"collect {session}/zigzag.csv -o {session}")


@pytest.mark.parametrize(
    ("line", "command"),
    [
        ("trajectory random --seed", "trajectory"),
        ("node simulate --seed", "node simulate"),
        ("--debug show --robot", "show"),
    ],
)
def test_an_option_without_its_value_is_told_with_its_command(call, line, command):
    said = call(line).err
    option = line.split()[-1]
    assert said.endswith(
        f"Option '{option}' requires an argument. See `truejoint {command} --help`.\n"
    )
    assert ("Traceback" in said) == ("--debug" in line)


@pytest.mark.parametrize("line", ["", "--debug"])
def test_no_words_are_answered_with_the_help(call, line):
    result = call(line)
    assert result.code == 2
    assert "Calibrate and judge" in result.out
    assert not result.err


def test_the_robot_of_a_file_is_known_by_the_model_that_carries_it(call):
    Path("tool.toml").write_text('name = "my_tool"\njoints = [{ name = "jaw" }]\n')
    t = np.arange(200) * 0.02
    table = pd.DataFrame({"t": t, "measured/jaw": np.sin(t), "truth/jaw": 1.1 * np.sin(t)})
    table.to_csv("run.csv", index=False)
    call.good("calibrate run.csv --robot tool.toml -e linear -o m.st")
    for judge in ("evaluate", "check"):
        result = call(f"{judge} m.st run.csv --robot my_tool")
        assert result.code != 2, result.err


@pytest.mark.parametrize("command", ["evaluate", "check"])
def test_a_file_that_does_not_say_is_of_the_robot_of_the_model(call, session, command):
    table = read_recording(session / "random.parquet").table.head(2000)
    table.to_csv("run.csv", index=False)
    line = f"{command} {session}/m.st run.csv"
    assert call(line).code in {0, 1}
    call.refuses("is of raven2 (right arm)", f"{line} --robot raven2:right")
    columns = "\n".join(f'"{name}" = "{name}"' for name in table)
    Path("other.toml").write_text(f'robot = "dvrk_psm"\n[columns]\n{columns}')
    call.refuses("dvrk_psm", f"{line} --columns other.toml")
