"""The panels of a fit: as the figures of its folder, and as the pictures of its page."""

import os
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from tirefit.fitting.result import FitResult
from tirefit.report.by_name import draw_by_name, has_runs, run_points
from tirefit.report.canvas import Picture, save_pictures
from tirefit.report.curves import FitCurve, fit_curve
from tirefit.report.draw import (
    draw_autocorrelation,
    draw_fit,
    draw_histogram,
    draw_quantiles,
    draw_scatter,
)
from tirefit.report.draw_uncertainty import (
    CORNER_NOTE,
    MOST_SCALED,
    draw_corner,
    draw_profiles,
    draw_trace,
    drawn_length,
)
from tirefit.report.fit_tables import reference_text
from tirefit.report.panels import WIDE, Panel, legend_below, together
from tirefit.report.residuals import residual_panels
from tirefit.report.uncertainty import corner_data, has_trace, profile_data, trace_data

_MOST_PAIRED = 40  # largest number of parameters of which a page has all pairs


def _draw_curve(figure: Any, curve: FitCurve) -> None:
    """Draw a force over slip, with its legend below."""
    legend_below(figure, draw_fit(figure.subplots(), curve), curve.note)


def _curve_panels(result: FitResult) -> list[Panel]:
    """Points, curve and bands of every fitted force."""
    curves = [fit_curve(result, channel) for channel in result.forces]
    return [
        Panel(
            partial(_draw_curve, curve=curve),
            f"Measured points and fitted curve of {curve.channel} over slip, with bands",
            (WIDE, 3.3 + 0.1 * len(curve.groups)),
        )
        for curve in curves
    ]


def _on_axes(draw: Callable, *data: Any) -> Callable[[Any], None]:
    return lambda figure: draw(figure.subplots(), *data)


def _residual_panels(result: FitResult) -> list[Panel]:
    """Residuals of the first force over each input, their distribution and sequence.

    Further forces of a joint fit are shown against their slip.
    """
    data = residual_panels(result)
    first, *others = result.forces
    scatters = [(first, panel) for panel in data.scatters]
    scatters[1:1] = [(force, residual_panels(result, force).scatters[0]) for force in others]
    panels = [
        Panel(
            _on_axes(draw_scatter, panel, force),
            f"Residuals of {force} against {panel.label}",
            (WIDE, 2.3 + 0.4 * bool(panel.ticks)),
        )
        for force, panel in scatters
    ]
    jobs = [
        (draw_histogram, "Distribution of the residuals beside a normal one"),
        (draw_quantiles, "Sorted residuals against normal quantiles"),
        (draw_autocorrelation, "Autocorrelation of the residuals"),
    ]
    jobs = jobs if data.lags is not None else jobs[:2]
    return [*panels, *(Panel(_on_axes(draw, data), text) for draw, text in jobs)]


def _run_panels(result: FitResult) -> list[Panel]:
    """Every parameter and derived quantity that differs by run."""
    points = run_points(result)
    at = reference_text(result).replace("F_z", "$F_z$")
    note = f"values and 95 % intervals by run ({result.source}); derived at {at}"
    note += "; grey: not identified" * any((~one.known).any() for one in points)
    text = "Parameters and derived quantities run by run"
    size = (WIDE, 1.3 + 1.4 * len(points))
    return [Panel(partial(draw_by_name, panels=points), text, size, note)]


def _profile_panels(result: FitResult) -> list[Panel]:
    """Profile likelihood, covariance and posterior of the parameters."""
    panels, of = profile_data(result), len(result.profiles)
    note = f"{len(panels)} of {of} parameters" * (len(panels) < of)
    text = "Profile likelihood, covariance and posterior of parameters"
    size = (WIDE, 0.4 + 2.1 * -(-len(panels) // 2))
    return [Panel(partial(draw_profiles, panels=panels), text, size, note)]


def _corner_panels(result: FitResult, parameters: Sequence[str] | None = None) -> list[Panel]:
    """The posterior of every parameter and every pair."""
    corner = corner_data(result, parameters)
    count = len(corner.labels)
    names, values = max(map(drawn_length, corner.labels)), max(map(len, corner.values))
    cell = 1.0 if count <= MOST_SCALED else max(5.4 / count, 0.34)
    left = 0.4 + 0.06 * names + 0.5 * (count <= MOST_SCALED)
    size = (max(left + cell * count + 0.065 * values, WIDE), 0.9 + left + cell * count)
    note = "\n".join(filter(None, (CORNER_NOTE, corner.note)))
    text = "Posterior of every parameter and every pair"
    return [Panel(_on_axes(draw_corner, corner), text, size, note, scrolls=True)]


def _trace_panels(result: FitResult, parameters: Sequence[str] | None = None) -> list[Panel]:
    """Posterior draws in order, by ensemble."""
    trace = trace_data(result, parameters)
    text, size = "Draws of every ensemble in order", (7.0, 0.6 + 1.1 * len(trace.labels))
    return [Panel(partial(draw_trace, trace=trace), text, size, trace.note, scrolls=True)]


PANELS: Mapping[str, Callable[..., list[Panel]]] = {
    "fit": _curve_panels,
    "residuals": _residual_panels,
    "runs": _run_panels,
    "profile": _profile_panels,
    "corner": _corner_panels,
    "trace": _trace_panels,
}
"""Name of a figure -> function of a fit that gives its panels."""

FIGURE_FILES = tuple(f"{name}{suffix}" for name in PANELS for suffix in (".png", ".svg"))
"""Every file that :func:`save_figures` may write."""


def missing_of(result: FitResult) -> dict[str, str]:
    """Name of a figure that the fit does not have -> what is missing."""
    sampled = result.chains is not None
    posterior = "posterior: tirefit.sample(fit) adds it"
    chain = "chain: its posterior is of independent points (plot('corner') draws it)"
    missing = {
        "runs": ""
        if has_runs(result)
        else "parameter for each run (per_run = true under [parameters.NAME])",
        "profile": "" if result.profiles else "profile likelihood",
        "corner": "" if sampled else posterior,
        "trace": "" if has_trace(result) else chain if sampled else posterior,
    }
    return {name: text for name, text in missing.items() if text}


def page_panels(result: FitResult) -> dict[str, list[Panel]]:
    """Name of a figure -> its panels for a page, as far as the fit has the content; of at most
    forty parameters all pairs."""
    every = result.labels if len(result.labels) <= _MOST_PAIRED else None
    missing = missing_of(result)
    return {
        name: panels(result, every) if name == "corner" else panels(result)
        for name, panels in PANELS.items()
        if name not in missing
    }


def figure_of(result: FitResult, name: str, **how: Any) -> Picture:
    """The figure of this name with title and footnote.

    Args:
        how: ``parameters`` of the corner and the trace.
    """
    return together(result, PANELS[name](result, **how), 2 if name == "residuals" else 1)


def save_figures(result: FitResult, directory: str | os.PathLike, svg: bool = False) -> list[Path]:
    """Write fit.png and residuals.png; runs.png if runs have separate parameters;
    profile.png, corner.png, trace.png if available.

    Args:
        result: a fit with its problem.
        directory: made if it is not there.
        svg: write every figure as SVG too.

    Returns:
        the files written.
    """
    directory = Path(directory)
    directory.mkdir(parents=True, exist_ok=True)
    names = [name for name in PANELS if name not in missing_of(result)]
    written = save_pictures(((name, figure_of(result, name)) for name in names), directory, svg)
    # Remove figures of an earlier fit, which would be mistaken for new ones.
    for name in FIGURE_FILES:
        if directory / name not in written:
            (directory / name).unlink(missing_ok=True)
    return written
