"""What a remainder looks like: one quantity of the tire that changes in one shape with
one thing that was measured.

The bases of :mod:`tirefit.diagnosis.basis` are wide: many smooth functions at once. A
stranger is often narrow: a kink, a threshold, a wave or one place. Here each such
pattern is one direction in the space of the data; its evidence has a closed form, and
thousands of them cost one product of matrices.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tirefit.data.levels import Levels, levels
from tirefit.diagnosis.negligible import NONZERO
from tirefit.diagnosis.rates import segments

__all__ = [
    "PARAMETERS",
    "USUAL_SIZES",
    "Look",
    "Pattern",
    "Patterns",
    "is_mirrored",
    "looks",
    "patterns",
    "patterns_gain",
    "quantities",
    "settings_of",
    "weights_of_sizes",
]

PARAMETERS = {
    "stiffness": ("stiffness", 0.06), "friction": ("friction", 0.03),
    "slip": ("shift", 0.002), "force": ("force", 0.01),
}  # fmt: skip
"""What changes: its field of the state, and the usual size of its change; that of the
force is of the load."""

USUAL_SIZES = (0.5, 2.0, 8.0)
"""Multiples of the usual size that the evidence is averaged over."""

_SET_BY_RIG = ("fz", "v", "temperature", "gamma", "pressure")
"""Quantities that may have few settings: then only thresholds between them and single
settings are patterns. What moves by itself has gaps at most."""

_KINKS = np.linspace(0.125, 0.875, 7)
_STEPS = np.linspace(0.1, 0.9, 17)
_PLACES = {0.05: np.linspace(0.05, 0.95, 19), 0.12: np.linspace(0.1, 0.9, 9)}
"""Places, as shares of the range; bumps by their width. Half a width lies between
them, so that a shape in between loses a tenth of its square at most."""

_WAVES = {"time": np.arange(2.0, 48.1, 0.5), "distance": np.arange(2.0, 48.1, 0.5)}
_FEW_WAVES = np.arange(2.0, 14.1, 0.5)
"""Waves over the range: what turns or swings repeats in time or with the way."""
_PHASES = np.pi * np.arange(4) / 4
_ROWS_OF_A_WAVE = 5

_LEFT, _LEAST = 1e-3, 1e-3
"""Share of a pattern that the fit must leave, and its squared length in standard errors
at the usual size: of less, nothing is known."""

_SHOWS = 3.0
"""Log evidence over nothing from which patterns are told: 20 to 1."""

_EACH_SIDE = 0.04
"""Share of the rows that a step must have on either side, and a bump within it."""


class Pattern(NamedTuple):
    """``parameter`` changes with ``covariate`` by a ``shape``: kink, threshold, local
    or wave; ``at`` is its place (the period of a wave), ``width`` that of a local one,
    in units of the covariate."""

    parameter: str
    covariate: str
    shape: str
    at: float
    width: float


class Patterns(NamedTuple):
    """Whitened columns (m, k) of patterns of the usual size, and the log prior (k,)."""

    columns: np.ndarray
    log_prior: np.ndarray
    of: Sequence[Pattern]


class Look(NamedTuple):
    """What a remainder looks like: ``parameter`` (stiffness, friction, slip or force)
    changes with ``covariate`` by ``shape``: kink, threshold, local or wave.

    ``at`` is its place, of a wave its period, ``width`` the standard width of a local
    one, in units of the covariate; ``size`` that of the change: a share of stiffness or
    friction, a slip, or a force as a share of the load. ``probability`` is that of any
    pattern of this parameter and covariate among all patterns, ``explains`` the share
    of the remainder's mean square that this one takes away.
    """

    parameter: str
    covariate: str
    shape: str
    at: float
    width: float
    size: float
    probability: float
    explains: float


def _travelled(prepared) -> np.ndarray:
    """Way since the start of each unbroken record [m]: (n,)."""
    way = np.zeros(prepared.n)
    for rows in segments(prepared.time, prepared.run):
        pace = np.abs(prepared.covariates.v[rows])
        steps = 0.5 * (pace[1:] + pace[:-1]) * np.diff(prepared.time[rows])
        way[rows[1:]] = np.cumsum(steps)
    return way


def quantities(prepared, slip_fraction) -> dict[str, np.ndarray]:
    """What a pattern may depend on, those that vary: (n,) each."""
    has, rows = prepared.has, prepared.covariates
    size = np.minimum(np.abs(slip_fraction), 3.0)
    values = {
        "slip_fraction": size,
        "used_friction": 1 - (1 - np.minimum(size, 1)) ** 3,
    }
    if "signs" in has:
        values["slip"] = np.clip(slip_fraction, -3.0, 3.0)
    if "loads" in has:
        values["fz"] = np.asarray(prepared.inputs.fz)
    if "speeds" in has:
        values["v"] = rows.v
    if "time" in has:
        values["time"] = prepared.time
        # At one speed the way is the time.
        if "speeds" in has:
            values["distance"] = _travelled(prepared)
    for name in ("temperature", "gamma", "pressure"):
        if name in has:
            values[name] = prepared.column(name)
    return values


def settings_of(covariate: str, values) -> Levels | None:
    """The few settings that a rig has of a covariate; None where it has a range."""
    settings = levels(values)
    is_set = covariate in _SET_BY_RIG and settings.few()
    return settings if is_set else None


def is_mirrored(parameter: str, covariate: str) -> bool:
    """Whether driving mirrors braking: the change is in the direction of the slip."""
    of_size = covariate in ("slip_fraction", "used_friction")
    return of_size and parameter in ("force", "slip")


def _shapes(
    values, n: int, waves, settings: Levels | None
) -> list[tuple[str, float, float, np.ndarray]]:
    """(shape, place, width, function of the rows (n,)) over one quantity, of which the
    rig may have few ``settings``."""
    low, span = values.min(), max(np.ptp(values), NONZERO)
    share = (values - low) / span
    if settings is not None:
        centers = np.asarray(settings.center)
        order = np.sort(centers)
        between = 0.5 * (order[1:] + order[:-1])
        steps = [("threshold", b, 0.0, (values > b) - 0.5) for b in between]
        inner = [
            ("local", c, 0.0, 1.0 * (settings.code == code))
            for code, c in enumerate(centers)
            if order[0] < c < order[-1]
        ]
        return steps + inner
    listed = [
        ("kink", k, 0.0, np.maximum(share - k, 0.0)) for k in _KINKS
    ] + [("threshold", k, 0.0, (share > k) - 0.5) for k in _STEPS]  # fmt: skip
    listed = [one for one in listed if _both_sides(share > one[1])]
    for width, places in _PLACES.items():
        for k in places:
            near = np.abs(share - k) < width
            if near.mean() > _EACH_SIDE:
                shape = np.exp(-0.5 * ((share - k) / width) ** 2)
                listed.append(("local", k, width, shape))
    for count in waves[waves * _ROWS_OF_A_WAVE < n]:
        for phase in _PHASES:
            shape = np.sin(2 * np.pi * count * share + phase)
            listed.append(("wave", 1 / count, 0.0, shape))
    return [
        (name, at * span if name == "wave" else low + at * span, width * span, shape)
        for name, at, width, shape in listed
    ]


def _both_sides(beyond) -> bool:
    return bool(_EACH_SIDE < beyond.mean() < 1 - _EACH_SIDE)


def patterns(prepared, slip_fraction, fields: dict[str, np.ndarray]) -> Patterns:
    """All patterns of a file.

    Args:
        slip_fraction: signed slip over that of full sliding, (n,).
        fields: of each of :data:`PARAMETERS` the whitened force (m,) of a unit change.
    """
    channels = len(prepared.channels)
    load = np.asarray(prepared.inputs.fz)
    side = np.where(slip_fraction < 0, -1.0, 1.0)
    blocks, prior, names = [], [], []
    for covariate, values in quantities(prepared, slip_fraction).items():
        waves = _WAVES.get(covariate, _FEW_WAVES)
        values = np.asarray(values, float)
        settings = settings_of(covariate, values)
        shapes = _shapes(values, prepared.n, waves, settings)
        if not shapes:
            continue
        stacked = np.stack([shape for *_, shape in shapes], axis=1)
        kinds = [name for name, *_ in shapes]
        for parameter, (_, usual) in PARAMETERS.items():
            weight = np.full(prepared.n, usual)
            if parameter == "force":
                weight = weight * load
            if is_mirrored(parameter, covariate):
                weight = weight * side
            column = fields[parameter][:, None] * np.tile(
                weight[:, None] * stacked, (channels, 1)
            )
            blocks.append(column.astype(np.float32))
            # Every kind of shape is as likely, and within it every place.
            prior.append([-np.log(len(set(kinds)) * kinds.count(k)) for k in kinds])
            names += [Pattern(parameter, covariate, s, at, w) for s, at, w, _ in shapes]
    log_prior = np.concatenate(prior) - np.log(len(blocks))
    return Patterns(np.concatenate(blocks, axis=1), log_prior, names)


def _scores(among: Patterns, against, residual):
    """Squared length (k,) of every pattern with ``against`` (m, p) out, and its product
    with the residual (k,); both zero where hardly anything is left of it."""
    unit, _ = np.linalg.qr(against)
    left = residual - unit @ (unit.T @ residual)
    whole = np.einsum("mk,mk->k", among.columns, among.columns)
    used = np.sum((unit.astype(np.float32).T @ among.columns) ** 2, axis=0)
    length = np.where(
        whole - used > np.maximum(_LEFT * whole, _LEAST), whole - used, 0.0
    )
    score = left.astype(np.float32) @ among.columns
    return length.astype(float), np.where(length > 0, score, 0.0).astype(float)


def _gains_of_sizes(length, score) -> np.ndarray:
    """Log evidence of each pattern over none at each of the usual sizes: (S, k)."""
    each = []
    for scale in USUAL_SIZES:
        t = scale**2 * length
        each.append(0.5 * (scale**2 * score**2 / (1 + t) - np.log1p(t)))
    return np.array(each)


def _gains(length, score) -> np.ndarray:
    """Log evidence of each pattern over none (k,), averaged over its size."""
    each = _gains_of_sizes(length, score)
    return np.logaddexp.reduce(each, axis=0) - np.log(len(USUAL_SIZES))


def weights_of_sizes(among: Patterns, against, residual):
    """Squared length and score (k,) of every pattern with ``against`` (m, p) out, and
    the log weight of each at each of the usual sizes, (S, k)."""
    length, score = _scores(among, against, residual)
    return length, score, _gains_of_sizes(length, score) + among.log_prior


def patterns_gain(among: Patterns, against, residual) -> float:
    """Log evidence of one pattern, whichever, over none.

    Args:
        against: (m, p) columns that the fit has used up.
        residual: (m,) whitened.
    """
    gains = _gains(*_scores(among, against, residual))
    return float(np.logaddexp.reduce(gains + among.log_prior))


def looks(among: Patterns, against, residual, most: int = 3) -> list[Look]:
    """The patterns that a remainder looks like, the most probable of each parameter and
    quantity; the probability is of all patterns of that parameter and quantity."""
    length, score = _scores(among, against, residual)
    weight = _gains(length, score) + among.log_prior
    if np.logaddexp.reduce(weight) < _SHOWS:
        return []
    share = np.exp(weight - np.logaddexp.reduce(weight))
    energy = max(float(residual @ residual), NONZERO)
    groups: dict[tuple[str, str], list[int]] = {}
    for k, one in enumerate(among.of):
        groups.setdefault((one.parameter, one.covariate), []).append(k)
    listed = []
    for members in groups.values():
        best = max(members, key=lambda k: weight[k])
        if length[best] <= 0:
            continue
        usual = PARAMETERS[among.of[best].parameter][1]
        listed.append(
            Look(
                *among.of[best],
                float(score[best] / length[best]) * usual,
                float(share[members].sum()),
                float(score[best] ** 2 / length[best]) / energy,
            )
        )
    return sorted(listed, key=lambda look: -look.probability)[:most]
