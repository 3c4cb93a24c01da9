"""Intervals: what they are made of, what they cover, and what is refused."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from truejoint.calibration import Calibration, calibrate, needed_trajectories, with_interval
from truejoint.calibration.conformal import conformal_threshold, exchangeable_units, scores_of
from truejoint.calibration.interval import inverse_span, range_excesses
from truejoint.errors import CalibrationError
from truejoint.recordings import Recording

FEATURES = ("measured/shoulder", "measured/elbow", "measured/insertion", "effort/elbow")


@pytest.fixture(scope="module")
def calibration(recording) -> Calibration:
    return calibrate(recording, "linear", features=FEATURES)


@pytest.fixture(scope="module")
def motions(build) -> list[Recording]:
    return [build(200, seed, homing_id=f"h{seed}") for seed in range(10, 32)]


@pytest.fixture(scope="module")
def stated(calibration, motions) -> Calibration:
    return with_interval(calibration, motions)


@given(st.integers(1, 199))
def test_fewest_trajectories_reach_the_level_and_one_fewer_does_not(thousandths):
    level = Fraction(thousandths * 5, 1000)
    n = needed_trajectories(float(level))
    assert Fraction(n, n + 1) >= level
    assert n == 1 or Fraction(n - 1, n) < level


@pytest.mark.parametrize("level", [0.0, 1.0, -0.1, float("nan")])
def test_a_level_must_be_a_probability(level):
    with pytest.raises(CalibrationError, match="between 0 and 1"):
        needed_trajectories(level)


@settings(max_examples=50, deadline=None)
@given(st.integers(9, 30), st.integers(0, 10**6))
def test_threshold_is_the_smallest_score_that_leaves_no_more_than_a_tenth(n, seed):
    rng = np.random.default_rng(seed)
    scores = [np.round(rng.exponential(size=rng.integers(1, 40)), 2) for _ in range(n)]
    threshold = conformal_threshold(scores, 0.9)

    def weight_below(value: float) -> Fraction:
        return sum(Fraction(int((s <= value).sum()), len(s)) for s in scores) / (n + 1)

    assert weight_below(threshold) >= Fraction(9, 10)
    below = [v for s in scores for v in s if v < threshold]
    assert not below or weight_below(max(below)) < Fraction(9, 10)


def test_nine_trajectories_give_the_largest_score():
    scores = [np.array([1.0, float(k)]) for k in range(9)]
    assert conformal_threshold(scores, 0.9) == 8.0


def test_coverage_on_new_trajectories_is_as_stated_where_pooled_samples_fall_short():
    rng = np.random.default_rng(0)
    own, pooled = [], []
    for _ in range(1500):
        # Trajectories differ far more from each other than samples within one.
        groups = np.abs(rng.normal(size=(13, 1)) + 0.1 * rng.normal(size=(13, 40)))
        threshold = conformal_threshold(list(groups[:12]), 0.9)
        own.append((groups[12] <= threshold).mean())
        pooled.append((groups[12] <= np.quantile(groups[:12], 0.9)).mean())
    error = np.std(own) / np.sqrt(len(own))
    assert 0.9 - 3 * error < np.mean(own) < 0.9 + 2 / 13
    assert np.mean(pooled) < 0.9 - 3 * error


@settings(deadline=None)
@given(st.lists(st.floats(-50, 50), min_size=3, max_size=3))
def test_range_excess_is_the_largest_share_of_a_range_outside(row):
    lower, upper = np.array([-1.0, 2.0, 5.0]), np.array([1.0, 2.0, 9.0])
    out = np.empty(1)
    range_excesses(np.array([row]), lower, upper, inverse_span(lower, upper), out)
    # The second feature never changed in training: it has no range to be outside of.
    expected = max(0.0, abs(row[0]) / 2 - 0.5, (5 - row[2]) / 4, (row[2] - 9) / 4)
    assert out[0] == pytest.approx(expected, abs=1e-12)


def test_half_widths_are_thresholds_of_the_errors_of_each_trajectory(calibration, motions, stated):
    interval = stated.interval
    assert interval.levels.tolist() == [0.8, 0.9, 0.95]
    assert (interval.trajectories, interval.homings) == (22, 22)
    widening = [1.0 + interval.growth * calibration.range_excess(m) for m in motions]
    assert max(map(np.max, widening)) > 1.02
    for k, joint in enumerate(calibration.joints):
        truth = [m.column(f"truth/{joint}") for m in motions]
        corrected = [calibration.correct(m)[:, k] for m in motions]
        each = zip(truth, corrected, widening, strict=True)
        scores = [np.abs(t - c) / wider for t, c, wider in each]
        for row, level in enumerate(interval.levels):
            expected = conformal_threshold(scores, level)
            assert interval.half_widths[row, k] == pytest.approx(expected, rel=1e-12)


def test_interval_widens_outside_the_trained_range_by_its_rule(calibration, motions, stated):
    inside, outside = motions[0], motions[0]
    shift = 0.5 * (calibration.upper[0] - calibration.lower[0])
    highest = inside.column("measured/shoulder").max()
    table = outside.table.assign(**{
        "measured/shoulder": outside.column("measured/shoulder")
        + (calibration.upper[0] - highest) + shift
    })  # fmt: skip
    moved = Recording(table, outside.units, outside.provenance)
    width = stated.half_widths(moved) / stated.interval.half_width(0.9)
    top = int(np.argmax(moved.column("measured/shoulder")))
    assert width[top] == pytest.approx(1 + 2.0 * 0.5)
    assert stated.range_excess(moved)[top] == pytest.approx(0.5)
    corrected, lower, upper = stated.correct_with_interval(moved)
    assert (upper - lower) / 2 == pytest.approx(stated.half_widths(moved))
    assert (upper + lower) / 2 == pytest.approx(corrected)


def homed(recording: Recording, homing: str) -> Recording:
    return replace(recording, provenance=replace(recording.provenance, homing_id=homing))


def shifted(recording: Recording, offset: float) -> Recording:
    names = [c for c in recording.table if c.startswith("truth")]
    table = recording.table.assign(**{n: recording.table[n] + offset for n in names})
    return Recording(table, recording.units, recording.provenance)


def test_rezeroing_makes_the_interval_blind_to_the_offset_of_a_homing(calibration, motions):
    rng, motions = np.random.default_rng(1), motions[:12]
    apart = [shifted(motion, 0.5 * rng.choice([-1.0, 1.0])) for motion in motions]
    as_homed = with_interval(calibration, apart).interval
    zeroed = with_interval(calibration, apart, rezero=2.0).interval
    alike = [shifted(motion, 0.7) for motion in motions]  # of a small offset, less is believed
    same = with_interval(calibration, alike, rezero=2.0).interval
    assert zeroed.half_widths == pytest.approx(same.half_widths, rel=0.01)
    assert (as_homed.half_width(0.9) > 3 * zeroed.half_width(0.9)).all()
    assert "any homing (12 homings seen)" in as_homed.meaning
    assert "re-zeroing from 2 s of truth" in zeroed.meaning


def test_the_errors_are_those_of_what_will_be_believed_of_a_zero(calibration, motions):
    """Their size is known from the interval's own recordings, no longer from the training's."""
    small, motions = calibration.effort_baseline, motions[:10]
    sure = replace(calibration, effort_baseline=replace(small, residual=0.1 * small.residual))
    for one in (calibration, sure):
        stated = with_interval(one, motions, rezero=0.2)
        scores = [scores_of(stated, stated.rows(m), 0.2) for m in motions]
        for k, half_width in enumerate(stated.interval.half_width(0.9)):
            expected = conformal_threshold([own[k][np.isfinite(own[k])] for own in scores], 0.9)
            assert half_width == pytest.approx(expected, rel=1e-12)


def test_a_copy_is_no_further_trajectory(calibration, motions):
    once = with_interval(calibration, motions[:12]).interval
    again = [*motions[:12], motions[0], homed(motions[3], "again")]
    again = with_interval(calibration, again).interval
    assert again.trajectories == 12
    np.testing.assert_array_equal(again.half_widths, once.half_widths)


def test_recordings_of_one_homing_count_once_where_there_are_several(calibration, motions):
    names = ["a", "b", "a", "", "", "b"]
    six = [homed(motion, name) for motion, name in zip(motions, names, strict=False)]
    assert exchangeable_units(six) == [[0, 2], [1, 5], [3], [4]]
    assert exchangeable_units(six, per_homing=False) == [[i] for i in range(6)]
    one = [homed(motion, "a") for motion in motions]
    assert len(exchangeable_units(one)) == 22
    assert "nothing of another homing" in with_interval(calibration, one).interval.meaning
    twelve = [homed(motion, f"h{i % 3}") for i, motion in enumerate(motions[:12])]
    with pytest.raises(CalibrationError, match="3 calibration trajectories are too few for a 80 %"):
        with_interval(calibration, twelve)


def test_only_levels_with_enough_trajectories_are_stated(calibration, motions):
    stated = with_interval(calibration, motions[:9], levels=np.array([0.95, 0.9, 0.8]))
    assert stated.interval.levels.tolist() == [0.8, 0.9]
    with pytest.raises(CalibrationError, match=r"95 % interval was made of 9 .* at least 19"):
        stated.interval.half_width(0.95)
    with pytest.raises(CalibrationError, match="8 calibration trajectories are too few for a 90 %"):
        with_interval(calibration, motions[:8], levels=[0.9])


def test_the_recordings_of_the_fit_are_refused(calibration, recording, motions):
    assert calibration.origin.includes(recording)
    assert not calibration.origin.includes(motions[0])
    with pytest.raises(CalibrationError, match="synthetic-0 was used in the fit"):
        with_interval(calibration, [*motions, recording])


@pytest.mark.parametrize("how", [{"levels": []}, {"rezero": -1.0}, {"rezero": float("nan")}])
def test_what_no_interval_can_be_made_with_is_refused(calibration, motions, how):
    with pytest.raises(CalibrationError, match="give a level, and a time"):
        with_interval(calibration, motions, **how)


def test_without_an_interval_none_is_made_up(calibration, motions):
    with pytest.raises(CalibrationError, match="states no interval"):
        calibration.correct_with_interval(motions[0])
    assert calibration.baselines["linear"].interval is None


def test_single_readings_of_the_truth_make_no_interval(calibration, motions):
    brief = []
    for motion in motions[:9]:
        table = motion.table.copy()
        table.loc[1:, [name for name in table if name.startswith("truth/")]] = np.nan
        brief.append(replace(motion, table=table))
    with pytest.raises(CalibrationError, match="no recording has the truth of two rows"):
        with_interval(calibration, brief)
