"""Coverage of a stated interval in the evaluation and in the report."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from truejoint.estimators import Calibration, calibrate, with_interval
from truejoint.evaluation import evaluate, render_report
from truejoint.recordings import Provenance, Recording

JOINTS = ("shoulder", "elbow", "insertion")


def motion(seed: int) -> Recording:
    """Half a minute of smooth motion with an error that follows the position."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 30.0, 0.05)
    columns: Mapping[str, np.ndarray] = {"t": t}
    for k, joint in enumerate(JOINTS):
        position = 0.5 + 0.1 * np.sin(0.4 * (k + 1) * t + rng.uniform(0, 6))
        noise = rng.normal(0.0, 1e-3, len(t))
        columns |= {
            f"measured/{joint}": position,
            f"effort/{joint}": np.cos(t) + rng.normal(0, 0.1, len(t)),
            f"truth/{joint}": position + 0.02 * (position - 0.4) + noise,
        }
    origin = Provenance("raven2", arm="left", source=f"m{seed}.parquet", session=str(seed))
    return Recording.from_columns(columns, origin)


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    features = [f"measured/{joint}" for joint in JOINTS]
    return calibrate([motion(0), motion(1)], "linear", features=features)


@pytest.fixture(scope="module")
def stated(calibration) -> Calibration:
    return with_interval(calibration, [motion(seed) for seed in range(10, 22)])


def test_coverage_is_that_of_the_stated_bounds(stated):
    tests = [motion(30), motion(31)]
    found = evaluate({"linear": [stated]}, tests)
    assert [(s.level, s.joint) for s in found.intervals] == [
        (level, joint) for level in (0.8, 0.9) for joint in JOINTS
    ]
    for score in found.intervals:
        k = JOINTS.index(score.joint)
        shares = []
        for test in tests:
            _, lower, upper = stated.correct_with_interval(test, score.level)
            truth = test.column(f"truth/{score.joint}")
            shares.append(np.mean((lower[:, k] <= truth) & (truth <= upper[:, k])))
        assert score.coverage == pytest.approx(np.mean(shares))
        assert score.standard_error == pytest.approx(np.std(shares, ddof=1) / np.sqrt(2))
        assert score.unit == ("m" if k == 2 else "rad")
        assert score.half_width < score.offset_half_width
    assert found.to_dict()["intervals"][0]["level"] == 0.8
    assert "after the homing of its 12 trajectories only" in found.interval_note


def test_the_report_shows_stated_beside_found(stated):
    page = render_report(evaluate({"linear": [stated]}, [motion(30), motion(31)]))
    section = page[page.index('<section id="intervals">') :]
    section = section[: section.index("</section>")]
    assert "Stated uncertainty" in section
    assert section.count('<tr><th scope="row">') == 6
    assert "90 %" in section


def test_an_interval_that_is_judged_on_what_it_was_made_of_is_told(stated):
    found = evaluate({"linear": [stated]}, [motion(12), motion(30)])
    assert "made of m12.parquet, which it is judged on here" in found.interval_note


def test_without_an_interval_the_page_says_so(calibration):
    found = evaluate({"linear": [calibration]}, [motion(30)])
    assert found.intervals == ()
    assert "The model states no interval" in render_report(found)


def test_an_interval_that_cannot_be_judged_does_not_stop_the_evaluation(calibration):
    recordings = [motion(seed) for seed in range(10, 22)]
    stated = with_interval(calibration, recordings, rezero=20.0)
    longer = replace(stated.interval, rezero=1e4)
    found = evaluate({"linear": [replace(stated, interval=longer)]}, [motion(30)])
    assert found.intervals == ()
    assert "nothing is left to judge" in found.interval_note
