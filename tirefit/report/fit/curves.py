"""Fitted curves and their bands, with the measured points, as arrays."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from tirefit.data.rig.levels import levels
from tirefit.data.run_names import run_names
from tirefit.fitting.problem.likelihood import CHANNEL_SLIP
from tirefit.fitting.problem.noise import noise_std
from tirefit.fitting.result import FitResult
from tirefit.fitting.uncertainty.bands import fitted_force, force_band
from tirefit.models import TireInputs
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


class SlipAxis(NamedTuple):
    """The slip as drawn: label, unit, and the maps from and to canonical values."""

    label: str
    unit: str
    shown: Callable[[np.ndarray], np.ndarray]
    canonical: Callable[[np.ndarray], np.ndarray]


class Group(NamedTuple):
    """Measured points of one level of load, slip, speed or run: slip, force (n,), and the
    range of forces (n,) if a point represents several rows."""

    label: str
    slip: np.ndarray
    force: np.ndarray
    low: np.ndarray | None = None
    high: np.ndarray | None = None


class Curve(NamedTuple):
    """A fitted curve (m,) with its 95 % band and the 95 % band of a measurement."""

    slip: np.ndarray
    force: np.ndarray
    low: np.ndarray
    high: np.ndarray
    noise_low: np.ndarray
    noise_high: np.ndarray


class FitCurve(NamedTuple):
    """One force over its slip, with a curve for each of ``groups``, or one for all."""

    channel: str
    x_label: str
    y_label: str
    groups: Sequence[Group]
    curves: Sequence[Curve]
    note: str
    title: str = ""
    ticks: Sequence[tuple[float, str]] = ()  # place, label of categories


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


def even(members: Sequence[Any]) -> list[Any]:
    """At most as many members as a panel shows, including the first and the last."""
    count = min(len(members), _MOST_GROUPS)
    return [members[i] for i in np.linspace(0, len(members) - 1, count).astype(int)]


def _levels(values: np.ndarray, scale: float) -> np.ndarray:
    """Codes (n,) of the levels of values; of thirds of the range if they are swept."""
    if not scale > 0 or np.ptp(values) <= 0.1 * scale:
        return np.zeros(len(values), int)
    settings = levels(values)
    if settings.few(_MOST_GROUPS):
        return settings.code
    return np.searchsorted(np.quantile(values, [1 / 3, 2 / 3]), values)


def _keys(result: FitResult, slip: str) -> dict[str, np.ndarray]:
    """Input -> codes (n,), of inputs that separate the curves; at most six combinations."""
    problem = result.problem
    inputs, other = problem.rows.inputs, _OTHER[slip]
    candidates = {}
    if any(p.per_run for p in problem.layout.free):
        candidates["run"] = problem.used(problem.rows.run)
    for name in ("fz", other, "v"):
        values = problem.used(getattr(inputs, name))
        scale = 0.1 if name == other else float(np.median(np.abs(values)))
        if name != "v" or "v" in problem.model.needs:
            candidates[name] = _levels(values, scale)
    kept: dict[str, np.ndarray] = {}
    for name, codes in candidates.items():
        stack = np.stack([*kept.values(), codes], axis=1)
        few = len(np.unique(stack, axis=0)) <= _MOST_GROUPS
        if np.ptp(codes) > 0 and (few or name == "run"):
            kept[name] = codes
    return kept


def _level_label(name: str, values: np.ndarray, runs: Sequence[str] = ()) -> str:
    """Name of a level of an input, such as ``$F_z$ = 4000 N``, by its values."""
    if name == "run":
        return plain_text(str(runs[int(values[0])]))
    middle = float(np.median(values))
    sign = "=" if np.ptp(values) <= 0.1 * abs(middle) + 1e-3 else "≈"
    symbol, shown, form, unit = {
        "fz": ("$F_z$", middle, ".0f", " N"),
        "v": ("$v$", middle, ".3g", " m/s"),
        "alpha": (r"$\alpha$", np.degrees(middle), ".2g", "°"),
        "sigma_x": (r"$\sigma_x$", middle, ".2g", ""),
    }[name]
    return f"{symbol} {sign} {shown:{form}}{unit}"


def _members(result: FitResult, keys: Mapping[str, np.ndarray]) -> list[tuple[str, np.ndarray]]:
    """Label and rows (n,) bool of every group; of many runs, of some of them."""
    problem = result.problem
    if not keys:
        return [("measured", np.ones(problem.n, bool))]
    columns = {**problem.rows.inputs._asdict(), "run": problem.rows.run}
    names = run_names(problem.layout.runs).short
    stack = np.stack(list(keys.values()), axis=1)
    combinations, of_row = np.unique(stack, axis=0, return_inverse=True)
    groups = []
    for code in even(range(len(combinations))):
        rows = of_row.ravel() == code
        parts = [_level_label(name, problem.used(columns[name])[rows], names) for name in keys]
        groups.append((", ".join(parts), rows))
    return groups


def _conditions(result: FitResult, rows: np.ndarray, slip: str, is_grouped: bool) -> dict[str, Any]:
    """The inputs of a curve: medians of its rows; the other slip is zero if the rows include
    zero and are not grouped by it."""
    problem, other = result.problem, _OTHER[slip]
    columns = {k: problem.used(v)[rows] for k, v in problem.rows.inputs._asdict().items()}
    at = {name: float(np.median(column)) for name, column in columns.items()}
    whole = problem.used(getattr(problem.rows.inputs, other))
    if not is_grouped:
        at[other] = 0.0 if whole.min() <= 0 <= whole.max() else float(np.median(whole))
    return at


def _carried(
    result: FitResult,
    channel: str,
    members: Sequence[tuple[str, np.ndarray]],
    conditions: Sequence[Mapping[str, float]],
) -> tuple[np.ndarray, bool]:
    """Measured forces (n,), moved to the load and the other slip of their curve, and whether.

    Rows of a group have other loads and other slips than their curve, so they would lie off
    it. They are moved by the difference that the fit predicts, if it exceeds the noise; each
    keeps its residual.
    """
    problem = result.problem
    inputs, run, other = problem.rows.inputs, problem.rows.run, _OTHER[CHANNEL_SLIP[channel]]
    observed = problem.used(problem.rows.observed[channel])
    moved = {name: np.array(getattr(inputs, name)) for name in ("fz", other)}
    for (_, rows), at in zip(members, conditions, strict=True):
        for name, column in moved.items():
            column[: problem.n][rows] = at[name]
    there = inputs._replace(**{k: jax.device_put(v) for k, v in moved.items()})
    if problem.model.transient:
        # Constant time means steady state, as in the curves.
        there = there._replace(time=jnp.zeros_like(inputs.time))
    after, before = (problem.used(fitted_force(result, channel, at, run)) for at in (there, inputs))
    shift, scale = after - before, problem.used(problem.rows.scale[channel])
    if np.sqrt(np.mean((shift / scale) ** 2)) < 1:
        return observed, False
    return observed + shift, True


def _curve(
    result: FitResult,
    channel: str,
    ends: Sequence[float],
    axis: SlipAxis,
    at: Mapping[str, Any],
    run: int,
) -> Curve:
    """The fitted curve at the conditions, between two slips as drawn."""
    problem, slip = result.problem, CHANNEL_SLIP[channel]
    shown = np.linspace(ends[0], ends[1], _POINTS)
    columns = {name: np.full(_POINTS, value) for name, value in at.items()}
    columns[slip] = np.asarray(axis.canonical(shown), float)
    inputs, of_run = jax.device_put(TireInputs(**columns)), np.full(_POINTS, run)
    noise = np.full(_POINTS, float(np.median(problem.used(problem.rows.scale[channel]))))
    if result.noise[channel].keys() & {"share_of_load", "by_run"}:
        force = fitted_force(result, channel, inputs, of_run)
        names = np.array(problem.layout.runs)[of_run]
        noise = noise_std(result.noise[channel], columns["fz"], force, names)
    return Curve(shown, *force_band(result, channel, inputs, of_run, noise))


def _ends(values: np.ndarray, axis: SlipAxis) -> tuple[float, float]:
    """Slips as drawn, from zero or the smallest to just beyond the largest."""
    values = axis.shown(values)
    low, high = min(values.min(), 0.0), max(values.max(), 0.0)
    margin = 0.03 * (high - low)
    low, high = low - margin * (low < 0), high + margin * (high > 0)
    if axis.shown is slip_ratio_from_sigma:
        low, high = max(low, -1 + 1e-3), min(high, 1.0)
    return float(low), float(high)


def fit_curve(result: FitResult, channel: str | None = None) -> FitCurve:
    """Measured points and fitted curves of one force over its slip.

    Points are grouped by run (where a parameter is per run), load, the other slip and,
    where the friction depends on it, speed. Points whose load or other slip differs from
    that of their curve are moved along the fit, as ``note`` says.

    Args:
        result: a fit with its problem.
        channel: ``fx``, ``fy`` or ``mz``; the first fitted one if None.
    """
    problem = result.problem
    channel = channel or problem.channels[0].name
    slip = CHANNEL_SLIP[channel]
    values = problem.used(getattr(problem.rows.inputs, slip))
    axis, keys = slip_axis(slip, values), _keys(result, slip)
    members, other = _members(result, keys), _OTHER[slip]
    conditions = [_conditions(result, rows, slip, other in keys) for _, rows in members]
    force, is_moved = _carried(result, channel, members, conditions)
    runs, ends = problem.used(problem.rows.run), _ends(values, axis)
    curves = [
        _curve(result, channel, ends, axis, at, int(runs[rows][0]))
        for (_, rows), at in zip(members, conditions, strict=True)
    ]
    notes = []
    if "run" in keys and len(members) < len(problem.layout.runs):
        notes.append(f"{len(members)} of {len(problem.layout.runs)} runs shown")
    if is_moved:
        common = [n for n in ("fz", other) if n not in keys]
        to = ", ".join(_level_label(n, np.full(1, conditions[0][n])) for n in common)
        steady = "the steady state and " * problem.model.transient
        notes.append(f"points moved along the fit to {steady}{to or 'the values of their curve'}")
    groups = members
    if len(members) == 1 and 1 < len(np.unique(runs)) <= _MOST_GROUPS:
        groups = _members(result, {"run": runs})  # for colour only
    name, unit, _ = FORCE_LABEL[channel]
    return FitCurve(
        channel,
        f"{axis.label} [{axis.unit}]",
        f"{name} [{unit}]",
        [Group(label, axis.shown(values[rows]), force[rows]) for label, rows in groups],
        curves,
        "\n".join(notes),
    )
