"""A handful of random cases, and every case that once went wrong."""

from __future__ import annotations

import numpy as np
import pytest

import truejoint
from truejoint.errors import TruejointError

from .cases import Draw, make, make_seeds, run
from .kills import Kills


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


def test_what_is_killed_loses_no_file(tmp_path):
    kills = Kills(tmp_path, ("rezero", "correct to csv", "extract", "trajectory", "export"))
    rng = np.random.default_rng(1)
    for _ in range(10):
        what, wrong = kills.one(rng)
        assert not wrong, f"{what}: {wrong}"


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
