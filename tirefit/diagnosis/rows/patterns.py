"""What a remainder looks like: one quantity of the tire that changes in one shape with
one thing that was measured.

The bases of :mod:`rows.basis` are wide: many smooth functions at once. A
stranger is often narrow: a kink, a threshold, a wave or one place. Here each such
pattern is one direction in the space of the data; its evidence has a closed form.
Thousands of them cost a few products of matrices: a pattern is a shape of the rows
times the force of a usual change, and both are there once, not every one of their
products; a wave of any phase is made of two.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from tirefit.data.levels import Levels, levels
from tirefit.diagnosis.negligible import NONZERO
from tirefit.diagnosis.rows.rates import segments

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
PHASES = 4
"""Phases of each wave."""

_MIXED = np.array(
    [(np.cos(p), np.sin(p)) for p in np.pi * np.arange(PHASES) / PHASES], np.float32
)
"""Sine and cosine in each phase: sin(x + p) = cos p sin x + sin p cos x."""
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


class Over(NamedTuple):
    """Shapes over one covariate that some of the weights take.

    ``plain`` (n, a) are shapes as they are; ``waves`` (n, 2 w) sines and cosines in
    turn, of which every wave has :data:`PHASES` phases. ``listed`` holds
    (shape, place, width) of every one of the a + 4 w, ``log_prior`` (a + 4 w,) its
    share; ``weights`` maps each parameter to its column of the weights.
    """

    covariate: str
    plain: np.ndarray
    waves: np.ndarray
    listed: Sequence[tuple[str, float, float]]
    log_prior: np.ndarray
    weights: dict[str, int]

    def products(self, against) -> np.ndarray:
        """Sums over the rows of each shape times (n, c): (a + 4 w, c)."""
        waves = (self.waves.T @ against).reshape(-1, 2, against.shape[1])
        phased = np.einsum("fi,wic->wfc", _MIXED, waves)
        whole = phased.reshape(-1, against.shape[1])
        return np.concatenate([self.plain.T @ against, whole])

    def shapes(self, which) -> np.ndarray:
        """Those of these numbers (c,): (n, c)."""
        plain = which < self.plain.shape[1]
        wave, phase = np.divmod(which[~plain] - self.plain.shape[1], PHASES)
        pairs = self.waves.reshape(len(self.waves), -1, 2)[:, wave]
        found = np.empty((len(self.waves), len(which)))
        found[:, plain] = self.plain[:, which[plain]]
        found[:, ~plain] = np.einsum("nci,ci->nc", pairs, _MIXED[phase])
        return found

    def squares(self, against) -> np.ndarray:
        """The same of each shape squared."""
        sine, cosine = self.waves[:, ::2], self.waves[:, 1::2]
        each = (sine**2, 2 * sine * cosine, cosine**2)
        parts = np.stack([part.T @ against for part in each], axis=1)
        mixed = np.stack([_MIXED[:, 0] ** 2, _MIXED.prod(axis=1), _MIXED[:, 1] ** 2])
        waves = np.einsum("if,wic->wfc", mixed.astype(np.float32), parts)
        whole = waves.reshape(-1, against.shape[1])
        return np.concatenate([(self.plain**2).T @ against, whole])


@dataclass(frozen=True, eq=False)
class Patterns:
    """Every shape of ``over`` (of n rows) as a change of each of its parameters:
    ``weights`` (channels, n, W) are the whitened forces of usual changes."""

    weights: np.ndarray
    over: Sequence[Over]

    @cached_property
    def log_prior(self) -> np.ndarray:
        """Of each pattern (k,): each covariate and parameter is as likely."""
        each = [np.tile(one.log_prior, len(one.weights)) for one in self.over]
        return np.concatenate(each) - np.log(sum(len(one.weights) for one in self.over))

    @cached_property
    def of(self) -> list[Pattern]:
        """What each of them is."""
        return [
            Pattern(parameter, one.covariate, *listed)
            for one in self.over
            for parameter in one.weights
            for listed in one.listed
        ]

    @cached_property
    def square(self) -> np.ndarray:
        """Squared length of each pattern (k,)."""
        force = np.sum(self.weights**2, axis=0).astype(np.float32)
        columns = [list(one.weights.values()) for one in self.over]
        return np.concatenate(
            [
                one.squares(force[:, own]).T.ravel()
                for one, own in zip(self.over, columns, strict=True)
            ]
        )

    def columns(self, which) -> np.ndarray:
        """Whitened forces (m, c) of the patterns of these numbers (c,)."""
        found, begin = np.zeros((*self.weights.shape[:2], len(which))), 0
        for one in self.over:
            for column in one.weights.values():
                mine = (which >= begin) & (which < begin + len(one.listed))
                shapes = one.shapes(which[mine] - begin)
                found[:, :, mine] = self.weights[:, :, [column]] * shapes
                begin += len(one.listed)
        return found.reshape(-1, len(which))

    def products(self, against) -> np.ndarray:
        """Products of each pattern with columns (m, c): (k, c)."""
        channels, n, _ = self.weights.shape
        against = against.reshape(channels, n, -1)
        force = np.einsum("xnw,xnc->nwc", self.weights, against).astype(np.float32)
        blocks = []
        for one in self.over:
            own = force[:, list(one.weights.values())]
            found = one.products(own.reshape(n, -1))
            found = found.reshape(-1, *own.shape[1:]).swapaxes(0, 1)
            blocks.append(found.reshape(-1, own.shape[2]))
        return np.concatenate(blocks)


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


def travelled(prepared) -> np.ndarray:
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
            values["distance"] = travelled(prepared)
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


_Shape = tuple[str, float, float, np.ndarray]
"""(shape, place, width, function of the rows (n,))."""


def _between_settings(values, settings: Levels) -> list[_Shape]:
    """Thresholds between the few settings of a rig, and single ones."""
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


def _in_range(share) -> list[_Shape]:
    """Kinks, steps and bumps over a range, of which rows have these shares."""
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
    return listed


def turns(share, counts) -> np.ndarray:
    """Sine and cosine, in turn, of so many evenly spaced turns: (n, 2 k).

    Args:
        share: (n,) what one turn is of.
        counts: (k,) turns, each as far from the one before.
    """
    # One product for each instead of a sine and a cosine: i exp(-i x) = sin + i cos.
    step = counts[1] - counts[0] if len(counts) > 1 else 0.0
    parts = np.empty((len(share), len(counts)), complex)
    parts[:, :1] = 1j * np.exp(-2j * np.pi * counts[:1] * share[:, None])
    parts[:, 1:] = np.exp(-2j * np.pi * step * share)[:, None]
    return np.cumprod(parts, axis=1).view(float)


def _over(covariate: str, values, weights: dict[str, int]) -> Over | None:
    """All shapes over one quantity; None if there are none."""
    settings, n = settings_of(covariate, values), len(values)
    low, span, waves = values.min(), max(np.ptp(values), NONZERO), np.zeros((n, 0))
    if settings is not None:
        shapes = _between_settings(values, settings)
        listed = [(name, at, width) for name, at, width, _ in shapes]
    else:
        share = (values - low) / span
        counts = _WAVES.get(covariate, _FEW_WAVES)
        counts = counts[counts * _ROWS_OF_A_WAVE < n]
        shapes, waves = _in_range(share), turns(share, counts)
        listed = [(name, low + at * span, w * span) for name, at, w, _ in shapes]
        listed += [("wave", span / c, 0.0) for c in counts for _ in range(PHASES)]
    if not listed:
        return None
    plain = np.array([shape for *_, shape in shapes]).reshape(-1, n).T
    # Every kind of shape is as likely, and within it every place.
    kinds = Counter(name for name, *_ in listed)
    prior = np.array([-np.log(len(kinds) * kinds[name]) for name, *_ in listed])
    return Over(
        covariate, plain.astype(np.float32), waves.astype(np.float32), listed, prior,
        weights,
    )  # fmt: skip


def _both_sides(beyond) -> bool:
    return bool(_EACH_SIDE < beyond.mean() < 1 - _EACH_SIDE)


def patterns(prepared, slip_fraction, fields: dict[str, np.ndarray]) -> Patterns:
    """All patterns of a file.

    Args:
        slip_fraction: signed slip over that of full sliding, (n,).
        fields: of each of :data:`PARAMETERS` the whitened force (m,) of a unit change.
    """
    load = np.asarray(prepared.inputs.fz)
    side = np.where(slip_fraction < 0, -1.0, 1.0)
    columns: list[np.ndarray] = []
    number: dict[tuple[str, bool], int] = {}
    for parameter, (_, usual) in PARAMETERS.items():
        size = usual * load if parameter == "force" else np.full(prepared.n, usual)
        field = fields[parameter].reshape(len(prepared.channels), prepared.n)
        for mirrored in (False, True):
            number[parameter, mirrored] = len(columns)
            columns.append(field * (side * size if mirrored else size))
    over = [
        _over(
            covariate,
            np.asarray(values, float),
            {name: number[name, is_mirrored(name, covariate)] for name in PARAMETERS},
        )
        for covariate, values in quantities(prepared, slip_fraction).items()
    ]
    return Patterns(np.stack(columns, axis=2), [one for one in over if one is not None])


def _scores(among: Patterns, unit, residual):
    """Squared length (k,) of every pattern with ``unit`` (m, q) taken out, see
    :func:`rows.basis.taken_out`, and its product with the residual (k,);
    both zero where hardly anything is left of it."""
    left = residual - unit @ (unit.T @ residual)
    found = among.products(np.concatenate([unit, left[:, None]], axis=1))
    whole, used = among.square, np.sum(found[:, :-1] ** 2, axis=1)
    length = np.where(
        whole - used > np.maximum(_LEFT * whole, _LEAST), whole - used, 0.0
    )
    return length.astype(float), np.where(length > 0, found[:, -1], 0.0).astype(float)


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
    length, score = _scores(among, np.linalg.qr(against)[0], residual)
    return length, score, _gains_of_sizes(length, score) + among.log_prior


def patterns_gain(among: Patterns, unit, residual) -> float:
    """Log evidence of one pattern, whichever, over none.

    Args:
        unit: (m, q) of :func:`tirefit.diagnosis.rows.basis.taken_out`.
        residual: (m,) whitened.
    """
    gains = _gains(*_scores(among, unit, residual))
    return float(np.logaddexp.reduce(gains + among.log_prior))


def looks(among: Patterns, against, residual, most: int = 3) -> list[Look]:
    """The patterns that a remainder looks like, the most probable of each parameter and
    quantity; the probability is of all patterns of that parameter and quantity."""
    length, score = _scores(among, np.linalg.qr(against)[0], residual)
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
