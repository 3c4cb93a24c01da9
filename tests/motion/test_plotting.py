"""Tests of truejoint.motion.plotting."""

import re

import numpy as np
import pytest

from truejoint.errors import TrajectoryError
from truejoint.motion import Trajectory, plot_trajectory, plotting, random_motion, zigzag
from truejoint.robots import get_robot

ROBOT = get_robot("raven2", "left")


def test_html_is_self_contained_and_faithful(tmp_path):
    path = tmp_path / "z.html"
    plot_trajectory(zigzag(ROBOT, "J2-J3", 0.5), path)
    page = path.read_text().replace("\\u002f", "/")
    assert not re.findall(r"<(?:script|link|img)[^>]+(?:src|href)=", page)
    for label in ("shoulder [deg]", "elbow [deg]", "insertion [mm]", "zigzag J2-J3 1/2"):
        assert label in page
    assert '"modeBarButtonsToRemove": ["sendChartToCloud"' in page


def test_long_motions_are_thinned_but_end_where_they_end(tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr(
        plotting, "_draw", lambda name, points, labels, path: drawn.append(points) or path.touch()
    )
    motion = random_motion(ROBOT, 2500.0)
    plot_trajectory(motion, tmp_path / "long.html")
    (points,) = drawn
    assert len(motion) > 20_000
    assert len(points) <= 20_001 + 1
    assert points[-1] == pytest.approx(motion.positions[-1] * [180 / np.pi, 180 / np.pi, 1e3])


def test_what_cannot_be_drawn_is_refused(tmp_path):
    with pytest.raises(TrajectoryError, match=r"z.pdf: .* call it .html"):
        plot_trajectory(zigzag(ROBOT), tmp_path / "z.pdf")
    flat = Trajectory(("a", "b"), ("rad", "m"), np.zeros((2, 2)))
    with pytest.raises(TrajectoryError, match="needs three joints"):
        plot_trajectory(flat, tmp_path / "z.html")
    assert list(tmp_path.iterdir()) == []
