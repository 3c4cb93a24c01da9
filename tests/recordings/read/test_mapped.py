import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from tests.recordings.refusals import refused

from truejoint.recordings import (
    ColumnMap,
    Recording,
    read_column_map,
    read_recording,
    read_recordings,
)
from truejoint.robots import get_robot

numbers = st.floats(-1e12, 1e12)


def write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


@given(
    data=st.data(), rows=st.integers(2, 20), delimiter=st.sampled_from([",", ";", "\t", " ", ", "])
)
def test_a_header_in_our_names_comes_back_exactly(tmp_path, data, rows, delimiter):
    t = np.sort(data.draw(arrays(float, rows, elements=st.floats(0, 1e7), unique=True)))
    measured = data.draw(arrays(float, rows, elements=numbers))
    truth = data.draw(arrays(float, rows, elements=numbers | st.just(np.nan)))
    lines = [delimiter.join(["truth/joint1", "t", "measured/joint1"])]
    lines += [
        delimiter.join("nan" if np.isnan(v) else repr(float(v)) for v in row)
        for row in zip(truth, t, measured, strict=True)
    ]
    path = write(tmp_path / "a.csv", "# note\n" + "\n".join(lines) + "\n")
    recording = read_recording(path, robot="bros")
    assert np.array_equal(recording.t, t)
    assert np.array_equal(recording.column("measured/joint1"), measured)
    assert np.array_equal(recording.column("truth/joint1"), truth, equal_nan=True)
    missing = int(np.isnan(truth).sum())
    assert recording.provenance.dropped == ({"truth: value missing": missing} if missing else {})


MAP = """
robot = "raven2"
arm = "green"
[columns]
t = {column = "stamp", unit = "ms"}
"measured/elbow" = {column = 2, unit = "deg"}
"measured/insertion" = {column = "ins", unit = "mm"}
"motor/elbow" = {column = "counts", unit = "deg", scale = 0.36}
"effort/elbow" = {column = "tau", unit = "mNm"}
"vision/elbow" = "note"
"""
TABLE = "stamp,counts,q2,ins,tau,note\n1000,100,90,400,5,1\n1500,200,180,410,6,2\n"


def check_map(recording: Recording) -> None:
    assert (recording.robot.name, recording.robot.arm) == ("raven2", "right")
    assert recording.t.tolist() == [1.0, 1.5]
    assert recording.column("measured/elbow") == pytest.approx([np.pi / 2, np.pi])
    assert recording.column("measured/insertion") == pytest.approx([0.4, 0.41])
    assert recording.column("motor/elbow") == pytest.approx(np.deg2rad([36.0, 72.0]))
    assert recording.column("effort/elbow") == pytest.approx([5e-3, 6e-3])
    assert recording.units["vision/elbow"] == "1"


def test_a_column_map_as_mapping_and_as_file(tmp_path):
    path = write(tmp_path / "a.csv", TABLE)
    mapping, toml = tomllib.loads(MAP), write(tmp_path / "map.toml", MAP)
    check_map(read_recording(path, column_map=mapping))
    check_map(read_recording(path, "csv", column_map=toml))
    assert read_recording(path, arm="left", column_map=mapping).robot.arm == "left"
    bare = write(tmp_path / "a.txt", "0 1 2\n1 3 4\n")  # positions need no header
    columns = {"columns": {"t": 0, "measured/joint2": 2}}
    recording = read_recording(bare, robot="bros", column_map=columns)
    assert recording.column("measured/joint2").tolist() == [2.0, 4.0]
    refused("No such file", read_column_map, tmp_path / "none.toml")


def test_a_rig_without_a_robot_file_is_made_of_its_columns(tmp_path):
    """One odd column does not refuse the whole; what was assumed is said in one line."""
    path = tmp_path / "run1.csv"
    path.write_text("t,measured/bend,truth/bend,effort/bend,tip_x\n0,1,2,3,4\n1,2,3,4,5\n")
    recording = read_recording(path)
    assert recording.robot.joint_names == ("bend",)
    assert recording.provenance.notes == (
        "no robot named: made one of the columns, bend [rad], without limits; "
        "taken as effort/bend in Nm; left out: tip_x"
    )
    assert set(recording.units) == {"measured/bend", "truth/bend", "effort/bend"}
    (tmp_path / "my.toml").write_text(
        'name = "my"\n[[joints]]\nname = "bend"\nkind = "prismatic"\n'
    )
    for robot in (get_robot(tmp_path / "my.toml"), tmp_path / "my.toml"):
        stated = read_recording(path, robot=robot)
        assert stated.units["truth/bend"] == "m"
        assert stated.provenance.notes == "left out: tip_x"
    column_map = {"columns": {"t": 0, "measured/x": {"column": 1, "unit": "mm"}, "truth/x": 2}}
    assert read_recording(path, column_map=column_map).units["measured/x"] == "m"


BROS = {"robot": "bros"}


def by(columns: dict[str, Any]) -> dict[str, Any]:
    return {**BROS, "column_map": {"columns": columns}}


@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        ("t,effort/joint1\n0,1\n1,2\n", {}, "no 'measured/<joint>' column; name the columns"),
        ("t,measured/elbow\n0,1\n1,2\n", BROS, "has no joint 'elbow'; it has joint1"),
        ("t,angle\n0,1\n1,2\n", BROS, "'angle' is neither 't' nor"),
        ("t,truth/joint1\n0,1\n1,2\n", BROS, "no 'measured/<joint>' column"),
        ("t,measured/joint1\n0,1\n", BROS, "1 rows; a recording needs at least 2"),
        ("t,measured/joint1\n", BROS, "holds no rows"),
        ("t,measured/joint1\n0,1\n1,2\n0,3\n", BROS, "row 2 goes back or repeats"),
        (
            "t,measured/joint1\n" + "".join(f"{t},1\n" for t in (*range(20), 0, *range(20, 40))),
            BROS,
            "row 20 goes back",
        ),
        ("t,measured/joint1\n0,1\n1,high\n", BROS, "line 3, column 1 is 'high'"),
        ("t;measured/joint1\n0;0,5\n1;0,6\n", BROS, "'0,5', not a number: write it with a point"),
        ("t,measured/joint1\n17e17,1\n18e17,2\n", BROS, "beyond the year 5000; if that is in ms"),
        ("t,measured/joint1\n0,1\n1,nan\n", BROS, "lack a value, 'measured/joint1'"),
        ("measured/joint1\n0\n1\n", BROS, "no column 't' .* --metadata rate_hz=.*truejoint col"),
        ("t,measured/joint1\n0,1\n1,2\n", {**BROS, "rate": 9.0}, "has time stamps"),
        ("measured/joint1\n0\n1\n", {**BROS, "rate": np.nan}, "a rate of nan Hz"),
        ("measured/joint1\n0\n1\n", {**BROS, "rate": -1.0}, "a rate of -1.0 Hz"),
        ("t,measured/joint1\n0,1\n1,inf\n", BROS, "row 1 is inf"),
        ("t,t,measured/joint1\n0,0,1\n1,1,2\n", BROS, "column 't' is there twice"),
        (TABLE, by({"t": "stamp"}), "no 'measured/"),
        (TABLE, by({"t": "time", "measured/joint1": 1}), "'time' is not there.* header has"),
        (
            TABLE,
            by({"t": 0, "measured/joint1": 6}),
            "column 6 is not there, .* there are 6 columns",
        ),
        ("0,1\n1,2\n", by({"t": "a", "measured/joint1": 1}), "there is no header: correct"),
        (
            TABLE,
            by({"t": 0, "measured/joint1": {"column": 1, "unit": "mm"}}),
            "is in rad, which 'mm' cannot be",
        ),
    ],
)
def test_bad_input_is_one_line(tmp_path, text, options, message):
    path = write(tmp_path / "a.csv", text)
    text = refused(message, read_recording, path, "csv", **options)
    assert str(path) in text


ROWS = np.column_stack([np.arange(5) * 10.0, np.arange(5) ** 2, [1, 2, np.nan, 4, 5]])
COLUMNS: dict[str, Any] = {
    "t": {"column": 0, "unit": "ms"},
    "measured/joint1": {"column": 1, "unit": "deg"},
    "truth/joint1": 2,
}


def check_rows(recording: Recording) -> None:
    np.testing.assert_allclose(recording.t, ROWS[:, 0] / 1e3)
    np.testing.assert_allclose(recording.column("measured/joint1"), np.radians(ROWS[:, 1]))
    np.testing.assert_array_equal(recording.column("truth/joint1"), ROWS[:, 2])
    assert recording.provenance.dropped == {"truth: value missing": 1}
    assert recording.provenance.rates == {"state": 100.0}


def test_an_npy_file_is_read_by_position(tmp_path):
    np.save(tmp_path / "a.npy", ROWS)
    mapping = {"robot": "bros", "columns": COLUMNS}
    check_rows(read_recording(tmp_path / "a.npy", column_map=mapping))


@pytest.mark.parametrize("version", ["4", "5"])
def test_a_mat_file_is_read_by_name_and_without_stamps_at_a_rate(tmp_path, version):
    content: dict[str, Any] = {"stamp": ROWS[:, 0], "q": ROWS[:, 1:].T}
    if version == "5":
        content = {"rec": content}
    scipy.io.savemat(tmp_path / "a.mat", content, format=version)
    prefix = "rec." if version == "5" else ""
    columns: dict[str, Any] = {
        "t": {"column": f"{prefix}stamp", "unit": "ms"},
        "measured/joint1": {"column": f"{prefix}q[0]", "unit": "deg"},
        "truth/joint1": f"{prefix}q[1]",
    }
    check_rows(read_recording(tmp_path / "a.mat", column_map={"robot": "bros", "columns": columns}))
    del columns["t"]
    mapping = {"robot": "bros", "rate_hz": 100, "columns": columns}
    check_rows(read_recording(tmp_path / "a.mat", column_map=mapping))


def test_samples_lie_along_the_side_of_the_stamps(tmp_path):
    content = {"t": [0.0, 1.0, 2.0], "q": np.arange(15.0).reshape(5, 3)}
    scipy.io.savemat(tmp_path / "a.mat", content)
    columns = {"t": "t", "measured/joint1": "q[4]"}
    recording = read_recording(tmp_path / "a.mat", column_map={"robot": "bros", "columns": columns})
    assert recording.column("measured/joint1").tolist() == [12, 13, 14]


@pytest.mark.parametrize(
    ("column", "message"),
    [
        ("x", "no signal 'x'; the file has rec.q, rec.stamp, n"),
        ("rec", "no signal 'rec'"),
        ("n.q", "no signal 'n.q'"),
        ("rec.q", r"holds 2 signals, which 'rec.q' does not name; write rec.q\[0\] to rec.q\[1\]"),
        ("rec.q[2]", "holds 2 signals"),
        ("rec.q[-1]", "holds 2 signals"),
        ("n[0]", "holds 1 signals, which 'n.0.' does not name; write n$"),
        ("n", "'measured/joint1' has shape"),
    ],
)
def test_a_signal_that_is_not_there_is_one_line(tmp_path, column, message):
    content = {"rec": {"q": ROWS[:, 1:].T, "stamp": ROWS[:, 0]}, "n": np.arange(4.0)}
    scipy.io.savemat(tmp_path / "a.mat", content)
    columns = {"t": "rec.stamp", "measured/joint1": column}
    refused(
        message,
        read_recording,
        tmp_path / "a.mat",
        column_map={"robot": "bros", "columns": columns},
    )
    refused("give a column map", read_recording, tmp_path / "a.mat", "arrays", robot="bros")


def test_a_rate_in_place_of_stamps_may_come_from_the_caller(tmp_path):
    path = write(tmp_path / "a.csv", "measured/joint1,truth/joint1\n1,2\n3,4\n")
    assert read_recording(path, robot="bros", rate=4.0).t.tolist() == [0.0, 0.25]
    np.save(tmp_path / "a.npy", ROWS)
    mapping = {"robot": "bros", "columns": {"measured/joint1": 1}}
    assert read_recording(tmp_path / "a.npy", column_map=mapping, rate=2.0).duration == 2.0


@settings(max_examples=30)
@given(
    rows=st.lists(st.lists(st.floats(-9, 9) | st.just(np.nan), min_size=2, max_size=2), min_size=9),
    lost=st.sets(st.integers(0, 8), max_size=3),
)
def test_rows_that_lack_a_value_are_left_out_and_counted(tmp_path, rows, lost):
    table = np.array([[k, *row] for k, row in enumerate(rows)])
    table[:, 1] = np.nan_to_num(table[:, 1])
    table[list(lost), 1] = np.nan
    path = tmp_path / "a.csv"
    names = "t,measured/joint1,truth/joint1"
    np.savetxt(path, table, delimiter=",", header=names, comments="", fmt="%.17g")
    recording = read_recording(path, robot="bros")
    kept = table[np.isfinite(table[:, 1])]
    np.testing.assert_array_equal(recording.table.to_numpy(), kept)
    assert recording.provenance.dropped.get("value missing", 0) == len(lost)


@settings(max_examples=30)
@given(
    lengths=st.lists(st.integers(10, 30), min_size=1, max_size=4),
    first=st.sampled_from([0.0, 3.5, 1.7e9]),
)
def test_each_restart_of_the_clock_begins_a_session(tmp_path, lengths, first):
    t = np.concatenate([first + 0.25 * np.arange(length) for length in lengths])
    path = tmp_path / "day.csv"
    names = "t,measured/joint1"
    table = np.column_stack([t, np.arange(t.size)])
    table = np.vstack([[first, -1.0], table])  # of one stamp the last row is kept
    np.savetxt(path, table, delimiter=",", header=names, comments="", fmt="%.17g")
    found = read_recordings(path, robot="bros", homing_id="h", session="morning")
    assert [len(recording) for recording in found] == lengths
    measured = np.concatenate([recording.column("measured/joint1") for recording in found])
    np.testing.assert_array_equal(measured, np.arange(t.size))
    several = len(lengths) > 1
    names = [f"morning#{k}" if several else "morning" for k in range(1, len(lengths) + 1)]
    assert [recording.provenance.session for recording in found] == names
    assert {recording.provenance.homing_id for recording in found} == {"h"}
    dropped = [recording.provenance.dropped for recording in found]
    assert dropped == [{"repeated time stamp": 1}, *[{}] * (len(lengths) - 1)]
    start = first if first > 1e9 else np.nan
    np.testing.assert_array_equal([recording.provenance.start for recording in found], start)
    if several:
        refused(f"holds {len(lengths)} recordings", read_recording, path, robot="bros")


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({}, "column map: 'columns' is missing"),
        ({"rate_hz": 5, "columns": {"t": 0}}, "gives 't' and rate_hz"),
        ({"rate_hz": -1, "columns": {"measured/joint1": 1}}, "rate_hz is -1"),
        ({"columns": {"t": 0}, "colour": "red"}, "no key called 'colour'"),
        ({"columns": {"t": 0}, "delimiter": "ab"}, "delimiter is 'ab'"),
        ({"columns": {"t": 0}, "comment": "//"}, "comment is '//'"),
        ({"columns": {"t": 0}, "robot": 3}, "robot is 3"),
        ({"columns": {"t": True}}, "t.column is True; want a whole number from 0"),
        ({"columns": {"t": {"unit": "s"}}}, "'column' is missing"),
        ({"columns": {"t": {"column": 1.5}}}, "column is 1.5"),
        ({"columns": {"t": -1}}, "is -1; want a whole number from 0"),
        ({"columns": {"t": {"column": 0, "unit": "furlong"}}}, "unit is 'furlong'; want , s, ms"),
        ({"columns": {"t": {"column": 0, "scale": 0}}}, "want a number other than 0"),
        ({"columns": {"t": {"column": 0, "scale": float("nan")}}}, "scale is nan; want a number"),
        ({"columns": {"t": {"column": 0, "scale": "2"}}}, "scale is '2'"),
        ({"columns": {"t": {"column": 0, "gain": 2}}}, "no key called 'gain'"),
    ],
)
def test_a_map_that_breaks_a_rule_is_refused(values, message):
    refused(message, read_column_map, values)


def test_a_map_that_is_one_passes():
    mapping = read_column_map({"columns": {"t": 0}})
    assert isinstance(mapping, ColumnMap)
    assert read_column_map(mapping) is mapping


@pytest.mark.parametrize("text", ["columns = ", "[columns]\nt = 0\n[columns]\n", "\x00"])
def test_a_file_that_is_no_toml_is_refused(tmp_path, text):
    path = tmp_path / "map.toml"
    path.write_text(text)
    refused(r"map.toml: is not TOML", read_column_map, path)
