"""Tests of the arm that a command drives: what is asked before a real one moves."""

from __future__ import annotations

import sys

import pytest
import typer

from truejoint.cli import driven_arm
from truejoint.motion import write_trajectory, zigzag
from truejoint.robots import get_robot


@pytest.fixture
def motion(tmp_path):
    path = tmp_path / "zigzag.csv"
    write_trajectory(zigzag(get_robot("raven2"), "J1-J2-J3", 1.0), path)
    return path


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--namespace", "/x"), "--namespace is for a real arm; give --ros"),
        (("--yes-move-it",), "--yes-move-it is for a real arm"),
        (("--ros", "1", "--twin", "peng2024"), "are a simulated arm's: leave them out"),
        (("--ros", "1"), "a real arm moves, raven2:left, at up to 50 mm/s and 143.2 deg/s: agree"),
    ],
)
def test_a_real_arm_is_asked_for_by_name_and_agreed_to(call, motion, tmp_path, options, words):
    told = call("collect", motion, "-o", tmp_path / "new", *options)
    assert told.code == 2
    assert words in told.err


@pytest.mark.parametrize("typed", ["raven2", "raven2:left"])
def test_it_moves_once_its_name_is_typed(call, motion, tmp_path, monkeypatch, typed):
    joined = []

    def join(*how):
        joined.append(how)
        raise typer.Abort

    monkeypatch.setattr(sys.stdin, "isatty", lambda: True)
    monkeypatch.setattr(typer, "prompt", lambda *_, **__: typed)
    monkeypatch.setattr(driven_arm, "joined", join)
    told = call("collect", motion, "-o", tmp_path / "new", "--ros", "2")
    if typed == "raven2":
        assert told.code == 2
        assert "nothing was moved" in told.err
    assert bool(joined) == (typed == "raven2:left")
