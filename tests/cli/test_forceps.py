from __future__ import annotations

import json

import pytest
from typer.testing import CliRunner

from truejoint.cli.forceps import app
from truejoint.errors import TruejointError
from truejoint.recordings import read_recording

run = CliRunner().invoke


def test_table2_prints_json_and_writes_files(tmp_path):
    result = run(app, ["table2", "--specimen", "B", "--json", "-o", str(tmp_path)])
    assert result.exit_code == 0
    assert json.loads(result.stdout)["specimen"] == "B"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["table2.json", "table2.md", "table2.png"]
    again = run(app, ["table2", "--specimen", "B", "-o", str(tmp_path)])
    assert isinstance(again.exception, TruejointError)


def test_a_designers_own_file_is_taken(tmp_path):
    path = tmp_path / "stiff.toml"
    path.write_text("[drive_cable]\nstiffness = 16000.0\n", encoding="utf-8")
    result = run(app, ["load", "--parameters", str(path)])
    assert result.exit_code == 0
    assert "specimen stiff" in result.stdout


def test_plant_writes_a_recording(tmp_path):
    path = tmp_path / "run.parquet"
    result = run(app, ["plant", "--motion", "load", "--load-g", "50", "-o", str(path), "--json"])
    assert json.loads(result.stdout)["rows"] == len(read_recording(path))


@pytest.mark.parametrize(
    "arguments", [["table2", "--specimen", "C"], ["population", "--count", "0"]]
)
def test_wrong_calls_are_refused(arguments):
    result = run(app, arguments)
    assert isinstance(result.exception, TruejointError)
