"""A laboratory's own way: calibrate, hang weights, home, read loads."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from truejoint import read_calibration, write_parquet
from truejoint.runtime import Corrector
from truejoint.simulation.forceps.load import LoadTest
from truejoint.simulation.forceps.specimens import specimen
from truejoint.simulation.forceps.twin import ZeroShift
from truejoint.studies.forceps.methods import record

PLANT = specimen("A")
SHIFT = 2e-5


@pytest.fixture(scope="module")
def laboratory(tmp_path_factory) -> Path:
    """Records that a laboratory has: one without a load, as text of four columns."""
    folder = tmp_path_factory.mktemp("jaw")
    unloaded = record(PLANT, "calibration").table
    columns = ["t", "motor/jaw", "cable/reset", "truth/jaw"]
    unloaded[columns].to_csv(folder / "unloaded.csv", index=False)
    write_parquet(record(PLANT, LoadTest(0.2, "along"), seed=7), folder / "hung.parquet")
    for name, shift in (("same", 0.0), ("off", SHIFT)):
        cycle = record(PLANT, "cycle", seed=9, zero_shift=ZeroShift(reset=shift))
        write_parquet(cycle, folder / f"{name}.parquet")
    return folder


def test_weights_and_homings_of_a_laboratory(call, laboratory):
    torque = 0.2 * 9.81 * PLANT.jaw.load_arm
    how = "--set drive_stiffness=9450 --set stiffness_error=0.06"
    unloaded = f"{laboratory}/unloaded.csv --robot forceps -e ukf_friction"
    call.good(f"calibrate {unloaded} {how} -o loads.st")

    call(f"correct loads.st {laboratory}/hung.parquet -o table.csv")
    last = pd.read_csv("table.csv").iloc[-1]
    assert last["load/jaw"] == pytest.approx(torque, abs=last["load_half_width/jaw"])
    assert last["load_half_width/jaw"] < 0.5 * torque
    assert last["status"] == "OK"

    for name, shift in (("off", SHIFT), ("same", 0.0)):
        cycle, today = laboratory / f"{name}.parquet", f"today_{name}.st"
        zero = call.json(f"rezero loads.st {cycle} --motor loads.st -o {today}")
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
    line = f"rezero loads.st {laboratory}/hung.parquet --motor loads.st -o never.st"
    call.refuses("turns round 0 times", line)
    assert not Path("never.st").exists()
