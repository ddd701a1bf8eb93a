"""Compare redundant channels of a vehicle log: gain, delay and offset of each pair.

At the tracked point, in the axes of the car (x forward, y left), with the speed v along
the path and the rate psi' of its direction:

.. math:: a_y = v_x r + \\dot v_y, \\quad a_x = \\dot v_x - v_y r, \\quad
   r = \\dot\\psi, \\quad v_x = v \\cos\\beta, \\quad \\delta \\approx L r / v_x

Each channel L is compared with a sum of terms R_k of other channels:

.. math:: L(t) = \\sum_k g_k R_k(t - d) + o + e(t)

Both sides are noisy, and least squares would find gains that are too small. The terms
some time before and after, when the noise of the sensors is independent, are therefore
used as instrumental variables (Durbin, Reiersol). Neighbouring errors are correlated;
their effective number is n over the sum of the autocorrelation.

The channels are compared below a fifth of the filter's cutoff, where noise is smaller.
Sensors are assumed to be at the tracked point, which causes smaller errors than a wrong
unit. The equation of the steering is valid up to a factor of a few, as cars understeer.
"""

import math
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from tirefit.data.vehicle.motion import SLOWER, Motion, slowed
from tirefit.data.vehicle.track import Track
from tirefit.data.vehicle.vehicle import Vehicle

_LATEST = 0.4  # longest delay [s] that is searched, as recorders of vehicles have

ALIKE = 1.3
"""Largest gain (or inverse gain) of channels that agree. Body roll, lever arms and
encoders cause 0.9 to 1.2; the closest pair of units causes 1.9 (knots for m/s)."""

CHANGED = 1 - 1 / ALIKE
"""Smallest relative change (rms) of a channel by a delay, or of the slip angle by a wrong
point, that is a fault: the change by a gain of ``ALIKE``."""

SURE = 4.0  # standard errors above which an estimate differs from its stated value
SEEN = 0.5  # a gain is judged if at least this share of the term's variation is not noise
RELATED = 0.6  # correlation above which two channels follow each other

AROUND = (-2.0, -1.5, -1.0, 1.0, 1.5, 2.0)
"""Times of the instruments, over the time after which the noise is independent."""

EACH = 10  # rows that are used per correlation time of the noise
FEWEST = 50  # fewest rows that are compared: 5 s of a log with the default filter
_ROUNDS = 4
_TINY = 1e-300  # divisor in place of zero

_PAIRS = (
    ("yaw", {"the direction of travel": "turning"}),
    ("yaw_rate", {"the rate of the heading": "yaw_turn"}),
    ("v_x", {"the speed of the positions": "path_v_x"}),
    ("v_y", {"the speed of the positions": "path_v_y"}),
    ("a_x", {"the acceleration of the positions": "path_a_x"}),
    ("a_y", {"the acceleration of the positions": "path_a_y"}),
    ("steering", {"the path's curvature": "path_curve"}),
    ("a_y", {"v_x r": "v_x yaw_rate", "dv_y/dt": "v_y_rate"}),
    ("a_x", {"dv_x/dt": "v_x_rate", "(-v_y r)": "minus_v_y yaw_rate"}),
    ("steering", {"L r / v_x": "curve"}),
)
"""A channel, and the terms whose sum it is: words -> the signals of :func:`_signals` whose product
a term is. Terms of missing signals but the first are left out."""

_POWERS: dict[str, dict[str, int]] = {
    "turning": {"y": 1},
    "yaw_turn": {"yaw": 1},
    "path_v_x": {"xy": 1},
    "path_v_y": {"xy": 1, "y": 1},
    "path_a_x": {"xy": 1},
    "path_a_y": {"xy": 1, "y": 1},
    "path_curve": {"xy": -1, "y": 1},
    "minus_v_y": {"v_y": 1},
    "v_x_rate": {"v_x": 1},
    "v_y_rate": {"v_y": 1},
    "curve": {"yaw_rate": 1, "v_x": -1},
}
"""Signal -> the power of each channel in it: ``xy`` for the unit of both positions, ``y``
for the sign of y. A signal that is not listed is a channel."""

_SENSORS = {
    "yaw": (0.01, 0.03),
    "yaw_rate": (0.03, 0.03),
    "a_y": (0.5, 0.3),
    "a_x": (0.5, 0.3),
    "steering": (0.05, 0.005),
    "v_x": (0.0, 0.3),
    "v_y": (0.0, 0.1),
}
"""Channel -> zero error of a good sensor (2 deg/s of a gyro, 3 deg of tilt; 0: 0.02 of the
speed), and the smallest rms with which it can be compared [SI]. ``yaw``: of its rate."""

SIDEWAYS = 0.6  # largest mean angle between heading and path with which cars drive [rad]

STEADY = 0.8
"""Smallest length of the mean direction of the path in the axes of the heading, 1 if it is
constant, for which the yaw is the heading: a drift by 37 deg to both sides."""


class Gain(NamedTuple):
    """The factor of a term in the prediction of a channel, 1 if they agree."""

    channel: str
    of: str  # the term, for the user
    powers: Counter[str]  # of the channels in the term, minus those of ``channel``
    value: float
    std: float
    seen: float  # share of the term's variation that is no noise, beyond the other terms


@dataclass(frozen=True)
class Agreement:
    """A channel compared with its prediction from others; standard errors use the effective
    number of samples."""

    gains: tuple[Gain, ...]
    values: np.ndarray  # (n,) of the channel on the grid, NaN where it is not known
    delay: float  # [s] of the channel behind the others
    delay_std: float
    delay_seen: float  # as ``seen``, of the rate of the prediction, which determines the delay
    offset: float  # of the channel, in its unit
    offset_std: float
    size: float  # rms of the prediction's variation
    own_size: float  # rms of the channel's variation
    correlation: float  # of the two sides at that delay
    samples: int  # number of rows that were compared
    effective_samples: float  # number of independent rows

    @property
    def channel(self) -> str:
        """The channel that is predicted."""
        return self.gains[0].channel

    @property
    def against(self) -> str:
        """The prediction, for the user."""
        return " + ".join(gain.of for gain in self.gains)

    @cached_property
    def judged(self) -> list[Gain]:
        """The gains that are known well enough to be compared with 1: five standard errors from
        0, of channels that move and follow each other. The level of a speed is compared too."""
        level = self.channel == "v_x"
        related = level or not (
            abs(self.correlation) < RELATED
            or max(self.size, self.own_size) < _SENSORS[self.channel][1]
            or self.strays
        )
        # Another sensor confirms a term with a correlation of more than noise can share.
        confirmed = self.gains[:1] if level or abs(self.correlation) > 0.9 else ()
        known = [gain for gain in self.gains if gain.seen > SEEN or gain in confirmed]
        return [gain for gain in known if related and abs(gain.value) > 5 * gain.std]

    @property
    def strays(self) -> bool:
        """Whether a channel certainly does not follow the others, in any unit: they are
        unrelated even 2.5 standard errors above the correlation."""
        highest = abs(self.correlation) + 2.5 / math.sqrt(self.effective_samples)
        moves = self.size > _SENSORS[self.channel][1] and self.gains[0].seen > SEEN
        return self.channel != "v_x" and moves and highest < 0.7

    @property
    def is_exact(self) -> bool:
        """Whether both sides agree at every time, without dynamics of the car between them,
        which would resemble a delay."""
        return self.channel not in ("yaw", "steering") and self.against != "v_x r"

    @property
    def has_delay(self) -> bool:
        """Whether the delay is known, and the dynamics of the car cannot cause it."""
        return bool(self.judged) and self.is_exact and self.delay_seen > SEEN

    def as_dict(self) -> dict[str, Any]:
        """The estimates, for the companion file."""
        gains = [{"of": gain.of, "value": gain.value, "std": gain.std} for gain in self.gains]
        of = {"channel": self.channel, "against": self.against, "gains": gains}
        names = ("delay", "delay_std", "offset", "offset_std", "correlation", "samples")
        of |= {name: getattr(self, name) for name in (*names, "effective_samples")}
        return of | {"judged": bool(self.judged)}


# --- the pairs of a log ---------------------------------------------------------


def agreements(track: Track, motion: Motion, vehicle: Vehicle) -> list[Agreement]:
    """The estimates of all pairs of the log with enough samples."""
    of, usable = _signals(track, motion, vehicle)
    if not usable.any():
        return []
    estimates = []
    for channel, products in _PAIRS:
        terms, of_terms = [], []
        for words, product in products.items():
            names = product.split()
            if not of.keys() >= {*names}:
                break
            powers = Counter({channel: 1})
            for name in names:
                powers.subtract(_POWERS.get(name, {name: 1}))
            terms.append(np.prod([of[name] for name in names], axis=0))
            of_terms.append((channel, words, powers))
        values = of.get("yaw_turn" if channel == "yaw" else channel)
        if values is not None and terms:
            zero = _SENSORS[channel][0] or 0.02 * np.sqrt(np.mean(of["speed"][usable] ** 2))
            with suppress(np.linalg.LinAlgError):  # not determined
                sides = np.column_stack(terms)
                if found := _estimate(values, sides, zero, motion, usable, vehicle):
                    each = zip(of_terms, found[0], strict=True)
                    gains = tuple(Gain(*term, *numbers) for term, numbers in each)
                    estimates.append(Agreement(gains, values, *found[1:]))
    return estimates


def _signals(
    track: Track, motion: Motion, vehicle: Vehicle
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Channels, and signals that follow from them -> values (n,), low-passed, NaN where they are
    not known; and which samples (n,) bool can be compared: in motion, away from edges."""
    unknown = slowed(np.where(np.isfinite(motion.logged), 0.0, 1.0), motion, vehicle)
    slow = slowed(motion.logged, motion, vehicle)
    slow[np.abs(unknown) > 1e-3] = np.nan  # weight of unknown samples in a low-passed one
    of = {c.quantity: values for c, values in zip(track.channels, slow.T.copy(), strict=True)}
    last_row = np.searchsorted(track.time, motion.time, side="right") - 1
    usable = (motion.within >= SLOWER * vehicle.filter.settling) & track.active[last_row]

    def rate_of(values: np.ndarray) -> np.ndarray:
        return np.gradient(values, 1 / vehicle.filter.sample_rate)

    if not motion.settled.any():
        return of, usable & False
    if "steering" in of:
        assert vehicle.steering is not None  # the vehicle file has both or neither
        of["steering"] = np.interp(of["steering"], vehicle.steering.command, vehicle.steering.angle)
    rates = {"v_x": "v_x_rate", "v_y": "v_y_rate", "yaw": "yaw_turn"}
    of |= {rate: rate_of(of[name]) for name, rate in rates.items() if name in of}
    of |= {"minus_v_y": -of["v_y"]} if "v_y" in of else {}
    by_rates = "v_x" in vehicle.columns.motion
    with np.errstate(divide="ignore", invalid="ignore"):
        if {"x", "y"} <= set(of):
            velocity = rate_of(of["x"]) + 1j * rate_of(of["y"])
            acceleration = rate_of(velocity)
            speed, ahead = np.abs(velocity), np.angle(velocity)
            turning = np.imag(np.conj(velocity) * acceleration) / speed**2
            of |= {"speed": speed, "turning": turning}
        if by_rates:
            of["speed"] = np.hypot(of["v_x"], of["v_y"])
            of["curve"] = vehicle.wheelbase * of["yaw_rate"] / of["v_x"]
        usable &= np.isfinite(of["speed"])
        # Below a tenth of the high speeds, rows are not compared.
        fast = 0.1 * np.percentile(of["speed"][usable], 95) if usable.any() else 0.0
        usable &= of["speed"] > fast
        if "turning" in of:
            if not by_rates:
                of["path_curve"] = vehicle.wheelbase * of["turning"] / of["speed"]
            askew = np.exp(1j * (ahead - of["yaw"]))[usable] if "yaw" in of else np.zeros(1)
            mean = np.mean(askew, where=np.isfinite(askew)) if np.isfinite(askew).any() else 0.0
            known = abs(mean) > STEADY and abs(np.angle(mean)) < SIDEWAYS
            turn = np.exp(-1j * (of["yaw"] if known else ahead))
            for kind, moved in (("v", velocity * turn), ("a", acceleration * turn)):
                of[f"path_{kind}_x"] = moved.real
                if known or kind == "a":  # else nothing moves across the path
                    of[f"path_{kind}_y"] = moved.imag
    return of, usable


# --- the estimate ---------------------------------------------------------------


class Fit(NamedTuple):
    """A fit of factors of the sides and of a constant."""

    theta: np.ndarray  # (k + 1,) factors
    std: np.ndarray  # their standard errors
    seen: np.ndarray  # (k,) see :class:`Gain`
    effective: float  # number of independent samples
    error: np.ndarray  # (n,) residuals


def _estimate(
    values: np.ndarray,
    terms: np.ndarray,
    good_zero: float,
    motion: Motion,
    usable: np.ndarray,
    vehicle: Vehicle,
) -> tuple[Any, ...] | None:
    """Value, standard error and ``seen`` of each gain, then the numbers of an
    :class:`Agreement`; None if too few rows are usable.

    Args:
        values: (n,) of the channel.
        terms: (n, k) whose sum predicts it.
        good_zero: standard deviation of the zero error of a good sensor [channel's unit].
        usable: (n,) bool, samples that may be compared.
    """
    rate, k = vehicle.filter.sample_rate, terms.shape[1]
    known = np.isfinite(values) & np.isfinite(terms).all(axis=1)
    usable = usable & known
    # Beyond three times the 99th percentile, a sample is a glitch.
    for column in (values, *terms.T) if usable.any() else ():
        usable &= np.abs(column) <= 3.0 * np.percentile(np.abs(column[usable]), 99)
    # After this time the noise of a filtered sensor is independent.
    step, latest = max(1, round(SLOWER / vehicle.filter.cutoff * rate)), round(_LATEST * rate)
    rows = surrounded(motion.part, usable, known, max(2 * step, latest) + 1)
    rows = rows[:: max(1, step // EACH)]
    if len(rows) < FEWEST:
        return None
    # Values of rows that are not usable, as at standstill, are arbitrary.
    terms = np.clip(terms, terms[rows].min(axis=0), terms[rows].max(axis=0))

    def zero(factors: np.ndarray) -> float:
        return good_zero * float(np.linalg.norm(factors[:-1]))

    shift, gains = _delay(values, terms, rows, latest)
    # This is wrong only next to a break, where no row is used.
    rates = np.gradient(terms, 1 / rate, axis=0)
    for turn in range(_ROUNDS):
        along = gains if gains.any() else np.ones(k)  # the gains of a dead channel are 0
        sides = np.column_stack([terms, rates @ along])
        late = values[rows + shift]
        near = around(sides, rows, step)
        fit = instrumented(late, sides[rows], near, zero)
        rest = round(float(fit.theta[k]) * rate)
        if turn == _ROUNDS - 1 or abs(rest) < 1:
            break
        # The terms were shifted by their rate, which is valid for a small delay only.
        shift, gains = int(np.clip(shift - rest, -latest, latest)), fit.theta[:k]
    moves = np.ptp(late) > 0 and np.ptp(late - fit.error) > 0
    correlation = float(np.corrcoef(late, late - fit.error)[0, 1]) if moves else 0.0
    theta, std, seen = fit.theta.tolist(), fit.std.tolist(), fit.seen.tolist()
    delay = shift / rate - theta[k], std[k], seen[k]
    sizes = float(np.std(terms[rows].sum(axis=1))), float(np.std(late))
    gains_found = list(zip(theta[:k], std, seen, strict=False))
    return gains_found, *delay, theta[-1], std[-1], *sizes, correlation, len(late), fit.effective


def around(values: np.ndarray, rows: np.ndarray, step: int) -> np.ndarray:
    """Values (n, k) before and after each row, at the times ``AROUND``, as columns."""
    last = len(values) - 1
    places = [np.clip(rows + round(k * step), 0, last) for k in AROUND]
    return np.nan_to_num(np.hstack([values[place] for place in places]))


def surrounded(part: np.ndarray, usable: np.ndarray, known: np.ndarray, reach: int) -> np.ndarray:
    """Usable rows with ``reach`` known samples of their stretch on either side."""
    rows = np.flatnonzero(usable)
    rows = rows[(rows >= reach) & (rows < len(part) - reach)]
    blanks = np.concatenate([[0], np.cumsum(~known)])
    whole = blanks[rows + reach + 1] == blanks[rows - reach]
    return rows[whole & (part[rows - reach] == part[rows + reach])]


def _delay(
    values: np.ndarray, terms: np.ndarray, rows: np.ndarray, latest: int
) -> tuple[int, np.ndarray]:
    """The delay [samples] at which the terms explain most variance, and their gains.

    The longest delay must explain 0.02 more: half a wave late, the opposite sign fits too.
    """
    basis, triangle = np.linalg.qr(np.column_stack([terms[rows], np.ones(len(rows))]))
    scores, shifts = [], range(-latest, latest + 1)
    for shift in shifts:
        late = values[rows + shift]
        about = late - late.mean()
        explained = np.sum((basis.T @ about) ** 2) / max(np.sum(about**2), _TINY)
        scores.append(explained - 0.02 * (shift / latest) ** 2)
    best = shifts[int(np.argmax(scores))]
    return best, np.linalg.lstsq(triangle, basis.T @ values[rows + best])[0][:-1]


def instrumented(
    values: np.ndarray, sides: np.ndarray, near: np.ndarray, zero: Callable[[np.ndarray], float]
) -> Fit:
    """Two-stage least squares with a prior on the offset.

    Args:
        values: (n,); sides: (n, k).
        near: (n, m), the instruments.
        zero: function of the (k,) factors of the sides that returns the standard
            deviation of the offset, in the unit of the values.

    Raises:
        LinAlgError: the instruments do not determine the factors.
    """
    ones = np.ones((len(values), 1))
    scale = np.concatenate([np.std(sides, axis=0), [1.0]])
    scale[scale == 0] = 1.0
    columns = np.hstack([sides, ones]) / scale
    instruments = np.hstack([near / np.maximum(np.std(near, axis=0), _TINY), ones])
    seen = instruments @ np.linalg.lstsq(instruments, columns)[0]
    curvature, slope = seen.T @ columns, seen.T @ values
    prior = np.zeros_like(curvature)
    theta = np.linalg.lstsq(curvature, slope)[0]
    for _ in range(2):
        error = values - columns @ theta
        count = _independent(error)
        noise = float(np.var(error)) * len(values) / count
        level = zero((theta / scale)[:-1])
        prior[-1, -1] = noise / max(level, 1e-9) ** 2
        theta = np.linalg.solve(curvature + prior, slope)
    # The instruments do not determine the factors, even if the columns would.
    spread = np.linalg.inv(seen.T @ seen + prior)
    std = np.sqrt(np.maximum(noise * np.diag(spread), 0.0))
    shares = []
    # Share of the variation of a column, beyond the others, that the instruments explain: small
    # for noise and for a combination of the others (Sanderson, Windmeijer).
    for k in range(sides.shape[1]):
        part = np.linalg.lstsq(np.delete(seen, k, axis=1), seen[:, k])[0]
        kept, whole = (each[:, k] - np.delete(each, k, axis=1) @ part for each in (seen, columns))
        shares.append(float(np.mean(kept**2) / max(np.mean(whole**2), _TINY)))
    return Fit(theta / scale, std / scale, np.array(shares), count, values - columns @ theta)


def _independent(error: np.ndarray) -> float:
    """Number of independent values among (n,) values. The autocorrelation is summed while pairs of
    neighbouring lags are positive (Geyer)."""
    n = len(error)
    covariance = np.fft.irfft(np.abs(np.fft.rfft(error - error.mean(), 2 * n)) ** 2)[: n // 2]
    if covariance[0] <= 0:
        return float(n)
    pairs = covariance[: n // 4 * 2].reshape(-1, 2).sum(axis=1)
    until = np.flatnonzero([*(pairs <= 0), True])[0]
    return float(n / max(2 * np.sum(pairs[:until]) / covariance[0] - 1, 1.0))
