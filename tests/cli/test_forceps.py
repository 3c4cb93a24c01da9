"""A laboratory's own way: calibrate, hang weights, home, read loads."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from tests.cli.conftest import Call

from truejoint import calibrate, read_calibration, read_recording, write_calibration, write_parquet
from truejoint.runtime import Corrector
from truejoint.simulation.forceps.load import LoadTest
from truejoint.simulation.forceps.specimens import specimen
from truejoint.simulation.forceps.twin import ZeroShift
from truejoint.studies.forceps.motions import record

PLANT = specimen("A")
ARM = f"{1e3 * PLANT.jaw.load_arm}"
SHIFT = 2e-5


@pytest.fixture(scope="module")
def laboratory(tmp_path_factory) -> Path:
    """Records that a laboratory has: one without a load, as text of four columns."""
    folder = tmp_path_factory.mktemp("jaw")
    unloaded = record(PLANT, "calibration").table
    columns = ["t", "motor/jaw", "cable/reset", "truth/jaw"]
    unloaded[columns].to_csv(folder / "unloaded.csv", index=False)
    for way in ("along", "opposing"):
        write_parquet(record(PLANT, LoadTest(0.2, way), seed=7), folder / f"hung_{way}.parquet")
    for name, shift in (("same", 0.0), ("off", SHIFT)):
        cycle = record(PLANT, "cycle", seed=9, zero_shift=ZeroShift(reset=shift))
        write_parquet(cycle, folder / f"{name}.parquet")
    calibration = calibrate(
        read_recording(folder / "unloaded.csv", robot="forceps"), "ukf_friction"
    )
    write_calibration(calibration, folder / "jaw.st")
    return folder


def test_weights_and_homings_of_a_laboratory(call: Call, laboratory: Path) -> None:
    model, loads, table = (laboratory / name for name in ("jaw.st", "loads.st", "table.csv"))
    hung = [laboratory / f"hung_{way}.parquet" for way in ("along", "opposing")]
    said = call("adapt", model, *hung, "--weights-mm", ARM, "-o", loads, "--json")
    assert said.code == 0
    found = json.loads(said.out)
    assert found["drive_stiffness"] == pytest.approx(9.45e3, rel=0.06)
    told = read_calibration(loads)
    assert told.model.drive_stiffness == found["drive_stiffness"]
    assert told.metadata["stiffness"]["growth"] == told.model.stiffness_growth

    call("correct", loads, hung[0], "-o", table)
    last = pd.read_csv(table).iloc[-1]
    true = 0.2 * 9.81 * PLANT.jaw.load_arm
    assert last["load/jaw"] == pytest.approx(true, abs=last["load_half_width/jaw"])
    assert last["load_half_width/jaw"] < 0.5 * true
    assert last["status"] == "OK"

    for name, shift in (("off", SHIFT), ("same", 0.0)):
        cycle, today = laboratory / f"{name}.parquet", laboratory / f"today_{name}.st"
        said = call("rezero", loads, cycle, "--motor", loads, "-o", today, "--json")
        assert said.code == 0
        zero = json.loads(said.out)
        assert zero["shift"] == pytest.approx(shift, abs=3.0 * zero["deviation"])
        assert (zero["correction"] != 0.0) == (shift != 0.0)
        own = Corrector(today)
        moved = read_calibration(today)
        assert moved.signal_shift[moved.signals.index("cable/reset")] == pytest.approx(
            -zero["correction"]
        )
        run = record(PLANT, LoadTest(0.0), zero_shift=ZeroShift(reset=shift))
        own.set_homing(True, run.provenance.homing_id)
        assert np.abs(own.run(run).position[-1, 0] - run.column("truth/jaw")[-1]) < 3e-3


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("adapt", "same.parquet", "--weights-mm", "10"), "its weight is not stated"),
        (("adapt", "hung_along.parquet", "--weights-mm", "-1"), "it must be above 0"),
        (("adapt", "hung_along.parquet", "--weights-mm", "40"), "hang a lighter one"),
        (("rezero", "hung_along.parquet", "--motor", "{model}"), "turns round 0 times"),
    ],
)
def test_what_tells_nothing_is_one_line(call: Call, laboratory: Path, words, message) -> None:
    command, recording, *rest = words
    out, model = laboratory / "never.st", laboratory / "jaw.st"
    rest = [word.format(model=model) for word in rest]
    result = call(command, model, laboratory / recording, *rest, "-o", out)
    assert result.code == 2
    assert message in result.err
    assert "Traceback" not in result.err
    assert not out.exists()
