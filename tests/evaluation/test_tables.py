import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from truejoint.evaluation import evaluate, findings_table, plot_corrected, score_table
from truejoint.recordings import Recording, check_data


@pytest.mark.parametrize("robot", ["raven2", "davinci_grasper"])
def test_the_table_and_the_picture_show_every_joint(
    robot: str,
    tmp_path: Path,
    recording_of: Callable[..., Recording],
    calibration_of: Callable[..., Any],
) -> None:
    train, test = recording_of(robot, seed=0), recording_of(robot, seed=1, source="[red]x.csv")
    evaluation = evaluate({"dnn": [calibration_of([train], seed=s) for s in range(2)]}, [test])
    console = Console(width=160, record=True, file=io.StringIO())
    console.print(score_table(evaluation))
    console.print(findings_table(check_data([test])))
    text = console.export_text()
    for joint, unit in zip(evaluation.joints, evaluation.units, strict=True):
        shown = "deg" if unit == "rad" else "mm"
        line = next(line for line in text.splitlines() if f" {joint} [{shown}] " in line)
        percent = evaluation.score("dnn", joint).percent_of_offset
        assert f"{percent:.0f} %" in line
    assert ("tool [mm]" in text) == bool(evaluation.cartesian)
    picture = plot_corrected(evaluation, tmp_path / "still.png", seconds=5)
    assert picture.read_bytes().startswith(b"\x89PNG")
