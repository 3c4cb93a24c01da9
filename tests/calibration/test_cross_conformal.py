"""Intervals of the recordings that are fitted to: what they are made of, and what they cover."""

from __future__ import annotations

import numpy as np
import pytest
from tests.calibration.test_choice import bent

from truejoint.calibration import (
    calibrate,
    cross_interval,
    measure_coverage,
    read_calibration,
    write_calibration,
)
from truejoint.calibration.conformal import conformal_threshold
from truejoint.errors import CalibrationError


def test_recordings_are_left_out_whole_and_the_width_is_that_of_their_errors():
    recordings = [bent(seed, 0.2) for seed in range(12)]
    model = cross_interval(recordings, "linear", growth=0.0)
    assert (model.interval.trajectories, model.interval.folds, model.interval.cut) == (12, 5, 0)
    assert model.interval.levels.tolist() == [0.8, 0.9]
    scores = []
    for i, recording in enumerate(recordings):
        fit = calibrate([r for k, r in enumerate(recordings) if k % 5 != i % 5], "linear")
        error = recording.columns("truth", ["jaw"]) - fit.correct(recording)
        scores.append(np.abs(error[:, 0]))
    expected = conformal_threshold(scores, 0.9)
    assert model.interval.half_width(0.9)[0] == pytest.approx(expected, rel=1e-12)
    plain = calibrate(recordings, "linear")
    np.testing.assert_array_equal(model.correct(recordings[0]), plain.correct(recordings[0]))
    assert "12 trajectories" in model.interval.meaning
    assert "5 fits" in model.interval.meaning


def test_one_recording_is_cut_into_parts():
    seen = []
    model = cross_interval(bent(0, 0.2), "linear", progress=seen.append)
    assert seen == sorted(seen)
    assert seen[-1] == pytest.approx(1.0)
    assert (model.interval.trajectories, model.interval.folds, model.interval.cut) == (15, 5, 1)
    assert "15 parts of its 1 recording:" in model.interval.meaning


def test_no_less_than_stated_is_covered_on_average():
    shares = []
    for draw in range(3):
        model = cross_interval([bent(100 * draw + k, 0.2) for k in range(10)], "poly2")
        unseen = [bent(100 * draw + k, 0.2) for k in range(50, 60)]
        shares.append(measure_coverage(model, unseen, 0.9).mean[0])
    assert 0.97 < np.mean(shares) < 1.0  # alike as they are: 90 % of 11 / 10


def test_it_survives_its_file_and_an_older_file_is_read(tmp_path):
    model = cross_interval([bent(seed, 0.2) for seed in range(3)], "linear", rezero=0.2)
    write_calibration(model, tmp_path / "m.safetensors")
    again = read_calibration(tmp_path / "m.safetensors").interval
    assert (again.folds, again.cut, again.rezero) == (5, 3, 0.2)
    assert again.meaning == model.interval.meaning


def test_what_is_chosen_is_chosen_once_and_kept():
    model = cross_interval([bent(seed, 0.2) for seed in range(3)], "linear", features="effort/jaw")
    assert model.feature_set.names == ("effort/jaw",)


@pytest.mark.parametrize(
    ("how", "said"),
    [({"levels": [0.999]}, "too few"), ({"growth": -1.0}, "growth"), ({"rezero": 99.0}, "99 s")],
)
def test_what_cannot_be_stated_is_refused(how, said):
    with pytest.raises(CalibrationError, match=said):
        cross_interval([bent(seed, 0.2) for seed in range(3)], "linear", **how)
