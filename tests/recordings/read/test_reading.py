import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.recordings.refusals import refused

from truejoint.errors import RecordingError
from truejoint.recordings import (
    FORMATS,
    detect_format,
    read_recording,
    read_recordings,
    write_parquet,
)
from truejoint.recordings.read.reading import why_no_recording


def write(path: Path, content: str | bytes) -> Path:
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


@pytest.mark.parametrize(
    ("content", "name"),
    [
        ("t,measured/jaw\n0,1\n", "csv"),
        ("# note\nmeasured/jaw t\n0 1\n", "csv"),
        ('"t";"measured/jaw"\n0;1\n', "csv"),
        ("t,Front-end Maxon Encoder [counts]\n1,2\n", "csv"),
        (",".join(["-1.5e-3"] * 240) + "\n", "raven_csv"),
        (",".join(["0"] * 252) + "\n", "raven_csv"),
        (",".join(["0"] * 256) + "\n", "raven_csv"),
        (b"PAR1whatever", "parquet"),
    ],
)
def test_the_content_tells_the_format(tmp_path, content, name):
    assert detect_format(write(tmp_path / "some.file", content)) == name


@pytest.mark.parametrize(
    ("content", "found"),
    [
        ("a,b\n1,2\n", "a header without 't'"),
        ("1,2,3\n", "3 columns without a header, expected 240, 252, 256; give a column map"),
        (b"\x00\x01\x02\x03", "not text and of no known binary layout; give a column map"),
    ],
)
def test_an_unknown_file_gets_the_list_of_formats(tmp_path, content, found):
    path = write(tmp_path / "some.file", content)
    text = refused(f"format not recognised.*{found}", read_recording, path)
    assert all(name in text for name in FORMATS)


def test_what_the_caller_knows_goes_into_the_provenance(recording, tmp_path):
    path = tmp_path / "a.parquet"
    write_parquet(recording, path)
    read = read_recording(path, load=0.5, homing_id="third", session="s")
    assert read.provenance.load == 0.5
    assert (read.provenance.homing_id, read.provenance.session) == ("third", "s")
    assert read.table.equals(recording.table)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"format": "pickle"}, "no format called 'pickle'; known: parquet, csv"),
        ({"robot": "raven2"}, "format 'parquet' takes no 'robot'; it takes load, homing_id"),
        ({"truth_zero": "robot"}, "takes no 'truth_zero'"),
    ],
)
def test_an_option_that_would_be_ignored_is_refused(recording, tmp_path, options, message):
    path = tmp_path / "a.parquet"
    write_parquet(recording, path)
    refused(message, read_recording, path, **options)


def test_a_path_that_is_not_there(tmp_path):
    refused(
        r"nowhere.csv: there is no such file or folder", read_recording, tmp_path / "nowhere.csv"
    )
    refused("is not a file", read_recording, tmp_path, "csv")
    refused("is empty", read_recording, write(tmp_path / "empty.csv", ""))


def test_an_error_names_the_path_that_was_given(write_raven, monkeypatch):
    def step_back(table: object) -> None:
        table[5, 0] = table[3, 0]  # type: ignore[index]

    path = write_raven(240, change=step_back)
    refused(f"^{path}: time stamp of row 5", read_recording, path)
    monkeypatch.chdir(path.parent)
    refused(f"^{path.name}: time stamp of row 5", read_recording, path.name)


@settings(max_examples=60)
@given(
    content=st.binary(max_size=200) | st.text('t,measured/joint1 \n"#;0123.', max_size=80),
    mapped=st.booleans(),
)
def test_any_file_in_a_folder_is_a_recording_or_says_why_not(tmp_path_factory, content, mapped):
    path = write(tmp_path_factory.getbasetemp() / "any.file", content)
    mapping = {"columns": {"t": 0, "measured/joint1": 1}} if mapped else None
    reason = why_no_recording(path, column_map=mapping)
    assert "\n" not in reason
    if not reason:
        options = {"column_map": mapping} if mapped else {}
        with suppress(RecordingError):
            assert read_recordings(path, robot="bros", **options)


def count_opens(path: Path, **options: Any) -> int:
    """How often a file is opened while it is read."""
    opened: list[str] = []
    sys.addaudithook(lambda event, about: opened.append(str(about[0])) if event == "open" else None)
    read_recordings(path, **options)
    return opened.count(str(path))


@pytest.mark.parametrize("packed", [False, True])
def test_the_head_of_a_text_is_read_once(recording_of, tmp_path, packed):
    path = tmp_path / f"run.csv{'.gz' if packed else ''}"
    recording_of("davinci_grasper").table.to_csv(path, index=False)
    assert count_opens(path, robot="davinci_grasper") <= 2
