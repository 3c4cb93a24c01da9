"""The block that is printed: closed, asymmetric, in reach, and of the points that it states."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from truejoint.errors import CalibrationError
from truejoint.motion.touching import joints_at
from truejoint.robots import get_robot
from truejoint.tip import design_block
from truejoint.tip.block import BASE, CONE, PITCH

ROBOT = get_robot("raven2", "left")


@pytest.fixture(scope="module")
def shape():
    return design_block(ROBOT)


def triangles(data: bytes) -> np.ndarray:
    """Corners (n, 3, 3) [mm] of a binary STL, read as its format says."""
    count = int.from_bytes(data[80:84], "little")
    assert len(data) == 84 + 50 * count
    rows = np.frombuffer(data[84:], dtype=np.uint8).reshape(count, 50)
    return rows[:, 12:48].copy().view("<f4").reshape(count, 3, 3).astype(float)


def test_the_print_is_closed_and_holds_what_its_cells_hold(shape):
    corners = triangles(shape.stl()).round(3)
    edges = Counter()
    for a, b, c in corners:
        for start, end in ((a, b), (b, c), (c, a)):
            edges[*start, *end] += 1
    assert set(edges.values()) == {1}
    assert all((*edge[3:], *edge[:3]) in edges for edge in edges)
    volume = np.einsum("ni,ni->n", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6
    height = BASE + (shape.level.max() - shape.level) * shape.step
    cone = 24 / 2 * np.sin(2 * np.pi / 24) * CONE**2 * CONE / 3
    expected = 1e9 * (height.sum() * PITCH**2 - shape.reached.sum() * cone)
    assert volume == pytest.approx(expected, rel=1e-5)
    assert np.ptp(corners.reshape(-1, 3), axis=0) == pytest.approx(1e3 * shape.size, abs=1e-3)


def test_every_dimple_is_in_reach_and_its_point_is_the_bottom_of_its_cone(shape):
    points = np.array(list(shape.block().points.values()))
    assert len(points) >= 40
    space = ROBOT.workspace
    for point in points[::7]:
        goal = shape.rotation @ point + shape.translation
        joint = joints_at(ROBOT, goal, ROBOT.home)
        assert ROBOT.kinematics.forward(joint)[:3, 3] == pytest.approx(goal, abs=1e-8)
        assert (joint[:3] >= space.lower).all()
        assert (joint[:3] <= space.upper).all()
    lowest = {tuple(p) for p in triangles(shape.stl()).reshape(-1, 3).round(2).tolist()}
    assert {tuple(p) for p in (1e3 * points).round(2).tolist()} <= lowest


def test_the_dimples_lie_in_no_plane_and_no_turn_repeats_the_block(shape):
    points = np.array(list(shape.block().points.values()))
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    assert spread[2] > 0.2 * spread[0]
    for turns in (1, 2, 3):
        turned = np.rot90(shape.level, turns)
        assert turned.shape != shape.level.shape or (turned != shape.level).any()
    assert np.ptp(points[:, 2]) > 0.03


def test_the_map_has_every_number_where_its_dimple_is(shape):
    rows = [line[2:].split() for line in shape.map().splitlines()[1:]][::-1]
    points = shape.block().points
    places = {n: (x, y) for y, row in enumerate(rows) for x, n in enumerate(row) if n != "."}
    assert places.keys() == points.keys()
    for number, place in places.items():
        assert points[number][:2] == pytest.approx(PITCH * (np.array(place) + 0.5))


def test_a_workspace_that_is_hardly_deep_gets_no_plane_in_place_of_stairs():
    space = ROBOT.workspace
    lower = space.lower.copy()
    lower[2] = space.upper[2] - 1e-3
    shallow = replace(ROBOT, workspace=replace(space, lower=lower))
    with pytest.raises(CalibrationError, match="dimples of a block can be reached"):
        design_block(shallow)


def test_a_robot_of_unknown_geometry_gets_none():
    with pytest.raises(CalibrationError, match="kinematics"):
        design_block(get_robot("davinci_grasper"))
