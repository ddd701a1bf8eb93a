"""The figures of a Magic Formula fit: their contents as arrays, and its files."""

from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tirefit.fitting.mf.bins import SlipBins
from tirefit.fitting.mf.parts import NEARLY_PURE, SLIPS_OF
from tirefit.fitting.mf.result import MagicFormulaFit, magic_formula_forces
from tirefit.models import TireInputs
from tirefit.report.canvas import Picture, images_of, save_pictures, together
from tirefit.report.fit.curves import FORCE_LABEL, Curve, FitCurve, Group, even
from tirefit.report.fit.figures import curve_panel, draw_fit
from tirefit.report.fit.tables import fit_files
from tirefit.results import UsageError

MAGIC_FORMULA_FILES = tuple(f"{name}.png" for name in ("fit", *FORCE_LABEL, "residuals", "ellipse"))
"""Every file that :func:`save_magic_formula` may write."""

_BY = {
    "fz": "load",
    "gamma": "camber",
    "pressure": "pressure",
    "held": "slip angle, in combined slip",
}
_NAMES = {force: name.split(" $")[0].capitalize() for force, (name, *_) in FORCE_LABEL.items()}
_AXIS = {
    "alpha": (r"slip angle $\alpha$ [deg]", 180 / np.pi),
    "sigma_x": (r"slip $\kappa$, braking positive [%]", 100.0),
}


def _fitted(
    fit: MagicFormulaFit, force: str, inputs: Sequence[TireInputs]
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Predicted force (n,) at the inputs, and the standard deviation (n,) of a measurement."""
    joined = TireInputs(*map(np.concatenate, zip(*inputs, strict=True)))
    mean, variance = magic_formula_forces(fit.stored, [force], joined)
    noise = fit.noise[force].variance(joined.fz, mean[force])
    ends = np.cumsum([np.size(rows.fz) for rows in inputs])[:-1]
    std = np.sqrt(noise + variance[force])
    return list(zip(np.split(mean[force], ends), np.split(std, ends), strict=True))


def _nominal(bins: SlipBins, slip: np.ndarray) -> TireInputs:
    """Inputs (m,) along the slip of a setting, at its load and the medians of the others."""
    columns = {k: np.full(len(slip), np.median(v)) for k, v in bins.inputs._asdict().items()}
    columns["fz"] = np.full(len(slip), bins.setting.fz)
    swept = bins.setting.swept
    columns[swept] = np.interp(slip, bins.slip, getattr(bins.inputs, swept))
    return TireInputs(**columns)


def _curve(x: np.ndarray, force: np.ndarray, std: Any = 0.0) -> Curve:
    """A curve (m,) with the 95 % band of a measurement."""
    half = 1.96 * std
    return Curve(x, force, force, force, force - half, force + half)


def _drawn(
    fit: MagicFormulaFit, force: str, name: str, members: Sequence[SlipBins]
) -> tuple[list[Group], list[Curve]]:
    """Points and curves of settings at their loads. The load of a rig varies with the slip:
    the points are moved along the fit, each keeps its residual."""
    groups, curves = [], []
    for bins in members:
        label, scale = bins.setting.text(name), _AXIS[bins.setting.swept][1]
        grid = np.linspace(bins.slip[0], bins.slip[-1], 80)
        inputs = [_nominal(bins, grid), _nominal(bins, bins.slip), bins.inputs]
        along, (there, _), (here, _) = _fitted(fit, force, inputs)
        moved = (values + there - here for values in (bins.force, bins.low, bins.high))
        groups.append(Group(label, scale * bins.slip, *moved))
        curves.append(_curve(scale * grid, *along))
    return groups, curves


def _conditions(bins: SlipBins, without: str = "") -> str:
    """The conditions of a setting except one."""
    texts = [bins.setting.text(name) for name in _BY if name != without]
    return ", ".join(filter(None, texts))


def force_curves(fit: MagicFormulaFit, force: str) -> list[FitCurve]:
    """A force over slip: by load, camber and pressure in pure slip, by slip angle in
    combined slip; each at the conditions with most settings, then least camber."""
    panels, (what, unit, _) = [], FORCE_LABEL[force]
    for name in _BY:
        swept = "sigma_x" if name == "held" else SLIPS_OF[force][-1]
        alike: dict[tuple[Any, ...], list[SlipBins]] = defaultdict(list)
        for bins in fit.binned[force]:
            setting = bins.setting
            pure = name == "held" or abs(setting.held) <= NEARLY_PURE
            if setting.swept == swept and pure and len(bins.slip) > 2:
                alike[tuple(getattr(setting, k) for k in _BY if k != name)].append(bins)
        best = max(
            alike.values(), key=lambda same: (len(same), -abs(same[0].setting.gamma)), default=[]
        )
        if len(best) > 1 or (best and name == "fz"):
            best = even(sorted(best, key=lambda bins: getattr(bins.setting, name)))
            drawn = _drawn(fit, force, name, best)
            note, title = _conditions(best[0], name), f"{_NAMES[force]} by {_BY[name]}"
            labels = _AXIS[swept][0], f"{what} [{unit}]"
            panels.append(FitCurve(force, *labels, *drawn, note, title))
    return panels


def residual_curve(fit: MagicFormulaFit, force: str) -> FitCurve:
    """The residual (measured - fitted) of every bin, by setting in order of load."""
    table = sorted(fit.binned[force], key=lambda bins: bins.setting)
    fitted = _fitted(fit, force, [bins.inputs for bins in table])
    residual = [b.force - middle for b, (middle, _) in zip(table, fitted, strict=True)]
    std = np.array([np.median(std) for _, std in fitted])
    points: dict[str, list[np.ndarray]] = defaultdict(list)
    places: dict[str, list[int]] = defaultdict(list)
    for i, (bins, off) in enumerate(zip(table, residual, strict=True)):
        x = i + np.linspace(-0.3, 0.3, len(off))
        points[bins.setting.text("held")].append(np.stack([x, off]))
        places[bins.setting.text("fz")].append(i)
    groups = [Group(kind, *np.concatenate(points[kind], axis=1)) for kind in even(sorted(points))]
    curve = _curve(np.arange(float(len(table))), np.zeros(len(table)), std)
    size = [float(np.sqrt(np.mean(off**2))) for off in residual]
    worst, unit = int(np.argmax(size)), FORCE_LABEL[force][1]
    note = f"worst, {size[worst]:.3g} {unit} rms: {_conditions(table[worst])}"
    ticks = even([(float(np.mean(at)), load) for load, at in places.items()])
    labels = "settings of the test, by load", f"measured - fitted [{unit}]"
    title = f"{_NAMES[force]}, measured - fitted"
    return FitCurve(force, *labels, groups, [curve], note, title, ticks)


def ellipse_curves(fit: MagicFormulaFit) -> list[FitCurve]:
    """F_y / F_z over F_x / F_z in combined slip, at the load, camber and pressure with
    most slip angles, then the largest load; empty without combined slip."""
    lateral = {bins.setting: bins for bins in fit.binned.get("fy", ())}
    alike: dict[tuple[Any, ...], list[tuple[SlipBins, SlipBins]]] = defaultdict(list)
    for bins in fit.binned.get("fx", ()):
        if bins.setting.swept == "sigma_x" and bins.setting in lateral:
            alike[bins.setting[:3]].append((bins, lateral[bins.setting]))
    most = max(alike, key=lambda key: (len(alike[key]), key[0]), default=None)
    if most is None or len(alike[most]) < 2:
        return []
    members = even(alike[most])
    sides = zip(("fx", "fy"), zip(*members, strict=True), strict=True)
    (along, x), (side, y) = (_drawn(fit, force, "held", bins) for force, bins in sides)
    fz, groups, curves = members[0][0].setting.fz, [], []
    for a, x_of, s, y_of in zip(along, x, side, y, strict=True):
        groups.append(Group(a.label, a.force / fz, np.interp(a.slip, s.slip, s.force) / fz))
        lateral_force = np.interp(x_of.slip, y_of.slip, y_of.force)
        curves.append(_curve(x_of.force / fz, lateral_force / fz))
    x_label, y_label = (f"{FORCE_LABEL[force][2]} [-]" for force in ("fx", "fy"))
    note, title = _conditions(members[0][0], "held"), "Friction ellipse"
    return [FitCurve("fy", x_label, y_label, groups, curves, note, title)]


def curves_of(fit: MagicFormulaFit) -> dict[str, list[FitCurve]]:
    """Name of a figure -> its curves: ``fit`` has the first of each force, the figure of a
    force the others. Raises UsageError for a fit read from a file."""
    if not fit.binned:
        raise UsageError("a fit read from a file has no data to draw: fit again")
    of_force = {force: force_curves(fit, force) for force in fit.binned}
    named = {"fit": [curve for curves in of_force.values() for curve in curves[:1]]}
    named |= {force: curves[1:] for force, curves in of_force.items()}
    named["residuals"] = [residual_curve(fit, force) for force in fit.binned]
    named["ellipse"] = ellipse_curves(fit)
    return {name: curves for name, curves in named.items() if curves}


def title_of(fit: MagicFormulaFit) -> str:
    """Model and file."""
    return f"{fit.model} fitted to {fit_files(fit, 50)}"


def stacked(curves: Sequence[FitCurve], title: str = "") -> Picture:
    """The curves one below the other, each with its legend below it."""
    return together([curve_panel(curve, curve.title) for curve in curves], title, "", "")


def plot_magic_formula(fit: MagicFormulaFit, ax: Any = None) -> Picture:
    """Draw every force over its slip by load, measured and fitted; returns the Figure.

    Args:
        fit: a fit of this process, which has its data.
        ax: axes to draw only the first force on.
    """
    first = curves_of(fit)["fit"]
    if ax is None:
        return stacked(first, title_of(fit))
    ax.legend(handles=draw_fit(ax, first[0]), fontsize=7, framealpha=0.85, edgecolor="none")
    return ax.figure


def page_pictures(fit: MagicFormulaFit) -> list[dict[str, Any]]:
    """All curves for a page."""
    every = (curve for curves in curves_of(fit).values() for curve in curves)
    return images_of(curve_panel(curve, curve.title) for curve in every)


def save_magic_formula(fit: MagicFormulaFit, folder: Path) -> list[Path]:
    """Write the figures; returns the files."""
    named = curves_of(fit).items()
    return save_pictures(((name, stacked(some, title_of(fit))) for name, some in named), folder)
