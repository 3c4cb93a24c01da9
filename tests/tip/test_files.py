"""Plate and pose files: they come back as they were, and what cannot be is refused."""

import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from truejoint.errors import CalibrationError
from truejoint.tip import (
    Block,
    BlockPose,
    Touches,
    read_block,
    read_pose,
    read_shots,
    read_touches,
    write_pose,
)
from truejoint.tip.block import block_text

POINTS = {"1": np.array([0.0, 0.01, 0.02]), "12": np.array([0.04, -0.03, 0.0])}
BLOCK = Block("stairs", "raven2", POINTS, 0.08, 0.0803)


def pose() -> BlockPose:
    root = np.random.default_rng(0).normal(size=(6, 6))
    return BlockPose(
        BLOCK, "raven2", "left", Rotation.from_rotvec([1.0, 2.0, -0.5]).as_matrix(),
        np.array([0.1, -0.2, 0.3]), root @ root.T, 1.002, 3e-4,
        np.array([1e-3, 2e-3, 1e-4]), "2026-11-22T10:00:00", "h 1", "abc",
    )  # fmt: skip


def test_a_plate_comes_back_from_its_file(tmp_path):
    for block in (BLOCK, Block("unmeasured", "raven2", POINTS, 0.08)):
        path = tmp_path / f"{block.name}.toml"
        path.write_text(block_text(block))
        again = read_block(path)
        assert (again.name, again.robot) == (block.name, block.robot)
        assert again.calliper == pytest.approx(0.08)
        assert again.measured == pytest.approx(block.measured, nan_ok=True)
        assert list(again.points) == ["1", "12"]
        for number, point in POINTS.items():
            assert again.points[number] == pytest.approx(point, abs=1e-9)


def test_a_pose_comes_back_bit_for_bit(tmp_path):
    path = tmp_path / "pose.toml"
    write_pose(pose(), path)
    again = read_pose(path)
    for name in ("rotation", "translation", "covariance", "joint_sd"):
        assert np.array_equal(getattr(again, name), getattr(pose(), name))
    for name in ("robot", "arm", "scale", "scale_sd", "date", "homing_id", "model_sha256"):
        assert getattr(again, name) == getattr(pose(), name)
    assert again.title == "stairs in the base of raven2 left"
    with pytest.raises(CalibrationError, match="exists already"):
        write_pose(pose(), path)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("calliper_mm = 80.0", "calliper_mm = 0", "calliper length"),
        ("measured_mm = 80.3", "measured_mm = 70", "measure again"),
        ("[points_mm]", "[points]", "did you mean 'points_mm'"),
        ("[0.0, 10.0, 20.0]", "[0.0, 10.0]", "three numbers"),
        ("[0.0, 10.0, 20.0]", "[0.0, 10.0, 2e4]", "less than 10 m"),
    ],
)
def test_a_plate_file_that_is_none_is_refused(tmp_path, old, new, said):
    path = tmp_path / "plate.toml"
    path.write_text(block_text(BLOCK))
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(CalibrationError, match=said):
        read_block(path)


@pytest.mark.parametrize(
    ("key", "wrong", "said"),
    [
        ("rotation", [[-1.0] * 3] * 3, "rotation is not"),
        ("covariance", [[-1.0] * 6] * 6, "covariance is not"),
        ("scale", 0.0, r"scale is 0\.0; want a number above 0"),
    ],
)
def test_a_pose_that_was_edited_is_refused(tmp_path, key, wrong, said):
    path = tmp_path / "pose.toml"
    write_pose(pose(), path)
    text = re.sub(rf"(?m)^{key} = .*$", f"{key} = {wrong}", path.read_text())
    path.write_text(text)
    with pytest.raises(CalibrationError, match=said):
        read_pose(path)


@pytest.mark.parametrize(
    ("read", "text", "said"),
    [
        (read_touches, "time,number\n1,2\n", "want t,dimple"),
        (read_touches, "t,dimple\none,2\n", "line 2"),
        (read_touches, "t,dimple\n1.0\n", "line 2"),
        (read_touches, "t,dimple\nnan,3\n", "must go up"),
        (read_touches, "t,dimple\n" + 200_000 * "1", "is not a CSV file of touches"),
        (read_shots, "", "want t,x_mm,y_mm,z_mm"),
        (read_shots, "t,x,y,z\n1,2,3,4\n", "want t,x_mm,y_mm,z_mm"),
        (read_shots, "t,x_mm,y_mm,z_mm\n", "no dimples; write a line for each"),
        (read_shots, "t,x_mm,y_mm,z_mm\n1,2,3\n", "line 2"),
        (read_shots, "t,x_mm,y_mm,z_mm\n1,2,far,4\n", "line 2"),
        (read_shots, "t,x_mm,y_mm,z_mm\n1,2,nan,4\n", "three numbers of less than 10 m"),
        (read_shots, "t,x_mm,y_mm,z_mm\n2,2,3,4\n1,2,3,4\n", "must go up"),
    ],
)
def test_a_file_that_is_not_of_touches_or_shots_is_refused(tmp_path, read, text, said):
    path = tmp_path / "seen.csv"
    path.write_text(text)
    with pytest.raises(CalibrationError, match=said):
        read(path)


def test_touches_come_back_from_their_file(tmp_path):
    path = tmp_path / "touches.csv"
    path.write_text("t, dimple, side\n1.5, 7, +-+\n\n3.25, 12, ---\n")
    assert read_touches(path) == Touches((1.5, 3.25), ("7", "12"), str(path))


def test_shots_come_back_in_metres(tmp_path):
    path = tmp_path / "shots.csv"
    path.write_text("x_mm,t,note,y_mm,z_mm\n100,1.5,good,-20,1500.25\n\n0,2.5,,1,2\n")
    touches, block = read_shots(path)
    assert touches == Touches((1.5, 2.5), ("1", "2"), str(path))
    expected = np.array([[0.1, -0.02, 1.50025], [0.0, 0.001, 0.002]])
    assert block.at(touches.dimple) == pytest.approx(expected)
    assert (block.scale, block.scale_sd) == (1.0, pytest.approx(0.0, abs=1e-4))
