"""What a person names on the command line, and what becomes of it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from tests.cli.conftest import Call

from truejoint import read_calibration, read_recording, write_parquet
from truejoint.recordings import Recording


def motion(seed: int = 0, rows: int = 400) -> pd.DataFrame:
    """A jaw that lags behind what its motor says, as the columns of a recording."""
    t = np.arange(rows) / 100
    jaw = 0.5 + 0.3 * np.sin((2 + 0.1 * seed) * t) * np.sin(5 * t)
    effort = 0.02 * np.cos((3 + 0.2 * seed) * t)
    truth = 1.02 * jaw + 0.5 * effort + 0.01
    columns = {"t": t, "measured/jaw": jaw, "effort/jaw": effort, "truth/jaw": truth}
    return pd.DataFrame(columns)


def folder_of_a_day(folder: Path) -> Path:
    """Two recordings among what else lies in a laboratory's folder."""
    day = folder / "day"
    day.mkdir()
    for seed in range(2):
        write_parquet(
            Recording.from_columns(motion(seed), "davinci_grasper"), day / f"run{seed}.parquet"
        )
    (day / "README.md").write_text("What was done that day, in words.\n")
    (day / "robot.log").write_text("12:00:01 homed\n12:00:05 moved\n")
    (day / "empty.csv").write_text("")
    (day / "picture.png").write_bytes(b"\x89PNG\0\0\0\0")
    pd.DataFrame({"t": [0, 1], "jaw": [0.1, 0.2]}).to_csv(day / "trajectory.csv", index=False)
    (day / "more").mkdir()
    return day


@pytest.mark.parametrize("pattern", ["", "/*"])
def test_strangers_in_a_folder_are_left_out_with_a_word(
    call: Call, tmp_path: Path, pattern: str
) -> None:
    day = folder_of_a_day(tmp_path)
    result = call("calibrate", f"{day}{pattern}", "-e", "linear", "-o", tmp_path / "m.st")
    assert result.code == 0, result.err
    assert len(read_calibration(tmp_path / "m.st").origin.sessions) == 2
    for stranger in ("README.md", "robot.log", "empty.csv", "picture.png", "trajectory.csv"):
        assert f"{stranger}: left out" in result.err


def test_a_damaged_recording_in_a_folder_is_not_passed_over(call: Call, tmp_path: Path) -> None:
    day = folder_of_a_day(tmp_path)
    whole = (day / "run0.parquet").read_bytes()
    (day / "run0.parquet").write_bytes(whole[:-200])
    result = call("calibrate", day, "-e", "linear", "-o", tmp_path / "m.st")
    assert result.code == 2
    assert "run0.parquet: is not a whole Parquet file" in result.err


def test_a_folder_of_strangers_is_refused(call: Call, tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("words\n")
    result = call("calibrate", tmp_path, "-o", tmp_path / "m.st")
    assert result.code == 2
    assert result.err.strip().endswith(f"{tmp_path}: none of 1 files there is a recording")


def test_strangers_among_mapped_files_lack_the_columns(call: Call, tmp_path: Path) -> None:
    for seed in range(2):
        table = motion(seed).set_axis(["time", "q", "tau", "encoder"], axis=1)
        table.to_csv(tmp_path / f"{seed}.csv", index=False)
    (tmp_path / "notes.csv").write_text("what,when\nhomed,12:00\n")
    (tmp_path / "map.toml").write_text(
        'robot = "davinci_grasper"\n[columns]\nt = "time"\n"measured/jaw" = "q"\n'
        '"effort/jaw" = "tau"\n"truth/jaw" = "encoder"\n'
    )
    model, mapping = tmp_path / "m.st", tmp_path / "map.toml"
    result = call(
        "calibrate", tmp_path / "*.csv", "--columns", mapping, "-e", "linear", "-o", model
    )
    assert result.code == 0, result.err
    assert "notes.csv: left out: column 'time' is not there" in result.err


def test_what_files_do_not_say_is_stated(call: Call, tmp_path: Path) -> None:
    motion(rows=800).drop(columns="t").to_csv(tmp_path / "run.csv", index=False)
    result = call(
        "calibrate", tmp_path / "run.csv", "-e", "linear", "-o", tmp_path / "m.st", "--json",
        "--robot", "davinci_grasper", "--metadata", "rate_hz=100", "--metadata", "homing_id=noon",
        "--metadata", "load_grams=250", "--metadata", "session=A",
    )  # fmt: skip
    assert result.code == 0, result.err
    metadata = json.loads(result.out)["metadata"]
    (session,) = metadata["sessions"]
    assert metadata["homing_ids"] == ["noon"]
    assert session["session"] == "A"
    assert metadata["duration"] == pytest.approx(7.99)


def test_a_clock_that_restarts_makes_sessions(call: Call, tmp_path: Path) -> None:
    pd.concat([motion(0), motion(1)]).to_csv(tmp_path / "run.csv", index=False)
    result = call(
        "calibrate", tmp_path / "run.csv", "-e", "linear", "-o", tmp_path / "m.st",
        "--robot", "davinci_grasper", "--metadata", "session=A",
    )  # fmt: skip
    assert result.code == 0, result.err
    assert "run.csv: its clock restarts: read as 2 recordings" in result.err
    sessions = read_calibration(tmp_path / "m.st").origin.sessions
    assert [session.session for session in sessions] == ["A#1", "A#2"]


def test_constant_features_are_left_out_with_a_word(call: Call, tmp_path: Path) -> None:
    motion().assign(**{"effort/jaw": 0.1}).to_csv(tmp_path / "run.csv", index=False)
    arguments = ["-e", "linear", "--robot", "davinci_grasper", "-o", tmp_path / "m.st"]
    result = call("calibrate", tmp_path / "run.csv", *arguments)
    assert result.code == 0, result.err
    assert "left out: effort/jaw never change in the training rows" in result.err


def test_a_model_says_which_robot_a_file_is_of(call: Call, tmp_path: Path) -> None:
    motion(0).to_csv(tmp_path / "a.csv", index=False)
    motion(1).to_csv(tmp_path / "b.csv", index=False)
    model = tmp_path / "m.st"
    arguments = ["-e", "linear", "--robot", "davinci_grasper", "-o", model]
    assert call("calibrate", tmp_path / "a.csv", *arguments).code == 0
    assert call("evaluate", model, tmp_path / "b.csv").code in {0, 1}
    assert call("check", model, tmp_path / "b.csv").code == 0


def test_a_robots_file_is_joined_with_that_of_its_sensors(call: Call, tmp_path: Path) -> None:
    table = motion(3, rows=4000)
    table.drop(columns="truth/jaw").to_csv(tmp_path / "robot.csv", index=False)
    encoder = pd.DataFrame(
        {"stamp": 1e3 * (table["t"] - 7.25), "deg": np.degrees(table["truth/jaw"])}
    )
    encoder[::2].to_csv(tmp_path / "encoder.csv", index=False)
    (tmp_path / "map.toml").write_text(
        '[columns]\nt = { column = "stamp", unit = "ms" }\n'
        '"truth/jaw" = { column = "deg", unit = "deg" }\n'
    )
    arguments = [
        tmp_path / "robot.csv", "--truth", tmp_path / "encoder.csv", "--robot", "davinci_grasper",
        "--truth-columns", tmp_path / "map.toml", "-o", tmp_path / "run.parquet",
    ]  # fmt: skip
    result = call("extract", *arguments, "--json")
    assert result.code == 0, result.err
    found = json.loads(result.out)
    assert found["offset"]["seconds"] == pytest.approx(7.25, abs=0.01)
    assert found["offset"]["sd"] < 0.02
    joined = read_recording(tmp_path / "run.parquet")
    assert np.abs(joined.column("truth/jaw") - table["truth/jaw"]).max() < 0.01
    stated = call("extract", *arguments, "--force", "--offset-s", "7.25")
    assert "7.25 s behind (as stated)" in " ".join(stated.out.split())
    assert call("extract", *arguments, "--force", "--offset-s", "7", "--near-s", "7").code == 2
    assert call("extract", *arguments).code == 2


def test_a_map_is_written_to_start_from(call: Call, tmp_path: Path) -> None:
    table = motion().set_axis(["stamp", "jaw_pos", "jaw_torque", "jaw_encoder"], axis=1)
    table.to_csv(tmp_path / "run.csv", index=False)
    arguments = ["columns", tmp_path / "run.csv", "--robot", "davinci_grasper"]
    printed = call(*arguments)
    assert printed.code == 0
    mapping = tmp_path / "map.toml"
    assert call(*arguments, "-o", mapping).code == 0
    assert mapping.read_text() == printed.out
    assert call(*arguments, "-o", mapping).code == 2
    shown = call("show", tmp_path / "run.csv", "--columns", mapping, "--json")
    columns = [c["column"] for c in json.loads(shown.out)["shown"][0]["columns"]]
    assert columns == ["measured/jaw", "effort/jaw", "truth/jaw"]
