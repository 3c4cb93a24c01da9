"""A page of Parquet that unpacks to more than its file's metadata says is refused before."""

import io
import subprocess
import sys

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from tests.recordings.refusals import refused

from truejoint.recordings import read_parquet
from truejoint.recordings.bounded_file import DamagedError
from truejoint.recordings.table.parquet_pages import Chunk, chunks, page_sizes

hostile = pytest.importorskip("tests.recordings.hostile", reason="truejoint[ros]")


@pytest.mark.parametrize("version", ["1.0", "2.0"])
@pytest.mark.parametrize("packing", ["none", "zstd", "gzip"])
@pytest.mark.parametrize("as_dictionary", [False, True])
def test_the_pages_are_those_that_arrow_wrote(version, packing, as_dictionary):
    file, rows = io.BytesIO(), np.arange(3000.0) % 50
    table = pa.table({"t": rows, "truth/jaw": pa.array(rows, mask=rows > 40)})
    how = {"data_page_version": version, "data_page_size": 2000, "write_batch_size": 100}
    pq.write_table(table, file, compression=packing, use_dictionary=as_dictionary, **how)
    metadata = pq.read_metadata(file)
    columns = [metadata.row_group(0).column(k) for k in range(2)]
    sizes = [size - 4096 for size in page_sizes(file, chunks(file))]
    assert len(sizes) > 4
    headers = sum(column.total_uncompressed_size for column in columns) - sum(sizes)
    assert 20 * len(sizes) < headers < 120 * len(sizes)  # which Arrow counts too


def test_a_forged_page_is_refused_before_it_is_unpacked(tmp_path, monkeypatch):
    hostile.forged_page(tmp_path / "a.parquet")
    monkeypatch.setattr(pq.ParquetFile, "read", None)
    refused(r"a\.parquet: unpacks to more than", read_parquet, tmp_path / "a.parquet")


@pytest.mark.parametrize("as_dictionary", [False, True])
@pytest.mark.parametrize("checked", [False, True])
def test_the_chunks_are_those_that_arrow_sees(as_dictionary, checked):
    file, rows = io.BytesIO(), np.arange(1000.0) % 7
    names = [f"truth/joint_{number}" for number in range(20)]  # lists with a length of its own
    table = pa.table({"t": rows, **{name: pa.array(rows, mask=rows > 4) for name in names}})
    how = {"use_dictionary": as_dictionary, "write_page_checksum": checked}
    pq.write_table(
        table, file, row_group_size=300, sorting_columns=[pq.SortingColumn(0)],
        write_page_index=checked, bloom_filter_options={"t": True} if checked else None, **how
    )  # fmt: skip
    metadata, expected = pq.read_metadata(file), []
    for group in map(metadata.row_group, range(4)):
        for one in map(group.column, range(21)):
            begin = one.dictionary_page_offset if as_dictionary else one.data_page_offset
            expected.append(Chunk(one.num_values, begin, begin + one.total_compressed_size))
    assert chunks(file) == expected


DAMAGE = """
import sys
from pathlib import Path
from truejoint.errors import RecordingError
from truejoint.recordings import read_parquet
path, refused = Path(sys.argv[1]), 0
whole = path.read_bytes()
footer = int.from_bytes(whole[-8:-4], "little")
for at in range(len(whole) - 8 - footer, len(whole) - 8):
    for flip in (1, 2, 0x10):
        damaged = bytearray(whole)
        damaged[at] ^= flip
        path.write_bytes(damaged)
        try:
            read_parquet(path)
        except RecordingError:
            refused += 1
print(refused / (3 * footer))
"""


def test_no_damage_of_a_footer_ends_the_process(tmp_path):
    """Arrow's own view of a chunk whose counts of levels do not fit ends it."""
    path = tmp_path / "a.parquet"
    pq.write_table(pa.table({"t": np.arange(20.0)}, metadata={b"truejoint": b"{}"}), path)
    command = [sys.executable, "-c", DAMAGE, str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)  # noqa: S603
    assert done.returncode == 0, done.stderr
    assert float(done.stdout) == 1.0


def _footer(of_groups: bytes) -> io.BytesIO:
    """A file of nothing but a footer, whose fourth field is a list."""
    footer = b"\x49" + of_groups + b"\0"
    return io.BytesIO(footer + len(footer).to_bytes(4, "little") + b"PAR1")


@pytest.mark.parametrize(
    "of_groups",
    [
        b"\x15\x02",  # of numbers
        b"\x1c\x19\x15\x02\0",  # of groups of numbers
        b"\x1c\x19\x1c\x3c\0\0\0",  # of chunks that say nothing
        b"\x1c\x19\x1c\x3c\x55\x01\x25\x02\x25\x02\0\0\0",  # of -1 values
        b"\x0c\0",  # and something behind
        b"\xf1" + b"\xff" * 8 + b"\x01",  # of very many truths
        b"\x19" * 20,
    ],
)
def test_a_footer_that_is_none_is_damage(of_groups):
    assert chunks(_footer(b"\x1c\x19\x1c\x3c\x55\x02\x25\x04\x25\x06\0\0\0")) == [(1, 3, 5)]
    with pytest.raises(DamagedError):
        chunks(_footer(of_groups))


def test_a_footer_of_too_many_bytes():
    with pytest.raises(DamagedError, match="too many bytes"):
        chunks(io.BytesIO(b"\0\0\0\x7fPAR1"))


GOOD = b"\x15\0\x15\x20\x15\x20\x2c\x15\x04\0\0"


@pytest.mark.parametrize(
    ("header", "why"),
    [
        (GOOD[:6] + b"\x05\x04" + GOOD[5:], "stands twice"),
        (b"\x19\x25" + GOOD, "a field that no page has"),
        (b"\x15" + b"\xff" * 20, "never ends"),
        (b"\x1c" * 9, "a field that no page has"),
        (GOOD[:2] + b"\0", "the header of a page"),
        (GOOD[:4], "the header of a page"),
        (b"\x15\0\x15\x21\x15\x20\0", "the length of a page"),
    ],
)
def test_a_header_that_is_none_is_damage(header, why):
    file = io.BytesIO()
    pq.write_table(pa.table({"t": np.arange(20.0)}), file, use_dictionary=False)
    damaged = io.BytesIO(file.getvalue()[:4] + header)
    with pytest.raises(DamagedError, match=why):
        list(page_sizes(damaged, chunks(file)))
    whole = io.BytesIO(file.getvalue()[:4] + GOOD + bytes(16) + GOOD * 50)
    assert next(page_sizes(whole, chunks(file))) == 4096 + 16


def test_chunks_that_count_more_values_than_the_file_has_rows(tmp_path):
    """They take few bytes where a page says that one value stands often."""
    path, rows = tmp_path / "a.parquet", 9_000_000
    pq.write_table(pa.table({"t": np.zeros(rows)}), path, row_group_size=rows)
    data, count = path.read_bytes(), b"\x16" + hostile.compact(rows)
    pieces, lie = data.split(count), b"\x16\x84\x80\x80\0"  # 2, in as many bytes
    assert len(pieces) == 4  # of the file, of its chunk, of its group of rows
    path.write_bytes(pieces[0] + lie + pieces[1] + count + pieces[2] + lie + pieces[3])
    assert pq.read_metadata(path).num_rows == 2
    refused("unpacks to more than", read_parquet, path)
