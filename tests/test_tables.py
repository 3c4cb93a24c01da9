import math

import pandas as pd
import pytest

from truejoint.tables import (
    csv_text,
    decimals_for,
    fixed,
    percent_text,
    share_text,
    shown,
    spread_text,
)


@pytest.mark.parametrize(
    ("values", "decimals"),
    [([0.104, 2.1], 3), ([1.14, 10.2], 2), ([0.0647, 0.49], 3), ([0.0041], 4), ([120.0], 0)],
)
def test_the_smallest_value_sets_the_decimals(values: list[float], decimals: int) -> None:
    assert decimals_for(values) == decimals


def test_nothing_to_show_has_two_decimals() -> None:
    assert decimals_for([0.0, math.nan]) == 2


def test_numbers_side_by_side_share_their_decimals() -> None:
    assert shown([0.104, 1.93, math.nan]) == ["0.104", "1.930", "\N{EN DASH}"]


def test_minus_is_a_minus_and_never_stands_before_zero() -> None:
    assert fixed(-0.5, 1) == "\u22120.5"
    assert fixed(-0.0001, 2) == "0.00"


def test_percentages_beyond_sense_are_cut() -> None:
    assert percent_text(12.4) == "12 %"
    assert percent_text(3e5) == "> 9999 %"
    assert percent_text(math.nan) == "\N{EN DASH}"


def test_a_spread_too_small_for_its_decimals_is_not_shown_as_none() -> None:
    assert spread_text(0.0123, 3) == "± 0.012"
    assert spread_text(0.0004, 3) == "±<0.001"
    assert spread_text(0.0, 3) == "± 0.000"


def test_a_share_is_not_rounded_to_nothing_nor_to_all() -> None:
    assert [share_text(x) for x in (0.0, 0.004, 0.042, 0.53, 0.997, 1.0)] == [
        "0 %", "0.4 %", "4.2 %", "53 %", "99.7 %", "100 %",
    ]  # fmt: skip


def test_no_text_of_a_csv_is_a_formula_or_steers_a_terminal() -> None:
    frame = pd.DataFrame({"=a": ["=1", "+1", "-1", "@x", "a=1", "\x1b[31m"], "b": [-1.5] * 6})
    lines = csv_text(frame).splitlines()
    assert lines[0] == "'=a,b"
    assert [line.removesuffix(",-1.5") for line in lines[1:]] == [
        "'=1", "'+1", "'-1", "'@x", "a=1", "\\x1b[31m",
    ]  # fmt: skip
