"""The study of wristed instruments: its motions, its loads, and what it must show."""

from __future__ import annotations

from unittest.mock import patch

import numpy as np
import pytest

from truejoint.drawing import png
from truejoint.errors import StudyError, TruejointError
from truejoint.estimators.cables import learn as cable_filter
from truejoint.estimators.filtered import Estimate
from truejoint.recordings import Provenance, Recording
from truejoint.robots.wrist.instruments import JOINTS
from truejoint.simulation.wrist.twin import WristTwin
from truejoint.studies import PartResult, Results, get_study
from truejoint.studies.rows import select
from truejoint.studies.wrist import motions
from truejoint.studies.wrist.accuracy import LOADS, honesty, judge, summarise

FEW = {
    "free_s": "20", "loaded_s": "12", "test_s": "8", "count": "1", "family": "measured",
    "methods": "coupling,linear_motor,play_motor,model,play_effort,filter",
}  # fmt: skip


@pytest.fixture(scope="module")
def result():
    settings = get_study("wrist").settings("small", options=FEW)
    (part,) = get_study("wrist").parts(settings)
    with patch.object(cable_filter, "_ROUNDS", 8):
        return Results.of(settings, [part], {part.key: PartResult(part.compute(**part.arguments))})


def of(result, kind, **where):
    return select(result.rows, of=kind, **where)


def rms(result, method, test):
    return np.degrees(of(result, "angle", method=method, test=test)[list(JOINTS)].to_numpy()[0])


def test_plays_know_what_the_coupling_and_a_line_do_not(result):
    free = {key: rms(result, key, "free") for key in ("coupling", "linear_motor", "play_motor")}
    assert (free["play_motor"] < 0.5 * free["linear_motor"]).all()
    assert (free["linear_motor"] < free["coupling"]).all()


def test_the_model_knows_from_motors_alone_where_unloaded_joints_are(result):
    assert (rms(result, "model", "free") < 0.6 * rms(result, "linear_motor", "free")).all()
    assert (rms(result, "model", "loaded") > 1.5 * rms(result, "filter", "loaded"))[1:].all()


def test_only_effort_sees_a_load(result):
    blind, seen = (rms(result, key, "loaded") for key in ("play_motor", "play_effort"))
    assert (seen < 0.6 * blind).all()


def test_a_grip_is_told_from_none(result):
    loads = of(result, "load", method="play_effort", name="grip").set_index("test")
    assert loads["size"]["free"] == 0.0
    assert loads.rms["free"] < 0.1 * loads["size"]["loaded"]
    assert loads.rms["loaded"] < 0.3 * loads["size"]["loaded"]


def test_the_filter_finds_the_instrument_and_says_how_well_it_knows_it(result):
    (found,) = of(result, "identified", name="jaw1_stiffness").itertuples()
    assert 110e3 < found.value < 200e3  # of 135-180
    assert 0.0 < found.deviation < 0.2 * found.value
    assert (rms(result, "filter", "loaded") < 0.6 * rms(result, "play_motor", "loaded")).all()
    honest = of(result, "honesty")
    assert honest[honest.name == "angle"].nees.between(0.1, 8.0).all()
    assert (honest[honest.name == "load"].covered > 0.6).all()


def test_what_errs_as_stated_is_honest_and_what_states_half_is_not():
    rng, n = np.random.default_rng(1), 4000
    angle, load = 0.01 * rng.normal(size=(n, 3)), 0.002 * rng.normal(size=(n, 3))
    columns = {f"truth_exact/{name}": np.zeros(n) for name in JOINTS}
    columns |= {f"truth_load/{name}": np.zeros(n) for name in LOADS}
    columns |= {f"measured/{name}": np.zeros(n) for name in JOINTS}
    test = Recording.from_columns({"t": 0.005 * np.arange(n), **columns}, Provenance("wrist"))
    deviations = np.full((n, 3), 0.01), np.full((n, 3), 0.001)
    angle[: n // 10] = 1.0  # before what counts
    states = Estimate(angle, deviations[0], load, deviations[1], np.zeros((n, 15)))
    of_angle, of_load = honesty(states, test, 0.1 * test.t[-1], motion="free")
    assert of_angle["nees"] == pytest.approx(1.0, abs=0.05)
    assert of_angle["covered"] == pytest.approx(0.9, abs=0.02)
    assert of_load["nees"] == pytest.approx(4.0, abs=0.2)
    assert of_load["covered"] == pytest.approx(0.589, abs=0.02)


@pytest.mark.usefixtures("coarse")
def test_its_table_and_figures_can_be_drawn(result):
    summary = summarise(result)
    first = "coupling inverse, measured"
    assert [row[0] for row in summary.tables[0].rows][:1] == [first]
    assert len(summary.tables) == 4
    assert all(png(figure).startswith(b"\x89PNG") for figure in summary.figures.values())


def test_motions_stay_within_what_they_say():
    for motion in (motions.multi_sine, motions.steps):
        pose = np.degrees(motion(20.0, 3))
        assert len(pose) == 20_000
        assert (np.abs(pose).max(axis=0) <= np.array([55.0, 45.0, 40.0]) + 1e-9).all()
        assert pose[:, 2].min() >= 8.0 - 1e-9
        speed = np.abs(np.diff(pose, axis=0)).max() / 1e-3
        assert 10.0 < speed < 200.0
    assert not np.array_equal(motions.steps(5.0, 1), motions.steps(5.0, 2))
    joints = motions.joints(np.array([[0.1, 0.2, 0.3]]))
    np.testing.assert_allclose(joints, [[0.1, 0.05, 0.35]])


def test_jaws_close_on_what_they_hold_and_are_open_when_it_goes():
    pose = motions.multi_sine(12.0, 5)
    asked, held = motions.grips(pose, 5)
    there = held > 0.0
    assert 0.3 < there.mean() < 0.8
    # They are clear of it as it comes and as it goes, and press on it in between.
    apart = asked[:, 2] - held
    changes = np.flatnonzero(np.diff(there.astype(int)))
    assert (apart[changes] > 0.04).all()
    assert apart[there].min() < -0.05
    np.testing.assert_array_equal(asked[:, :2], pose[:, :2])


def test_a_load_grips_half_of_the_time_and_comes_off_again():
    twin = WristTwin(seed=1)
    twin.home()
    run = motions.record(twin, motions.steps, 12.0, 5, load=True)
    grip = run.column("truth_load/grip")
    assert 0.2 < np.mean(grip > 0.01) < 0.7
    assert 0.03 < grip.max() < 0.3
    assert np.abs(run.column("truth_load/pitch")).max() <= 2.0 * 19e-3
    free = motions.record(twin, motions.steps, 3.0, 6, load=False)
    assert free.column("truth_load/grip").max() == 0.0


def test_what_cannot_be_is_refused():
    study = get_study("wrist")
    with pytest.raises(StudyError, match="no method called 'plays'"):
        study.parts(study.settings(options={"methods": "plays"}))
    with pytest.raises(TruejointError, match="no family called 'rods'"):
        study.parts(study.settings(options={"family": "rods"}))
    with pytest.raises(TruejointError, match="no arm called '42'"):
        study.parts(study.settings(options={"instrument": "42"}))
    with pytest.raises(StudyError, match=r"free_s=-1\.0; it must be above 0"):
        study.parts(study.settings(options={"free_s": "-1"}))
    with pytest.raises(StudyError, match="test_s=1; it must be above 2"):
        study.parts(study.settings(options={"test_s": "1"}))
    assert judge.__module__ == study.module
