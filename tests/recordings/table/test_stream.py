import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.recordings.refusals import refused

from truejoint.recordings import Stream, synchronise
from truejoint.recordings.table.stream import (
    AFTER,
    BACK,
    BEFORE,
    GAP,
    MISSING,
    direction,
    forward_rows,
    gaps,
    velocity,
)


def stream(t: np.ndarray, **columns: np.ndarray) -> Stream:
    return Stream(np.asarray(t, float), {n: np.asarray(v, float) for n, v in columns.items()})


@given(seed=st.integers(0, 2**32 - 1), limit=st.floats(0.02, 0.2))
def test_interpolates_but_never_across_a_gap(seed, limit):
    rng = np.random.default_rng(seed)
    t = np.arange(300) * 0.01
    u = np.cumsum(rng.exponential(0.05, 80))
    columns, dropped = synchronise(stream(t, a=-t), stream(u, x=u), gap_limit=limit)
    np.testing.assert_array_equal([columns["t"], columns["a"]], [t, -t])
    gaps = 0
    for stamp, value in zip(t, columns["x"], strict=True):
        if stamp in u:
            assert value == stamp
        elif stamp < u[0] or stamp > u[-1]:
            assert np.isnan(value)
        else:
            width = u[u > stamp][0] - u[u < stamp][-1]
            if width > limit:
                gaps += 1
                assert np.isnan(value)
            else:
                assert value == pytest.approx(stamp, abs=1e-12)
    counts = {BEFORE: (t < u[0]).sum(), AFTER: (t > u[-1]).sum(), GAP: gaps}
    assert dropped == {reason: count for reason, count in counts.items() if count}


def test_a_reading_at_the_very_stamp_counts_even_beside_a_gap():
    streams = stream([0.0, 1.0, 1.5, 2.0]), stream([0.0, 1.0, 2.0], x=[5.0, 6.0, 7.0])
    assert not synchronise(*streams, 1.0)[1]  # a limit is no gap
    columns, dropped = synchronise(*streams, 0.1)
    assert columns["x"].tolist()[:2] == [5.0, 6.0]
    assert np.isnan(columns["x"][2])
    assert columns["x"][3] == 7.0
    assert dropped == {GAP: 1}


def test_rows_that_cannot_be_used_are_counted():
    t = np.arange(40) * 0.1
    t[10] = 99.0  # a stray stamp ahead: only this row goes
    a = np.ones(40)
    a[20] = np.nan
    u = np.arange(400) * 0.01
    u[100] = u[99]
    x = u.copy()
    x[50] = np.nan
    columns, dropped = synchronise(stream(t, a=a), stream(u, x=x), 0.05)
    assert dropped == {f"{s}: {why}": 1 for s in ("state", "truth") for why in (BACK, MISSING)}
    assert len(columns["t"]) == 38
    assert np.allclose(columns["x"], columns["t"])
    _, dropped = synchronise(stream(np.array([0.0, 0.1, 0.2, 0.15])), stream(u, x=x), 0.05)
    assert dropped[f"state: {BACK}"] == 1  # of few rows one may be


def test_a_clock_that_is_set_back_for_good_is_refused():
    t = np.concatenate([np.arange(50) * 0.1, np.arange(50) * 0.1 - 3600])
    refused(
        r"state: the clock goes back at row 50",
        synchronise,
        stream(t),
        stream([0.0, 1.0], x=[0.0, 0.0]),
        1.0,
    )


@given(st.lists(st.floats(-10, 10) | st.just(np.nan), max_size=30))
def test_rows_kept_go_forward(values):
    t = np.array(values)
    keep = forward_rows(t)
    assert (np.diff(t[keep]) > 0).all()
    if np.isfinite(t).all() and (np.diff(t) > 0).all():
        assert keep.all()
    if np.isfinite(t).any():
        assert keep.any()


def test_angles_are_not_wrapped():
    columns, _ = synchronise(stream([0.5] * 1 + [0.75]), stream([0.0, 1.0], x=[3.1, -3.1]), 2.0)
    assert columns["x"] == pytest.approx([0.0, -1.55])


@pytest.mark.parametrize("limit", [0.0, -1.0, float("nan")])
def test_streams_need_a_gap_limit_rows_and_matching_columns(limit):
    refused("gap limit", synchronise, stream([0.0, 1.0]), stream([0.0, 1.0], x=[0.0, 0.0]), limit)
    refused("truth: 1 usable rows", synchronise, stream([0.0, 1.0]), stream([0.0], x=[0.0]), 1.0)
    refused(r"column 'x' has shape \(2,\)", stream, [0.0, 1.0, 2.0], x=[0.0, 0.0])


def test_velocity_of_a_ramp_is_its_slope_whatever_the_stamps():
    t = np.cumsum(np.random.default_rng(0).uniform(0.005, 0.02, 300))
    rate = velocity(t, np.column_stack((3.0 * t, -0.5 * t)))
    np.testing.assert_allclose(rate, np.tile([3.0, -0.5], (300, 1)), atol=1e-9)


def test_encoder_steps_do_not_show_as_changes_of_direction():
    t = np.arange(5000) / 1000
    position = np.floor(np.sin(0.5 * t) / 0.001) * 0.001
    rising = direction(t, position)[100:2900]
    assert (rising == 1).mean() > 0.99
    assert not (rising == -1).any()


def test_direction_tells_up_down_and_standing():
    t = np.arange(600) / 100
    position = np.concatenate((t[:200], np.full(200, t[199]), t[199] - t[:200]))
    way = direction(t, position)
    assert (way[20:180] == 1).all()
    assert (way[220:380] == 0).all()
    assert (way[420:580] == -1).all()
    assert not direction(np.arange(10.0), np.ones(10)).any()


def test_gaps_are_found_where_steps_are_long():
    t = np.delete(np.arange(100.0), [*range(30, 40), 70])
    np.testing.assert_array_equal(gaps(t), [29])


def test_slow_rates_use_neighbours():
    t = np.arange(10) * 0.5
    assert velocity(t, t**2)[4] == pytest.approx((t[5] ** 2 - t[3] ** 2) / (t[5] - t[3]))
