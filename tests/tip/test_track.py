"""Joint truth from what a tracker saw: transforms, delay, strays, and what cannot be seen."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.simulated_tracker import SimulatedTracker

from truejoint.errors import CalibrationError, RecordingError, RobotError
from truejoint.recordings import Provenance, Recording, Track
from truejoint.robots import get_robot
from truejoint.tip import (
    Base,
    Marker,
    Registered,
    Registration,
    Touched,
    read_registration,
    tracked_truth,
)

ROBOT = get_robot("raven2", "left")
JOINTS = ROBOT.positioning
CARRIER = ROBOT.kinematics.up_to(3)
BASE = np.eye(4)
BASE[:3, :3] = Rotation.from_rotvec([0.3, -0.4, 1.9]).as_matrix()
BASE[:3, 3] = 0.2, -0.1, 0.9
"""Pose of the base in the tracker's frame."""
MARKER = np.eye(4)
MARKER[:3, :3] = Rotation.from_rotvec([1.0, 2.0, 0.3]).as_matrix()
MARKER[:3, 3] = 0.008, 0.003, -0.015
CLEAN = SimulatedTracker(2.5e-4, rate=20.0, delay=0.0, lost=0.0, strays=0.0)


def motion(seconds: float = 80.0, seed: int = 0, start: float = 0.0) -> tuple[Recording, Recording]:
    """A robot's recording and the same with the truth: zeros, slopes, a square and a play."""
    random = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, 0.05)
    rates, phases = random.uniform(0.15, 0.7, (3, 3)), random.uniform(0, 6, (3, 3))
    u = np.sin(t[:, None, None] * rates + phases).mean(axis=1) * 1.4
    centre, half = np.array([0.7, 1.45, 0.375]), np.array([0.3, 0.4, 0.04])
    joint = np.tile(ROBOT.home, (len(t), 1))
    joint[:, :3] = centre + half * u
    way = np.tanh(20 * np.gradient(u, t, axis=0))
    error = np.array([0.02, -0.03, 2e-3]) + 0.03 * half * u + 0.01 * half * u[:, [1, 2, 0]] ** 2
    truth = joint[:, :3] + error - 0.005 * half * way
    columns = {"t": t} | {f"measured/{n}": joint[:, k] for k, n in enumerate(ROBOT.joint_names)}
    about = Provenance("raven2", "left", source="robot.parquet", start=start)
    robot = Recording.from_columns(columns, about)
    known = {f"truth/{name}": truth[:, k] for k, name in enumerate(JOINTS)}
    return robot, Recording.from_columns(columns | known, about)


def seen(whole: Recording, tracker: SimulatedTracker = CLEAN, seed: int = 0) -> Track:
    joint = whole.columns("measured", ROBOT.joint_names)
    joint[:, :3] = whole.columns("truth", JOINTS)
    t, position, turn = tracker.see(CARRIER, whole.t, joint, BASE, MARKER, seed)
    return Track.of_readings(t, position, turn)


@pytest.fixture(scope="module")
def clean() -> tuple[Recording, Recording, Track]:
    """A robot's recording, the same with the truth, and what a tracker without strays saw."""
    robot, whole = motion()
    return robot, whole, seen(whole)


def stated(seed: int = 0, mm: float = 0.05, deg: float = 0.02) -> Registration:
    """Registration that is off by as much as it says."""
    random = np.random.default_rng([seed, 1])
    sd = np.repeat([np.deg2rad(deg), 1e-3 * mm], 3)
    off, pose = sd * random.standard_normal(6), BASE.copy()
    pose[:3, :3] = BASE[:3, :3] @ Rotation.from_rotvec(off[:3]).as_matrix()
    pose[:3, 3] = BASE[:3, 3] + BASE[:3, :3] @ off[3:]
    marker = MARKER[:3, 3] + 1e-3 * mm * random.standard_normal(3)
    return Registration(based(pose, 1e-3 * mm, np.deg2rad(deg)), Marker("roll", marker, 1e-3 * mm))


def based(pose: np.ndarray, sd: float, turn_sd: float) -> Base:
    return Base(pose[:3, 3], Rotation.from_matrix(pose[:3, :3]).as_quat(), sd, turn_sd)


def base_error(found: Registered) -> np.ndarray:
    """Turn [rad] and shift [m] (6,) by which the base is off, about and along its own axes."""
    off = np.linalg.inv(BASE) @ np.linalg.inv(found.base_from_tracker)
    return np.concatenate([Rotation.from_matrix(off[:3, :3]).as_rotvec(), off[:3, 3]])


def truth_error(tracked: Recording, whole: Recording) -> np.ndarray:
    error = tracked.columns("truth", JOINTS) - whole.columns("truth", JOINTS)
    return error[np.isfinite(error).all(axis=1)]


@pytest.mark.parametrize("turn_noise", [0.0, 0.004])
def test_truth_transforms_and_delay_are_as_stated(turn_noise: float) -> None:
    robot, whole = motion(start=1.7e9)
    tracker = replace(CLEAN, turn_noise=turn_noise, delay=0.04, lost=0.05, strays=0.02)
    track = seen(whole, tracker)
    track = replace(track, t=track.t + 1.7e9 - 12.0)
    tracked, found = tracked_truth(robot, track, stated())
    assert found.clock.seconds == pytest.approx(12.0 - 0.04, abs=4 * found.clock.sd)
    assert found.clock.sd < 0.01
    assert (np.abs(base_error(found)) < 4 * found.base_sd).all()
    marker = found.link_from_marker[:3, 3] - MARKER[:3, 3]
    assert (np.abs(marker) < 4 * found.marker_sd).all()
    assert found.noise == pytest.approx(2.5e-4, rel=0.1)
    error = truth_error(tracked, whole)
    assert len(error) > 1300
    # Between two readings the truth is their mean, which has less noise than either.
    assert (error.std(axis=0) < 1.1 * found.noise_deviation).all()
    assert (np.abs(error.mean(axis=0)) < 4 * found.pose_deviation).all()
    assert found.strays == pytest.approx(0.02 * len(track), abs=15)
    assert "truth of a tracker" in tracked.provenance.notes
    assert tracked.provenance.dropped["tracker: strays"] == found.strays
    if turn_noise:
        turned = found.link_from_marker[:3, :3].T @ MARKER[:3, :3]
        assert Rotation.from_matrix(turned).magnitude() < 0.01


def test_poses_tell_where_the_base_is_and_points_do_not(clean) -> None:
    robot, whole, track = clean
    loose = stated(mm=0.5)
    loose = replace(loose, marker=Marker("roll", MARKER[:3, 3], 5e-5))
    points = tracked_truth(robot, track, loose)[1]
    poses = tracked_truth(robot, seen(whole, replace(CLEAN, turn_noise=0.004)), loose)[1]
    assert (poses.base_sd[3:] < 0.5 * points.base_sd[3:]).all()
    assert (np.abs(base_error(poses)) < 4 * poses.base_sd).all()


def test_what_no_motion_shows_is_named_with_what_would_tell(clean) -> None:
    robot, _, track = clean
    with pytest.raises(CalibrationError) as told:
        tracked_truth(robot, track, Registration(marker=Marker("roll")))
    assert "zero of shoulder from a turn of the base about its z axis" in str(told.value)
    assert "zero of insertion from the marker's place" in str(told.value)
    assert "--registration" in str(told.value)


def test_touched_points_stand_in_for_the_bases_pose(clean) -> None:
    robot, _, track = clean
    marker = Marker("roll", MARKER[:3, 3], 1e-4)
    points = np.array([[0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1], [-0.1, 0.05, -0.1]])
    theirs = points @ BASE[:3, :3].T + BASE[:3, 3]
    touched = tuple(map(Touched, points, theirs))
    _, found = tracked_truth(robot, track, Registration(None, marker, touched, 1e-4))
    assert (np.abs(base_error(found)) < 4 * found.base_sd + 1e-9).all()
    assert found.base_sd[3:].max() < 1e-4


@pytest.mark.parametrize("fault", ["mistyped", "swapped", "scaled", "left-handed"])
def test_touched_points_that_do_not_fit_each_other_are_refused(fault: str) -> None:
    points = np.array([[0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1], [-0.1, 0.05, -0.1]])
    theirs = points @ BASE[:3, :3].T + BASE[:3, 3]
    theirs += 2e-4 * np.random.default_rng(0).standard_normal(theirs.shape)
    Registration(touched=tuple(map(Touched, points, theirs)), touched_sd=2e-4)
    wrong = {
        "mistyped": theirs + np.eye(4)[:, :1] * [3e-3, 0, 0],
        "swapped": theirs[[1, 0, 2, 3]],
        "scaled": 1.02 * theirs,
        "left-handed": theirs * [1, 1, -1],
    }[fault]
    with pytest.raises(CalibrationError, match=r"are \d.* mm apart .*touched_sd_mm says 0\.200"):
        Registration(touched=tuple(map(Touched, points, wrong)), touched_sd=2e-4)


def test_bad_tracks_are_one_line_each(clean) -> None:
    (robot, _, track), known = clean, stated()
    swapped = track.position.copy()
    swapped[len(swapped) // 2 :] += 0.03
    mirrored = track.position * [1.0, 1.0, -1.0]
    quaternion = known.base.quaternion[[3, 0, 1, 2]]  # w first
    turned = replace(known, base=known.base._replace(quaternion=quaternion))
    cases = [
        (replace(track, position=1e3 * track.position), known, (), None, "--unit mm"),
        (replace(track, position=mirrored), Registration(), (), 0.0, "left-handed"),
        (replace(track, t=track.t + 1e4), known, (), 0.0, "--offset-s"),
        (track, known, ("shoulder", "shoulder"), None, "each named once"),
        (track, known, ROBOT.joint_names[:4], None, "tells 1 to 3 joints"),
        (track, Registration(marker=Marker("knee")), (), None, "no joint called 'knee'"),
        (track, known, ("roll",), None, "stand still"),
        (track, turned, (), 0.0, "zero of insertion would be further.*x, y, z, w"),
    ]
    for bad, registration, joints, offset, said in cases:
        with pytest.raises((CalibrationError, RobotError), match=said) as told:
            tracked_truth(robot, bad, registration, joints, offset=offset)
        assert "\n" not in str(told.value)
    with pytest.raises(CalibrationError, match="confuse two markers"):
        tracked_truth(robot, replace(track, position=swapped), known, offset=0.0)
    other = seen(motion(seed=5)[1])
    with pytest.raises((CalibrationError, RecordingError)):
        tracked_truth(robot, other, known)


def confused(
    whole: Recording, aside: tuple[float, float, float], share: float
) -> tuple[Track, tuple[float, float]]:
    """What a tracker sees that takes another marker for this one, and from when to when [s]."""
    joint = whole.columns("measured", ROBOT.joint_names)
    joint[:, :3] = whole.columns("truth", JOINTS)
    tracker, other = replace(CLEAN, strays=0.02), MARKER.copy()
    other[:3, 3] += aside
    t, points, _ = tracker.see(CARRIER, whole.t, joint, BASE, MARKER, 0)
    begin = int(0.3 * len(t))
    rows = slice(begin, begin + int(share * len(t)))
    points[rows] = tracker.see(CARRIER, whole.t, joint, BASE, other, 1)[1][rows]
    return Track.of_readings(t, points), (t[rows][0], t[rows][-1])


@pytest.mark.parametrize("aside", [(0.02, 0.01, 0.02), (0.003, 0.0, 0.0)])
def test_a_stretch_of_another_marker_is_named_and_left_out(clean, aside) -> None:
    robot, whole, _ = clean
    track, (begin, end) = confused(whole, aside, 0.1)
    tracked, found = tracked_truth(robot, track, stated(), offset=0.0)
    (stretch,) = found.stretches
    assert (stretch.begin, stretch.end) == pytest.approx((begin, end), abs=0.6)
    assert stretch.alike
    assert stretch.distance == pytest.approx(np.linalg.norm(aside), rel=0.1)
    assert f"left out: {stretch}" in tracked.provenance.notes
    assert tracked.provenance.dropped["tracker: off for a while"] == stretch.readings
    inside = (tracked.t > begin + 1.0) & (tracked.t < end - 1.0)
    assert np.isnan(tracked.columns("truth", JOINTS)[inside]).all()
    assert (np.abs(truth_error(tracked, whole).mean(axis=0)) < 4 * found.pose_deviation).all()
    assert found.summary()["left out"] == str(stretch)


def test_a_stretch_that_is_here_and_there_is_no_marker(clean) -> None:
    robot, _, track = clean
    random = np.random.default_rng(0)
    points = track.position.copy()
    points[400:500] += random.uniform(-0.05, 0.05, (100, 3))
    found = tracked_truth(robot, replace(track, position=points), stated(), offset=0.0)[1]
    (stretch,) = found.stretches
    assert not stretch.alike
    assert stretch.readings == pytest.approx(100, abs=3)


def test_turns_of_the_cables_are_no_other_marker_to_a_tracker_without_noise(clean) -> None:
    robot, whole, _ = clean
    track = seen(whole, replace(CLEAN, noise=0.0))
    tracked, found = tracked_truth(robot, track, stated(), offset=0.0)
    assert (found.strays, found.stretches) == (0, ())
    assert (np.abs(truth_error(tracked, whole).mean(axis=0)) < 4 * found.pose_deviation).all()


def test_markers_confused_for_long_are_refused_with_when(clean) -> None:
    robot, whole, _ = clean
    # At a third the fit lies between both, and leaves nothing out.
    track, (begin, end) = confused(whole, (0.01, 0.0, 0.0), 0.32)
    with pytest.raises(CalibrationError, match=r"they jump at (.+) s\)") as told:
        tracked_truth(robot, track, stated(), offset=0.0)
    times = re.findall(r"jump at ([\d.]+), ([\d.]+) s", str(told.value))
    assert [float(t) for t in times[0]] == pytest.approx((begin, end), abs=0.6)


@pytest.mark.parametrize("millimetres", [0.7, 2.0])
def test_a_marker_that_slips_is_refused_with_when(clean, millimetres: float) -> None:
    robot, whole, track = clean
    joint = whole.columns("measured", ROBOT.joint_names)
    joint[:, :3] = whole.columns("truth", JOINTS)
    slipped, points = MARKER.copy(), track.position.copy()
    slipped[:3, 3] += 1e-3 * millimetres * np.array([0.6, 0.0, 0.8])
    half = len(track) // 2
    points[half:] = CLEAN.see(CARRIER, whole.t, joint, BASE, slipped, 1)[1][half:]
    with pytest.raises(CalibrationError, match=r"the marker slips at 40\.\d s, by [01]\."):
        tracked_truth(robot, replace(track, position=points), stated(), offset=0.0)


TOML = """
[base]
position_mm = [1, 2, 3]
quaternion = [0, 0, 0, 1]
sd_mm = 0.2
sd_deg = 0.03
[marker]
link = "roll"
"""


def test_a_registration_is_read_in_millimetres_and_degrees(tmp_path: Path) -> None:
    path = tmp_path / "tracker.toml"
    path.write_text(TOML)
    found = read_registration(path)
    assert found.base is not None
    assert found.base.position.tolist() == [1e-3, 2e-3, 3e-3]
    assert (found.base.turn_sd, found.base.sd) == pytest.approx((np.deg2rad(0.03), 2e-4))
    assert found.marker == Marker("roll")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("[base]", "[bass]", "did you mean 'base'"),
        ("quaternion = [0, 0, 0, 1]", "quaternion = [0, 0, 0, 2]", "unit quaternion"),
        ("sd_mm = 0.2", "sd_mm = 0", "above 0"),
        ('link = "roll"', "position_mm = [1, 2, 3]", "marker.sd_mm is missing"),
        ("[marker]", 'touched = "roll"\n[marker]', "touched"),
    ],
)
def test_a_wrong_registration_is_one_line(tmp_path: Path, old: str, new: str, said: str) -> None:
    path = tmp_path / "tracker.toml"
    path.write_text(TOML.replace(old, new))
    with pytest.raises((CalibrationError, RobotError), match=said) as told:
        read_registration(path)
    assert "\n" not in str(told.value)
