import hashlib
import io
import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from truejoint.errors import StudyError
from truejoint.studies import Part, PartResult, run_study, runner
from truejoint.studies.runner import part_file, read_part, write_part


def test_parts_are_computed_once(toy, tmp_path):
    fractions = []
    first = run_study(toy.study, folder=tmp_path, progress=fractions.append)
    assert toy.computed == [0, 1, 2, 3]
    assert fractions == [0.25, 0.5, 0.75, 1.0]
    again = run_study(toy.study, folder=tmp_path)
    assert toy.computed == []
    assert (first.computed, again.computed) == (4, 0)
    assert first.to_dict() == again.to_dict()
    (file,) = (tmp_path / "parts").glob("part-2-*.part")
    file.write_bytes(file.read_bytes()[:-50])  # a damaged one is computed again
    run_study(toy.study, folder=tmp_path)
    assert toy.computed == [2]


def test_nothing_is_kept_without_a_folder(toy):
    for _ in range(2):
        run_study(toy.study, preset="small")
        assert toy.computed == [0, 1]


def test_other_settings_are_other_parts(toy, tmp_path):
    run_study(toy.study, folder=tmp_path, preset="small")
    assert toy.computed == [0, 1]
    run_study(toy.study, folder=tmp_path)  # begins with what the small preset did
    assert toy.computed == [2, 3]
    for changed in ({"options": {"scale": 2}}, {"seed": 1}):
        run_study(toy.study, folder=tmp_path, **changed)
        assert toy.computed == [0, 1, 2, 3]


def test_parts_of_other_sources_are_left_aside_and_counted(toy, tmp_path, monkeypatch):
    run_study(toy.study, folder=tmp_path, preset="small")
    assert toy.computed == [0, 1]
    (file,) = (tmp_path / "parts").glob("part-0-*.part")
    sources = read_part(file).sources
    assert {"toy_study", "studies/study.py", "errors.py"} <= sources.keys()
    assert not any(name.startswith("cli/") for name in sources)
    for changed in ("toy_study", "errors.py"):
        digest = runner._digest_of
        monkeypatch.setattr(
            runner, "_digest_of", lambda name, d=digest, c=changed: d(name) + "x" * (name == c)
        )
        result = run_study(toy.study, folder=tmp_path, preset="small")
        assert (toy.computed, result.computed, result.aside) == ([0, 1], 2, 2)
        assert run_study(toy.study, folder=tmp_path, preset="small").aside == 0
        assert toy.computed == []
    write_part(file, replace(read_part(file), sources={}))
    assert run_study(toy.study, folder=tmp_path, preset="small").aside == 1, "of nobody knows which"


PROGRAM = """
import sys; sys.path.insert(0, sys.argv[1])
from truejoint.studies import Option, Study, run_study
options = (Option('count', 4, ''), Option('scale', 1.0, ''))
study = Study('toy', '', '', 'toy_study', options)
run_study(study, folder=sys.argv[2], jobs=int(sys.argv[3]))
"""


def in_a_process(folder, jobs):
    arguments = [sys.executable, "-c", PROGRAM, str(folder / "module"), str(folder), str(jobs)]
    # Whoever holds its output is waited for, so its workers too.
    run = subprocess.run(arguments, check=False, stdout=subprocess.PIPE, timeout=100)  # noqa: S603
    return run.returncode


def test_workers_whose_parent_is_killed_end_too(toy, tmp_path):
    toy.trouble("orphan@1")
    assert in_a_process(tmp_path, 2) == -9


def test_a_process_that_is_killed_loses_the_part_in_hand_alone(toy, tmp_path):
    toy.trouble("kill@2")
    assert in_a_process(tmp_path, 1) == -9
    assert toy.computed == [0, 1]
    toy.trouble("")
    result = run_study(toy.study, folder=tmp_path)
    assert toy.computed == [2, 3]
    assert result.to_dict() == run_study(toy.study).to_dict()


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_part_that_fails_leaves_the_others(toy, tmp_path, jobs):
    toy.trouble("refuse@1")
    with pytest.raises(StudyError, match="toy: part part-1 failed: the plant is out of order"):
        run_study(toy.study, folder=tmp_path, jobs=jobs)
    assert sorted(toy.computed) == [0, 2, 3]
    toy.trouble("")
    run_study(toy.study, folder=tmp_path)
    assert toy.computed == [1]


def test_a_worker_that_dies_costs_its_part(toy, tmp_path):
    toy.trouble("die-once@1")
    pooled = run_study(toy.study, folder=tmp_path, jobs=2)
    toy.trouble("")
    alone = run_study(toy.study)
    assert pooled.to_dict() == alone.to_dict()  # bit for bit, in any order and place
    for key, part in alone.parts.items():
        assert np.array_equal(part.arrays["values"], pooled.parts[key].arrays["values"])


def test_studies_share_their_workers(toy, monkeypatch):
    pools, made = [], runner.ProcessPoolExecutor
    monkeypatch.setattr(
        runner, "ProcessPoolExecutor", lambda *how: pools.append(made(*how)) or pools[-1]
    )
    for seed in range(2):
        assert run_study(toy.study, preset="small", seed=seed, jobs=2).computed == 2
    assert len(pools) == 1


def test_workers_that_die_again_and_again_are_given_up(toy, tmp_path, monkeypatch):
    monkeypatch.setattr("truejoint.studies.runner._POOLS", 1)
    toy.trouble("kill@0")
    with pytest.raises(StudyError, match="workers died 1 times"):
        run_study(toy.study, folder=tmp_path, jobs=2, preset="small")


def test_wrong_calls_are_refused(toy):
    with pytest.raises(StudyError, match="0 jobs"):
        run_study(toy.study, jobs=0)
    with pytest.raises(StudyError, match="no study called 'nosuch'"):
        run_study("nosuch")
    with pytest.raises(StudyError, match="no parts"):
        run_study(toy.study, {"count": 0})


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=8,
)
ARRAYS = hnp.arrays(st.sampled_from((np.float64, np.int64, np.bool_)), hnp.array_shapes(min_side=0))
NAMES = st.text("abcdefghij_/.0123456789", min_size=1, max_size=12)


@settings(max_examples=15)  # each writes a file
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
    ("key", "compute", "arguments"),
    [
        ("b", max, {"x": 1}),
        ("a", min, {"x": 1}),
        ("a", max, {"x": 1.5}),
        ("a", max, {"x": 1, "y": 0}),
    ],
)
def test_function_and_arguments_of_a_part_are_in_its_name(tmp_path, key, compute, arguments):
    one = part_file(tmp_path, Part("a", max, {"x": 1}))
    assert one == part_file(tmp_path, Part("a", max, {"x": 1}, {"specimen": "labels are free"}))
    assert one != part_file(tmp_path, Part(key, compute, arguments))
