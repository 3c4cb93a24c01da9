"""What a person names on the command line, and what becomes of it."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from truejoint import read_calibration, read_recording, write_parquet
from truejoint.recordings import Recording

FIT = "-e linear -o m.st"
OF_GRASPER = f"{FIT} --robot davinci_grasper"


def motion(seed: int = 0, rows: int = 400) -> pd.DataFrame:
    """A jaw that lags behind what its motor says, as the columns of a recording."""
    t = np.arange(rows) / 100
    jaw = 0.5 + 0.3 * np.sin((2 + 0.1 * seed) * t) * np.sin(5 * t)
    effort = 0.02 * np.cos((3 + 0.2 * seed) * t)
    truth = 1.02 * jaw + 0.5 * effort + 0.01
    columns = {"t": t, "measured/jaw": jaw, "effort/jaw": effort, "truth/jaw": truth}
    return pd.DataFrame(columns)


@pytest.fixture
def day(call) -> Path:
    """Two recordings among what else lies in a laboratory's folder."""
    day = Path("day")
    (day / "more").mkdir(parents=True)
    for seed in range(2):
        recording = Recording.from_columns(motion(seed), "davinci_grasper")
        write_parquet(recording, day / f"run{seed}.parquet")
    (day / "README.md").write_text("What was done that day, in words.\n")
    (day / "robot.log").write_text("12:00:01 homed\n12:00:05 moved\n")
    (day / "empty.csv").write_text("")
    (day / "picture.png").write_bytes(b"\x89PNG\0\0\0\0")
    pd.DataFrame({"t": [0, 1], "jaw": [0.1, 0.2]}).to_csv(day / "trajectory.csv", index=False)
    return day


@pytest.mark.parametrize("pattern", ["", "/*"])
def test_strangers_in_a_folder_are_left_out_with_a_word(call, day, pattern):
    said = call.good(f"calibrate '{day}{pattern}' {FIT}").err
    assert len(read_calibration("m.st").origin.sessions) == 2
    for stranger in ("README.md", "robot.log", "empty.csv", "picture.png", "trajectory.csv"):
        assert f"{stranger}: left out" in said


def test_a_damaged_recording_in_a_folder_is_not_passed_over(call, day):
    whole = (day / "run0.parquet").read_bytes()
    (day / "run0.parquet").write_bytes(whole[:-200])
    call.refuses("run0.parquet: is not a whole Parquet file", f"calibrate {day} {FIT}")
    for path in day.glob("*.parquet"):
        path.unlink()
    call.refuses("day: none of 6 files there is a recording", f"calibrate {day} {FIT}")


def test_strangers_among_mapped_files_lack_the_columns(call):
    for seed in range(2):
        table = motion(seed).set_axis(["time", "q", "tau", "encoder"], axis=1)
        table.to_csv(f"{seed}.csv", index=False)
    Path("notes.csv").write_text("what,when\nhomed,12:00\n")
    Path("map.toml").write_text(
        'robot = "davinci_grasper"\n[columns]\nt = "time"\n"measured/jaw" = "q"\n'
        '"effort/jaw" = "tau"\n"truth/jaw" = "encoder"\n'
    )
    said = call.good(f"calibrate '*.csv' --columns map.toml {FIT}").err
    assert "notes.csv: left out: column 'time' is not there" in said


def test_what_files_do_not_say_is_stated(call):
    motion(rows=800).drop(columns="t").to_csv("run.csv", index=False)
    stated = ("rate_hz=100", "homing_id=noon", "load_grams=250", "session=A")
    how = " ".join(f"--metadata {each}" for each in stated)
    metadata = call.json(f"calibrate run.csv {OF_GRASPER} {how}")["metadata"]
    (session,) = metadata["sessions"]
    assert metadata["homing_ids"] == ["noon"]
    assert session["session"] == "A"
    assert metadata["duration"] == pytest.approx(7.99)


def test_a_clock_that_restarts_makes_sessions(call):
    pd.concat([motion(0), motion(1)]).to_csv("run.csv", index=False)
    said = call.good(f"calibrate run.csv {OF_GRASPER} --metadata session=A").err
    assert "run.csv: its clock restarts: read as 2 recordings" in said
    sessions = read_calibration("m.st").origin.sessions
    assert [session.session for session in sessions] == ["A#1", "A#2"]


def test_constant_features_are_left_out_with_a_word(call):
    motion().assign(**{"effort/jaw": 0.1}).to_csv("run.csv", index=False)
    said = call.good(f"calibrate run.csv {OF_GRASPER}").err
    assert "left out: effort/jaw never change in the training rows" in said


def test_a_robots_file_is_joined_with_that_of_its_sensors(call):
    table = motion(3, rows=4000)
    table.drop(columns="truth/jaw").to_csv("robot.csv", index=False)
    stamps, degrees = 1e3 * (table["t"] - 7.25), np.degrees(table["truth/jaw"])
    encoder = pd.DataFrame({"stamp": stamps, "deg": degrees})
    encoder[::2].to_csv("encoder.csv", index=False)
    Path("map.toml").write_text(
        '[columns]\nt = { column = "stamp", unit = "ms" }\n'
        '"truth/jaw" = { column = "deg", unit = "deg" }\n'
    )
    line = "extract robot.csv --truth encoder.csv --robot davinci_grasper -o run.parquet"
    line += " --truth-columns map.toml"
    offset = call.json(line)["offset"]
    assert offset["seconds"] == pytest.approx(7.25, abs=0.01)
    assert offset["sd"] < 0.02
    joined = read_recording("run.parquet")
    assert np.abs(joined.column("truth/jaw") - table["truth/jaw"]).max() < 0.01
    stated = call(f"{line} --force --offset-s 7.25")
    assert "7.25 s behind (as stated)" in " ".join(stated.out.split())
    of_columns = "extract robot.csv --truth encoder.csv --truth-columns map.toml -o rig.parquet"
    assert call.json(of_columns)["offset"]["seconds"] == pytest.approx(7.25, abs=0.01)
    call.refuses("give one of the two", f"{line} --force --offset-s 7 --near-s 7")
    call.refuses("--force", line)


def test_a_map_is_written_to_start_from(call):
    table = motion().set_axis(["stamp", "jaw_pos", "jaw_torque", "jaw_encoder"], axis=1)
    table.to_csv("run.csv", index=False)
    line = "columns run.csv --robot davinci_grasper"
    printed = call.good(line).out
    call.good(f"{line} -o map.toml")
    assert Path("map.toml").read_text() == printed
    call.refuses("--force", f"{line} -o map.toml")
    assert "good unit" in call("doctor run.csv --columns map.toml").out
    (shown,) = call.json("show run.csv --columns map.toml")["shown"]
    assert [c["column"] for c in shown["columns"]] == ["measured/jaw", "effort/jaw", "truth/jaw"]
