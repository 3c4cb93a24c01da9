"""What `correct`, `show` and `evaluate` of several models make and say."""

from __future__ import annotations

import html
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from tests.cli.conftest import Call

from truejoint import calibrate, read_calibration, read_recording, write_calibration, write_parquet
from truejoint.calibration import with_interval
from truejoint.evaluation import part_by_time
from truejoint.runtime import Corrector, Status

ANYHOW = ("--accept", "range")  # half of the random motion is outside the zig-zag's range


def test_a_corrected_table_is_what_the_loop_gives(
    call: Call, session: Path, tmp_path: Path
) -> None:
    table = tmp_path / "out.csv"
    result = call(
        "correct", session / "m.st", session / "random.parquet", "-o", table, "--json", *ANYHOW
    )
    assert result.code == 0, result.err
    recording = read_recording(session / "random.parquet")
    corrector = Corrector(session / "m.st")
    corrector.set_homing(True, recording.provenance.homing_id)
    rows = recording.table[list(corrector.signals)].to_numpy()
    expected = []
    for t, sample in zip(recording.t, rows, strict=True):
        status = corrector.step(t, sample)
        expected.append([*corrector.position, Status(status).name])
    found = pd.read_csv(table)
    measured, corrected = (
        [f"{quantity}/{joint}" for joint in corrector.joints]
        for quantity in ("measured", "corrected")
    )
    assert list(found) == ["t", *measured, *corrected, "status"]
    assert "no half_width: the model states no interval" in result.err
    frame = pd.DataFrame(expected, columns=[*corrected, "status"])
    pd.testing.assert_frame_equal(found[[*frame]], frame, rtol=0, atol=1e-9)
    before = recording.table[["t", *measured]]
    pd.testing.assert_frame_equal(found[[*before]], before, rtol=0, atol=1e-6)
    stamps = table.read_text().splitlines()[1:]
    assert max(len(line.partition(",")[0]) for line in stamps) <= 12
    (counts,) = json.loads(result.out)["recordings"]
    assert counts["rows"] == len(found) == counts["corrected"] + sum(counts["flagged"].values())
    assert counts["corrected"] == (found["status"] == "OK").sum()


def test_several_recordings_go_into_one_table(call: Call, session: Path, tmp_path: Path) -> None:
    files = [session / "random.parquet", session / "zigzag.parquet"]
    out = tmp_path / "out.parquet"
    assert call("correct", session / "m.st", *files, "-o", out).code == 0
    found = pd.read_parquet(out)
    assert "is it a recording of truejoint's" in call("show", out).err
    names = [read_recording(file).provenance.session for file in files]
    assert found["recording"].unique().tolist() == names
    assert call("correct", session / "m.st", *files, "-o", out).code == 2


def test_rows_of_another_homing_stay_as_measured_and_fail(
    call: Call, session: Path, tmp_path: Path
) -> None:
    arguments = ["correct", session / "m.st", session / "random.parquet", "-o"]
    result = call(*arguments, tmp_path / "a.csv", "--metadata", "homing_id=tomorrow")
    assert result.code == 1
    assert "HOMED_AGAIN: the model is for homing seed 0, homing 1" in result.err
    found = pd.read_csv(tmp_path / "a.csv")
    measured = read_recording(session / "random.parquet").column("measured/elbow")
    np.testing.assert_allclose(found["corrected/elbow"], measured, atol=1e-9)
    assert "half_width/elbow" not in found


def test_a_table_is_in_the_units_of_the_column_map_and_says_where_no_width_is_stated(
    call: Call, session: Path, tmp_path: Path
) -> None:
    recording = read_recording(session / "random.parquet")
    parts = [part_by_time(recording, k / 9, (k + 1) / 9) for k in range(9)]
    write_calibration(with_interval(read_calibration(session / "m.st"), parts), tmp_path / "m.st")
    table, text = recording.table, 'robot = "raven2"\n[columns]\nt = "t"\n'
    for name, unit in recording.units.items():
        angle = name.startswith(("measured/", "truth/")) and unit == "rad"
        text += f'"{name}" = {{ column = "{name}", unit = "{"deg" if angle else unit}" }}\n'
        table[name] = np.rad2deg(table[name]) if angle else table[name]
    table.loc[0, "truth/elbow"] += 500.0  # truth is not needed, so it cannot fail
    table.to_csv(tmp_path / "run.csv", index=False)
    (tmp_path / "map.toml").write_text(text.replace('\n"t" = { column = "t", unit = "s" }', ""))
    arguments = ["correct", tmp_path / "m.st", tmp_path / "run.csv", "--accept", "range"]
    result = call(*arguments, "--columns", tmp_path / "map.toml", "-o", tmp_path / "a.csv")
    assert result.code == 0, result.err
    found = pd.read_csv(tmp_path / "a.csv")
    np.testing.assert_allclose(found["measured/elbow [deg]"], table["measured/elbow"], atol=1e-8)
    assert np.isfinite(found["measured/insertion [m]"]).all()
    empty = found["half_width/elbow [deg]"].isna()
    assert f"half_width is empty in {empty.sum()} rows" in result.err
    assert 0 < empty.sum() < len(found)
    assert found["status"][~empty].eq("OK").all()


def test_a_recording_that_begins_with_truth_is_re_zeroed(
    call: Call, session: Path, tmp_path: Path
) -> None:
    recording = read_recording(session / "random.parquet")
    table = recording.table
    table["truth/elbow"] += 0.02
    truth = [f"truth/{joint}" for joint in recording.joints_of("truth")]
    tomorrow = replace(recording.provenance, homing_id="tomorrow")
    brief = table.copy()
    brief.loc[table["t"] > table["t"].iloc[0] + 10.0, truth] = np.nan
    moved = replace(recording, table=brief, provenance=tomorrow)
    write_parquet(moved, tmp_path / "moved.parquet")
    arguments = ["correct", session / "m.st", tmp_path / "moved.parquet", "-o"]
    result = call(*arguments, tmp_path / "a.csv", "--rezero-s", "10", *ANYHOW)
    assert result.code == 0, result.err
    found = pd.read_csv(tmp_path / "a.csv")
    assert not found["status"].str.contains("HOMED_AGAIN").any()
    ok = found["status"] == "OK"
    left = (found["corrected/elbow"] - table["truth/elbow"])[ok]
    assert abs(left.median()) < 0.01
    refused = call(*arguments, tmp_path / "b.csv", "--rezero-s", "-1", *ANYHOW)
    assert refused.code == 2
    assert "give more than 0 s" in refused.err


def test_stamps_since_1970_are_given_as_the_file_had_them(
    call: Call, session: Path, tmp_path: Path
) -> None:
    table = read_recording(session / "random.parquet").table
    table["t"] += 1.7e9
    table.to_csv(tmp_path / "run.csv", index=False)
    model = session / "m.st"
    assert call("correct", model, tmp_path / "run.csv", "-o", tmp_path / "a.csv", *ANYHOW).code == 0
    found = pd.read_csv(tmp_path / "a.csv")
    np.testing.assert_allclose(found["t"], table["t"], rtol=0, atol=1e-6)


@pytest.mark.parametrize("command", [("correct", "-o", "out.csv"), ("evaluate",)])
def test_a_signal_that_is_absent_is_named_in_a_line_that_can_be_read(
    call: Call, session: Path, tmp_path: Path, command: tuple[str, ...]
) -> None:
    whole = read_recording(session / "random.parquet")
    units = {name: unit for name, unit in whole.units.items() if name != "effort/elbow"}
    part = replace(whole, table=whole.table.drop(columns="effort/elbow"), units=units)
    write_parquet(part, tmp_path / "part.parquet")
    name, *more = command
    result = call(name, session / "m.st", tmp_path / "part.parquet", *more)
    assert result.code == 2
    assert "lacks effort/elbow, which the features need; did you mean 'effort/" in result.err
    assert len(result.err.splitlines()[-1]) < 500


def test_two_recordings_of_one_name_are_refused(call: Call, session: Path, tmp_path: Path) -> None:
    recording = read_recording(session / "random.parquet")
    other = replace(recording, provenance=replace(recording.provenance, source="other"))
    write_parquet(other, tmp_path / "b.parquet")
    files = [session / "random.parquet", tmp_path / "b.parquet"]
    result = call("correct", session / "m.st", *files, "-o", tmp_path / "a.csv")
    assert result.code == 2
    assert "two recordings are called 'random 1 min, seed 0'" in result.err


def test_show_tells_what_a_model_is(call: Call, session: Path) -> None:
    model = read_calibration(session / "m.st")
    (shown,) = json.loads(call("show", session / "m.st", "--json").out)["shown"]
    assert shown["homings"] == ["seed 0, homing 1"]
    assert shown["sample"].split(", ") == list(model.loop_signals)
    assert [column["column"] for column in shown["columns"]] == list(model.signals)
    assert shown["columns"][1]["lowest"] == model.lower[1]
    assert len(shown["sha256"]) == 64
    text = call("show", session / "m.st").out
    for word in ("seed 0, homing 1", "truejoint calibrate", "measured/elbow", "deg"):
        assert word in text


def test_show_shortens_settings_that_hold_a_whole_mechanism(
    call: Call, session: Path, tmp_path: Path
) -> None:
    settings = f"CableFilter({'mechanism ' * 500})"
    model = read_calibration(session / "m.st").with_metadata(settings=settings)
    path = tmp_path / "long.safetensors"
    write_calibration(model, path)
    text = call("show", path).out
    assert "CableFilter(" in text
    assert " ... " in text
    assert text.count("mechanism") < 40
    (shown,) = json.loads(call("show", path, "--json").out)["shown"]
    assert shown["settings"] == settings


def test_show_tells_what_a_recording_is(call: Call, session: Path) -> None:
    path = session / "random.parquet"
    (shown,) = json.loads(call("show", path, "--json").out)["shown"]
    recording = read_recording(path)
    assert shown["homing_id"] == recording.provenance.homing_id
    columns = {column["column"]: column for column in shown["columns"]}
    assert set(columns) == set(recording.units)
    truth = columns["truth/elbow"]
    assert truth["highest"] == np.nanmax(recording.column("truth/elbow"))
    assert truth["missing"] == np.isnan(recording.column("truth/elbow")).sum()
    assert "seed 0, homing 1" in call("show", path).out


def test_several_models_are_judged_beside_each_other(
    call: Call, session: Path, tmp_path: Path
) -> None:
    zigzag, random = session / "zigzag.parquet", session / "random.parquet"
    write_calibration(calibrate(read_recording(zigzag), "poly2"), tmp_path / "curved.st")
    models = [session / "m.st", tmp_path / "curved.st"]
    page = tmp_path / "models.html"
    result = call("evaluate", *models, random, "--json", "--report", page, *ANYHOW)
    assert result.code == 0, result.err
    text = page.read_text(encoding="utf-8")
    for word in (
        "2 models compared",
        ">m (linear)<",
        ">curved (poly2)<",
        "residual-1",
        'id="distribution"',
    ):
        assert word in text
    found = json.loads(result.out)
    rmse = {(row["estimator"], row["joint"]): row["rmse"] for row in found["scores"]}
    for joint, best in found["best"].items():
        assert rmse[best, joint] == min(rmse["m (linear)", joint], rmse["curved (poly2)", joint])
    assert ("poly2", "elbow") not in rmse  # the model given stands for its baseline
    assert found["deploy"] in {"", "raw", "offset", "linear", "m (linear)", "curved (poly2)"}
    assert found["advice"] in re.sub("</?code>", "`", html.unescape(text))
    assert "instead" not in found["advice"]
    assert set(found["verdicts"]) == {"m (linear)", "curved (poly2)"}
    assert call("evaluate", *models, random).code == 1, "the check fails unless it is accepted"
    seen = call("evaluate", *models, zigzag)
    assert seen.code == 1
    assert seen.out.count("cannot be believed") == 2
    for arguments, said in (
        (models, "name recordings with truth to judge the models on, after the models"),
        (
            [*models, random, "--seed-of", models[0]],
            f"--seed-of judges one model; leave out {models[1]}",
        ),
        ([models[0], models[0], random], f"{models[0]}: named twice"),
    ):
        refused = call("evaluate", *arguments)
        assert refused.code == 2
        assert said in refused.err
