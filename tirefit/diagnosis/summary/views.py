"""What the figures of a diagnosis show, as arrays: which cells of the data miss, and
both fits over the slip."""

from typing import NamedTuple

import numpy as np
from scipy.special import stdtr
from scipy.stats import false_discovery_control

from tirefit.data.levels import cells, levels
from tirefit.diagnosis.negligible import NONZERO, ROUNDING
from tirefit.diagnosis.summary.where import LEVEL, covariates_of
from tirefit.slip import sigma_from_slip_ratio, slip_ratio_from_sigma

_BANDS = 5
"""Bands of a covariate that is swept."""
_BINS, _IN_A_BIN = (4, 14), 8
"""Bins of the slip, fewest and most, and rows of a bin of a map on average."""
_FINE, _TENTHS = 8, (0.1, 0.9)
"""Bins of a curve at least, and rows of one; quantiles that hold 80 % of its rows."""
_BETTER = 0.05
"""Share of its energy by which another map must show more than that over the load."""
_FEWEST = 4
"""Rows of a cell of the map: fewer say nothing of their own scatter."""
_FARTHEST = 4.0
"""Slip fractions beyond are shown there: the tire slides in full since one."""
_SHOWN_OVER = ("fz", "v", "time", "direction", "gamma")
"""Covariates that the map is drawn over, the usual one first."""
_POINTS, _CURVES, _STEPS = 300, 3, 60
"""Points and curves that a figure shows, and bins of a curve, at most."""


class ShownRows(NamedTuple):
    """The used rows of the first channel, (n,) each.

    ``slip`` is sigma_x, or alpha [rad] where ``slip_name`` says so; ``covariates`` are
    those that vary, loads first; ``base``, ``extended`` and ``gap`` [N] are both fits
    and the located gap.
    """

    channel: str
    slip_name: str
    slip: np.ndarray
    slip_fraction: np.ndarray
    load: np.ndarray
    covariates: dict[str, np.ndarray]
    observed: np.ndarray
    base: np.ndarray
    extended: np.ndarray
    gap: np.ndarray


class ResidualMap(NamedTuple):
    """Mean residual of the base fit in cells of slip fraction x another covariate.

    ``edges`` (k+1,) of the signed slip fraction; ``levels`` (m, 2) of the other one,
    from and to; ``mean`` (m, k) in % of F_z, NaN for empty cells; ``beyond`` (m, k):
    that cell's mean is not noise, at 5 % false discoveries (Benjamini-Hochberg);
    ``energy`` (m, k): the share of the located gap's energy that lies there, 0 where
    no gap can be resolved.
    """

    channel: str
    covariate: str
    levels: np.ndarray
    edges: np.ndarray
    mean: np.ndarray
    beyond: np.ndarray
    energy: np.ndarray


class LoadCurve(NamedTuple):
    """One level of load [N], from and to: measured points, and both fits as means over
    bins of slip.

    ``slip``, ``force`` (n,); ``center``, ``base``, ``extended`` (k,); ``low`` and
    ``high`` (k,): where the extended force lies for 80 % of the rows of a bin, as it
    depends on more than slip and load.
    """

    load: tuple[float, float]
    slip: np.ndarray
    force: np.ndarray
    center: np.ndarray
    base: np.ndarray
    extended: np.ndarray
    low: np.ndarray
    high: np.ndarray


class Comparison(NamedTuple):
    """Before and after: curves by load; rms residuals [N] in bins of slip fraction.

    The residuals hold the noise, of force and of slip, beside the gap. ``named`` says
    whether ``after`` is the extension, or the base fit and the located gap.
    """

    channel: str
    slip_name: str
    named: bool
    curves: tuple[LoadCurve, ...]
    center: np.ndarray
    before: np.ndarray
    after: np.ndarray


def shown_rows(base, parts) -> ShownRows:
    """The rows of a base fit.

    Args:
        parts: ``base``, ``extended`` and ``gap`` (n,) of the first channel.
    """
    prepared = base.prepared
    channel, inputs = prepared.channels[0], prepared.inputs
    varying = covariates_of(base)
    covariates = {name: varying[name] for name in _SHOWN_OVER if name in varying}
    lateral = prepared.mode == "y"
    return ShownRows(
        channel, "alpha" if lateral else "sigma_x",
        np.arctan(prepared.slip) if lateral else prepared.slip, base.slip_fraction,
        np.asarray(inputs.fz, float), covariates, prepared.observed[channel],
        parts["base"], parts["extended"], parts["gap"],
    )  # fmt: skip


def _levels(values) -> tuple[np.ndarray, np.ndarray]:
    """Codes (n,) of the levels of a covariate, and the levels (m, 2), from and to."""
    settings = levels(values)
    if settings.few():
        return settings.code, np.stack([settings.center, settings.center], axis=1)
    cuts = np.unique(np.quantile(values, np.linspace(0, 1, _BANDS + 1)))
    codes = np.clip(np.searchsorted(cuts, values, "right") - 1, 0, len(cuts) - 2)
    return codes, np.stack([cuts[:-1], cuts[1:]], axis=1)


def _energy_seen(codes, size: int, values) -> float:
    """Energy of the cells' means beyond that of their noise."""
    count, mean, std = cells(codes, size, values)
    there = count >= _FEWEST
    return float(np.sum((count * mean**2 - std**2)[there]))


def _wide(edges) -> np.ndarray:
    # One value alone would be a map of no width.
    return edges if len(edges) > 1 else edges[0] + np.array([-0.5, 0.5])


def _slip_edges(fraction, rows: int) -> np.ndarray:
    # An odd number leaves zero slip, where noise flips the sign, within one cell.
    steps = int(np.clip(len(fraction) // (_IN_A_BIN * rows), *_BINS)) | 1
    inside = np.clip(fraction, -_FARTHEST, _FARTHEST)
    return _wide(np.unique(np.quantile(inside, np.linspace(0, 1, steps + 1))))


class _Grid(NamedTuple):
    """Cells of slip fraction x a covariate: the ``cell`` (n,) of each row."""

    covariate: str
    levels: np.ndarray
    edges: np.ndarray
    cell: np.ndarray

    @property
    def shape(self) -> tuple[int, int]:
        return len(self.levels), len(self.edges) - 1

    @property
    def size(self) -> int:
        return self.shape[0] * self.shape[1]


def _grid(rows: ShownRows, covariate: str, values) -> _Grid:
    codes, levels = _levels(values)
    edges = _slip_edges(rows.slip_fraction, len(levels))
    inside = np.clip(rows.slip_fraction, edges[0], edges[-1])
    columns = len(edges) - 1
    column = np.clip(np.searchsorted(edges, inside, "right") - 1, 0, columns - 1)
    return _Grid(covariate, levels, edges, codes * columns + column)


def residual_map(rows: ShownRows, inflation: float, resolvable: bool) -> ResidualMap:
    """The map over slip fraction and the covariate along which most of the gap shows.

    Loads are preferred where no other covariate shows 5 % more.

    Args:
        inflation: rows per independent row.
        resolvable: whether there is a gap to share out.
    """
    residual = 100 * (rows.observed - rows.base) / rows.load
    most, grid = -np.inf, None
    for covariate, values in (rows.covariates or {"fz": rows.load}).items():
        option = _grid(rows, covariate, values)
        seen = _energy_seen(option.cell, option.size, residual)
        if grid is None or seen > most + _BETTER * abs(most):
            most, grid = seen, option
    assert grid is not None  # there is a covariate, or else the load
    count, mean, std = cells(grid.cell, grid.size, residual)
    there = count >= _FEWEST
    square = np.bincount(grid.cell, rows.gap**2, grid.size)
    energy = square * resolvable / max(float(square.sum()), NONZERO)
    return ResidualMap(
        rows.channel, grid.covariate, grid.levels, grid.edges,
        np.where(there, mean, np.nan).reshape(grid.shape),
        _beyond(count, mean, std, there, inflation).reshape(grid.shape),
        energy.reshape(grid.shape),
    )  # fmt: skip


def _beyond(count, mean, std, there, inflation: float) -> np.ndarray:
    """Cells (size,) whose mean is not noise."""
    independent = np.maximum(count / inflation, 1.0)
    t = mean * np.sqrt(independent) / np.maximum(std, ROUNDING)
    p = 2 * stdtr(np.maximum(independent - 1, 1.0), -np.abs(t))
    beyond = np.zeros(len(mean), bool)
    if there.any():
        beyond[there] = false_discovery_control(p[there]) < LEVEL
    return beyond


def _binned(x, edges, *columns):
    """(bin of each row, bins with any rows, their means of x and of the columns)."""
    codes = np.clip(np.searchsorted(edges, x, "right") - 1, 0, len(edges) - 2)
    count = np.bincount(codes, minlength=len(edges) - 1)
    there = count > 0
    sums = (np.bincount(codes, c, len(edges) - 1)[there] for c in (x, *columns))
    center, *means = (total / count[there] for total in sums)
    return codes, there, center, means


def _load_curve(load, slip, force, base, extended) -> LoadCurve:
    # A wheel that nearly locks has slips without bound: bins are those of its ratio.
    unbounded = np.max(np.abs(slip), initial=0.0) > 1.0
    place = slip_ratio_from_sigma(slip) if unbounded else slip
    steps = int(np.clip(len(slip) // _FINE, _FINE, _STEPS))
    edges = _wide(np.unique(np.quantile(place, np.linspace(0, 1, steps + 1))))
    codes, there, center, (before, after) = _binned(place, edges, base, extended)
    # Within a bin the force rises with slip: only what the extension adds is spread.
    change = extended - base
    low, high = np.array(
        [np.quantile(change[codes == k], _TENTHS) for k in np.flatnonzero(there)]
    ).T
    points = np.unique(np.linspace(0, len(slip) - 1, _POINTS).astype(int))
    return LoadCurve(
        load, slip[points], force[points],
        sigma_from_slip_ratio(center) if unbounded else center, before, after,
        before + low, before + high,
    )  # fmt: skip


def compared(rows: ShownRows, named: bool) -> Comparison:
    """Both fits over the data at up to three loads, and their residuals over slip.

    Where nothing is named, the located gap stands in for the extension: it says what
    is missing, not why.
    """
    after = rows.extended if named else rows.base + rows.gap
    codes, levels = _levels(rows.load)
    there = np.flatnonzero(np.bincount(codes))
    chosen = np.unique(there[np.linspace(0, len(there) - 1, _CURVES).astype(int)])
    curves = tuple(
        _load_curve(
            tuple(levels[k].tolist()),
            *(x[codes == k] for x in (rows.slip, rows.observed, rows.base, after)),
        )
        for k in chosen
    )
    fraction = np.clip(rows.slip_fraction, -_FARTHEST, _FARTHEST)
    *_, center, (before, rest) = _binned(
        fraction, _slip_edges(fraction, 1), (rows.observed - rows.base) ** 2,
        (rows.observed - after) ** 2,
    )  # fmt: skip
    return Comparison(
        rows.channel, rows.slip_name, named, curves, center, np.sqrt(before),
        np.sqrt(rest),
    )  # fmt: skip
