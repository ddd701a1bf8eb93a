"""Figure of a whole rig test: channels, segments and kept rows."""

from typing import Any, NamedTuple

import numpy as np
from matplotlib.patches import Patch

from tirefit import __version__
from tirefit.data.rig.prepare import Prepared
from tirefit.data.rig.set_points import SHOWN
from tirefit.data.rig.slips import LEAST, swept_range
from tirefit.data.units import slip_from_sigma
from tirefit.report.canvas import BLUE, DARK, GREEN, GREY, ORANGE, SKY, WIDE, Picture, frame, tidy

_COLOR = {
    "sweep up": BLUE,
    "sweep down": SKY,
    "steady": GREEN,
    "warm-up": ORANGE,
    "standing": "#d8d8d8",
    "transition": GREY,
    "unusable": DARK,
}
_PANELS = {
    "alpha": "slip angle",
    "sigma_x": "slip ratio",
    "fz": "load",
    "gamma": "camber",
    "pressure": "pressure",
    "v": "speed",
    "temperature": "tire",
    "fy": "side force",
    "fx": "long. force",
}
"""Channels that are shown, in this order, and their labels."""
_ALSO = {"fx": (1.0, "N"), "fy": (1.0, "N"), "temperature": (1.0, "°C")}


class Panel(NamedTuple):
    """One channel over time."""

    name: str
    label: str  # with its unit
    value: np.ndarray  # (n,)
    settings: np.ndarray  # (k,) settings of the rig


class Strip(NamedTuple):
    """All stretches of one kind of segment: (begin, width) of each, and its rows."""

    kind: str
    spans: list[tuple[float, float]]
    rows: int
    is_kept: bool

    @property
    def style(self) -> dict[str, Any]:
        """Colour and opacity, which is stronger for rows that are kept."""
        return {"facecolor": _COLOR[self.kind], "alpha": 0.45 if self.is_kept else 0.22}


def _is_telling(name: str, prepared: Prepared, settings: int) -> bool:
    """Whether a channel changed by more than noise about one value."""
    size = swept_range(prepared.columns[name])
    if name in LEAST:
        return size >= LEAST[name]
    if name in ("fx", "fy") and "fz" in prepared.columns:
        # Smallest range of a force that has a panel, over the largest load.
        return size >= 0.1 * float(np.max(prepared.columns["fz"]))
    return name not in ("gamma", "pressure", "v") or settings != 1


def panels_of(prepared: Prepared) -> list[Panel]:
    """The channels that changed by more than noise about one value."""
    panels = []
    for name, label in _PANELS.items():
        if name not in prepared.columns:
            continue
        value = prepared.columns[name]
        settings = prepared.settings.get(name)
        scale, unit = (SHOWN | _ALSO)[name]
        if name == "sigma_x":
            value = slip_from_sigma(value, "slip_ratio")
        if unit == "N" and np.max(np.abs(value)) > 2000.0:  # forces above this [N] are shown in kN
            scale, unit = 1e-3, "kN"
        held = settings is not None and settings.is_held
        center = settings.center if settings is not None and held else np.zeros(0)
        if not _is_telling(name, prepared, len(center)):
            continue
        center = scale * center if name not in ("alpha", "sigma_x") else np.zeros(0)
        panels.append(Panel(name, f"{label}\n[{unit}]", scale * value, center))
    return panels


def strips_of(prepared: Prepared) -> list[Strip]:
    """The segments of each kind."""
    time, step = prepared.series.time, 1.0
    if prepared.series.rate is not None:
        step = 1 / prepared.series.rate
    strips: dict[str, Strip] = {}
    for part in prepared.segments:
        kind = f"{part.kind} {part.direction}" if part.kind == "sweep" else part.kind
        begin = float(time[part.begin])
        width = float(time[part.end - 1]) + step - begin
        there = strips.get(kind, Strip(kind, [], 0, part.kind in prepared.config.keep))
        rows = there.rows + part.end - part.begin
        strips[kind] = there._replace(spans=[*there.spans, (begin, width)], rows=rows)
    order = list(_COLOR)
    return sorted(strips.values(), key=lambda strip: order.index(strip.kind))


def title_of(prepared: Prepared) -> str:
    """The numbers of sweeps, steady states and bins, and the share of rows kept."""
    kept, total = int(prepared.kept.sum()), len(prepared.data)
    sweeps, states = (
        sum(part.kind == kind for part in prepared.segments) for kind in ("sweep", "steady")
    )
    bins = {p.bin for p in prepared.segments if p.kind in prepared.config.keep}
    what = [
        f"{count} {word}{'s' if count > 1 else ''}"
        for count, word in ((sweeps, "sweep"), (states, "steady state"))
        if count
    ]
    title = f"{prepared.data.name}: {' and '.join(what) or 'no sweep'} in {len(bins)}"
    title += f" bin{'s' if len(bins) > 1 else ''}, {kept / total:.0%} of the rows kept"
    return title


def _draw(axes: Any, panel: Panel, time: np.ndarray, strips: list[Strip]) -> None:
    whole = {"transform": axes.get_xaxis_transform(), "linewidth": 0, "zorder": 0}
    for strip in strips:
        axes.broken_barh(strip.spans, (0, 1), **strip.style, **whole)
    for setting in panel.settings:
        axes.axhline(setting, color=DARK, linewidth=0.5, linestyle=":", zorder=1)
    axes.plot(time, panel.value, color=DARK, linewidth=0.6, zorder=2)
    tidy(axes, "", panel.label, 8)
    axes.margins(x=0)


def prepared_figure(prepared: Prepared) -> Picture:
    """Draw the whole test: every channel that changed, with segments in the background
    (strong colours: kept), and dotted lines for settings."""
    panels, strips, series = panels_of(prepared), strips_of(prepared), prepared.series
    chosen, count = prepared.filter, len(prepared.data)
    band = "not filtered" if chosen is None else f"zero-phase {chosen.bandwidth:g} Hz"
    note = f"tirefit {__version__} · braking positive, SI · {band}"
    note += f" · {int(prepared.kept.sum())} of {count} rows"
    picture = frame(title_of(prepared), "", note, (WIDE, 0.8 + 0.9 * len(panels)))
    body: Any = picture.subfigures(1, 1)  # whose legend is below the title
    all_axes = body.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    for axes, panel in zip(all_axes, panels, strict=True):
        _draw(axes, panel, series.time, strips)
    clock = "row" if series.rate is None else "time [s]"
    all_axes[-1].set_xlabel(clock, fontsize=8, color=DARK)
    body.align_ylabels(all_axes)
    handles = [
        Patch(**strip.style, label=f"{strip.kind} {strip.rows / count:.0%}") for strip in strips
    ]
    style: dict[str, Any] = {"fontsize": 7.5, "frameon": False, "handlelength": 1.2}
    body.legend(handles=handles, loc="outside upper left", ncols=3, **style)
    return picture
