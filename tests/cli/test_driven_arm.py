"""Tests of the arm that a command drives: what is asked before a real one moves."""

from __future__ import annotations

import sys

import pytest
import typer

from truejoint.cli import driven_arm


@pytest.mark.parametrize("typed", ["raven2", "raven2:left"])
def test_it_moves_once_its_name_is_typed(call, session, tmp_path, monkeypatch, typed):
    joined = []

    def join(*how):
        joined.append(how)
        raise typer.Abort

    monkeypatch.setattr(sys.stdin, "isatty", lambda: True)
    monkeypatch.setattr(typer, "prompt", lambda *_, **__: typed)
    monkeypatch.setattr(driven_arm, "joined", join)
    told = call("collect", session / "random.csv", "-o", tmp_path / "new", "--ros", "2")
    if typed == "raven2":
        assert told.code == 2
        assert "nothing was moved" in told.err
    assert bool(joined) == (typed == "raven2:left")
