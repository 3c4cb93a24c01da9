"""How an arm behaves while its calibration holds: efforts on the way, errors over time."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from truejoint.calibration import baseline_fit, calibrate
from truejoint.calibration.baseline_fit import MAX_JOINTS, residual_baseline, residual_statistics
from truejoint.calibration.efforts import (
    count_effort_terms,
    effort_steps,
    effort_terms,
    time_in_motion,
)
from truejoint.recordings import Provenance, Recording
from truejoint.robots import get_robot

JOINTS = ("shoulder", "elbow", "insertion")
LOWER, UPPER = np.array([0.4, 1.0, 0.33]), np.array([1.0, 1.9, 0.42])
FEATURES = [f"{quantity}/{joint}" for quantity in ("measured", "effort") for joint in JOINTS]


def known_effort(position: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """Effort (n, 3) that the terms can express: gravity, Coulomb and viscous friction."""
    scaled = (2 * position - LOWER - UPPER) / (UPPER - LOWER)
    gravity = 0.1 + 0.05 * scaled[:, [1, 2, 0]] + 0.02 * scaled**2
    per_range = speed / (UPPER - LOWER)
    return gravity + np.sign(speed) * (0.08 + 0.01 * scaled) + 0.3 * per_range


def motion(seed: int = 0, *, duration=400.0, rate=30.0, noise=0.004, shoulder=1.0) -> Recording:
    """Triangular motion of three joints over their ranges, efforts known."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, duration, 1.0 / rate)
    phase = np.outer(t, [0.021 * shoulder, 0.05, 0.087]) + rng.uniform(0, 1, 3)
    share = np.abs((phase % 1.0) * 2 - 1)
    position = LOWER + (0.02 + 0.96 * share) * (UPPER - LOWER)
    if shoulder == 0.0:
        position[:, 0] += 1e-4 * np.sin(t)
    speed = np.diff(position, axis=0, prepend=position[:1] - (position[1] - position[0])) * rate
    effort = known_effort(position, speed) + rng.normal(0, noise, position.shape)
    columns = {"t": t}
    for k, joint in enumerate(JOINTS):
        columns[f"measured/{joint}"] = position[:, k]
        columns[f"effort/{joint}"] = effort[:, k]
        columns[f"truth/{joint}"] = position[:, k] + 0.01 + rng.normal(0, 1e-3, len(t))
    provenance = Provenance("raven2", arm="left", source=f"motion-{seed}", session=str(seed))
    return Recording.from_columns(columns, provenance)


def steps_of(t, position, effort, lower=LOWER, upper=UPPER) -> np.ndarray:
    """Steps of a motion, as `effort_steps` lays them out."""
    rows = np.empty((position.size, 4 + count_effort_terms(3)))
    t, position, effort = map(np.ascontiguousarray, (t, position, effort))
    return rows[: effort_steps(t, position, effort, lower, upper, rows)]


@pytest.fixture(scope="module")
def calibration():
    return calibrate([motion(0), motion(1)], "linear", features=FEATURES)


@settings(deadline=None)
@given(st.lists(st.floats(0, 1), min_size=3, max_size=3), st.floats(-1, 1).filter(bool))
def test_terms_are_gravity_and_friction(shares, speed):
    position = LOWER + np.array(shares) * (UPPER - LOWER)
    out = np.full(count_effort_terms(3), np.nan)
    effort_terms(position, speed, LOWER, UPPER, out)
    z = 2 * np.array(shares) - 1
    products = [z[i] * z[j] for i in range(3) for j in range(i, 3)]
    sign = np.sign(speed)
    assert out == pytest.approx([1, *z, *products, sign, *(sign * z), speed], abs=1e-12)


def test_baseline_recovers_the_efforts_and_their_noise(calibration):
    baseline = calibration.effort_baseline
    assert baseline.monitored.tolist() == [1.0, 1.0, 1.0]
    assert baseline.scale == pytest.approx(0.004, rel=0.3)  # and speeds at 30 Hz are rough
    test = motion(5, noise=0.0)
    motions = (test.columns(quantity, JOINTS) for quantity in ("measured", "effort"))
    rows = steps_of(test.t.copy(), *motions, baseline.lower, baseline.upper)
    assert len(rows) > 1000
    predicted = np.einsum("ij,ij->i", rows[:, 4:], baseline.coef[rows[:, 0].astype(int)])
    assert np.abs(predicted - rows[:, 1]).max() < 0.012  # friction alone is 0.16 apart


def test_steps_count_travel_and_not_time_and_standstill_makes_none():
    counts = {}
    for rate in (30.0, 500.0):
        test = motion(5, duration=100.0, rate=rate)
        position = test.columns("measured", JOINTS)
        counts[rate] = len(steps_of(test.t.copy(), position, position))
        travel = np.abs(np.diff(position, axis=0)).sum(axis=0) / (UPPER - LOWER)
        assert counts[rate] < 200 * travel.sum()
    # At 30 Hz a step is up to one row longer than 1/200 of the range.
    assert 0.6 * counts[500.0] < counts[30.0] <= counts[500.0]
    flicker = 1e-5 * np.random.default_rng(0).normal(size=(500, 3))
    still = (LOWER + UPPER) / 2 + flicker
    assert not len(steps_of(np.arange(500.0), still, still))


def test_a_joint_that_hardly_moved_or_whose_effort_is_not_seen_is_not_monitored():
    slow = [motion(seed, shoulder=0.2) for seed in range(2)]
    hardly = calibrate(slow, "linear", features=FEATURES).effort_baseline
    assert hardly.monitored.tolist() == [0.0, 1.0, 1.0]
    unseen = calibrate(motion(0), "linear", features=FEATURES[:5]).effort_baseline
    assert unseen.monitored.tolist() == [1.0, 1.0, 0.0]
    assert unseen.coef[2].tolist() == [0.0] * count_effort_terms(3)


def test_recordings_that_disagree_raise_the_limits():
    other = motion(1)
    table = other.table.assign(**{"effort/elbow": other.column("effort/elbow") + 0.05})
    changed = replace(other, table=table)
    alike = calibrate([motion(0), other], "linear", features=FEATURES).effort_baseline
    apart = calibrate([motion(0), changed], "linear", features=FEATURES).effort_baseline
    assert alike.shift_limit == pytest.approx(0.6, rel=0.1)
    # 0.05 is twelve standard deviations of the noise, and what is held out counts five times.
    assert apart.shift_limit[1] > 10
    assert apart.shift_limit[[0, 2]].tolist() == alike.shift_limit[[0, 2]].tolist()


def test_size_and_correlation_time_of_errors_are_found():
    rng = np.random.default_rng(0)
    base = motion(0, duration=2000.0, rate=5.0)
    n, keep = len(base), np.exp(-0.2 / 4.0)
    wander = np.zeros((n, 3))
    for i in range(1, n):
        wander[i] = keep * wander[i - 1] + np.sqrt(1 - keep**2) * rng.normal(size=3)
    truth = {
        f"truth/{j}": base.column(f"measured/{j}") + 0.02 * wander[:, k]
        for k, j in enumerate(JOINTS)
    }
    recording = replace(base, table=base.table.assign(**truth))
    calibration = calibrate(recording, "offset", features=FEATURES)
    size, time, _ = residual_statistics(calibration, [recording], np.zeros(len(calibration.joints)))
    assert size == pytest.approx(0.02, rel=0.1)
    assert time == pytest.approx(4.0, rel=0.3)


@pytest.mark.parametrize(("recordings", "each"), [(1, 24), (5, 5), (8, 3), (12, 3)])
def test_beginnings_are_looked_at_from_so_many_starts_in_all_and_of_each(
    monkeypatch, calibration, recordings, each
):
    counts = []

    def looked_at(_calibration, _recording, _corrected, count, _step):
        counts.append(count)
        return []

    monkeypatch.setattr(baseline_fit, "beginning_offsets", looked_at)
    residual_statistics(calibration, [motion(0, duration=20.0)] * recordings, np.zeros(3))
    assert counts == [each] * recordings


def test_too_many_joints_or_a_joint_at_rest_give_no_effort_baseline(calibration):
    rows = calibration.rows(motion(3, duration=20.0))
    assert residual_baseline(calibration, [rows]) is not None
    still = rows.recording.table.assign(**{"measured/elbow": 1.0})
    at_rest = replace(rows, recording=replace(rows.recording, table=still))
    for none in (at_rest, replace(rows, joints=("elbow",) * (MAX_JOINTS + 1))):
        assert residual_baseline(calibration, [none]) is None
    assert len(get_robot("kuka_kr300").joints) <= MAX_JOINTS


def test_a_joint_rests_where_it_takes_long_for_a_step():
    """By the definition, sample by sample, in plain Python."""
    t = np.cumsum(np.random.default_rng(0).uniform(0.02, 0.2, 300))
    t[150:] += 7.0  # nobody looked, and it is elsewhere then
    speed = np.select([t < 5.0, t < 10.0, t < 20.0], [0.0, 1.0, 0.05], 0.7)
    position = np.cumsum(speed * np.diff(t, prepend=0.0))
    step, expected, at, since, total = 0.05, [], position[0], t[0], 0.0
    for i in range(300):
        if abs(position[i] - at) >= step:
            total += min(t[i] - since, max(0.5, t[i] - t[i - 1]))
            at, since = position[i], t[i]
        expected.append(total)
    both = np.column_stack([position, np.where(np.arange(300) % 2, 0.04, 0.0)])
    found = time_in_motion(t, both, np.array([step, step]))
    np.testing.assert_allclose(found[:, 0], expected, rtol=1e-12)
    assert not found[:, 1].any()  # it flickers within a step
    assert found[t < 5.0, 0].max() == 0.0
    assert found[-1, 0] < 0.9 * (t[-1] - 5.0)  # at 0.05 it takes a second for a step: half counts
    every = time_in_motion(t, both, np.zeros(2))
    np.testing.assert_allclose(every, np.column_stack([t - t[0]] * 2), rtol=1e-12)
