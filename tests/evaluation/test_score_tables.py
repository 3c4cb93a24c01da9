import io

import pandas as pd
import pytest
from rich.console import Console

from truejoint.errors import RecordingError
from truejoint.evaluation import evaluate, score_table, write_tables
from truejoint.units import display_unit


@pytest.mark.parametrize("robot", ["raven2", "davinci_grasper"])
def test_the_table_shows_every_joint(robot, recording_of, calibration_of):
    train, test = recording_of(robot, seed=0), recording_of(robot, seed=1, source="[red]x.csv")
    evaluation = evaluate({"dnn": [calibration_of([train], seed=s) for s in range(2)]}, [test])
    console = Console(width=160, record=True, file=io.StringIO())
    console.print(score_table(evaluation))
    text = console.export_text()
    for joint, unit in zip(evaluation.joints, evaluation.units, strict=True):
        shown = "deg" if unit == "rad" else "mm"
        line = next(line for line in text.splitlines() if f" {joint} [{shown}] " in line)
        percent = evaluation.score("dnn", joint).percent_of_offset
        assert f"{percent:.0f} %" in line
    assert ("tool [mm]" in text) == bool(evaluation.cartesian)


@pytest.mark.parametrize("robot", ["raven2", "davinci_grasper"])
def test_tables_go_to_a_paper_and_to_a_spreadsheet(robot, tmp_path, recording_of, calibration_of):
    train, test = recording_of(robot, seed=0), recording_of(robot, seed=1)
    evaluation = evaluate({"ukf_elastic": [calibration_of([train])]}, [test])
    folder = tmp_path / "tables"
    paths = write_tables(evaluation, folder)
    assert {path.suffix for path in paths} == {".csv", ".tex"}
    assert (folder / "tool_position.csv").exists() == bool(evaluation.cartesian)
    joint, unit = evaluation.joints[0], display_unit(evaluation.units[0])
    table = pd.read_csv(folder / f"{joint}.csv")
    for place, name in enumerate(evaluation.estimators):
        score = evaluation.score(name, joint)
        assert table[f"RMSE [{unit.name}]"][place] == unit.scale * score.rmse
        assert table["percent of fixed offset"][place] == score.percent_of_offset
    assert f"spread [{unit.name}]" not in table.columns  # of one seed there is none
    text = (folder / f"{joint}.tex").read_text()
    assert r"ukf\_elastic &" in text
    assert text.count(r"\\") == len(evaluation.estimators) + 1
    with pytest.raises(RecordingError, match="exists"):
        write_tables(evaluation, folder)
    assert write_tables(evaluation, folder, overwrite=True) == paths
    with pytest.raises(RecordingError, match="is a file"):
        write_tables(evaluation, paths[0])
