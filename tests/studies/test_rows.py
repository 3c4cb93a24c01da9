"""Tidy rows of studies: chosen, told apart by quantiles, and shown."""

import math

from pandas import DataFrame, Series

from truejoint.studies.rows import frame_table, mean_text, notes_on, quantiles, select


def test_rows_are_chosen_by_value() -> None:
    rows = DataFrame({"method": list("abc"), "rms": [1.0, 2.0, 3.0]})
    assert select(rows, method=("a", "c")).rms.tolist() == [1.0, 3.0]


def test_quantiles_keep_the_order_of_the_rows() -> None:
    rows = DataFrame({"m": list("bba"), "rms": [1.0, 3.0, 5.0]})
    table = quantiles(rows, "m", "rms", {"top": 1.0})
    assert table.index.tolist() == ["b", "a"]
    assert table["top"].tolist() == [3.0, 5.0]


def test_a_mean_has_its_deviation_where_there_are_several() -> None:
    assert mean_text(Series([1.0, 2.0]), 1) == "1.5 ± 0.7"
    assert mean_text(Series([3.0]), 1) == "3.0"


def test_a_frame_becomes_a_table() -> None:
    frame = DataFrame({"rms": [1.0, math.nan], "worst": ["2.0 deg", ""]}, ["a", "b"])
    table = frame_table("RMS", frame.fillna(0.0), decimals=1)
    assert table.rows == (("a", "1.0", "2.0 deg"), ("b", "0.0", ""))


def test_notes_are_at_hand() -> None:
    assert notes_on("hung")[0].startswith("; IV hung still")
