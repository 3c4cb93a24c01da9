"""`truejoint track`, as a person calls it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
from tests.cli.conftest import Call

from truejoint import get_robot, read_recording
from truejoint.simulation.tracker import SimulatedTracker

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
    words = ["track", tmp_path / "robot.csv", points, "--robot", "raven2", "--arm", "left"]
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
    assert json.loads(told.out)["joints"] == list(robot.positioning)
    assert call(*words, "--registration", known).code == 2
    told = call(*words, "--near-s", "1")
    assert "give one of the two" in told.err
