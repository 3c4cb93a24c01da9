from __future__ import annotations

import io

import numpy as np
from matplotlib.image import imread

from truejoint.studies.figures import Box, Curve, Figure, Panel, png


def test_a_picture_has_its_size_and_shows_its_curves():
    curve = Curve([1.0, 2.0, 3.0], [1.0, 10.0, 100.0], "label", "tab:red", width=3.0)
    panels = [
        [Panel([curve], "x", "y", "title", log="xy", shade=(1.0, 2.0), legend=True)],
        [Panel([Curve([1, 2], [0, 1], style="o")], rows=("above", "below"))],
    ]
    data = png(Figure("title", panels, width=4.0, height=5.0, legend=True))
    picture = imread(io.BytesIO(data))
    assert picture.shape[:2] == (650, 520)
    red = np.linalg.norm(picture[..., :3] - np.array([0.839, 0.153, 0.157]), axis=-1) < 0.1
    assert red.sum() > 200


def test_a_box_stands_where_its_values_are():
    boxes = [Box(k, [1.0, 2.0, 3.0, 10.0], "tab:red", "label" * (k == 0)) for k in range(2)]
    panel = Panel((), y="value", boxes=boxes, columns=("first", "second"))
    picture = imread(io.BytesIO(png(Figure("title", ((panel,),), width=4.0, height=3.0))))
    red = np.linalg.norm(picture[..., :3] - np.array([0.839, 0.153, 0.157]), axis=-1) < 0.1
    columns = np.flatnonzero(red.any(axis=0))
    assert columns.size > 40
    assert np.ptp(columns) > 150  # both boxes
