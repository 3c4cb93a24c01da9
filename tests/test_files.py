"""The one writer of files."""

from __future__ import annotations

from pathlib import Path

import pytest

from truejoint.errors import TruejointError
from truejoint.files import write_all_atomically, write_atomically


def test_a_failed_write_leaves_what_was_there(tmp_path: Path) -> None:
    path = tmp_path / "kept"
    path.write_text("before")

    def half(temporary: Path) -> None:
        temporary.write_text("half")
        raise OSError("disk full")

    with pytest.raises(TruejointError, match="cannot be written: disk full"):
        write_atomically(path, half, overwrite=True)
    assert path.read_text() == "before"
    assert [p.name for p in tmp_path.iterdir()] == ["kept"]


def test_overwriting_must_be_allowed(tmp_path: Path) -> None:
    path = tmp_path / "kept"
    path.write_text("before")
    with pytest.raises(TruejointError, match="exists already"):
        write_atomically(path, lambda p: p.write_text("after") and None, overwrite=False)
    assert path.read_text() == "before"
    write_atomically(path, lambda p: p.write_text("after") and None, overwrite=True)
    assert path.read_text() == "after"


def test_a_file_made_in_the_meantime_is_not_replaced(tmp_path: Path) -> None:
    path = tmp_path / "late"

    def slow(temporary: Path) -> None:
        temporary.write_text("ours")
        path.write_text("theirs")

    with pytest.raises(TruejointError, match="exists already"):
        write_atomically(path, slow, overwrite=False)
    assert path.read_text() == "theirs"


def test_a_folder_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(TruejointError, match="nowhere does not exist"):
        write_atomically(tmp_path / "nowhere" / "a", lambda _: None, overwrite=False)


def test_of_several_files_none_is_written_where_one_fails(tmp_path: Path) -> None:
    first, second = tmp_path / "first", tmp_path / "second"
    first.write_text("before")

    def full(_: Path) -> None:
        raise OSError("disk full")

    writers = {first: lambda p: p.write_text("after"), second: full}
    with pytest.raises(TruejointError, match="second: cannot be written: disk full"):
        write_all_atomically(writers, overwrite=True)
    assert first.read_text() == "before"
    assert [p.name for p in tmp_path.iterdir()] == ["first"]
    with pytest.raises(TruejointError, match="first: exists already"):
        write_all_atomically({second: full, first: full}, overwrite=False)
