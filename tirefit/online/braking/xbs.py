r"""Extended braking stiffness from wheel speed only, O(1)-(10).

With the slope k [N s/m] of the braking force over the slip velocity, the wheel is a
first-order system driven by the uneven road, O(2): :math:`\ddot v_w = -p\,\dot v_w + w`
with :math:`p = a + k r^2 / J` [1/s], O(8), a the gain of a deceleration servo or zero.
Least squares with a forgetting factor on the band-passed speed, O(3)-(7) and O(10), give

.. math:: \hat p = (1 - \rho_1) / \tau

where :math:`\rho_1` is the correlation of one increment of the filtered speed with the next. **That
is not p.** Sampling gives 2/3 p, and the band-pass removes everything outside the band: with 2 to
20 Hz at 200 samples per second it is between 3.7 and 24.8 1/s for all p. But it rises with p: for a
white disturbance w the sampled speed has the spectrum of :func:`speed_spectrum` and the filter is
known, so :math:`\hat p` is a ratio of two integrals over frequency. The record computes that
relation once and inverts it. The same integrals give the variance of the estimate; P of the
recursion assumes white errors. Poles far below or above the band are not resolved.

A strong vibration in the past hides a weak one now: with a memory of 1 s, half of a fall of k is
found within 0.2 s, but half of a rise only after 1.6 s. With ``quiet`` above zero, the past is
dropped if the wheel is so much calmer.
"""

from functools import lru_cache
from typing import Any, ClassVar, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tirefit.arrays import Number, Scalar
from tirefit.online import base
from tirefit.params import par

_NODES, _FREQUENCIES = 256, 4096
_SLOWEST, _FASTEST = 0.02, 8.0
"""Poles of the relation over the lower and the upper edge of the band."""
_INTERVAL_OFF = 0.2
"""Relative difference of an interval from that of the rate above which it is a gap."""


class Section(NamedTuple):
    """A filter of second order: b0 + b1/z + b2/z^2 over 1 + a1/z + a2/z^2."""

    b0: Number | float
    b1: Number | float
    b2: Number | float
    a1: Number | float
    a2: Number | float

    def step(self, state: tuple[Array, Array], x: Array) -> tuple[tuple[Array, Array], Array]:
        """(state (s1, s2), output) after the input x: direct form II transposed."""
        s1, s2 = state
        y = self.b0 * x + s1
        return (self.b1 * x - self.a1 * y + s2, self.b2 * x - self.a2 * y), y


def butterworth(kind: str, corner: float, rate: float) -> Section:
    """Butterworth of second order, ``low`` or ``high``; corner and rate in Hz."""
    from scipy.signal import butter

    top, bottom = butter(2, corner, kind, fs=rate)
    return Section(*top, *bottom[1:])


def speed_spectrum(angle: np.ndarray, pole: float, corner: float, period: float) -> np.ndarray:
    r"""Power of the sampled increments of wheel speed, by frequency; any common scale.

    The speed has poles at p and at the corner c of the road's disturbance d, whose
    spectrum is flat below c and falls with the square above, so that its rate w is
    white above: :math:`S_v \propto 1 / ((\omega^2 + p^2)(\omega^2 + c^2))`, O's own
    assumption for c = 0. In partial fractions each is the exponential autocovariance of
    a first-order system, whose sampled spectrum is known: aliasing is in it.

    Args:
        angle: frequency [rad a sample].
        pole: p [1/s], > 0, not c.
        corner: c [rad/s], >= 0.
        period: of sampling [s].
    """
    step = 2 - 2 * np.cos(angle)  # |1 - 1/z|^2

    def first_order(rate: float) -> np.ndarray:
        if rate == 0:
            return 2 * period + 0 * angle
        rho = np.exp(-rate * period)
        last = -np.expm1(-rate * period)  # 1 - rho without its cancellation
        return last * (1 + rho) / rate * step / (last**2 + rho * step)

    return (first_order(pole) - first_order(corner)) / (corner**2 - pole**2)


class Relation(NamedTuple):
    """The result of least squares for each pole: arrays (nodes,), by rising pole.
    ``spreads``: N times the variance of the estimate [1/s2] of N samples, due to the square
    of the signal, signal times sensor noise, and the square of the noise, each over its
    power; ``noise0``, ``noise1``: for white noise of variance one, the mean square of an
    increment and the mean product of two."""

    square: np.ndarray  # p^2 [1/s2]
    printed: np.ndarray  # the estimate O(3)-(7) [1/s]
    spreads: np.ndarray  # (3, nodes)
    noise0: float
    noise1: float


@lru_cache
def relation(
    rate: float, low: float, high: float, corner: float, gain: float = 0.0, delay: float = 0.0
) -> Relation:
    r"""The relation for samples per second, band [Hz], corner of the road [Hz], and gain a
    [1/s] and delay T [s] of a servo; poles p include the gain.

    The delay multiplies the power of the wheel speed by
    :math:`|i\omega + p|^2 / |i\omega + p - a + a e^{-i\omega T}|^2`; the servo of O(8) has
    none. Aliasing of the difference is ignored.
    """
    from scipy.signal import freqz

    # The mean over frequencies is accurate for such smooth spectra.
    angle = (np.arange(_FREQUENCIES) + 0.5) * np.pi / _FREQUENCIES
    band = np.ones(_FREQUENCIES)
    for filtered in (butterworth("high", low, rate), butterworth("low", high, rate)):
        band *= np.abs(freqz(filtered[:3], (1.0, *filtered[3:]), angle)[1]) ** 2
    turning = 1j * angle * rate
    delayed = gain * np.expm1(-turning * delay)
    noise = band * (2 - 2 * np.cos(angle))
    noise0, noise1 = np.mean(noise), np.mean(noise * np.cos(angle))
    noise = noise / noise0
    weight = rate * (1 - np.cos(angle))
    poles = np.pi * 2 * np.geomspace(_SLOWEST * low, _FASTEST * high, _NODES)
    rows = []
    for pole in poles:
        signal = band * speed_spectrum(angle, pole, 2 * np.pi * corner, 1 / rate)
        signal = signal * np.abs((turning + pole) / (turning + pole + delayed)) ** 2
        signal = signal / np.mean(signal)
        printed = np.mean(weight * signal)
        off = (weight - printed) ** 2
        parts = signal * signal, 2 * signal * noise, noise * noise
        rows.append((pole**2, printed, *(2 * np.mean(off * part) for part in parts)))
    table = np.array(rows)
    # With a delayed servo, the slowest poles oscillate and the relation is not monotonic
    # there: of two poles the faster one is used, as the other would be unstable.
    turn = int(np.argmin(table[:, 1]))
    table[:turn, 1] = table[turn, 1] - 1e-9 * np.arange(turn, 0, -1)
    return Relation(table[:, 0], table[:, 1], table[:, 2:].T, float(noise0), float(noise1))


def rate_in_use(slope: Array, stiffness: float, direction: Scalar = 0.0) -> Array:
    r"""Friction in use gamma [-] from the slope of the force: the inverse of O(22).

    Args:
        slope: :math:`v_w k = \partial F_x / \partial \kappa_x` [N].
        stiffness: :math:`K_s` [N].
        direction: theta of the force [rad].

    Returns:
        0 to 1; 1 below the slope of full sliding, 0 above that of no slip.
    """
    along, across = jnp.cos(direction) ** 2, jnp.sin(direction) ** 2 / 3
    # (along + across) X^2 + across X + across = slope / stiffness, X = sticking share.
    lead, rest = along + across, across - slope / stiffness
    root = jnp.sqrt(jnp.maximum(across**2 - 4 * lead * rest, 0.0))
    sticking = jnp.clip((root - across) / (2 * lead), 0.0, 1.0)
    return 1 - sticking**3


def _forgotten(sums: Float[Array, "4"], share: Scalar) -> Float[Array, "4"]:
    """The sums of a state with all weights multiplied by this share."""
    return sums * base.floats(share, share, share, share**2)


class XbsState(NamedTuple):
    """States of the filters, the last filtered speed and its last increment [m/s]; sums
    weighted by age: squares and products of increments [m2/s2], weights, squares of weights;
    number of samples since the start of the filter, and the speed then; whether the last
    interval differed from the rate; the last speed [m/s], force and load [N]."""

    high: tuple[Number, Number]
    low: tuple[Number, Number]
    filtered: Number
    increment: Number
    power: Number
    sums: Float[Array, "4"]
    age: Number
    origin: Number
    irregular: Number
    speed: Number
    force: Number
    fz: Number


class Xbs(base.AbstractEstimator):
    """Extended braking stiffness, and the friction in use that follows from it, O(22).

    A sample needs only ``omega``. ``reference``: speed [m/s] that a deceleration servo
    follows, :math:`v_0` of O(9), which is subtracted; ``use``: 1, or 0 for a sample that
    updates the filter but not the regression, for example during a pressure ramp.
    """

    method: ClassVar[base.Method] = base.Method(
        "xbs", "slope of force over slip velocity from wheel vibration", ("omega",),
        ("xbs", "used"), "steady braking; slopes with a break frequency near or in the band",
        "O(3)-(7)", "first-order wheel",
    )  # fmt: skip

    judged: ClassVar[bool] = False

    average: float = par(1.0, (1.0, 1.0 + 1e-9), "-", "every sample is a step")
    rate: float = par(200.0, (40.0, 1e4), "Hz", "samples a second")
    low: float = par(2.0, (0.1, 50.0), "Hz", "lower edge of the band")
    high: float = par(20.0, (0.5, 500.0), "Hz", "upper edge of the band")
    forgetting: float = par(0.995, (0.5, 1.0), "-", "forgetting factor per sample")
    radius: float = par(0.3, (0.01, 2.0), "m", "rolling radius")
    wheel_inertia: float = par(1.2, (1e-6, 1e3), "kg m2", "of one wheel")
    servo_gain: float = par(0.0, (-500.0, 500.0), "1/s", "gain of the deceleration servo")
    # Share of the memory's mean square below which the past has little weight; 0: as in O.
    quiet: float = par(0.0, (0.0, 1.0), "-", "share of the past's power that makes it forgotten")
    servo_delay: float = par(0.0, (0.0, 0.2), "s", "time after which the servo acts")
    road_corner: float = par(0.0, (0.0, 500.0), "Hz", "below it the road's disturbance is white")
    speed_noise: float = par(0.0, (0.0, 1.0), "m/s", "std of the noise of the wheel's speed")
    stiffness: float = par(
        6e4, (1.0, 1e8), "N", "2 c_p a^2, slope of the force at rest", scale="log"
    )
    # Computed from the settings above whenever they change; not a setting.
    sections: Any = None
    relation: Any = None

    def __post_init__(self) -> None:
        low, high, rate = float(self.low), float(self.high), float(self.rate)
        if not low < high < rate / 2:
            raise ValueError(
                f"band {low:g} to {high:g} Hz at {rate:g} samples a second: the edges"
                f" must rise and lie below {rate / 2:g} Hz"
            )
        self.sections = butterworth("high", low, rate), butterworth("low", high, rate)
        servo = float(self.servo_gain), float(self.servo_delay)
        self.relation = relation(rate, low, high, float(self.road_corner), *servo)

    def init(self) -> XbsState:
        zero, none = jnp.zeros(()), jnp.full((), jnp.nan)
        return XbsState(
            (zero, zero), (zero, zero), zero, zero, zero, jnp.zeros(4), zero,
            none, zero, none, none, none,
        )  # fmt: skip

    def update(self, state: XbsState, sample: base.Sample) -> base.Updated:
        s, speed = state, self.radius * sample["omega"]
        error = speed - sample.get("reference", 0.0)
        origin = jnp.where(s.age > 0, s.origin, error)
        first, second = self.sections
        high, passed = first.step(s.high, error - origin)
        low, filtered = second.step(s.low, passed)
        increment = filtered - s.filtered
        settled = s.age >= self._settling()
        added = base.floats(s.increment**2, s.increment * increment, 1.0, 1.0)
        # Time [s] of the recent mean square, compared with that of the memory.
        power = s.power + (increment**2 - s.power) / (0.1 * self.rate)
        faded = power * s.sums[2] < self.quiet * s.sums[0]
        # Forgetting factor while the wheel is so much calmer than before.
        forget = jnp.where(faded, jnp.minimum(0.9, self.forgetting), self.forgetting)
        sums = _forgotten(s.sums, forget) + added
        use = settled & (sample.get("use", 1.0) > 0)
        after = XbsState(
            high, low, filtered, increment, power, base.choose(use, sums, s.sums), s.age + 1,
            origin, s.irregular, speed, *self._force(sample),
        )  # fmt: skip
        return after, jnp.zeros((), int), jnp.full((), jnp.nan)

    def wait(self, state: XbsState, dt: Number, steps: Number) -> XbsState:
        """After lost samples, the filter starts again and the past has less weight."""
        begun = state.age > 0
        off = begun & (jnp.abs(dt * self.rate - 1) > _INTERVAL_OFF)
        gap = begun & ((steps > 0) | (dt * self.rate > 1 + _INTERVAL_OFF))
        forget = jnp.where(gap, self.forgetting ** (dt * self.rate), 1.0)
        kept = {name: getattr(state, name) for name in ("origin", "speed", "force", "fz")}
        fresh = self.init()._replace(sums=_forgotten(state.sums, forget), **kept)
        return base.choose(gap, fresh, state)._replace(irregular=jnp.where(off, 1.0, 0.0))

    def _settling(self) -> float:
        # Periods of the lower edge until the response of the band-pass to a step is below 4 %.
        return 0.8 * self.rate / self.low

    def _force(self, sample: base.Sample) -> tuple[Number, Number]:
        """Braking force and load [N] of the sample, if known."""
        return jnp.full((), jnp.nan), jnp.full((), jnp.nan)

    def pole(self, state: XbsState) -> tuple[Array, Array, Array, Array]:
        """(p, std of it, printed estimate [1/s], flag), NaN before the first sums."""
        table, age = self.relation, state.age
        square, product, weight, weight2 = state.sums
        there = weight > 0
        weight = jnp.where(there, weight, 1.0)
        noise = self.speed_noise**2 * weight
        power = square - noise * table.noise0
        clear = there & (power > 0.5 * square) & (square > 0)
        power = jnp.where(clear, power, 1.0)
        correlation = (product - noise * table.noise1) / power
        printed = self.rate * (1 - correlation)
        low, high = table.printed[0], table.printed[-1]
        square = jnp.interp(printed, table.printed, table.square)
        share = noise * table.noise0 / power
        parts = [jnp.interp(square, table.square, part) for part in table.spreads]
        variance = parts[0] + share * (parts[1] + share * parts[2])
        variance = variance * weight2 / weight**2
        slopes = jnp.diff(table.square) / jnp.diff(table.printed)
        middle = jnp.sqrt(table.square[1:] * table.square[:-1])
        std = jnp.sqrt(variance) * jnp.interp(square, middle, slopes)
        pole = jnp.sqrt(square)
        # Error of a root: by its slope away from zero, else the root of the spread.
        std = jnp.minimum(std / (2 * pole), jnp.sqrt(std))
        none = jnp.where(clear, 0.0, jnp.nan)
        flag = base.flag_of(
            (clear & ((printed <= low) | (printed >= high)), base.Flag.OUT_OF_RANGE),
            (there & ~clear, base.Flag.LITTLE_EXCITATION),
            ((age < self._settling()) | ~there, base.Flag.SETTLING),
            (state.irregular > 0, base.Flag.GAP),
        )
        return pole + none, std + none, printed + none, flag

    def estimate(self, state: XbsState) -> base.Estimate:
        pole, pole_std, _, flag = self.pole(state)
        scale = self.wheel_inertia / self.radius**2
        slope, slope_std = scale * (pole - self.servo_gain), scale * pole_std
        used = rate_in_use(state.speed * slope, self.stiffness)
        share = jnp.clip(state.speed * slope / self.stiffness, 0.0, 1.0)
        relative = state.speed * slope_std / self.stiffness
        # The stiffness at rest is known to 10 %.
        relative = jnp.hypot(relative, 0.1 * share)
        # gamma = 1 - share^(3/2); near full use the spread of the share itself.
        used_std = jnp.minimum(1.5 * jnp.sqrt(share + relative) * relative, 1.0)
        value, std = [slope, used], [slope_std, used_std]
        if "mu" in self.method.parameters:
            there = used > 0
            safe = jnp.where(there, used, 1.0)
            mu = jnp.where(there, state.force / (safe * state.fz), jnp.nan)
            value, std = [*value, mu], [*std, mu * used_std / safe]
        return base.Estimate(jnp.stack(value), jnp.stack(std), flag)


class XbsBraking(Xbs):
    """The same method with the force from the brake pressure, and so the friction.

    :math:`F = g p - J \\dot\\Omega / R` without the band-passed acceleration, as only the
    mean force matters.
    """

    method: ClassVar[base.Method] = base.Method(
        "xbs-braking", "as xbs, and friction with the force by brake pressure",
        ("omega", "brake_pressure", "fz"), ("xbs", "used", "mu"),
        "as xbs, with 30 to 100 % of the friction", "S §3.5", "brush",
    )  # fmt: skip

    gain: float = base.brake_gain()

    def _force(self, sample: base.Sample) -> tuple[Number, Number]:
        return self.gain * sample["brake_pressure"], sample["fz"]
