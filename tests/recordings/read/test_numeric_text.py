from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from tests.recordings.refusals import refused

from truejoint.errors import RecordingError
from truejoint.recordings.bounded_file import Head
from truejoint.recordings.read.numeric_text import TextLayout, read_numbers, text_layout

finite = st.floats(allow_nan=False, allow_infinity=False)
tables = st.tuples(st.integers(1, 20), st.integers(1, 6)).flatmap(
    lambda shape: arrays(np.float64, shape, elements=finite)
)


def write(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


@given(table=tables, delimiter=st.sampled_from([",", ";", "\t", " "]), ended=st.booleans())
def test_numbers_come_back_to_the_last_bit(tmp_path, table, delimiter, ended):
    lines = [delimiter.join(repr(float(v)) for v in row) for row in table]
    text = "% a, comment; with\tdelimiters\n" + "\n".join(lines) + ("\n" if ended else "")
    path = write(tmp_path / "t.txt", text)
    layout = TextLayout(table.shape[1], delimiter, comment="%")
    order = list(range(table.shape[1]))[::-1]
    read = read_numbers(path, layout, order)
    assert np.array_equal(read.values, table[:, order])
    assert read.incomplete == 0


@given(text=st.text(alphabet="0123456789.,-+eEnaif \t\n\r%x\"'\0é", max_size=300))
def test_garbage_is_read_or_refused_in_one_line(tmp_path, text):
    path = tmp_path / "t.txt"
    path.write_text(text, encoding="utf-8")
    values, said = np.empty((1, 2)), str(path)
    try:
        values = read_numbers(path, TextLayout(3, comment="%"), (0, 1)).values
    except RecordingError as error:
        said = str(error)
    assert said.startswith(str(path))
    assert "\n" not in said
    assert values.shape[1] == 2
    assert len(values) > 0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1,2,3\n4,5\n6,7,8\n", "line 2 has 2 columns, expected 3"),
        ("1,2,3\n4,5,6,7\n6,7,8\n", "line 2 has 4 columns, expected 3"),
        ("1,2,3\n4,five,6\n6,7,8\n", "line 2, column 1 is 'five', not a number"),
        ("1,2,3\n4,12:30,6\n6,7,8\n", "column 1 is '12:30', not a number: write times in sec"),
        ("1,2,3\n4,5\n", "line 2 has 2 columns, expected 3"),
        ("1,2,3\n" * 700 + "1,2,3,4\n" + "1,2,3\n" * 300, "line 701 has 4 columns"),
        ("1,2,3\n1,2,3,4\n6,7,8\n9,", "line 2 has 4"),  # though the last is cut short
        ("1,2,3\n1,2\n6,7,8\n9,", "line 2 has 2"),
        ("# nothing\n", "holds no rows"),
    ],
)
def test_what_breaks_the_layout_is_named(tmp_path, text, message):
    path = write(tmp_path / "t.csv", text)
    assert str(path) in refused(message, read_numbers, path, TextLayout(3, comment="#"), (0, 1))


@pytest.mark.parametrize("tail", ["4,5", "4,5,", "4,", "4,1e"])
def test_a_last_line_cut_short_is_left_out_and_counted(tmp_path, tail):
    path = write(tmp_path / "t.csv", "1,2,3\n2,3,4\n" + tail)
    table = read_numbers(path, TextLayout(3), (0, 1))
    # "4,5," has three fields, the last one empty: it is cut short all the same
    assert np.array_equal(table.values, [[1, 2], [2, 3]])
    assert table.incomplete == 1


def test_only_named_columns_may_miss(tmp_path):
    path = write(tmp_path / "t.csv", "1,2,3\n2,,4\n")
    assert np.isnan(read_numbers(path, TextLayout(3), (0, 1)).values[1, 1])
    for last in ("", "OK", "nan"):  # of a column that nobody reads
        write(path, f"1,2,{last}\n3,4,{last}\n")
        assert np.array_equal(read_numbers(path, TextLayout(3), (0, 1)).values, [[1, 2], [3, 4]])


def test_the_line_of_a_fault_counts_from_the_start_of_the_file(tmp_path, monkeypatch):
    monkeypatch.setattr("truejoint.recordings.read.numeric_text._PIECE_BYTES", 10)
    rows = ["% a note", "t,a,b", *["1,2,3"] * 50]
    path = write(tmp_path / "t.csv", "\n".join(rows) + "\n")
    layout = TextLayout(3, comment="%", skip=2)
    assert len(read_numbers(path, layout, (0,)).values) == 50
    rows[40] = "1,2,x"
    write(path, "\n".join(rows) + "\n")
    refused("line 41, column 2 is 'x'", read_numbers, path, layout, (0, 2))


def test_a_delimiter_within_quotes_parts_nothing(tmp_path):
    path = write(tmp_path / "t.csv", '"t [s]";"angle, deg; motor";x\n0;1;"a;b"\n2;3;c\n')
    layout, fields, _ = text_layout(Head.of(path))
    assert (layout.delimiter, fields) == (";", ["t [s]", "angle, deg; motor", "x"])
    assert np.array_equal(read_numbers(path, layout, (0, 1)).values, [[0, 1], [2, 3]])


def test_unusual_but_right_numbers_are_read(tmp_path):
    path = write(tmp_path / "t.csv", '"1","2.5"\r\n+3, 4 \r\n\f5,1e999 # note\r\n')
    values = read_numbers(path, TextLayout(2, comment="#"), (0, 1)).values
    assert np.array_equal(values, [[1, 2.5], [3, 4], [5, np.inf]])


def test_a_form_feed_in_a_comment_is_no_line_end(tmp_path):
    path = write(tmp_path / "t.csv", "# page\fbreak\x1c\nt,a\n1,2\n3,4\n")
    number, header = Head.of(path).first_line("#")
    assert (number, header) == (2, "t,a")
    table = read_numbers(path, TextLayout(2, comment="#", skip=number), (0, 1))
    assert np.array_equal(table.values, [[1, 2], [3, 4]])
    refused("not a text file", Head(path, b"\x00\x01\x02").first_line)


def test_more_than_is_kept_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("truejoint.recordings.read.numeric_text.MAX_VALUES", 30)
    path = write(tmp_path / "t.csv", "1,2,3\n" * 11)
    refused("more than 10 rows of 3 columns", read_numbers, path, TextLayout(3), (0, 1, 2))
