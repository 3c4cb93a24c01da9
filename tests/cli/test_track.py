"""`truejoint track`, as a person calls it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from tests.cli.conftest import Call
from tests.recordings.marker_bag import write_marker_bag
from tests.simulated_tracker import SimulatedTracker

from truejoint import get_robot, read_recording
from truejoint.recordings import write_bag

REGISTRATION = """
[base]
position_mm = [0, 0, 0]
quaternion = [0, 0, 0, 1]
sd_mm = 0.1
sd_deg = 0.02
[marker]
link = "roll"
position_mm = [0, 0, 0]
sd_mm = 0.1
"""


def test_points_become_truth(call: Call, session: Path, tmp_path: Path):
    before = read_recording(session / "random.parquet")
    robot = get_robot("raven2", "left")
    rows = np.isfinite(before.columns("truth", robot.positioning)).all(axis=1)
    joint = before.columns("measured", robot.joint_names)[rows]
    joint[:, :3] = before.columns("truth", robot.positioning)[rows]
    tracker = SimulatedTracker(1e-4, delay=0.0)
    carrier = robot.kinematics.up_to(3)
    t, position, _ = tracker.see(carrier, before.t[rows], joint, np.eye(4), np.eye(4))
    points, output = tmp_path / "points.csv", tmp_path / "tracked.parquet"
    columns = dict(zip("xyz", 1e3 * position.T, strict=True))
    pd.DataFrame({"t": t + before.provenance.start, **columns}).to_csv(points, index=False)
    bare = before.table[["t", *(f"measured/{n}" for n in robot.joint_names)]]
    bare.assign(t=bare["t"] + before.provenance.start).to_csv(tmp_path / "robot.csv", index=False)
    known = tmp_path / "tracker.toml"
    known.write_text(REGISTRATION)
    words = ["extract", tmp_path / "robot.csv", "--tracker", points, "--robot", "raven2:left"]
    words += ["--unit", "mm", "-o", output, "--offset-s", "0"]
    told = call(*words)
    assert told.code == 2
    assert "the motion does not tell the zero of shoulder" in told.err
    told = call(*words, "--registration", known)
    assert told.code == 0, told.err
    assert "truth ±" in told.out
    tracked = read_recording(output)
    assert "truth of a tracker, points.csv" in tracked.provenance.notes
    told = call(*words, "--registration", known, "--force", "--json")
    assert told.code == 0, told.err
    assert json.loads(told.out)["tracker"]["joints"] == list(robot.positioning)
    assert call(*words, "--registration", known).code == 2
    told = call(*words, "--near-s", "1")
    assert "give one of the two" in told.err


def test_the_tracker_of_a_bag_is_its_truth(call: Call, session: Path, tmp_path: Path):
    robot = get_robot("raven2", "left")
    whole = read_recording(session / "random.parquet").with_truth(robot.positioning)
    joint = whole.columns("measured", robot.joint_names)
    joint[:, :3] = whole.columns("truth", robot.positioning)
    tracker = SimulatedTracker(1e-4, rate=10.0, delay=0.02)
    carrier = robot.kinematics.up_to(3)
    t, points, _ = tracker.see(carrier, whole.t, joint, np.eye(4), np.eye(4))
    # For five seconds it sees another marker of the tool, 2 cm further up.
    aside = np.eye(4)
    aside[2, 3] = -0.02
    swapped = (t > 20.0) & (t < 25.0)
    points[swapped] = tracker.see(carrier, whole.t, joint, np.eye(4), aside)[1][swapped]
    start = 1.7e9
    about = replace(whole.provenance, start=start)
    write_bag(replace(whole, provenance=about), tmp_path / "arm.bag", profile="raven2_mended")
    turns = np.tile([0.0, 0.0, 0.0, 1.0], (len(t), 1))
    kinds = {"/marker": "PointStamped"}
    write_marker_bag(tmp_path / "tracker.bag", start + t, points, turns, kinds)
    known, output = tmp_path / "tracker.toml", tmp_path / "tracked.parquet"
    known.write_text(REGISTRATION)
    words = ("extract", tmp_path / "arm.bag", tmp_path / "tracker.bag", "-o", output)
    words += ("--robot", "raven2", "--profile", "raven2_mended")
    told = call(*words, "--tracker", "/marker")
    assert told.code == 2
    assert "--registration" in told.err
    assert call(*words, "--truth", "/ext_jpos", "--registration", known).code == 2
    told = call(*words, "--registration", known, "--json")
    assert told.code == 0, told.err
    assert "all alike: another marker" in told.err
    (stretch,) = json.loads(told.out)["tracker"]["stretches"]
    assert (stretch["begin"], stretch["end"]) == pytest.approx((20.0, 25.0), abs=0.5)
    assert stretch["distance"] == pytest.approx(0.02, rel=0.05)
    tracked = read_recording(output)
    off = tracked.columns("truth", robot.positioning) - np.column_stack(
        [np.interp(tracked.t, whole.t, column) for column in joint[:, :3].T]
    )
    missing = np.isnan(off).any(axis=1)
    assert missing[(tracked.t > 21.0) & (tracked.t < 24.0)].all()
    assert (np.abs(np.median(off[~missing], axis=0)) < [0.01, 0.01, 5e-4]).all()
