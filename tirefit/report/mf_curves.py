"""What the figures of a Magic Formula fit show, as arrays."""

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

_POINTS = 80
"""Of a curve between the first and the last bin."""
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
    """One set of axes: its title, and points and curves; ``ticks`` are places along
    the abscissa that have names, if the abscissa is no quantity."""

    title: str
    curve: FitCurve
    ticks: tuple[tuple[float, str], ...] = ()


def _fitted(fit: MagicFormulaFit, force: str, inputs: Sequence[TireInputs]):
    """For each of some inputs the force of the fit and its standard deviation as a
    measurement, (n,) each."""
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
    """Inputs (m,) between the bins of a setting as the rows had them there: the load of
    a rig follows the slip."""
    slip = np.linspace(bins.slip[0], bins.slip[-1], _POINTS)
    return TireInputs(*(np.interp(slip, bins.slip, column) for column in bins.inputs))


def _named(force: str) -> str:
    return FORCE_LABEL[force][0].split(" $")[0].capitalize()


def _conditions(bins: SlipBins, but: str) -> str:
    texts = [bins.setting.text(name) for name in _BY if name != but]
    return ", ".join(filter(None, texts))


def _panel(fit, force: str, name: str, members: Sequence[SlipBins]) -> Panel:
    """Points and curves of settings that differ in one condition."""
    x_label, scale = _AXIS[members[0].setting.swept]
    fitted = _fitted(fit, force, [_between(bins) for bins in members])
    groups, curves = [], []
    for bins, (middle, std) in zip(members, fitted, strict=True):
        label = bins.setting.text(name)
        x = scale * bins.slip
        band = middle - _IN_95 * std, middle + _IN_95 * std
        along = np.linspace(x[0], x[-1], _POINTS)
        groups.append(Group(label, x, bins.force, bins.low, bins.high))
        curves.append(Curve(label, along, middle, middle, middle, *band, None))
    what, unit, _ = FORCE_LABEL[force]
    note, y_label = _conditions(members[0], name), f"{what} [{unit}]"
    shown = tuple(groups), tuple(curves)
    curve = FitCurve(force, x_label, y_label, *shown, "", note)
    return Panel(f"{_named(force)} by {_BY[name]}", curve)


def _told(members: Sequence[SlipBins]) -> tuple[int, float, int]:
    rows = sum(int(bins.rows.sum()) for bins in members)
    return len(members), -abs(members[0].setting.gamma), rows


def force_panels(fit: MagicFormulaFit, force: str) -> list[Panel]:
    """A force over slip by load, camber and pressure in pure slip and by the slip angle
    in combined slip; each where the test has several, the other conditions those at
    which it has most of them, with least camber, and then most rows."""
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
        best = max(alike.values(), key=_told, default=[])
        if len(best) > 1 or (best and name == "fz"):
            best = sorted(best, key=lambda bins: getattr(bins.setting, name))
            panels.append(_panel(fit, force, name, even(best)))
    return panels


def residual_panel(fit: MagicFormulaFit, force: str) -> Panel:
    """What every bin misses, measured - fitted, setting by setting in order of load."""
    table = sorted(fit.binned[force], key=lambda bins: bins.setting)
    fitted = _fitted(fit, force, [bins.inputs for bins in table])
    missed = [b.force - middle for b, (middle, _) in zip(table, fitted, strict=True)]
    half = np.array([_IN_95 * np.median(std) for _, std in fitted])
    kinds = np.array([bins.setting.text("held") for bins in table])
    groups = []
    for kind in even(sorted(set(kinds.tolist()))):
        own = np.flatnonzero(kinds == kind)
        x = [i + np.linspace(-0.3, 0.3, len(missed[i])) for i in own]
        y = [missed[i] for i in own]
        groups.append(Group(kind, np.concatenate(x), np.concatenate(y)))
    place, zero = np.arange(float(len(table))), np.zeros(len(table))
    curve = Curve("", place, zero, zero, zero, -half, half, None)
    size = [float(np.sqrt(np.mean(one**2))) for one in missed]
    worst = int(np.argmax(size))
    unit = FORCE_LABEL[force][1]
    note = f"worst, {size[worst]:.3g} {unit} rms: {_conditions(table[worst], '')}"
    loads = np.array([bins.setting.text("fz") for bins in table])
    ticks = [
        (float(place[loads == t].mean()), t) for t in dict.fromkeys(loads.tolist())
    ]
    labels = "settings of the test, by load", f"measured - fitted [{unit}]"
    panel = FitCurve(force, *labels, tuple(groups), (curve,), "", note)
    return Panel(f"{_named(force)}, measured less fitted", panel, tuple(even(ticks)))


def ellipse_panel(fit: MagicFormulaFit) -> list[Panel]:
    """Lateral over longitudinal force in combined slip, over load, at the camber and
    pressure with most slip angles and the largest load; none without such a test."""
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
            np.interp(along.slip, side.slip, column)
            for column in (side.force, side.inputs.fz)
        )
        groups.append(Group(label, along.force / fz, fy / fz))
        x, y = (fitted[force][i][0] / inputs[i].fz for force in ("fx", "fy"))
        curves.append(Curve(label, x, y, y, y, y, y, None))
    x_label, y_label = (f"{FORCE_LABEL[force][2]} [-]" for force in ("fx", "fy"))
    note = _conditions(members[0][0], "held")
    panel = FitCurve("fy", x_label, y_label, tuple(groups), tuple(curves), "", note)
    return [Panel("Lateral and longitudinal force share the friction", panel)]


def panels_of(fit: MagicFormulaFit) -> dict[str, list[Panel]]:
    """Name of a figure -> its panels."""
    if not fit.binned:
        raise UsageError("this fit has no data in memory (fit again to draw it)")
    named = {force: force_panels(fit, force) for force in fit.binned}
    named["residuals"] = [residual_panel(fit, force) for force in fit.binned]
    named["ellipse"] = ellipse_panel(fit)
    return {name: panels for name, panels in named.items() if panels}
