"""Describe the file, locate the gap in regions of slip, load, speed, time and direction, and
both fits over the slip as arrays, and the shape of the remainder."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc

from tirefit.data.rig.levels import levels
from tirefit.data.table import TireData
from tirefit.diagnosis.effects.vehicle import notes_on_motion
from tirefit.diagnosis.engine import NONZERO
from tirefit.diagnosis.engine.decide import POLICY
from tirefit.diagnosis.engine.discrepancy import Component
from tirefit.diagnosis.rows.discrepancy import FULL_SLIDING, PARAMETERS
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


class Shape(NamedTuple):
    """A quantity as a function of a covariate that fits the remainder."""

    parameter: str
    covariate: str
    at: float  # covariate of the largest change
    size: float  # largest change: relative (stiffness, friction), a slip, force over load
    probability: float  # among all such functions
    explains: float  # share of the mean square of the remainder


SIGNIFICANT = 0.05  # rate of false discoveries among regions

_FEWEST_ROWS = 8
"""Smallest number of rows of a region, and of a bin on average; and number of neighbours
in slip whose misfits are summed: a smooth misfit adds up, noise does not."""


# scipy.stats has it, and takes 0.4 s to import.
def adjusted(p_values: np.ndarray) -> np.ndarray:
    """Adjust p-values for the rate of false discoveries among tests that depend on each other,
    by Benjamini & Yekutieli (2001)."""
    falling = np.argsort(p_values)[::-1]
    rank = np.arange(len(falling), 0, -1)
    least = np.empty(len(rank))
    each = p_values[falling] * len(rank) / rank * np.sum(1 / rank)
    least[falling] = np.minimum.accumulate(each).clip(max=1)
    return least


def data_summary(data: TireData, base: Base, rig: Rig) -> DataSummary:
    """The file of a diagnosis: the table as it was read, with the fit to its rows."""
    warning = base.simulator.remark_on_signs if base.simulator else ""
    warnings = (f"warning: {warning}",) if warning else ()
    return DataSummary(
        name=data.name,
        path=data.source.path,
        sha256=data.source.sha256,
        convention=data.source.convention,
        channels=base.rows.channels,
        assumptions=(*warnings, *data.source.notes, *rig.beside(data)),
        set_aside=data.first_masked(),
        motion=notes_on_motion(base.rows, rig),
    )


def _binned(values: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Bin (n,) of each value, edges (k + 1,) of at most ``count`` equally full bins."""
    edges = np.unique(np.quantile(values, np.linspace(0, 1, max(count, 1) + 1)))
    if len(edges) == 1:  # a single value would give a bin without width
        edges = edges[0] + np.array([-0.5, 0.5])
    return np.digitize(values, edges[1:-1]), edges


def _levels(values: np.ndarray, bands: int) -> tuple[np.ndarray, np.ndarray]:
    """Level (n,) of each value, and the levels (m, 2), from and to: its settings, or ``bands`` of
    a swept covariate."""
    settings = levels(values)
    if settings.few():
        return settings.code, np.stack([settings.low, settings.high], axis=1)
    codes, edges = _binned(values, bands)
    return codes, np.stack([edges[:-1], edges[1:]], axis=1)


def regions(base: Base, residual: np.ndarray, gap: np.ndarray) -> list[Region]:
    """Settings, or quarters of swept covariates, with their shares of the energy of the
    located ``gap`` (n,) [N] and the corrected p-values of the whitened ``residual``
    (n,), inflation included; the largest significant share first. P-values are by Benjamini
    and Yekutieli, as parts of several covariates share rows."""
    rows = base.rows
    values = {
        "fz": ("loads", rows.inputs.fz),
        "v": ("speeds", rows.inputs.v),
        "time": ("time", rows.time),
        "direction": ("sweeps", np.sign(rows.covariates.turning)),
        "sign": ("signs", np.where(rows.slip < 0, -1.0, 1.0)),
    }
    covariates = {"slip_fraction": np.abs(base.slip_fraction)}
    covariates |= {name: value for name, (need, value) in values.items() if need in rows.has}
    covariates |= {name: rows.column(name) for name in ("temperature", "gamma") if name in rows.has}
    energy, parts = gap**2 / max(float(np.sum(gap**2)), NONZERO), []
    for name, values_of in covariates.items():
        code, ends = _levels(values_of, min(len(values_of) // _FEWEST_ROWS, 4))
        for k, (low, high) in enumerate(ends.tolist()):
            inside = np.flatnonzero(code == k)
            if len(inside) < _FEWEST_ROWS:
                continue
            # Chi-squared of the sums over neighbours in slip; the residual has the rows'
            # inflation in it.
            ordered = residual[inside[np.argsort(base.slip_fraction[inside], kind="stable")]]
            groups = np.array_split(ordered, max(len(inside) // _FEWEST_ROWS, 1))
            p = float(chdtrc(len(groups), sum(g.sum() ** 2 / len(g) for g in groups)))
            parts.append(Region(name, low, high, float(energy[inside].sum()), p))
    chances = adjusted(np.array([part.p_value for part in parts])).tolist()
    parts = [part._replace(p_value=p) for part, p in zip(parts, chances, strict=True)]
    return sorted(parts, key=lambda r: (r.p_value > SIGNIFICANT, -r.share))


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


def _means(codes: np.ndarray, *columns: np.ndarray) -> list[np.ndarray]:
    """Mean of each column in every bin that has rows."""
    count = np.bincount(codes)
    filled = count > 0
    return [np.bincount(codes, c)[filled] / count[filled] for c in columns]


def compared(base: Base, parts: Mapping[str, np.ndarray], named: bool) -> Comparison:
    """Both fits and the data of the first channel at up to three loads, and their residuals over
    slip. If no effect is named, the base with the located gap replaces the extension.

    Args:
        parts: ``base``, ``extended`` and ``gap`` (n,) of that channel [N].
    """
    rows, before, gap = base.rows, parts["base"], parts["gap"]
    after, lateral = parts["extended"] if named else before + gap, rows.mode == "y"
    channel, slips = rows.channels[0], np.arctan(rows.slip) if lateral else rows.slip
    observed, load = rows.observed[channel], np.asarray(rows.inputs.fz, float)
    level, ends = _levels(load, 5)
    filled, curves = np.unique(level), []
    for k in np.unique(filled[np.linspace(0, len(filled) - 1, 3).astype(int)]):
        slip, force, first, last = (x[level == k] for x in (slips, observed, before, after))
        codes, _ = _binned(slip, min(len(slip) // _FEWEST_ROWS, 60))
        bins = [codes == code for code in np.unique(codes)]
        # The slip of a nearly locked wheel is unbounded, so do not average it.
        center = np.array([np.median(slip[inside]) for inside in bins])
        means = _means(codes, first, last)
        # The force rises with slip within a bin: spread only the part of the extension.
        spread = np.array([np.quantile((last - first)[inside], (0.1, 0.9)) for inside in bins])
        some = np.unique(np.linspace(0, len(slip) - 1, 300).astype(int))  # points of a figure
        shown = slip[some], force[some], center, *means, *(means[0] + spread.T)
        curves.append(LoadCurve(tuple(ends[k].tolist()), *shown))
    within = np.clip(base.slip_fraction, -FULL_SLIDING, FULL_SLIDING)
    # With an odd number, zero slip, where noise changes the sign, is within one bin.
    codes, _ = _binned(within, min(len(within) // _FEWEST_ROWS, 13) | 1)
    center, *squares = _means(codes, within, (observed - before) ** 2, (observed - after) ** 2)
    slip_name = "alpha" if lateral else "sigma_x"
    return Comparison(channel, slip_name, named, tuple(curves), center, *map(np.sqrt, squares))


def shapes_of(case: Case) -> tuple[Shape, ...]:
    """The functions that the remainder of the verdict resembles, of a probability above .05, the
    likeliest first; empty if an unlisted effect is unlikely."""
    if case.verdict.unlisted <= POLICY.likely:
        return ()
    likeliest = case.base.discrepancy.components(case.chosen)
    return tuple(_shape(function) for function in likeliest if function.probability > 0.05)


def _shape(function: Component) -> Shape:
    """A function of the remainder, in the units of its quantity."""
    cell = function.cell
    change = PARAMETERS[cell.quantity][1] * function.value
    largest = int(np.argmax(np.abs(change)))
    sizes = float(change[largest]), function.probability, function.explains
    return Shape(cell.quantity, cell.covariate, float(cell.places[largest]), *sizes)
