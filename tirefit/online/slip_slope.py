r"""Slope of the slip curve near zero slip, and the road that follows, S section 3.1.

The regression is :math:`s = (F/F_z) / k + \delta`, with the force over the load so that
the slope k [-] does not depend on the load, and :math:`x = (1/k, \delta)` as a random
walk. The cumulative sum of the runner detects fast changes, for which ``open`` raises the
covariance of 1/k. Noise of the force, a regressor here, biases 1/k towards zero by its
share of the variance of the force; averaging before a step makes that small.

Variations of the rolling radius appear as slip noise, to first order
:math:`\delta s = -\delta R / R`. Their variance is that of the errors of prediction minus
that of slip and force noise. :func:`road_of` gives the road.
"""

from typing import ClassVar, NamedTuple

import jax.numpy as jnp
from jax.scipy.stats import norm
from jaxtyping import Array, Bool, Float

from tirefit.arrays import Number
from tirefit.online import base
from tirefit.params import par

ROADS = ("asphalt", "gravel", "snow", "ice")
"""The four roads of S section 3.1; estimates number them from 1, by falling friction."""
STIFF, SOFT = 0.75, 0.45
"""Limits between asphalt, snow and ice on a smooth road, as slopes over that of asphalt."""
_MEMORY = 0.98  # weight of the previous mean square error: a memory of about 50 steps


def road_of(relative: Number, rough: Bool[Array, ""]) -> Number:
    """Number of the road in :data:`ROADS`, from 1.

    Args:
        relative: slope over that of asphalt [-].
        rough: whether the rolling radius varies more than on a smooth road.

    Returns:
        For a smooth road asphalt above 0.75, snow above 0.45, else ice; for a rough one
        gravel above 0.45, else snow, as ice is never rough.
    """
    smooth = jnp.where(relative >= STIFF, 1.0, jnp.where(relative >= SOFT, 3.0, 4.0))
    return jnp.where(rough, jnp.where(relative >= SOFT, 2.0, 3.0), smooth)


class SlipSlopeState(NamedTuple):
    """1/k and the offset [-], their covariance, mean square error of one sample."""

    x: Float[Array, "2"]
    covariance: Float[Array, "2 2"]
    square: Number


class SlipSlope(base.AbstractEstimator):
    """Kalman filter of the slope at low slip, the slip offset and the road."""

    method: ClassVar[base.Method] = base.Method(
        "slip-slope", "slope and offset of the slip by Kalman filter; road",
        ("sigma_x", "fx", "fz"), ("slip_slope", "slip_offset", "radius_std", "road"),
        "up to 30 % of the load; does not measure the peak", "S §3.1", "straight line",
    )  # fmt: skip

    slope: float = par(18.5, (0.5, 500.0), "-", "slope on asphalt, to be calibrated", scale="log")
    drift_slope: float = par(0.005, (0.0, 1.0), "1/sqrt(s)", "relative random walk of 1/k")
    drift_offset: float = par(1e-5, (0.0, 1.0), "1/sqrt(s)", "random walk of the offset")
    rough: float = par(0.003, (0.0, 1.0), "-", "relative std of the radius on a rough road")
    force_noise: float = base.force_noise(0.0447)
    slip_noise: float = base.slip_noise()
    gain_spread: float = 0.0  # relative std of the gain of the force; samples do not determine it

    def init(self) -> SlipSlopeState:
        inverse = jnp.asarray(1 / self.slope, float)
        return SlipSlopeState(base.floats(inverse, 0.0), self._first(), self._noise(inverse))

    def _first(self) -> Float[Array, "2 2"]:
        # 1/k is first known to half of itself, the offset to 0.5 % of slip.
        return jnp.diag(base.floats(0.5 / self.slope, 0.005) ** 2)

    def use(self, sample: base.Sample) -> Number:
        """Force over load [-] of a sample."""
        return sample["fx"] / sample["fz"]

    def applies(self, use: Number) -> Bool[Array, ""]:
        """Whether a sample with this force over load is in the linear range."""
        return jnp.abs(use) <= 0.3

    def update(self, state: SlipSlopeState, sample: base.Sample) -> base.Updated:
        s, use, count = state, self.use(sample), sample["count"]
        noise = jnp.maximum(s.square, self._noise(s.x[0])) / count
        row = jnp.stack([use, jnp.ones(())])
        error = sample["sigma_x"] - row @ s.x
        given = s.covariance, row[None], error[None], noise[None, None]
        x, covariance, ((spread,),) = base.kalman_update(s.x, *given)
        seen = count * error * error * noise / spread
        updated = SlipSlopeState(x, covariance, _MEMORY * s.square + (1 - _MEMORY) * seen)
        unused = ~self.applies(use)
        surprise = jnp.where(unused, jnp.nan, error / jnp.sqrt(spread))
        flag = base.flag_of((unused, base.Flag.OUT_OF_RANGE))
        return base.choose(unused, s, updated), flag, surprise

    def wait(self, state: SlipSlopeState, dt: Number, steps: Number) -> SlipSlopeState:
        walk = base.floats(self.drift_slope / self.slope, self.drift_offset) ** 2
        return state._replace(covariance=state.covariance + dt * jnp.diag(walk))

    def open(self, state: SlipSlopeState) -> SlipSlopeState:
        """Restore the uncertainty of the slope; that of the radius is kept."""
        first = self._first().at[1, 1].set(0.0)
        return state._replace(covariance=base.widest(state.covariance, first))

    def _noise(self, inverse: Number) -> Number:
        """Variance of the error of one sample on a smooth road."""
        return self.slip_noise**2 + (self.force_noise * inverse) ** 2

    def estimate(self, state: SlipSlopeState) -> base.Estimate:
        s = state
        sane = s.x[0] > 0
        inverse = jnp.where(sane, s.x[0], 1.0)
        inverse_std, offset_std = jnp.sqrt(jnp.diag(s.covariance))
        slope = jnp.where(sane, 1 / inverse, jnp.nan)
        relative = jnp.hypot(inverse_std / inverse, self.gain_spread)
        variance = jnp.maximum(s.square - self._noise(inverse), 0.0)
        variance_std = s.square * jnp.sqrt(2 * (1 - _MEMORY))
        radius = jnp.sqrt(variance)
        # Error of a root: by its slope away from zero, else the root of the spread.
        radius_std = variance_std / jnp.maximum(2 * radius, jnp.sqrt(variance_std))
        road = road_of(slope / self.slope, variance > self.rough**2)
        limits = [(limit * self.slope - slope) / (slope * relative) for limit in (STIFF, SOFT)]
        above = [norm.sf(limit) for limit in limits]
        rough = norm.sf((self.rough**2 - variance) / variance_std)
        chances = (
            (1 - rough) * above[0],
            rough * above[1],
            (1 - rough) * (above[1] - above[0]) + rough * (1 - above[1]),
            (1 - rough) * (1 - above[1]),
        )
        road_std = jnp.sqrt(sum(p * (k - road) ** 2 for k, p in enumerate(chances, start=1)))
        resolved = relative < base.RESOLVED
        nothing = jnp.where(resolved, 0.0, jnp.nan)
        return base.Estimate(
            jnp.stack([slope, s.x[1], radius, road + nothing]),
            jnp.stack([slope * relative, offset_std, radius_std, road_std]),
            base.flag_of((~resolved, base.Flag.LITTLE_EXCITATION)),
        )


class SlipSlopeBraking(SlipSlope):
    """The same method while braking, with the force from the brake pressure.

    S section 3.1, last paragraph. The balance F = gain p ignores the inertia of the wheel:
    J dOmega/dt / R is 40 N of 20 kN in the saw-teeth of S section 5.1. An error of the
    gain is an error of the slope; its std is added to that of the slope.
    """

    method: ClassVar[base.Method] = base.Method(
        "slip-slope-braking", "slip-slope from braking, force by brake pressure",
        ("sigma_x", "brake_pressure", "fz"), ("slip_slope", "slip_offset", "radius_std", "road"),
        "braking with up to 50 % of the load", "S §3.1", "straight line",
    )  # fmt: skip

    gain: float = base.brake_gain()
    gain_spread: float = par(0.1, (0.0, 1.0), "-", "relative std of the brake's gain")

    def use(self, sample: base.Sample) -> Number:
        return self.gain * sample["brake_pressure"] / sample["fz"]

    def applies(self, use: Number) -> Bool[Array, ""]:
        # Less than 5 % is not braking.
        return (use >= 0.05) & (use <= 0.5)
