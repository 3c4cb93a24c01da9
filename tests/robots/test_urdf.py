"""Kinematics from a URDF against the transforms of the library that reads it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from truejoint.errors import RobotError
from truejoint.robots import Joint, Robot, get_robot
from truejoint.robots.urdf import read_urdf

urdf = pytest.importorskip("pytransform3d.urdf")

KINDS = ("revolute", "prismatic", "fixed", "continuous")
angles = st.sampled_from([0.0, np.pi / 2, -np.pi / 2, np.pi]) | st.floats(-3, 3)
lengths = st.sampled_from([0.0, 0.1]) | st.floats(-0.5, 0.5)
directions = st.sampled_from([(1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, -1)]) | st.tuples(
    st.floats(-1, 1), st.floats(-1, 1), st.floats(0.1, 1)
)
links = st.tuples(
    st.sampled_from(KINDS), st.tuples(lengths, lengths, lengths),
    st.tuples(angles, angles, angles), directions,
)  # fmt: skip


def document(chain, extra=""):
    def words(values):
        return " ".join(map(repr, map(float, values)))

    joints = [
        f'<joint name="j{n}" type="{kind}"><parent link="l{n}"/><child link="l{n + 1}"/>'
        f'<origin xyz="{words(xyz)}" rpy="{words(rpy)}"/><axis xyz="{words(axis)}"/>'
        '<limit lower="-9" upper="9" effort="1" velocity="1"/></joint>'
        for n, (kind, xyz, rpy, axis) in enumerate(chain)
    ]
    names = "".join(f'<link name="l{n}"/>' for n in range(len(chain) + 1))
    return f'<robot name="r">{names}{"".join(joints)}{extra}</robot>'


def joints_of(chain):
    return tuple(
        Joint(f"j{n}", "prismatic" if kind == "prismatic" else "revolute")
        for n, (kind, *_) in enumerate(chain)
        if kind != "fixed"
    )


@given(chain=st.lists(links, min_size=1, max_size=6), seed=st.integers(0, 99))
def test_poses_are_those_of_the_urdf(tmp_path_factory, chain, seed):
    path = tmp_path_factory.mktemp("urdf") / "arm.urdf"
    path.write_text(document(chain))
    joints = (*joints_of(chain), Joint("other"))
    values = np.random.default_rng(seed).uniform(-1, 1, len(joints))
    manager = urdf.UrdfTransformManager()
    manager.load_urdf(document(chain))
    for joint, value in zip(joints[:-1], values, strict=False):
        manager.set_joint(joint.name, value)
    expected = manager.get_transform(f"l{len(chain)}", "l0")
    np.testing.assert_allclose(
        read_urdf(path, {joint.name: joint.kind for joint in joints}).forward(values),
        expected,
        atol=1e-6,
    )


ARM = [
    ("revolute", (0, 0, 0.3), (0, 0, 0), (0, 1, 0)),
    ("fixed", (0.2, 0, 0), (0.1, 0, 0), (1, 0, 0)),
    ("prismatic", (0, 0, 0.1), (0, 1, 0), (0, 0, 1)),
]
FILE = """
name = "urdf_arm"
[[joints]]
name = "j0"
[[joints]]
name = "j2"
kind = "prismatic"
[kinematics]
urdf = "arm.urdf"
"""


@pytest.fixture
def arm(tmp_path):
    (tmp_path / "arm.urdf").write_text(document(ARM))
    path = tmp_path / "arm.toml"
    path.write_text(FILE)
    return path


def test_the_plain_data_no_longer_need_the_urdf(arm):
    robot = get_robot(arm)
    again = Robot.from_dict(robot.to_dict())
    pose = robot.kinematics.forward([0.3, 0.02])
    assert np.array_equal(again.kinematics.forward([0.3, 0.02]), pose)


@pytest.mark.parametrize(
    ("text", "old", "new", "message"),
    [
        (document(ARM), '"j2"', '"other"', "joint 'j2' is not among the robot's joints j0, other"),
        (document(ARM), 'kind = "prismatic"', "", "joint 'j2' is prismatic there, but not in the"),
        (document(ARM), '"arm.urdf"', '"none.urdf"', "none.urdf: cannot be read"),
        (document(ARM), '"arm.urdf"', '"\\u0000"', "cannot be read"),
        (document(ARM), '"arm.urdf"', '"/dev/zero"', "is not a file"),
        (document(ARM), '"arm.urdf"', '"arm.urdf"\ntip = "x"', "no joints lead from link 'x' to"),
        (document(ARM), '"arm.urdf"', '"arm.urdf"\nbase = "l9"', "no joints lead from link 'l9'"),
        (document(ARM), '"arm.urdf"', '"arm.urdf"\nroot = "l9"', "no key called 'root'"),
        ("<robot", "", "", "cannot be read as a URDF"),
        ('<!DOCTYPE r [<!ENTITY e SYSTEM "file:///etc/passwd">]><robot name="&e;"/>', "", "",
         "no document type or CDATA is read"),
        ("", "", "", "cannot be read as a URDF"),
        (document(ARM).replace('xyz="0.0 1.0 0.0"', 'xyz="0 0 0"'), "", "", "want a direction"),
        (
            document(ARM, '<link name="b"/><joint name="k" type="fixed"><parent link="l0"/>'
                     '<child link="b"/></joint>'),
            "", "", "ends in the links b, l3; name one as tip",
        ),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_named_in_one_line(arm, text, old, new, message):
    arm.with_suffix(".urdf").write_text(text)
    arm.write_text(FILE.replace(old, new) if old else FILE)
    with pytest.raises(RobotError, match=message) as error:
        get_robot(arm)
    assert "\n" not in str(error.value)
