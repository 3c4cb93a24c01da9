"""A small session on the simulated arm, made once through the command line itself."""

import json
import shlex
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from truejoint.cli.app import main


@dataclass(frozen=True)
class Result:
    """What a call of the command left: exit code and what it printed."""

    code: int
    out: str
    err: str


@dataclass(frozen=True)
class Call:
    """Runs the command in this process: its words, or a line of them as it is typed."""

    patch: pytest.MonkeyPatch
    capture: pytest.CaptureFixture[str]

    def __call__(self, *words: object) -> Result:
        typed = shlex.split(words[0]) if len(words) == 1 and isinstance(words[0], str) else words
        self.patch.setattr(sys, "argv", ["truejoint", *map(str, typed)])
        code = 0
        try:
            main()
        except SystemExit as stop:
            code = int(stop.code or 0)
        said = self.capture.readouterr()
        return Result(code, said.out, said.err)

    def good(self, *words: object) -> Result:
        """Run what must end well."""
        result = self(*words)
        assert result.code == 0, result.out + result.err
        return result

    def json(self, line: str, code: int = 0) -> Any:
        """Run what must end with this code; gives its values."""
        result = self(f"{line} --json")
        assert result.code == code, result.out + result.err
        return json.loads(result.out)

    def refuses(self, said: str, *words: object) -> str:
        """Run what must be refused in a last line that says this; gives all that was said."""
        result = self(*words)
        assert (result.code, result.out) == (2, ""), result.err
        last = result.err.splitlines()[-1]
        assert last.startswith("truejoint: ")
        assert said in last
        assert "fault of truejoint" not in last
        assert "Traceback" not in result.err
        return result.err


@pytest.fixture
def call(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> Call:
    """Run the command in an empty folder."""
    monkeypatch.chdir(tmp_path)
    return Call(monkeypatch, capsys)


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
