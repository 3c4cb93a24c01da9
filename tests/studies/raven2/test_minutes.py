"""The studies of what a minute of motion is worth."""

import numpy as np
import pytest
from pandas import DataFrame

from truejoint.studies import run_study
from truejoint.studies.raven2 import minutes
from truejoint.studies.raven2.sessions import JOINTS
from truejoint.studies.rows import select


def test_a_time_is_that_at_which_the_joints_together_are_as_good():
    errors = [[4.0, 1.0, 1.0], [2.0, 1.0, 0.5], [1.0, 1.0, 1.0]]
    rows = DataFrame(errors, columns=list(JOINTS)).assign(specimen="A", session=0)
    share = minutes.shares(rows, rows[2:], "specimen", "session")
    np.testing.assert_allclose(share, [4.0 ** (1 / 3), 1.0, 1.0])
    times = [5.0, 10.0, 15.0, 20.0]
    for shares, first, good in (
        ([1.4, 1.0, 1.1, 0.9], 10.0, 20.0),
        ([0.9, 0.8, 1.0, 0.9], 5.0, 5.0),
        ([np.nan, 0.8, 1.2, 1.1], 10.0, np.inf),
        ([1.1, 1.2, 1.2, 1.1], np.inf, np.inf),
    ):
        found = minutes.reached(DataFrame({"share": shares, "minutes": times}))
        assert found.tolist() == [first, good]


def test_recordings_are_cut_by_the_time_of_all(recording):
    pair = [recording, recording]
    whole = recording.duration
    kept = minutes.until(pair, 1.5 * whole)
    assert len(kept[0]) == len(recording)
    assert kept[1].duration == pytest.approx(0.5 * whole, rel=0.1)
    assert len(minutes.until(pair, 0.5 * whole)) == 1


def test_efficiency_compares_three_motions(drawn, tmp_path, monkeypatch):
    monkeypatch.setattr(minutes, "_FINE", (1,))
    options = {"specimens": "nominal", "sessions": 1, "longest": 1, "every_s": 30, "test": 0.5}
    result = run_study("efficiency", options)
    rows = result.rows
    assert set(rows.case) == {"zigzag", "random", "designed"}
    first = select(rows, of=minutes.FIRST)
    assert (first.groupby("case").seconds.count() == 2).all()
    errors = select(first, case="designed")[list(JOINTS)].to_numpy()
    assert (errors > 0.0).all()
    at_end = errors[-1]  # of a minute: a degree, a millimetre
    assert (at_end < [np.radians(1.0), np.radians(1.0), 1e-3]).all()
    assert len(result.summary.claims) == 2
    assert len(result.summary.tables[0].rows) == 3  # both ends are one here
    assert drawn(result)
    assert {"efficiency.html", "efficiency.png"} <= {file.name for file in tmp_path.iterdir()}
