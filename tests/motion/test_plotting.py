"""Tests of truejoint.motion.plotting."""

import re

import matplotlib.image as mpimg
import numpy as np
import pytest

from truejoint.errors import TrajectoryError
from truejoint.motion import Trajectory, plot_trajectory, plotting, random_motion, zigzag
from truejoint.robots import get_robot

ROBOT = get_robot("raven2", "left")


def test_png_shows_lines(tmp_path):
    path = tmp_path / "z.png"
    plot_trajectory(zigzag(ROBOT, "J1", 0.5), path)
    picture = mpimg.imread(path)[:, :, :3]
    assert picture.shape[:2] == (1080, 1200)
    saturation = picture.max(axis=2) - picture.min(axis=2)
    assert (saturation > 0.2).sum() > 2000


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
        plotting,
        "_draw_png",
        lambda name, points, labels, path: drawn.append(points) or path.touch(),
    )
    motion = random_motion(ROBOT, 2500.0)
    plot_trajectory(motion, tmp_path / "long.png")
    (points,) = drawn
    assert len(motion) > 20_000
    assert len(points) <= 20_001 + 1
    assert points[-1] == pytest.approx(motion.positions[-1] * [180 / np.pi, 180 / np.pi, 1e3])


def test_what_cannot_be_drawn_is_refused(tmp_path):
    with pytest.raises(TrajectoryError, match=r"plots are .png or .html"):
        plot_trajectory(zigzag(ROBOT), tmp_path / "z.pdf")
    with pytest.raises(TrajectoryError, match="nowhere does not exist"):
        plot_trajectory(zigzag(ROBOT), tmp_path / "nowhere" / "z.png")
    flat = Trajectory(("a", "b"), ("rad", "m"), np.zeros((2, 2)))
    with pytest.raises(TrajectoryError, match="needs three joints"):
        plot_trajectory(flat, tmp_path / "z.png")
    assert list(tmp_path.iterdir()) == []
