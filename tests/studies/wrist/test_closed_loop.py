"""Joints of a wrist in a loop: what stands in it, and what that brings."""

from __future__ import annotations

from unittest.mock import patch

import numpy as np
import pytest
from tests.runtime.registered import FEW_PLAYS

from truejoint.drawing import png
from truejoint.errors import CommandRefused, StudyError
from truejoint.estimators.cables import hybrid as cable_hybrid
from truejoint.estimators.cables import learn as cable_filter
from truejoint.robots.wrist.instruments import JOINTS
from truejoint.studies import PartResult, Results, get_study
from truejoint.studies.rows import select
from truejoint.studies.wrist import closed_loop
from truejoint.studies.wrist.closed_loop import (
    CASES,
    GRIPS,
    OPEN,
    PERFECT,
    TITLES,
    judged_grip,
    summarise,
)

FEW = {
    "free_s": "25", "loaded_s": "12", "seconds": "2.5", "count": "1", "family": "measured",
    "loops": "open,play_motor,hybrid,perfect_forward",
}  # fmt: skip
KEYS = (OPEN, "play_motor", "hybrid", PERFECT, "perfect_forward")


@pytest.fixture(scope="module")
def result():
    settings = get_study("wrist-loop").settings("small", options=FEW)
    (part,) = get_study("wrist-loop").parts(settings)
    with (
        patch.object(cable_filter, "_ROUNDS", 3),
        patch.object(cable_hybrid, "WRIST_PLAYS", FEW_PLAYS),
    ):
        return Results.of(settings, [part], {part.key: PartResult(part.compute(**part.arguments))})


def of(results, kind, load):
    return select(results.rows, of=kind, load=load).set_index("loop")


def test_an_estimate_in_the_loop_is_nearly_a_perfect_sensor(result):
    for case in CASES:
        error = of(result, "joint", case)[list(JOINTS)].mean(axis=1)
        assert set(error.index) == set(KEYS)
        assert error["hybrid"] < 0.4 * error[OPEN]
        assert error["hybrid"] < 1.5 * error[PERFECT]
        assert np.degrees(error[PERFECT]) < 0.4


def test_motors_alone_do_not_see_a_push(result):
    errors = of(result, "joint", "tip")[list(JOINTS)].mean(axis=1)
    assert errors["play_motor"] > 1.05 * errors["hybrid"]


def test_jaws_grip_as_they_are_told(result):
    assert "refused" not in result.rows
    for case in GRIPS:
        found = of(result, "grip", case)
        assert found.standing[PERFECT] < 1e-3
        assert found.rms[PERFECT] < 2.5e-3
        assert found.rms["hybrid"] < 8e-3


def test_a_loop_that_refuses_is_a_row_and_the_others_go_on(result, monkeypatch):
    def follow(bench, key, wanted, offset, pushed):
        if pushed and key == "play_motor":
            raise CommandRefused("compensator: pitch is wanted beyond its range")
        return np.full((1000, 3), 1e-3 if key == PERFECT else 2e-3)

    settings = get_study("wrist-loop").settings("small", options=FEW)
    (part,) = get_study("wrist-loop").parts(settings)
    monkeypatch.setattr(closed_loop, "calibrate", lambda *_, **__: None)
    monkeypatch.setattr(closed_loop.Bench, "follow", follow)
    monkeypatch.setattr(closed_loop.Bench, "grip", lambda bench, key, path, wanted: wanted + 1e-3)
    found = Results.of(settings, [part], {part.key: PartResult(part.compute(**part.arguments))})
    (row,) = found.rows.dropna(subset="refused").itertuples()
    assert (row.load, row.loop) == ("tip", "play_motor")
    joints, _, refused = summarise(found).tables
    title = f"measured, {TITLES['play_motor']}"
    assert f"tip, {title}" not in [row[0] for row in joints.rows]
    assert (f"free, {title}", "1") in [row[:2] for row in joints.rows]
    assert refused.rows[0][1:3] == ("tip", TITLES["play_motor"])
    assert "beyond its range" in refused.rows[0][3]


def test_a_grip_is_judged_after_its_steps_and_by_how_far_it_goes_beyond():
    wanted = np.concatenate(
        [np.full(3000, 0.02), np.linspace(0.02, 0.05, 300), np.full(1700, 0.05)]
    )
    force = wanted.copy()
    force[3310:3330] += 4e-3  # beyond the step's end
    force[4500:] -= 1e-3
    found = judged_grip(force, wanted)
    assert found["overshoot"] == pytest.approx(4e-3)
    assert found["standing"] == pytest.approx(1e-3 * np.sqrt(500 / 2200), rel=0.02)
    assert found["rms"] == pytest.approx(np.sqrt(np.mean((force - wanted)[2000:] ** 2)))


@pytest.mark.usefixtures("coarse")
def test_its_table_and_figure_can_be_drawn(result):
    summary = summarise(result)
    assert len(summary.tables[0].rows) == len(CASES) * len(KEYS)
    ratios = {row[0]: row[-1] for row in summary.tables[0].rows}
    assert ratios[f"tip, measured, {TITLES[PERFECT]}"] == "1.00"
    assert len(summary.tables[1].rows) == 2 * len(GRIPS)
    assert all(png(figure).startswith(b"\x89PNG") for figure in summary.figures.values())


def test_a_loop_too_slow_for_its_gain_is_refused_before_anything_is_computed():
    study = get_study("wrist-loop")
    with pytest.raises(CommandRefused, match="gain"):
        study.parts(study.settings(options={"gain": "5"}))
    with pytest.raises(StudyError, match="no loop called 'closed'"):
        study.parts(study.settings(options={"loops": "closed"}))
    with pytest.raises(StudyError, match="seconds=1; it must be 2 or more"):
        study.parts(study.settings(options={"seconds": "1"}))
    with pytest.raises(StudyError, match="rate_hz=300; it must divide"):
        study.parts(study.settings(options={"rate_hz": "300"}))
