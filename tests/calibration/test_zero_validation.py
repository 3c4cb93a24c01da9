"""A zero for each recording, kept where re-zeroed recordings that no fit saw are better for it."""

from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd
import pytest
from tests.calibration.test_folds import jaw

from truejoint.calibration import (
    Automatic,
    calibrate,
    find_zero,
    read_calibration,
    write_calibration,
)
from truejoint.calibration.choose import validate_zeros
from truejoint.calibration.folds import FOLDS, Fold, Part
from truejoint.calibration.truth_zero import judged_error
from truejoint.errors import CalibrationError
from truejoint.estimators import get_estimator
from truejoint.recordings import Recording

START = 2.0  # [s] of truth


def loaded(seed: int, zero: float) -> Recording:
    """Jaw under a load of its own, whose truth is off by a zero that no signal tells."""
    rng = np.random.default_rng(seed)
    t = np.arange(600) / 30.0
    q = 0.4 * np.sin(rng.uniform(2.0, 3.0) * t + seed)
    effort = rng.normal() + 0.2 * np.cos(5.0 * t + seed)
    truth = 1.05 * q + 0.1 * effort + zero * rng.normal() + rng.normal(0.0, 1e-3, len(t))
    columns = {"t": t, "measured/jaw": q, "effort/jaw": effort, "truth/jaw": truth}
    return Recording.from_columns(columns, jaw(session=f"s{seed}").provenance)


def several(zero: float, count: int = 5) -> list[Recording]:
    return [loaded(seed, zero) for seed in range(count)]


LINEAR = Automatic([get_estimator("linear")])
calibrated = partial(calibrate, features=["measured/jaw", "effort/jaw"])


@pytest.fixture(scope="module")
def kept():
    return calibrated(several(0.3), LINEAR)


def rmse(model, recording: Recording, start: float) -> float:
    return float(np.sqrt(np.mean(judged_error(model, recording, start)[0] ** 2)))


def test_zeros_that_moved_are_fitted_beside_the_chosen_model(kept, tmp_path):
    told = kept.metadata["choice"]["zero"]
    assert told["kept"]
    assert told["rezeroed_from"] == pytest.approx(START, rel=0.01)
    assert told["left_out"] == [f"recordings {k}" for k in (1, 2, 3, 4, 5)]
    assert told["recording"]["jaw"] < 0.5 * told["shared"]["jaw"]
    test = loaded(9, 0.3)
    plain = calibrated(several(0.3), LINEAR, zero="shared")
    assert kept.correct(test).tobytes() == plain.correct(test).tobytes()
    assert "zero" not in plain.metadata["choice"]
    stated = calibrated(several(0.3), LINEAR, zero="recording")
    both = [one.at(find_zero(one, test, START)).correct(test) for one in (kept, stated)]
    assert both[0].tobytes() == both[1].tobytes()
    own = kept.for_rezeroing
    assert rmse(own, test, START) < 0.5 * rmse(plain, test, START)
    write_calibration(kept, tmp_path / "m.safetensors")
    read = read_calibration(tmp_path / "m.safetensors")
    again = read.at(find_zero(read, test, START))
    assert again.correct(test).tobytes() == both[0].tobytes()


def test_zeros_that_did_not_move_change_nothing():
    recordings = several(0.0)
    model, plain = calibrated(recordings, LINEAR), calibrated(recordings, LINEAR, zero="shared")
    assert not model.metadata["choice"]["zero"]["kept"]
    assert model.rezeroed_fit is None
    assert model.for_rezeroing is model
    test = loaded(9, 0.0)
    for start in (0.5, START):
        again = [one.at(find_zero(one, test, start)).correct(test) for one in (model, plain)]
        assert again[0].tobytes() == again[1].tobytes()


def test_two_recordings_do_not_tell_and_it_is_said():
    model = calibrated(several(0.3, 2), LINEAR)
    assert model.metadata["choice"]["zero"] == {"kept": False, "note": "it takes 3 recordings"}
    assert model.rezeroed_fit is None


def test_what_zeros_are_judged_by_knows_nothing_of_the_part_left_out(monkeypatch):
    """Not how large its errors are either, by which zeros are believed."""
    found = []

    def first_pair(recordings, left_out, fit, say):
        found.append(fit([0, 1, 2]))
        return False, {"kept": False}

    monkeypatch.setattr("truejoint.calibration.fit.validate_zeros", first_pair)
    recordings = several(0.0, 4)
    off = recordings[3].column("truth/jaw") + 0.02 * np.sin(0.4 * recordings[3].t)
    wandering = recordings[3].table.assign(**{"truth/jaw": off})
    for last in (recordings[3], replace(recordings[3], table=wandering)):
        assert calibrated([*recordings[:3], last], LINEAR).estimator == "linear"
    (one, _), (other, _) = found
    np.testing.assert_array_equal(one.model.coef_, other.model.coef_)
    for name in ("correlation", "beginning"):
        left, right = (getattr(model.effort_baseline, name) for model in (one, other))
        np.testing.assert_array_equal(left, right)


def test_a_recording_that_is_nearly_all_the_time_is_not_left_out_to_judge_zeros():
    long = loaded(7, 0.3)
    parts = [replace(long, table=long.table.assign(t=long.t + k * 20.0)) for k in range(20)]
    table = pd.concat([one.table for one in parts], ignore_index=True)
    told = calibrated([*several(0.3, 3), replace(long, table=table)], LINEAR).metadata["choice"]
    assert [name.split()[0] for name in told["left_out"]].count("time") == 5
    assert told["zero"]["left_out"] == [f"recordings {k}" for k in (1, 2, 3)]


def test_recordings_that_are_thinned_unlike_each_other_are_judged_all_the_same(monkeypatch):
    """Rows of the long one are further apart than gaps of the others."""
    monkeypatch.setattr("truejoint.calibration.fit.MOST_ROWS", 2400)
    one = loaded(7, 0.3)
    parts = [one.table.assign(t=one.t + k * 20.0) for k in range(20)]
    long = replace(one, table=pd.concat(parts, ignore_index=True))
    features = ["measured/jaw", "effort/jaw", "lowpass(effort/jaw, 0.5)"]
    model = calibrated([*several(0.3, 7), long, loaded(8, 0.3)], LINEAR, features=features)
    assert model.looks_back
    assert len(model.metadata["choice"]["zero"]["left_out"]) >= 3


def test_what_is_judged_is_the_rest_of_recordings_that_were_left_out(kept):
    recordings = several(0.3, 4)
    units = [Part(k, 0, len(one)) for k, one in enumerate(recordings)]
    left_out = [Fold("a", (units[0], units[2])), Fold("all but one", tuple(units[:3])),
                Fold("b", (units[1],)), Fold("cannot be fitted", (units[3],))]  # fmt: skip
    shared = replace(kept, origin=replace(kept.origin, zeros=None), rezeroed_fit=None)
    better = replace(shared, offsets={"model": np.array([0.01])})
    assert len(left_out) <= FOLDS
    seen: list[list[int]] = []

    def fit(indices):
        seen.append(list(indices))
        if 3 not in indices:
            raise CalibrationError("too few rows")
        return better, kept

    rows = [kept.rows(recording) for recording in recordings]
    is_kept, told = validate_zeros(rows, left_out, fit, lambda _what, _share: None)
    assert seen == [[1, 3], [0, 2, 3], [0, 1, 2]]
    assert told["left_out"] == ["a", "b"]
    for name, model in (("shared", better), ("recording", kept.for_rezeroing)):
        folds = []
        for out in ([0, 2], [1]):
            left = []
            for one in (recordings[i] for i in out):
                zero = find_zero(model, one, told["rezeroed_from"]).shift
                error = one.column("truth/jaw") - model.correct(one)[:, 0] - zero
                left.append(error[one.t - one.t[0] >= told["rezeroed_from"]])
            folds.append(np.mean(np.concatenate(left) ** 2))
        assert told[name]["jaw"] == pytest.approx(np.sqrt(np.mean(folds)), rel=1e-12)
    assert is_kept is told["kept"]


def test_zeros_that_are_no_better_are_given_up_after_three_parts(kept):
    recordings = several(0.3, 7)
    left_out = [Fold(str(k), (Part(k, 0, len(one)),)) for k, one in enumerate(recordings)]
    rows = [kept.rows(recording) for recording in recordings]
    offset, origin = kept.fitted_baselines["offset"], replace(kept.origin, zeros=None)
    worse = replace(kept, fitted=offset, origin=origin, rezeroed_fit=None)
    for pair, judged in (((kept, worse), "024"), ((worse, kept), "0246")):
        found, told = validate_zeros(rows, left_out, lambda _, p=pair: p, lambda *_: None)
        assert "".join(told["left_out"]) == judged
        assert found is (judged != "024")
        assert np.exp(np.mean(np.log(told["ratios"]))) == pytest.approx(told["ratio"])
