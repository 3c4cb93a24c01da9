"""The studies of what a minute of motion is worth."""

from __future__ import annotations

import numpy as np
import pytest
from pandas import DataFrame

from truejoint.errors import StudyError
from truejoint.simulation.raven2 import Raven2Parameters
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
    monkeypatch.setattr(minutes, "_FIRST_LOOK", 30.0)
    monkeypatch.setattr(minutes, "_LOOK", 60.0)
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
    stop = select(rows, of=minutes.STOPPED).seconds.item()
    assert 30.0 <= stop < 65.0  # with the way to the start
    assert len(result.summary.claims) == 3
    assert len(result.summary.tables[0].rows) == 3  # both ends are one here
    assert drawn(result)
    assert {"efficiency.html", "efficiency.png"} <= {file.name for file in tmp_path.iterdir()}


def test_transfer_starts_from_the_first_calibration(drawn, monkeypatch):
    monkeypatch.setattr(minutes, "_SECONDS", minutes._IN_TABLE)
    options = {"specimens": "nominal", "sessions": 1, "first": 2, "test": 0.5}
    result = run_study("transfer", {**options, "changes": "homing"})
    keys = ("specimen", "session")
    own = select(result.rows, made_by=minutes.OWN)
    made = {way: select(result.rows, made_by=way) for way in minutes._WAYS}
    shares = {way: minutes.shares(rows, own, *keys) for way, rows in made.items()}
    assert (shares["prior, reference"] < 1.2).all()
    # Nobody learns a workspace in ten seconds; not a zero either, without a reference.
    assert shares["prior, reference"][0] < shares["prior"][0]
    assert not shares["anew"][0] < shares["prior"][0]
    (claim,) = result.summary.claims
    assert claim.text == "a new homing takes 10 s for the accuracy of a whole calibration"
    (table,) = result.summary.tables
    assert [row[-1] for row in table.rows if row[0].endswith("own")] == ["1.00"]
    assert drawn(result)
    with pytest.raises(StudyError, match="no change called 'weather'"):
        run_study("transfer", {**options, "changes": "weather"})


def test_another_arm_and_tool_are_what_they_are_called():
    plain = Raven2Parameters.read().to_dict()
    seen = []

    def homed(raven, seed):
        seen.append((raven, seed))
        return "arm", "twin"

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(minutes.s, "homed", homed)
        for change in ("tool", "arm"):
            assert minutes.changed(None, plain, change, 7) == "arm"
    (tool, _), (arm, _) = seen
    assert tool["mass"]["instrument"] == pytest.approx(plain["mass"]["instrument"] + 0.1)
    assert tool["cable"] == plain["cable"]
    ratio = np.array(arm["cable"]["stiffness"]) / np.array(plain["cable"]["stiffness"])
    assert (np.abs(ratio - 1.0) <= 0.2).all()
    assert np.ptp(ratio) > 0.0
    assert plain == Raven2Parameters.read().to_dict()
