"""The unlisted effect of rows of forces: a parameter of the tire, its slip or its force as a
function of one covariate; and the smooth functions and waves that represent any gap while
the noise is estimated."""

from typing import TYPE_CHECKING

import numpy as np

from tirefit.data.rig.levels import levels
from tirefit.diagnosis.effects.state import State
from tirefit.diagnosis.engine import FLAT, ROUNDING, UNSEEN
from tirefit.diagnosis.engine.discrepancy import Cell, Discrepancy, places_of
from tirefit.diagnosis.rows.prepared import Prepared
from tirefit.diagnosis.rows.slips import segments
from tirefit.params import Values

if TYPE_CHECKING:
    from tirefit.diagnosis.rows.subject import Base

FULL_SLIDING = 3.0
"""Slip over that of full sliding above which the force no longer depends on it."""

PARAMETERS = {
    "stiffness": ("stiffness", 0.06),
    "friction": ("friction", 0.03),
    "slip": ("shift", 0.002),
    "force": ("force", 0.01),
}
"""Field of each parameter; usual change (relative, a slip, or force over load)."""

PLACE = {name: k for k, name in enumerate(State._fields)}
"""Column of each field of the state in :class:`rows.forces.Linear`."""


def travelled(prepared: Prepared) -> np.ndarray:
    """Distance since the start of each unbroken stretch [m]: (n,)."""
    way = np.zeros(prepared.n)
    if prepared.time is None:
        return way
    for rows in segments(prepared.time, prepared.run):
        pace = np.abs(prepared.covariates.v[rows])
        steps = 0.5 * (pace[1:] + pace[:-1]) * np.diff(prepared.time[rows])
        way[rows[1:]] = np.cumsum(steps)
    return way


def quantities(prepared: Prepared, slip_fraction: np.ndarray) -> dict[str, np.ndarray]:
    """Covariates that vary: (n,) each. ``slip_fraction`` is signed."""
    has, rows = prepared.has, prepared.covariates
    signed = np.clip(slip_fraction, -FULL_SLIDING, FULL_SLIDING)
    values = {"slip_fraction": np.abs(signed)}
    if "signs" in has:
        values["slip"] = signed
    if "loads" in has:
        values["fz"] = np.asarray(prepared.inputs.fz)
    if "speeds" in has:
        values["v"] = rows.v
    if "time" in has:
        values["time"] = prepared.time
    if "time" in has and "speeds" in has:  # at constant speed, distance is time
        values["distance"] = travelled(prepared)
    if "sweeps" in has:
        values["direction"] = np.sign(rows.turning)
    named = ("temperature", "gamma", "pressure")
    return values | {name: prepared.column(name) for name in named if name in has}


def discrepancy_of(base: "Base") -> Discrepancy:
    """The cells of every parameter with every covariate that varies."""
    rows, fields = base.rows, np.asarray(base.at_null.fields)
    channels, load = len(rows.channels), np.asarray(rows.inputs.fz)
    side = np.where(base.slip_fraction < 0, -1.0, 1.0)
    weights = {}
    for name, (field, usual) in PARAMETERS.items():
        slope = usual * fields[:, PLACE[field]]
        weights[name] = slope * np.tile(load, channels) if field == "force" else slope
    columns, cells = [], []
    # Numbers of places at which a function has its values: 20 or 28, 12 for what a rig sets.
    counts = {"slip_fraction": 20, "slip": 28, "time": 28, "distance": 28}
    for covariate, values in quantities(rows, base.slip_fraction).items():
        settings, count = levels(np.asarray(values)), counts.get(covariate, 12)
        few = covariate not in counts and settings.few()  # each setting with a value of its own
        centers = settings.center if few else None
        shapes, places = places_of(np.asarray(values, float), centers, count)
        for parameter, weight in weights.items():
            mirrored = covariate == "slip_fraction" and parameter in ("force", "slip")
            signed = shapes * side[:, None] if mirrored else shapes
            columns.append(weight[:, None] * np.tile(signed, (channels, 1)))
            cells.append(Cell(parameter, covariate, places, few))
    return Discrepancy(np.concatenate(columns, axis=1), tuple(cells))


_WAVES = 96
"""Largest number of waves of one kind that are compared at once."""

_BUMPS = (4, 8)  # smallest and largest number of functions of the slip for each sign
_LEVELS = 4  # largest number of settings of a covariate with a coefficient each


def _standard(values: Values) -> np.ndarray | None:
    """Values minus their mean over their standard deviation; None without one."""
    values = np.asarray(values)
    spread = np.std(values)
    return (values - values.mean()) / spread if spread > UNSEEN else None


def _modulations(prepared: Prepared) -> list[Values]:
    """Factors of the functions of the slip in the order of importance: (n,) each."""
    rows = prepared.covariates
    first: list[Values] = [np.ones(prepared.n)]
    second: list[Values] = []
    if "runs" in prepared.has:
        runs = np.unique(prepared.run)[1 : _LEVELS + 1]
        steps = [_standard(prepared.run == run) for run in runs]
        first += [unit for unit in steps if unit is not None]
    plain = (rows.v, rows.time, rows.temperature, rows.gamma, rows.other)
    for values in (np.log(rows.fz), *plain):
        if (unit := _standard(values)) is not None:
            first.append(unit)
            if not levels(values).few(_LEVELS - 1):
                second.append(unit**2 - 1)
    if "sweeps" in prepared.has:
        first.append(rows.turning)
        if (speed := _standard(rows.v)) is not None:
            first.append(rows.turning * speed)
    return first + second


def smooth_basis(
    prepared: Prepared, slip_fraction: np.ndarray, scale: Values, most: int
) -> np.ndarray:
    """Smooth functions of slip, times run, load, speed, time and direction: whitened unit columns
    (n, b), reduced to a basis with the same covariance.

    Args:
        slip_fraction: signed slip over that of full sliding, (n,).
        scale: (n,) typical force over the noise of each row.
        most: approximate number of columns.
    """
    factors, inside = _modulations(prepared), np.clip(slip_fraction, -FULL_SLIDING, FULL_SLIDING)
    sides = [inside >= 0, inside < 0]  # separately, if each has a twentieth of the rows
    if min(np.mean(side) for side in sides) <= 0.05:
        sides = [np.ones(len(inside), bool)]
    count, size = int(np.clip(most // (len(sides) * len(factors)), *_BUMPS)), np.abs(inside)
    centers = np.linspace(size.min(), size.max(), count)
    width = max((centers[1] - centers[0]), FLAT)
    shapes = np.exp(-0.5 * ((size[:, None] - centers) / width) ** 2)
    chosen = factors[: max(most // (len(sides) * count), 1)]
    columns = [shapes * (side * factor)[:, None] for factor in chosen for side in sides]
    basis = np.concatenate(columns, axis=1) * scale[:, None]
    length = np.linalg.norm(basis, axis=0)
    basis = basis[:, length > FLAT] / length[length > FLAT]
    if not basis.shape[1]:
        return basis
    values, vectors = np.linalg.eigh(basis.T @ basis)
    return basis @ vectors[:, values > UNSEEN * values.max()]


def wave_basis(
    prepared: Prepared, scale: Values, friction: np.ndarray, remainder: np.ndarray
) -> np.ndarray:
    """Sine and cosine of slip, of time, and of the friction over time, side by side:
    (n, 2 x waves). Of each kind these are the ones that a ``remainder`` (n,) contains most of.
    """
    slip, most = prepared.slip, max(prepared.n // 5, 2 * _BUMPS[0])  # a wave has five rows
    over_slip = np.arange(1.0, min(most // 2, _WAVES // 4) + 1)
    kinds = [((slip - slip.min()) / max(np.ptp(slip), FLAT), over_slip, scale)]
    if "time" in prepared.has:
        # With half waves: between two whole numbers of waves a third of the energy is lost.
        over_time = np.arange(1, most + 0.1, 0.5)
        kinds += [(prepared.covariates.time, over_time, weight) for weight in (scale, friction)]
    waves = []
    for share, counts, weight in kinds:
        if len(counts) > _WAVES:
            # Within steps of which the shortest wave, of five rows, has ten.
            steps = 2 * len(share)
            places = np.rint((share - share.min()) * steps).astype(int)
            power = np.abs(np.fft.rfft(np.bincount(places, remainder * weight, 2 * steps)))
            strongest = np.argsort(-power[2 : len(counts) + 2])[:_WAVES]
            counts = counts[np.sort(strongest)]
        turns = 1j * np.exp(-2j * np.pi * share[:, None] * counts)  # sin + i cos
        waves.append(turns.view(float) * weight[:, None])
    columns = np.concatenate(waves, axis=1)
    size = np.sqrt(np.einsum("nk,nk->k", columns, columns))
    return columns / np.maximum(size, ROUNDING)


def _pairs(columns: np.ndarray) -> np.ndarray:
    """Products sine-sine, sine-cosine, cosine-cosine of waves (m, 2 K): (K, 3)."""
    sine, cosine = columns[:, ::2], columns[:, 1::2]
    each = ((sine, sine), (sine, cosine), (cosine, cosine))
    return np.stack([np.einsum("mk,mk->k", *pair) for pair in each], axis=1)


def waves_within(waves: np.ndarray, against: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """chi-squared (K,), two degrees of freedom each, of every wave."""
    unit, _ = np.linalg.qr(against)
    rest = residual - unit @ (unit.T @ residual)
    gram = _pairs(waves) - _pairs(unit.T @ waves)
    sine, cosine = (waves.T @ rest).reshape(-1, 2).T
    a, b, c = gram[:, 0] + FLAT, gram[:, 1], gram[:, 2] + FLAT
    return (c * sine**2 - 2 * b * sine * cosine + a * cosine**2) / (a * c - b * b)
