"""Names that are wrong are refused, with the nearest one, before anything is read."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

import pytest
from tests.cli.conftest import Call

import truejoint
from truejoint.cli.fit_options import configured
from truejoint.errors import TruejointError


@pytest.fixture
def nothing_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_arguments: object, **_options: object) -> None:
        raise AssertionError("a recording was read")

    monkeypatch.setattr(truejoint.recordings, "read_recordings", refuse)


@pytest.mark.usefixtures("nothing_is_read")
@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["-e", "lin"], "did you mean 'linear'?"),
        (["--set", "epocs=3"], "did you mean 'epochs'?"),
        (["--set", "epochs=many"], "not of the kind"),
        (["--set", "epochs=-1"], "epochs is -1"),
        (["-e", "rich_play", "--set", "leading=many"], "'many' is no whole number"),
        (["-e", "rich_play", "--set", "leading=-1"], "leading is -1"),
        (["--robot", "raven"], "did you mean 'raven2'?"),
        (["--robot", "raven2:middle"], "no arm"),
        (["--robot", "raven2", "--joint", "elbw"], "did you mean 'elbow'?"),
        (["--metadata", "format=parket"], "did you mean 'parquet'?"),
        (["--feature", "play(measured/elbow, x)"], "'x' is not a number"),
        (["--test", "davinci_graspr_umn"], "did you mean 'davinci_grasper_umn'?"),
        (["--interval", "kflex_tendon_sheath:nothing"], "no recording fits"),
        (["-o", "m.onnx"], "call it m.safetensors"),
        (["-o", "model.csv"], "call it model.safetensors"),
        (["-o", "m.st"], "--force"),
        (["-e"], "Option '-e' requires an argument. See `truejoint calibrate --help`."),
        (["-o", "nosuch/m.st"], "the folder nosuch does not exist"),
    ],
    ids=lambda words: " ".join(words) if isinstance(words, list) else "",
)
def test_calibrate(
    call: Call,
    session: Path,
    monkeypatch: pytest.MonkeyPatch,
    options: list[str],
    said: str,
) -> None:
    monkeypatch.chdir(session)
    result = call("calibrate", "zigzag.parquet", "-o", "new.st", *options)
    assert result.code == 2
    assert said in result.err
    assert len(result.err.strip().splitlines()) == 1


@pytest.mark.usefixtures("nothing_is_read")
@pytest.mark.parametrize(
    ("option", "value", "said"),
    [
        ("--report", "nosuch/report.html", "the folder nosuch does not exist"),
        ("--report", "report.pdf", "report.pdf: a report is an HTML page; call it report.html"),
        ("--tolerance", "elbo=0.2", "did you mean 'elbow'?"),
    ],
)
def test_evaluate(call: Call, session: Path, option: str, value: str, said: str) -> None:
    result = call("evaluate", session / "m.st", session / "random.parquet", option, value)
    assert result.code == 2
    assert said in result.err


@pytest.mark.parametrize(
    ("option", "wrong", "right"),
    [("--joint", "elbw", "elbow"), ("--feature", "rate(effort/elbw, 0.1)", "effort/elbow")],
)
def test_a_name_that_no_file_can_have_is_refused_after_the_first(
    call: Call, session: Path, tmp_path: Path, option: str, wrong: str, right: str
) -> None:
    (tmp_path / "unreadable.parquet").write_text("")
    files = [session / "zigzag.parquet", tmp_path / "unreadable.parquet"]
    result = call("calibrate", *files, option, wrong, "-o", tmp_path / "m.st")
    assert result.code == 2
    assert f"did you mean {right!r}?" in result.err


@pytest.mark.parametrize("text", ["50,50", "(50, 50)", "[50,50]", "(50,50,)"])
def test_several_numbers_are_written_as_one_likes(text: str) -> None:
    estimator = configured("dnn", [f"hidden_layer_sizes={text}"])
    assert estimator.get_params()["hidden_layer_sizes"] == (50, 50)


@pytest.mark.parametrize("setting", ["epochs=1,2", "epochs=", "epochs", "hidden_layer_sizes=a"])
def test_a_setting_that_is_none_is_refused(setting: str) -> None:
    with pytest.raises(TruejointError, match="--set"):
        configured("dnn", [setting])


def test_the_package_runs_as_a_module(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["truejoint", "--version"])
    with pytest.raises(SystemExit) as stop:
        runpy.run_module("truejoint", run_name="__main__")
    assert not stop.value.code
    assert capsys.readouterr().out.startswith("truejoint ")


@pytest.mark.parametrize("name", ["[/x]", "[bold]run[/bold].csv", "\\[x]"])
def test_brackets_in_a_name_are_no_markup(
    call: Call, session: Path, tmp_path: Path, name: str
) -> None:
    result = call("check", session / "m.st", name)
    assert result.code == 2
    assert name in result.err
    folder = tmp_path / "[/y]"
    folder.mkdir(parents=True)
    (folder / "run.csv").write_bytes(b"t,measured/elbow\n")
    result = call("check", session / "m.st", folder / "run.csv", "--robot", "raven2")
    assert result.code == 2
    assert "[/y]" in result.err
