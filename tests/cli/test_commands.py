"""Every command as a person calls it: what it makes, says and returns."""

from __future__ import annotations

import html
import json
import re
import shlex
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from tests.cli.conftest import Call

from truejoint import read_calibration, read_recording, write_parquet
from truejoint.cli.commands import COMMANDS, GROUPS, command
from truejoint.estimators.registry import estimator_names
from truejoint.motion import read_trajectory
from truejoint.recordings.read.map_sketch import QUANTITIES
from truejoint.robots import robot_names


@pytest.mark.parametrize("name", ["", *{**GROUPS, **COMMANDS}])
def test_help_ends_in_an_example_that_is_understood(call: Call, name: str) -> None:
    result = call(*name.split(), "--help")
    assert result.code == 0
    example = " ".join(result.out.partition("Example: ")[2].split()).removesuffix(
        " shows the whole way on a simulated RAVEN-II."
    )
    called = shlex.split(example)
    assert called[: len(name.split()) + 1] == ["truejoint", *name.split()]
    line = f"{shlex.join(called[1:])} "
    longest = max((n for n in COMMANDS if line.startswith(f"{n} ")), key=len)
    command(longest).make_context("truejoint", called[1 + len(longest.split()) :])


def test_session_is_what_was_asked_for(session: Path) -> None:
    path = read_trajectory(session / "zigzag.csv")
    assert path.joints == ("shoulder", "elbow", "insertion")
    recording = read_recording(session / "random.parquet")
    assert recording.t[0] == 0.0
    assert recording.duration == pytest.approx(60.0, abs=30.0)
    assert recording.provenance.command.startswith("truejoint collect")
    assert recording.provenance.load == 0.0
    model = read_calibration(session / "m.st")
    assert model.joints == path.joints
    assert len(model.feature_set) == 16


def test_evaluate_judges_and_reports(call: Call, session: Path, tmp_path: Path) -> None:
    report = tmp_path / "report.html"
    result = call(
        "evaluate", session / "m.st", session / "random.parquet", "--report", report, "--json",
        "--accept", "range",
    )  # fmt: skip
    assert result.code == 0
    values = json.loads(result.out)
    assert values["verdict"]["passed"] is True
    assert values["verdict"]["deploy"] in {"", *values["estimators"]}
    shown = re.sub("</?code>", "`", html.unescape(report.read_text()))
    assert values["verdict"]["advice"] in shown
    assert values["domain"]["inside"] > 0.5
    assert {row["estimator"] for row in values["scores"]} >= {"raw", "offset", "linear"}
    assert "truejoint evaluate" in report.read_text()


def test_zeros_are_fitted_and_judged_as_they_are_used(
    call: Call, session: Path, tmp_path: Path
) -> None:
    model, recordings = tmp_path / "m.st", [session / "zigzag.parquet", session / "random.parquet"]
    fitted = call("calibrate", *recordings, "-e", "linear", "--zero", "recording", "-o", model)
    assert fitted.code == 0
    assert len(read_calibration(model).origin.zeros) == len(recordings)
    arguments = ["evaluate", session / "m.st", recordings[1], "--rezero-s"]
    result = call(*arguments, "5", "--json")
    values = json.loads(result.out)
    assert values["rezero"] == 5.0
    assert any("first 5 s of each recording" in remark for remark in values["verdict"]["remarks"])
    refused = call(*arguments, "1000")
    assert refused.code == 2
    assert "after the 1000 s that re-zero it" in refused.err


def test_missed_tolerance_is_exit_code_1(call: Call, session: Path) -> None:
    arguments = ["evaluate", session / "m.st", session / "random.parquet"]
    assert call(*arguments, "--tolerance", "elbow=5").code == 1  # outside the range of training
    arguments += ["--accept", "range"]
    assert call(*arguments, "--tolerance", "elbow=5").code == 0
    missed = call(*arguments, "--tolerance", "elbow=0.0001")
    assert missed.code == 1
    assert "elbow" in missed.out


def test_testing_on_training_rows_fails(call: Call, session: Path) -> None:
    result = call("evaluate", session / "m.st", session / "zigzag.parquet")
    assert result.code == 1
    assert "trained on" in result.out


def test_a_failed_data_check_ends_in_one_line_unless_accepted(
    call: Call, session: Path, tmp_path: Path
) -> None:
    recording = read_recording(session / "zigzag.parquet")
    truth = recording.column("truth/elbow").copy()
    truth[100:4000:100] += 0.5
    spoiled = replace(recording, table=recording.table.assign(**{"truth/elbow": truth}))
    write_parquet(spoiled, tmp_path / "spoiled.parquet")
    arguments = ["calibrate", tmp_path / "spoiled.parquet", "-e", "linear", "-o", tmp_path / "m.st"]
    refused = call(*arguments)
    assert refused.code == 1
    assert "fail: outliers: truth/elbow in" in refused.err
    assert refused.err.splitlines()[-1] == (
        "truejoint: the data check failed (outliers): mend the data, or go on with "
        "--accept outliers"
    )
    assert not (tmp_path / "m.st").exists()
    said = json.loads(call(*arguments, "--json").out)
    assert [f["name"] for f in said["check"]["findings"] if f["level"] == "fail"] == ["outliers"]
    assert call(*arguments, "--accept", "outliers").code == 0
    assert call(*arguments, "--accept", "outlier", "--force").code == 2
    judged = call("evaluate", session / "m.st", tmp_path / "spoiled.parquet", "--json")
    assert judged.code == 1
    assert json.loads(judged.out)["check"]["findings"][0]["name"] == "outliers"


def test_parts_of_one_recording(call: Call, session: Path, tmp_path: Path) -> None:
    model, recording = tmp_path / "m.st", session / "random.parquet"
    assert call("calibrate", recording, "-e", "linear", "--part", "0:0.7", "-o", model).code == 0
    late = call("evaluate", model, recording, "--part", "0.75:1", "--json")
    objections = json.loads(late.out)["verdict"]["objections"]
    assert all("of a motion unlike it" in said for said in objections), "parts of one motion differ"


def test_settings_reach_the_estimator(call: Call, session: Path, tmp_path: Path) -> None:
    model = tmp_path / "m.st"
    result = call(
        "calibrate", session / "zigzag.parquet", "-e", "dnn", "-o", model, "--set", "epochs=2",
        "--set", "hidden_layer_sizes=7,5",
    )  # fmt: skip
    assert result.code == 0
    parameters = read_calibration(model).model.get_params()
    assert parameters["epochs"] == 2
    assert tuple(parameters["hidden_layer_sizes"]) == (7, 5)


def test_robots_are_listed_with_what_a_column_map_names(call: Call) -> None:
    listed = json.loads(call("robots", "--json").out)["robots"]
    assert [robot["name"] for robot in listed] == [*robot_names()]
    said = call("robots", "dvrk_psm").out
    for word in ("outer_insertion", "240", "mm", "<quantity>/<joint>", *QUANTITIES):
        assert word in said
    assert "which it may name too: unused" in call("robots", "raven2:right").out
    assert call("show", "dvrk_psm").out == said


def test_estimators_are_listed_with_their_parameters(call: Call) -> None:
    said = call("estimators").out
    listed = json.loads(call("estimators", "--json").out)["estimators"]
    assert [*listed] == [*estimator_names()]
    for name, facts in listed.items():
        assert re.search(rf"{name} +│ {facts['what'][:20]}.*{facts['auto']}", said)
    shown = json.loads(call("estimators", "dnn", "--json").out)
    assert shown["parameters"]["hidden_layer_sizes"] == "(100, 100)"
    assert (shown["what"], shown["auto"]) == (listed["dnn"]["what"], "no")


def test_data_sets_are_listed(call: Call) -> None:
    names = {entry["name"] for entry in json.loads(call("datasets", "--json").out)["datasets"]}
    assert "davinci_grasper_umn" in names
    shown = json.loads(call("show", "dvrk_psm_berkeley", "--json").out)
    assert shown == json.loads(call("datasets", "dvrk_psm_berkeley", "--json").out)
    assert shown["upstream"].startswith("BerkeleyAutomation/dvrkCalibration @ ")


def _damaged(session: Path, folder: Path, damage: str) -> Path:
    good = session / "random.parquet"
    path = folder / f"{damage}.csv"
    table = pd.read_parquet(good)
    if damage == "truncated":
        path = folder / "truncated.parquet"
        path.write_bytes(good.read_bytes()[:-200])
        return path
    if damage == "empty":
        path.write_text("")
        return path
    if damage == "time goes back":
        table.loc[10, "t"] = 0.0
    elif damage == "text":
        table = table.astype(object)
        table.loc[10, "measured/elbow"] = "high"
    elif damage == "missing column":
        table = table.drop(columns=["effort/elbow"])
    elif damage == "constant":
        table["measured/elbow"] = 0.0
    elif damage == "short":
        table = table[:20]
    elif damage == "truth stops":
        table.loc[len(table) // 3 :, "truth/elbow"] = np.nan
    table.to_csv(path, index=False)
    return path


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        ("truncated", "truncated.parquet"),
        ("empty", "empty"),
        ("text", "line 12"),
        ("time goes back", "back"),
        ("constant", "measured/elbow"),
        ("short", "rows"),
        ("truth stops", "truth/elbow"),
    ],
)
def test_bad_recordings_are_one_line_and_exit_code_2(
    call: Call, session: Path, tmp_path: Path, damage: str, said: str
) -> None:
    path = _damaged(session, tmp_path, damage)
    model = tmp_path / "m.st"
    arguments = ["calibrate", path, "--robot", "raven2", "-e", "linear", "-o", model]
    accept = [word for name in ("missing", "frozen", "unit") for word in ("--accept", name)]
    result = call(*arguments, *accept)
    assert result.code == 2
    last = result.err.strip().splitlines()[-1]
    assert last.startswith("truejoint: ")
    assert said in last
    assert "Traceback" not in result.err
    assert not model.exists()


def test_missing_column_is_refused_when_applied(call: Call, session: Path, tmp_path: Path) -> None:
    path = _damaged(session, tmp_path, "missing column")
    result = call("evaluate", session / "m.st", path, "--robot", "raven2")
    assert result.code == 2
    assert "effort/elbow" in result.err


def test_damaged_model_is_refused(call: Call, session: Path, tmp_path: Path) -> None:
    model = tmp_path / "m.st"
    content = bytearray((session / "m.st").read_bytes())
    content[-3] ^= 1
    model.write_bytes(content)
    result = call("evaluate", model, session / "random.parquet")
    assert result.code == 2
    assert str(model) in result.err


def test_nothing_is_overwritten_unasked(call: Call, session: Path) -> None:
    before = (session / "m.st").read_bytes()
    result = call("calibrate", session / "zigzag.parquet", "-e", "linear", "-o", session / "m.st")
    assert result.code == 2
    assert "--force" in result.err
    assert (session / "m.st").read_bytes() == before
    collected = call("collect", session / "zigzag.csv", "-o", session)
    assert collected.code == 2
    assert "zigzag.parquet" in collected.err


def test_the_last_calibration_is_the_prior_of_the_next(call: Call, session: Path) -> None:
    model = session / "next.st"
    made = call(
        "adapt", session / "m.st", session / "random.parquet",
        "--reference", session / "zigzag.parquet", "-o", model,
    )  # fmt: skip
    assert made.code == 0, made.err
    read = read_calibration(model)
    assert [Path(one).name for one in read.metadata["prior"]["reference"]] == ["zigzag.parquet"]
    assert read.estimator == "linear"
    assert read.metadata["prior"]["robot"] == "raven2 (left arm)"
    assert "truejoint adapt" in read.metadata["command"]
    model.unlink()


@pytest.mark.parametrize(
    ("arguments", "command"),
    [
        (["trajectory", "random", "--seed"], "trajectory"),
        (["node", "simulate", "--seed"], "node simulate"),
        (["--debug", "show", "--robot"], "show"),
    ],
)
def test_an_option_without_its_value_is_told_with_its_command(
    call: Call, arguments: list[str], command: str
) -> None:
    result = call(*arguments)
    assert result.err.endswith(
        f"Option '{arguments[-1]}' requires an argument. See `truejoint {command} --help`.\n"
    )
    assert ("Traceback" in result.err) == ("--debug" in arguments)


@pytest.mark.parametrize("arguments", [[], ["--debug"]])
def test_no_words_are_answered_with_the_help(call: Call, arguments: list[str]) -> None:
    result = call(*arguments)
    assert result.code == 2
    assert "Calibrate and judge" in result.out
    assert not result.err


def test_the_robot_of_a_file_is_known_by_the_model_that_carries_it(
    call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("tool.toml").write_text('name = "my_tool"\njoints = [{ name = "jaw" }]\n')
    t = np.arange(200) * 0.02
    rows = np.column_stack([t, np.sin(t), 1.1 * np.sin(t)])
    header = "t,measured/jaw,truth/jaw"
    np.savetxt("run.csv", rows, delimiter=",", header=header, comments="")
    made = call("calibrate", "run.csv", "--robot", "tool.toml", "-e", "linear", "-o", "m.st")
    assert made.code == 0, made.err
    for judge in ("evaluate", "check"):
        result = call(judge, "m.st", "run.csv", "--robot", "my_tool")
        assert result.code != 2, result.err


@pytest.mark.parametrize("command", ["evaluate", "check"])
def test_a_file_that_does_not_say_is_of_the_robot_of_the_model(
    call: Call, session: Path, tmp_path: Path, command: str
) -> None:
    recording = read_recording(session / "random.parquet")
    path, other = tmp_path / "run.csv", tmp_path / "other.toml"
    recording.table.to_csv(path, index=False)
    assert call(command, session / "m.st", path).code in {0, 1}
    right = call(command, session / "m.st", path, "--robot", "raven2:right")
    assert right.code == 2
    assert "is of raven2 (right arm)" in right.err
    lines = ['robot = "dvrk_psm"', "[columns]"]
    lines += [f'"{name}" = "{name}"' for name in recording.table.columns]
    other.write_text("\n".join(lines))
    mapped = call(command, session / "m.st", path, "--columns", other)
    assert mapped.code == 2
    assert "dvrk_psm" in mapped.err
