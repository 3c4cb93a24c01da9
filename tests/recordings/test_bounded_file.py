import gzip
import hashlib
import re

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from tests.recordings.refusals import refused

from truejoint.errors import RecordingError
from truejoint.recordings.bounded_file import (
    FOREIGN,
    HEAD_BYTES,
    BoundedFile,
    Head,
    read_bounded,
    require_file,
    sha256_of,
)


@given(data=st.binary(min_size=1, max_size=3000), packed=st.booleans())
def test_reads_what_was_written_and_hashes_the_unpacked_content(tmp_path, data, packed):
    assume(not data.startswith(tuple(FOREIGN)))
    path = tmp_path / "some.bin"
    if data.startswith(b"\x1f\x8b"):
        packed = True
    path.write_bytes(gzip.compress(data) if packed else data)
    content, digest = read_bounded(path)
    assert content == data
    assert digest == sha256_of(path) == hashlib.sha256(data).hexdigest()
    assert Head.of(path, 10).data == data[:10]


def test_hash_covers_what_was_not_read_yet(tmp_path):
    path = tmp_path / "a"
    path.write_bytes(b"0123456789" * 1000)
    with BoundedFile(path) as file:
        file.read(7)
        assert file.sha256() == hashlib.sha256(b"0123456789" * 1000).hexdigest()


@pytest.mark.parametrize(("size", "limits"), [(10_000_000, [100_000]), ((1 << 26) + 1, [])])
def test_a_gzip_bomb_is_refused_before_it_is_unpacked(tmp_path, size, limits):
    path = tmp_path / "bomb.gz"
    path.write_bytes(gzip.compress(bytes(size), 1))
    most = limits[0] if limits else 1 << 26
    refused(rf"bomb\.gz: unpacks to more than {most} bytes", read_bounded, path, *limits)


def test_an_endless_line_is_refused(tmp_path):
    path = tmp_path / "line.txt"
    path.write_bytes(b"1,2\n" + b"3" * 3_000_000)
    with BoundedFile(path, lines=True) as file, pytest.raises(RecordingError, match="line longer"):
        file.sha256()


@pytest.mark.parametrize("cut", [5, 20, -4])
def test_a_damaged_gzip_file_is_one_line(tmp_path, cut):
    path = tmp_path / "cut.gz"
    path.write_bytes(gzip.compress(bytes(range(256)) * 50)[:cut])
    refused(r"cut.gz: the gzip file is cut short or damaged", read_bounded, path)


@pytest.mark.parametrize(("content", "kind"), FOREIGN.items())
def test_what_no_reader_takes_is_called_by_its_name(tmp_path, content, kind):
    (tmp_path / "run.csv").write_bytes(content + b"\0\0")
    refused(f"run.csv: is {re.escape(kind)}; save its table as text", Head.of, tmp_path / "run.csv")


@pytest.mark.parametrize("begin", ["# a note\n" * 8000, "a name," * 10_000])
def test_a_header_that_the_head_does_not_hold_is_no_shorter_one(tmp_path, begin):
    (tmp_path / "run.csv").write_text(f"{begin}\nt,measured/jaw\n0,1\n")
    said = f"neither header nor row ends in its first {HEAD_BYTES} bytes"
    refused(said, Head.of(tmp_path / "run.csv").first_line, "#")


@pytest.mark.parametrize(
    ("name", "said"), [("nowhere", "no such file"), (".", "not a file"), ("empty", "is empty")]
)
def test_what_is_no_file_is_refused(tmp_path, name, said):
    (tmp_path / "empty").touch()
    refused(said, require_file, tmp_path / name)
