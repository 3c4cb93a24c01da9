import io

import numpy as np
import pandas as pd
from matplotlib import figure as mpl_figure
from matplotlib.image import imread

from truejoint.drawing import Box, Curve, Figure, Panel, _draw, box_plot, by_condition, ecdf, png


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


def test_a_legend_below_hides_nothing(monkeypatch):
    drawn, savefig = [], mpl_figure.Figure.savefig

    def keep(picture, *arguments, **how):
        drawn.append(picture)
        savefig(picture, *arguments, **how)

    monkeypatch.setattr(mpl_figure.Figure, "savefig", keep)
    png(Figure("", [[Panel([Curve([0, 1], [0, 1], "label")], "x", "y")]], legend=True))
    (picture,) = drawn
    ((axis,), (legend,)) = picture.axes, picture.legends
    assert legend.get_window_extent().y1 <= axis.get_tightbbox().y0


def test_an_axis_over_many_decades_has_room_for_its_numbers():
    panel = Panel([Curve([0.15, 170.0], [0, 1], style="o")], x="RMSE", log="x")
    axis = mpl_figure.Figure().subplots()
    _draw(panel, axis)
    low, high = axis.get_xlim()
    shown = [value for value in axis.get_xticks() if low <= value <= high]
    np.testing.assert_allclose(shown, [1.0, 10.0, 100.0])
    short = mpl_figure.Figure().subplots()
    _draw(Panel([Curve([0.15, 1.7], [0, 1], style="o")], log="x"), short)
    low, high = short.get_xlim()
    shown = [value for value in short.get_xticks() if low <= value <= high]
    np.testing.assert_allclose(shown, [0.2, 0.5, 1.0])


FRAME = pd.DataFrame(
    {
        "model": ["a", "a", "b", "b", "a", "a", "b", "b"],
        "load": [1, 2, 1, 2, 1, 2, 1, 2],
        "rms": [1.0, 2.0, 3.0, 4.0, 3.0, 4.0, 5.0, 8.0],
    }
)


def test_a_cumulative_plot_gives_the_share_of_rows_below_an_absolute_value():
    frame = FRAME.assign(rms=FRAME.rms * np.array([1, -1] * 4))
    first, second = ecdf(frame, "rms", "model", scale=2.0).curves
    np.testing.assert_allclose(first.x, [2.0, 4.0, 6.0, 8.0])
    np.testing.assert_allclose(second.y, [0.0, 100 / 3, 200 / 3, 100.0])


def test_a_plot_by_condition_draws_medians():
    a, b = by_condition(FRAME, "load", "rms", "model").curves
    np.testing.assert_allclose([a.x, a.y], [[1, 2], [2.0, 3.0]])
    assert (a.label, b.label, list(b.y)) == ("a", "b", [4.0, 6.0])


def test_boxes_stand_side_by_side_at_their_condition():
    panel = box_plot(FRAME, "load", "rms", "model")
    assert [round(box.x, 3) for box in panel.boxes] == [-0.2, 0.2, 0.8, 1.2]
    assert [box.label for box in panel.boxes] == ["a", "b", "", ""]
    np.testing.assert_allclose(panel.boxes[3].values, [4.0, 8.0])
    assert panel.columns == ("1", "2")
