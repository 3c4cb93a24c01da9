"""`truejoint check` as a person calls it, and the interval that it judges by."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from truejoint import read_recording, write_parquet
from truejoint.recordings import Recording


@pytest.fixture(scope="module")
def pieces(session, tmp_path_factory) -> Path:
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
def model(call, session, pieces):
    """Linear model with a 90 % interval from nine pieces."""
    how = " ".join(f"--interval {pieces}/p{k}.parquet" for k in range(9))
    made = call.good(f"calibrate {session}/zigzag.parquet -e linear -o m.safetensors {how}")
    said = " ".join(made.out.split())
    assert "90 % shoulder ± " in said
    assert "95 %" not in said
    assert "says nothing of another homing" in said
    return "m.safetensors"


def test_an_interval_that_holds_or_not_and_a_model_that_is_re_zeroed(call, model, pieces):
    held = call.good(f"check {model} {pieces}/p9.parquet")
    assert "The 90 % interval holds" in held.out
    found = call.json(f"check {model} {pieces}/homed_again.parquet", code=1)
    assert found["holds"] is False
    assert [joint["holds"] for joint in found["joints"]] == [True, False, True]
    assert found["joints"][1]["offset"] == pytest.approx(0.1, abs=0.02)
    rezero = f"rezero {model} {pieces}/homed_again.parquet -o mended.safetensors"
    call.good(rezero)
    call.good(f"check mended.safetensors {pieces}/homed_again.parquet")
    call.refuses("exists already", rezero)
    call.refuses("takes at least 19", f"check {model} {pieces}/p9.parquet --level 95")
    call.refuses("takes one at a time", f"check {model} '{pieces}/*.parquet'")
    call.refuses("no.st", f"check no.st {pieces}/p9.parquet")


def test_a_model_without_an_interval_gives_no_verdict(call, session, pieces):
    said = call.good(f"check {session}/m.st {pieces}/p9.parquet")
    assert "No verdict: the model states no interval" in " ".join(said.out.split())
