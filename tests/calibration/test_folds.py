"""What a fit does not see: whole recordings, parts with a gap, never single rows."""

import itertools

import numpy as np
import pytest
from tests.synthetic import build_recording

from truejoint.calibration import folds
from truejoint.calibration.rows import Rows
from truejoint.errors import CalibrationError
from truejoint.features import FeatureSet
from truejoint.recordings import Recording


def jaw(speed: float = 1.0, effort: float = 1.0, n: int = 300, **origin) -> Recording:
    t = np.arange(n) / 30.0
    q = 0.3 * np.sin(speed * t)
    columns = {"t": t, "measured/jaw": q, "effort/jaw": effort * np.cos(speed * t)}
    columns["truth/jaw"] = q + 0.01
    about = folds.replace(build_recording(2).provenance, robot="davinci_grasper", arm="", **origin)
    return Recording.from_columns(columns, about)


def rows_of(recording: Recording) -> Rows:
    return Rows.of(recording, FeatureSet.parse(["measured/jaw"]), ("jaw",), 1.0)


def test_one_recording_is_left_out_a_fifth_at_a_time_and_with_a_gap():
    recording = jaw()
    found = folds.folds([recording])
    assert [fold.name for fold in found] == [f"time {k}" for k in range(1, 6)]
    edges = [(fold.parts[0].first, fold.parts[0].end) for fold in found]
    assert [end for _, end in edges] == [first for first, _ in edges[1:]] + [len(recording)]
    assert edges[0][0] == 0
    (kept,) = folds.without([rows_of(recording)], found[2].parts)
    hidden = ~kept.known
    part = found[2].parts[0]
    assert hidden[part.first : part.end].all()
    assert hidden.sum() == pytest.approx(1.2 * (part.end - part.first), abs=3)
    np.testing.assert_array_equal(kept.measured[:, 0], recording.column("measured/jaw"))


def test_no_part_of_one_recording_is_of_a_joint_at_rest():
    recording = jaw(n=600)
    q = np.where(recording.t < 10.0, 0.0, 0.3 * np.sin(recording.t - 10.0))
    table = recording.table.assign(**{"measured/jaw": q, "truth/jaw": q})
    parts = [fold.parts[0] for fold in folds.folds([folds.replace(recording, table=table)])]
    assert (parts[0].first, parts[-1].end) == (0, 600)
    assert all(one.end == other.first for one, other in itertools.pairwise(parts))
    starts = [part.first for part in parts[1:]]
    np.testing.assert_allclose(starts, [360, 420, 480, 540], atol=15)


def test_a_joint_that_jumps_once_is_cut_by_time():
    still = jaw(n=300)
    q = (still.t > 5.0) * 0.1
    table = still.table.assign(**{"measured/jaw": q, "truth/jaw": q})
    parts = [fold.parts[0] for fold in folds.folds([folds.replace(still, table=table)])]
    assert [part.first for part in parts] == [0, 60, 120, 180, 240]


def test_recordings_are_left_out_whole():
    recordings = [jaw() for _ in range(7)]
    found = folds.folds(recordings)
    assert [[part.recording for part in fold.parts] for fold in found] == [
        [0, 5], [1, 6], [2], [3], [4]
    ]  # fmt: skip
    assert len(folds.without([rows_of(one) for one in recordings], found[0].parts)) == 5


@pytest.mark.parametrize(("n", "whole"), [(300, [0, 1]), (90, [0, 1]), (60, [1])])
def test_of_two_recordings_one_is_left_out_whole_where_enough_stays(n, whole):
    """A fit to a minute shows nothing of one to half an hour."""
    found = folds.folds([jaw(), jaw(n=n)])
    assert [[part.recording for part in fold.parts] for fold in found] == [
        *[[0, 1]] * 5, *[[k] for k in whole]
    ]  # fmt: skip


@pytest.mark.parametrize("count", [3, 11])
def test_of_several_recordings_one_that_is_nearly_all_the_time_loses_fifths(count):
    """Without it, so little stays that nothing is shown of what is used."""
    lengths = [60] * count
    lengths[1] = 300 * (count - 1)
    recordings = [jaw(1.0 + k, 1.0 + k, n) for k, n in enumerate(lengths)]
    found = folds.folds(recordings)
    cut = [fold.parts for fold in found if fold.name.startswith("time")]
    assert [len(parts) for parts in cut] == [1] * 5
    edges = [(part.first, part.end) for (part,) in cut]
    assert [end for _, end in edges] == [first for first, _ in edges[1:]] + [lengths[1]]
    assert edges[0][0] == 0
    assert {part.recording for (part,) in cut} == {1}
    others = [fold for fold in found if not fold.name.startswith("time")]
    whole = [part for fold in others for part in fold.parts]
    assert {part.recording for part in whole} == {*range(count)} - {1}
    assert set(whole) <= set(folds.wholes(recordings))
    kinds = {"recordings"} if count < folds.SORTED_FROM else {"speed", "effort"}
    assert {fold.name.split()[0] for fold in others} == kinds


def test_many_recordings_are_left_out_by_speed_and_by_effort():
    rng = np.random.default_rng(0)
    speeds, efforts = rng.permutation(10), rng.permutation(10)
    recordings = [jaw(1.0 + s, 1.0 + e) for s, e in zip(speeds, efforts, strict=True)]
    found = {fold.name: {part.recording for part in fold.parts} for fold in folds.folds(recordings)}
    assert len(found) == 10
    assert {speeds[i] for i in found["speed 1"]} == {0, 1}
    assert {speeds[i] for i in found["speed 5"]} == {8, 9}
    assert {efforts[i] for i in found["effort 5"]} == {8, 9}


def test_what_works_under_one_load_is_left_out_together():
    """Else what is judged under a load would have been fitted to the same load."""
    loads = np.repeat([1.0, 2.0, 4.0], 5)
    recordings = [jaw(1.0, load + 0.02 * k) for k, load in enumerate(loads)]
    found = [fold for fold in folds.folds(recordings) if fold.name.startswith("effort")]
    assert [{loads[part.recording] for part in fold.parts} for fold in found] == [{1}, {2}, {4}]


def test_stated_homings_and_loads_are_left_out():
    recordings = [
        jaw(homing_id=h, load=load)
        for h, load in [("a", 0.0), ("a", 0.5), ("b", 0.0), ("b", 0.5), ("", 0.0)]
    ]
    found = {fold.name: [part.recording for part in fold.parts] for fold in folds.folds(recordings)}
    assert found == {
        "homing 1": [0, 1], "homing 2": [2, 3], "load 1": [0, 2, 4], "load 2": [1, 3]
    }  # fmt: skip


def test_too_few_rows_to_cut_are_refused():
    with pytest.raises(CalibrationError, match="synthetic-0: 40 rows are too few"):
        folds.folds([jaw(n=40)])


def crossed(speeds, loads) -> list[Recording]:
    """A recording of every speed under every load."""
    return [jaw(speed, load * (1.0 + 0.01 * speed)) for speed in speeds for load in loads]


def test_a_fit_does_without_the_level_of_what_it_is_judged_on():
    recordings = crossed([1.0, 2.0, 3.0, 4.0], [1.0, 2.0, 4.0, 8.0, 16.0, 32.0])
    kinds = folds.levels_by_quantity(recordings)
    assert [len(groups) for groups in kinds] == [4, 6]
    left_out = [{p.recording for p in f.parts} for f in folds.without_levels(recordings, kinds)]
    assert len(left_out) == 5
    assert max(map(len, left_out)) <= 8
    every = set(range(24))
    for index, (speed, load) in enumerate(itertools.product(range(4), range(6))):
        own = [every - left for left in left_out if index in left]  # what the fits see
        between = (0 < speed < 3) + (0 < load < 5)
        assert len(own) == max(between, 1)
        if 0 < speed < 3:
            assert any(all(i // 6 != speed for i in seen) for seen in own)
        if 0 < load < 5:
            assert any(all(i % 6 != load for i in seen) for seen in own)
        if between == 0:  # no fit is asked for what lies beyond all that it saw
            assert any(i // 6 == speed for i in own[0])
            assert any(i % 6 == load for i in own[0])


def test_what_comes_in_no_levels_is_cut_into_runs_and_what_hardly_differs_is_no_condition():
    assert folds.levels_by_quantity([jaw(1.0 + 0.002 * k) for k in range(16)]) == []
    order = np.random.default_rng(1).permutation(16)
    (speeds,) = folds.levels_by_quantity([jaw(2.0 + 0.1 * k, n=900) for k in order])
    assert [order[own].tolist() for own in speeds] == [[k, k + 1] for k in range(0, 16, 2)]


def test_speeds_and_efforts_that_hardly_differ_are_no_condition_in_levels_either():
    recordings = [jaw(2.0, 1.0 + 0.02 * (k % 3) + 1e-4 * k, n=900) for k in range(12)]
    assert folds.levels_by_quantity(recordings) == []


def test_of_three_conditions_no_fit_knows_the_ends_alone():
    places = np.arange(64)
    digits = [places // base % 4 for base in (1, 4, 16)]
    kinds = [[np.flatnonzero(own == level) for level in range(4)] for own in digits]
    left_out = [
        {part.recording for part in fold.parts}
        for fold in folds.without_levels([jaw(n=10)] * 64, kinds)
    ]
    assert len(left_out) == 6
    for left in left_out:
        seen = np.setdiff1d(places, list(left))
        assert all(len(np.unique(own[seen])) >= 3 for own in digits)


def test_a_stated_mass_is_a_condition_and_one_that_parts_alike_is_none():
    recordings = [jaw(1.0, 1.0 + k % 3, load=0.1 * (k % 3)) for k in range(12)]
    (loads,) = folds.levels_by_quantity(recordings)
    assert [own.tolist() for own in loads] == [[0, 3, 6, 9], [1, 4, 7, 10], [2, 5, 8, 11]]
    nameless = [jaw(load=0.1 * (k % 3)) for k in range(11)] + [jaw()]
    assert folds.levels_by_quantity(nameless) == []
