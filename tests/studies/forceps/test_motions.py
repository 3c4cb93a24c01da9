import math

import numpy as np
import pytest

from truejoint.simulation.forceps.load import LoadTest
from truejoint.simulation.forceps.specimens import specimen
from truejoint.simulation.forceps.twin import ZeroShift, simulate_forceps
from truejoint.studies.forceps.methods import record_forceps

T = np.arange(2001) / 1000
MOTION = np.radians(10.0) * np.sin(3.0 * T)


@pytest.fixture(scope="module")
def run():
    return simulate_forceps(specimen("A"), MOTION, seed=7)


def test_the_columns_are_the_runs_with_units(run):
    recording = record_forceps(specimen("A"), MOTION, seed=7)
    assert recording.robot.name == "forceps"
    for column, values, unit in (
        ("measured/jaw", run.motor[:, 0] * 9.75 / (35 * 4.0), "rad"),
        ("setpoint/jaw", run.setpoint[:, 0], "rad"),
        ("motor/jaw", run.motor[:, 0], "rad"),
        ("cable/drive", run.extra["cable/drive"], "m"),
        ("cable/reset", run.extra["cable/reset"], "m"),
        ("truth/jaw", run.truth.position[:, 0], "rad"),
        ("truth_exact/jaw", run.joint[:, 0], "rad"),
        ("truth_load/jaw", run.extra["truth_load/jaw"], "Nm"),
        ("truth_tension/drive", run.extra["truth_tension/drive"], "N"),
        ("truth_tension/reset", run.extra["truth_tension/reset"], "N"),
    ):
        np.testing.assert_allclose(recording.column(column), values, rtol=1e-14, err_msg=column)
        assert recording.units[column] == unit
    assert recording.joints_of("truth") == ("jaw",)
    error = run.truth.position[:, 0] - recording.column("measured/jaw")
    np.testing.assert_allclose(recording.error(("jaw",))[:, 0], error)


def test_the_provenance_says_which_instrument_homing_and_load():
    plain = record_forceps(specimen("A"), MOTION, seed=7).provenance
    assert plain.source == "virtual forceps, seed 7"
    assert plain.load == 0.0
    assert plain.rates == {"state": pytest.approx(200.0)}
    shifted = record_forceps(specimen("A"), MOTION, zero_shift=ZeroShift(reset=5e-6)).provenance
    assert shifted.homing_id != plain.homing_id
    test = LoadTest(0.1, "along", start=0.1, speed=math.radians(60), loaded_from=1.0,
                    loaded_to=1.2, end=1.5)  # fmt: skip
    loaded = record_forceps(specimen("A"), test).provenance
    assert (loaded.load, loaded.session) == (0.1, "load 0")
    assert "100 g along" in loaded.notes


@pytest.mark.parametrize(
    ("values", "columns"),
    [
        ({"drive_encoder.installed": False}, ("reset",)),
        ({"drive_encoder.installed": False, "reset_encoder.installed": False}, ()),
        ({}, ("drive", "reset")),
    ],
)
def test_a_sensor_that_is_not_installed_leaves_no_column(values, columns):
    recording = record_forceps(specimen().with_values(values), MOTION)
    assert recording.joints_of("cable") == columns
