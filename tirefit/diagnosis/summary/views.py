"""Describe the file, locate the gap in regions of slip, load, speed, time and direction, and
contents of the figures as arrays: the residual in cells of the data, both fits over the
slip, and the shape of the remainder."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.special import chdtrc, stdtr

from tirefit.data.rig.levels import cells, levels
from tirefit.data.table import TireData
from tirefit.diagnosis.effects.vehicle import said_of_motion
from tirefit.diagnosis.engine import NONZERO, ROUNDING
from tirefit.diagnosis.engine.decide import POLICY
from tirefit.diagnosis.engine.discrepancy import Found
from tirefit.diagnosis.rows.discrepancy import FULL_SLIDING, PARAMETERS, is_mirrored
from tirefit.diagnosis.rows.rig import Rig
from tirefit.diagnosis.rows.subject import Base
from tirefit.diagnosis.summary.case import Case


@dataclass(frozen=True, kw_only=True)
class DataSummary:
    """The file, and how it was read."""

    name: str
    path: str
    sha256: str
    convention: str
    channels: tuple[str, ...]
    assumptions: tuple[str, ...]
    set_aside: tuple[str, ...] = ()  # the first excluded rows with reasons, and a count
    motion: tuple[str, ...] = ()  # notes on a force derived from it


class Region(NamedTuple):
    """One bin of one covariate."""

    covariate: str
    low: float
    high: float
    share: float  # of the gap's energy
    p_value: float  # of its misfit, Benjamini-Yekutieli


class Look(NamedTuple):
    """A quantity as a function of a covariate that fits the remainder."""

    parameter: str
    covariate: str
    is_wave: bool
    at: float  # covariate of the largest change; period of a wave
    size: float  # largest change: relative (stiffness, friction), a slip, force over load
    probability: float  # among all such functions
    explains: float  # share of the mean square of the remainder


LEVEL = 0.05
"""Rates of false discoveries (regions, cells), false alarms, and confusions."""
_PARTS = 4  # number of parts of a swept covariate
FEWEST_ROWS = 8
"""Smallest number of rows of a region, and of a bin on average; and number of neighbours
in slip whose misfits are summed: a smooth misfit adds up, noise does not."""


# scipy.stats has it, and takes 0.4 s to import.
def adjusted(p_values: np.ndarray, dependent: bool = False) -> np.ndarray:
    """Adjust p-values for the rate of false discoveries by Benjamini and Hochberg, those of
    tests that depend on each other by Benjamini & Yekutieli (2001)."""
    falling = np.argsort(p_values)[::-1]
    rank = np.arange(len(falling), 0, -1)
    factor = len(rank) / rank * (np.sum(1 / rank) if dependent else 1.0)
    found = np.empty(len(rank))
    found[falling] = np.minimum.accumulate(p_values[falling] * factor).clip(max=1)
    return found


def data_summary(data: TireData, base: Base, rig: Rig) -> DataSummary:
    """The file of a diagnosis: the table as it was read, with the fit to its rows."""
    doubt = base.simulator.wrong_signs if base.simulator else ""
    doubts = (f"warning: {doubt}",) if doubt else ()
    return DataSummary(
        name=data.name,
        path=data.source.path,
        sha256=data.source.sha256,
        convention=data.source.convention,
        channels=base.rows.channels,
        assumptions=(*doubts, *data.source.notes, *rig.beside(data)),
        set_aside=data.first_masked(),
        motion=said_of_motion(base.rows, rig, base.forces(base.as_given, base.amplitudes())),
    )


def covariates_of(base: Base) -> dict[str, np.ndarray]:
    """Covariates that vary, and the slip fraction: (n,) each."""
    rows = base.rows
    values = {
        "fz": ("loads", rows.inputs.fz),
        "v": ("speeds", rows.inputs.v),
        "time": ("time", rows.time),
        "direction": ("sweeps", np.sign(rows.covariates.turning)),
        "sign": ("signs", np.where(rows.slip < 0, -1.0, 1.0)),
    }
    found = {"slip_fraction": np.abs(base.slip_fraction)}
    found |= {name: value for name, (need, value) in values.items() if need in rows.has}
    others = ("temperature", "gamma")
    return found | {name: rows.column(name) for name in others if name in rows.has}


def binned(values: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Bin (n,) of each value, edges (k + 1,) of at most ``count`` equally full bins."""
    edges = np.unique(np.quantile(values, np.linspace(0, 1, max(count, 1) + 1)))
    if len(edges) == 1:  # a single value would give a bin without width
        edges = edges[0] + np.array([-0.5, 0.5])
    return np.digitize(values, edges[1:-1]), edges


def regions(base: Base, residual: np.ndarray, gap: np.ndarray) -> list[Region]:
    """Settings, or quarters of swept covariates, with their shares of the energy of the
    located ``gap`` (n,) [N] and the corrected p-values of the whitened ``residual``
    (n,), inflation included; the largest significant share first. P-values are by Benjamini
    and Yekutieli, as parts of several covariates share rows."""
    energy, found = gap**2 / max(float(np.sum(gap**2)), NONZERO), []
    for name, values in covariates_of(base).items():
        at = levels(values)
        code, lows, highs = at.code, at.low, at.high
        if not at.few():
            code, edges = binned(values, min(len(values) // FEWEST_ROWS, _PARTS))
            lows, highs = edges[:-1], edges[1:]
        for k, (low, high) in enumerate(zip(lows, highs, strict=True)):
            rows = np.flatnonzero(code == k)
            if len(rows) < FEWEST_ROWS:
                continue
            # Chi-squared of the sums over neighbours in slip; the residual has the rows'
            # inflation in it.
            ordered = residual[rows[np.argsort(base.slip_fraction[rows], kind="stable")]]
            groups = np.array_split(ordered, max(len(rows) // FEWEST_ROWS, 1))
            p = float(chdtrc(len(groups), sum(g.sum() ** 2 / len(g) for g in groups)))
            share = float(energy[rows].sum())
            found.append(Region(name, float(low), float(high), share, p))
    if not found:
        return []
    chances = adjusted(np.array([one.p_value for one in found]), dependent=True)
    found = [one._replace(p_value=float(p)) for one, p in zip(found, chances, strict=True)]
    return sorted(found, key=lambda r: (r.p_value > LEVEL, -r.share))


_BANDS, _BINS, _STEPS = 5, 13, 60
"""Largest numbers of bands of a swept covariate, bins of a map, and bins of a curve."""

_FEWEST = 4  # smallest number of rows of a cell for its scatter to be known
_TENTHS = (0.1, 0.9)  # quantiles that hold 80 % of the rows of a bin
_BETTER = 0.05  # another map replaces that over the load if it shows more energy by this share
_SHOWN = 0.05  # smallest probability of a function of the remainder that is reported
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

    @property
    def within(self) -> np.ndarray:
        """The slip fraction, at most that of full sliding."""
        return np.clip(self.slip_fraction, -FULL_SLIDING, FULL_SLIDING)

    def bins(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """:func:`binned` of the slip fraction, for maps of ``count`` levels."""
        columns = min(len(self.slip) // (FEWEST_ROWS * count), _BINS)
        # With an odd number, zero slip, where noise changes the sign, is within one cell.
        return binned(self.within, columns | 1)


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


def shown_rows(base: Base, parts: Mapping[str, np.ndarray]) -> ShownRows:
    """The rows of a base fit; ``parts`` are ``base``, ``extended`` and ``gap`` (n,) of
    the first channel."""
    rows, varying = base.rows, covariates_of(base)
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


def _means(codes: np.ndarray, *columns: np.ndarray) -> list[np.ndarray]:
    """Mean of each column in every bin that has rows."""
    count = np.bincount(codes)
    there = count > 0
    return [np.bincount(codes, c)[there] / count[there] for c in columns]


def _levels(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Level (n,) of each value, and the levels (m, 2), from and to."""
    settings = levels(values)
    if settings.few():
        return settings.code, np.stack([settings.center, settings.center], axis=1)
    codes, edges = binned(values, _BANDS)
    return codes, np.stack([edges[:-1], edges[1:]], axis=1)


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
        column, edges = rows.bins(len(ends))
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


def compared(rows: ShownRows, named: bool) -> Comparison:
    """Both fits and the data at up to three loads, and their residuals over slip. If no
    effect is named, the base with the located gap replaces the extension."""
    after = rows.extended if named else rows.base + rows.gap
    level, ends = _levels(rows.load)
    there, curves = np.unique(level), []
    for k in np.unique(there[np.linspace(0, len(there) - 1, _CURVES).astype(int)]):
        each = (x[level == k] for x in (rows.slip, rows.observed, rows.base, after))
        slip, force, base, extended = each
        codes, _ = binned(slip, min(len(slip) // FEWEST_ROWS, _STEPS))
        bins = [codes == code for code in np.unique(codes)]
        # The slip of a nearly locked wheel is unbounded, so do not average it.
        center = np.array([np.median(slip[own]) for own in bins])
        means = _means(codes, base, extended)
        # The force rises with slip within a bin: spread only the part of the extension.
        spread = np.array([np.quantile((extended - base)[own], _TENTHS) for own in bins])
        some = np.unique(np.linspace(0, len(slip) - 1, _POINTS).astype(int))
        shown = slip[some], force[some], center, *means, *(means[0] + spread.T)
        curves.append(LoadCurve(tuple(ends[k].tolist()), *shown))
    missed = [(rows.observed - x) ** 2 for x in (rows.base, after)]
    center, *squares = _means(rows.bins(1)[0], rows.within, *missed)
    return Comparison(
        rows.channel, rows.slip_name, named, tuple(curves), center, *map(np.sqrt, squares)
    )


class LookCurve(NamedTuple):
    """The change of the parameter of a :class:`Look` over its covariate, or over the period
    of a wave, in the units of the look."""

    look: Look
    x: np.ndarray  # (k,) of the covariate
    change: np.ndarray  # (k,) estimates
    std: np.ndarray  # (k,) standard errors
    is_mirrored: bool  # changes in the direction of the slip
    at_settings: bool  # x are its only values


def look_curves(case: Case) -> tuple[LookCurve, ...]:
    """The functions that the remainder of the verdict resembles, the likeliest first; empty
    if an unlisted effect is unlikely."""
    if case.verdict.unlisted <= POLICY.likely:
        return ()
    found = case.base.discrepancy.found(case.chosen)
    return tuple(_look_curve(one) for one in found if one.probability > _SHOWN)


def _look_curve(found: Found) -> LookCurve:
    cell, usual = found.cell, PARAMETERS[found.cell.quantity][1]
    change = usual * found.value
    largest = int(np.argmax(np.abs(change)))
    at = float(cell.places[-1 if found.is_wave else largest])
    sizes = float(change[largest]), found.probability, found.explains
    look = Look(cell.quantity, cell.covariate, found.is_wave, at, *sizes)
    mirrored = not found.is_wave and is_mirrored(cell.quantity, cell.covariate)
    return LookCurve(look, cell.places, change, usual * found.std, mirrored, cell.settings)
