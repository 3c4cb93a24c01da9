"""Files and topics of points and poses, and readings in which the marker is lost."""

from itertools import product

import numpy as np
import pandas as pd
import pytest
from tests.recordings.marker_bag import KINDS, write_marker_bag
from tests.recordings.refusals import refused

from truejoint.recordings import Track, read_track
from truejoint.recordings.read.track import BACK, FROZEN, LOST

T = np.arange(120) / 30
POINTS = np.column_stack([np.sin(T), np.cos(T), T])
TURNS = np.column_stack([np.sin(T / 2), np.zeros_like(T), np.zeros_like(T), np.cos(T / 2)])


def table(*, poses: bool) -> pd.DataFrame:
    columns = dict(zip("xyz", POINTS.T, strict=True))
    if poses:
        columns |= dict(zip(("qx", "qy", "qz", "qw"), TURNS.T, strict=True))
    return pd.DataFrame({"frame": np.arange(len(T)), "t": T, **columns})


@pytest.mark.parametrize("poses", [False, True])
@pytest.mark.parametrize("kind", ["csv", "tab"])
def test_a_file_gives_its_points(tmp_path, kind, poses):
    path = tmp_path / f"points.{kind}"
    frame = table(poses=poses)
    frame.to_csv(path, index=False, sep="\t" if kind == "tab" else ",")
    track = read_track(path)
    np.testing.assert_allclose(track.t, T)
    np.testing.assert_allclose(track.position, POINTS)
    assert (track.orientation is not None) == poses
    if track.orientation is not None:
        np.testing.assert_allclose(track.orientation, TURNS, atol=1e-15)
    np.testing.assert_allclose(read_track(path, unit="mm").position, 1e-3 * POINTS)


def test_a_lost_marker_is_no_reading():
    points, turns, t = POINTS.copy(), TURNS.copy(), T.copy()
    points[3] = np.nan
    points[4] = 0.0
    turns[5] = 0.0
    points[7], turns[7] = points[6], turns[6]
    t[9] = t[8]
    track = Track.of_readings(t, points, turns)
    assert dict(track.dropped) == {LOST: 3, FROZEN: 1, BACK: 1}
    kept = np.setdiff1d(np.arange(len(T)), [3, 4, 5, 7, 9])
    np.testing.assert_array_equal(track.position, POINTS[kept])


def test_a_bag_gives_the_topic_of_the_tracker(tmp_path):
    path = tmp_path / "session.bag"
    topics = {"/marker": "PoseStamped", "/arm1/measured_cp": "PoseStamped"}
    write_marker_bag(path, 5.0 + T, POINTS, TURNS, topics)
    track = read_track(path)
    np.testing.assert_allclose(track.t, 5.0 + T, atol=1e-8)
    assert track.source == "session.bag: /marker"
    assert len(read_track(path, "/arm1/measured_cp")) == len(T)
    refused(r"no points or poses on '/tf'.* /marker", read_track, path, "/tf")
    refused("in m; leave the unit out", read_track, path, unit="mm")
    refused("at least one", read_track, [])


@pytest.mark.parametrize(
    ("kind", "suffix"), [*product(KINDS, (".bag", ".mcap")), ("PoseStamped", ".db3")]
)
def test_each_message_of_a_marker_is_read(tmp_path, kind, suffix):
    half = len(T) // 2
    bags = [tmp_path / f"{name}{suffix}" for name in ("first", "second")]
    for bag, rows in zip(bags, (slice(half), slice(half, None)), strict=True):
        write_marker_bag(bag, 5.0 + T[rows], POINTS[rows], TURNS[rows], {"/marker": kind})
    track = read_track(bags)
    np.testing.assert_allclose(track.t, 5.0 + T, atol=1e-8)
    np.testing.assert_array_equal(track.position, POINTS)
    if kind == "PointStamped":
        assert track.orientation is None
    else:
        assert track.orientation is not None
        np.testing.assert_allclose(track.orientation, TURNS, atol=1e-15)


def test_what_is_no_track_is_one_line(tmp_path):
    path = tmp_path / "points.csv"
    table(poses=True).drop(columns="qw").to_csv(path, index=False)
    refused("is no file of points: it begins with frame, t, x", read_track, path)
    np.savetxt(path, POINTS, delimiter=",")
    refused("is no file of points", read_track, path)
    table(poses=False).iloc[:40].to_csv(path, index=False)
    refused("40 readings", read_track, path)
    refused("is no bag, so it has no topic", read_track, path, "/marker")
    refused("no unit called 'inch'", read_track, path, unit="inch")
    lost = table(poses=False)
    lost.loc[5:, ["x", "y", "z"]] = np.nan
    lost.to_csv(path, index=False)
    refused(r"only 5 of 120 readings .*marker lost: 115", read_track, path)
    table(poses=False).to_parquet(tmp_path / "points.parquet")
    refused("is not a text file", read_track, tmp_path / "points.parquet")
    refused("there is no such file", read_track, tmp_path / "none.csv")
