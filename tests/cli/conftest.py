"""A small session on the simulated arm, made once through the command line itself."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from truejoint.cli.app import main


@dataclass(frozen=True)
class Result:
    """What a call of the command left: exit code and what it printed."""

    code: int
    out: str
    err: str


Call = Callable[..., Result]


@pytest.fixture
def call(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Call:
    """Run the command in this process."""

    def run(*arguments: str | Path) -> Result:
        monkeypatch.setattr(sys, "argv", ["truejoint", *map(str, arguments)])
        code = 0
        try:
            main()
        except SystemExit as stop:
            code = int(stop.code or 0)
        said = capsys.readouterr()
        return Result(code, said.out, said.err)

    return run


@pytest.fixture(scope="session")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with trajectories, recordings and a linear model."""
    folder = tmp_path_factory.mktemp("session")
    with pytest.MonkeyPatch.context() as patch:
        for arguments in (
            ["trajectory", "zigzag", "--sparsity", "1/2", "-o", f"{folder}/zigzag.csv"],
            ["trajectory", "random", "--duration-s", "60", "-o", f"{folder}/random.csv"],
            ["collect", f"{folder}/zigzag.csv", f"{folder}/random.csv", "-o", f"{folder}"],
            ["calibrate", f"{folder}/zigzag.parquet", "-e", "linear", "-o", f"{folder}/m.st"],
        ):
            patch.setattr(sys, "argv", ["truejoint", *arguments])
            with pytest.raises(SystemExit) as stop:
                main()
            assert not stop.value.code, arguments
    return folder
