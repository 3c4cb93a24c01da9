"""The study of wristed instruments: its motions, its loads, and what it must show."""

from types import SimpleNamespace
from unittest.mock import patch

import numpy as np
import pytest

from truejoint.drawing import png
from truejoint.estimators import CableFilter
from truejoint.estimators.cables import learn as cable_filter
from truejoint.estimators.filtered import Estimate
from truejoint.recordings import Provenance, Recording
from truejoint.robots.wrist.instruments import JOINTS
from truejoint.simulation.wrist.twin import WristTwin
from truejoint.studies import PartResult, Results, get_study
from truejoint.studies.rows import select
from truejoint.studies.wrist import accuracy as motions
from truejoint.studies.wrist.accuracy import LOADS, judged, summarise

FEW = {
    "free_s": "20", "loaded_s": "12", "test_s": "8", "count": "1", "family": "measured",
    "estimators": "linear,rich_play,ukf_cables",
}  # fmt: skip


@pytest.fixture(scope="module")
def result():
    settings = get_study("wrist").settings("small", options=FEW)
    (part,) = get_study("wrist").parts(settings)
    with patch.object(cable_filter, "_ROUNDS", 8):
        return Results.of(settings, [part], {part.key: PartResult(part.compute(**part.arguments))})


def rms(result, method, test):
    (row,) = select(result.rows, of="angle", method=method, test=test)[list(JOINTS)].to_numpy()
    return np.degrees(row)


def test_plays_know_what_the_coupling_and_a_line_do_not(result):
    free = {key: rms(result, f"{key}, motors", "free") for key in ("linear", "rich_play")}
    assert free["rich_play"].mean() < 0.5 * free["linear"].mean()
    assert (free["rich_play"] < free["linear"]).all()
    assert (free["linear"] < rms(result, "raw", "free")).all()


def test_only_effort_sees_a_load(result):
    blind = rms(result, "rich_play, motors", "loaded")
    assert (rms(result, "ukf_cables", "loaded") < 0.6 * blind).all()
    assert (rms(result, "rich_play", "loaded") < 0.6 * blind)[1:].all()  # a grip moves the jaws


def test_a_grip_is_told_from_none(result):
    loads = select(result.rows, of="load", load="grip").set_index("test")
    assert loads["size"]["free"] == 0.0
    assert loads.rms["free"] < 0.1 * loads["size"]["loaded"]
    assert loads.rms["loaded"] < 0.3 * loads["size"]["loaded"]
    assert (select(result.rows, of="load").inside > 0.6).all()


def test_what_errs_as_stated_is_honest_and_what_states_half_is_not():
    rng, n = np.random.default_rng(1), 4000
    angle, load = 0.01 * rng.normal(size=(n, 3)), 0.002 * rng.normal(size=(n, 3))
    columns = {f"truth_exact/{name}": np.zeros(n) for name in JOINTS}
    columns |= {f"truth_load/{name}": np.zeros(n) for name in LOADS}
    columns |= {f"measured/{name}": np.zeros(n) for name in JOINTS}
    test = Recording.from_columns({"t": 0.005 * np.arange(n), **columns}, Provenance("wrist"))
    angle[: n // 10] = 1.0  # before what counts
    deviations = np.full((n, 3), 0.01), np.full((n, 3), 0.001)
    states = Estimate(angle, deviations[0], load, deviations[1], np.zeros((n, 15)))
    model = SimpleNamespace(
        model=CableFilter(), gap_limit=1.0, correct=lambda _: angle,
        feature_set=SimpleNamespace(compute=lambda *_: np.zeros((n, 6))),
    )  # fmt: skip
    with patch.object(CableFilter, "states", lambda *_: states):
        of_angle, *of_loads = judged(model, test, method="filter", test="free")
    assert of_angle["pitch"] == pytest.approx(0.01, rel=0.05)
    assert of_angle["inside"] == pytest.approx(0.9, abs=0.02)
    assert [row["load"] for row in of_loads] == list(LOADS)
    for row in of_loads:
        assert row["inside"] == pytest.approx(0.589, abs=0.03)
        assert row["rms"] == pytest.approx(0.002, rel=0.05)


@pytest.mark.usefixtures("coarse")
def test_its_table_and_figures_can_be_drawn(result):
    summary = summarise(result)
    angles, loads = summary.tables
    assert [row[0] for row in angles.rows][:2] == ["raw, measured", "linear, motors, measured"]
    assert [row[0] for row in loads.rows] == ["ukf_cables, measured"]
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
