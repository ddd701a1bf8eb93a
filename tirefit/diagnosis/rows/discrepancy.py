"""The unlisted effect of rows of forces: a parameter of the tire, its slip or its force as a
function of one covariate; and the smooth functions and waves that represent any gap while
the noise is estimated."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from tirefit.data.rig.levels import Levels, levels
from tirefit.diagnosis.effects.state import State
from tirefit.diagnosis.engine import FLAT, ROUNDING, UNSEEN
from tirefit.diagnosis.engine.discrepancy import Cell, Discrepancy, Wave, places_of
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

_PLACES = {"slip_fraction": 20, "slip": 28, "time": 28, "distance": 28}
_USUAL = 12
"""Numbers of places of the covariates at which a function has its values."""

_SET_BY_RIG = ("fz", "v", "temperature", "gamma", "pressure", "direction", "run")
"""Covariates that may have few settings, each with a value of its own."""

_WAVES = ("friction", "force")
"""Parameters that may be waves in time, such as mains hum, chatter or an uneven road."""

_FINER = 4
"""A record with more sampling times for each row is not sampled evenly."""


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


def settings_of(covariate: str, values: np.ndarray) -> Levels | None:
    """The few settings of a covariate; None if it has a range."""
    settings = levels(values)
    return settings if covariate in _SET_BY_RIG and settings.few() else None


def is_mirrored(parameter: str, covariate: str) -> bool:
    """Whether the change has the sign of the slip."""
    return covariate == "slip_fraction" and parameter in ("force", "slip")


def discrepancy_of(base: "Base") -> Discrepancy:
    """The cells of every parameter with every covariate that varies."""
    rows, fields = base.rows, np.asarray(base.at_null.fields)
    channels, load = len(rows.channels), np.asarray(rows.inputs.fz)
    side = np.where(base.slip_fraction < 0, -1.0, 1.0)
    weights = {}
    for name, (field, usual) in PARAMETERS.items():
        own = usual * fields[:, PLACE[field]]
        weights[name] = own * np.tile(load, channels) if field == "force" else own
    columns: list[np.ndarray] = [np.zeros((len(fields), 0))]
    cells, first = [], 0
    for covariate, values in quantities(rows, base.slip_fraction).items():
        settings = settings_of(covariate, np.asarray(values))
        shapes, places = places_of(
            np.asarray(values, float),
            None if settings is None else settings.center,
            _PLACES.get(covariate, _USUAL),
        )
        for parameter, weight in weights.items():
            own = shapes * side[:, None] if is_mirrored(parameter, covariate) else shapes
            columns.append(weight[:, None] * np.tile(own, (channels, 1)))
            end = first + len(places)
            cells.append(Cell(parameter, covariate, first, end, places, settings is not None))
            first = end
    shapes = np.concatenate(columns, axis=1)
    return Discrepancy(shapes, tuple(cells), _waves(rows, weights))


def _waves(rows: Prepared, weights: dict[str, np.ndarray]) -> tuple[Wave, ...]:
    """Waves over time, and over distance where the speed varies: of mains hum or chatter, and
    of the turning wheel."""
    over: dict[str, np.ndarray] = {}
    if rows.time is not None and "time" in rows.has and not rows.random_order:
        over["time"] = rows.time
        if "speeds" in rows.has:
            over["distance"] = travelled(rows)
    return tuple(
        Wave(name, covariate, weights[name], np.tile(clock, len(rows.channels)), tick)
        for covariate, values in over.items()
        for clock, tick in (_clock(values),)
        for name in _WAVES
    )


def _clock(values: np.ndarray) -> tuple[np.ndarray, float]:
    """Place (n,) of each value in even steps, -1 for values that need too many of them, and
    the step: the median one."""
    moments = np.unique(values)
    step = float(np.median(np.diff(moments))) if len(moments) > 1 else 1.0
    places = np.rint((values - moments[0]) / step).astype(int)
    return (places if places.max() < _FINER * len(values) else np.full(len(values), -1)), step


WAVES, ROWS_OF_A_WAVE = 96, 5
"""Largest number of waves of one kind that are compared at once, and smallest number of rows
of a wave."""

_BUMPS = (4, 8)  # smallest and largest number of functions of the slip for each sign
_LEVELS = 4  # largest number of settings of a covariate with a coefficient each


def bumps(values: np.ndarray, count: int) -> np.ndarray:
    """Radial functions over the range of the values: (n, count)."""
    centers = np.linspace(values.min(), values.max(), count)
    width = max((centers[1] - centers[0]), FLAT)
    return np.exp(-0.5 * ((values[:, None] - centers) / width) ** 2)


def _by_side(
    slip_fraction: np.ndarray, factors: Sequence[Values], scale: Values, most: int
) -> np.ndarray:
    """Bumps over the size of the slip times each factor (n,), separately by sign if each
    sign has a twentieth of the rows: about ``most`` whitened columns."""
    inside = np.clip(slip_fraction, -FULL_SLIDING, FULL_SLIDING)
    sides = [inside >= 0, inside < 0]
    if min(np.mean(side) for side in sides) <= 0.05:
        sides = [np.ones(len(inside), bool)]
    count = int(np.clip(most // (len(sides) * len(factors)), *_BUMPS))
    shapes = bumps(np.abs(inside), count)
    chosen = factors[: max(most // (len(sides) * count), 1)]
    columns = [shapes * (side * one)[:, None] for one in chosen for side in sides]
    return _scaled(np.concatenate(columns, axis=1), scale)


def _standard(values: Values) -> np.ndarray | None:
    values = np.asarray(values)
    spread = np.std(values)
    return (values - values.mean()) / spread if spread > UNSEEN else None


def _modulations(prepared: Prepared) -> list[Values]:
    """Factors of the bumps in the order of importance: (n,) each."""
    rows = prepared.covariates
    first: list[Values] = [np.ones(prepared.n)]
    second: list[Values] = []
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


def _scaled(columns: np.ndarray, scale: Values) -> np.ndarray:
    """Whitened unit columns, reduced to a basis with the same covariance."""
    basis = columns * scale[:, None]
    size = np.linalg.norm(basis, axis=0)
    basis = basis[:, size > FLAT] / size[size > FLAT]
    if not basis.shape[1]:
        return basis
    values, vectors = np.linalg.eigh(basis.T @ basis)
    return basis @ vectors[:, values > UNSEEN * values.max()]


def smooth_basis(
    prepared: Prepared, slip_fraction: np.ndarray, scale: Values, most: int, runs: bool = False
) -> np.ndarray:
    """Smooth functions of slip, times load, speed, time and direction (n, b).

    Args:
        slip_fraction: signed slip over that of full sliding, (n,).
        scale: (n,) typical force over the noise of each row.
        most: approximate number of columns.
        runs: whether each run has functions of its own too.
    """
    factors = _modulations(prepared)
    if runs and "runs" in prepared.has:
        own = [_standard(prepared.run == k) for k in np.unique(prepared.run)[1:]]
        factors[1:1] = [unit for unit in own[:_LEVELS] if unit is not None]
    return _by_side(slip_fraction, factors, scale, most)


def wave_basis(
    prepared: Prepared, scale: Values, friction: np.ndarray, remainder: np.ndarray
) -> np.ndarray:
    """Sine and cosine of slip, of time, and of the friction over time, side by side:
    (n, 2 x waves). Of each kind these are the ones that a ``remainder`` (n,) contains most of.
    """
    slip, most = prepared.slip, max(prepared.n // ROWS_OF_A_WAVE, 2 * _BUMPS[0])
    over_slip = np.arange(1.0, min(most // 2, WAVES // 4) + 1)
    kinds = [((slip - slip.min()) / max(np.ptp(slip), FLAT), over_slip, scale)]
    if "time" in prepared.has:
        # With half waves: between two whole numbers of waves a third of the energy is lost.
        over_time = np.arange(1, most + 0.1, 0.5)
        kinds += [(prepared.covariates.time, over_time, weight) for weight in (scale, friction)]
    waves = []
    for share, counts, weight in kinds:
        if len(counts) > WAVES:
            counts = _strongest(share, remainder * weight, counts)
        turns = 1j * np.exp(-2j * np.pi * share[:, None] * counts)  # sin + i cos
        waves.append(turns.view(float) * weight[:, None])
    columns = np.concatenate(waves, axis=1)
    size = np.sqrt(np.einsum("nk,nk->k", columns, columns))
    return columns / np.maximum(size, ROUNDING)


def _strongest(share: np.ndarray, values: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """The :data:`WAVES` of the counts, 1 and more in half steps, with the largest sums of the
    values (n,) times the wave, in their order."""
    # Within steps of which the shortest wave, of five rows, has ten.
    steps = 2 * len(share)
    places = np.rint((share - share.min()) * steps).astype(int)
    placed = np.bincount(places, values, 2 * steps)
    power = np.abs(np.fft.rfft(placed))[2 : len(counts) + 2]
    return counts[np.sort(np.argsort(-power)[:WAVES])]


def _in_pairs(gram: np.ndarray, score: np.ndarray, ridge: float) -> tuple[np.ndarray, np.ndarray]:
    """chi-squared and determinant of each wave, from the products ``gram`` (K, 3) of
    :func:`_pairs` and ``score`` (K, 2) with the residual; ``ridge`` adds to squares."""
    a, b, c = gram[:, 0] + ridge, gram[:, 1], gram[:, 2] + ridge
    sine, cosine = score.T
    size = a * c - b * b
    return (c * sine**2 - 2 * b * sine * cosine + a * cosine**2) / size, size


def _pairs(columns: np.ndarray) -> np.ndarray:
    """Products sine-sine, sine-cosine, cosine-cosine of waves (m, 2 K): (K, 3)."""
    sine, cosine = columns[:, ::2], columns[:, 1::2]
    each = ((sine, sine), (sine, cosine), (cosine, cosine))
    return np.stack([np.einsum("mk,mk->k", *pair) for pair in each], axis=1)


def waves_within(waves: np.ndarray, against: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """chi-squared (K,), two degrees of freedom each, of every wave."""
    unit, _ = np.linalg.qr(against)
    rest = residual - unit @ (unit.T @ residual)
    gram, score = _pairs(waves) - _pairs(unit.T @ waves), waves.T @ rest
    return _in_pairs(gram, score.reshape(-1, 2), FLAT)[0]
