"""Columns that take messages as they come in."""

from __future__ import annotations

import numpy as np
import pytest

from truejoint.errors import RecordingError
from truejoint.recordings.read.bags import fields
from truejoint.recordings.read.bags.fields import Series


def test_lots_become_columns() -> None:
    taken, random = Series(), np.random.default_rng(0)
    values = random.random(10)
    for rows in (slice(2), slice(2, 3), slice(3, 10)):
        place = np.arange(10)[rows]
        columns = {"a": values[rows]} | ({"b": -values[rows]} if rows.start else {})
        taken.add(place, 5 + place, columns)
    assert taken.count == 10
    assert taken.start == 5
    stamps, columns = taken.joined()
    np.testing.assert_array_equal(stamps, 5 + np.arange(10))
    np.testing.assert_array_equal(columns["a"], values)
    np.testing.assert_array_equal(columns["b"], [np.nan, np.nan, *-values[2:]])
    assert taken.joined()[1] == {}  # nothing is held twice


def test_a_column_that_is_missing_in_a_lot_has_no_value_there() -> None:
    taken = Series()
    taken.add(np.array([0]), np.array([1]), {"a": np.array([1.0]), "b": np.array([2.0])})
    taken.add(np.array([1]), np.array([2]), {"b": np.array([3.0])})
    np.testing.assert_array_equal(taken.joined()[1]["a"], [1.0, np.nan])


def test_lots_of_other_layouts_are_put_in_order() -> None:
    taken = Series()
    taken.add(np.array([0, 2]), np.array([10, 12]), {"a": np.array([0.0, 2.0])})
    taken.add(np.array([1, 3]), np.array([11, 13]), {"a": np.array([1.0, 3.0])})
    stamps, columns = taken.joined()
    assert stamps.tolist() == [10, 11, 12, 13]
    assert columns["a"].tolist() == [0.0, 1.0, 2.0, 3.0]


def test_too_many_values_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fields, "MAX_VALUES", 5)
    taken = Series()
    taken.add(np.arange(2), np.arange(2), {"a": np.zeros(2)})
    with pytest.raises(RecordingError, match="more than 5 values; extract fewer bags"):
        taken.add(np.array([2]), np.array([2]), {"a": np.zeros(1)})
