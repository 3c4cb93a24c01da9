"""Robots as plain data, and the files that hold it."""

import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from truejoint.errors import RobotError
from truejoint.robots import Robot, arm_names, get_robot, robot_names
from truejoint.robots.chain import SerialChain

TOOL = """
name = "tool"
arms = ["left", "right"]
channels = ["lift", "spare", "jaw"]
positioning = ["lift"]
effort = "motor"
transmission = [[100.0, 0.0], [0.5, 20.0]]

[[joints]]
name = "lift"
kind = "prismatic"
unit = "mm"
lower = 10
upper = 250
home = 20
max_speed = 50

[[joints]]
name = "jaw"
unit = "deg"
lower = -40

[kinematics]
unit = "deg"
axes = [{ d = 0.1, kind = "prismatic" }, { alpha = 90, a = 0.02 }]

[workspace.lift]
lower = 20
upper = 200
speed = 25

[[encoders]]
joint = "lift"
resolution = 0.005
hard_stop = 5
end = "lower"
direction = -1
"""


@pytest.fixture
def tool(tmp_path):
    path = tmp_path / "tool.toml"
    path.write_text(TOOL)
    return path


def test_a_robot_file_says_what_a_robot_is(tool):
    robot = get_robot(tool, "Left")
    assert robot.title == "tool (left arm)"
    assert robot.joint("lift").upper == 0.25
    assert robot.joint("lift").max_speed == 0.05
    assert robot.joint("jaw").lower == math.radians(-40)
    assert robot.joint("jaw").upper == math.inf
    assert robot.unused_channels == ("spare",)
    assert robot.positioning == ("lift",)
    assert robot.effort == "motor"
    assert np.array_equal(robot.transmission.motor_from_joint([1, 2]), [100, 40.5])
    # The second axis points along -y of the first, so the jaw does not move the tool.
    np.testing.assert_allclose(robot.kinematics.forward([0.1, 0.3])[:3, 3], [0.02, 0, 0.2])


def test_a_robot_file_may_say_where_a_calibration_moves(tool):
    space = get_robot(tool).workspace
    assert space.joints == ("lift",)
    assert [space.lower[0], space.upper[0], space.speed[0]] == [0.02, 0.2, 0.025]
    assert space.margin is None


def test_a_robot_goes_wherever_a_name_goes(tool):
    robot = get_robot(tool, "right")
    assert get_robot(robot) is robot
    assert get_robot(robot, "right") is robot
    for name, arm in ((robot, "left"), (3, "")):
        with pytest.raises(RobotError, match="give the robot's name or the path of a robot file"):
            get_robot(name, arm)  # type: ignore[arg-type]
    with pytest.raises(RobotError, match="no robot called 'tool'"):  # a file names nothing
        get_robot("tool")


@pytest.mark.parametrize(
    ("name", "arm"),
    [*((name, "") for name in robot_names()), *(("wrist", arm) for arm in arm_names("wrist"))],
)
def test_plain_data_make_the_robot_again(name, arm):
    robot = get_robot(name, arm)
    values = json.loads(json.dumps(robot.to_dict(), allow_nan=False, sort_keys=bool(arm)))
    again = Robot.from_dict(values)
    assert again.to_dict() == robot.to_dict()
    assert again.joints == robot.joints
    assert (again.workspace is None) == (robot.workspace is None)
    if arm:  # what a loop's one cable gets its other gives, so that no pose stretches both
        moments = again.mechanism.moments.reshape(-1, 2, 3)
        np.testing.assert_array_equal(moments[:, 0], -moments[:, 1])
    if isinstance(robot.kinematics, SerialChain):
        pose = robot.kinematics.forward(robot.home)
        assert np.array_equal(again.kinematics.forward(robot.home), pose)


def test_a_file_that_changed_is_read_anew_and_takes_no_built_in_name(tool):
    get_robot(tool)
    tool.write_text(TOOL.replace("home = 20", "home = 30"))
    assert get_robot(tool).joint("lift").home == 0.03
    tool.write_text(TOOL.replace('"tool"', '"raven2"'))
    with pytest.raises(RobotError, match="another robot called 'raven2' than truejoint"):
        get_robot(tool, "left")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('name = "jaw"', 'name = "lift"', "joints: 'lift' stands twice"),
        ("lower = 10\n", "lower = 300\n", "lower limit 0.3 m is not below the upper one, 0.25"),
        ("home = 20", "home = 0", "home 0 m is not within its limits"),
        ("max_speed = 50", "max_speed = 0", "max_speed is 0; want above 0"),
        ('unit = "mm"', 'unit = "deg"', r"joints\[0\]: unit 'deg' does not fit a prismatic joint"),
        ('kind = "prismatic"\nu', 'kind = "ball"\nu', "kind is 'ball'; want revolute or prismatic"),
        ("[0.5, 20.0]]", "[0.5]]", "want n x n numbers"),
        ("[0.5, 20.0]]", "[50.0, 0.0]]", "must be square, finite and invertible"),
        ("[[100.0, 0.0], [0.5, 20.0]]", "[[2.0]]", "does not fit its 2 joints"),
        ('effort = "motor"', 'effort = "cable"', "effort is 'cable'; want joint or motor"),
        ('effort = "motor"', 'efort = "motor"', "no key called 'efort'; did you mean 'effort'"),
        ('["lift"]', '["wrist"]', "no joint called 'wrist'"),
        ('["lift", "spare", "jaw"]', '["jaw", "lift"]', "must hold every joint, in order"),
        ("lower = -40", "lower = -1" + 400 * "0", "lower is -10*; want a number from"),
        ("lower = -40", "lower = -1" + 5000 * "0", "is not TOML"),
        ("a = 0.02", "b = 0.02", r"kinematics.axes\[1\]: no key called 'b'"),
        ("[kinematics]", "[kinematics]\ntool_rotation = [[1]]", "want 3 x 3 numbers"),
        ("[kinematics]", "[kinematics]\naxis_from_joint = [[1]]", "must be 2 x 2 numbers"),
        ('name = "tool"', 'name = "my tool"', "name is 'my tool'; want up to 60 letters"),
        ('name = "tool"', "", "'name' is missing; add it"),
        ('["left", "right"]', '["left", "left"]', "arms: 'left' stands twice"),
        ("arms =", "arm =", "no key called 'arm'; did you mean 'arms'"),
        ("upper = 200", "upper = 251", "workspace.lift: 0.02 to 0.251 m at 0.025 m/s is beyond"),
        ("speed = 25", "speed = 51", "at 0.051 m/s is beyond what the joint can"),
        ('d = 0.1, kind = "prismatic"', "d = 0.1", "axes revolute, revolute do not fit the joints"),
        ("a = 0.02 }", "a = 0.02 }, {}", "axes prismatic, revolute, revolute do not fit"),
        ("workspace.lift", "workspace.lid", "no joint called 'lid'; known: lift, jaw"),
        ("upper = 200", "upper = 20", "workspace.lift: lower must be below upper"),
        ("resolution = 0.005", "resolution = 0", r"encoders\[0\].resolution is 0; want a number"),
        ("direction = -1", "direction = 2", "direction is 2; want 1 or -1"),
        ('end = "lower"', 'end = "middle"', "end is 'middle'; want lower or upper"),
        ('joint = "lift"', 'joint = "left"', "did you mean 'lift'"),
        (
            "speed = 25",
            "speed = 25\nmargin = 9\n[workspace.jaw]\nlower = 0\nupper = 20\nspeed = 5",
            "workspace: margin is missing for jaw; state it for every joint or for none",
        ),
    ],
)
def test_what_breaks_a_rule_is_named_in_one_line(tool, old, new, message):
    assert old in TOOL
    tool.write_text(TOOL.replace(old, new))
    with pytest.raises(RobotError, match=message) as error:
        get_robot(tool)
    assert str(error.value).startswith(f"{tool}: ")
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 300 + len(str(tool))


def test_a_file_that_is_not_there_or_without_the_arm_is_named(tool, tmp_path):
    with pytest.raises(RobotError, match=r"none.toml: cannot be read \(No such file"):
        get_robot(tmp_path / "none.toml")
    with pytest.raises(RobotError, match="no arm called 'middle'; its arms: left, right"):
        get_robot(tool, "middle")


def test_a_file_that_is_like_another_states_what_differs(tool, tmp_path):
    path, whole = tmp_path / "long.toml", get_robot(tool, "left").to_dict()
    changes = 'like = "tool.toml"\nname = "long"\n[workspace]\nlift = { upper = 210 }\n'
    path.write_text(changes)
    whole["workspace"]["lift"]["upper"] = 0.21
    assert get_robot(path, "left").to_dict() == {**whole, "name": "long"}
    assert arm_names(str(path)) == ("left", "right")
    for other, fault in (("3", "/3: cannot be read"), ('"long.toml"', "no key called 'like'")):
        path.write_text(changes.replace('"tool.toml"', other))
        with pytest.raises(RobotError, match=fault):
            get_robot(path)


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner),
    max_leaves=10,
)


@given(
    path=st.sampled_from(["name", "arm", "joints", "channels", "positioning", "effort", "gear",
                          "transmission", "kinematics", "workspace", "mechanism", "encoders",
                          "grasper"]),
    value=json_values,
    inside=st.sampled_from([(), (0, "name"), (0, "kind"), (0, "lower"), ("axes",), ("axes", 0)]),
)  # fmt: skip
def test_any_data_are_a_robot_or_refused_in_one_line(path, value, inside):
    values = json.loads(json.dumps(get_robot("dvrk_psm").to_dict()))
    values.setdefault(path, None)
    place, key = values, path
    for step in inside:
        if isinstance(place[key], dict if isinstance(step, str) else list):
            place, key = place[key], step
    place[key] = value
    message = "model: "
    try:
        Robot.from_dict(values, "model")
    except RobotError as error:
        message = str(error)
    assert message.startswith("model: ")
    assert "\n" not in message


def test_a_file_states_temporary_encoders_in_the_units_of_their_joints(tool):
    robot = get_robot(str(tool), "left")
    (encoder,) = robot.encoders
    assert (encoder.joint, encoder.end, encoder.direction, encoder.tolerance) == (
        "lift", "lower", -1, 20,
    )  # fmt: skip
    assert encoder.resolution == pytest.approx(5e-6)
    assert encoder.hard_stop == pytest.approx(5e-3)
    assert Robot.from_dict(json.loads(json.dumps(robot.to_dict()))).encoders == robot.encoders
