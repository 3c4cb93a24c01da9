import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from tests.recordings.refusals import refused

from truejoint.errors import RobotError
from truejoint.files import content_hash
from truejoint.recordings import Provenance, Recording, read_parquet, read_recording, write_parquet
from truejoint.recordings.table.parquet import KEY, VERSION
from truejoint.robots import get_robot

values = st.floats(allow_nan=False, allow_infinity=False)


@settings(max_examples=30)
@given(
    data=st.data(),
    rows=st.integers(2, 30),
    notes=st.text(max_size=30),
    load=st.floats(0, 10) | st.just(float("nan")),
    dropped=st.dictionaries(st.text(max_size=10), st.integers(0, 10**9), max_size=3),
)
def test_round_trip_is_exact(tmp_path, data, rows, notes, load, dropped):
    columns = {
        "t": np.sort(data.draw(arrays(float, rows, elements=values, unique=True))),
        "measured/joint1": data.draw(arrays(float, rows, elements=values)),
        "truth/joint1": data.draw(arrays(float, rows, elements=values | st.just(np.nan))),
        "odd name, with 'quotes'/é": data.draw(arrays(float, rows, elements=values)),
    }
    provenance = Provenance("bros", source="x", notes=notes, load=load, dropped=dropped)
    before = Recording.from_columns(columns, provenance, {"odd name, with 'quotes'/é": "Nm"})
    path = tmp_path / "a.parquet"
    write_parquet(before, path, overwrite=True)
    after = read_parquet(path)
    for name in before.table.columns:
        assert np.array_equal(before.column(name), after.column(name), equal_nan=True)
    assert list(after.table.columns) == list(before.table.columns)
    assert after.units == before.units
    assert after.provenance.to_dict() == before.provenance.to_dict()


def test_units_of_columns_that_are_not_there_are_not_written(tmp_path):
    t = np.arange(3.0)
    units = {"measured/joint1": "rad", "truth/joint1": "rad"}
    recording = Recording.from_columns({"t": t, "measured/joint1": t}, Provenance("bros"), units)
    write_parquet(recording, tmp_path / "a.parquet")
    assert read_parquet(tmp_path / "a.parquet").units == {"measured/joint1": "rad"}


def test_a_file_that_is_there_is_not_replaced(recording, tmp_path):
    path = tmp_path / "a.parquet"
    write_parquet(recording, path)
    shorter = recording.rows(slice(10))
    refused(r"a.parquet: exists already", write_parquet, shorter, path)
    assert len(read_parquet(path)) == len(recording)
    write_parquet(shorter, path, overwrite=True)
    assert len(read_parquet(path)) == 10


def test_a_value_edited_by_another_program_is_refused(recording, tmp_path):
    path = tmp_path / "a.parquet"
    write_parquet(recording, path)
    table = pq.read_table(path)
    pq.write_table(table, path, compression="gzip")  # the same, packed in another way
    assert len(read_parquet(path)) == len(recording)
    column = table.column("motor/joint1").to_numpy().copy()
    column[7] += 1e-12
    place = table.column_names.index("motor/joint1")
    pq.write_table(table.set_column(place, "motor/joint1", pa.array(column)), path)
    refused("does not match its hash", read_parquet, path)


def test_short_memory_is_called_that(recording, tmp_path, monkeypatch):
    def refuse(*_: object, **__: object) -> None:
        raise pa.ArrowMemoryError("malloc of size 1 failed")

    write_parquet(recording, tmp_path / "a.parquet")
    monkeypatch.setattr(pq.ParquetFile, "read", refuse)
    refused("takes more memory than there is", read_parquet, tmp_path / "a.parquet")


def rewrite(path: Path, header: object = None, **columns: pa.Array) -> None:
    table = pa.table(columns)
    if isinstance(header, dict):
        numbers = {name: np.asarray(values) for name, values in columns.items()}
        header = header | {"sha256": content_hash(header, numbers)}
    if header is not None:
        text = header if isinstance(header, str) else json.dumps(header)
        table = table.replace_schema_metadata({KEY: text})
    pq.write_table(table, path)


GOOD = {
    "version": VERSION,
    "units": {"measured/joint1": "rad"},
    "provenance": {"robot": "bros"},
    "robot": get_robot("bros").to_dict(),
}
T = pa.array([0.0, 1.0])


@pytest.mark.parametrize(
    ("header", "message", "columns"),
    [
        (json.dumps(GOOD), "does not match its hash", {}),
        (json.dumps(GOOD), "not float64", {"measured/joint1": pa.array(["a", "b"])}),
        (GOOD, "row 1 goes back", {"t": pa.array([1.0, 0.0])}),
        (None, "is no recording of truejoint", {}),
        ("{", "metadata is damaged", {}),
        ([1], "metadata is damaged", {}),
        (GOOD | {"version": "1"}, "metadata is damaged", {}),
        (GOOD | {"version": 1}, "is of version 1, this truejoint reads 2", {}),
        (GOOD | {"version": 99}, "is of version 99", {}),
        (GOOD | {"units": {}}, "metadata is damaged", {}),
        (GOOD | {"units": {"measured/joint1": 3}}, "metadata is damaged", {}),
        (GOOD | {"provenance": {"robot": "bros", "new": 1}}, "no key called 'new'", {}),
    ],
)
def test_a_file_that_is_not_ours_is_refused(tmp_path, header, message, columns):
    path = tmp_path / "a.parquet"
    rewrite(path, header, **{"t": T, "measured/joint1": T, **columns})
    text = refused(message, read_parquet, path)
    assert text.startswith(str(path))


def test_more_values_than_are_read_are_refused(recording, tmp_path, monkeypatch):
    path = tmp_path / "a.parquet"
    write_parquet(recording, path)
    monkeypatch.setattr("truejoint.recordings.table.parquet.MAX_VALUES", 100)
    refused("50 rows of 5 columns", read_parquet, path)


TOOL = """
name = "parquet_tool"
joints = [{ name = "jaw", upper = 1.0 }]
"""


def test_a_robot_of_a_file_comes_with_the_recording(tmp_path):
    (tmp_path / "tool.toml").write_text(TOOL)
    (tmp_path / "run.csv").write_text("t,measured/jaw\n0,0.1\n1,0.2\n")
    (tmp_path / "map.toml").write_text(
        'robot = "tool.toml"\ncolumns = { t = "t", "measured/jaw" = "measured/jaw" }\n'
    )
    recording = read_recording(tmp_path / "run.csv", column_map=tmp_path / "map.toml")
    write_parquet(recording, tmp_path / "run.parquet")
    again = read_parquet(tmp_path / "run.parquet")
    assert again.robot.joint("jaw").upper == 1.0
    (tmp_path / "tool.toml").write_text(TOOL.replace("1.0", "2.0"))
    assert get_robot(tmp_path / "tool.toml").joint("jaw").upper == 2.0
    assert read_parquet(tmp_path / "run.parquet").robot.joint("jaw").upper == 1.0
    with pytest.raises(RobotError, match="no robot called 'parquet_tool'"):
        get_robot("parquet_tool")


@pytest.mark.parametrize("robot", [{"name": "parquet_tool"}, 3, []])
def test_a_damaged_robot_is_refused_in_one_line(tmp_path, recording, robot):
    path = tmp_path / "a.parquet"
    write_parquet(recording, path)
    table = pq.read_table(path)
    header = json.loads(table.schema.metadata[KEY]) | {"robot": robot}
    del header["sha256"]
    rewrite(path, header, **{name: table[name] for name in table.column_names})
    message = refused(f"^{path}: ", read_parquet, path)
    assert message.count(path.name) == 1


def test_a_header_without_units_describes_stamps_alone(tmp_path):
    path = tmp_path / "stamps.parquet"
    write_parquet(Recording.from_columns({"t": [0.0, 1.0]}, "bros"), path)
    header = json.loads(pq.read_schema(path).metadata[KEY])
    del header["units"], header["sha256"]
    rewrite(path, header, t=T)
    assert not read_parquet(path).units
