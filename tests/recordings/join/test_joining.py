"""Truth that was recorded on a clock of its own finds its place by the motion."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from tests.recordings.refusals import refused

from truejoint.recordings import Provenance, Recording, Stream, join_truth
from truejoint.recordings.datasets import read_dataset
from truejoint.recordings.join import joining

JOINTS = ("joint1", "joint2")


def angles(t: np.ndarray, seed: int) -> np.ndarray:
    """Motion (n, 2) at several speeds that does not repeat itself."""
    random = np.random.default_rng(seed)
    rates, phases = random.uniform(0.2, 2.0, (6, 2)), random.uniform(0, 6, (6, 2))
    return np.sin(t[:, None, None] * rates + phases).mean(axis=1)


def robot_and_truth(
    offset: float, seed: int, dt: float = 0.01, truth_dt: float = 0.02, *, hysteresis: float = 0.0
) -> tuple[Recording, Stream]:
    """Robot's recording and a truth [rad] whose clock is `offset` behind, both with noise."""
    random = np.random.default_rng(seed)
    t, truth_t = np.arange(0.0, 40.0, dt), np.arange(3.0, 44.0, truth_dt)
    noise = 1e-4 * random.standard_normal((len(t), 2))
    measured = dict(zip(JOINTS, (angles(t, seed) + noise).T, strict=True))
    q = angles(truth_t, seed)
    way = np.sign(np.gradient(q, axis=0))
    truth = 1.03 * q - 0.02 * q[:, ::-1] + 0.1 - hysteresis * way
    columns = {"t": t} | {f"measured/{joint}": values for joint, values in measured.items()}
    recording = Recording.from_columns(columns, Provenance("bros", source="robot.csv"))
    named = {f"truth/{joint}": truth[:, k] for k, joint in enumerate(JOINTS)}
    return recording, Stream(truth_t - offset, named)


@settings(max_examples=3)
@given(offset=st.floats(-5e3, 5e3), seed=st.integers(0, 50))
def test_the_offset_is_found_to_a_fraction_of_a_step(offset, seed):
    recording, truth = robot_and_truth(offset, seed)
    joined, clock = join_truth(recording, truth)
    assert clock.seconds == pytest.approx(offset, abs=2e-3)
    assert abs(clock.seconds - offset) < 3 * clock.sd < 0.05
    known = np.isfinite(joined.columns("truth", JOINTS)).all(axis=1)
    assert known.sum() == pytest.approx((recording.t >= 3.0).sum(), abs=2)
    assert f"{clock} (sd " in joined.provenance.notes
    assert joined.provenance.rates["truth"] == 50.0


@pytest.mark.parametrize("seed", range(2))
def test_friction_is_not_taken_for_a_delay(seed):
    recording, truth = robot_and_truth(17.0, seed, hysteresis=0.03)
    _, clock = join_truth(recording, truth)
    assert clock.seconds == pytest.approx(17.0, abs=0.02)  # 0.03 rad pass for about 50 ms
    assert abs(clock.seconds - 17.0) < 3 * clock.sd


def test_stamps_since_1970_are_offset_against_the_robots_own_clock():
    recording, truth = robot_and_truth(0.0, 1)
    later = Provenance("bros", source="robot.csv", start=1.7e9)
    recording = Recording(recording.table, recording.units, later)
    _, clock = join_truth(recording, Stream(truth.t + 1.7e9 - 2.5, truth.columns))
    assert clock.seconds == pytest.approx(2.5, abs=2e-3)


def test_a_stated_offset_is_taken_as_it_is():
    recording, truth = robot_and_truth(17.0, 1)
    joined, clock = join_truth(recording, truth, 17.0)
    assert (clock.seconds, clock.joints) == (17.0, ())
    rows = np.isfinite(joined.column("truth/joint1"))
    expected = np.interp(joined.t[rows], truth.t + 17.0, truth.columns["truth/joint1"])
    np.testing.assert_allclose(joined.column("truth/joint1")[rows], expected)


def test_a_motion_that_repeats_itself_needs_a_hint():
    t = np.arange(0.0, 30.0, 0.01)
    columns = {"t": t, "measured/joint1": np.sin(2 * np.pi * t / 5.0)}
    truth = Stream(t + 60.0, {"truth/joint1": columns["measured/joint1"]})
    recording = Recording.from_columns(columns, "bros")
    refused(
        r"repeats itself: offsets of .*--near-s of extract, join and track",
        join_truth,
        recording,
        truth,
    )
    for near in (-61.0, -58.5, -54.0):
        _, clock = join_truth(recording, truth, near=near)
        assert clock.seconds == pytest.approx(5.0 * round(near / 5.0), abs=1e-3)


def _other(recording: Recording, truth: Stream) -> object:
    noise = np.random.default_rng(0).standard_normal((2, len(truth.t)))
    return join_truth(recording, Stream(truth.t, dict(zip(truth.columns, noise, strict=True))))


def _twitch(recording: Recording, truth: Stream) -> object:
    at_once = {"t": recording.t, "measured/joint1": 1e-3 * (np.arange(len(recording)) == 5)}
    one = Stream(truth.t, {"truth/joint1": truth.columns["truth/joint1"]})
    return join_truth(Recording.from_columns(at_once, "bros"), one)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (_twitch, "joint1 stand still"),
        (_other, "no offset of the clocks makes the truth follow joint1, joint2"),
        (
            lambda recording, truth: join_truth(
                recording, Stream(truth.t, {"truth/joint1": np.ones(len(truth.t))})
            ),
            "joint1 stand still",
        ),
        (
            lambda recording, truth: join_truth(join_truth(recording, truth)[0], truth),
            "has a truth already",
        ),
        (
            lambda recording, truth: join_truth(
                recording, Stream(truth.t, {"truth/elbow": truth.columns["truth/joint1"]})
            ),
            "no column 'measured/elbow'",
        ),
        (lambda recording, truth: join_truth(recording, truth, np.inf), "an offset of inf s"),
        (
            lambda recording, truth: join_truth(recording, Stream(truth.t, {"jaw": truth.t})),
            r"columns \['jaw'\] are none of it; call them truth/",
        ),
    ],
)
def test_what_cannot_be_joined_is_one_line(call, message):
    refused(message, call, *robot_and_truth(0.0, 0))


@pytest.mark.parametrize("name", ["bros_dual_encoder", "kuka_kr300_dual_encoder"])
def test_the_offset_is_found_on_real_joints(dataset_folder, name):
    dataset_folder(name)
    for whole in read_dataset(name)[:2]:
        joints = whole.joints_of("truth")
        kept = [column for column in whole.table if not column.startswith("truth")]
        robot = Recording.from_columns(whole.table[kept], whole.provenance.robot)
        rows = slice(len(whole) // 10, None, 3)
        truth = {f"truth/{joint}": whole.column(f"truth/{joint}")[rows] for joint in joints}
        _, clock = join_truth(robot, Stream(whole.t[rows] - 123.4, truth))
        assert clock.seconds == pytest.approx(123.4, abs=0.005)
        assert abs(clock.seconds - 123.4) < 2 * clock.sd


def test_strokes_that_are_all_alike_leave_the_offset_open_and_that_is_said():
    """Up and down at one speed, in periods that never change: a play looks like a delay."""
    fine = np.arange(0.0, 100.0, 1e-3)
    t, truth_t = np.arange(0.0, 99.9, 1 / 30), np.arange(0.003, 99.9, 0.01)
    columns, truth = {"t": t}, {}
    for joint, period in zip(JOINTS, (5.0, 5.7), strict=True):
        strokes = 0.7 + 0.3 * (2.0 * np.abs(2.0 * ((fine / period) % 1.0) - 1.0) - 1.0)
        joint_at = [strokes[0]]
        for motor in strokes[1:]:
            joint_at.append(min(max(joint_at[-1], motor - 0.01), motor + 0.01))
        noise = 1e-5 * np.random.default_rng(0).standard_normal(len(t))
        columns[f"measured/{joint}"] = np.interp(t, fine, strokes) + noise
        truth[f"truth/{joint}"] = np.interp(truth_t, fine, joint_at)
    recording = Recording.from_columns(columns, Provenance("bros"))
    _, clock = join_truth(recording, Stream(truth_t, truth), near=0.0)
    assert abs(clock.seconds) < 2.0 * clock.sd
    assert clock.sd > 0.02


@pytest.mark.parametrize("seed", range(2))
def test_a_path_finds_its_place_in_whatever_frame_it_is_seen(seed):
    random = np.random.default_rng(seed)
    t, seen_t = np.arange(0.0, 60.0, 0.05), np.arange(5.0, 55.0, 0.02)
    turn = Rotation.random(rng=random).as_matrix()
    seen = path(seen_t, seed) @ turn.T + [1.0, -2.0, 3.0]
    # Noise as large as a step: ripples on one peak are no second answer.
    seen += 0.02 * random.standard_normal(seen.shape)
    offset = joining.find_path_offset(t, path(t, seed), seen_t - 77.0, seen)
    assert offset == pytest.approx(77.0, abs=0.1)
    refused(
        "no offset of the clocks makes the truth follow",
        joining.find_path_offset,
        t,
        path(t, seed),
        seen_t,
        random.standard_normal(seen.shape),
    )


def test_a_path_that_repeats_itself_is_refused_unless_told_about_where():
    t, seen_t = np.arange(0.0, 60.0, 0.05), np.arange(20.0, 40.0, 0.05)

    def rounds(stamps: np.ndarray) -> np.ndarray:
        turns = stamps[:, None] * [1.0, 2.0, 3.0]
        return np.sin(2 * np.pi * turns / 10.0 + [0.0, 1.0, 2.0])

    refused("repeats itself", joining.find_path_offset, t, rounds(t), seen_t, rounds(seen_t))
    found = joining.find_path_offset(t, rounds(t), seen_t, rounds(seen_t), near=9.0)
    assert found == pytest.approx(10.0, abs=0.05)
    refused(
        "about nan s", joining.find_path_offset, t, rounds(t), seen_t, rounds(seen_t), near=math.nan
    )


def path(t: np.ndarray, seed: int) -> np.ndarray:
    """Way (n, 3) that does not repeat itself."""
    return np.column_stack([angles(t, seed), angles(t, seed + 1000)[:, :1]])
