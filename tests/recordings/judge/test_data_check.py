"""What recordings cover, what their origins say, and rows that a model has not seen."""

import json
import re
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from tests.recordings.judge.faults import added, changed, named
from tests.recordings.refusals import refused

from truejoint.features import FeatureSet
from truejoint.recordings import Provenance, Recording, check_data
from truejoint.recordings.judge.data_check import joint_coverage
from truejoint.recordings.read.bags.container import CUT_SHORT
from truejoint.robots import Joint, Robot


@pytest.fixture(scope="module")
def clean(recording_of: Callable[..., Recording]) -> Recording:
    return recording_of("davinci_grasper", seconds=60, load=0.5, homing_id="h1")


def _jaw(t: np.ndarray, position: np.ndarray, error: np.ndarray | float = 0.0) -> Recording:
    columns = {"t": t, "measured/jaw": position, "truth/jaw": position + error}
    return Recording.from_columns(columns, "davinci_grasper")


def test_clean_data_raise_nothing_but_information(clean):
    check = check_data([clean])
    assert {f.level for f in check.findings} <= {"info"}
    assert not check.failed
    assert named(check, "load")[0].what == "one load only: 500 g"
    json.dumps(check.to_dict(), allow_nan=False)


def test_coverage_is_what_was_recorded(clean, recording_of):
    row, position = joint_coverage([clean, clean], "jaw"), clean.column("measured/jaw")
    assert (row.lowest, row.highest) == (position.min(), position.max())
    assert row.up + row.down + row.standing == pytest.approx(1.0)
    assert row.up == pytest.approx(0.5, abs=0.1)
    assert (row.rows, row.effort_unit) == (2 * len(clean), "Nm")
    assert row.duration == pytest.approx(2 * clean.duration)
    assert 0 < row.speed_median < row.speed_high
    raven = recording_of("raven2")
    joint, position = raven.robot.joint("elbow"), raven.column("measured/elbow")
    share = joint_coverage([raven], "elbow").share_of_limits
    assert share == pytest.approx(np.ptp(position) / (joint.upper - joint.lower))


def test_one_direction_rest_and_holes_are_found():
    t = np.arange(3000) / 100
    position = np.interp(t % 10, [0, 4, 4.5, 10], [0, 1, 0, 0])
    check = check_data(_jaw(t, position, 0.01 * np.sin(t)))
    assert named(check, "directions")[0].what.startswith("one direction of motion holds only")
    assert named(check, "standstill")[0].what.startswith("the joint stands still in 5")
    apart = np.where(t < 15, 0.0, 2.0) + 0.2 * np.sin(3 * t)
    assert "hardly visited" in named(check_data(_jaw(t, apart)), "hole")[0].what


def test_dropped_rows_and_two_homings_are_told(recording_of):
    lost = {"in a gap": 200, "before truth": 0, CUT_SHORT: 10**6}
    recording = recording_of("davinci_grasper", dropped=lost)
    homings = [recording_of("davinci_grasper", homing_id=h) for h in ("a", "b")]
    assert named(check_data(homings), "homing")[0].what == "2 homings (a, b)"
    (finding,) = named(check_data([recording]), "dropped")
    assert re.fullmatch(f"200 rows .* read: 200 in a gap, 1000000 {CUT_SHORT}", finding.what)
    assert finding.level == "warn"


def test_the_same_finding_of_many_recordings_is_one_line(recording_of):
    recordings = [
        changed(
            recording_of("davinci_grasper", seed=seed, seconds=60),
            truth__jaw=added(slice(0, 50 * (seed + 2)), np.nan),
        )
        for seed in range(4)
    ]
    (finding,) = named(check_data(recordings), "missing")
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
    middle = float(np.median(features.compute(clean)[:, 0]))
    trained = _Trained(("jaw",), features, np.full(3, -9.0), np.array([9.0, middle, 9.0]))
    findings = named(check_data([clean], model=trained), "range")
    assert [f.where for f in findings] == ["lag(measured/jaw, 2)"]
    assert not named(check_data([clean], model=replace(trained, upper=np.full(3, 9.0))), "range")
    narrow = replace(trained, upper=np.array([-8.0, 9.0, 9.0]))
    assert check_data([clean], model=narrow).failed


def test_a_signal_whose_name_begins_as_another_is_counted_by_itself():
    joints = ("joint1", "joint12")
    t, robot = np.arange(400) / 100, Robot("long_arm", tuple(map(Joint, joints)))
    columns = {f"{q}/{name}": np.sin(2 * t) for q in ("measured", "truth") for name in joints}
    recording = Recording.from_columns({"t": t, **columns}, Provenance("long_arm"), robot=robot)
    features = FeatureSet.parse([f"measured/{name}" for name in joints])
    narrow = _Trained(joints, features, np.full(2, -0.1), np.full(2, 0.1))
    findings = named(check_data([recording], model=narrow), "range")
    assert [f.where for f in findings] == ["measured/joint1", "measured/joint12"]


@pytest.mark.parametrize(("narrower", "findings"), [(0.004, 0), (0.2, 1)])
def test_a_hundredth_of_the_range_is_forgiven(clean, narrower, findings):
    values = clean.column("measured/jaw")
    slack, features = narrower * np.ptp(values), FeatureSet.parse(["measured/jaw"])
    bounds = np.array([values.min() + slack]), np.array([values.max() - slack])
    check = check_data([clean], model=_Trained(("jaw",), features, *bounds))
    assert len(named(check, "range")) == findings


def test_nothing_to_check_is_refused(clean):
    refused("no recording", check_data, [])
    refused("no column 'measured/elbow'", check_data, [clean], joints=["elbow"])
