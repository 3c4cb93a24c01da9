"""A map that is written for a file is one that reads it."""

import re
import tomllib

import numpy as np
import scipy.io
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.recordings.refusals import refused

from truejoint.recordings import read_column_map, read_recording, sketch_column_map

fields = st.text(
    st.characters(codec="utf-8", exclude_characters=',;\t\r\n "#\v\f\x1c\x1d\x1e\x85\u2028\u2029'),
    min_size=1,
    max_size=12,
)


@settings(max_examples=30)
@given(names=st.lists(fields, min_size=2, max_size=8), robot=st.sampled_from(["", "raven2"]))
def test_any_header_gives_a_map_that_is_understood(tmp_path, names, robot):
    path = tmp_path / "run.csv"
    head = ",".join(names)
    path.write_text(f"{head}\n{','.join('1' for _ in names)}\n", encoding="utf-8")
    if "\0" in head:
        return
    text = sketch_column_map(path, robot)
    mapping = read_column_map(tomllib.loads(text))
    assert mapping.robot == robot
    taken = [mapped.column for mapped in mapping.columns.values()]
    assert len(set(taken)) == len(taken)
    # What is not guessed stands there as a comment that becomes an entry by taking the # away.
    spare = [line[2:] for line in text.splitlines() if re.match('# "[^"]*<', line)]
    for k, line in enumerate(spare):
        entry = tomllib.loads(re.sub('^"[^"]*"', f'"effort/x{k}"', line))
        taken.append(entry[f"effort/x{k}"]["column"])
    assert len(taken) == len(names)


def test_what_the_names_say_is_guessed(tmp_path):
    path = tmp_path / "run.csv"
    names = (
        "Time [ms],q_shoulder_deg,jpos_elbow,insertion (mm),tau_0,tau_1,ext_1_deg,mvel2,desired_3"
    )
    path.write_text(f"# note\n{names},note,note\n" + ",".join("1" * 11) + "\n")
    text = sketch_column_map(path, "raven2")
    mapping = read_column_map(tomllib.loads(text))
    found = {name: (c.column, c.unit) for name, c in mapping.columns.items()}
    assert found == {
        "t": ("Time [ms]", "ms"),
        "measured/shoulder": ("q_shoulder_deg", "deg"),
        "measured/elbow": ("jpos_elbow", ""),
        "measured/insertion": ("insertion (mm)", "mm"),
        "effort/shoulder": ("tau_0", ""),
        "effort/elbow": ("tau_1", ""),
        "truth/elbow": ("ext_1_deg", "deg"),
        "motor_velocity/insertion": ("mvel2", ""),
        "setpoint/roll": ("desired_3", ""),
    }
    assert text.count("column = 9") == text.count("column = 10") == 1


def test_a_name_that_says_half_leaves_the_other_half_open(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("t,yaw_cmd,ins_pos,tool_roll,cam_x,cam_pitch,pos\n" + ",".join("1" * 7) + "\n")
    text = sketch_column_map(path, "dvrk_psm")
    found = {key: c.column for key, c in read_column_map(tomllib.loads(text)).columns.items()}
    assert found == {
        "t": "t",
        "setpoint/outer_yaw": "yaw_cmd",
        "measured/outer_insertion": "ins_pos",
        "truth/outer_pitch": "cam_pitch",
    }
    for half in ("<quantity>/outer_roll", "truth/<joint>", "measured/<joint>"):
        assert f'# "{half}" = ' in text


def test_the_map_reads_the_file(tmp_path):
    content = {"time": np.arange(5.0), "q": np.arange(10.0).reshape(2, 5), "tau": np.ones((2, 5))}
    scipy.io.savemat(tmp_path / "run.mat", content)
    np.savetxt(tmp_path / "bare.txt", np.ones((3, 4)))
    (tmp_path / "map.toml").write_text(sketch_column_map(tmp_path / "run.mat", "bros"))
    recording = read_recording(tmp_path / "run.mat", column_map=tmp_path / "map.toml")
    np.testing.assert_array_equal(
        recording.columns("measured", ("joint1", "joint2")).T, content["q"]
    )
    assert recording.joints_of("effort") == ("joint1", "joint2")
    bare = sketch_column_map(tmp_path / "bare.txt")
    assert [f"column = {k} " in bare for k in range(5)] == [True] * 4 + [False]
    assert "# robot =" in bare
    assert "# rate_hz =" in bare


def test_what_needs_no_map_is_refused(tmp_path):
    (tmp_path / "a.parquet").write_bytes(b"PAR1....")
    refused("needs no column map", sketch_column_map, tmp_path / "a.parquet")
    refused("there is no such file", sketch_column_map, tmp_path / "b.csv")
