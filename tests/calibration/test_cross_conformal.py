"""Intervals of the recordings that are fitted to: what they are made of, and what they cover."""

from dataclasses import replace

import numpy as np
import pytest
from sklearn.neighbors import KNeighborsRegressor
from tests.calibration.test_choose import bent
from tests.calibration.test_conformal import homed as homed_as
from tests.calibration.test_folds import crossed, jaw
from tests.synthetic import build_recording

from truejoint.calibration import Calibration, calibrate, cross_interval, folds
from truejoint.calibration.conformal import conformal_threshold
from truejoint.calibration.interval import GROWTH
from truejoint.errors import CalibrationError
from truejoint.recordings import Recording


def unknowing(recordings: list[Recording]) -> list[list[Calibration]]:
    """Linear fits, for each recording those without it."""
    found = [[] for _ in recordings]
    for fold in folds.without_levels(recordings, folds.levels_by_quantity(recordings)):
        left = {part.recording for part in fold.parts}
        fit = calibrate([one for i, one in enumerate(recordings) if i not in left], "linear")
        for i in left:
            found[i].append(fit)
    return found


def widening(fit: Calibration, recording: Recording) -> np.ndarray:
    """How much wider an interval is outside the range of a fit (n,)."""
    return 1.0 + GROWTH * fit.range_excess(recording)


def inside(model, recordings):
    """Share of the samples that lie within the 90 % interval, mean over recordings."""
    shares = []
    for recording in recordings:
        _, lower, upper = model.correct_with_interval(recording)
        truth = recording.columns("truth", model.joints)
        shares.append(((lower <= truth) & (truth <= upper)).mean())
    return np.mean(shares)


@pytest.fixture(scope="module")
def ten() -> Calibration:
    return cross_interval([bent(seed, 0.2) for seed in range(10)], "poly2")


def test_recordings_are_left_out_whole_and_the_width_is_that_of_their_errors():
    recordings = [bent(seed, 0.2) for seed in range(10)]
    model = cross_interval(recordings, "linear")
    assert (model.interval.trajectories, model.interval.folds, model.interval.cut) == (10, 5, 0)
    assert model.interval.levels.tolist() == [0.8, 0.9]
    scores = []
    for one, fits in zip(recordings, unknowing(recordings), strict=True):
        left = [np.abs(one.error(["jaw"]) - fit.predict_error(one))[:, 0] for fit in fits]
        wider = [widening(fit, one) for fit in fits]
        scores.append(np.concatenate(left) / np.concatenate(wider))
    expected = conformal_threshold(scores, 0.9)
    assert model.interval.half_width(0.9)[0] == pytest.approx(expected, rel=1e-12)
    plain = calibrate(recordings, "linear")
    np.testing.assert_array_equal(model.correct(recordings[0]), plain.correct(recordings[0]))
    assert "10 trajectories" in model.interval.meaning
    assert "5 fits" in model.interval.meaning


def test_one_recording_is_cut_into_parts():
    seen = []
    model = cross_interval(bent(0, 0.2), "linear", progress=seen.append)
    assert seen == sorted(seen)
    assert seen[-1] == pytest.approx(1.0)
    assert (model.interval.trajectories, model.interval.folds, model.interval.cut) == (15, 5, 1)
    assert "15 parts of its 1 recording:" in model.interval.meaning
    assert "nor of another day" in model.interval.meaning


@pytest.mark.parametrize(("count", "each"), [(2, 8), (4, 5)])
def test_a_few_recordings_are_cut_and_left_out_whole(count, each):
    recordings = [bent(seed, 0.2) for seed in range(count)]
    model = cross_interval(recordings, "poly2")
    interval = model.interval
    assert (interval.trajectories, interval.folds) == (count * each, count)
    assert (interval.cut, interval.whole) == (count, count)
    scores, squares = [], []
    for one in recordings:
        fit = calibrate([other for other in recordings if other is not one], "poly2")
        error = (one.error(["jaw"]) - fit.predict_error(one))[:, 0]
        squares.append(error.var())
        score = np.abs(error) / widening(fit, one)
        scores += [score[part.first : part.end] for part in folds.blocks([one], each)]
    expected = conformal_threshold(scores, 0.9)
    assert interval.half_width(0.9)[0] == pytest.approx(expected, rel=1e-12)
    assert f"lie outside altogether in 1 of {count + 1} cases" in interval.meaning
    assert model.effort_baseline.residual[0] == pytest.approx(np.sqrt(np.mean(squares)), rel=1e-9)


def test_few_homings_are_left_out_whole():
    six = [bent(seed, 0.2) for seed in range(6)]
    homed = [homed_as(one, f"h{i % 3}") for i, one in enumerate(six)]
    interval = cross_interval(homed, "linear").interval
    assert (interval.trajectories, interval.folds, interval.cut, interval.whole) == (30, 3, 6, 3)
    assert not interval.any_homing
    assert "after the 3 homings of its 30 trajectories only" in interval.meaning
    assert "takes 9 homings for 90 %" in interval.meaning
    many = [homed_as(bent(seed, 0.2), f"h{seed}") for seed in range(10)]
    drawn = cross_interval(many, "linear").interval
    assert drawn.any_homing
    assert "after any homing (10 homings seen)" in drawn.meaning


def of_joints(moving: str, seed: int) -> Recording:
    """Two joints, of which one stands still unless it is named."""
    one = build_recording(400, seed)
    still = [name for name in ("shoulder", "elbow") if name not in moving]
    held = {f"{kind}/{name}": 0.1 for name in still for kind in ("measured", "truth")}
    return replace(one, table=one.table.assign(**held))


@pytest.mark.parametrize("moving", [("shoulder elbow",) * 3, ("shoulder", "shoulder", "elbow")])
def test_what_one_recording_alone_shows_is_not_left_out_whole(moving):
    recordings = [of_joints(names, seed) for seed, names in enumerate(moving)]
    how = {"features": ["measured/shoulder", "measured/elbow"], "joints": ["shoulder", "elbow"]}
    seen = []
    interval = cross_interval(recordings, "linear", progress=seen.append, **how).interval
    alone = "elbow" in moving
    assert (interval.folds, interval.whole) == ((5, 0) if alone else (3, 3))
    assert seen == sorted(seen)
    assert seen[-1] == pytest.approx(1.0)


def test_nor_is_what_is_nearly_all_the_time():
    lengths = [2000, 150, 150, 150, 150, 2000]  # the first and the last would be left out together
    recordings = [jaw(1.0 + 0.1 * k, n=n) for k, n in enumerate(lengths)]
    interval = cross_interval(recordings, "linear").interval
    assert (interval.folds, interval.cut, interval.whole) == (5, len(lengths), 0)


@pytest.mark.parametrize("count", [3, 5, 8])
def test_parts_of_few_recordings_cover_as_far_as_these_are_alike(count):
    """Recordings with errors of their own, each of a fit without it: exchangeable."""
    rng, each = np.random.default_rng(0), -(-15 // count)
    found = []
    for own in (0.0, 1.0, 5.0):  # deviation between recordings, in that within one
        shares = []
        for _ in range(200):
            means = own * rng.normal(size=(count + 1, 1))
            errors = np.abs(means + rng.normal(size=(count + 1, 90)))
            parts = [part for one in errors[:count] for part in np.array_split(one, each)]
            shares.append((errors[count] <= conformal_threshold(parts, 0.9)).mean())
        found.append((np.mean(shares), 3.0 * np.std(shares) / np.sqrt(len(shares))))
    for mean, error in found:
        assert count / (count + 1) - error < mean < 0.9 * 16 / 15 + error
    assert found[0][0] > max(0.9, found[2][0])  # of what each does by itself, less is promised


def test_no_less_than_stated_is_covered_on_average(ten):
    shares = []
    others = cross_interval([bent(100 + k, 0.2) for k in range(10)], "poly2")
    for draw, model in enumerate((ten, others)):
        unseen = [bent(100 * draw + k, 0.2) for k in range(50, 60)]
        shares.append(inside(model, unseen))
    assert 0.97 < np.mean(shares) < 1.0  # alike as they are: 90 % of 11 / 10


@pytest.mark.parametrize(
    ("how", "said"), [({"levels": [0.999]}, "too few"), ({"levels": []}, "give a level")]
)
def test_what_cannot_be_stated_is_refused(how, said):
    with pytest.raises(CalibrationError, match=said):
        cross_interval([bent(seed, 0.2) for seed in range(3)], "linear", **how)


def test_copies_are_no_further_trajectories(ten):
    recordings, once = [bent(seed, 0.2) for seed in range(10)], ten.interval
    again = cross_interval([*recordings, *recordings[:5]], "poly2").interval
    assert again.trajectories == once.trajectories == 10
    # A fit that is judged on a recording has not seen its copy either.
    np.testing.assert_array_equal(again.half_widths, once.half_widths)
    alone = cross_interval([recordings[0]] * 12, "linear").interval
    assert (alone.trajectories, alone.cut) == (15, 1)


OFFSETS = np.random.default_rng(5).normal(0.0, 0.01, 14)  # [rad], of loads: nobody can know them


def loaded(number: int, seed: int) -> Recording:
    """Jaw with the offset of its load, which its effort shows."""
    rng = np.random.default_rng(seed)
    one = jaw(1.0, 1.0, n=120, session=f"s{seed}")
    q = one.column("measured/jaw")
    effort = 5.0 + number + 0.1 * one.column("effort/jaw")
    truth = q + OFFSETS[number] + rng.normal(0.0, 1e-3, len(q))
    return replace(one, table=one.table.assign(**{"effort/jaw": effort, "truth/jaw": truth}))


@pytest.mark.parametrize(
    "estimator", ["linear", KNeighborsRegressor(1, algorithm="brute")], ids=str
)
def test_what_is_stated_holds_under_loads_that_were_never_seen(estimator):
    """Whether an estimator remembers loads or not: its errors under those left out say how far."""
    unseen = 2, 5, 8, 11
    training = [loaded(k, 20 * k + i) for k in range(14) for i in (0, 1) if k not in unseen]
    model = cross_interval(training, estimator)
    tests = [loaded(k, 300 + k) for k in unseen]
    errors = [one.error(["jaw"]) - model.predict_error(one) for one in tests]
    assert inside(model, tests) > 0.7
    half_widths = [model.half_widths(one).mean() for one in tests]
    assert np.mean(half_widths) < 3.0 * np.sqrt(np.mean(np.square(errors)))


@pytest.mark.parametrize("estimator", ["linear_trees", "gp"])
def test_what_few_recordings_state_holds_for_another(estimator):
    """Their loads are remembered: parts of recordings that a fit saw would show no error."""
    model = cross_interval([loaded(k, k) for k in (0, 3, 6, 9, 12)], estimator)
    assert inside(model, [loaded(k, 300 + k) for k in (1, 4, 7, 10, 13)]) > 0.6
    assert model.interval.half_width(0.9)[0] > 5e-3  # of offsets of 1e-2, noise of 1e-3


def test_a_level_never_seen_is_covered_as_theory_says_and_not_by_shuffled_folds():
    """Offsets of ten loads, remembered: the nearest load's is another draw (exchangeable)."""
    recordings = crossed([1.0, 1.0, 1.0], 2.0 ** np.arange(10))
    parts, load_of = folds.wholes(recordings), np.arange(30) % 10
    shuffled = (load_of + np.arange(30) // 10) % 5  # no fold has all recordings of a load
    plans = [
        folds.without_levels(recordings, folds.levels_by_quantity(recordings)),
        [folds.Fold("", tuple(parts[i] for i in np.flatnonzero(shuffled == k))) for k in range(5)],
    ]
    rng = np.random.default_rng(0)
    shares = np.empty((400, 2))
    for draw, number in np.ndindex(shares.shape):
        offsets = rng.normal(size=11)
        scores = []
        for fold in plans[number]:
            left = [part.recording for part in fold.parts]
            known = np.unique(np.delete(load_of, left))
            for one in load_of[left]:
                nearest = known[np.argmin(np.abs(known - one))]
                scores.append(np.abs([offsets[one] - offsets[nearest]]))
        new = abs(offsets[10] - offsets[9])
        shares[draw, number] = new <= conformal_threshold(scores, 0.9)
    # Of 31 weights 3.1 may lie above: 1 of what is to come, of 24 recordings of levels between.
    error = np.sqrt(0.12 * 0.88 / len(shares))
    assert 1.0 - 3.1 / 25 - 4 * error < shares[:, 0].mean() < 0.9 * 11 / 10
    assert shares[:, 1].mean() < 0.1  # what is remembered has no error
