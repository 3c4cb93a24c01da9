"""Coverage of a stated interval in the evaluation and in the report."""

import base64
import io
import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from rich.console import Console

from truejoint.calibration import calibrate, find_zero, with_interval
from truejoint.evaluation import evaluate as judged
from truejoint.evaluation import interval_table, render_report
from truejoint.evaluation.scoring import coverage_of
from truejoint.recordings import Provenance, Recording, check_data

JOINTS = ("shoulder", "elbow", "insertion")


def inside(model, recordings, level):
    """Share of the samples of each recording that lie within the stated interval, by joint."""
    shares = []
    for recording in recordings:
        _, lower, upper = model.correct_with_interval(recording, level)
        truth = recording.columns("truth", model.joints)
        shares.append(((lower <= truth) & (truth <= upper)).mean(axis=0))
    return np.array(shares)


def motion(seed, *, homing="", shift=0.0, load=np.nan):
    """Half a minute of smooth motion with an error that follows the position."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 30.0, 0.05)
    columns: dict[str, np.ndarray] = {"t": t}
    for k, joint in enumerate(JOINTS):
        position = 0.5 + 0.1 * np.sin(0.4 * (k + 1) * t + rng.uniform(0, 6))
        noise = rng.normal(0.0, 1e-3, len(t))
        columns |= {
            f"measured/{joint}": position,
            f"effort/{joint}": np.cos(t) + rng.normal(0, 0.1, len(t)),
            f"truth/{joint}": position + 0.02 * (position - 0.4) + shift + noise,
        }
    about = {"source": f"m{seed}.parquet", "session": str(seed), "homing_id": homing, "load": load}
    return Recording.from_columns(columns, Provenance("raven2", "left", **about))


@cache
def checked():
    return check_data([motion(30)])


def evaluate(models, recordings):
    """Judge on data that were checked once: half of what it costs, and no matter of intervals."""
    return judged(models, recordings, check=checked())


@pytest.fixture(scope="module")
def calibration():
    features = [f"measured/{joint}" for joint in JOINTS]
    return calibrate([motion(0), motion(1)], "linear", features=features)


@pytest.fixture(scope="module")
def one_homing(calibration):
    return with_interval(calibration, [motion(seed, homing="h1") for seed in range(10, 22)])


@pytest.fixture(scope="module")
def many_homings(calibration):
    shifts = {seed: 2e-3 * np.sin(seed) for seed in range(10, 22)}
    homed = [motion(seed, homing=f"h{seed}", shift=shift) for seed, shift in shifts.items()]
    return with_interval(calibration, homed)


@pytest.fixture(scope="module")
def stated(calibration):
    return with_interval(calibration, [motion(seed) for seed in range(10, 22)])


@pytest.fixture(scope="module")
def alone(stated):
    return evaluate(stated, [motion(30)])


@pytest.fixture(scope="module")
def pair(stated):
    """Evaluation of two recordings, and its page."""
    found = evaluate(stated, [motion(30), motion(31)])
    return found, render_report(found)


def test_every_level_and_joint_is_stated(pair):
    found, _ = pair
    assert found.intervals[["level", "joint", "unit"]].to_numpy().tolist() == [
        [level, joint, "m" if joint == "insertion" else "rad"]
        for level in (0.8, 0.9)
        for joint in JOINTS
    ]
    assert found.to_dict()["intervals"][0]["level"] == 0.8
    assert "after the homing of its 12 trajectories only" in found.interval_note


def test_coverage_equals_that_of_the_estimators_package(many_homings):
    tests = [motion(seed, homing=f"h{seed}", shift=3e-3) for seed in (30, 31, 32)]
    found = evaluate(many_homings, tests)
    for level in many_homings.interval.levels:
        shares = inside(many_homings, tests, level)
        rows = found.intervals[found.intervals.level == level]
        np.testing.assert_allclose(rows.coverage, shares.mean(axis=0))
        error = shares.std(axis=0, ddof=1) / np.sqrt(len(tests))
        np.testing.assert_allclose(rows.standard_error, error)
        widths = np.mean([many_homings.half_widths(test, level).mean(axis=0) for test in tests], 0)
        np.testing.assert_allclose(rows.half_width, widths)
        np.testing.assert_allclose(np.transpose(rows.shares.tolist()), shares)


def test_recordings_after_one_homing_count_as_one_where_any_homing_may_come(many_homings):
    tests = [motion(30, homing="a"), motion(31, homing="a"), motion(32, homing="b")]
    found = evaluate(many_homings, tests)
    assert found.interval_trajectories == ("homing a", "homing b")
    apart = inside(many_homings, tests, 0.9)
    for k, shares in enumerate(found.intervals[found.intervals.level == 0.9].shares):
        assert shares == pytest.approx([apart[:2, k].mean(), apart[2, k]])


def test_a_homing_that_the_interval_does_not_hold_for_gives_no_number(one_homing):
    tests = [motion(30, homing="h2", shift=0.01), motion(31, homing="h1")]
    found = evaluate(one_homing, tests)
    assert found.interval_trajectories == ("m31.parquet",)
    (objection,) = found.interval_objections
    assert "not judged on m30.parquet: the interval holds after the homing h1, not" in objection
    known = found.rows["lower"].notna().all(axis=1).groupby(level=0)
    assert known.all().to_dict() == {"m30.parquet": False, "m31.parquet": True}
    assert not known.any()["m30.parquet"]
    alone = evaluate(one_homing, tests[:1])
    assert alone.intervals.empty
    page = render_report(alone)
    assert "holds after the homing h1, not after another" in page
    assert "found inside" not in page


def test_after_rezeroing_the_interval_of_one_homing_goes_with_the_new_one(one_homing):
    again = one_homing.at(find_zero(one_homing, motion(40, homing="h2", shift=0.01)))
    tests = [motion(30, homing="h2", shift=0.01), motion(31, homing="h1")]
    assert evaluate(again, tests).interval_trajectories == ("m30.parquet",)
    verdict = evaluate(again, [motion(40, homing="h2", shift=0.01)]).verdict
    assert any("re-zeroed on truth of m40.parquet" in remark for remark in verdict.doubts)


def test_a_homing_that_is_not_named_is_told(one_homing):
    found = evaluate(one_homing, [motion(30)])
    assert not found.intervals.empty
    assert "Not all recordings name their homing" in found.interval_note


def test_how_coverage_scatters_is_by_what_is_independent(stated, alone):
    """Shares of Beta(3, 1) where each of three recordings errs in its own way, not its parts."""
    few = replace(stated, interval=replace(stated.interval, folds=3, cut=3, whole=3))
    notes = alone.interval_note, evaluate(few, [motion(30)]).interval_note
    said = "to another its coverage scatters by up to about"
    assert f"one set of 12 trajectories {said} 7 %" in notes[0]
    assert f"one set of 3 recordings {said} 19 %" in notes[1]


def test_masses_that_the_interval_has_not_seen_are_told(calibration):
    recordings = [motion(seed, load=0.1 * (seed % 3)) for seed in range(10, 22)]
    stated = with_interval(calibration, recordings)
    heavy = evaluate(stated, [motion(30, load=0.5), motion(31, load=0.15)])
    assert "has not seen (500 g)" in heavy.interval_note
    assert len(heavy.interval_trajectories) == 2
    light = evaluate(stated, [motion(30, load=0.15), motion(31)])
    assert "has not seen" not in light.interval_note


def test_recordings_that_a_part_of_the_fit_saw_are_not_judged(stated, alone):
    tests = [motion(0), motion(12), motion(13), motion(30)]
    found = evaluate(stated, tests)
    assert found.interval_trajectories == ("m30.parquet",)
    assert found.interval_objections == (
        "Coverage is not judged on m0.parquet: used in the fit.",
        "Coverage is not judged on m12.parquet; m13.parquet: used to make the interval.",
    )
    assert found.intervals.coverage.tolist() == alone.intervals.coverage.tolist()


def test_too_few_inside_is_told_from_sampling_error():
    def agreement(*shares):
        return coverage_of(np.array(shares), 0.9)["agreement"]

    assert agreement(0.91, 0.88, 0.90) == "agrees"
    assert agreement(0.60, 0.62, 0.61) == "too few inside"
    assert agreement(0.99, 0.98, 0.99) == "more inside"
    assert agreement(0.2) == ""
    # Student's t with 1 degree of freedom: tan(0.475 pi), so 0.1 by that about 0.6.
    level = 0.6 + 0.1 * np.tan(0.475 * np.pi)
    for side, said in ((-1e-9, "agrees"), (1e-9, "too few inside")):
        assert coverage_of(np.array([0.5, 0.7]), level + side)["agreement"] == said


def test_the_band_holds_the_share_that_is_told(pair):
    found, _ = pair
    assert found.interval_level == 0.9
    rows = found.rows
    inside = (rows["lower"] <= rows["truth"]) & (rows["truth"] <= rows["upper"])
    shares = found.intervals[found.intervals.level == 0.9].set_index("joint").shares
    for joint, by_recording in inside.groupby(level=0).mean().items():
        assert shares[joint] == pytest.approx(by_recording.to_numpy())


def test_the_band_of_a_rezeroed_interval_follows_the_truth(calibration):
    recordings = [motion(seed, shift=0.01 * seed) for seed in range(10, 22)]
    again = with_interval(calibration, recordings, rezero=5.0)
    found = evaluate(again, [motion(30, homing="any", shift=0.5)])
    assert (found.rows["lower"].isna().all(axis=1) == (found.rows["t"] < 5.0)).all()
    kept = found.rows[(found.rows["t"] >= 5.0).to_numpy()]
    inside = ((kept["lower"] <= kept["truth"]) & (kept["truth"] <= kept["upper"])).to_numpy()
    assert inside.mean() > 0.8
    assert "re-zeroed from the first 5 s of each recording" in found.interval_note
    shares = found.intervals[found.intervals.level == 0.9].shares.str[0].to_numpy()
    assert shares == pytest.approx(inside.mean(axis=0))


def figures_of(page):
    start = page.index('id="figures">') + len('id="figures">')
    values = json.loads(page[start : page.index("</script>", start)])
    return {figure["key"]: figure for figure in values["figures"]}


def numbers(values):
    return np.frombuffer(base64.b64decode(values["bdata"]), "<f4")


def test_the_report_shows_stated_beside_found(pair):
    found, page = pair
    section = page[page.index('<section id="intervals">') :]
    section = section[: section.index("</section>")]
    assert "Stated uncertainty" in section
    assert section.count('<tr><th scope="row">') == 6
    assert "2 trajectories" in section
    figures = figures_of(page)
    for key in ("calibration", "coverage"):
        assert f'id="figure-{key}"' in section
        assert [d["name"] for d in figures[key]["variants"][0]["data"]][1:] == list(JOINTS)
    shown = figures["calibration"]["variants"][0]["data"][1]
    rows = found.intervals[found.intervals.joint == "shoulder"]
    np.testing.assert_allclose(numbers(shown["x"]), [80, 90], atol=0.5)
    np.testing.assert_allclose(numbers(shown["y"]), 100 * rows.coverage, rtol=1e-6)
    bars = numbers(shown["error_y"]["array"])
    np.testing.assert_allclose(bars, 100 * rows.standard_error, rtol=1e-5)


def test_the_curves_have_the_band_of_the_interval(stated, pair):
    _, page = pair
    upper, errors = (
        d for d in figures_of(page)["time-0"]["variants"][0]["data"] if d["name"] == "90 % interval"
    )
    width = np.degrees(stated.interval.half_width(0.9)[0])
    inner = numbers(errors["y"])
    assert np.nanmin(inner) <= -width * (1 - 1e-5)
    assert np.nanmax(inner) >= width * (1 - 1e-5)
    assert np.nanmedian(np.abs(inner)) == pytest.approx(width, rel=1e-4)
    assert upper["fill"] == "toself"
    assert "stated at 90 %" in page[: page.index('<table class="main">')]


@pytest.fixture(scope="module")
def weighed(calibration):
    """Evaluation under two masses and one that is not stated, without an interval, and its page."""
    tests = [motion(30, load=0.0), motion(31, load=0.5, shift=0.01), motion(32)]
    found = evaluate(calibration, tests)
    return found, render_report(found)


def test_without_an_interval_the_page_says_so(weighed):
    found, page = weighed
    assert found.intervals.empty
    assert np.isnan(found.interval_level)
    assert "The model states no interval" in page
    assert "90 % interval" not in page
    assert {"calibration", "coverage"}.isdisjoint(figures_of(page))


def test_an_interval_that_cannot_be_judged_does_not_stop_the_evaluation(calibration):
    recordings = [motion(seed) for seed in range(10, 22)]
    stated = with_interval(calibration, recordings, rezero=20.0)
    longer = replace(stated.interval, rezero=1e4)
    tests = [motion(30, load=0.0), motion(32)]
    found = evaluate({"linear": [replace(stated, interval=longer)]}, tests)
    assert found.intervals.empty
    assert "all truth lies within the 10000 s" in found.interval_objections[0]
    page = render_report(found)
    assert "all truth lies" in page
    assert "By hung mass" not in page  # of which there is one alone


def test_the_terminal_shows_it_too(pair):
    found, _ = pair
    console = Console(width=100, file=io.StringIO())
    console.print(interval_table(found))
    text = console.file.getvalue()
    assert "on 2 test trajectories" in text
    assert text.count("90 %") == 3
    shoulder = found.intervals.set_index("joint").loc["shoulder"].iloc[0]
    assert f"{100 * shoulder.coverage:.1f} ± {100 * shoulder.standard_error:.1f} %" in text
    assert "shoulder [deg]" in text


def test_masses_that_differ_are_compared(calibration, weighed):
    _, page = weighed
    table = page[page.index("By hung mass") :]
    table = table[: table.index("</section>")]
    assert table.count('<th scope="row">500 g') == 3
    assert table.count('<th scope="row">0 g') == 3
    heavy = motion(31, load=0.5, shift=0.01)
    error = heavy.column("truth/elbow") - calibration.correct(heavy)[:, 1]
    assert f">{np.degrees(np.sqrt(np.mean(error**2))):.3f}<" in table
