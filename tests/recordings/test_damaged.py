"""Whatever is done to the bytes of a file, it is read in part or refused in one line."""

from typing import Any

import pytest

pytest.importorskip("rosbags", reason="rosbags is not installed (truejoint[ros])")

from hypothesis import given
from hypothesis import strategies as st

from .damaged import KINDS, read_damaged


@pytest.fixture(scope="module", params=KINDS)
def whole(request, tmp_path_factory) -> tuple[str, bytes, dict[str, Any]]:
    """Suffix, content, and how a file of a kind is read."""
    suffix, (write, options) = request.param, KINDS[request.param]
    path = tmp_path_factory.mktemp("whole") / f"a{suffix}"
    write(path)
    return suffix, path.read_bytes(), options


@given(
    changes=st.lists(st.tuples(st.floats(0.0, 1.0), st.integers(0, 255)), max_size=4),
    kept=st.just(1.0) | st.floats(0.0, 1.0),
)
def test_damage_is_survived(whole, tmp_path, changes, kept):
    suffix, content, options = whole
    data = bytearray(content)
    for place, value in changes:
        data[int(place * (len(data) - 1))] = value
    data = data[: round(kept * len(data))]
    path = tmp_path / f"b{suffix}"
    path.write_bytes(data)
    said = read_damaged(path, options)
    assert "\n" not in said
    assert not said or bytes(data) != content
