"""Describe the file, and locate the gap in it: in regions of slip, load, speed, time and
direction, and in dependences of a tire parameter on these."""

from itertools import combinations

import numpy as np
from scipy.special import chdtrc

from tirefit.data.levels import levels
from tirefit.data.table import TireData
from tirefit.diagnosis.effects.motion import said_of_motion
from tirefit.diagnosis.engine.fit import Fit
from tirefit.diagnosis.negligible import NONZERO
from tirefit.diagnosis.rows.discrepancy import quantities
from tirefit.diagnosis.rows.prepared import Prepared
from tirefit.diagnosis.rows.rig import Rig
from tirefit.diagnosis.rows.subject import Base
from tirefit.diagnosis.summary.records import Cell, DataSummary, Region, Spot

LEVEL = 0.05
"""Rates of false discoveries (regions, spots, cells), false alarms, and confusions."""
_PARTS, _STRETCHES = 4, 32
"""Number of parts of a swept covariate for regions, and for spots; most spots."""
FEWEST_ROWS = 8
"""Smallest number of rows of a region, and of a bin on average; and number of neighbours
in slip whose misfits are summed: a smooth misfit adds up, noise does not."""
_DENSE = 4.0  # smallest ratio of the share of the gap to that of the rows for a spot
_TOGETHER = 0.9
"""Rank correlation above which two conditions are reported as related."""


# scipy.stats has both, and takes 0.4 s to import.
def adjusted(p_values: np.ndarray, dependent: bool = False) -> np.ndarray:
    """Adjust p-values for the rate of false discoveries by Benjamini and Hochberg, those of
    tests that depend on each other by Benjamini & Yekutieli (2001)."""
    falling = np.argsort(p_values)[::-1]
    rank = np.arange(len(falling), 0, -1)
    factor = len(rank) / rank * (np.sum(1 / rank) if dependent else 1.0)
    found = np.empty(len(rank))
    found[falling] = np.minimum.accumulate(p_values[falling] * factor).clip(max=1)
    return found


def rank_correlation(one: np.ndarray, other: np.ndarray) -> float:
    """Spearman's rank correlation of two arrays (n,), neither of them constant."""

    def ranks(values):
        _, place, count = np.unique(values, return_inverse=True, return_counts=True)
        return (np.cumsum(count) - (count - 1) / 2)[place]

    return float(np.corrcoef(ranks(one), ranks(other))[0, 1])


def data_summary(data: TireData, base: Base, rig: Rig) -> DataSummary:
    """The file of a diagnosis: the table as it was read, with the fit to its rows."""
    messages = base.simulator.doubt if base.simulator else ""
    doubts = (f"warning: {messages}",) if messages else ()
    return DataSummary(
        name=data.name,
        path=data.source.path,
        sha256=data.source.sha256,
        convention=data.source.convention,
        channels=base.prepared.channels,
        assumptions=(*doubts, *data.source.notes, *rig.notes, *rig.beside(data)),
        set_aside=data.first_masked(),
        motion=said_of_motion(base, rig),
        together=moving_together(base.prepared),
    )


def moving_together(rows: Prepared) -> tuple[str, ...]:
    """Sentences on pairs of conditions that are correlated."""
    values, messages = quantities(rows, np.zeros(rows.n)), []
    names = ("time", "fz", "v", "temperature", "gamma", "pressure")
    for one, other in combinations([c for c in names if c in values], 2):
        rank = rank_correlation(values[one], values[other])
        if abs(rank) > _TOGETHER:
            how = "rises" if rank > 0 else "falls"
            messages.append(
                f"{other} {how} with {one} in this file (rank correlation {rank:.2f}):"
                " an effect of the one may be reported as one of the other"
            )
    return tuple(messages)


def covariates_of(base: Base) -> dict[str, np.ndarray]:
    """Covariates that vary, and the slip fraction: (n,) each."""
    rows = base.prepared
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


def _chance(base: Base, residual, rows) -> float:
    """p-value of the whitened misfit of ``rows``: chi-squared of the sums over
    neighbours in slip. The residual has the rows' inflation in it already."""
    ordered = residual[rows[np.argsort(base.slip_fraction[rows], kind="stable")]]
    groups = np.array_split(ordered, max(len(rows) // FEWEST_ROWS, 1))
    return float(chdtrc(len(groups), sum(g.sum() ** 2 / len(g) for g in groups)))


def binned(values, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Bin (n,) of each value, edges (k + 1,) of at most ``count`` equally full bins."""
    edges = np.unique(np.quantile(values, np.linspace(0, 1, max(count, 1) + 1)))
    if len(edges) == 1:  # a single value would give a bin without width
        edges = edges[0] + np.array([-0.5, 0.5])
    return np.digitize(values, edges[1:-1]), edges


def _judged(base: Base, residual, gap, parts) -> list[Region]:
    """Regions of ``parts`` (name -> part of each row, lower and upper ends), with p-values
    by Benjamini and Yekutieli, as parts of several covariates share rows."""
    energy, found = gap**2 / max(float(np.sum(gap**2)), NONZERO), []
    for name, (code, *ends) in parts.items():
        for k, (low, high) in enumerate(zip(*ends, strict=True)):
            rows = np.flatnonzero(code == k)
            if len(rows) >= FEWEST_ROWS:
                p, share = _chance(base, residual, rows), float(energy[rows].sum())
                found.append(Region(name, float(low), float(high), share, p))
    if not found:
        return []
    chances = adjusted(np.array([one.p_value for one in found]), dependent=True)
    return [region._replace(p_value=float(p)) for region, p in zip(found, chances, strict=True)]


def _parts(values, count: int):
    """Part (n,) of each value, and both ends of the parts, of as many rows each."""
    code, edges = binned(values, min(len(values) // FEWEST_ROWS, count))
    return code, edges[:-1], edges[1:]


def regions(base: Base, residual, gap) -> list[Region]:
    """Settings, or quarters of swept covariates, with their shares of the energy of the
    located ``gap`` (n,) [N] and the corrected p-values of the whitened ``residual``
    (n,), inflation included; the largest significant share first."""
    parts = {}
    for name, values in covariates_of(base).items():
        at = levels(values)
        few = at.few()
        parts[name] = (at.code, at.low, at.high) if few else _parts(values, _PARTS)
    found = _judged(base, residual, gap, parts)
    return sorted(found, key=lambda r: (r.p_value > LEVEL, -r.share))


def spots(base: Base, residual, gap) -> tuple[Spot, ...]:
    """Short stretches of swept covariates with a share of the gap far above their share
    of the rows, the largest first; arguments as in :func:`regions`."""
    parts = {
        name: _parts(values, _STRETCHES)
        for name, values in covariates_of(base).items()
        # Pauses between sweeps separate the time; a setting has no stretches.
        if name == "time" or not levels(values).few()
    }
    rows = {k: float(np.bincount(c).max() / len(c)) for k, (c, *_) in parts.items()}
    dense = [
        Spot(name, low, high, rows[name], share, p)
        for name, low, high, share, p in _judged(base, residual, gap, parts)
        if p <= LEVEL and share >= _DENSE * rows[name]
    ]
    return tuple(sorted(dense, key=lambda spot: -spot.share)[:_PARTS])


def parameter_map(base: Base, fit: Fit) -> list[Cell]:
    """Every parameter with every covariate that varies, beside a fit, the strongest evidence
    first. A gap of one cause also appears in cells that resemble it."""
    shapes = base.discrepancy
    return [
        Cell(one.cell.quantity, one.cell.covariate, one.log_evidence, one.explains)
        for one in shapes.found(fit, 2 * len(shapes.cells))
        if not one.is_wave
    ]
