"""A laboratory's own way: calibrate, hang weights, home, read loads."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from truejoint import calibrate, read_calibration, read_recording, write_calibration, write_parquet
from truejoint.calibration import identify_stiffness
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


def test_weights_and_homings_of_a_laboratory(call, laboratory):
    model = laboratory / "jaw.st"
    hung = [laboratory / f"hung_{way}.parquet" for way in ("along", "opposing")]
    read, torque = read_calibration(model), 0.2 * 9.81 * PLANT.jaw.load_arm
    rows = [read.rows(read_recording(path)) for path in hung]
    torques = [
        np.where(one.t > one.t[-1] - 5.0, way * torque, np.nan)
        for one, way in zip(rows, (1.0, -1.0), strict=True)
    ]
    X, dt = (np.concatenate([getattr(one, name) for one in rows]) for name in ("X", "dt"))
    found = identify_stiffness(read.model, X, np.concatenate(torques), dt)
    assert found.drive_stiffness == pytest.approx(9.45e3, rel=0.06)
    settings = {
        "drive_stiffness": found.drive_stiffness,
        "stiffness_growth": found.growth,
        "stiffness_error": max(found.deviation / found.drive_stiffness, 0.05),
    }
    how = " ".join(f"--set {name}={value}" for name, value in settings.items())
    unloaded = f"{laboratory}/unloaded.csv --robot forceps -e ukf_friction"
    call.good(f"calibrate {unloaded} {how} -o loads.st")

    call(f"correct loads.st {hung[0]} -o table.csv")
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


def test_what_tells_nothing_is_one_line(call, laboratory):
    line = "rezero {0}/jaw.st {0}/hung_along.parquet --motor {0}/jaw.st -o never.st"
    call.refuses("turns round 0 times", line.format(laboratory))
    assert not Path("never.st").exists()
