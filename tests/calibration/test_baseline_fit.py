"""Errors over time: how large, how alike, and how sure the beginning of a motion is."""

from dataclasses import replace

import numpy as np
import pytest

from truejoint.calibration import calibrate, find_zero
from truejoint.calibration.baseline_fit import (
    _root_mean_square,
    beginning_offsets,
    residual_statistics,
)
from truejoint.calibration.efforts import BEGINNINGS
from truejoint.calibration.rows import Rows
from truejoint.features import FeatureSet
from truejoint.recordings import Recording

FEATURES = ("measured/shoulder", "measured/elbow", "measured/insertion", "effort/elbow")


class Late:
    """Stands for a calibration that is off by 1 for as long as it runs, less by each second."""

    joints, gap_limit, looks_back = ("jaw",), 1.0, True

    def rows(self, recording: Recording | Rows) -> Rows:
        if isinstance(recording, Rows):
            return recording
        return Rows.of(recording, FeatureSet.parse(["measured/jaw"]), self.joints, self.gap_limit)

    def correct(self, recording: Recording | Rows) -> np.ndarray:
        rows = self.rows(recording)
        steps = np.diff(rows.t, prepend=-np.inf) > self.gap_limit
        starts = rows.t[steps][np.cumsum(steps) - 1]
        return rows.truth - self.off(rows.t - starts)[:, None]

    def off(self, since: np.ndarray) -> np.ndarray:
        return 1.0 / (1.0 + since)


class Forgetful(Late):
    """Stands for one that is off by 1 for a moment; it counts the rows that it runs over."""

    count = 0

    def off(self, since: np.ndarray) -> np.ndarray:
        self.count += len(since)
        return np.exp(-20.0 * since)


def test_beginnings_are_started_anew_and_as_long_as_they_say():
    t = np.arange(0.0, 30.0, 0.05)
    columns = {"t": t, "measured/jaw": t, "truth/jaw": np.sin(t)}
    recording = Recording.from_columns(columns, "davinci_grasper")
    late, step = Late(), np.array([0.01])
    found = beginning_offsets(late, late.rows(recording), late.correct(recording), 7, step)
    assert len(found) == 7
    long = np.array(BEGINNINGS)
    half = np.where(long < 5.0, long / np.sqrt(2.0), long / 2.0 + 1.25)  # of weights, 5 at most
    for each in found:
        np.testing.assert_allclose(each[:6, 0], 1.0 / (1.0 + half[:6]), rtol=0.06)
        assert np.isnan(each[6, 0])  # 20 s are more than half of it
    sd = residual_statistics(Late(), [recording], step)[2][:, 0]
    mean = np.mean(1.0 / (1.0 + t))
    assert sd[:6] == pytest.approx(np.abs(found[0][:6, 0] - mean), rel=0.05)
    assert sd[6] == sd[5]
    waits = recording.table.assign(**{"measured/jaw": np.where(t < 10.0, 0.0, t)})
    waiting = replace(recording, table=waits)
    rests = beginning_offsets(late, late.rows(waiting), late.correct(waiting), 1, step)[0][:, 0]
    assert rests[0] == pytest.approx(1.0 / 6.0, rel=0.01)  # all of ten seconds at rest
    assert np.isnan(rests[5:]).all()  # it is in motion for five


def test_what_is_forgotten_is_not_run_again(monkeypatch):
    t = np.arange(0.0, 30.0, 0.05)
    columns = {"t": t, "measured/jaw": t, "truth/jaw": np.sin(t)}
    recording, model = Recording.from_columns(columns, "davinci_grasper"), Forgetful()
    rows = model.rows(recording)
    corrected, step = model.correct(rows), np.array([0.01])

    def looked_at() -> tuple[np.ndarray, int]:
        model.count = 0
        offsets = beginning_offsets(model, rows, corrected, 7, step)
        return np.array(offsets), model.count

    found, count = looked_at()
    assert 200 < count <= 210  # seven times a tenth of half of the recording
    monkeypatch.setattr("truejoint.calibration.baseline_fit._AGREED", -1.0)  # nothing ever agrees
    whole, count = looked_at()
    assert 2200 < count <= 7 * (30 + 300)
    near = 0.01 * np.std(np.exp(-20.0 * t))
    assert (found[:, 0] > 0.3).all()
    np.testing.assert_allclose(found, whole, rtol=0.0, atol=near)
    model.looks_back = False
    assert looked_at()[1] == 0


@pytest.mark.parametrize("estimator", ["poly2", "linear", "rich_play"])
def test_a_beginning_tells_what_a_recording_tells_that_begins_there(build, estimator):
    """`find_zero` of the rows from there on, which knows nothing of those before."""
    filtered = "lowpass(effort/elbow, 0.2)"
    features = FEATURES if estimator == "poly2" else (*FEATURES, filtered)
    calibration = calibrate(build(1500, 0), estimator, features=features)
    assert calibration.looks_back == (estimator != "poly2")
    bare = replace(calibration, effort_baseline=None)  # a step of 0: all of time is in motion
    recording = build(900, 4)
    recording = replace(recording, table=recording.table.assign(t=1.0137 * recording.t))
    t, length = recording.t, recording.duration / 2.0
    found = beginning_offsets(bare, bare.rows(recording), bare.correct(recording), 3, np.zeros(3))
    for start, offsets in zip(np.linspace(t[0], t[-1] - length, 3), found, strict=True):
        piece = recording.rows((t >= start) & (t < start + length))
        for duration, offset in zip(BEGINNINGS[:6], offsets, strict=False):
            near = 0.02 * calibration.effort_baseline.residual.min()
            assert offset == pytest.approx(find_zero(bare, piece, duration).offset, abs=near)


def test_rows_so_far_apart_that_a_beginning_is_one_of_them_are_no_gaps(build):
    recording = build(400, 0)
    slow = replace(recording, table=recording.table.assign(t=30.0 * np.arange(400)))
    features = ["measured/elbow", "lowpass(measured/elbow, 60)"]
    calibration = calibrate(slow, "linear", features=features, joints=["elbow"])
    assert calibration.looks_back
    rows, step = calibration.rows(slow), calibration.effort_baseline.step
    corrected = calibration.correct(rows)
    assert len(beginning_offsets(calibration, rows, corrected, 24, step)) == 15
    assert beginning_offsets(calibration, rows, corrected, 1, step) == []  # one row is no recording


def test_a_beginning_that_shows_nothing_is_as_the_next_one_that_does():
    off = np.full((2, len(BEGINNINGS), 1), np.nan)
    off[:, 2], off[0, 3] = [[3.0], [-4.0]], 2.0
    found = _root_mean_square(off)[:, 0]
    np.testing.assert_allclose(found, [*3 * [np.sqrt(12.5)], 2.0, 2.0, 2.0, 2.0])
    both = np.concatenate([off, np.full_like(off, np.nan)], axis=2)
    both[:, 0, 1] = 5.0  # a joint that never was in motion
    np.testing.assert_allclose(_root_mean_square(both), np.column_stack([found, [5.0] * 7]))
    assert _root_mean_square(off[:0]).tolist() == [[0.0]] * len(BEGINNINGS)
