"""Tests of truejoint.motion.files."""

import json
import os
import shutil
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from truejoint.errors import TrajectoryError
from truejoint.motion import (
    Trajectory,
    files,
    random_motion,
    read_trajectory,
    write_trajectory,
    zigzag,
)
from truejoint.robots import get_robot

ROBOT = get_robot("raven2", "left")

names = st.from_regex(r"[A-Za-z_][A-Za-z0-9_]{0,8}", fullmatch=True).filter(lambda n: n != "t")
plain = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=5,
)


@st.composite
def trajectories(draw):
    joints = tuple(draw(st.lists(names, min_size=1, max_size=5, unique=True)))
    rows = draw(st.integers(2, 8))
    value = st.floats(allow_nan=False, allow_infinity=False)
    row = st.lists(value, min_size=len(joints), max_size=len(joints))
    positions = np.array(draw(st.lists(row, min_size=rows, max_size=rows)))
    times = None
    if draw(st.booleans()):
        stamps = st.floats(-1e9, 1e9)
        times = np.sort(draw(st.lists(stamps, min_size=rows, max_size=rows, unique=True)))
    units = tuple(draw(st.sampled_from(("rad", "m"))) for _ in joints)
    meta = draw(st.dictionaries(st.text(), plain, max_size=3))
    return Trajectory(joints, units, positions, times, draw(st.text(max_size=20)), meta)


@given(trajectories())
def test_round_trip_is_bit_for_bit(tmp_path_factory, trajectory):
    path = tmp_path_factory.mktemp("csv") / "t.csv"
    write_trajectory(trajectory, path)
    again = read_trajectory(path)
    for key in ("joints", "units", "name", "meta"):
        assert getattr(again, key) == getattr(trajectory, key)
    assert np.array_equal(again.positions, trajectory.positions)
    assert (again.times is None) == (trajectory.times is None)
    if trajectory.times is not None:
        assert np.array_equal(again.times, trajectory.times)


def test_header_can_be_read_by_a_person(tmp_path):
    path = tmp_path / "random.csv"
    write_trajectory(random_motion(ROBOT, 2.0, seed=4), path)
    first, second, third = path.read_text().splitlines()[:3]
    provenance = json.loads(first.removeprefix("# truejoint trajectory "))
    assert provenance["units"] == {"shoulder": "rad", "elbow": "rad", "insertion": "m"}
    assert provenance["meta"]["seed"] == 4
    assert second == "t,shoulder,elbow,insertion"
    assert third.startswith("0.0,0.69")


def test_nothing_is_overwritten_unasked(tmp_path):
    path = tmp_path / "t.csv"
    write_trajectory(zigzag(ROBOT, "J1"), path)
    with pytest.raises(TrajectoryError, match=r"t\.csv: exists"):
        write_trajectory(zigzag(ROBOT, "J2"), path)
    write_trajectory(zigzag(ROBOT, "J2"), path, overwrite=True)
    assert read_trajectory(path).name == "zigzag J2 1/4"


@pytest.mark.parametrize(
    ("value", "said"), [(object(), "cannot be written as JSON"), ("y" * 70000, "below 64 kB")]
)
def test_an_origin_that_no_file_can_hold_is_refused(tmp_path, value, said):
    path = Trajectory(("a",), ("rad",), np.zeros((2, 1)), meta={"x": value})
    with pytest.raises(TrajectoryError, match=said):
        write_trajectory(path, tmp_path / "t.csv")
    assert list(tmp_path.iterdir()) == []


def test_the_laboratorys_bare_columns_are_read(tmp_path):
    path = tmp_path / "zigzag_traj_dir_yz_0.25.csv"
    original = zigzag(ROBOT, "J2-J3", 1 / 4)
    np.savetxt(path, original.positions, delimiter=",")  # %.18e, as numpy writes by default
    loaded = read_trajectory(path)
    assert loaded.name == "zigzag_traj_dir_yz_0.25"
    assert (loaded.joints, loaded.units) == (original.joints, original.units)
    assert np.array_equal(loaded.positions, original.positions)


GOOD = '# truejoint trajectory {"format": 2, "name": "x", "units": {"a": "rad"}, "meta": {}}\n'


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("", "starts with ''"),
        ("x,y,z\n1,2,3\n", "starts with 'x,y,z'"),
        ("1,2\n3,4\n", "starts with '1,2'; want .* without a header"),
        *((f"1,2,3\n{row}\n", "a row is not 3 numbers") for row in ("4,5", "4,5,6,7", "4,x,6")),
        ("1,2,3\n", "at least 2 rows"),
        ("0.1,nan,0.3\n0.1,0.2,0.3\n", "elbow is nan in row 0"),
        ("# truejoint trajectory {\n", "first line is damaged"),
        (f'# truejoint trajectory {{"format": {"9" * 5000}}}\n', "first line is damaged"),
        ("# truejoint trajectory []\n", r"first line is \[\]; want a table"),
        ("# truejoint trajectory {}\n", "first line: 'format' is missing"),
        *((GOOD.replace(": 2", f": {n}"), f"format is {n}; want a whole number") for n in (1, 3)),
        (GOOD.replace('"x"', '"x", "sha256": "0"') + "a\n1.0\n", "does not match its hash"),
        (GOOD.replace("rad", "deg") + "a\n1\n2\n", "a unit, 'rad' or 'm'"),
        (GOOD + "b\n1\n2\n", "do not match the joints"),
        (GOOD, "do not match the joints"),
        (GOOD + "a\n", "has no rows"),
        (GOOD + "t,a\n0,1\n0,2\n", "times must increase"),
        (GOOD + "a\n1\n2,3\n", "a row is not 1 numbers"),
        (GOOD + "a\n1,2\n3,4\n", "rows have 2 numbers, want 1"),
    ],
)
def test_damaged_files_are_refused_in_one_line(tmp_path, text, match):
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with pytest.raises(TrajectoryError, match=match) as refusal:
        read_trajectory(path)
    assert "bad.csv" in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_what_is_no_text_file_is_refused(tmp_path, monkeypatch):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(TrajectoryError, match="is not a file, but"):  # and not waited for
        read_trajectory(tmp_path / "pipe")
    with pytest.raises(TrajectoryError, match=r"none\.csv: cannot be read: No such file"):
        read_trajectory(tmp_path / "none.csv")
    (tmp_path / "b.csv").write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(TrajectoryError, match="is not text"):
        read_trajectory(tmp_path / "b.csv")
    write_trajectory(zigzag(ROBOT), tmp_path / "z.csv")
    packed = shutil.copy(tmp_path / "z.csv", tmp_path / "z.gz")
    with pytest.raises(TrajectoryError, match="a row is not 3 numbers"):
        read_trajectory(packed)
    monkeypatch.setattr(files, "_MAX_BYTES", 100)
    with pytest.raises(TrajectoryError, match="more than a trajectory may have"):
        read_trajectory(tmp_path / "z.csv")


def test_a_changed_bit_changes_no_value(tmp_path):
    path = tmp_path / "t.csv"
    rows = np.array([[0.5, -0.0], [1e-300, 2.0], [0.1, 3.0]])
    before = Trajectory(("a", "b"), ("rad", "m"), rows, None, "x", {2: 1, 10: 1})
    write_trajectory(before, path)
    whole = path.read_bytes()
    for place in range(len(whole)):
        for bit in (0, 3, 6) if place % 4 == 0 else (place % 8,):
            data = bytearray(whole)
            data[place] ^= 1 << bit
            path.write_bytes(data)
            with suppress(TrajectoryError):
                after = read_trajectory(path)
                assert np.array_equal(after.positions, rows)
                assert (after.units, after.name) == (before.units, before.name)


def test_one_without_a_hash_is_read_and_says_so(tmp_path):
    path = tmp_path / "t.csv"
    path.write_text(GOOD + "a\n1.0\n2.0\n")
    assert "without a content hash" in read_trajectory(path).meta["notes"]
    path.write_text(GOOD.replace('"meta": {}', '"meta": {"notes": "by hand"}') + "a\n1.0\n2.0\n")
    assert read_trajectory(path).meta["notes"].startswith("by hand; was written without a content")
