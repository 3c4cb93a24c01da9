"""A page of Parquet that unpacks to more than its file's metadata says is refused before."""

import io

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from truejoint.errors import RecordingError
from truejoint.recordings import read_parquet
from truejoint.recordings.bounded_file import DamagedError
from truejoint.recordings.table.parquet import page_sizes

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
    chunks = [metadata.row_group(0).column(k) for k in range(2)]
    sizes = [size - 4096 for size in page_sizes(file, metadata)]
    assert len(sizes) > 4
    headers = sum(chunk.total_uncompressed_size for chunk in chunks) - sum(sizes)
    assert 20 * len(sizes) < headers < 120 * len(sizes)  # which Arrow counts too


def test_a_forged_page_is_refused_before_it_is_unpacked(tmp_path, monkeypatch):
    hostile.forged_page(tmp_path / "a.parquet")
    monkeypatch.setattr(pq.ParquetFile, "read", None)
    with pytest.raises(RecordingError, match=r"a\.parquet: unpacks to more than"):
        read_parquet(tmp_path / "a.parquet")


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
    metadata = pq.read_metadata(file)
    damaged = io.BytesIO(file.getvalue()[:4] + header)
    with pytest.raises(DamagedError, match=why):
        list(page_sizes(damaged, metadata))
    whole = io.BytesIO(file.getvalue()[:4] + GOOD + bytes(16) + GOOD * 50)
    assert next(page_sizes(whole, metadata)) == 4096 + 16


def test_chunks_that_count_more_values_than_the_file_has_rows(tmp_path):
    """They take few bytes where a page says that one value stands often."""
    path, rows = tmp_path / "a.parquet", 9_000_000
    pq.write_table(pa.table({"t": np.zeros(rows)}), path, row_group_size=rows)
    data, count = path.read_bytes(), b"\x16" + hostile.compact(rows)
    pieces, lie = data.split(count), b"\x16\x84\x80\x80\0"  # 2, in as many bytes
    assert len(pieces) == 4  # of the file, of its chunk, of its group of rows
    path.write_bytes(pieces[0] + lie + pieces[1] + count + pieces[2] + lie + pieces[3])
    assert pq.read_metadata(path).num_rows == 2
    with pytest.raises(RecordingError, match="unpacks to more than"):
        read_parquet(path)
