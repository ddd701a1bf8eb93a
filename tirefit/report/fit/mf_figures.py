"""The figures of a Magic Formula fit: their contents as arrays, and its files."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tirefit.fitting.mf.bins import SlipBins
from tirefit.fitting.mf.parts import NEARLY_PURE, SLIPS_OF
from tirefit.fitting.mf.result import MagicFormulaFit
from tirefit.fitting.predict import predict
from tirefit.models import TireInputs
from tirefit.report.canvas import Picture, images_of, save_pictures, together
from tirefit.report.fit.curves import FORCE_LABEL, Curve, FitCurve, Group, even
from tirefit.report.fit.figures import curve_panel, draw_fit
from tirefit.report.fit.tables import fit_files
from tirefit.results import UsageError

MAGIC_FORMULA_FILES = tuple(f"{name}.png" for name in ("fit", *FORCE_LABEL, "residuals", "ellipse"))
"""Every file that :func:`save_magic_formula` may write."""

_POINTS = 80  # points of a curve between the first and the last bin
_IN_95 = 1.96
_BY = {
    "fz": "load",
    "gamma": "camber",
    "pressure": "pressure",
    "held": "slip angle, in combined slip",
}
_AXIS = {
    "alpha": (r"slip angle $\alpha$ [deg]", 180 / np.pi),
    "sigma_x": (r"slip $\kappa$, braking positive [%]", 100.0),
}


def _fitted(
    fit: MagicFormulaFit, force: str, inputs: Sequence[TireInputs]
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Predicted force (n,) at the inputs, and the standard deviation (n,) of a measurement."""
    joined = TireInputs(*map(np.concatenate, zip(*inputs, strict=True)))
    columns = {
        name: column
        for name, column in joined._asdict().items()
        if name in ("sigma_x", "alpha", "fz", "gamma", "v") or np.all(column > 0)
    }
    given = predict(fit, columns)
    ends = np.cumsum([np.size(rows.fz) for rows in inputs])[:-1]
    each = (np.split(given[name], ends) for name in (force, f"{force}_std"))
    return list(zip(*each, strict=True))


def _nominal(bins: SlipBins, slip: np.ndarray) -> TireInputs:
    """Inputs (m,) along the slip of a setting, at its load and the medians of the others."""
    columns = {k: np.full(len(slip), np.median(v)) for k, v in bins.inputs._asdict().items()}
    columns["fz"] = np.full(len(slip), bins.setting.fz)
    swept = bins.setting.swept
    columns[swept] = np.interp(slip, bins.slip, getattr(bins.inputs, swept))
    return TireInputs(**columns)


def _curve(x: np.ndarray, force: np.ndarray, std: Any = 0.0) -> Curve:
    """A curve (m,) with the 95 % band of a measurement."""
    half = _IN_95 * std
    return Curve(x, force, force, force, force - half, force + half)


def _drawn(
    fit: MagicFormulaFit, force: str, name: str, members: Sequence[SlipBins]
) -> tuple[list[Group], list[Curve]]:
    """Points and curves of settings at their loads. The load of a rig varies with the slip:
    the points are moved along the fit, each keeps its residual."""
    grids = [np.linspace(bins.slip[0], bins.slip[-1], _POINTS) for bins in members]
    inputs = [_nominal(bins, grid) for bins, grid in zip(members, grids, strict=True)]
    inputs += [_nominal(bins, bins.slip) for bins in members]
    fitted, count = _fitted(fit, force, [*inputs, *(b.inputs for b in members)]), len(members)
    groups, curves = [], []
    for i, (bins, grid) in enumerate(zip(members, grids, strict=True)):
        label, scale = bins.setting.text(name), _AXIS[bins.setting.swept][1]
        shift = fitted[count + i][0] - fitted[2 * count + i][0]
        moved = (values + shift for values in (bins.force, bins.low, bins.high))
        groups.append(Group(label, scale * bins.slip, *moved))
        curves.append(_curve(scale * grid, *fitted[i]))
    return groups, curves


def _name_of(force: str) -> str:
    """The name of a force as the beginning of a title."""
    return FORCE_LABEL[force][0].split(" $")[0].capitalize()


def _conditions(bins: SlipBins, without: str = "") -> str:
    """The conditions of a setting except one."""
    texts = [bins.setting.text(name) for name in _BY if name != without]
    return ", ".join(filter(None, texts))


def _preference(members: Sequence[SlipBins]) -> tuple[int, float, int]:
    """Sort key of the settings to show: most, then least camber, then most rows."""
    rows = sum(int(bins.rows.sum()) for bins in members)
    return len(members), -abs(members[0].setting.gamma), rows


def force_curves(fit: MagicFormulaFit, force: str) -> list[FitCurve]:
    """A force over slip: by load, camber and pressure in pure slip, by slip angle in
    combined slip; each at the conditions with most settings."""
    panels, (what, unit, _) = [], FORCE_LABEL[force]
    for name in _BY:
        swept = "sigma_x" if name == "held" else SLIPS_OF[force][-1]
        alike: dict[tuple[Any, ...], list[SlipBins]] = {}
        for bins in fit.binned[force]:
            setting = bins.setting
            pure = name == "held" or abs(setting.held) <= NEARLY_PURE
            if setting.swept == swept and pure and len(bins.slip) > 2:
                key = tuple(getattr(setting, other) for other in _BY if other != name)
                alike.setdefault(key, []).append(bins)
        best = max(alike.values(), key=_preference, default=[])
        if len(best) > 1 or (best and name == "fz"):
            best = even(sorted(best, key=lambda bins: getattr(bins.setting, name)))
            drawn = _drawn(fit, force, name, best)
            note, title = _conditions(best[0], name), f"{_name_of(force)} by {_BY[name]}"
            labels = _AXIS[swept][0], f"{what} [{unit}]"
            panels.append(FitCurve(force, *labels, *drawn, note, title))
    return panels


def residual_curve(fit: MagicFormulaFit, force: str) -> FitCurve:
    """The residual (measured - fitted) of every bin, by setting in order of load."""
    table = sorted(fit.binned[force], key=lambda bins: bins.setting)
    fitted = _fitted(fit, force, [bins.inputs for bins in table])
    residual = [b.force - middle for b, (middle, _) in zip(table, fitted, strict=True)]
    std = np.array([np.median(std) for _, std in fitted])
    points: dict[str, list[np.ndarray]] = {}
    places: dict[str, list[int]] = {}
    for i, (bins, off) in enumerate(zip(table, residual, strict=True)):
        x = i + np.linspace(-0.3, 0.3, len(off))
        points.setdefault(bins.setting.text("held"), []).append(np.stack([x, off]))
        places.setdefault(bins.setting.text("fz"), []).append(i)
    groups = [Group(kind, *np.concatenate(points[kind], axis=1)) for kind in even(sorted(points))]
    curve = _curve(np.arange(float(len(table))), np.zeros(len(table)), std)
    size = [float(np.sqrt(np.mean(off**2))) for off in residual]
    worst, unit = int(np.argmax(size)), FORCE_LABEL[force][1]
    note = f"worst, {size[worst]:.3g} {unit} rms: {_conditions(table[worst])}"
    ticks = even([(float(np.mean(at)), load) for load, at in places.items()])
    labels = "settings of the test, by load", f"measured - fitted [{unit}]"
    title = f"{_name_of(force)}, measured - fitted"
    return FitCurve(force, *labels, groups, [curve], note, title, ticks)


def ellipse_curves(fit: MagicFormulaFit) -> list[FitCurve]:
    """F_y / F_z over F_x / F_z in combined slip, at the load, camber and pressure with
    most slip angles, then the largest load; empty without combined slip."""
    lateral = {bins.setting: bins for bins in fit.binned.get("fy", ())}
    alike: dict[tuple[Any, ...], list[tuple[SlipBins, SlipBins]]] = {}
    for bins in fit.binned.get("fx", ()):
        if bins.setting.swept == "sigma_x" and bins.setting in lateral:
            pair = bins, lateral[bins.setting]
            alike.setdefault(bins.setting[:3], []).append(pair)
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
    """Name of a figure -> its curves; raises UsageError for a fit read from a file."""
    if not fit.binned:
        raise UsageError("a fit read from a file has no data to draw: fit again")
    named = {force: force_curves(fit, force) for force in fit.binned}
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
    first = _first(fit, curves_of(fit))
    if ax is None:
        return stacked(first, title_of(fit))
    ax.legend(handles=draw_fit(ax, first[0]), fontsize=7, framealpha=0.85, edgecolor="none")
    return ax.figure


def _first(fit: MagicFormulaFit, curves: Mapping[str, Sequence[FitCurve]]) -> list[FitCurve]:
    """The first curve of each force."""
    return [curves[force][0] for force in fit.binned if force in curves]


def page_pictures(fit: MagicFormulaFit) -> list[dict[str, Any]]:
    """All curves for a page."""
    every = (curve for curves in curves_of(fit).values() for curve in curves)
    return images_of(curve_panel(curve, curve.title) for curve in every)


def save_magic_formula(fit: MagicFormulaFit, folder: Path) -> list[Path]:
    """Write the figures; returns the files."""
    curves = curves_of(fit)
    named = {"fit": _first(fit, curves), **curves}.items()
    return save_pictures(((name, stacked(some, title_of(fit))) for name, some in named), folder)
