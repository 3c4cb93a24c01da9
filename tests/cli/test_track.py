"""`truejoint track`, as a person calls it."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
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


ROBOT = get_robot("raven2", "left")
CARRIER = ROBOT.kinematics.up_to(3)


def true_joints(recording):
    """Positions of all joints of a recording, true ones where sensors tell them (n, 7)."""
    joint = recording.columns("measured", ROBOT.joint_names)
    joint[:, :3] = recording.columns("truth", ROBOT.positioning)
    return joint


def test_points_become_truth(call, session):
    before = read_recording(session / "random.parquet")
    seen = before.with_truth(ROBOT.positioning)
    tracker = SimulatedTracker(1e-4, delay=0.0)
    t, position, _ = tracker.see(CARRIER, seen.t, true_joints(seen), np.eye(4), np.eye(4))
    start, columns = before.provenance.start, dict(zip("xyz", 1e3 * position.T, strict=True))
    pd.DataFrame({"t": t + start, **columns}).to_csv("points.csv", index=False)
    bare = before.table[["t", *(f"measured/{n}" for n in ROBOT.joint_names)]]
    bare.assign(t=bare["t"] + start).to_csv("robot.csv", index=False)
    Path("tracker.toml").write_text(REGISTRATION)
    line = "extract robot.csv --tracker points.csv --robot raven2:left --unit mm -o tracked.parquet"
    call.refuses("the motion does not tell the zero of shoulder", f"{line} --offset-s 0")
    known = f"{line} --offset-s 0 --registration tracker.toml"
    assert "truth ±" in call.good(known).out
    assert "truth of a tracker, points.csv" in read_recording("tracked.parquet").provenance.notes
    assert call.json(f"{known} --force")["tracker"]["joints"] == list(ROBOT.positioning)
    call.refuses("--force", known)
    call.refuses("give one of the two", f"{line} --offset-s 0 --near-s 1")


def test_the_tracker_of_a_bag_is_its_truth(call, session):
    whole = read_recording(session / "random.parquet").with_truth(ROBOT.positioning)
    joint = true_joints(whole)
    tracker = SimulatedTracker(1e-4, rate=10.0, delay=0.02)
    t, points, _ = tracker.see(CARRIER, whole.t, joint, np.eye(4), np.eye(4))
    # For five seconds it sees another marker of the tool, 2 cm further up.
    aside = np.eye(4)
    aside[2, 3] = -0.02
    swapped = (t > 20.0) & (t < 25.0)
    points[swapped] = tracker.see(CARRIER, whole.t, joint, np.eye(4), aside)[1][swapped]
    start = 1.7e9
    about = replace(whole.provenance, start=start)
    write_bag(replace(whole, provenance=about), "arm.bag", profile="raven2_mended")
    turns = np.tile([0.0, 0.0, 0.0, 1.0], (len(t), 1))
    kinds = {"/marker": "PointStamped"}
    write_marker_bag(Path("tracker.bag"), start + t, points, turns, kinds)
    Path("tracker.toml").write_text(REGISTRATION)
    line = "extract arm.bag tracker.bag -o tracked.parquet --robot raven2 --profile raven2_mended"
    call.refuses("--registration", f"{line} --tracker /marker")
    known = f"{line} --registration tracker.toml"
    call.refuses("give one of the two", f"{known} --truth /ext_jpos")
    told = call.good(f"{known} --json")
    assert "all alike: another marker" in told.err
    (stretch,) = json.loads(told.out)["tracker"]["stretches"]
    assert (stretch["begin"], stretch["end"]) == pytest.approx((20.0, 25.0), abs=0.5)
    assert stretch["distance"] == pytest.approx(0.02, rel=0.05)
    tracked = read_recording("tracked.parquet")
    off = tracked.columns("truth", ROBOT.positioning) - np.column_stack(
        [np.interp(tracked.t, whole.t, column) for column in joint[:, :3].T]
    )
    missing = np.isnan(off).any(axis=1)
    assert missing[(tracked.t > 21.0) & (tracked.t < 24.0)].all()
    assert (np.abs(np.median(off[~missing], axis=0)) < [0.01, 0.01, 5e-4]).all()
