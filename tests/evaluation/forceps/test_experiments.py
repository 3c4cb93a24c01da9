"""The forceps experiments: what they must show, what they keep, and what they refuse."""

from __future__ import annotations

import json

import numpy as np
import pytest

from truejoint.errors import CalibrationError, TruejointError
from truejoint.evaluation.forceps import (
    METHODS,
    PopulationStudy,
    compare_forces,
    compare_homing,
    compare_loaded,
    compare_strategies,
    compare_unloaded,
    study_population,
)
from truejoint.evaluation.forceps.figures import (
    plot_loaded,
    plot_population,
    plot_strategies,
    plot_unloaded,
)
from truejoint.evaluation.forceps.plant import record_motion
from truejoint.simulation.forceps.specimens import population, specimen

PNG = b"\x89PNG\r\n"
FEW = ("lsm", "lsm_compensated", "ukf_compensated", "play_reset", "play_gated")


@pytest.fixture(scope="module")
def table_2():
    return compare_unloaded(specimen("A"), specimen="A", methods=FEW)


def test_table_2_has_the_order_of_the_paper(table_2, tmp_path):
    rms = {key: np.degrees(error.rms) for key, error in table_2.verification_errors.items()}
    assert rms["lsm"] > rms["lsm_compensated"] > rms["ukf_compensated"]
    assert rms["ukf_compensated"] <= 0.14
    assert np.degrees(table_2.verification_errors["ukf_compensated"].largest) <= 0.55
    assert rms["play_gated"] <= 0.05
    error = table_2.verification_errors["play_gated"]
    assert error.exact_rms > error.rms  # the encoder's own error is learnt
    plot_unloaded(table_2, tmp_path / "figure.png")
    assert (tmp_path / "figure.png").read_bytes().startswith(PNG)


def test_tables_say_what_the_numbers_are(table_2):
    text = table_2.table().markdown()
    assert "| least squares (29) |" in text
    assert " 0.57 |" in text  # the paper's
    plain = json.loads(json.dumps(table_2.to_dict()))
    assert plain["verification"]["lsm"]["rms_deg"] == pytest.approx(
        np.degrees(table_2.verification_errors["lsm"].rms)
    )


def test_table_3_separates_the_methods(tmp_path):
    result = compare_loaded(specimen("A"), masses=(0.2,), methods=("ukf_compensated", "play_gated"))
    assert len(result.cases) == 2
    assert result.worst("ukf_compensated", "I") <= np.radians(0.2)
    assert result.worst("play_gated", "IV") <= np.radians(0.15)
    assert result.worst("ukf_compensated", "IV", "along") > np.radians(0.5)
    assert "0.15/0.06/0.40" in result.table().markdown()
    plot_loaded(result, tmp_path / "figure.png")
    assert (tmp_path / "figure.png").read_bytes().startswith(PNG)


def test_strategies_name_their_sensors(tmp_path):
    result = compare_strategies(
        specimen("B"), masses=(0.1,), methods=("play_motor", "play_gated", "play_cables")
    )
    assert [row[1] for row in result.table().rows] == ["1", "2", "3"]
    assert result.unloaded["play_motor"].rms > result.unloaded["play_gated"].rms
    plot_strategies(result, tmp_path / "figure.png")
    assert (tmp_path / "figure.png").read_bytes().startswith(PNG)


def test_population_goes_on_where_it_stopped(tmp_path):
    keep = tmp_path / "population.jsonl"
    methods = ("ukf_compensated", "play_gated")
    fractions: list[float] = []
    study_population(1, methods=methods, keep=keep)
    first = keep.read_text()
    keep.write_text(first + first[: len(first) // 2])  # cut short by a crash
    study = study_population(2, methods=methods, keep=keep, progress=fractions.append)
    assert keep.read_text().startswith(first)
    assert len(keep.read_text().splitlines()) == 2
    assert fractions == [0.5, 1.0]
    assert np.array_equal(study_population(2, methods=methods).rms, study.rms)
    plot_population(study, tmp_path / "figure.png")
    with pytest.raises(TruejointError, match="another study"):
        study_population(2, methods=methods, seed=1, keep=keep)
    keep.write_text("not a trial\n" + first)
    with pytest.raises(TruejointError, match="line 1 is not a trial"):
        study_population(2, methods=methods, keep=keep)


def test_shares_and_ratios_count_specimens():
    rms = np.array([[2.0, 1.0], [1.0, 2.0], [4.0, 1.0], [3.0, 1.0]])
    study = PopulationStudy(0, 0.0, ("ukf_compensated", "play_gated"), rms, rms)
    assert study.share("ukf_compensated", "play_gated") == 0.75
    assert study.median_ratio("ukf_compensated", "play_gated") == 2.5
    assert study.to_dict()["orderings"] == {"ukf_compensated > play_gated": 0.75}


def test_loads_are_weighed():
    result = compare_forces(specimen("nominal"), masses=(0.2,))
    opposing, along = result.estimates
    assert along.identified == pytest.approx(along.torque, rel=0.15)
    assert abs(opposing.identified - opposing.torque) < result.dead_band + 0.15 * abs(along.torque)
    assert "Dead band" in result.table().markdown()


def test_homing_is_mended():
    (case,) = compare_homing(specimen("B"), shifts=(2e-5,), methods=("play_gated",)).cases
    assert case.found == pytest.approx(2e-5, abs=3e-6)
    assert case.before["play_gated"].rms > np.radians(0.2)
    assert case.after["play_gated"].rms < np.radians(0.06)


def test_a_changed_cable_changes_what_rigid_cables_miss():
    """A designer's question: a stiffer cable must help whoever has no sensor on it."""
    soft, stiff = (
        compare_unloaded(
            specimen("nominal").with_values(
                {"drive_cable.stiffness": k, "reset_cable.stiffness": k}
            ),
            methods=("rigid",),
        ).verification_errors["rigid"].rms
        for k in (9e3, 17e3)
    )  # fmt: skip
    assert stiff < soft


def test_motions_become_recordings():
    recording = record_motion(population(1)[0], "load", load=0.05, log_rate=50.0)
    assert recording.provenance.load == 0.05
    assert "truth/jaw" in recording.units
    with pytest.raises(TruejointError, match="choose one of calibration"):
        record_motion(specimen("A"), "sine")


def test_unknown_methods_are_refused():
    with pytest.raises(CalibrationError, match=f"known: {', '.join(list(METHODS)[:2])}"):
        compare_unloaded(specimen("A"), methods=("lsm", "svm"))
