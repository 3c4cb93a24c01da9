"""What `correct`, `show` and `evaluate` of several models make and say."""

import html
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from truejoint import calibrate, read_calibration, read_recording, write_calibration, write_parquet
from truejoint.calibration import with_interval
from truejoint.evaluation import part_by_time
from truejoint.runtime import Corrector, Status, Unlearnt

ANYHOW = "--accept range"  # half of the random motion is outside the zig-zag's range


@pytest.fixture(scope="module")
def random(session):
    return read_recording(session / "random.parquet")


@pytest.fixture(scope="module")
def line(session):
    """A correction of the session's recording."""
    return f"correct {session}/m.st {session}/random.parquet"


def test_a_corrected_table_is_what_the_loop_gives(call, session, random, line):
    result = call.json(f"{line} -o out.csv {ANYHOW}")
    corrector = Corrector(session / "m.st")
    corrector.set_homing(True, random.provenance.homing_id)
    rows = random.table[list(corrector.signals)].to_numpy()
    expected = []
    for t, sample in zip(random.t, rows, strict=True):
        status = corrector.step(t, sample)
        expected.append([*corrector.position, Status(status).name, corrector.unlearnt.name])
    found = pd.read_csv("out.csv")
    measured, corrected = (
        [f"{quantity}/{joint}" for joint in corrector.joints]
        for quantity in ("measured", "corrected")
    )
    assert list(found) == ["t", *measured, *corrected, "status", "unlearnt"]
    frame = pd.DataFrame(expected, columns=[*corrected, "status", "unlearnt"])
    pd.testing.assert_frame_equal(found[[*frame]], frame, rtol=0, atol=1e-9)
    before = random.table[["t", *measured]]
    pd.testing.assert_frame_equal(found[[*before]], before, rtol=0, atol=1e-6)
    stamps = Path("out.csv").read_text().splitlines()[1:]
    assert max(len(line.partition(",")[0]) for line in stamps) <= 12
    (counts,) = result["recordings"]
    assert counts["rows"] == len(found) == counts["corrected"] + sum(counts["flagged"].values())
    assert counts["corrected"] == (found["status"] == "OK").sum()
    warned = {w.name: int(found["unlearnt"].str.contains(w.name).sum()) for w in Unlearnt}
    assert counts["unlearnt"] == {name: n for name, n in warned.items() if n}


def test_motion_that_is_slower_than_the_trainings_is_named(call, session, random, line):
    slow = replace(random, table=random.table.assign(t=4.0 * random.t))
    write_parquet(slow, "slow.parquet")
    said = call(f"correct {session}/m.st slow.parquet -o slow.csv {ANYHOW} --accept delay").err
    share = pd.read_csv("slow.csv")["unlearnt"].str.contains("SLOWER").mean()
    assert share > 0.5
    words = f"in {100 * share:.1f} % of the rows the arm moves slower than in training"
    assert f"SLOWER: {random.provenance.session}: {words}" in " ".join(said.split())


def test_several_recordings_go_into_one_table(call, session, line):
    said = call.good(f"{line} {session}/zigzag.parquet -o out.parquet {ANYHOW}").err
    assert "no half_width: the model states no interval" in said
    found = pd.read_parquet("out.parquet")
    assert "is no recording of truejoint's" in call("show out.parquet").err
    files = [session / "random.parquet", session / "zigzag.parquet"]
    names = [read_recording(file).provenance.session for file in files]
    assert found["recording"].unique().tolist() == names
    call.refuses("--force", f"{line} -o out.parquet")


def test_rows_of_another_homing_stay_as_measured_and_fail(call, random, line):
    result = call(f"{line} -o a.csv --metadata homing_id=tomorrow {ANYHOW}")
    assert result.code == 1
    assert "HOMED_AGAIN: the model is for homing seed 0, homing 1" in result.err
    found = pd.read_csv("a.csv")
    np.testing.assert_allclose(found["corrected/elbow"], random.column("measured/elbow"), atol=1e-9)
    assert "half_width/elbow" not in found


def test_a_table_is_in_the_units_of_the_column_map_and_says_where_no_width_is_stated(
    call, session, random
):
    parts = [part_by_time(random, k / 9, (k + 1) / 9) for k in range(9)]
    write_calibration(with_interval(read_calibration(session / "m.st"), parts), "m.st")
    table, text = random.table.copy(), 'robot = "raven2"\n[columns]\nt = "t"\n'
    for name, unit in random.units.items():
        angle = name.startswith(("measured/", "truth/")) and unit == "rad"
        text += f'"{name}" = {{ column = "{name}", unit = "{"deg" if angle else unit}" }}\n'
        table[name] = np.rad2deg(table[name]) if angle else table[name]
    table.loc[::100, "truth/elbow"] += 500.0  # truth is not needed, so it cannot fail
    table.to_csv("run.csv", index=False)
    Path("map.toml").write_text(text.replace('\n"t" = { column = "t", unit = "s" }', ""))
    said = call.good(f"correct m.st run.csv {ANYHOW} --columns map.toml -o a.csv").err
    found = pd.read_csv("a.csv")
    np.testing.assert_allclose(found["measured/elbow [deg]"], table["measured/elbow"], atol=1e-8)
    assert np.isfinite(found["measured/insertion [m]"]).all()
    empty = found["half_width/elbow [deg]"].isna()
    assert f"half_width is empty in {empty.sum()} rows" in said
    assert 0 < empty.sum() < len(found)
    assert found["status"][~empty].eq("OK").all()


def test_a_recording_that_begins_with_truth_is_re_zeroed(call, session, random):
    table = random.table.copy()
    table["truth/elbow"] += 0.02
    truth = [f"truth/{joint}" for joint in random.joints_of("truth")]
    tomorrow = replace(random.provenance, homing_id="tomorrow")
    brief = table.copy()
    brief.loc[table["t"] > table["t"].iloc[0] + 10.0, truth] = np.nan
    write_parquet(replace(random, table=brief, provenance=tomorrow), "moved.parquet")
    moved = f"correct {session}/m.st moved.parquet {ANYHOW} -o"
    call.good(f"{moved} a.csv --rezero-s 10")
    found = pd.read_csv("a.csv")
    assert not found["status"].str.contains("HOMED_AGAIN").any()
    residual = (found["corrected/elbow"] - table["truth/elbow"])[found["status"] == "OK"]
    assert abs(residual.median()) < 0.01
    call.refuses("give more than 0 s", f"{moved} b.csv --rezero-s -1")


def test_stamps_since_1970_are_given_as_the_file_had_them(call, session, random):
    table = random.table.assign(t=random.table["t"] + 1.7e9)
    table.to_csv("run.csv", index=False)
    call.good(f"correct {session}/m.st run.csv -o a.csv {ANYHOW}")
    np.testing.assert_allclose(pd.read_csv("a.csv")["t"], table["t"], rtol=0, atol=1e-6)


@pytest.mark.parametrize("command", ["correct -o out.csv", "evaluate"])
def test_a_signal_that_is_absent_is_named_in_a_line_that_can_be_read(
    call, session, random, command
):
    units = {name: unit for name, unit in random.units.items() if name != "effort/elbow"}
    part = replace(random, table=random.table.drop(columns="effort/elbow"), units=units)
    write_parquet(part, "part.parquet")
    said = "lacks effort/elbow, which the features need; did you mean 'effort/"
    assert len(call.refuses(said, f"{command} {session}/m.st part.parquet").splitlines()[-1]) < 500


def test_two_recordings_of_one_name_are_refused(call, random, line):
    write_parquet(
        replace(random, provenance=replace(random.provenance, source="other")), "b.parquet"
    )
    called = "two recordings are called 'random 1 min, seed 0'"
    call.refuses(called, f"{line} b.parquet -o a.csv")


def test_show_tells_what_a_model_is(call, session):
    model = read_calibration(session / "m.st")
    (shown,) = call.json(f"show {session}/m.st")["shown"]
    assert shown["homings"] == ["seed 0, homing 1"]
    assert shown["sample"].split(", ") == list(model.loop_signals)
    assert [column["column"] for column in shown["columns"]] == list(model.signals)
    assert shown["columns"][1]["lowest"] == model.lower[1]
    assert len(shown["sha256"]) == 64
    text = call(f"show {session}/m.st").out
    for word in ("seed 0, homing 1", "truejoint calibrate", "measured/elbow", "deg"):
        assert word in text


def test_show_shortens_settings_that_hold_a_whole_mechanism(call, session):
    settings = f"CableFilter({'mechanism ' * 500})"
    model = read_calibration(session / "m.st").with_metadata(settings=settings)
    write_calibration(model, "long.safetensors")
    text = call("show long.safetensors").out
    assert "CableFilter(" in text
    assert " ... " in text
    assert text.count("mechanism") < 40
    (shown,) = call.json("show long.safetensors")["shown"]
    assert shown["settings"] == settings


def test_show_tells_what_a_recording_is(call, session, random):
    (shown,) = call.json(f"show {session}/random.parquet")["shown"]
    assert shown["homing_id"] == random.provenance.homing_id
    columns = {column["column"]: column for column in shown["columns"]}
    assert set(columns) == set(random.units)
    truth = columns["truth/elbow"]
    assert truth["highest"] == np.nanmax(random.column("truth/elbow"))
    assert truth["missing"] == np.isnan(random.column("truth/elbow")).sum()
    assert "seed 0, homing 1" in call(f"show {session}/random.parquet").out


def test_several_models_are_judged_beside_each_other(call, session):
    zigzag, random = session / "zigzag.parquet", session / "random.parquet"
    write_calibration(calibrate(read_recording(zigzag), "poly2"), "curved.st")
    models = f"{session}/m.st curved.st"
    found = call.json(f"evaluate {models} {random} --report models.html {ANYHOW}")
    text = Path("models.html").read_text(encoding="utf-8")
    for word in ("2 models compared", ">m (linear)<", ">curved (poly2)<", "residual-1",
                 'id="distribution"'):  # fmt: skip
        assert word in text
    rmse = {(row["estimator"], row["joint"]): row["rmse"] for row in found["scores"]}
    for joint, best in found["best"].items():
        assert rmse[best, joint] == min(rmse["m (linear)", joint], rmse["curved (poly2)", joint])
    assert ("poly2", "elbow") not in rmse  # the model given stands for its baseline
    assert found["deploy"] in {"", "raw", "offset", "linear", "m (linear)", "curved (poly2)"}
    assert found["advice"] in re.sub("</?code>", "`", html.unescape(text))
    assert "instead" not in found["advice"]
    assert set(found["verdicts"]) == {"m (linear)", "curved (poly2)"}
    seen = call(f"evaluate {models} {zigzag}")
    assert seen.code == 1
    assert seen.out.count("cannot be believed") == 2
    for words, said in (
        (models, "name recordings with truth to judge the models on, after the models"),
        (f"{models} {random} --seed-of curved.st", "--seed-of judges one model; leave out curved"),
        (f"curved.st curved.st {random}", "curved.st: named twice"),
    ):
        call.refuses(said, f"evaluate {words}")


def test_a_recording_is_not_overwritten_by_its_own_correction(call, session):
    Path("run.parquet").write_bytes((session / "random.parquet").read_bytes())
    line = f"correct {session}/m.st run.parquet -o ./run.parquet --force"
    call.refuses("run.parquet: is to be corrected itself", line)
    assert read_recording("run.parquet").joints_of("truth")
