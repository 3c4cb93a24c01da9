import base64
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from truejoint.evaluation.report import figures


@given(st.lists(st.floats(width=32, allow_nan=False), min_size=1, max_size=50))
def test_packed_numbers_come_back(values):
    spec = figures.packed(np.array(values))
    back = np.frombuffer(base64.b64decode(spec["bdata"]), dtype="<f4")
    np.testing.assert_array_equal(back, np.array(values, dtype="f4"))


@given(st.integers(1, 500), st.integers(1, 40), st.integers(0, 99))
def test_thinning_keeps_every_peak_and_both_ends(n, buckets, seed):
    values = np.random.default_rng(seed).normal(size=n)
    keep = figures.extreme_rows(values, buckets)
    assert len(keep) <= max(2 * buckets + 2, 2)
    assert (np.diff(keep) > 0).all()
    assert {0, n - 1, int(np.argmax(values)), int(np.argmin(values))} <= set(keep.tolist())


def test_a_gap_breaks_the_curve():
    t = np.concatenate((np.arange(100.0), np.arange(300.0, 400.0)))
    thin_t, thin = figures.thinned(t, np.sin(t), 30)
    (broken,) = np.flatnonzero(np.isnan(thin))
    assert thin_t[broken - 1] <= 99
    assert thin_t[broken + 1] >= 300
    assert not np.isnan(thin_t).any()


def test_panels_fill_the_width_without_touching():
    layout = figures.side_by_side([({}, {}, [])] * 3, 100, gap=0.05)["layout"]
    domains = [layout[f"xaxis{number}"]["domain"] for number in ("", 2, 3)]
    assert domains[0][0] == 0.0
    assert domains[2][1] == pytest.approx(1.0)
    assert domains[1][0] - domains[0][1] == pytest.approx(0.05)


def test_titles_cannot_carry_markup_or_steer_a_screen():
    assert figures.plain("<a href='x'>&") == "&lt;a href='x'&gt;&amp;"
    assert figures.plain("\x1b\u2028\U0001f600") == "\\x1b\\u2028\U0001f600"
    assert figures.curve([0.0], [0.0], "\x1b<", "red")["name"] == "\\x1b&lt;"
    assert figures.axis("\x1b<")["title"]["text"] == "\\x1b&lt;"


def test_rows_are_spread_evenly():
    np.testing.assert_array_equal(figures.every(5, 10), np.arange(5))
    assert list(figures.every(1000, 5)) == [0, 250, 500, 749, 999]


def test_binned_quantiles_agree_with_a_loop():
    random = np.random.default_rng(3)
    x, y = random.uniform(0, 24, 2000), random.normal(size=2000)
    x[:2] = [0.0, 24.0]
    centre, low, middle, high = figures.binned(x, y)
    for c, a, b, d in zip(centre, low, middle, high, strict=True):
        first = math.floor(c)
        rows = (x >= first) & ((x < first + 1) | (first == 23))
        np.testing.assert_allclose([a, b, d], np.quantile(y[rows], [0.05, 0.5, 0.95]))


def test_bins_with_few_rows_are_left_out():
    x = np.concatenate((np.zeros(20), [10.0]))
    centre, *_ = figures.binned(x, np.arange(21.0))
    assert len(centre) == 1
