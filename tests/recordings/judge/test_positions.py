"""Faults of the truth and of redundant sensors, put into a recording that has none."""

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
from tests.recordings.judge.faults import added, changed, in_all, in_first, late, named

from truejoint.calibration import calibrate
from truejoint.features import FeatureSet
from truejoint.recordings import Provenance, Recording, check_data
from truejoint.recordings.join.explained import gross_outliers

check_elbow = partial(check_data, joints=["elbow"])


@pytest.fixture(scope="module")
def healthy(recording_of: Callable[..., Recording]) -> list[Recording]:
    """Three minutes of a RAVEN-II in three recordings."""
    return [recording_of("raven2", seed=seed, seconds=60, load=0.0) for seed in range(3)]


def test_nothing_is_found_where_nothing_is_wrong(healthy):
    assert {finding.name for finding in check_data(healthy).findings} <= {"limits", "load"}


def test_outliers_are_named_by_row_and_size(healthy):
    spoilt = in_first(healthy[:2], truth__elbow=added([200, 900, 901, 902], 0.4))
    (finding,) = named(check_elbow(spoilt), "outliers")
    assert finding.level == "fail"
    assert finding.rows == ((200, 201), (900, 903))
    assert finding.where.startswith("truth/elbow in synthetic-0.csv")
    assert finding.what.startswith("4 of 1800 rows up to 22.9")
    assert "(rows 200, 900-902)" in finding.what


@pytest.mark.parametrize(
    ("rows", "by", "levels"),
    [
        (slice(900, 1000), 0.05 * np.exp(-np.arange(100) / 10), []),  # steps and creeps back
        (500, 0.012, ["warn"]),
    ],
)
def test_a_slip_is_no_outlier_and_a_small_one_a_warning(healthy, rows, by, levels):
    check = check_elbow(in_first(healthy[:2], truth__elbow=added(rows, by)))
    assert [finding.level for finding in named(check, "outliers")] == levels


def _slack(seed: int, slip: float = 0.0) -> Recording:
    """A joint with play, whose effort changes its sign with the motion, that may slip halfway."""
    random = np.random.default_rng(seed)
    t = np.arange(1200) / 25.0
    rates, phases = 0.4 * np.arange(1, 6), random.uniform(0.0, 6.0, 5)
    measured = (0.25 * np.sin(np.outer(t, rates) + phases)).sum(axis=1)
    truth, at = np.empty_like(t), measured[0]
    for i, position in enumerate(measured):
        truth[i] = at = min(max(at, position - 0.02), position + 0.02)
    effort = 0.02 * np.sign(np.gradient(measured)) + 0.04 * measured
    truth += 5e-4 * random.standard_normal(len(t))
    truth[600:] += slip
    columns = {"t": t, "measured/jaw": measured, "truth/jaw": truth, "effort/jaw": effort}
    return Recording.from_columns(columns, Provenance("davinci_grasper", source="slack.csv"))


@pytest.mark.parametrize("seed", range(4))
def test_an_effort_that_turns_round_in_a_slack_makes_no_outlier_of_the_truth(seed):
    assert {f.name for f in check_data(_slack(seed)).findings if f.level == "fail"} <= {"travel"}


@pytest.mark.parametrize("slip", [0.05, 0.1, 0.4, -0.8])
def test_a_slip_halfway_is_found_however_large_it_is(slip):
    (finding,) = named(check_data(_slack(4, slip)), "zero")
    assert finding.level == "fail"
    assert finding.what.endswith("at row 600 and stays")


@pytest.mark.parametrize("spread", [in_first, in_all])
def test_a_wrong_sign_is_called_that_and_nothing_else(healthy, spread):
    check = check_data(spread(healthy, truth__shoulder=np.negative), joints=["shoulder", "elbow"])
    assert check.failures == ("sign",)
    assert not check.accept(["sign"]).failed
    assert check.accept(["unit"]).failed


@pytest.mark.parametrize(("moves", "failures"), [(1.0, ("arm",)), (0.3, ())])
def test_a_truth_that_follows_another_joint_is_none_of_one_that_moves(healthy, moves, failures):
    def less(values: np.ndarray) -> np.ndarray:
        return values.mean() + moves * (values - values.mean())

    other = less(healthy[0].column("truth/shoulder")) + moves * 1.0
    check = check_elbow(in_first(healthy, truth__elbow=other, measured__elbow=less))
    assert tuple(name for name in check.failures if name != "zero") == failures


@pytest.mark.parametrize("share", [0.2, 0.35])
def test_a_truth_behind_a_large_slack_follows(share):
    t = 0.02 * np.arange(6000)
    swings = np.array([0.03, 0.11, 0.19, 0.31, 0.47])
    jaw = np.sin(2 * np.pi * np.outer(t, swings) + [0, 1, 2, 3, 4]).sum(axis=1) / 8
    recording = Recording.from_columns({"t": t, "measured/jaw": jaw}, "davinci_grasper")
    slack = FeatureSet.parse([f"play(measured/jaw, {share * np.ptp(jaw):.4g})"]).compute(recording)
    columns = {"t": t, "measured/jaw": jaw, "truth/jaw": slack[:, 0]}
    check = check_data(Recording.from_columns(columns, "davinci_grasper"))
    assert not named(check, "arm")


@pytest.mark.parametrize(
    ("column", "scale"),
    [("truth/shoulder", 57.3), ("measured/shoulder", 57.3), ("truth/insertion", 1000.0)],
)
def test_a_wrong_unit_is_called_that_and_nothing_else(healthy, column, scale):
    spoilt = in_all(healthy[:2], **{column: lambda values: scale * values})
    check = check_data(spoilt, joints=[column.partition("/")[2], "elbow"])
    assert check.failures == ("unit",)
    (finding,) = named(check, "unit")
    assert finding.where.startswith(column)


def test_degrees_on_both_sides_are_seen_by_the_limits(healthy):
    both = in_all(healthy[:1], truth__elbow=np.degrees, measured__elbow=np.degrees)
    (finding,) = named(check_elbow(both), "unit")
    assert "the limits are" in finding.what


@pytest.mark.parametrize(("count", "where"), [(3, ""), (1, "in synthetic-0.csv")])
def test_a_late_truth_is_measured_in_all_recordings_or_in_one(healthy, count, where):
    delayed = [late(recording, 0.06) for recording in healthy[:count]]
    check = check_data([*delayed, *healthy[count:]], joints=["shoulder", "elbow"])
    (finding,) = named(check, "delay")
    assert 55 <= float(finding.what.split()[3]) <= 65
    assert "behind" in finding.what
    assert finding.where.endswith(where)


def test_the_delay_of_slow_rows_is_told_with_its_uncertainty():
    t, rng = 0.5 * np.arange(2000), np.random.default_rng(0)
    columns = {"t": t}
    for joint, period in (("shoulder", 17.0), ("elbow", 23.0)):
        position = 0.5 + 0.2 * np.sin(2 * np.pi * t / period) + 0.1 * np.sin(t)
        columns[f"measured/{joint}"] = position
        delayed = position - 0.1 * np.gradient(position, t)
        columns[f"truth/{joint}"] = delayed + 1e-3 * rng.normal(size=len(t))
    recording = Recording.from_columns(columns, Provenance("raven2", arm="left", source="a.csv"))
    (finding,) = named(check_data([recording]), "delay")
    assert finding.level == "fail"
    assert float(finding.what.split()[3]) == pytest.approx(100.0, abs=5.0)


def test_a_zero_that_moved_is_found_in_its_recording_and_at_its_row(healthy):
    check = check_elbow(in_first(healthy, truth__elbow=lambda truth: truth + 0.05))
    (finding,) = named(check, "zero")
    assert finding.where == "truth/elbow in synthetic-0.csv"
    off = float(finding.what.removeprefix("its zero is ").partition(" deg")[0])
    assert off == pytest.approx(np.degrees(0.05), rel=0.1)
    moved = in_first(healthy, truth__elbow=added(slice(1000, None), 0.05))
    (finding,) = named(check_elbow(moved), "zero")
    assert finding.rows == ((1000, 1001),)


def test_redundant_sensors_that_disagree_are_found(healthy):
    """Motor encoders tell of a slip without truth."""
    recordings = []
    for r in healthy:
        table = r.table.assign(**{"motor/elbow": 7.3 * r.column("measured/elbow")})
        recordings.append(Recording(table, {**r.units, "motor/elbow": "rad"}, r.provenance))
    assert not named(check_elbow(recordings), "redundant")
    for first in (0, 700):
        slip = added(slice(first, None), 7.3 * 0.0175)
        (finding,) = named(check_elbow(in_first(recordings, motor__elbow=slip)), "redundant")
        assert finding.where.startswith("motor/elbow in synthetic-0.csv")


def test_another_instrument_than_the_training_s_is_named(healthy):
    model = calibrate(healthy[:2], "linear", joints=["elbow"])
    assert not named(check_data(healthy[2:], model=model), "instrument")
    for shift, level in ((60.0, "warn"), (600.0, "fail")):
        other = in_first(healthy[2:], effort__elbow=lambda x, by=shift: x + by * x.std())
        (finding,) = named(check_data(other, model=model), "instrument")
        assert finding.level == level


@pytest.mark.parametrize(("quantity", "count"), [("truth", 1), ("measured", 1), ("effort", 3)])
def test_two_exchanged_channels_are_named(healthy, quantity, count):
    """Exchanged positions exchange the truth as well."""
    a, b = f"{quantity}/shoulder", f"{quantity}/elbow"
    swapped = [changed(r, **{a: r.column(b), b: r.column(a)}) for r in healthy[:count]]
    check = check_data([*swapped, *healthy[count:]], joints=["shoulder", "elbow"])
    findings, column = named(check, "swapped"), "effort" if quantity == "effort" else "truth"
    assert {finding.where.partition(" ")[0] for finding in findings} >= {f"{column}/shoulder"}
    assert {finding.level for finding in findings} == {"fail"}
    assert all("more of" in f.where for f in findings) == (count == 3)


def test_a_sensor_slower_than_the_table_is_named(healthy):
    slow = in_all(healthy[:1], truth__elbow=lambda x: x[np.arange(len(x)) // 10 * 10])
    (finding,) = named(check_elbow(slow), "repeats")
    assert finding.where.startswith("truth/elbow")
    assert finding.what == "a new value in every 10 rows only, so about 150 ms late"


@pytest.mark.parametrize(("count", "slope"), [(2, 0.8), (3, 1.1)])
def test_a_session_whose_truth_moves_further_is_named(healthy, count, slope):
    spoilt = in_first(healthy[:count], truth__elbow=lambda x: 1.0 + slope * (x - 1.0))
    (finding,) = named(check_elbow(spoilt), "slope")
    assert finding.where == "truth/elbow in synthetic-0.csv"
    assert f"{slope:.2f} times" in finding.what


@pytest.mark.parametrize(
    ("push", "noise", "share"), [(3.0, 0.0, 0.8), (3.0, 1e-3, 0.95), (0.0, 1e-3, 0.8),
                                 (0.0, 0.0, 0.8), (0.0, 0.0, 0.95)]
)  # fmt: skip
def test_a_stop_is_told_from_a_saturated_sensor(healthy, push, noise, share):
    """A motor pushes at a stop, and what is measured there is not one value."""
    truth = healthy[0].column("truth/elbow")
    level = truth.min() + share * np.ptp(truth)
    beyond = truth > level
    still = level + noise * np.random.default_rng(0).normal(size=len(truth))
    spoilt = in_first(
        healthy[:2],
        truth__elbow=lambda x: np.where(beyond, still, x),
        effort__elbow=lambda x: x + push * beyond,
    )
    kind, other = ("stop", "saturated") if push or noise else ("saturated", "stop")
    check = check_elbow(spoilt)
    (finding,) = named(check, kind)
    assert not named(check, other)
    assert finding.where == "truth/elbow in synthetic-0.csv"
    assert all(beyond[first:behind].all() for first, behind in finding.rows)
    assert not gross_outliers(spoilt, "elbow")[0][beyond].any()
    if kind == "stop":
        assert not check.failed


def test_a_burst_is_found_wherever_it_begins(recording_of):
    """The truth scatters: what comes back from 0.4 rad need not come back to just where it left."""
    for seed in (0, 1):
        recording = recording_of("raven2", seed=seed, seconds=40, load=0.0)
        for first in range(100, 1100, 100):
            rows = list(range(first, first + 3))
            ill = in_first([recording], truth__elbow=added(rows, 0.4))
            (mask,) = gross_outliers(ill, "elbow")
            assert np.flatnonzero(mask).tolist() == rows
