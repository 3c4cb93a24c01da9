"""Tests of `truejoint export` beyond those that all commands share."""

from __future__ import annotations

from pathlib import Path

from tests.cli.conftest import Call


def test_a_level_is_refused_where_the_model_states_no_interval(
    call: Call, session: Path, tmp_path: Path
) -> None:
    arguments = ("export", session / "m.st", "--to", "c", "-o", tmp_path / "c")
    result = call(*arguments, "--level", "95")
    assert result.code == 2
    assert "states no interval; make one" in result.err.splitlines()[-1]
    assert not (tmp_path / "c").exists()
