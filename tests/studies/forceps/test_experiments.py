"""The forceps studies: what they must show, and what they refuse."""

import os
from functools import partial

import numpy as np
import pytest
from pandas import DataFrame

from truejoint.errors import CommandRefused, StudyError, TruejointError
from truejoint.motion import nested_motion
from truejoint.robots import get_robot
from truejoint.simulation.forceps.parameters import ForcepsParameters
from truejoint.simulation.forceps.specimens import specimen
from truejoint.studies import get_study, run_study
from truejoint.studies.claim_tests import below_all
from truejoint.studies.forceps import closed_loop, load, methods, population
from truejoint.studies.forceps.methods import record
from truejoint.studies.rows import select

FEW = "lsm,lsm_compensated,ukf_compensated,play_gated"


@pytest.fixture
def briefer(monkeypatch):
    """Motions of 21 s, a period of (27), and nested loops of half a minute."""
    paths = {name: methods._TRAJECTORIES[name] for name in ("calibration", "verification")}
    brief = {name: partial(path, 21.0) for name, path in paths.items()}
    brief["nested"] = partial(nested_motion, get_robot("forceps"), 30.0, rate=1000.0)
    monkeypatch.setattr(methods, "_TRAJECTORIES", brief)
    for kept in (methods.record, methods.calibrated):
        kept.cache_clear()
    yield
    for kept in (methods.record, methods.calibrated):
        kept.cache_clear()


@pytest.fixture
def swift(briefer, monkeypatch):
    """Load tests of 10.5 s, as a sweep has them."""
    whole = methods.load_test
    monkeypatch.setattr(methods, "load_test", lambda *test, **_: whole(*test, **population._WEIGHT))


@pytest.fixture(scope="module")
def unloaded():
    """Three draws; the first is that of a page of the manual, which is tried elsewhere."""
    kept = os.environ["TRUEJOINT_TEST_MODELS"]
    return run_study("forceps-unloaded", {"methods": FEW, "draws": 3}, folder=kept)


def test_table_2_has_the_order_of_the_paper(unloaded, drawn):
    errors = select(unloaded.rows, motion="verification", draw=0).set_index("method")
    rms = np.degrees(errors.rms)
    assert rms["lsm"] > rms["lsm_compensated"] > rms["ukf_compensated"]
    assert rms["ukf_compensated"] <= 0.14
    assert np.degrees(errors.largest["ukf_compensated"]) <= 0.55
    assert rms["play_gated"] <= 0.05
    # The encoder's own error is learnt.
    assert errors.exact_rms["play_gated"] > errors.rms["play_gated"]
    assert drawn(unloaded)


def test_errors_are_those_of_the_estimates(unloaded):
    part = unloaded.parts["unloaded-0"]
    error = part.arrays["verification/lsm"] - part.arrays["verification/truth"]
    (numbers,) = select(unloaded.rows, motion="verification", method="lsm", draw=0).itertuples()
    assert part.arrays["verification/t"][0] == pytest.approx(2.205)
    assert part.arrays["verification/t"][-1] == pytest.approx(64.83, abs=5e-3)
    assert numbers.rms == np.sqrt(np.mean(error**2))
    assert (numbers.largest, numbers.smallest) == (error.max(), error.min())


def test_tables_say_what_the_numbers_are(unloaded):
    text = unloaded.summary.tables[0].markdown()
    assert "| least squares (29) | motor, x1, x2 | 0.522 | 0.57 | 1.62 | 1.45 |" in text
    assert "specimen A" in text


def test_claims_of_the_paper_are_judged(unloaded):
    verdicts = {claim.text: claim.verdict for claim in unloaded.summary.claims}
    assert verdicts["the filter's RMS error on (28) stays below 0.2 deg"] == "holds"
    assert verdicts["the filter's largest error on (28) stays below 0.5 deg"] == "cannot be told"
    assert verdicts[
        "least squares err more than compensated ones, and those more than the filter"
    ] == ("holds")
    amplitude = "the filter's error amplitude is about 49 % below that of compensated least squares"
    assert verdicts[amplitude] == "holds"
    assert verdicts["the filter errs most where the jaw reverses"] == "holds"
    first = "the filter's errors on (27): maximum 0.27, minimum -0.20, RMS 0.06 deg"
    assert verdicts[first] == "does not"  # its minimum is -0.32
    assert len(verdicts) == 12


def test_errors_at_reversals_are_those_within_half_a_second(unloaded):
    arrays = unloaded.parts["unloaded-0"].arrays
    t, error = arrays["calibration/t"], arrays["calibration/lsm"] - arrays["calibration/truth"]
    quarter = np.pi / 2 / 0.3  # (27) reverses at the odd ones
    turning = np.abs((t / quarter + 1.0) % 2.0 - 0.0)
    turning = np.minimum(turning, 2.0 - turning) * quarter <= 0.5
    (row,) = select(unloaded.rows, motion="calibration", method="lsm", draw=0).itertuples()
    assert row.reversing == pytest.approx(np.sqrt(np.mean(error[turning] ** 2)), rel=1e-2)
    assert row.between == pytest.approx(np.sqrt(np.mean(error[~turning] ** 2)), rel=1e-2)


@pytest.mark.usefixtures("briefer")
def test_table_3_separates_the_methods(drawn):
    options = {"masses_g": "250", "methods": "ukf_compensated,play_gated", "draws": 2}
    result = run_study("forceps-loaded", options)
    assert list(result.parts) == [
        f"250g-{way}{draw}" for draw in ("", "-1") for way in ("opposing", "along")
    ]
    cases = result.rows
    worst = np.degrees(cases.groupby(["method", "phase", "direction"]).rms.max())
    assert worst["ukf_compensated", "I"].max() <= 0.2
    assert worst["play_gated", "IV"].max() <= 0.15
    assert worst["ukf_compensated", "IV", "along"] > 0.5
    assert "0.12/0.05/0.29" in result.summary.tables[0].markdown()
    verdicts = [claim.verdict for claim in result.summary.claims]
    assert verdicts[1:3] == ["holds", "holds"]  # of phases I and II
    assert verdicts[4] != "holds"  # of phase IV
    assert {claim.number for claim in result.summary.claims} == {"Y14", "Y15", "Y16", "Y17", "Y19"}
    (hung, loaded) = (select(cases, phase=phase).deviation.mean() for phase in ("III", "IV"))
    assert hung > 2.0 * loaded, "the hand shakes the jaw"
    # The hand's draw counts: the table says how much, and the claims take the worst.
    spread = result.summary.tables[1]
    one = {"method": "ukf_compensated", "phase": "IV", "direction": "opposing"}
    both = select(cases, **one).rms
    least, largest = sorted(f"{np.degrees(value):.3f}" for value in both)
    assert spread.rows[0][2].endswith(f"({least} to {largest})")
    assert least != largest
    most, _, smallest = result.summary.tables[2].rows[0][2].partition("/")
    assert float(smallest.replace("\N{MINUS SIGN}", "-")) < 0.0 < float(most) < 0.5
    assert "0.33/\N{MINUS SIGN}0.22" in result.summary.tables[2].rows[0][1]
    # Nothing is cut off in figure 9.
    along = result.summary.figures["forceps-loaded"].panels[0][1]
    assert np.abs(along.curves[0].y).max() > 2.0
    angles = result.summary.figures["forceps-loaded-angles"].panels[0][1]
    assert np.max(angles.curves[0].y) > 30.0
    assert drawn(result)


@pytest.mark.usefixtures("swift")
def test_a_sensor_on_the_reset_cable_sees_a_weight(drawn):
    options = {
        "specimen": "B",
        "masses_g": "100",
        "methods": "play_motor,play_gated,play_cables",
        "draws": 1,
    }
    result = run_study("forceps-strategies", options)
    rms = select(result.rows, phase="IV").groupby("method").rms.max()
    assert rms["play_motor"] > rms["play_cables"] > rms["play_gated"]
    assert drawn(result)


@pytest.mark.usefixtures("briefer")
def test_a_larger_population_begins_with_the_smaller(drawn, tmp_path):
    one, two = (
        run_study("forceps-population", {"count": n, "methods": FEW}, folder=tmp_path)
        for n in (1, 2)
    )
    assert two.computed == 1
    assert one.parts["specimen-00000"].rows == two.parts["specimen-00000"].rows
    assert drawn(two)


@pytest.mark.usefixtures("briefer")
def test_other_frictions_and_weights_are_judged_together(drawn):
    options = {"count": 1, "masses_g": "100", "methods": "ukf_compensated,play_gated"}
    result = run_study("forceps-mixed", options)
    rows = select(result.rows, method="play_gated")
    ours, *_ = rows.itertuples()
    (paper,) = select(result.rows, method="ukf_compensated", load="unloaded").rms
    assert np.degrees(ours.rms) < 0.05
    assert ours.rms < paper
    assert list(rows.load) == ["unloaded", "100 g opposing", "100 g along"]
    assert 0.85 < ours.inside < 0.98
    (table,) = result.summary.tables
    assert table.notes[1].startswith("gated plays (our default): a stated 90 % holds in")
    assert drawn(result)


def test_a_rope_that_is_pulled_tighter_stays_on_its_line():
    plant = ForcepsParameters.read("A")
    tight = methods.tensioned(plant, 2.0)
    assert tight.assembly.pretension == 2.0 * plant.assembly.pretension
    before, after = plant.drive_cable, tight.drive_cable
    slope = before.stiffening * before.stiffness / plant.assembly.pretension  # [1/m]
    assert after.stiffening * after.stiffness / tight.assembly.pretension == pytest.approx(slope)
    assert after.stiffness == pytest.approx(
        before.stiffness + slope * plant.assembly.pretension, rel=1e-12
    )
    assert methods.tensioned(plant, 1.0) == plant
    with pytest.raises(TruejointError, match=r"pretension"):
        methods.tensioned(plant, 100.0)
    settings = get_study("forceps-unloaded").settings("small", options={"tension": 2.0})
    assert methods.common_arguments(settings)["forceps"] == tight.to_dict()


def test_more_tension_is_judged_specimen_by_specimen(swift):
    few = {"tensions": "0.5,2", "count": 1, "masses_g": "100", "methods": "ukf_compensated"}
    result = run_study("forceps-tension", few | {"priors": "capstan"})
    assert list(result.parts) == ["capstan-00000-0.5", "capstan-00000-2"]
    (claim,) = result.summary.claims
    assert (claim.verdict, claim.number) == ("cannot be told", "Y20")
    assert claim.test.endswith("n = 1")
    mean = np.degrees(result.rows[result.rows.load != "unloaded"].groupby("tension").rms.mean())
    assert f"{mean.iloc[0]:.2f} deg at 0.5" in claim.found
    assert "0.5 of the tension, IV, capstan" in result.summary.tables[0].markdown()


def test_shares_count_specimens():
    rms = DataFrame({"ukf_compensated": [2.0, 1.0, 4.0, 3.0], "play_gated": [1.0, 2.0, 1.0, 1.0]})
    assert population.share(rms, "ukf_compensated", "play_gated") == 0.75
    assert population.share(rms, "play_gated", "ukf_compensated", "play_gated") == 0.0


@pytest.mark.usefixtures("briefer")
def test_a_load_swings_in_no_loop():
    methods = "ukf_compensated,play_gated"
    result = run_study(
        "forceps-swinging", {"count": 2, "swings_hz": "1", "mass_g": 100, "methods": methods}
    )
    loads = ["unloaded", "0 Hz, shutting", "1 Hz, shutting", "0 Hz, opening", "1 Hz, opening"]
    assert list(result.rows.load.unique()) == loads
    worst = result.rows.groupby(["method", "load"], sort=False).rms.max().unstack()
    assert (worst.drop(columns="unloaded").ge(worst.unloaded, axis=0)).all(axis=None)
    errors = result.rows.set_index(["session", "load", "method"]).rms
    ours, paper = (
        [[errors[n, load, method] for n in (0, 1)] for load in loads[2::2]]
        for method in ("play_gated", "ukf_compensated")
    )
    (claim,) = result.summary.claims
    assert claim.number.startswith("O")
    assert claim.holds == below_all([*zip(ours, paper, strict=True)])
    study = get_study("forceps-swinging")
    for wrong, said in ({"mass_g": -100}, r"a load of -0\.1 kg"), ({"swings_hz": "-1"}, "at -1 Hz"):
        with pytest.raises(TruejointError, match=said):
            study.parts(study.settings(options=wrong))


@pytest.mark.usefixtures("briefer")
def test_loads_are_weighed(monkeypatch):
    monkeypatch.setattr(load, "CALIBRATION_WEIGHTS", (0.1, 0.25))
    monkeypatch.setattr(load, "_CYCLES", 1)
    result = run_study("forceps-load", {"specimen": "nominal", "masses_g": "200"})
    opposing, along, unloaded = result.rows.itertuples()
    assert along.identified == pytest.approx(along.torque, rel=0.1)
    missed = abs(opposing.identified - opposing.torque)
    assert missed < 2.0 * along.true_friction + 0.1 * abs(along.torque)
    assert along.drive_stiffness == pytest.approx(along.true_stiffness, rel=0.05)
    errors = next(row for row in result.summary.tables[1].rows if row[0].startswith("load along"))
    assert float(errors[3]) < 25.0
    assert 0.8 < unloaded.angle_inside < 0.99
    weights, errors = result.summary.tables
    assert "Dead band" in weights.markdown()
    assert "Stiffness within 5 % in 100 %." in errors.markdown()


@pytest.mark.usefixtures("briefer")
def test_the_jaw_follows_in_a_closed_loop(drawn):
    options = {
        "specimen": "B", "methods": "play_gated", "swings_hz": "2", "seconds": 2.6, "count": 1,
        "rate_hz": 125, "gain": 1, "prior": "capstan",
    }  # fmt: skip
    result = run_study("forceps-closed-loop", options)
    for number in range(4):  # no load, steady both ways, swinging
        open_loop, closed = select(result.rows, case=number).itertuples()
        assert closed.rms < np.radians(0.25) < 4 * closed.rms + open_loop.rms
        assert closed.rms < 0.2 * open_loop.rms
        assert closed.corrected > 0.99
    assert drawn(result)


def test_a_loop_that_refuses_is_not_within(monkeypatch):
    """A weight that slackens the cable: no set-point takes the jaw where it is wanted."""

    def refuses(*_arguments, **_how):
        raise CommandRefused("no set-point reaches it")

    monkeypatch.setattr(closed_loop, "follow_jaw", refuses)
    loads = {"steady": (0.1, 0.0, False)}
    (row,) = closed_loop.track(specimen("A").to_dict(), (), ["open"], loads, number=0, seconds=0.1)
    none = {key: row[key] for key in ("rms", "exact_rms", "corrected")}
    assert none == {"rms": None, "exact_rms": None, "corrected": None}
    good = {"rms": np.radians(0.05)}
    every = [
        {"specimen": n, "load": load, "name": "open loop", **found}
        for n, cases in enumerate(((good, good), (good, none)))
        for load, found in zip(("none", "steady"), cases, strict=True)
    ]
    settings = get_study("forceps-closed-loop").settings()
    table = closed_loop._spread(settings, DataFrame(every).astype({"rms": float}))
    assert [row[1:] for row in table.rows] == [
        ("0.050", "0.050", "0.050", "100 %"),
        ("0.050", "0.050", "0.050", "50 %"),
    ]
    assert "1; not within" in table.notes[1]


@pytest.mark.usefixtures("briefer")
def test_a_sweep_says_which_sensors_a_designer_needs():
    options = {
        "layouts": "motor,x2,motor+x2", "resolutions_um": "1,20", "stiffnesses_kNm": "6",
        "homings_um": "0,10", "count": 1,
    }  # fmt: skip
    result = run_study("forceps-sweep", options)
    soft = result.rows.set_index(["layout", 1e6 * result.rows.resolution, 1e6 * result.rows.homing])
    unloaded = soft.unloaded
    assert unloaded["x2", 1, 0] < unloaded["x2", 20, 0]
    assert unloaded["x2", 1, 0] < unloaded["x2", 1, 10]
    assert soft.loaded["x2", 1, 0] < 0.1 * soft.loaded["motor", 1, 0]
    assert ("motor", 20, 0) not in soft.index  # nothing that a cable's encoder changes
    median, worst = result.summary.tables
    assert median.rows == worst.rows  # of one specimen
    assert len(median.rows) == 1 + 2 * 2 * 2
    assert "Designs that keep 0.1 deg on every specimen" in median.notes[1]


@pytest.mark.usefixtures("briefer")
def test_a_method_without_its_sensor_is_left_out(tmp_path):
    file = tmp_path / "bare.toml"
    file.write_text("[drive_encoder]\ninstalled = false\n", encoding="utf-8")
    options = {"specimen": file, "methods": "lsm,play_reset", "draws": 1}
    result = run_study("forceps-unloaded", options)
    (table,) = result.summary.tables
    assert [row[0] for row in table.rows] == ["plays on x2"]
    assert table.notes[-1] == "Left out, since a sensor is not installed: least squares (29)."
    with pytest.raises(StudyError, match="no sensors for lsm"):
        run_study("forceps-unloaded", {"specimen": file, "methods": "lsm"})


def test_a_motion_that_is_none_is_refused():
    with pytest.raises(TruejointError, match="choose one of calibration"):
        record(specimen(), "sine")
