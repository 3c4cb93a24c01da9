"""Joints of a wrist in a loop: what stands in it, and what that brings."""

from __future__ import annotations

import numpy as np
import pytest

from truejoint.errors import CommandRefused
from truejoint.studies import get_study
from truejoint.studies.figures import png
from truejoint.studies.wrist.closed_loop import CASES, OPEN, PERFECT, TITLES, summarise

FEW = {"free_s": "24", "loaded_s": "12", "seconds": "4", "count": "1", "family": "measured"}


@pytest.fixture(scope="module")
def result():
    settings = get_study("wrist-loop").settings("small", options=FEW)
    (part,) = get_study("wrist-loop").parts(settings)
    return settings, {part.key: part.compute(**part.arguments)}


def test_an_estimate_in_the_loop_is_nearly_a_perfect_sensor(result):
    (part,) = result[1].values()
    for case in CASES:
        error = {key: np.mean(part.numbers["errors"][case][key]) for key in TITLES}
        assert error["play_effort"] < 0.4 * error[OPEN]
        assert error["play_effort"] < 2.0 * error[PERFECT]
        assert np.degrees(error[PERFECT]) < 0.4


def test_motors_alone_do_not_see_a_push(result):
    (part,) = result[1].values()
    pushed = part.numbers["errors"]["tip"]
    assert np.mean(pushed["play_motor"]) > 1.05 * np.mean(pushed["play_effort"])


def test_its_table_and_figure_can_be_drawn(result):
    summary = summarise(*result)
    assert len(summary.tables[0].rows) == len(CASES) * len(TITLES)
    assert summary.tables[0].rows[3][-1] == "1.00"
    assert all(png(figure).startswith(b"\x89PNG") for figure in summary.figures.values())


def test_a_loop_too_slow_for_its_gain_is_refused_before_anything_is_computed():
    study = get_study("wrist-loop")
    with pytest.raises(CommandRefused, match="gain"):
        study.parts(study.settings(options={"gain": "5"}))
