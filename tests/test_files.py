"""The one writer of files."""

import errno
import os
import stat
from pathlib import Path

import numpy as np
import pytest

from truejoint.errors import TruejointError
from truejoint.files import (
    check_folder,
    check_target,
    content_hash,
    free_name,
    is_as_written,
    read_small,
    write_all_atomically,
    write_atomically,
)


@pytest.mark.parametrize(
    ("failure", "said"),
    [
        (OSError("disk full"), "cannot be written: disk full"),
        (OSError(errno.ENOSPC, "No space left"), "cannot be written: the disk is full; make room"),
        (KeyboardInterrupt("Ctrl-C"), "Ctrl-C"),
    ],
)
def test_a_failed_write_leaves_what_was_there(
    tmp_path: Path, failure: BaseException, said: str
) -> None:
    path = tmp_path / "kept"
    path.write_text("before")

    def half(temporary: Path) -> None:
        temporary.write_text("half")
        raise failure

    with pytest.raises((TruejointError, KeyboardInterrupt), match=said):
        write_atomically(path, half, overwrite=True)
    assert path.read_text() == "before"
    assert [p.name for p in tmp_path.iterdir()] == ["kept"]


def test_the_disk_has_a_file_before_its_name_and_then_the_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept = []

    def fsync(handle: int) -> None:
        named = (tmp_path / "new").exists()
        kept.append((stat.S_ISDIR(os.fstat(handle).st_mode), os.fstat(handle).st_size, named))

    monkeypatch.setattr(os, "fsync", fsync)
    write_atomically(tmp_path / "new", lambda p: p.write_text("whole") and None, overwrite=False)
    assert [(is_folder, named) for is_folder, _, named in kept] == [(False, False), (True, True)]
    assert kept[0][1] == len("whole")


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


def test_where_there_are_no_links_the_name_is_claimed_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(Path, "hardlink_to", refuse)
    path = tmp_path / "a"
    write_atomically(path, lambda p: p.write_text("ours"), overwrite=False)
    assert path.read_text() == "ours"

    def slow(temporary: Path) -> None:
        temporary.write_text("late")
        (tmp_path / "b").write_text("theirs")

    with pytest.raises(TruejointError, match="exists already"):
        write_atomically(tmp_path / "b", slow, overwrite=False)
    assert sorted(p.read_text() for p in tmp_path.iterdir()) == ["ours", "theirs"]


def test_what_is_no_file_is_neither_replaced_nor_waited_for(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with pytest.raises(TruejointError, match="is no file"):
        write_atomically(pipe, lambda p: p.write_text("a"), overwrite=True)
    with pytest.raises(TruejointError, match="is not a file, but"):
        read_small(pipe, TruejointError, 10, "ours")
    (tmp_path / "file").touch()
    with pytest.raises(TruejointError, match="is a file; name a folder"):
        check_folder(tmp_path / "file" / "a" / "b")
    check_folder(tmp_path / "a" / "b")


def test_a_free_name_is_free(tmp_path: Path) -> None:
    names = []
    for _ in range(3):
        free = free_name(tmp_path / "run.parquet", "partial")
        free.touch()
        names.append(free.name)
    assert names == ["run.partial.parquet", "run.partial2.parquet", "run.partial3.parquet"]


def test_the_hash_is_of_what_is_said() -> None:
    array = np.arange(6.0).reshape(2, 3)
    digest = content_hash({"a": 1, "b": [2]}, {"x": array, "y": array[0]})
    same = content_hash({"b": [2], "a": 1}, {"y": array[0].copy(), "x": np.asfortranarray(array)})
    assert digest == same
    for description, arrays in (
        ({"a": 1, "b": [3]}, {"x": array, "y": array[0]}),
        ({"a": 1, "b": [2]}, {"x": array.reshape(3, 2), "y": array[0]}),
        ({"a": 1, "b": [2]}, {"z": array, "y": array[0]}),
        ({"a": 1, "b": [2]}, {"x": -array, "y": array[0]}),
        ({"a": float("nan"), "b": [2]}, {"x": array, "y": array[0]}),
    ):
        assert not is_as_written(digest, description, arrays)


def test_a_name_that_no_file_can_have_is_refused(tmp_path):
    with pytest.raises(TruejointError, match="cannot be written: File name too long"):
        check_target(tmp_path / ("a" * 5000), overwrite=True)
