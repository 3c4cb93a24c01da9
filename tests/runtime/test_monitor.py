"""The monitor: silent while all is well, and what raises it."""

import math
from dataclasses import replace

import numpy as np
import pytest

from truejoint.calibration import calibrate
from truejoint.errors import CalibrationError
from truejoint.recordings import Provenance, Recording
from truejoint.runtime import Alarm, Monitor, Reason

from .streams import least_memory

JOINTS = ("shoulder", "elbow", "insertion")
LOWER, UPPER = np.array([0.4, 1.0, 0.33]), np.array([1.0, 1.9, 0.42])
FEATURES = [f"{quantity}/{joint}" for quantity in ("measured", "effort") for joint in JOINTS]


def motion(
    seed: int = 0, *, duration=300.0, rate=30.0, load=0.0, friction=1.0, reach=1.0
) -> Recording:
    """Triangular motion; gravity, friction and noise in the efforts."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, duration, 1.0 / rate)
    phase = np.outer(t, [0.021, 0.05, 0.087]) + rng.uniform(0, 1, 3)
    share = np.abs((phase % 1.0) * 2 - 1)
    position = LOWER + (0.02 + 0.96 * reach * share) * (UPPER - LOWER)
    direction = np.sign(np.gradient(position, t, axis=0))
    gravity = 0.1 + 0.05 * share[:, [1, 2, 0]] + load * np.array([0.0, 0.0, 1.0])
    effort = gravity + friction * 0.08 * direction + rng.normal(0, 0.006, position.shape)
    columns = {"t": t}
    for k, joint in enumerate(JOINTS):
        columns[f"measured/{joint}"] = position[:, k]
        columns[f"effort/{joint}"] = effort[:, k]
        columns[f"truth/{joint}"] = position[:, k] + 0.01 + rng.normal(0, 1e-3, len(t))
    return Recording.from_columns(columns, Provenance("raven2", arm="left", source=f"m{seed}"))


@pytest.fixture(scope="module")
def calibration():
    return calibrate([motion(0), motion(1)], "linear", features=FEATURES)


@pytest.fixture(scope="module")
def monitor(calibration):
    return Monitor(calibration)


def samples_of(recording: Recording, signals: tuple[str, ...]) -> np.ndarray:
    return np.ascontiguousarray(np.column_stack([recording.column(s) for s in signals]))


def first_alarm(trace) -> float:
    """Time since the first sample [s] at which an alarm was first raised; NaN if never."""
    raised = np.flatnonzero(trace.alarm)
    return float(trace.t[raised[0]] - trace.t[0]) if len(raised) else math.nan


def test_an_arm_that_behaves_as_calibrated_raises_nothing(monitor):
    trace = monitor.run(motion(7, duration=600.0))
    assert trace.alarm.max() == Alarm.NONE
    assert math.isnan(first_alarm(trace))
    assert trace.measures[:, 0].max() > 0.0, "it never compared an effort"
    assert np.isfinite(monitor.shifts).all()


def test_a_load_shows_in_both_directions_alike(monitor):
    trace = monitor.run(motion(7, load=0.02))
    assert trace.alarm.max() >= Alarm.CHECK
    assert 2.0 < first_alarm(trace) < 100.0
    assert trace.reasons[-1] == Reason.SHIFT
    assert np.argmax(np.abs(monitor.shifts)) == 2
    assert monitor.shifts[2] > 1.0
    assert monitor.alarm >= Alarm.CHECK
    assert monitor.reasons == Reason.SHIFT


def test_a_heavy_load_means_recalibrate(monitor):
    assert monitor.run(motion(7, load=0.1)).alarm.max() == Alarm.RECALIBRATE


def test_friction_shows_in_the_difference_of_the_directions(monitor):
    trace = monitor.run(motion(7, friction=1.6))
    assert trace.reasons[-1] == Reason.FRICTION
    assert (monitor.frictions > 1.0).all()
    assert (monitor.run(motion(7, friction=0.4)).reasons[-1]) == Reason.FRICTION
    assert (monitor.frictions < -1.0).all()


def test_any_effort_may_hold_an_arm_at_rest(monitor, calibration):
    test = motion(7, duration=600.0)
    monitor.run(test)
    sample = samples_of(test, calibration.signals)[-1].copy()
    effort = [calibration.signals.index(f"effort/{joint}") for joint in JOINTS]
    worked = monitor.measures[3]
    for i in range(20_000):
        sample[effort] = 0.1 + 0.1 * math.sin(i)  # within the trained range
        assert monitor.step(600.0 + i / 30, sample) == Alarm.NONE
    assert monitor.measures[3] == pytest.approx(worked, abs=3 / 3600)


def test_samples_far_outside_the_trained_range_raise_it(calibration):
    test = motion(7)
    far = test.table.assign(**{"measured/elbow": test.column("measured/elbow") + 2.0})
    trace = Monitor(calibration).run(Recording(far, test.units, test.provenance))
    assert trace.reasons[-1] & Reason.RANGE
    assert trace.alarm.max() == Alarm.RECALIBRATE
    # Averaged over a minute: 10 % after 60 s * log(10 / 9).
    first = trace.t[np.argmax(trace.reasons & Reason.RANGE)] - trace.t[0]
    assert first == pytest.approx(60 * math.log(10 / 9), abs=0.1)


def test_working_time_counts_motion_and_starts_anew_at_a_reset(calibration):
    monitor = Monitor(calibration, working_time=100.0)
    trace = monitor.run(motion(7, duration=150.0))
    assert first_alarm(trace) == pytest.approx(100.0, abs=3.0)
    assert trace.reasons[-1] == Reason.WORK
    monitor.reset()
    assert monitor.alarm == Alarm.NONE
    assert monitor.step(151.0, samples_of(motion(7), calibration.signals)[0]) == Alarm.NONE


def test_a_gap_is_not_working_time_and_starts_the_direction_anew(calibration):
    monitor = Monitor(calibration)
    test = motion(7, duration=60.0)
    late = test.table.assign(t=np.where(test.t > 30.0, test.t + 5000.0, test.t))
    monitor.run(Recording(late, test.units, test.provenance))
    assert monitor.measures[3] < 61.0 / 3600.0
    assert monitor.alarm == Alarm.NONE


def test_the_rate_of_the_loop_does_not_matter(monitor):
    at_30 = monitor.run(motion(7, load=0.02))
    shifts = monitor.shifts.copy()
    at_200 = monitor.run(motion(7, load=0.02, rate=200.0))
    assert monitor.shifts == pytest.approx(shifts, abs=0.15)
    assert first_alarm(at_200) == pytest.approx(first_alarm(at_30), abs=5.0)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_samples_that_cannot_be_used_change_nothing(monitor, calibration, bad):
    test = motion(7, duration=60.0)
    clean = monitor.run(test).measures[-1].copy()
    monitor.reset()
    rows = samples_of(test, calibration.signals)
    for t, row in zip(test.t, rows, strict=True):
        monitor.step(t, row)
        broken = row.copy()
        broken[3] = bad
        monitor.step(t + 1e-4, broken)
        monitor.step(bad, row)
        monitor.step(t, row + 1.0)
        monitor.step(t - 10.0, row + 1.0)
    assert monitor.measures.tolist() == clean.tolist()


def test_garbage_leaves_finite_measures(calibration):
    monitor = Monitor(calibration)
    rng = np.random.default_rng(0)
    t = 0.0
    for _ in range(5000):
        t += rng.choice([1e-9, 1e-3, 10.0, -5.0])
        monitor.step(t, rng.choice([0.0, 1e300, -1e300, 1.0, math.nan], 6) * rng.normal(size=6))
    assert not np.isnan(monitor.measures).any()
    assert monitor.alarm in set(Alarm)


def test_a_step_allocates_nothing_that_stays(monitor, calibration):
    rows = samples_of(motion(7), calibration.signals)
    monitor.reset()
    t = 0.0

    def watch() -> None:
        nonlocal t
        for row in rows[:600]:
            t += 1 / 30
            monitor.step(t, row)

    assert least_memory([watch] * 5)[1] < 500


def test_what_it_cannot_work_with_is_refused(calibration):
    with pytest.raises(CalibrationError, match="no baseline of how efforts looked"):
        Monitor(replace(calibration, effort_baseline=None))
    with pytest.raises(CalibrationError, match="above 0 s"):
        Monitor(calibration, working_time=math.nan)
    with pytest.raises(CalibrationError, match="the 6 signals"):
        Monitor(calibration).step(0.0, [1.0, 2.0])
