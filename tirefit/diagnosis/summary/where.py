"""Where the gap lies: regions of slip, load, speed, time and direction, and which
parameter of the tire would have to vary with which of them."""

import numpy as np
from scipy.special import chdtrc
from scipy.stats import false_discovery_control

from tirefit.data.levels import levels
from tirefit.diagnosis.evidence.base import Base
from tirefit.diagnosis.evidence.forms import PLACE
from tirefit.diagnosis.negligible import NONZERO
from tirefit.diagnosis.rows.basis import (
    FULL_SLIDING,
    functions_of,
    mean_gain,
    orthogonal,
)
from tirefit.diagnosis.rows.patterns import PARAMETERS, USUAL_SIZES
from tirefit.diagnosis.summary.records import Cell, Region, Spot

LEVEL = 0.05
"""False discoveries among the regions, or the cells of a map, that are said to hold
more than noise."""

_PARTS = 4
"""Parts of a covariate that is swept, at most: of as many rows each."""

_NEIGHBOURS = 8
"""Rows of a run whose misses are added up: a smooth miss adds up, noise does not."""

_STRETCHES = (8, 16, 32, 64)
"""Parts of the rows that a spot is looked for among, each overlapping the next by half;
quarters are regions."""

_DENSE = 4.0
"""Share of the gap over that of the rows from which a stretch is a spot."""

_MOST_SPOTS = 4

_EDGE = 1e-6
"""Width of the ends of a setting over its value: those are rounded values."""

_FUNCTIONS = 6
"""Smooth functions of a covariate that a parameter may follow."""


def _bins(values) -> list[tuple[float, float, np.ndarray]]:
    """Settings, or parts of what is swept: (low, high, rows (n,) bool), each
    row in one."""
    settings = levels(values)
    if settings.few():
        ends = zip(settings.low.tolist(), settings.high.tolist(), strict=True)
        return [(*end, _between(values, *end)) for end in ends]
    parts = int(np.clip(len(values) // _NEIGHBOURS, 1, _PARTS))
    cuts = np.unique(np.quantile(values, np.linspace(0, 1, parts + 1)))
    part = np.digitize(values, cuts[1:-1])
    ends = zip(cuts[:-1].tolist(), cuts[1:].tolist(), strict=True)
    return [(*end, part == k) for k, end in enumerate(ends)]


def _between(values, low: float, high: float) -> np.ndarray:
    width = _EDGE * max(abs(high), 1.0)
    return (values >= low - width) & (values <= high + width)


def covariates_of(base: Base) -> dict[str, np.ndarray]:
    """Covariates that vary, and the slip fraction: (n,) each."""
    prepared = base.prepared
    rows = prepared.covariates
    values = {"slip_fraction": np.abs(base.slip_fraction)}
    if "loads" in prepared.has:
        values["fz"] = prepared.inputs.fz
    if "speeds" in prepared.has:
        values["v"] = prepared.inputs.v
    if "time" in prepared.has:
        values["time"] = prepared.time
    if "sweeps" in prepared.has:
        values["direction"] = np.sign(rows.turning)
    if "signs" in prepared.has:
        # A slip of zero itself is no third side.
        values["sign"] = np.where(prepared.slip < 0, -1.0, 1.0)
    for name in ("temperature", "gamma"):
        if name in prepared.has:
            values[name] = prepared.column(name)
    return values


def _chances(residual, slip_fraction) -> np.ndarray:
    """p-value of each set of whitened misses: of neighbours over the slip, added up.

    Args:
        residual, slip_fraction: (sets, k).
    """
    order = np.argsort(slip_fraction, axis=1, kind="stable")
    part = np.take_along_axis(residual, order, axis=1)
    groups = np.array_split(
        np.arange(part.shape[1]), max(part.shape[1] // _NEIGHBOURS, 1)
    )
    begins, sizes = [g[0] for g in groups], np.array([len(g) for g in groups])
    sums = np.add.reduceat(part, begins, axis=1)
    # The rows' inflation is in the residual already; sums bring it back.
    return chdtrc(len(groups), np.sum(sums**2 / sizes, axis=1))


def regions(base: Base, residual, gap) -> list[Region]:
    """Every region with its share and corrected p-value, largest evidence first.

    Args:
        residual: (n,) whitened residual of the base fit, inflation included.
        gap: (n,) located gap [N].
    """
    energy = gap**2
    total = max(float(energy.sum()), NONZERO)
    bins, raw = [], []
    for name, values in covariates_of(base).items():
        for low, high, inside in _bins(values):
            if inside.sum() < _NEIGHBOURS:
                continue
            own = residual[None, inside], base.slip_fraction[None, inside]
            raw.append(float(_chances(*own)[0]))
            share = float(energy[inside].sum()) / total
            bins.append(Region(name, low, high, share, 1.0))
    if not bins:
        return []
    # By Benjamini and Yekutieli: the bins of several covariates share their rows.
    corrected = false_discovery_control(raw, method="by").tolist()
    judged = [r._replace(p_value=p) for r, p in zip(bins, corrected, strict=True)]
    return sorted(judged, key=lambda region: (region.p_value > LEVEL, -region.share))


def spots(base: Base, residual, gap) -> tuple[Spot, ...]:
    """Short stretches of what was swept that hold far more of the gap than their share
    of the rows, the densest first, none within another; see :func:`regions`."""
    energy = gap**2
    total, n = max(float(energy.sum()), NONZERO), len(gap)
    stretches: list[Spot] = []
    for name, values in covariates_of(base).items():
        # Pauses between sweeps part the time; a setting has no stretches.
        if name != "time" and levels(values).few():
            continue
        order = np.argsort(values, kind="stable")
        for count in _STRETCHES:
            width = n // count
            if width < _NEIGHBOURS:
                break
            starts = np.arange(0, n - width + 1, width // 2)
            rows = order[starts[:, None] + np.arange(width)]
            each = (
                values[rows[:, 0]], values[rows[:, -1]], np.full(len(rows), width / n),
                energy[rows].sum(axis=1) / total,
                _chances(residual[rows], base.slip_fraction[rows]),
            )  # fmt: skip
            parts = (part.astype(float).tolist() for part in each)
            stretches += [Spot(name, *one) for one in zip(*parts, strict=True)]
    if not stretches:
        return ()
    corrected = false_discovery_control([s.p_value for s in stretches], method="by")
    dense = [
        spot._replace(p_value=float(p))
        for spot, p in zip(stretches, corrected, strict=True)
        if p <= LEVEL and spot.share >= _DENSE * spot.rows
    ]
    dense.sort(key=lambda spot: -spot.share / spot.rows)
    chosen: list[Spot] = []
    for spot in dense:
        if not any(_overlap(spot, other) for other in chosen):
            chosen.append(spot)
    return tuple(chosen[:_MOST_SPOTS])


def _overlap(one: Spot, other: Spot) -> bool:
    if one.covariate != other.covariate:
        return False
    return one.low <= other.high and other.low <= one.high


_MAPPED = PARAMETERS | {
    "kinetic friction": ("kinetic", 0.06),
    "pressure": ("skew", 0.1),
}
"""What may vary: its field of the state, and the usual size of its change."""


def parameter_map(base: Base) -> list[Cell]:
    """Every parameter against every covariate that varies, the most telling first.

    Cells overlap: a gap of one cause shows in all that can imitate it.
    """
    residual, jacobian, _, fields = base.at_null
    load, channels = np.asarray(base.prepared.inputs.fz), len(base.prepared.channels)
    misfit = max(float(residual @ residual), NONZERO)
    cells = []
    for covariate, values in covariates_of(base).items():
        values = (
            np.minimum(values, FULL_SLIDING) if covariate == "slip_fraction" else values
        )
        shapes = functions_of(np.asarray(values, float), _FUNCTIONS)
        for parameter, (field, size) in _MAPPED.items():
            scaled = size * (load[:, None] if field == "force" else 1.0) * shapes
            columns = fields[:, [PLACE[field]]] * np.tile(scaled, (channels, 1))
            left, length = orthogonal(columns, jacobian)
            score = left.T @ residual
            evidence = mean_gain(score, length, USUAL_SIZES)
            shrink = (USUAL_SIZES[-1] * length) ** 2
            shrink = shrink / (1 + shrink)
            explained = float(np.sum(shrink * score**2)) / misfit
            cells.append(Cell(parameter, covariate, evidence, explained))
    return sorted(cells, key=lambda cell: -cell.log_evidence)
