"""What a tracker saw of the tool at rest: read, turned into the base, refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.tip.test_touch_calibration import session, without_truth
from tests.tip.touched_arm import ROBOT, ROTATION

from truejoint.errors import CalibrationError
from truejoint.tip import Registration, Shots, calibrate_by_points, calibrate_by_touch, read_shots
from truejoint.tip.rests import RestPoints

BASE = np.eye(4)  # of the robot, in the tracker
BASE[:3, :3] = Rotation.from_rotvec([0.4, 1.0, -0.3]).as_matrix()
BASE[:3, 3] = [0.2, -0.1, 1.5]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "want t,x_mm,y_mm,z_mm"),
        ("t,x,y,z\n1,2,3,4\n", "want t,x_mm,y_mm,z_mm"),
        ("t,x_mm,y_mm,z_mm\n", "no shots; write a line for each"),
        ("t,x_mm,y_mm,z_mm\n1,2,3\n", "line 2"),
        ("t,x_mm,y_mm,z_mm\n1,2,far,4\n", "line 2"),
        ("t,x_mm,y_mm,z_mm\n1,2,nan,4\n", "three numbers for each time"),
        ("t,x_mm,y_mm,z_mm\n2,2,3,4\n1,2,3,4\n", "must go up"),
    ],
)
def test_a_file_that_is_not_of_shots_is_refused(tmp_path, text, said):
    path = tmp_path / "shots.csv"
    path.write_text(text)
    with pytest.raises(CalibrationError, match=said):
        read_shots(path)


def test_shots_come_back_in_metres(tmp_path):
    path = tmp_path / "shots.csv"
    path.write_text("x_mm,t,note,y_mm,z_mm\n100,1.5,good,-20,1500.25\n\n0,2.5,,1,2\n")
    shots = read_shots(path)
    assert shots.t == (1.5, 2.5)
    assert shots.point == pytest.approx(np.array([[0.1, -0.02, 1.50025], [0.0, 0.001, 0.002]]))
    assert shots.rests.dimple == ("1", "2")


def test_points_of_a_tracker_that_is_registered_are_in_the_base():
    inside = np.random.default_rng(0).normal(size=(5, 3))
    seen = Shots((1.0, 2.0, 3.0, 4.0, 5.0), inside @ BASE[:3, :3].T + BASE[:3, 3])
    known = Registration(base=BASE, base_sd=np.full(6, 0.1))
    found = RestPoints.of_shots(seen, known, ROBOT, 1e-4)
    assert found.point == pytest.approx(inside)
    assert found.pose == pytest.approx(np.diag(np.full(6, 100.0)))
    assert not found.marker_sd.any()
    assert RestPoints.of_shots(seen, Registration(), ROBOT, 1e-4).pose is None
    carried = RestPoints.of_shots(seen, Registration(link="roll"), ROBOT, 1e-4)
    assert (carried.marker_sd > 0.0).all()
    with pytest.raises(CalibrationError, match="5 different shots; to calibrate it takes 12"):
        calibrate_by_points(session()[0], seen)
    with pytest.raises(CalibrationError, match="leave them out with single shots"):
        RestPoints.of_shots(seen, Registration(stops={"elbow": (0.0, 0.0, 1e-3)}), ROBOT, 1e-4)


def test_shots_calibrate_as_touches_do_and_a_known_base_shows_the_shoulder():
    recording, touches, block, translation = session()
    recording = without_truth(recording)
    points = block.at(touches.dimple)
    blind, _ = calibrate_by_points(recording, Shots(touches.t, points), shot_sd=2e-4)
    measured = replace(block, measured=block.calliper)
    touched, _ = calibrate_by_touch(recording, touches, measured)
    assert blind.correct(recording) == pytest.approx(touched.correct(recording), abs=2e-5)
    base = points @ ROTATION.T + translation
    seen = Shots(touches.t, base @ BASE[:3, :3].T + BASE[:3, 3])
    known = Registration(base=BASE, base_sd=np.array([1e-3] * 3 + [1e-4] * 3))
    model, report = calibrate_by_points(recording, seen, known)
    assert report.zero_sd[0] < 3e-3
    assert not any("shoulder: not seen" in text for text in report.not_seen)
    assert model.metadata["touch"]["frame"] == "tracker"
    there = np.array(model.metadata["touch"]["rotation"])
    assert there == pytest.approx(BASE[:3, :3].T, abs=5e-3)
    error = session()[0].columns("truth", model.joints) - model.correct(recording)
    assert (np.abs(error.mean(axis=0)) < 4.0 * report.zero_sd).all()
    assert "30 shots; tip within" in str(model)
