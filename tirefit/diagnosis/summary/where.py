"""Describe the file, and locate the gap in it: in regions of slip, load, speed, time and
direction."""

import numpy as np
from scipy.special import chdtrc

from tirefit.data.levels import levels
from tirefit.data.table import TireData
from tirefit.diagnosis.effects.motion import said_of_motion
from tirefit.diagnosis.negligible import NONZERO
from tirefit.diagnosis.rows.rig import Rig
from tirefit.diagnosis.rows.subject import Base
from tirefit.diagnosis.summary.records import DataSummary, Region

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
    messages = base.simulator.doubt if base.simulator else ""
    doubts = (f"warning: {messages}",) if messages else ()
    return DataSummary(
        name=data.name,
        path=data.source.path,
        sha256=data.source.sha256,
        convention=data.source.convention,
        channels=base.rows.channels,
        assumptions=(*doubts, *data.source.notes, *rig.notes, *rig.beside(data)),
        set_aside=data.first_masked(),
        motion=said_of_motion(base, rig),
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


def regions(base: Base, residual, gap) -> list[Region]:
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
            if len(rows) >= FEWEST_ROWS:
                p, share = _chance(base, residual, rows), float(energy[rows].sum())
                found.append(Region(name, float(low), float(high), share, p))
    if not found:
        return []
    chances = adjusted(np.array([one.p_value for one in found]), dependent=True)
    found = [one._replace(p_value=float(p)) for one, p in zip(found, chances, strict=True)]
    return sorted(found, key=lambda r: (r.p_value > LEVEL, -r.share))
