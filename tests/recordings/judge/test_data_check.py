import json
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from tests.recordings.judge.faults import changed

from truejoint.errors import RecordingError
from truejoint.features import FeatureSet
from truejoint.recordings import DataCheck, Finding, check_data
from truejoint.recordings.judge.data_check import joint_coverage
from truejoint.recordings.table.recording import Provenance, Recording
from truejoint.robots import Joint, Robot


@pytest.fixture
def clean(recording_of: Callable[..., Recording]) -> Recording:
    return recording_of("davinci_grasper", seconds=60, load=0.5, homing_id="h1")


def _found(check: DataCheck, word: str) -> list[Finding]:
    return [f for f in check.findings if word in f.what]


def test_clean_data_raise_nothing_but_information(clean):
    check = check_data([clean])
    assert {f.level for f in check.findings} <= {"info"}
    assert not check.failed
    assert _found(check, "one load only: 500 g")
    json.dumps(check.to_dict(), allow_nan=False)


def test_coverage_is_what_was_recorded(clean):
    row = joint_coverage([clean, clean], "jaw")
    position = clean.column("measured/jaw")
    assert (row.lowest, row.highest) == (position.min(), position.max())
    assert row.up + row.down + row.standing == pytest.approx(1.0)
    assert row.up == pytest.approx(0.5, abs=0.1)
    assert row.rows == 2 * len(clean)
    assert row.duration == pytest.approx(2 * clean.duration)
    assert row.effort_unit == "Nm"
    assert 0 < row.speed_median < row.speed_high


def test_limits_give_a_share_of_travel(recording_of):
    recording = recording_of("raven2")
    joint = recording.robot.joint("elbow")
    position = recording.column("measured/elbow")
    share = joint_coverage([recording], "elbow").share_of_limits
    assert share == pytest.approx(np.ptp(position) / (joint.upper - joint.lower))


def test_a_gap_is_found(clean):
    keep = np.ones(len(clean), dtype=bool)
    keep[300:360] = False
    (finding,) = _found(check_data([clean.rows(keep)]), "gap")
    assert finding.level == "warn"
    assert finding.what.startswith("1 gap longer than 5 samples, up to 2.03 s")


def test_an_irregular_clock_is_found(clean):
    step = np.where(np.arange(len(clean)) % 3 == 0, 0.06, 0.02)
    check = check_data([changed(clean, t=np.cumsum(step))])
    assert _found(check, "half off the median")


@pytest.mark.parametrize("quantity", ["measured", "truth"])
def test_a_wrap_of_the_encoder_fails_the_check(clean, quantity):
    values = clean.column(f"{quantity}/jaw").copy()
    values[700:] += 2 * np.pi
    check = check_data([changed(clean, **{f"{quantity}__jaw": values})])
    (finding,) = _found(check, "whole turn")
    assert finding.level == "fail"
    assert finding.where == f"{quantity}/jaw in synthetic-0.csv"
    assert check.failed
    values[700:] += 1.0 - 2 * np.pi
    check = check_data([changed(clean, **{f"{quantity}__jaw": values})])
    assert not _found(check, "whole turn")
    if quantity == "measured":
        assert _found(check, "1 sudden jump,")[0].level == "warn"


@pytest.mark.parametrize("frozen", ["truth", "measured"])
def test_a_sensor_that_freezes_while_the_joint_moves(clean, frozen):
    values = clean.column(f"{frozen}/jaw").copy()
    values[400:600] = values[400]
    check = check_data([changed(clean, **{f"{frozen}__jaw": values})])
    (finding,) = _found(check, "repeats one value")
    assert finding.level == "fail"
    assert finding.where.startswith(f"{frozen}/jaw")


def test_a_constant_signal_is_found_but_not_on_an_unused_channel(recording_of):
    recording = recording_of("raven2")
    table = recording.table.assign(
        **{"effort/elbow": 0.5, "measured/unused": 0.0, "effort/unused": 0.0}
    )
    units = {**recording.units, "measured/unused": "1", "effort/unused": "1"}
    check = check_data([Recording(table, units, recording.provenance)])
    (finding,) = _found(check, "in every row")
    assert finding.where.startswith("effort/elbow")


def test_missing_truth_is_counted_and_its_end_found(clean):
    values = clean.column("truth/jaw").copy()
    values[len(values) * 7 // 10 :] = np.nan
    check = check_data([changed(clean, truth__jaw=values)])
    assert _found(check, "30 % of the rows have no true position")[0].level == "warn"
    assert _found(check, "the truth stops 18.0 s before the end")
    values[len(values) * 4 // 10 :] = np.nan
    assert check_data([changed(clean, truth__jaw=values)]).failed


def test_one_direction_and_rest_are_found():
    t = np.arange(3000) / 100
    position = np.interp(t % 10, [0, 4, 4.5, 10], [0, 1, 0, 0])
    columns = {"t": t, "measured/jaw": position, "truth/jaw": position + 0.01 * np.sin(t)}
    check = check_data([Recording.from_columns(columns, Provenance("davinci_grasper"))])
    assert _found(check, "one direction of motion holds only")
    assert _found(check, "stands still in 5")


def test_a_hole_in_the_range_is_found():
    t = np.arange(4000) / 100
    position = np.where(t < 20, 0.2 * np.sin(3 * t), 2.0 + 0.2 * np.sin(3 * t))
    columns = {"t": t, "measured/jaw": position, "truth/jaw": position}
    check = check_data([Recording.from_columns(columns, Provenance("davinci_grasper"))])
    assert _found(check, "hardly visited")


def test_dropped_rows_and_two_homings_are_told(recording_of):
    recording = recording_of("davinci_grasper", dropped={"in a gap": 200, "before truth": 0})
    homings = [recording_of("davinci_grasper", homing_id=h) for h in ("a", "b")]
    assert _found(check_data(homings), "2 homings (a, b)")
    (finding,) = _found(check_data([recording]), "dropped")
    assert "200 in a gap" in finding.what
    assert "before truth" not in finding.what
    assert finding.level == "warn"


def test_the_same_finding_of_many_recordings_is_one_line(recording_of):
    recordings = []
    for seed in range(4):
        recording = recording_of("davinci_grasper", seed=seed, seconds=60)
        values = recording.column("truth/jaw").copy()
        values[: 50 * (seed + 2)] = np.nan
        recordings.append(changed(recording, truth__jaw=values))
    (finding,) = _found(check_data(recordings), "no true position")
    assert finding.where == "truth/jaw in synthetic-3.csv and 3 more of 4 recordings"


@dataclass(frozen=True)
class _Trained:
    joints: tuple[str, ...]
    feature_set: FeatureSet
    lower: np.ndarray
    upper: np.ndarray
    gap_limit: float = 1.0
    training_domain: None = None


def test_extrapolation_is_counted_by_signal(clean):
    features = FeatureSet.parse(["measured/jaw", "lag(measured/jaw, 2)", "effort/jaw"])
    rows = features.compute(clean)
    middle = float(np.median(rows[:, 0]))
    trained = _Trained(
        ("jaw",), features, np.array([-9.0, -9.0, -9.0]), np.array([9.0, middle, 9.0])
    )
    findings = _found(check_data([clean], model=trained), "outside the range")
    assert [f.where for f in findings] == ["lag(measured/jaw, 2)"]
    wide = replace(trained, upper=np.array([9.0, 9.0, 9.0]))
    assert not _found(check_data([clean], model=wide), "outside the range")
    narrow = replace(trained, upper=np.array([-8.0, 9.0, 9.0]))
    assert check_data([clean], model=narrow).failed


def test_a_signal_whose_name_begins_as_another_is_counted_by_itself():
    t = np.arange(400) / 100
    names = ("joint1", "joint12")
    robot = Robot("long_arm", tuple(map(Joint, names)))
    way = np.sin(2 * t)
    columns = {"t": t} | {f"{q}/{name}": way for q in ("measured", "truth") for name in names}
    recording = Recording.from_columns(columns, "long_arm", robot=robot)
    features = FeatureSet.parse([f"measured/{name}" for name in names])
    narrow = _Trained(names, features, np.full(2, -0.1), np.full(2, 0.1))
    findings = _found(check_data([recording], model=narrow), "outside the range")
    assert [f.where for f in findings] == ["measured/joint1", "measured/joint12"]


@pytest.mark.parametrize(("narrower", "names"), [(0.004, set()), (0.2, {"range"})])
def test_a_hundredth_of_the_range_is_forgiven(clean, narrower, names):
    values = clean.column("measured/jaw")
    slack, features = narrower * np.ptp(values), FeatureSet.parse(["measured/jaw"])
    bounds = np.array([values.min() + slack]), np.array([values.max() - slack])
    check = check_data([clean], model=_Trained(("jaw",), features, *bounds))
    assert {f.name for f in check.findings} & {"range"} == names


def test_nothing_to_check_is_refused(clean):
    with pytest.raises(RecordingError, match="no recording"):
        check_data([])
    with pytest.raises(RecordingError, match="no column 'measured/elbow'"):
        check_data([clean], joints=["elbow"])
