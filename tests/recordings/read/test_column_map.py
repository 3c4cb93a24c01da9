from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from truejoint.errors import RecordingError
from truejoint.recordings import ColumnMap, read_column_map


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({}, "column map: 'columns' is missing"),
        ({"rate_hz": 5, "columns": {"t": 0}}, "gives 't' and rate_hz"),
        ({"columns": {"t": 0}, "colour": "red"}, "no key called 'colour'"),
        ({"columns": {"t": 0}, "delimiter": "ab"}, "delimiter is 'ab'"),
        ({"columns": {"t": 0}, "comment": "//"}, "comment is '//'"),
        ({"columns": {"t": 0}, "robot": 3}, "robot is 3"),
        ({"columns": {"t": True}}, "t.column is True; want a whole number from 0"),
        ({"columns": {"t": {"unit": "s"}}}, "'column' is missing"),
        ({"columns": {"t": {"column": 1.5}}}, "column is 1.5"),
        ({"columns": {"t": -1}}, "is -1; want a whole number from 0"),
        ({"columns": {"t": {"column": 0, "unit": "furlong"}}}, "unit is 'furlong'; want , s, ms"),
        ({"columns": {"t": {"column": 0, "scale": 0}}}, "want a number other than 0"),
        ({"columns": {"t": {"column": 0, "scale": float("nan")}}}, "scale is nan; want a number"),
        ({"columns": {"t": {"column": 0, "scale": "2"}}}, "scale is '2'"),
        ({"columns": {"t": {"column": 0, "gain": 2}}}, "no key called 'gain'"),
    ],
)
def test_a_map_that_breaks_a_rule_is_refused(values: dict[str, Any], message: str) -> None:
    with pytest.raises(RecordingError, match=message):
        read_column_map(values)


def test_a_map_that_is_one_passes() -> None:
    mapping = read_column_map({"columns": {"t": 0}})
    assert isinstance(mapping, ColumnMap)
    assert read_column_map(mapping) is mapping


@pytest.mark.parametrize("text", ["columns = ", "[columns]\nt = 0\n[columns]\n", "\x00"])
def test_a_file_that_is_no_toml_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "map.toml"
    path.write_text(text)
    with pytest.raises(RecordingError, match=r"map.toml: is not TOML") as caught:
        read_column_map(path)
    assert "\n" not in str(caught.value)


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="No such file"):
        read_column_map(tmp_path / "map.toml")
