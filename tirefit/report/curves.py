"""The fitted curve and its bands, as arrays."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from tirefit.data.levels import levels
from tirefit.data.run_names import run_names
from tirefit.fitting.bands import Band, fitted_force, force_band
from tirefit.fitting.likelihood import CHANNEL_SLIP
from tirefit.fitting.noise import noise_std
from tirefit.fitting.result import FitResult
from tirefit.models import TireInputs
from tirefit.params import parameter_values, with_values
from tirefit.report.numbers import plain_text
from tirefit.slip import LOCKED, sigma_from_slip_ratio, slip_ratio_from_sigma

_MOST_GROUPS = 6
_POINTS = 240
_OTHER = {"sigma_x": "alpha", "alpha": "sigma_x"}
FORCE_LABEL = {
    "fx": ("longitudinal force $F_x$", "N", "$F_x / F_z$"),
    "fy": ("lateral force $F_y$", "N", "$F_y / F_z$"),
    "mz": ("aligning moment $M_z$", "N m", "$M_z / F_z$"),
    "mx": ("overturning moment $M_x$", "N m", "$M_x / F_z$"),
    "my": ("rolling resistance moment $M_y$", "N m", "$M_y / F_z$"),
}
_LIMIT = {"mu": ("friction limit", r"\mu"), "mu_peak": ("peak", r"\mu'"), "D": ("peak", "D")}


class SlipAxis(NamedTuple):
    """The slip as drawn: label, unit, and the maps from and to canonical values."""

    label: str
    unit: str
    shown: Callable[[np.ndarray], np.ndarray]
    canonical: Callable[[np.ndarray], np.ndarray]


class Group(NamedTuple):
    """Measured points of one level of load, slip, speed or run: slip, force (n,), and
    where each stands for several rows the range of their forces, (n,)."""

    label: str
    slip: np.ndarray
    force: np.ndarray
    low: np.ndarray | None = None
    high: np.ndarray | None = None


class Curve(NamedTuple):
    """A fitted curve (m,) with its 95 % band and the 95 % band of a measurement."""

    label: str
    slip: np.ndarray
    force: np.ndarray
    low: np.ndarray
    high: np.ndarray
    noise_low: np.ndarray
    noise_high: np.ndarray
    limit: float | None  # of friction, None where the data do not tell


class FitCurve(NamedTuple):
    """One force over its slip. ``curves`` match ``groups`` one to one, or are one."""

    channel: str
    x_label: str
    y_label: str
    groups: tuple[Group, ...]
    curves: tuple[Curve, ...]
    limit_label: str
    note: str


def slip_axis(name: str, values: np.ndarray) -> SlipAxis:
    """Axis of a slip: angles in degrees, slips of nearly locked wheels as slip ratio.

    Args:
        name: ``sigma_x`` or ``alpha``.
        values: canonical values to be drawn, (n,).
    """
    if name == "alpha":
        return SlipAxis(r"slip angle $\alpha$", "deg", np.degrees, np.radians)
    if np.max(np.abs(values), initial=0.0) <= 1.0:
        return SlipAxis(r"slip $\sigma_x$", "-", np.asarray, np.asarray)
    return SlipAxis(
        r"slip ratio $v_{sx}/\max(v_x, \Omega R_e)$",
        "-",
        slip_ratio_from_sigma,
        lambda ratio: sigma_from_slip_ratio(np.minimum(ratio, 1 - 1 / LOCKED)),
    )


def even(members: Sequence[Any]) -> list:
    """At most as many members as a panel shows, the first and the last among them."""
    count = min(len(members), _MOST_GROUPS)
    return [members[i] for i in np.linspace(0, len(members) - 1, count).astype(int)]


def _levels(values: np.ndarray, scale: float) -> np.ndarray:
    """Codes (n,) of the levels that values gather at; thirds where they are swept."""
    if not scale > 0 or np.ptp(values) <= 0.1 * scale:
        return np.zeros(len(values), int)
    settings = levels(values)
    if settings.few(_MOST_GROUPS):
        return settings.code
    return np.searchsorted(np.quantile(values, [1 / 3, 2 / 3]), values)


def _keys(result: FitResult, slip: str) -> list[tuple[str, np.ndarray]]:
    """(input, codes (n,)) of what separates the curves, at most six combinations."""
    problem = result.problem
    inputs, run = problem.rows.inputs, problem.used(problem.rows.run)
    other = _OTHER[slip]
    per_run = any(p.per_run for p in problem.layout.free)
    candidates = [("run", run)] if per_run else []
    for name in ("fz", other, "v"):
        values = problem.used(getattr(inputs, name))
        scale = 0.1 if name == other else float(np.median(np.abs(values)))
        if name != "v" or "v" in problem.model.needs:
            candidates.append((name, _levels(values, scale)))
    kept: list[tuple[str, np.ndarray]] = []
    for name, codes in candidates:
        stack = np.stack([c for _, c in kept] + [codes], axis=1)
        few = len(np.unique(stack, axis=0)) <= _MOST_GROUPS
        if np.ptp(codes) > 0 and (few or name == "run"):
            kept.append((name, codes))
    return kept


def _level_label(name: str, values: np.ndarray, runs) -> str:
    if name == "run":
        return plain_text(str(runs[int(values[0])]))
    middle = float(np.median(values))
    sign = "=" if np.ptp(values) <= 0.1 * abs(middle) + 1e-3 else "≈"
    text = {
        "fz": lambda: f"$F_z$ {sign} {middle:.0f} N",
        "v": lambda: f"$v$ {sign} {middle:.3g} m/s",
        "alpha": lambda: rf"$\alpha$ {sign} {np.degrees(middle):.2g}°",
        "sigma_x": lambda: rf"$\sigma_x$ {sign} {middle:.2g}",
    }
    return text[name]()


def _members(result: FitResult, keys) -> tuple[list[tuple[str, np.ndarray]], str]:
    """((label, rows (n,) bool) of every group, note on what is left out)."""
    problem = result.problem
    columns = {**problem.rows.inputs._asdict(), "run": problem.rows.run}
    names = run_names(problem.layout.runs).short
    if not keys:
        return [("measured", np.ones(problem.n, bool))], ""
    stack = np.stack([codes for _, codes in keys], axis=1)
    combinations, of_row = np.unique(stack, axis=0, return_inverse=True)
    chosen, note = np.arange(len(combinations)), ""
    if len(combinations) > _MOST_GROUPS:
        chosen = np.array(even(range(len(combinations))))
        note = f"{_MOST_GROUPS} of {len(combinations)} runs shown"
    groups = []
    for code in chosen:
        rows = of_row.ravel() == code
        parts = [_level_label(name, problem.used(columns[name])[rows], names) for name, _ in keys]
        groups.append((", ".join(parts), rows))
    return groups, note


def _value(result: FitResult, name: str, run: int) -> float:
    """Least-squares value of a free, tied or fixed parameter in one run."""
    problem = result.problem
    for tie in problem.layout.ties:
        if tie.name == name:
            return tie.factor * _value(result, tie.other, run)
    for label in (name, f"{name}[{problem.layout.runs[run]}]"):
        if label in result.least_squares:
            return result.least_squares[label].value
    return float(parameter_values(problem.model)[name])


def _grid(problem, slip: str, axis: SlipAxis) -> np.ndarray:
    """Slips as drawn, (m,), from zero or the smallest to just beyond the largest."""
    values = axis.shown(problem.used(getattr(problem.rows.inputs, slip)))
    low, high = min(values.min(), 0.0), max(values.max(), 0.0)
    margin = 0.03 * (high - low)
    low, high = low - margin * (low < 0), high + margin * (high > 0)
    if axis.shown is slip_ratio_from_sigma:
        low, high = max(low, -1 + 1e-3), min(high, 1.0)
    return np.linspace(low, high, _POINTS)


def _conditions(problem, members) -> list[dict[str, float]]:
    """The inputs at which the curve of each group is drawn: medians of its rows."""
    inputs = problem.rows.inputs._asdict()
    return [
        {k: float(np.median(problem.used(v)[rows])) for k, v in inputs.items()}
        for _, rows in members
    ]


def _carried(result: FitResult, channel: str, members, keys, middle):
    """Measured forces (n,), moved to the other slip of their curve, and a note.

    In combined slip each row has another value of the other slip, so the points would
    lie off the curves. They are moved by the difference that the fit predicts, if it
    exceeds the noise; ``middle`` then takes up a slip common to all groups.
    """
    problem = result.problem
    inputs, run = problem.rows.inputs, problem.rows.run
    observed = problem.used(problem.rows.observed[channel])
    name = _OTHER[CHANNEL_SLIP[channel]]
    own = np.asarray(getattr(inputs, name))
    moved, target = own.copy(), np.median(problem.used(own))
    if problem.used(own).min() <= 0 <= problem.used(own).max():
        target = 0.0
    grouped = name in dict(keys)
    for (_, rows), at in zip(members, middle, strict=True):
        moved[: problem.n][rows] = at[name] if grouped else target
    target_inputs = inputs._replace(**{name: jnp.asarray(moved)})
    if problem.model.transient:
        # Constant time means steady state, as in the curves.
        target_inputs = target_inputs._replace(time=jnp.zeros_like(inputs.time))
    there, here = (
        problem.used(fitted_force(result, channel, at, run)) for at in (target_inputs, inputs)
    )
    shift, scale = there - here, problem.used(problem.rows.scale[channel])
    if np.sqrt(np.mean((shift / scale) ** 2)) < 1:
        return observed, ""
    to = "to the steady state and" if problem.model.transient else "to"
    if grouped:
        return observed + shift, f"points moved along the fit {to} these slips"
    for at in middle:
        at[name] = float(target)
    label = _level_label(name, np.full(1, target), ())
    return observed + shift, f"points moved along the fit {to} {label}"


def _curves(result: FitResult, channel, members, axis: SlipAxis, normalise, middle):
    """The fitted curve of every group, all groups evaluated in one call."""
    problem = result.problem
    slip = CHANNEL_SLIP[channel]
    shown = _grid(problem, slip, axis)
    grid = np.asarray(axis.canonical(shown), float)
    inputs, runs = problem.rows.inputs, problem.used(problem.rows.run)
    columns = {
        name: np.concatenate(
            [grid if name == slip else np.full(len(grid), m[name]) for m in middle]
        )
        for name in inputs._fields
    }
    run = [int(runs[rows][0]) for _, rows in members]
    inputs = jax.device_put(TireInputs(**columns))
    scale = problem.used(problem.rows.scale[channel])
    each = [float(np.median(scale[rows])) for _, rows in members]
    of_run, noise = np.repeat(run, len(grid)), np.repeat(each, len(grid))
    if result.noise[channel].keys() & {"share_of_load", "by_run"}:
        force = fitted_force(result, channel, inputs, of_run)
        names = np.array(problem.layout.runs)[of_run]
        noise = noise_std(result.noise[channel], columns["fz"], force, names)
    band = force_band(result, channel, inputs, of_run, noise)
    curves = []
    for i, (label, _) in enumerate(members):
        unit = middle[i]["fz"] if normalise else 1.0
        part = Band(*(x[i * len(grid) : (i + 1) * len(grid)] / unit for x in band))
        limit = _limit(result, channel, run[i], middle[i]["fz"])
        limit = None if limit is None else limit / unit
        curves.append(Curve(label, shown, *part, limit))
    return tuple(curves)


def _limit_name(result: FitResult) -> str | None:
    """The parameter that limits the friction, None where the model has none."""
    names = parameter_values(result.problem.model)
    return next((name for name in _LIMIT if name in names), None)


def _limit_known(result: FitResult, name: str) -> bool:
    """Whether the data identify the friction limit in every run."""
    labels = [k for k in result.least_squares if k.split("[")[0] == name]
    return all(result.least_squares[label].identified for label in labels)


def _limit(result: FitResult, channel: str, run: int, fz: float) -> float | None:
    name = _limit_name(result)
    if channel == "mz" or name is None or not _limit_known(result, name):
        return None
    model = result.problem.model
    values = {key: _value(result, key, run) for key in parameter_values(model)}
    friction = with_values(model, values).static_friction(fz)
    return float(values[name] if friction is None else friction) * fz


def fit_curve(result: FitResult, channel: str | None = None) -> FitCurve:
    """Measured points and fitted curves of one force over its slip.

    Points are grouped by run (where a parameter is per run), load, the other slip and,
    where the friction depends on it, speed. Points of combined slip are moved along the
    fit to the other slip of their curve; ``note`` says so. Within a group whose load
    varies by more than 10 % points and curves are forces over load.

    Args:
        result: a fit with its problem.
        channel: ``fx``, ``fy`` or ``mz``; the first fitted one if None.
    """
    problem = result.problem
    channel = channel or problem.channels[0].name
    slip = CHANNEL_SLIP[channel]
    values = problem.used(getattr(problem.rows.inputs, slip))
    load = problem.used(problem.rows.inputs.fz)
    axis = slip_axis(slip, values)
    keys = _keys(result, slip)
    members, note = _members(result, keys)
    middle = _conditions(problem, members)
    force, moved = _carried(result, channel, members, keys, middle)
    normalise = any(
        np.ptp(np.quantile(load[rows], [0.025, 0.975])) > 0.1 * np.median(load[rows])
        for _, rows in members
    )
    curves = _curves(result, channel, members, axis, normalise, middle)
    if len(members) == 1:
        members = _by_run(problem, members)
    unit = load if normalise else np.ones_like(load)
    groups = tuple(
        Group(label, axis.shown(values[rows]), (force / unit)[rows]) for label, rows in members
    )
    name, force_unit, ratio = FORCE_LABEL[channel]
    ratio_unit = "m" if channel == "mz" else "-"
    return FitCurve(
        channel,
        f"{axis.label} [{axis.unit}]",
        f"{ratio} [{ratio_unit}]" if normalise else f"{name} [{force_unit}]",
        groups,
        curves,
        _limit_label(result, channel, normalise),
        "\n".join(filter(None, (note, moved))),
    )


def _limit_label(result: FitResult, channel: str, normalise: bool) -> str:
    name = _limit_name(result)
    if name is None or channel == "mz":
        return ""
    what, symbol = _LIMIT[name]
    text = f"{what} ${symbol}$" if normalise else rf"{what} ${symbol}\,F_z$"
    return text if _limit_known(result, name) else f"{text}: not identified"


def _by_run(problem, members):
    """One group split by run, for colour only, where there are a few runs."""
    run = problem.used(problem.rows.run)
    codes = np.unique(run)
    if not 1 < len(codes) <= _MOST_GROUPS:
        return members
    names = run_names(problem.layout.runs).short
    return [(plain_text(names[code]), run == code) for code in codes]
