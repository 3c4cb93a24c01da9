"""Faults of the truth and of redundant sensors, put into a recording that has none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from tests.recordings.judge.faults import named

from truejoint.calibration import calibrate
from truejoint.recordings import Provenance, Recording, check_data
from truejoint.recordings.join.explained import gross_outliers

Change = Callable[[np.ndarray], np.ndarray]
check_elbow = partial(check_data, joints=["elbow"])


@pytest.fixture(scope="module")
def healthy(recording_of: Callable[..., Recording]) -> list[Recording]:
    """Three minutes of a RAVEN-II in three recordings."""
    return [recording_of("raven2", seed=seed, seconds=60, load=0.0) for seed in range(3)]


def _changed(recording: Recording, column: str, change: Change) -> Recording:
    values = change(recording.column(column).copy())
    return replace(recording, table=recording.table.assign(**{column: values}))


def _in_first(recordings: list[Recording], column: str, change: Change) -> list[Recording]:
    return [_changed(recordings[0], column, change), *recordings[1:]]


def _in_all(recordings: list[Recording], column: str, change: Change) -> list[Recording]:
    return [_changed(recording, column, change) for recording in recordings]


def _added(rows: Any, by: Any) -> Change:
    """Add to the values of some rows."""

    def change(values: np.ndarray) -> np.ndarray:
        values[rows] += by
        return values

    return change


def test_nothing_is_found_where_nothing_is_wrong(healthy):
    assert {finding.name for finding in check_data(healthy).findings} <= {"limits", "load"}


def test_outliers_are_named_by_row_and_size(healthy):
    spoil = _added([200, 900, 901, 902], 0.4)
    (finding,) = named(check_elbow(_in_first(healthy, "truth/elbow", spoil)), "outliers")
    assert finding.level == "fail"
    assert finding.rows == ((200, 201), (900, 903))
    assert finding.where.startswith("truth/elbow in synthetic-0.csv")
    assert finding.what.startswith("4 of 1800 rows up to 22.9")
    assert "(rows 200, 900-902)" in finding.what


def test_what_steps_away_and_creeps_back_is_no_outlier(healthy):
    slip = _added(slice(900, 1000), 0.05 * np.exp(-np.arange(100) / 10))
    assert not named(check_elbow(_in_first(healthy, "truth/elbow", slip)), "outliers")


def test_a_single_small_outlier_is_a_warning_only(healthy):
    spoilt = _in_first(healthy, "truth/elbow", _added(500, 0.012))
    (finding,) = named(check_elbow(spoilt), "outliers")
    assert finding.level == "warn"


@pytest.mark.parametrize("spread", [_in_first, _in_all])
def test_a_wrong_sign_is_called_that_and_nothing_else(healthy, spread):
    check = check_data(spread(healthy, "truth/shoulder", np.negative))
    assert check.failures == ("sign",)


@pytest.mark.parametrize(
    ("column", "scale"),
    [("truth/shoulder", 57.3), ("measured/shoulder", 57.3), ("truth/insertion", 1000.0)],
)
def test_a_wrong_unit_is_called_that_and_nothing_else(healthy, column, scale):
    check = check_data(_in_all(healthy, column, lambda values: scale * values))
    assert check.failures == ("unit",)
    (finding,) = named(check, "unit")
    assert finding.where.startswith(column)


def test_degrees_on_both_sides_are_seen_by_the_limits(healthy):
    both = healthy
    for quantity in ("truth", "measured"):
        both = _in_all(both, f"{quantity}/elbow", np.degrees)
    (finding,) = named(check_data(both), "unit")
    assert "the limits are" in finding.what


@pytest.mark.parametrize(("spread", "where"), [(_in_all, ""), (_in_first, "in synthetic-0.csv")])
def test_a_late_truth_is_measured_in_all_recordings_or_in_one(healthy, spread, where):
    late = healthy
    for joint in ("shoulder", "elbow", "insertion"):
        t = late[0].t
        late = spread(late, f"truth/{joint}", lambda x, t=t: np.interp(t - 0.06, t, x))
    (finding,) = named(check_data(late), "delay")
    assert 55 <= float(finding.what.split()[3]) <= 65
    assert "behind" in finding.what
    assert finding.where.endswith(where)


def test_the_delay_of_slow_rows_is_told_with_its_uncertainty():
    t = 0.5 * np.arange(2000)
    rng = np.random.default_rng(0)
    columns = {"t": t}
    for joint, period in (("shoulder", 17.0), ("elbow", 23.0)):
        position = 0.5 + 0.2 * np.sin(2 * np.pi * t / period) + 0.1 * np.sin(t)
        rate = np.gradient(position, t)
        columns[f"measured/{joint}"] = position
        columns[f"truth/{joint}"] = position - 0.1 * rate + 1e-3 * rng.normal(size=len(t))
    recording = Recording.from_columns(columns, Provenance("raven2", arm="left", source="a.csv"))
    (finding,) = named(check_data([recording]), "delay")
    assert finding.level == "fail"
    assert float(finding.what.split()[3]) == pytest.approx(100.0, abs=5.0)


def test_a_zero_that_moved_is_found_in_its_recording(healthy):
    check = check_elbow(_in_first(healthy, "truth/elbow", lambda truth: truth + 0.05))
    (finding,) = named(check, "zero")
    assert finding.where == "truth/elbow in synthetic-0.csv"
    off = float(finding.what.removeprefix("its zero is ").partition(" deg")[0])
    assert off == pytest.approx(np.degrees(0.05), rel=0.1)


def test_a_zero_that_moves_within_a_recording_is_found_at_its_row(healthy):
    moved = _in_first(healthy, "truth/elbow", _added(slice(1000, None), 0.05))
    (finding,) = named(check_elbow(moved), "zero")
    assert finding.rows == ((1000, 1001),)


@pytest.mark.parametrize("first", [0, 700])
def test_redundant_sensors_that_disagree_are_found(healthy, first):
    """Motor encoders tell of a slip without truth."""
    motors = [{"motor/elbow": 7.3 * r.column("measured/elbow")} for r in healthy]
    recordings = [
        Recording(r.table.assign(**motor), {**r.units, "motor/elbow": "rad"}, r.provenance)
        for r, motor in zip(healthy, motors, strict=True)
    ]
    assert not named(check_elbow(recordings), "redundant")
    slip = _added(slice(first, None), 7.3 * 0.0175)
    (finding,) = named(check_elbow(_in_first(recordings, "motor/elbow", slip)), "redundant")
    assert finding.where.startswith("motor/elbow in synthetic-0.csv")


def test_another_instrument_than_the_training_s_is_named(healthy):
    model = calibrate(healthy[:2], "linear")
    assert not named(check_data(healthy[2:], model=model), "instrument")
    for shift, level in ((60.0, "warn"), (600.0, "fail")):
        other = _in_first(healthy[2:], "effort/elbow", lambda x, by=shift: x + by * x.std())
        (finding,) = named(check_data(other, model=model), "instrument")
        assert finding.level == level


def test_failures_can_be_accepted_by_name(healthy):
    check = check_data(_in_all(healthy, "truth/shoulder", np.negative))
    assert check.failures == ("sign",)
    assert not check.accept(["sign"]).failed
    assert check.accept(["unit"]).failed


def _swapped(recording: Recording, quantity: str, a: str, b: str) -> Recording:
    first, second = f"{quantity}/{a}", f"{quantity}/{b}"
    columns = {first: recording.column(second), second: recording.column(first)}
    return replace(recording, table=recording.table.assign(**columns))


@pytest.mark.parametrize("quantity", ["effort", "truth", "measured"])
@pytest.mark.parametrize("count", [1, 3])
def test_two_exchanged_channels_are_named(healthy, quantity, count):
    """Exchanged positions exchange the truth as well."""
    exchanged = [_swapped(r, quantity, "shoulder", "elbow") for r in healthy[:count]]
    findings = named(check_data([*exchanged, *healthy[count:]]), "swapped")
    column = "effort" if quantity == "effort" else "truth"
    assert {finding.where.partition(" ")[0] for finding in findings} >= {f"{column}/shoulder"}
    assert {finding.level for finding in findings} == {"fail"}
    assert all("more of" in f.where for f in findings) == (count == 3)


def test_a_sensor_slower_than_the_table_is_named(healthy):
    slow = _in_all(healthy, "truth/elbow", lambda x: x[np.arange(len(x)) // 10 * 10])
    (finding,) = named(check_elbow(slow), "repeats")
    assert finding.where.startswith("truth/elbow")
    assert finding.what == "a new value in every 10 rows only, so about 150 ms late"


@pytest.mark.parametrize("count", [2, 3])
@pytest.mark.parametrize("slope", [0.8, 1.1])
def test_a_session_whose_truth_moves_further_is_named(healthy, count, slope):
    spoilt = _in_first(healthy[:count], "truth/elbow", lambda x: 1.0 + slope * (x - 1.0))
    (finding,) = named(check_elbow(spoilt), "slope")
    assert finding.where == "truth/elbow in synthetic-0.csv"
    assert f"{slope:.2f} times" in finding.what


@pytest.mark.parametrize("share", [0.8, 0.95])
@pytest.mark.parametrize(("push", "noise"), [(3.0, 0.0), (3.0, 1e-3), (0.0, 1e-3), (0.0, 0.0)])
def test_a_stop_is_told_from_a_saturated_sensor(healthy, share, push, noise):
    """A motor pushes at a stop, and what is measured there is not one value."""
    truth = healthy[0].column("truth/elbow")
    level = truth.min() + share * np.ptp(truth)
    beyond = truth > level
    still = level + noise * np.random.default_rng(0).normal(size=len(truth))
    spoilt = _in_first(healthy, "truth/elbow", lambda x: np.where(beyond, still, x))
    spoilt = _in_first(spoilt, "effort/elbow", lambda x: x + push * np.where(beyond, 1.0, 0.0))
    kind, other = ("stop", "saturated") if push or noise else ("saturated", "stop")
    check = check_elbow(spoilt)
    (finding,) = named(check, kind)
    assert not named(check, other)
    assert finding.where == "truth/elbow in synthetic-0.csv"
    assert all(beyond[first:behind].all() for first, behind in finding.rows)
    assert not gross_outliers(spoilt, "elbow")[0][beyond].any()
    if kind == "stop":
        assert not check.failed
