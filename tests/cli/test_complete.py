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
        (["calibrate", "run.csv", "--robot", "raven"], ["raven2"]),
        (["calibrate", "davinci"], ["davinci_grasper_umn"]),
        (["datasets", "kuka"], ["kuka_kr300_dual_encoder"]),
        (["datasets", "no_such"], []),
        (["export", "m.st", "--to", ""], ["c", "onnx", "ros", "bag"]),
        (["calibrate", "--metadata", "load"], ["load_grams="]),
        (["calibrate", "--accept", "outl"], ["outliers"]),
        (["trajectory", "zigzag", "--direction", "J3"], ["J3"]),
        (["study", "forceps-unl"], ["forceps-unloaded"]),
        (["calibrate", ""], []),  # files are the shell's to complete
    ],
    ids=" ".join,
)
def test_values_complete(complete: Complete, words: list[str], offered: list[str]) -> None:
    assert complete(*words) == offered
