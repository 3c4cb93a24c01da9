"""What changes after a calibration cost and show, and what touching the stops takes off."""

from __future__ import annotations

from unittest.mock import patch

import numpy as np
import pytest
from tests.runtime.registered import FEW_PLAYS

from truejoint.drawing import png
from truejoint.errors import StudyError
from truejoint.estimators.cables import hybrid as cable_hybrid
from truejoint.estimators.cables import learn as cable_filter
from truejoint.simulation.wrist.twin import WristTwin
from truejoint.studies import PartResult, Results, get_study
from truejoint.studies.wrist import changes

FEW = {"free_s": "50", "loaded_s": "12", "test_s": "6", "count": "1", "family": "endowrist"}


@pytest.fixture(scope="module")
def result():
    settings = get_study("wrist-changes").settings("small", options=FEW)
    (part,) = get_study("wrist-changes").parts(settings)
    with (
        patch.object(cable_filter, "_ROUNDS", 2),
        patch.object(cable_filter, "_LONGEST", 10.0),
        patch.object(changes, "_CHECK", 15.0),
        patch.object(cable_hybrid, "WRIST_PLAYS", FEW_PLAYS),
    ):
        rows = part.compute(**part.arguments)
    return Results.of(settings, [part], {part.key: PartResult(rows)})


def test_efforts_show_more_friction_and_not_where_the_zeros_are(result):
    strange = result.rows.set_index("changed").strange
    assert strange["motors' friction x 1.5"] > strange[changes.NOTHING] + 0.02
    assert strange[changes.GAIN] > strange[changes.NOTHING] + 0.02
    assert strange[changes.ENGAGED] == pytest.approx(strange[changes.NOTHING], abs=0.02)


@pytest.mark.parametrize("specimen", ["nominal", "cable_only"])
def test_stops_tell_how_far_engaging_moved_each_joint(specimen):
    found, zeros = [], []
    for homings in (1, 2):
        twin = WristTwin(WristTwin.PARAMETERS.read(specimen), seed=3)
        for _ in range(homings):
            twin.home()
        found.append(changes.touched(twin))
        zeros.append(twin._transmission.joint_from_motor(twin._zero[None])[0])
    moved = zeros[0] - zeros[1]
    assert np.degrees(np.abs(moved)).max() > 0.3
    shown = found[1] - found[0]
    np.testing.assert_allclose(np.degrees(shown[:3] - moved), 0.0, atol=0.05)
    assert np.degrees(shown[3]) == pytest.approx(np.degrees(moved[2] - moved[1]), abs=0.05)


def test_a_test_too_short_to_settle_is_refused():
    study = get_study("wrist-changes")
    with pytest.raises(StudyError, match="test_s=2; it must be above 2"):
        study.parts(study.settings(options={"test_s": "2"}))


@pytest.mark.usefixtures("coarse")
def test_its_tables_and_figure_can_be_drawn(result):
    summary = changes.summarise(result)
    assert [row[0] for row in summary.tables[0].rows] == list(changes.CHANGES)
    assert [len(row) for row in summary.tables[1].rows] == [5, 5, 5]
    assert all(png(figure).startswith(b"\x89PNG") for figure in summary.figures.values())
