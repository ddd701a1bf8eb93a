"""Figure of a whole rig test: channels, segments and kept rows."""

from collections import Counter
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


def panels_of(prepared: Prepared) -> list[Panel]:
    """The channels that changed by more than noise about one value."""
    panels, columns = [], prepared.columns
    # Smallest range of a force that has a panel: a tenth of the largest load.
    least = LEAST | dict.fromkeys(("fx", "fy"), 0.1 * float(np.max(columns.get("fz", 0.0))))
    for name in (name for name in _PANELS if name in columns):
        value, settings = columns[name], prepared.settings.get(name)
        held = settings.center if settings is not None and settings.is_held else np.zeros(0)
        is_one = name in ("gamma", "pressure", "v") and len(held) == 1
        if swept_range(value) < least[name] if name in least else is_one:
            continue
        scale, unit = (SHOWN | _ALSO)[name]
        if name == "sigma_x":
            value = slip_from_sigma(value, "slip_ratio")
        if unit == "N" and np.max(np.abs(value)) > 2000.0:  # forces above this [N] are shown in kN
            scale, unit = 1e-3, "kN"
        held = held[:0] if name in ("alpha", "sigma_x") else scale * held
        panels.append(Panel(name, f"{_PANELS[name]}\n[{unit}]", scale * value, held))
    return panels


def strips_of(prepared: Prepared) -> list[Strip]:
    """The segments of each kind."""
    time, rate = prepared.series.time, prepared.series.rate
    step = 1.0 if rate is None else 1 / rate
    parts: dict[str, list[Any]] = {kind: [] for kind in _COLOR}
    for part in prepared.segments:
        parts[f"{part.kind} {part.direction}" if part.kind == "sweep" else part.kind].append(part)
    return [
        Strip(
            kind,
            [(float(time[p.begin]), float(time[p.end - 1] - time[p.begin]) + step) for p in each],
            sum(p.end - p.begin for p in each),
            each[0].kind in prepared.config.keep,
        )
        for kind, each in parts.items()
        if each
    ]


def title_of(prepared: Prepared) -> str:
    """The numbers of sweeps, steady states and bins, and the share of rows kept."""
    share = prepared.kept.sum() / len(prepared.data)
    counts = Counter(part.kind for part in prepared.segments)
    bins = {p.bin for p in prepared.segments if p.kind in prepared.config.keep}
    what = f"{counts['sweep']} sweeps and {counts['steady']} steady states in {len(bins)} bins"
    return f"{prepared.data.name}: {what}, {share:.0%} of the rows kept"


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
        whole = {"transform": axes.get_xaxis_transform(), "linewidth": 0, "zorder": 0}
        for strip in strips:
            axes.broken_barh(strip.spans, (0, 1), **strip.style, **whole)
        for setting in panel.settings:
            axes.axhline(setting, color=DARK, linewidth=0.5, linestyle=":", zorder=1)
        axes.plot(series.time, panel.value, color=DARK, linewidth=0.6, zorder=2)
        tidy(axes, "", panel.label, 8)
        axes.margins(x=0)
    clock = "row" if series.rate is None else "time [s]"
    all_axes[-1].set_xlabel(clock, fontsize=8, color=DARK)
    body.align_ylabels(all_axes)
    handles = [
        Patch(**strip.style, label=f"{strip.kind} {strip.rows / count:.0%}") for strip in strips
    ]
    style: dict[str, Any] = {"fontsize": 7.5, "frameon": False, "handlelength": 1.2}
    body.legend(handles=handles, loc="outside upper left", ncols=3, **style)
    return picture
