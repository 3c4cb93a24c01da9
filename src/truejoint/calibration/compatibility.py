"""Whether recordings, arms and a calibration go together, and what recordings have in common.

Each function raises CalibrationError where they do not.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Final

from truejoint.errors import CalibrationError, meant
from truejoint.features.feature_set import FeatureSet, default_features
from truejoint.robots.robot import Robot, as_robot

if TYPE_CHECKING:
    from truejoint.estimators.base import JointRegressor
    from truejoint.recordings import Recording

_SHOWN: Final = 12  # columns in a message


def check_columns(recording: Recording, columns: Sequence[str], whose: str) -> None:
    """Raise CalibrationError, naming them, when columns are missing that something needs."""
    missing = [column for column in columns if column not in recording.table.columns]
    if missing:
        quantity = missing[0].partition("/")[0] + "/"  # of another one nothing can be meant
        alike = [name for name in recording.units if name.startswith(quantity)]
        raise CalibrationError(
            f"{source_of(recording)} lacks {listed(missing)}, which the {whose};"
            f"{meant(missing[0], alike)} it has {listed(list(recording.units))}"
        )


def listed(columns: Sequence[str]) -> str:
    """First columns by name, and how many more there are."""
    more = len(columns) - _SHOWN
    return ", ".join([*columns[:_SHOWN], *[f"{more} more"] * (more > 0)])


def check_units(recording: Recording, units: Mapping[str, str], where: str) -> None:
    """Raise CalibrationError unless columns are in the units that they have elsewhere."""
    for column, unit in units.items():
        if recording.units[column] != unit:
            raise CalibrationError(
                f"{source_of(recording)}: {column!r} is in {recording.units[column]}, {where} "
                f"{unit}; convert it where the file is read"
            )


def check_arm(recording: Recording, arm: tuple[str, str], other: str) -> None:
    """Raise CalibrationError unless a recording is of the robot and arm that another is of."""
    robot = recording.robot
    if (robot.name, robot.arm) != arm:
        raise CalibrationError(
            f"{source_of(recording)} is of {robot.title}, {other}; take recordings of one arm alone"
        )


def check_robot(made_for: tuple[str, str], robot: Robot) -> None:
    """Raise CalibrationError unless an arm is the one that a calibration was `made_for`."""
    if (as_robot(robot).name, robot.arm) != made_for:
        raise CalibrationError(
            f"the calibration of {Robot(made_for[0], (), made_for[1]).title} is not for "
            f"{robot.title}; give one that was made on recordings of this arm"
        )


def source_of(recording: Recording) -> str:
    """File or robot that a recording is of, for a message."""
    return recording.provenance.source or "recording"


def common_robot(recordings: Sequence[Recording]) -> Robot:
    """Robot that all recordings are of."""
    if not recordings:
        raise CalibrationError("no recordings are given; give at least one")
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
        with_truth = set.intersection(*[set(r.joints_of("truth")) for r in recordings])
        chosen = tuple(joint for joint in robot.positioning if joint in with_truth)
        missing = (
            f"{source_of(recordings[0])} has no truth column of {', '.join(robot.positioning)}; a "
            "calibration needs the true position of a joint that positions the tool"
        )
    else:
        chosen = tuple(dict.fromkeys([joints] if isinstance(joints, str) else joints))
        robot.index(chosen)
        missing = f"no joints to correct; {robot.title} has {', '.join(robot.joint_names)}"
    if not chosen:
        raise CalibrationError(missing)
    needed = [f"{quantity}/{joint}" for quantity in ("measured", "truth") for joint in chosen]
    for recording in recordings:
        check_columns(recording, needed, f"calibration of {', '.join(chosen)} needs")
    return chosen


def chosen_features(
    model: JointRegressor,
    robot: Robot,
    recordings: Sequence[Recording],
    features: FeatureSet | Iterable[str] | None,
) -> FeatureSet:
    """Features asked for, which must be as many as the model takes; its own by default."""
    params, inputs = model.model_params(), model.family.inputs
    if features is not None:
        chosen = FeatureSet.parse(features)
        model.family.check_size(params, len(chosen))
    elif inputs is not None:
        chosen = FeatureSet.parse(inputs(params))
    else:
        chosen = default_features(robot, recordings[0])
    for recording in recordings:
        check_columns(recording, chosen.signals, "features need")
    return chosen


def in_all(recordings: Sequence[Recording], columns: Iterable[str]) -> list[str]:
    """Columns that every recording has, in one unit."""
    common = dict(set.intersection(*[set(recording.units.items()) for recording in recordings]))
    return [name for name in columns if name in common]


def common_units(
    recordings: Sequence[Recording], feature_set: FeatureSet, joints: Sequence[str]
) -> dict[str, str]:
    """Units of the columns that the calibration will need; the truth must share them."""
    first = recordings[0]
    columns = (*feature_set.signals, *(f"measured/{joint}" for joint in joints))
    units = {column: first.units[column] for column in columns}
    for recording in recordings:
        check_units(recording, units, f"in {source_of(first)} in")
        for joint in joints:
            name = f"measured/{joint}"
            check_units(recording, {f"truth/{joint}": units[name]}, f"{name!r} in")
    return units
