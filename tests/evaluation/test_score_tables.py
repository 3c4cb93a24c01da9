import io

import pytest
from rich.console import Console

from truejoint.evaluation import evaluate, score_table
from truejoint.evaluation.results import TOOL, all_scores
from truejoint.tables import shown
from truejoint.units import display_unit


@pytest.mark.parametrize("robot", ["raven2", "davinci_grasper"])
def test_tables_show_every_joint_with_the_digits_of_its_column(robot, recording_of, calibration_of):
    train, test = recording_of(robot, seed=0), recording_of(robot, seed=1, source="[red]x.csv")
    seeds = [calibration_of([train], seed=s) for s in range(2)]
    console = Console(width=160, record=True, file=io.StringIO())
    evaluation = evaluate({"dnn": seeds}, [test])
    console.print(score_table(evaluation))
    text, tables = console.export_text(), dict(all_scores(evaluation))
    assert ("tool [mm]" in text) == (TOOL in tables) == (not evaluation.cartesian_note)
    for joint, si in zip(evaluation.joints, evaluation.units, strict=True):
        unit, table = display_unit(si), tables[joint]
        line = next(line for line in text.splitlines() if f" {joint} [{unit.name}] " in line)
        assert f"{evaluation.score('dnn', joint).percent_of_offset:.0f} %" in line
        values = [unit.scale * evaluation.score(n, joint).rmse for n in evaluation.estimators]
        assert table[f"RMSE [{unit.name}]"].tolist() == shown(values)
    other = evaluate({"ukf_elastic": seeds[:1]}, [test], check=evaluation.check)
    single = dict(all_scores(other))
    assert not any(name.startswith("spread") for name in single[evaluation.joints[0]])
