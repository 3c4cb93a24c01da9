"""What a calibration is of: the robot, joints, features and columns that all recordings have.

Each raises CalibrationError where what is asked for is not there.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from truejoint.calibration.compatibility import (
    check_arm,
    check_columns,
    check_unit,
    listed,
    source_of,
)
from truejoint.calibration.redundancy import redundant_columns
from truejoint.errors import CalibrationError
from truejoint.estimators.base import JointRegressor
from truejoint.features.feature_set import FeatureSet, default_features
from truejoint.recordings import Recording
from truejoint.robots import Robot


def common_robot(recordings: Sequence[Recording]) -> Robot:
    """Robot that all recordings are of."""
    if not recordings:
        raise CalibrationError("no recordings to calibrate on; give at least one")
    robot = recordings[0].robot
    for recording in recordings:
        other = f"{source_of(recordings[0])} of {robot.title}"
        check_arm(recording, (robot.name, robot.arm), other)
    return robot


def chosen_joints(
    robot: Robot, recordings: Sequence[Recording], joints: Sequence[str] | None
) -> tuple[str, ...]:
    """Joints asked for, or the positioning joints of which each recording has the truth."""
    if joints is None:
        with_truth = [set(recording.joints_of("truth")) for recording in recordings]
        chosen = tuple(j for j in robot.positioning if all(j in known for known in with_truth))
        if not chosen:
            raise CalibrationError(
                f"{source_of(recordings[0])} has no truth column of {', '.join(robot.positioning)}"
                "; a calibration needs the true position of a joint that positions the tool"
            )
    else:
        chosen = tuple(dict.fromkeys([joints] if isinstance(joints, str) else joints))
        robot.index(chosen)
        if not chosen:
            raise CalibrationError(
                f"no joints to correct; {robot.title} has {', '.join(robot.joint_names)}"
            )
    for recording in recordings:
        for column in (f"{q}/{joint}" for q in ("measured", "truth") for joint in chosen):
            if column not in recording.table.columns:
                raise CalibrationError(
                    f"{source_of(recording)} has no column {column!r}, which calibrating "
                    f"{', '.join(chosen)} needs; it has {listed(list(recording.units))}"
                )
    return chosen


def chosen_features(
    model: JointRegressor,
    robot: Robot,
    recordings: Sequence[Recording],
    features: FeatureSet | Iterable[str] | None,
) -> FeatureSet:
    """Features asked for, which must be as many as the model takes; its own by default."""
    params, own = model.model_params(), model.family.inputs
    if features is None:
        chosen = FeatureSet.parse(own(params)) if own else default_features(robot, recordings[0])
    else:
        chosen = FeatureSet.parse(features)
    if features is not None:
        model.family.check_size(params, len(chosen))
    for recording in recordings:
        check_columns(recording, chosen.signals, "features need")
    return chosen


def in_all(recordings: Sequence[Recording], columns: Iterable[str]) -> list[str]:
    """Columns that every recording has, in one unit."""
    first = recordings[0].units
    return [
        name
        for name in columns
        if name in first and all(one.units.get(name) == first[name] for one in recordings)
    ]


def chosen_redundant(
    recordings: Sequence[Recording], asked: Sequence[str] | None
) -> dict[str, str]:
    """Units of the redundant columns that are asked for; of all by default."""
    there = redundant_columns(recordings)
    if asked is None:
        return there
    for column in asked:
        if column not in there:
            raise CalibrationError(
                f"column {column!r:.60} cannot check a measured position; these can, being in "
                f"every recording: {', '.join(there) or 'none'}"
            )
    return {column: there[column] for column in asked}


def common_units(
    recordings: Sequence[Recording], feature_set: FeatureSet, joints: Sequence[str]
) -> dict[str, str]:
    """Units of the columns that the calibration will need; the truth must share them."""
    first = recordings[0]
    columns = (*feature_set.signals, *(f"measured/{joint}" for joint in joints))
    units = {column: first.units[column] for column in columns}
    for recording in recordings:
        for column, unit in units.items():
            check_unit(recording, column, unit, f"in {source_of(first)} in")
        for joint in joints:
            measured = f"measured/{joint}"
            check_unit(recording, f"truth/{joint}", units[measured], f"{measured!r} in")
    return units
