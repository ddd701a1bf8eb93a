"""Contents of the figures of a diagnosis, as arrays: the residual in cells of the data,
both fits over the slip, and the shape of the remainder."""

from typing import Any, NamedTuple

import numpy as np
from scipy.special import stdtr

from tirefit.data.levels import cells, levels
from tirefit.diagnosis.evidence.base import Base
from tirefit.diagnosis.evidence.forms import PLACE
from tirefit.diagnosis.evidence.posterior import LinearFit, linear_at
from tirefit.diagnosis.negligible import NONZERO, ROUNDING
from tirefit.diagnosis.rows.basis import FULL_SLIDING, without
from tirefit.diagnosis.rows.patterns import (
    PARAMETERS,
    Look,
    Pattern,
    is_mirrored,
    quantities,
    settings_of,
)
from tirefit.diagnosis.summary.where import FEWEST_ROWS, LEVEL, adjusted, binned, covariates_of

_BANDS, _BINS, _STEPS = 5, 13, 60
"""Largest numbers of bands of a swept covariate, bins of a map, and bins of a curve."""

_FEWEST = 4  # smallest number of rows of a cell for its scatter to be known
_TENTHS = (0.1, 0.9)  # quantiles that hold 80 % of the rows of a bin
_BETTER = 0.05
"""Another map replaces that over the load if it shows more energy by this share."""
_POINTS, _CURVES = 300, 3  # largest numbers of points and curves in a figure
_SHOWN_OVER = ("fz", "v", "time", "direction", "gamma")
"""Covariates of the map, the usual one first."""


class ShownRows(NamedTuple):
    """The used rows of the first channel, (n,) each."""

    channel: str
    slip_name: str
    slip: np.ndarray  # sigma_x, or alpha [rad], see ``slip_name``
    slip_fraction: np.ndarray
    load: np.ndarray
    covariates: dict[str, np.ndarray]  # those that vary, loads first
    observed: np.ndarray
    base: np.ndarray  # [N]
    extended: np.ndarray  # [N]
    gap: np.ndarray  # [N], located


class ResidualMap(NamedTuple):
    """Mean residual of the base fit in cells of slip fraction x another covariate."""

    channel: str
    covariate: str
    levels: np.ndarray  # (m, 2) of the covariate, from and to
    edges: np.ndarray  # (k+1,) of the signed slip fraction
    mean: np.ndarray  # (m, k) in % of F_z, NaN for empty cells
    beyond: np.ndarray  # (m, k) significant (Benjamini-Hochberg, 5 %)
    energy: np.ndarray  # (m, k) share of the gap's energy, 0 if it cannot be resolved


class LoadCurve(NamedTuple):
    """One level of load: measured points (n,), both fits as means over bins of slip (k,)."""

    load: tuple[float, float]  # [N] from and to
    slip: np.ndarray  # (n,)
    force: np.ndarray  # (n,)
    center: np.ndarray
    base: np.ndarray
    extended: np.ndarray
    low: np.ndarray  # ends of 80 % of the extended forces of a bin
    high: np.ndarray


class Comparison(NamedTuple):
    """Base and extension: curves by load; rms residuals [N] with noise by slip fraction."""

    channel: str
    slip_name: str
    named: bool  # whether ``after`` is the extension; else it has the located gap
    curves: tuple[LoadCurve, ...]
    center: np.ndarray
    before: np.ndarray
    after: np.ndarray


def shown_rows(base, parts) -> ShownRows:
    """The rows of a base fit; ``parts`` are ``base``, ``extended`` and ``gap`` (n,) of
    the first channel."""
    rows, varying = base.prepared, covariates_of(base)
    channel, is_lateral = rows.channels[0], rows.mode == "y"
    return ShownRows(
        channel,
        "alpha" if is_lateral else "sigma_x",
        np.arctan(rows.slip) if is_lateral else rows.slip,
        base.slip_fraction,
        np.asarray(rows.inputs.fz, float),
        {name: varying[name] for name in _SHOWN_OVER if name in varying},
        rows.observed[channel],
        parts["base"],
        parts["extended"],
        parts["gap"],
    )


def _means(codes, *columns) -> list[np.ndarray]:
    """Mean of each column in every bin that has rows."""
    count = np.bincount(codes)
    there = count > 0
    return [np.bincount(codes, c)[there] / count[there] for c in columns]


def _levels(values) -> tuple[np.ndarray, np.ndarray]:
    """Level (n,) of each value, and the levels (m, 2), from and to."""
    settings = levels(values)
    if settings.few():
        return settings.code, np.stack([settings.center, settings.center], axis=1)
    codes, edges = binned(values, _BANDS)
    return codes, np.stack([edges[:-1], edges[1:]], axis=1)


def _in_columns(rows: ShownRows, count: int) -> tuple[np.ndarray, np.ndarray]:
    """:func:`binned` of the slip fraction, for maps of ``count`` levels."""
    inside = np.clip(rows.slip_fraction, -FULL_SLIDING, FULL_SLIDING)
    columns = min(len(inside) // (FEWEST_ROWS * count), _BINS)
    # With an odd number, zero slip, where noise changes the sign, is within one cell.
    return binned(inside, columns | 1)


def residual_map(rows: ShownRows, inflation: float, resolvable: bool) -> ResidualMap:
    """The map over slip fraction and the covariate that shows most of the gap; the load,
    unless another covariate shows 5 % more.

    Args:
        inflation: rows per independent row.
        resolvable: whether there is a gap to share out.
    """
    residual = 100 * (rows.observed - rows.base) / rows.load
    most, found = -np.inf, list[Any]()
    for covariate, values in (rows.covariates or {"fz": rows.load}).items():
        level, ends = _levels(values)
        column, edges = _in_columns(rows, len(ends))
        cell = level * (len(edges) - 1) + column
        each = cells(cell, len(ends) * (len(edges) - 1), residual)
        count, mean, std = each
        seen = float(np.sum((count * mean**2 - std**2)[count >= _FEWEST]))
        if not found or seen > most + _BETTER * abs(most):
            most, found = seen, [covariate, ends, edges, cell, *each]
    covariate, ends, edges, cell, count, mean, std = found
    there, independent = count >= _FEWEST, np.maximum(count / inflation, 1.0)
    t = mean * np.sqrt(independent) / np.maximum(std, ROUNDING)
    p = 2 * stdtr(np.maximum(independent - 1, 1.0), -np.abs(t))
    beyond = np.zeros(len(mean), bool)
    if there.any():
        beyond[there] = adjusted(p[there]) < LEVEL
    square = np.bincount(cell, rows.gap**2, len(mean))
    energy = square * resolvable / max(float(square.sum()), NONZERO)
    shown = np.where(there, mean, np.nan), beyond, energy
    shape = len(ends), len(edges) - 1
    return ResidualMap(rows.channel, covariate, ends, edges, *(x.reshape(shape) for x in shown))


def _load_curve(load, slip, force, base, extended) -> LoadCurve:
    codes, _ = binned(slip, min(len(slip) // FEWEST_ROWS, _STEPS))
    bins = [codes == k for k in np.unique(codes)]
    # The force rises with slip within a bin: spread only the part of the extension.
    spread = [np.quantile((extended - base)[rows], _TENTHS) for rows in bins]
    # The slip of a nearly locked wheel is unbounded, so do not average it.
    center = np.array([np.median(slip[rows]) for rows in bins])
    before, after = _means(codes, base, extended)
    points = np.unique(np.linspace(0, len(slip) - 1, _POINTS).astype(int))
    return LoadCurve(
        load, slip[points], force[points], center, before, after, *(before + np.array(spread).T)
    )


def compared(rows: ShownRows, named: bool) -> Comparison:
    """Both fits and the data at up to three loads, and their residuals over slip. If no
    effect is named, the base with the located gap replaces the extension."""
    after = rows.extended if named else rows.base + rows.gap
    codes, ends = _levels(rows.load)
    there, each = np.unique(codes), (rows.slip, rows.observed, rows.base, after)
    chosen = np.unique(there[np.linspace(0, len(there) - 1, _CURVES).astype(int)])
    curves = tuple(
        _load_curve(tuple(ends[k].tolist()), *(x[codes == k] for x in each)) for k in chosen
    )
    missed = [(rows.observed - x) ** 2 for x in (rows.base, after)]
    inside = np.clip(rows.slip_fraction, -FULL_SLIDING, FULL_SLIDING)
    center, *squares = _means(_in_columns(rows, 1)[0], inside, *missed)
    return Comparison(rows.channel, rows.slip_name, named, curves, center, *map(np.sqrt, squares))


class LookCurve(NamedTuple):
    """The local change of the parameter of a :class:`Look` over its covariate, in the
    units of the look."""

    look: Look
    center: np.ndarray  # (k,) bins of the covariate
    change: np.ndarray  # (k,) estimates
    std: np.ndarray  # (k,) standard errors
    x: np.ndarray  # (p,) of the shape
    shape: np.ndarray  # (p,) fitted; scaled by the amplitude of a wave or end of a kink
    is_mirrored: bool  # changes in the direction of the slip
    is_folded: bool  # a wave, shown within one period
    at_settings: bool  # bins are settings


def shape_of(one: Pattern | Look, values, low: float, span: float) -> np.ndarray:
    """The shape of a pattern at values of its covariate, which begins at ``low`` in the
    data and has this ``span``: (n, 1); for a wave sine and cosine, (n, 2)."""
    off = np.asarray(values, float) - one.at
    if one.shape == "wave":
        angle = 2 * np.pi * (np.asarray(values, float) - low) / one.at
        return np.stack([np.sin(angle), np.cos(angle)], axis=1)
    if one.shape == "kink":
        return np.maximum(off, 0.0)[:, None] / span
    if one.shape == "threshold":
        return (off > 0)[:, None] - 0.5
    if one.width:
        return np.exp(-0.5 * (off[:, None] / one.width) ** 2)
    return 1.0 * np.isclose(values, one.at)[:, None]


def look_curve(chosen, base: Base, look: Look) -> LookCurve:
    """The shape that the remainder of a fit resembles, with the data."""
    values = quantities(base.rows, base.slip_fraction)[look.covariate]
    place = PLACE[PARAMETERS[look.parameter][0]]
    field = np.asarray(base.at_null.fields)[:, place].reshape(-1, base.rows.n)
    if look.parameter == "force":
        field = field * np.asarray(base.rows.inputs.fz)
    if is_mirrored(look.parameter, look.covariate):
        field = field * np.where(base.slip_fraction < 0, -1.0, 1.0)
    values, linear = np.asarray(values, float), linear_at(base, chosen)
    return curve_of(look, values, field, linear)


def curve_of(look: Look, values, field, linear: LinearFit) -> LookCurve:
    """The points are partial residuals (Larsen and McCleary, 1972, Technometrics
    14:781) of the shape, fitted together with the base's parameters.

    Args:
        values: the covariate (n,).
        field: whitened force of a unit change of the parameter, (channels, n).
        linear: the remainder of the fit, and the directions that it has absorbed.
    """
    low, span = float(values.min()), float(np.ptp(values))
    settings, is_folded = settings_of(look.covariate, values), look.shape == "wave"
    if settings is not None:
        values = settings.center[settings.code]
    shapes = shape_of(look, values, low, span)
    columns = (field[:, :, None] * shapes).reshape(-1, shapes.shape[1])
    lone = without(columns, linear.used_up)
    residual = without(linear.residual, linear.used_up)
    coefficient = np.linalg.lstsq(lone, residual, rcond=None)[0]
    left = (residual - lone @ coefficient).reshape(field.shape)
    information = np.sum(field**2, axis=0)
    estimate = information * (shapes @ coefficient) + np.sum(field * left, axis=0)

    place, begin = (np.mod(values - low, look.at), 0.0) if is_folded else (values, low)
    if settings is not None:
        codes, x = settings.code, settings.center
    else:
        codes = equally_known(place, information)
        x = np.linspace(begin, begin + (look.at if is_folded else span), _POINTS)
    total, *sums = (np.bincount(codes, x) for x in (information, information * place, estimate))
    there = total > 0
    center, change = (part[there] / total[there] for part in sums)
    curve = shape_of(look, x, begin, span) @ coefficient
    size = curve[-1] if look.shape == "kink" else coefficient[0]
    size = float(np.linalg.norm(coefficient)) if is_folded else float(size)
    return LookCurve(
        look._replace(size=size),
        center,
        change,
        1 / np.sqrt(total[there]),
        x,
        curve,
        is_mirrored(look.parameter, look.covariate),
        is_folded,
        settings is not None,
    )


def equally_known(place, information) -> np.ndarray:
    """Bins (n,) of the place, in each of which the parameter has the same accuracy."""
    count = max(min(len(place) // FEWEST_ROWS, _BINS), 1)
    order = np.argsort(place, kind="stable")
    known = np.cumsum(information[order])
    middle = (known - 0.5 * information[order]) / known[-1]
    codes = np.empty(len(place), int)
    codes[order] = np.minimum(count * middle, count - 1).astype(int)
    return codes
