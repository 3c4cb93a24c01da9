"""Whatever is done to the bytes of a bag, it is read in part or refused in one line."""

from __future__ import annotations

import sys
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.recordings.read.bags.conftest import make_session

from truejoint.errors import TruejointError
from truejoint.recordings import bag_topics, read_bag, write_bag

zstd = pytest.importorskip("backports.zstd" if sys.version_info < (3, 14) else "compression.zstd")


@pytest.fixture(scope="module")
def bags(tmp_path_factory) -> dict[str, bytes]:
    """A short bag of each kind by its suffix."""
    folder, session = tmp_path_factory.mktemp("bags"), make_session(rows=20)
    found = {}
    for suffix in (".bag", ".mcap"):
        write_bag(session, folder / f"a{suffix}")
        found[suffix] = (folder / f"a{suffix}").read_bytes()
    return {**found, ".mcap.zstd": zstd.compress(found[".mcap"])}


@pytest.mark.parametrize("suffix", [".bag", ".mcap", ".mcap.zstd"])
@settings(max_examples=40)
@given(
    changes=st.lists(st.tuples(st.floats(0.0, 1.0), st.integers(0, 255)), max_size=6),
    kept=st.floats(0.0, 1.0),
)
def test_damage_is_survived(bags, tmp_path, suffix, changes, kept):
    data = bytearray(bags[suffix])
    for place, value in changes:
        data[int(place * (len(data) - 1))] = value
    path = Path(tmp_path) / f"b{suffix}"
    path.write_bytes(data[: int(kept * len(data))])
    for read in (bag_topics, read_bag):
        with suppress(TruejointError):
            read(path)
