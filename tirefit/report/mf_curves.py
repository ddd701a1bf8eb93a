"""The contents of the figures of a Magic Formula fit, as arrays."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tirefit.fitting.mf.bins import SlipBins
from tirefit.fitting.mf.parts import NEARLY_PURE, SLIPS_OF
from tirefit.fitting.mf.result import MagicFormulaFit
from tirefit.fitting.predict import predict
from tirefit.models import TireInputs
from tirefit.report.curves import FORCE_LABEL, Curve, FitCurve, Group, even
from tirefit.results import UsageError

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


class Panel(NamedTuple):
    """One set of axes."""

    title: str
    curve: FitCurve
    ticks: tuple[tuple[float, str], ...] = ()  # place, label of categories


def _fitted(fit: MagicFormulaFit, force: str, inputs: Sequence[TireInputs]):
    """Predicted force (n,) at the inputs, and the standard deviation (n,) of a measurement."""
    joined = TireInputs(*map(np.concatenate, zip(*inputs, strict=True)))
    columns = {
        name: column
        for name, column in joined._asdict().items()
        if name in ("sigma_x", "alpha", "fz", "gamma", "v") or np.all(column > 0)
    }
    given = predict(fit, columns)
    ends = np.cumsum([np.size(one.fz) for one in inputs])[:-1]
    each = (np.split(given[name], ends) for name in (force, f"{force}_std"))
    return list(zip(*each, strict=True))


def _between(bins: SlipBins) -> TireInputs:
    """Inputs (m,) along the slip of a setting, interpolated between its bins: the load
    of a rig varies with the slip."""
    slip = np.linspace(bins.slip[0], bins.slip[-1], _POINTS)
    return TireInputs(*(np.interp(slip, bins.slip, column) for column in bins.inputs))


def _curve(label: str, x: np.ndarray, force: np.ndarray, std=0.0) -> Curve:
    """A curve (m,) with the 95 % band of a measurement."""
    half = _IN_95 * std
    return Curve(label, x, force, force, force, force - half, force + half, None)


def _name_of(force: str) -> str:
    """The name of a force as the beginning of a title."""
    return FORCE_LABEL[force][0].split(" $")[0].capitalize()


def _conditions(bins: SlipBins, without: str = "") -> str:
    """The conditions of a setting except one."""
    texts = [bins.setting.text(name) for name in _BY if name != without]
    return ", ".join(filter(None, texts))


def _panel(fit, force: str, name: str, members: Sequence[SlipBins]) -> Panel:
    """Points and curves of settings that differ in one condition."""
    x_label, scale = _AXIS[members[0].setting.swept]
    inputs = [_between(bins) for bins in members]
    groups, curves = [], []
    for bins, (middle, std) in zip(members, _fitted(fit, force, inputs), strict=True):
        label, x = bins.setting.text(name), scale * bins.slip
        groups.append(Group(label, x, bins.force, bins.low, bins.high))
        curves.append(_curve(label, np.linspace(x[0], x[-1], _POINTS), middle, std))
    what, unit, _ = FORCE_LABEL[force]
    labels, note = (x_label, f"{what} [{unit}]"), _conditions(members[0], name)
    curve = FitCurve(force, *labels, tuple(groups), tuple(curves), "", note)
    return Panel(f"{_name_of(force)} by {_BY[name]}", curve)


def _preference(members: Sequence[SlipBins]) -> tuple[int, float, int]:
    """Sort key of the settings to show: most, then least camber, then most rows."""
    rows = sum(int(bins.rows.sum()) for bins in members)
    return len(members), -abs(members[0].setting.gamma), rows


def force_panels(fit: MagicFormulaFit, force: str) -> list[Panel]:
    """A force over slip: by load, camber and pressure in pure slip, by slip angle in
    combined slip, as far as the test varies these. The other conditions have the values
    that :func:`_preference` ranks first."""
    panels = []
    for name in _BY:
        swept = "sigma_x" if name == "held" else SLIPS_OF[force][-1]
        alike: dict[tuple, list[SlipBins]] = {}
        for bins in fit.binned[force]:
            setting = bins.setting
            pure = name == "held" or abs(setting.held) <= NEARLY_PURE
            if setting.swept == swept and pure and len(bins.slip) > 2:
                key = tuple(getattr(setting, other) for other in _BY if other != name)
                alike.setdefault(key, []).append(bins)
        best = max(alike.values(), key=_preference, default=[])
        if len(best) > 1 or (best and name == "fz"):
            best = sorted(best, key=lambda bins: getattr(bins.setting, name))
            panels.append(_panel(fit, force, name, even(best)))
    return panels


def residual_panel(fit: MagicFormulaFit, force: str) -> Panel:
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
    groups = tuple(
        Group(kind, *np.concatenate(points[kind], axis=1)) for kind in even(sorted(points))
    )
    curve = _curve("", np.arange(float(len(table))), np.zeros(len(table)), std)
    size = [float(np.sqrt(np.mean(off**2))) for off in residual]
    worst, unit = int(np.argmax(size)), FORCE_LABEL[force][1]
    note = f"worst, {size[worst]:.3g} {unit} rms: {_conditions(table[worst])}"
    ticks = [(float(np.mean(at)), load) for load, at in places.items()]
    labels = "settings of the test, by load", f"measured - fitted [{unit}]"
    panel = FitCurve(force, *labels, groups, (curve,), "", note)
    return Panel(f"{_name_of(force)}, measured - fitted", panel, tuple(even(ticks)))


def ellipse_panel(fit: MagicFormulaFit) -> list[Panel]:
    """F_y / F_z over F_x / F_z in combined slip, at the load, camber and pressure with
    most slip angles, then the largest load; empty without combined slip."""
    lateral = {bins.setting: bins for bins in fit.binned.get("fy", ())}
    alike: dict[tuple, list[tuple[SlipBins, SlipBins]]] = {}
    for bins in fit.binned.get("fx", ()):
        if bins.setting.swept == "sigma_x" and bins.setting in lateral:
            pair = bins, lateral[bins.setting]
            alike.setdefault(bins.setting[:3], []).append(pair)
    most = max(alike, key=lambda key: (len(alike[key]), key[0]), default=None)
    if most is None or len(alike[most]) < 2:
        return []
    members = even(alike[most])
    inputs = [_between(along) for along, _ in members]
    fitted = {force: _fitted(fit, force, inputs) for force in ("fx", "fy")}
    groups, curves = [], []
    for i, (along, side) in enumerate(members):
        label = along.setting.text("held")
        fy, fz = (
            np.interp(along.slip, side.slip, column) for column in (side.force, side.inputs.fz)
        )
        groups.append(Group(label, along.force / fz, fy / fz))
        x, y = (fitted[force][i][0] / inputs[i].fz for force in ("fx", "fy"))
        curves.append(_curve(label, x, y))
    x_label, y_label = (f"{FORCE_LABEL[force][2]} [-]" for force in ("fx", "fy"))
    note = _conditions(members[0][0], "held")
    panel = FitCurve("fy", x_label, y_label, tuple(groups), tuple(curves), "", note)
    return [Panel("Friction ellipse: lateral over longitudinal force", panel)]


def panels_of(fit: MagicFormulaFit) -> dict[str, list[Panel]]:
    """Name of a figure -> its panels; raises UsageError for a fit read from a file."""
    if not fit.binned:
        raise UsageError("a fit read from a file has no data to draw: fit again")
    named = {force: force_panels(fit, force) for force in fit.binned}
    named["residuals"] = [residual_panel(fit, force) for force in fit.binned]
    named["ellipse"] = ellipse_panel(fit)
    return {name: panels for name, panels in named.items() if panels}
