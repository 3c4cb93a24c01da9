import io

import pytest
from rich.console import Console

from truejoint.evaluation import evaluate, score_table
from truejoint.evaluation.results import TOOL
from truejoint.evaluation.score_tables import all_scores
from truejoint.tables import shown
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
    assert ("tool [mm]" in text) == (not evaluation.cartesian_note)


@pytest.mark.parametrize("robot", ["raven2", "davinci_grasper"])
def test_scores_stand_by_joint_with_the_digits_of_their_column(robot, recording_of, calibration_of):
    train, test = recording_of(robot, seed=0), recording_of(robot, seed=1)
    evaluation = evaluate({"ukf_elastic": [calibration_of([train])]}, [test])
    tables = dict(all_scores(evaluation))
    assert (TOOL in tables) == (not evaluation.cartesian_note)
    for joint, si in zip(evaluation.joints, evaluation.units, strict=True):
        unit, table = display_unit(si), tables[joint]
        values = [unit.scale * evaluation.score(n, joint).rmse for n in evaluation.estimators]
        assert table[f"RMSE [{unit.name}]"].tolist() == shown(values)
        assert f"spread [{unit.name}]" not in table  # of one seed there is none
