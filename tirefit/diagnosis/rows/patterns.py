"""Patterns of a remainder: one parameter of the tire changes with one covariate, with the
shape of a kink, a threshold, a local change or a wave. The column of a pattern is the
product of a shape of the rows and the force of a usual change; both are stored.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from tirefit.data.levels import Levels, levels
from tirefit.diagnosis.negligible import NONZERO
from tirefit.diagnosis.rows.slips import segments

FULL_SLIDING = 3.0
"""Slip over that of full sliding above which the force no longer depends on it."""

PARAMETERS = {
    "stiffness": ("stiffness", 0.06),
    "friction": ("friction", 0.03),
    "slip": ("shift", 0.002),
    "force": ("force", 0.01),
}
"""Field of each parameter; usual change (relative, a slip, or force over load)."""

USUAL_SIZES = 0.5 * 4.0 ** np.arange(3)
"""Multiples of the usual size over which the evidence is averaged."""

_SET_BY_RIG = ("fz", "v", "temperature", "gamma", "pressure")
"""Covariates that may have few settings, with shapes of their own."""

_PLACES = np.arange(1, 20) / 20
"""Places as shares of the range; a bump between two loses at most 0.1 of its square."""

WAVES, ROWS_OF_A_WAVE = 96, 5
"""Largest number of waves in a record (half as many for patterns in time or distance,
an eighth for others), and smallest number of rows of a wave."""

PHASES = 4  # phases of each wave


class Pattern(NamedTuple):
    """A change of a parameter with a covariate; lengths in units of the covariate."""

    parameter: str
    covariate: str
    shape: str  # kink, threshold, local or wave
    at: float  # place; the period of a wave
    width: float  # of a local change


class Over(NamedTuple):
    """Shapes over one covariate."""

    covariate: str
    shapes: np.ndarray  # (n, k)
    listed: Sequence[tuple[str, float, float]]  # k of (shape, place, width)
    log_prior: np.ndarray  # (k,)
    weights: dict[str, int]  # parameter -> its column of ``Patterns.weights``


@dataclass(frozen=True, eq=False)
class Patterns:
    """The shapes of ``over`` as changes of each parameter; ``weights`` (channels, n, W)
    are the whitened forces of usual changes."""

    weights: np.ndarray
    over: Sequence[Over]

    @cached_property
    def log_prior(self) -> np.ndarray:
        """Log probability of each pattern (k,): covariates and parameters are equal."""
        each = [np.tile(one.log_prior, len(one.weights)) for one in self.over]
        return np.concatenate(each) - np.log(sum(len(one.weights) for one in self.over))

    @cached_property
    def of(self) -> list[Pattern]:
        """All patterns (k)."""
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
        each = ((one.shapes**2).T @ force[:, [*one.weights.values()]] for one in self.over)
        return np.concatenate([part.T.ravel() for part in each])

    def columns(self, which) -> np.ndarray:
        """Whitened forces (m, c) of the patterns of these numbers (c,)."""
        found, begin = np.zeros((*self.weights.shape[:2], len(which))), 0
        for one in self.over:
            for column in one.weights.values():
                mine = (which >= begin) & (which < begin + len(one.listed))
                shapes = one.shapes[:, which[mine] - begin]
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
            found = one.shapes.T @ own.reshape(n, -1)
            found = found.reshape(-1, *own.shape[1:]).swapaxes(0, 1)
            blocks.append(found.reshape(-1, own.shape[2]))
        return np.concatenate(blocks)


class Look(NamedTuple):
    """A pattern that fits the remainder, beginning with the fields of the pattern."""

    parameter: str
    covariate: str
    shape: str
    at: float
    width: float
    size: float  # relative (stiffness, friction), a slip, or a force over load
    probability: float  # of any pattern of this parameter and covariate
    explains: float  # share of the mean square of the remainder


def travelled(prepared) -> np.ndarray:
    """Distance since the start of each unbroken stretch [m]: (n,)."""
    way = np.zeros(prepared.n)
    for rows in segments(prepared.time, prepared.run):
        pace = np.abs(prepared.covariates.v[rows])
        steps = 0.5 * (pace[1:] + pace[:-1]) * np.diff(prepared.time[rows])
        way[rows[1:]] = np.cumsum(steps)
    return way


def quantities(prepared, slip_fraction) -> dict[str, np.ndarray]:
    """Covariates of patterns that vary: (n,) each."""
    has, rows = prepared.has, prepared.covariates
    signed = np.clip(slip_fraction, -FULL_SLIDING, FULL_SLIDING)
    size = np.abs(signed)
    values = {"slip_fraction": size, "used_friction": 1 - (1 - np.minimum(size, 1)) ** 3}
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
    named = ("temperature", "gamma", "pressure")
    return values | {name: prepared.column(name) for name in named if name in has}


def settings_of(covariate: str, values) -> Levels | None:
    """The few settings of a covariate; None if it has a range."""
    settings = levels(values)
    return settings if covariate in _SET_BY_RIG and settings.few() else None


def is_mirrored(parameter: str, covariate: str) -> bool:
    """Whether the change has the sign of the slip."""
    of_size = covariate in ("slip_fraction", "used_friction")
    return of_size and parameter in ("force", "slip")


_Shape = tuple[str, float, float, np.ndarray]
"""(shape, place, width, function of the rows (n,))."""


def _between_settings(values, settings: Levels) -> list[_Shape]:
    """Thresholds between the few settings of a rig, and single inner settings."""
    order = np.sort(settings.center)
    steps = [("threshold", at, 0.0, (values > at) - 0.5) for at in 0.5 * (order[1:] + order[:-1])]
    return steps + [
        ("local", at, 0.0, 1.0 * (settings.code == code))
        for code, at in enumerate(settings.center)
        if order[0] < at < order[-1]
    ]


def _in_range(share) -> list[_Shape]:
    """Kinks, steps and bumps over a range, from the rows' shares of it (n,). 4 % of the
    rows or more are on either side of a step, or within a bump."""
    even, step = _PLACES[1::2], _PLACES[1] - _PLACES[0]
    kinks = [("kink", k, 0.0, np.maximum(share - k, 0.0)) for k in even]
    listed = kinks + [("threshold", k, 0.0, (share > k) - 0.5) for k in _PLACES]
    listed = [one for one in listed if 0.04 < np.mean(share > one[1]) < 0.96]
    for width, places in ((step, _PLACES), (2 * step, even)):
        for k in places:
            if np.mean(np.abs(share - k) < width) > 0.04:
                shape = np.exp(-0.5 * ((share - k) / width) ** 2)
                listed.append(("local", k, width, shape))
    return listed


def turns(share, counts) -> np.ndarray:
    """Sine and cosine, in turn, of evenly spaced numbers of turns (k,): (n, 2 k)."""
    # One product for each instead of a sine and a cosine: i exp(-i x) = sin + i cos.
    step = counts[1] - counts[0] if len(counts) > 1 else 0.0
    parts = np.empty((len(share), len(counts)), complex)
    parts[:, :1] = 1j * np.exp(-2j * np.pi * counts[:1] * share[:, None])
    parts[:, 1:] = np.exp(-2j * np.pi * step * share)[:, None]
    return np.cumprod(parts, axis=1).view(float)


def phased(waves) -> np.ndarray:
    """Waves (n, 2 k) of :func:`turns` in each phase: (n, k x phases)."""
    angle = np.pi * np.arange(PHASES) / PHASES
    mixed = np.array([np.cos(angle), np.sin(angle)], np.float32)
    return (waves.reshape(len(waves), -1, 2) @ mixed).reshape(len(waves), -1)


def _over(covariate: str, values, weights: dict[str, int]) -> Over | None:
    """All shapes over one quantity; None if there are none."""
    settings, n = settings_of(covariate, values), len(values)
    low, span, waves = values.min(), max(np.ptp(values), NONZERO), np.zeros((n, 0))
    if settings is not None:
        shapes = _between_settings(values, settings)
        listed = [(name, at, width) for name, at, width, _ in shapes]
    else:
        share = (values - low) / span
        most = WAVES // (2 if covariate in ("time", "distance") else 8)
        counts = np.arange(2.0, most + 0.1, 0.5)
        counts = counts[counts * ROWS_OF_A_WAVE < n]
        shapes, waves = _in_range(share), phased(turns(share, counts))
        listed = [(name, low + at * span, w * span) for name, at, w, _ in shapes]
        listed += [("wave", span / c, 0.0) for c in counts for _ in range(PHASES)]
    if not listed:
        return None
    plain = np.array([shape for *_, shape in shapes]).reshape(-1, n).T
    # Kinds of shapes have equal probabilities, and places within a kind.
    kinds = Counter(name for name, *_ in listed)
    prior = np.array([-np.log(len(kinds) * kinds[name]) for name, *_ in listed])
    every = np.concatenate([plain, waves], axis=1).astype(np.float32)
    return Over(covariate, every, listed, prior, weights)


def patterns(prepared, slip_fraction, fields: dict[str, np.ndarray]) -> Patterns:
    """All patterns of a file, from the signed slip over that of full sliding (n,) and
    the whitened force (m,) of a unit change of each of :data:`PARAMETERS`."""
    load = np.asarray(prepared.inputs.fz)
    side = np.where(slip_fraction < 0, -1.0, 1.0)
    columns: list[np.ndarray] = []
    for parameter, (_, usual) in PARAMETERS.items():
        field = fields[parameter].reshape(len(prepared.channels), prepared.n) * usual
        field = field * load if parameter == "force" else field
        columns += [field, field * side]  # the second one for mirrored changes
    over = []
    for covariate, values in quantities(prepared, slip_fraction).items():
        names = enumerate(PARAMETERS)
        number = {name: 2 * k + is_mirrored(name, covariate) for k, name in names}
        if (one := _over(covariate, np.asarray(values, float), number)) is not None:
            over.append(one)
    return Patterns(np.stack(columns, axis=2), over)


def weights_of_sizes(among: Patterns, unit, residual):
    """Squared length and score (k,) of every pattern orthogonal to ``unit`` (m, q) of
    :func:`rows.basis.taken_out`, and its log weight over no pattern at each usual size
    (S, k). The length is zero where hardly anything remains."""
    left = residual - unit @ (unit.T @ residual)
    found = among.products(np.concatenate([unit, left[:, None]], axis=1))
    whole = among.square.astype(float)
    length = whole - np.sum(found[:, :-1] ** 2, axis=1)
    # A thousandth at least, of the pattern and of a standard error at its usual size.
    length = np.where(length > 1e-3 * np.maximum(whole, 1.0), length, 0.0)
    score = np.where(length > 0, found[:, -1], 0.0).astype(float)
    t = np.square(USUAL_SIZES)[:, None]
    gain = 0.5 * (t * score**2 / (1 + t * length) - np.log1p(t * length))
    return length, score, gain + among.log_prior


def patterns_gain(among: Patterns, unit, residual) -> float:
    """Log evidence over no remainder of any one pattern, averaged over its size."""
    *_, weight = weights_of_sizes(among, unit, residual)
    return float(np.logaddexp.reduce(weight, axis=None) - np.log(len(weight)))


def looks(among: Patterns, against, residual, most: int = 3) -> list[Look]:
    """The most probable pattern of each parameter and covariate in the remainder of a
    fit of ``against`` (m, p), most probable first."""
    length, score, each = weights_of_sizes(among, np.linalg.qr(against)[0], residual)
    weight = np.logaddexp.reduce(each, axis=0) - np.log(len(each))
    whole = np.logaddexp.reduce(weight)
    if whole < 3:  # 20 to 1 over no remainder
        return []
    energy = max(float(residual @ residual), NONZERO)
    groups: dict[tuple[str, str], list[int]] = {}
    for k, one in enumerate(among.of):
        groups.setdefault((one.parameter, one.covariate), []).append(k)
    listed = []
    for members in groups.values():
        best = max(members, key=lambda k: weight[k])
        if length[best] <= 0:
            continue
        size = float(score[best] / length[best])
        probability = float(np.exp(weight[members] - whole).sum())
        explains = float(size * score[best]) / energy
        size *= PARAMETERS[among.of[best].parameter][1]
        listed.append(Look(*among.of[best], size, probability, explains))
    return sorted(listed, key=lambda look: -look.probability)[:most]
