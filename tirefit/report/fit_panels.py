"""The figures of the page of a fit, readable on a phone.

They are narrow: on a screen of 375 pixels, 8.5 points are then 9.6 pixels high.
"""

from collections.abc import Mapping
from typing import NamedTuple

from matplotlib.legend import Legend

from tirefit.fitting.result import FitResult
from tirefit.report.by_name import has_runs, place_points, run_points
from tirefit.report.canvas import Picture
from tirefit.report.curves import fit_curve
from tirefit.report.draw import (
    draw_autocorrelation,
    draw_fit,
    draw_histogram,
    draw_quantiles,
    draw_scatter,
)
from tirefit.report.draw_corner import corner_figure
from tirefit.report.draw_uncertainty import draw_profile, trace_figure
from tirefit.report.residuals import Residuals, residual_panels
from tirefit.report.uncertainty import has_trace, profile_data

WIDE = 4.6
_SMALL = 2.3
_MOST_PAIRED = 40  # largest number of parameters of which all pairs are drawn
_PIXELS = 100
"""Pixels of the page per inch of a picture that is too wide for a phone and scrolls."""


class Shown(NamedTuple):
    """A picture of the page with its description, and its smallest width on the screen
    [px], 0 if it may shrink."""

    picture: Picture
    alternative: str
    least: int = 0


def _empty(height: float, width: float = WIDE) -> Picture:
    return Picture(figsize=(width, height), layout="constrained")


def below(picture: Picture, legend: Legend | None, columns: int = 2) -> None:
    """Move the legend of axes below them."""
    if legend is None:
        return
    handles = [handle for handle in legend.legend_handles if handle is not None]
    texts = [text.get_text().replace("\n", " ") for text in legend.get_texts()]
    title = legend.get_title().get_text()
    legend.remove()
    picture.legend(
        handles,
        texts,
        loc="outside lower left",
        ncols=columns,
        fontsize=8,
        frameon=False,
        title=title.replace("\n", " ") or None,
        title_fontsize=8,
        alignment="left",
    )


def curve_pictures(result: FitResult) -> list[Shown]:
    """Points, curve and bands of every fitted force."""
    shown = []
    for channel in result.forces:
        curve = fit_curve(result, channel)
        picture = _empty(3.3 + 0.1 * len(curve.groups))
        axes = picture.subplots()
        draw_fit(axes, curve)
        below(picture, axes.get_legend())
        text = f"Measured points and fitted curve of {channel} over slip, with bands"
        shown.append(Shown(picture, text))
    return shown


def residual_pictures(result: FitResult) -> list[Shown]:
    """Residuals over every input that varies, their distribution, and their sequence."""
    data = residual_panels(result)
    first, *others = result.forces
    panels = [(first, panel) for panel in data.scatters]
    panels += [(force, residual_panels(result, force).scatters[0]) for force in others]
    shown = []
    for force, panel in panels:
        picture = _empty(_SMALL + (0.4 if panel.ticks else 0))
        draw_scatter(picture.subplots(), panel, force)
        shown.append(Shown(picture, f"Residuals of {force} against {panel.label}"))
    return [*shown, *_distribution(data)]


def _distribution(data: Residuals) -> list[Shown]:
    jobs = [
        (draw_histogram, "Distribution of the residuals beside a normal one"),
        (draw_quantiles, "Sorted residuals against normal quantiles"),
    ]
    if data.lags is not None:
        jobs.append((draw_autocorrelation, "Autocorrelation of the residuals"))
    shown = []
    for draw, text in jobs:
        picture = _empty(_SMALL)
        draw(picture.subplots(), data)
        shown.append(Shown(picture, text))
    return shown


def _runs(result: FitResult) -> Shown:
    panels = run_points(result)
    picture = Picture(figsize=(WIDE, 1.3 + 1.4 * len(panels)))
    place_points(picture, panels, 0.02, 0.98)
    return Shown(picture, "Parameters and derived quantities run by run")


def _profiles(result: FitResult) -> Shown:
    panels = profile_data(result)
    columns = min(len(panels), 2)
    rows = -(-len(panels) // columns)
    picture = _empty(0.4 + 2.1 * rows)
    cells = picture.subplots(rows, columns, squeeze=False).ravel()
    for i, (axes, panel) in enumerate(zip(cells, panels, strict=False)):
        draw_profile(axes, panel)
        axes.locator_params(axis="y", nbins=5)
        if not panel.logarithmic:
            axes.locator_params(axis="x", nbins=4)
        if i % columns:
            axes.set_ylabel("")
    for axes in cells[len(panels) :]:
        axes.remove()
    handles, labels = cells[0].get_legend_handles_labels()
    picture.legend(handles, labels, loc="outside upper left", ncols=3, fontsize=8, frameon=False)
    return Shown(picture, "Profile likelihood, covariance and posterior of parameters")


def _whole(picture: Picture, alternative: str) -> Shown:
    return Shown(picture, alternative, round(_PIXELS * picture.get_figwidth()))


def page_pictures(result: FitResult) -> Mapping[str, list[Shown]]:
    """Section -> its pictures, as far as the fit has the content."""
    sections = ("curve", "residuals", "runs", "profile", "corner", "trace")
    pictures: dict[str, list[Shown]] = {section: [] for section in sections}
    pictures["curve"] = curve_pictures(result)
    pictures["residuals"] = residual_pictures(result)
    if has_runs(result):
        pictures["runs"] = [_runs(result)]
    if result.profiles:
        pictures["profile"] = [_profiles(result)]
    if result.chains is not None:
        text = "Posterior of every parameter and every pair"
        every = result.labels if len(result.labels) <= _MOST_PAIRED else None
        pictures["corner"] = [_whole(corner_figure(result, every), text)]
        if has_trace(result):
            text = "Draws of every ensemble in order"
            pictures["trace"] = [_whole(trace_figure(result), text)]
    return pictures
