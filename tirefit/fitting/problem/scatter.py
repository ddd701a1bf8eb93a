"""Estimate the noise of a file from its own rows, and choose a sample of them."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tirefit.data.rig.levels import levels
from tirefit.data.table import TireData
from tirefit.fitting.problem.build import slope_and_peak
from tirefit.fitting.problem.likelihood import CHANNEL_SLIP
from tirefit.fitting.problem.noise import autocorrelation_time

ROWS = 512
"""Size of the sample, evenly over loads and slips: one compiled program for all files."""
_LEAST_NOISE = 1e-3  # of the load: no rig measures better
_GUESSED_NOISE = 0.01
_SPINNING = -0.95  # slip below which a wheel spins almost on the spot
_SETTINGS = 12  # largest number of levels of a channel that are settings of a rig
_CHUNK = 12  # parts of a slip curve, each fitted by a parabola with noise residuals


class Scatter(NamedTuple):
    """The noise of a force."""

    share: float  # standard deviation over the load
    inflation: float  # rows per independent row
    how: str


def stretches(data: TireData, force: str) -> list[np.ndarray]:
    """The used rows of each setting of the rig, in the order of slip."""
    rows = np.flatnonzero(data.used)
    if "sigma_x" in data:  # the slip of a wheel that spins on the spot is not defined
        rolls = data["sigma_x"][rows] > _SPINNING
        rows = rows[rolls] if rolls.any() else rows
    key = np.zeros(len(rows), int)
    for name in ("fz", "v", "gamma", "pressure"):
        here = levels(data[name][rows]) if name in data else None
        if here is not None and here.few(_SETTINGS):
            key = key * len(here.center) + here.code
    parts, slip = [rows[key == k] for k in np.unique(key)], CHANNEL_SLIP[force]
    return [part[np.argsort(data[slip][part], kind="stable")] for part in parts]


def some_rows(data: TireData, parts: Sequence[np.ndarray], seed: int) -> TireData:
    """Data of at most ``ROWS`` rows of the parts, evenly taken in their order."""
    order = np.concatenate(parts)
    if len(order) > ROWS:
        edges = np.linspace(0, len(order), ROWS + 1)
        place = np.random.default_rng(seed).uniform(edges[:-1], edges[1:])
        order = order[np.minimum(place.astype(int), len(order) - 1)]
    chosen = np.zeros(len(data), bool)
    chosen[order] = True
    return data.where(chosen)


def scatter_of(data: TireData, force: str, parts: Sequence[np.ndarray]) -> Scatter:
    """The noise from the residuals of the rows about a piecewise parabolic slip curve."""
    share = data[force] / data["fz"]
    rest = np.full(len(data), np.nan)
    for part in parts:
        for rows in np.array_split(part, min(_CHUNK, max(len(part) // 8, 1))):
            if len(rows) < 6:
                continue
            slip = data[CHANNEL_SLIP[force]][rows]
            at = (slip - slip.mean()) / (np.ptp(slip) or 1.0)
            terms = np.column_stack([np.ones(len(at)), at, at**2])
            left = share[rows] - terms @ np.linalg.lstsq(terms, share[rows])[0]
            rest[rows] = left * np.sqrt(len(rows) / (len(rows) - 3))
    known = np.flatnonzero(np.isfinite(rest))
    if len(known) < 12:
        how = f"too few rows to estimate it: {_GUESSED_NOISE:.0%} of the load is assumed"
        return Scatter(_GUESSED_NOISE, 1.0, how)
    size = max(float(np.sqrt(np.mean(rest[known] ** 2))), _LEAST_NOISE)
    inflation = 1.0
    if "time" in data:
        runs = [known[data.run[known] == code] for code in np.unique(data.run[known])]
        order = [rows[np.argsort(data["time"][rows], kind="stable")] for rows in runs]
        inflation = autocorrelation_time([rest[rows] for rows in order])
    return Scatter(size, inflation, "scatter about the slip curve of each load")


def curve_of(data: TireData, force: str) -> tuple[float, float, float]:
    """Slope of the force at small slip [N], largest force over load, typical load."""
    slope, peak, typical = slope_and_peak(data, force)
    peak = float(np.clip(peak, 0.02, 3.0))
    largest = float(np.max(np.abs(data.usable(CHANNEL_SLIP[force]))))
    return max(slope, peak * typical / largest), peak, typical
