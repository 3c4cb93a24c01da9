"""What the shell is offered for a word."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from tests.cli.conftest import Call

Complete = Callable[..., list[str]]


@pytest.fixture
def complete(call: Call, session: Path, monkeypatch: pytest.MonkeyPatch) -> Complete:
    """Words offered for the last one, in the folder of a session."""
    monkeypatch.chdir(session)

    def run(*words: str) -> list[str]:
        monkeypatch.setenv("_TRUEJOINT_COMPLETE", "complete_bash")
        monkeypatch.setenv("COMP_WORDS", " ".join(["truejoint", *words]))
        monkeypatch.setenv("COMP_CWORD", str(len(words)))
        return call().out.split()

    return run


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        (["eval"], ["evaluate"]),
        (["calibrate", "-e", "ukf_e"], ["ukf_elastic"]),
        (
            ["calibrate", "run.csv", "--robot", "raven"],
            ["raven2", "raven2:left", "raven2:gold", "raven2:right", "raven2:green"],
        ),
        (["calibrate", "davinci"], ["davinci_grasper_umn"]),
        (["calibrate", "davinci_grasper_umn", "--split", ""], ["frequency", "load"]),
        (["calibrate", "davinci_grasper_umn", "--joint", ""], ["jaw"]),
        (["calibrate", "zigzag.parquet", "--joint", "e"], ["elbow"]),
        (["calibrate", "zigzag.parquet", "--feature", "effort/e"], ["effort/elbow"]),
        (["calibrate", "--feature", "kuka"], ["kuka_kr300_dual_encoder"]),
        (["datasets", "fetch", "kuka"], ["kuka_kr300_dual_encoder"]),
        (["evaluate", "m.st", "random.parquet", "--tolerance", "i"], ["insertion="]),
        (["export", "m.st", "--to", ""], ["c", "onnx", "ros", "bag"]),
        (
            ["calibrate", "--metadata", "format=k"],
            ["format=kuka_kr300_dual_encoder", "format=kflex_tendon_sheath"],
        ),
        (["calibrate", "-e", "gru", "--set", "e"], ["epochs="]),
        (["calibrate", "-e", "no_such", "--set", ""], []),
        (["collect", "--robot", "dvrk_psm:p"], ["dvrk_psm:psm1", "dvrk_psm:psm2", "dvrk_psm:psm3"]),
        (["collect", "--topic", "measured_c"], ["measured_cp=", "measured_cv="]),
        (["trajectory", "zigzag", "--direction", "J3"], ["J3"]),
        (["check", "m.st", "random.parquet", "--level", ""], []),
        (["check", "nothing.st", "random.parquet", "--level", ""], []),
        (["calibrate", "nothing.csv", "--joint", ""], []),
        (["calibrate", ""], []),  # files are the shell's to complete
    ],
    ids=" ".join,
)
def test_values_complete(complete: Complete, words: list[str], offered: list[str]) -> None:
    assert complete(*words) == offered
