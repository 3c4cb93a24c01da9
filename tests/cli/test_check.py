"""`truejoint check` as a person calls it, and the interval that it judges by."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from truejoint.recordings import Recording, read_recording, write_parquet


@pytest.fixture(scope="module")
def pieces(session: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the minute of random motion in ten pieces, and a tenth that was homed again."""
    folder = tmp_path_factory.mktemp("pieces")
    whole = read_recording(session / "random.parquet")
    for k, rows in enumerate(np.array_split(np.arange(len(whole)), 10)):
        write_parquet(whole.rows(rows), folder / f"p{k}.parquet")
    last = read_recording(folder / "p9.parquet")
    table = last.table.assign(**{"truth/elbow": last.table["truth/elbow"] + 0.1})
    provenance = replace(last.provenance, homing_id="another")
    write_parquet(Recording(table, last.units, provenance), folder / "homed_again.parquet")
    return folder


@pytest.fixture
def model(call, session, pieces, tmp_path) -> Path:
    """Linear model with a 90 % interval from nine pieces."""
    path = tmp_path / "m.safetensors"
    options = [text for k in range(9) for text in ("--interval", pieces / f"p{k}.parquet")]
    made = call("calibrate", session / "zigzag.parquet", "-e", "linear", "-o", path, *options)
    assert made.code == 0, made.err
    assert "90 % shoulder ± " in " ".join(made.out.split())
    assert "95 %" not in made.out
    assert "says nothing of another homing" in " ".join(made.out.split())
    return path


def test_a_model_that_holds_is_code_0(call, model, pieces):
    said = call("check", model, pieces / "p9.parquet")
    assert said.code == 0, said.err
    assert "The 90 % interval holds" in said.out


def test_a_model_that_no_longer_holds_is_code_1_and_can_be_rezeroed(call, model, pieces, tmp_path):
    mended = tmp_path / "mended.safetensors"
    test = pieces / "homed_again.parquet"
    said = call("check", model, test, "--json")
    assert said.code == 1
    found = json.loads(said.out)
    assert found["holds"] is False
    assert [joint["holds"] for joint in found["joints"]] == [True, False, True]
    assert found["joints"][1]["offset"] == pytest.approx(0.1, abs=0.02)
    assert call("rezero", model, test, "-o", mended).code == 0
    assert call("check", mended, test).code == 0
    again = call("rezero", model, test, "-o", mended)
    assert again.code == 2
    assert "exists already" in again.err


def test_a_model_without_an_interval_gives_no_verdict(call, session, pieces):
    said = call("check", session / "m.st", pieces / "p9.parquet")
    assert said.code == 0, said.err
    assert "No verdict: the model states no interval" in " ".join(said.out.split())


def test_wrong_calls_are_code_2_and_one_line(call, model, pieces, tmp_path):
    for arguments, said in (
        ([model, pieces / "p9.parquet", "--level", "95"], "takes at least 19"),
        ([model, pieces / "*.parquet"], "takes one at a time"),
        ([tmp_path / "no.st", pieces / "p9.parquet"], "no.st"),
    ):
        result = call("check", *arguments)
        assert result.code == 2, result.out
        assert said in result.err
        assert result.err.strip().splitlines()[-1].startswith("truejoint: ")
