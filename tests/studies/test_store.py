from __future__ import annotations

import hashlib
import io
import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from truejoint.studies import Part, PartResult, Study
from truejoint.studies.runner import part_file, read_part, write_part

JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=8,
)
ARRAYS = hnp.arrays(st.sampled_from((np.float64, np.int64, np.bool_)), hnp.array_shapes(min_side=0))
NAMES = st.text("abcdefghij_/.0123456789", min_size=1, max_size=12)


@given(
    st.lists(st.dictionaries(st.text(), JSON), max_size=3),
    st.dictionaries(NAMES, ARRAYS, max_size=3),
)
def test_a_part_is_read_back_bit_for_bit(tmp_path_factory, rows, arrays):
    path = tmp_path_factory.mktemp("parts") / "one.part"
    write_part(path, PartResult(rows, arrays, {"a.py": "0f"}))
    part = read_part(path)
    assert part.sources == {"a.py": "0f"}
    assert json.dumps(part.rows) == json.dumps(rows)
    assert part.arrays.keys() == arrays.keys()
    for name, values in arrays.items():
        assert part.arrays[name].dtype == values.dtype
        assert part.arrays[name].tobytes() == values.tobytes()


def test_a_damaged_part_is_no_part(tmp_path):
    path = tmp_path / "one.part"
    write_part(path, PartResult([{"a": 1}], {"values": np.arange(100.0)}))
    whole = path.read_bytes()
    assert read_part(tmp_path / "none.part") is None
    for length in range(0, len(whole), 97):
        path.write_bytes(whole[:length])
        assert read_part(path) is None
    for place in range(0, len(whole), 11):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 4]) + whole[place + 1 :])
        assert read_part(path) is None


def test_objects_are_never_unpickled(tmp_path):
    with pytest.raises(ValueError, match="Object arrays"):
        write_part(tmp_path / "part", PartResult([], {"x": np.array([print], dtype=object)}))
    content = io.BytesIO()
    np.savez(content, rows=np.array([print], dtype=object))
    data = content.getvalue()
    (tmp_path / "part").write_bytes(hashlib.sha256(data).digest() + data)
    with pytest.raises(ValueError, match="allow_pickle=False"):
        read_part(tmp_path / "part")


@pytest.mark.parametrize(
    ("key", "arguments"), [("b", {"x": 1}), ("a", {"x": 1.5}), ("a", {"x": 1, "y": 0})]
)
def test_study_and_arguments_of_a_part_are_in_its_name(tmp_path, key, arguments):
    study = Study("s", "", "", "m")
    one = part_file(tmp_path, study, Part("a", max, {"x": 1}))
    assert one == part_file(tmp_path, study, Part("a", max, {"x": 1}))
    assert one != part_file(tmp_path, study, Part(key, max, arguments))
    assert one != part_file(tmp_path, replace(study, name="t"), Part("a", max, {"x": 1}))
