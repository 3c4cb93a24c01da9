"""A handful of random cases, and every case that once went wrong."""

import json
import shutil
import struct

import numpy as np
import pytest

import truejoint
from truejoint.errors import TruejointError

from .cases import Draw, make, make_seeds, run
from .kills import MOMENTS, Kills


@pytest.fixture(scope="module")
def seeds(tmp_path_factory):
    folder = tmp_path_factory.mktemp("seeds")
    make_seeds(folder)
    return folder


@pytest.mark.parametrize("number", range(40))
def test_random_cases_work_or_are_refused(seeds, tmp_path, monkeypatch, number):
    monkeypatch.chdir(tmp_path)
    make(1, number, seeds, tmp_path).run()


def test_a_case_is_made_again_by_its_number(seeds, tmp_path):
    assert make(1, 7, seeds, tmp_path).what == make(1, 7, seeds, tmp_path).what


def test_a_case_gets_no_file_that_others_need(seeds, tmp_path):
    draw = Draw(1, 0, seeds, tmp_path)
    assert not {draw.file() for _ in range(200)} & set(map(str, draw.seeds))


TAKE_A_PATH = (
    truejoint.read_recording,
    truejoint.recordings.detect_format,
    truejoint.recordings.read_bag,
    truejoint.recordings.read_truth,
    truejoint.recordings.read_track,
    lambda name: truejoint.simulation.make_twin("raven2", parameters=name),
)


@pytest.mark.parametrize("name", ["a" * 5000, "x/" * 3000], ids=len)
@pytest.mark.parametrize("function", TAKE_A_PATH)
def test_a_name_longer_than_any_is_refused_as_one_that_is_not_there(function, name):
    with pytest.raises(TruejointError):
        function(name)


@pytest.mark.parametrize("duration", [-1.0, 0.0, np.nan])
def test_a_zero_is_not_looked_for_in_no_time(seeds, duration):
    model = truejoint.read_calibration(seeds / "linear.safetensors")
    test = truejoint.read_recording(seeds / "test.parquet")
    with pytest.raises(TruejointError, match="give more than 0 s"):
        truejoint.calibration.find_zero(model, test, duration)


def joint_called(name: str) -> bytes:
    """Robot of one joint that is called so."""
    named = json.dumps({"name": name})[1:-1].replace(":", " =")
    return f'name = "rig"\njoints = [{{ {named}, unit = "deg" }}]'.encode()


def header(text: bytes, length: int | None = None) -> bytes:
    """Model file of a header, which is said to be so long."""
    return struct.pack("<Q", len(text) if length is None else length) + text + bytes(800)


ATTACKS = {
    "lists.toml": b"a = " + b"[" * 50_000 + b"]" * 50_000,
    "tables.toml": b"a = " + b"{b = " * 5000 + b"1" + b"}" * 5000,
    "keys.toml": b"[" + b".".join([b"a"] * 20_000) + b"]\nb = 1",
    "number.toml": b"name = " + b"9" * 100_000,
    "long.toml": b"a = 1\n" * 200_000,
    "picture.toml": b"\xff\xd8\xff\xe1" + bytes(range(256)) * 9,
    "script.toml": joint_called("<script>alert(1)</script>"),
    "escape.toml": joint_called("\x1b]0;title\x07"),
    "comment.toml": joint_called("*/ system(1) /*"),
    "path.toml": joint_called("../../../etc/passwd"),
    "formula.toml": joint_called("=1+1"),
    "long_header.safetensors": header(b"{}", 4 << 30),
    "nested.safetensors": header(b'{"__metadata__":' + b'{"a":' * 10**5 + b"1" + b"}" * 100_001),
    "twice.safetensors": header(b'{"__metadata__":{"a":"1"},"__metadata__":{"truejoint":"{}"}}'),
    "wide.csv": b"t" + b",measured/jaw" * 10**6 + b"\n" + b"0.5," * 10**6 + b"0.5\n",
    "picture.csv": b"\xff\xd8\xff\xe1" + bytes(range(256)) * 9,
}


@pytest.mark.parametrize("name", ATTACKS)
def test_what_a_stranger_made_is_refused_in_one_line(seeds, tmp_path, name):
    path = tmp_path / name
    path.write_bytes(ATTACKS[name])
    words = {".toml": ["show", seeds / "table.csv", "--robot"], ".csv": ["doctor"]}
    code, said = run(*words.get(path.suffix, ["show"]), path)
    assert code == 2
    assert said.count("truejoint: ") == 1
    assert said.splitlines()[-1].isprintable()


def test_an_array_that_stands_twice_in_a_header_is_that_of_the_hash(seeds, tmp_path):
    content = (seeds / "linear.safetensors").read_bytes()
    end = 8 + int.from_bytes(content[:8], "little")
    name, array = list(json.loads(content[8:end]).items())[1]
    twice = content[8:end].rstrip()[:-1] + f",{json.dumps(name)}:{json.dumps(array)}}}".encode()
    path = tmp_path / "twice.safetensors"
    path.write_bytes(struct.pack("<Q", len(twice)) + twice + content[end:])
    model, good = map(truejoint.read_calibration, (path, seeds / "linear.safetensors"))
    test = truejoint.read_recording(seeds / "test.parquet")
    np.testing.assert_array_equal(model.correct(test), good.correct(test))


@pytest.mark.parametrize("target", ["correct", "export"])
def test_a_link_in_a_folder_of_results_leads_to_no_other_file(seeds, tmp_path, target):
    precious, folder = tmp_path / "precious", tmp_path / "results"
    precious.write_text("precious")
    folder.mkdir()
    words = {"correct": [seeds / "test.parquet", "-o", folder / "a.csv"],
             "export": ["--to", "c", "--out", folder, "--prefix", "a"]}[target]  # fmt: skip
    links = [folder / name for name in ("a.csv", "a.c", "a.h")]
    for link in links:
        link.symlink_to(precious)
    assert run(target, seeds / "linear.safetensors", *words)[0] == 2
    assert run(target, seeds / "linear.safetensors", *words, "--force")[0] in {0, 1}
    assert precious.read_text() == "precious"
    assert not all(link.is_symlink() for link in links)


def test_what_is_killed_loses_no_file(seeds, tmp_path):
    shutil.copytree(seeds, tmp_path / "base")
    kills = Kills(tmp_path, ("rezero", "correct to csv", "extract", "trajectory", "export"))
    rng, done = np.random.default_rng(213), set()
    for _ in MOMENTS:
        what, wrong = kills.one(rng)
        assert not wrong, f"{what}: {wrong}"
        done |= {*what.split(", ")}
    assert done == {*kills.seconds, *MOMENTS}, "each command and each moment once"


WORDS = [
    ["trajectory", "zigzag", "-o", "z.csv", "--sparsity", "9" * 400],
    ["trajectory", "zigzag", "-o", "z.csv", "--sparsity", "1e999999999"],  # took for ever
]


@pytest.mark.parametrize("words", WORDS, ids=lambda words: " ".join(words)[:60])
def test_what_once_went_wrong_is_refused_in_a_line(tmp_path, monkeypatch, words):
    monkeypatch.chdir(tmp_path)
    code, said = run(*words)
    assert code == 2
    assert len(said.splitlines()) == 1
