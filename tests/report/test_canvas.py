"""Figures with any names that a file may have."""

import matplotlib.pyplot as plt
import numpy as np

import tirefit
from tirefit.report.canvas import Picture, save_picture


def test_letters_missing_in_the_font_are_boxes(tmp_path):
    """Without a warning, which the tests turn into an error."""
    picture = Picture(figsize=(1, 1))
    picture.text(0.1, 0.5, "run \x1b 测试 \N{SNOWMAN WITHOUT SNOW}")
    for name in ("a.png", "a.svg"):
        assert save_picture(picture, tmp_path / name).stat().st_size > 500
    assert picture._repr_png_().startswith(b"\x89PNG")


def test_a_fit_stays_inside_the_axes_of_the_user():
    """Several loads give several groups, whose legend does not fit next to the axes."""
    slip = np.tile(np.linspace(-0.1, 0.2, 30), 3)
    fz = np.repeat([2e3, 4e3, 6e3], 30)
    fx = fz * np.tanh(20 * slip) + np.random.default_rng(0).normal(0, 20, 90)
    result = tirefit.fit({"sigma_x": slip, "fx": fx, "fz": fz})
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 4))
    assert result.plot(ax=left) is figure
    figure.canvas.draw()
    legend, inside = left.get_legend().get_window_extent(), left.get_window_extent()
    assert inside.x0 <= legend.x0 and legend.x1 <= inside.x1
    assert inside.y0 <= legend.y0 and legend.y1 <= inside.y1
    assert not right.lines and len(left.get_legend().get_texts()) > 4
    plt.close(figure)
