r"""Lateral friction from the position on the road, S section 3.3 (Hahn), corrected.

Force and slip angle of the front axle follow from the distance :math:`e_y` from the centre
line, the heading :math:`\psi`, that of the road :math:`\psi_d` and the yaw rate r:

.. math::
   F_f = \frac{m l_r}{l_f + l_r} \left(\ddot e_y + V \dot\psi_d
         + \frac{I_z}{m l_r} \dot r\right), \quad
   \alpha_f = \delta_f - \arctan \frac{\dot e_y - (\psi - \psi_d) V + l_f r}{V}

with every signal passed through :math:`b^2 (s + b)^{-2}`, which gives its derivatives
without differences. The brush is linear in :math:`\Theta = [C, C^2/\mu, C^3/\mu^2]` over
:math:`\Phi = [|\tan\alpha|, -|\tan\alpha|^2/(3F_z), |\tan\alpha|^3/(27F_z^2)]`; force and
:math:`\Phi`, with their signs, pass the filter :math:`(s + a)^{-2}` of the source. (The brush of a
slip that passed one filter as slow as a is not the filtered brush: mu was 60 % too high.)

The source leaves the adaptive law to its reference [7]. Here it is least squares with
forgetting on :math:`\ln C` and :math:`1/\mu`, so that the three parts of :math:`\Theta`
are consistent. It stores only products of the regressors: each step goes towards the
least squares of all samples, however wrong the start.
"""

from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from tirefit.arrays import Number, Scalar
from tirefit.online import base
from tirefit.online.base import Estimate, Flag, Method, Sample, Updated, choose, flag_of
from tirefit.online.regression import SLIDING, Regressors, regressors
from tirefit.online.vehicle import AbstractVehicleMethod, wrapped
from tirefit.params import par

_SIGNALS = ("offset", "aside", "road_heading", "yaw_rate", "steering")
"""The signals that are filtered first; aside: heading - that of the road."""
_BANDWIDTH = 10.0  # b [1/s] of the filter of the signals
_PRIOR = 0.3, 1.0  # relative std of the expected stiffness, std of the expected mu over mu
_MODEL_ERROR = 0.015  # relative error of the force that is constant in a drive
_SAMPLES_OF_NOISE = 20.0  # weight, in samples, of the stated noise relative to the observed errors
_FARTHEST = 0.5  # largest step per sample, where the slope is valid
_EXPECTED = (0.0, 1.0)
_KEPT = 0.02  # weight of the past after a change


class Filtered(NamedTuple):
    """Signals (k,) of the last sample, u, and u/(s+a), u/(s+a)^2 of them."""

    u: Float[Array, " k"]
    once: Float[Array, " k"]
    twice: Float[Array, " k"]

    def value(self, a: float) -> Float[Array, " k"]:
        """a^2/(s+a)^2 of the signals."""
        return a * a * self.twice

    def rate(self, a: float) -> Float[Array, " k"]:
        """The filtered first derivatives."""
        return a * a * (self.once - a * self.twice)

    def acceleration(self, a: float) -> Float[Array, " k"]:
        """The filtered second derivatives."""
        return a * a * (self.u - 2 * a * self.once + a * a * self.twice)


def filtered_step(state: Filtered, u: Float[Array, " k"], dt: Number, a: float) -> Filtered:
    """The filter after ``dt`` [s], by the trapezoidal (Tustin) rule; a in 1/s."""
    keep, take = (2 - a * dt) / (2 + a * dt), dt / (2 + a * dt)
    once = keep * state.once + take * (u + state.u)
    return Filtered(u, once, keep * state.twice + take * (once + state.once))


def _moved(
    before: Filtered, u: Float[Array, " k"], dt: Number, a: float, anew: Bool[Array, ""]
) -> Filtered:
    """The filter after one step, or initialised as settled on the signals."""
    settled = Filtered(u, u / a, u / (a * a))
    return choose(anew, settled, filtered_step(before, u, dt, a))


class LawState(NamedTuple):
    """ln of C over the expected one, and the expected mu over mu; the products of u_0,
    u_1, u_2 and y, summed with forgetting, and their effective number."""

    x: Float[Array, "2"]
    products: Float[Array, "4 4"]
    weight: Number


def coefficients(x: Float[Array, "2"]) -> Float[Array, "3"]:
    """theta (3,) of a :class:`LawState`'s x (2,); the third follows from the others."""
    theta0 = jnp.exp(x[0])
    return theta0 * jnp.stack([jnp.ones_like(x[1]), theta0 * x[1], (theta0 * x[1]) ** 2])


class PositionState(NamedTuple):
    """The filters of the signals and of the regression, the time [s] since their start,
    the largest recent u_0 [-], the state of the law."""

    signals: Filtered
    regression: Filtered
    age: Number
    peak: Number
    law: LawState


class Position(AbstractVehicleMethod):
    """Friction and cornering stiffness of the front axle, from positions."""

    method: ClassVar[Method] = Method(
        "position", "front axle's brush from position on the road and yaw rate",
        ("offset", "heading", "road_heading", "yaw_rate", "steering", "v"), ("mu", "C_f"),
        "40 to 90 % of the friction, in bends; below, mu is flagged", "S §3.3",
    )  # fmt: skip

    mu: float = base.nominal_friction(0.9)
    bandwidth: float = par(3.0, (0.1, 100.0), "1/s", "a of the filter (s+a)^-2")
    forgetting: float = par(0.999, (0.5, 1.0), "-", "forgetting factor per sample")
    force_noise: float = base.force_noise(0.05)
    least_use: float = base.excitation()

    def init(self) -> PositionState:
        of_signals = Filtered(*[jnp.zeros(len(_SIGNALS))] * 3)
        of_regression = Filtered(*[jnp.zeros(len(Regressors._fields))] * 3)
        zero = jnp.zeros(())
        law = LawState(jnp.array(_EXPECTED), jnp.zeros((4, 4)), zero)
        return PositionState(of_signals, of_regression, zero, zero, law)

    def update(self, state: PositionState, sample: Sample) -> Updated:
        a, dt = self.bandwidth, sample["dt"]
        # After one filter time without a sample the filter starts again.
        anew = a * dt > 1.0
        road = state.signals.u[2]
        road = road + wrapped(sample["road_heading"] - road)
        aside = wrapped(sample["heading"] - sample["road_heading"])
        u = [sample["offset"], aside, road, sample["yaw_rate"], sample["steering"]]
        signals = _moved(state.signals, jnp.stack(u), dt, _BANDWIDTH, anew)
        force, slip = self.force_and_slip(signals, sample["v"])
        load = self.loads[0]
        given = {"sigma_x": slip, "fx": force, "fz": jnp.asarray(load)}
        # The terms of S(49) [-] with the sign of the slip.
        folded = regressors(given, self.stiffness_f * load / 2, self.mu, 0.0)
        terms = jnp.where(slip < 0, -1.0, 1.0) * jnp.stack(folded)
        regression = _moved(state.regression, terms, dt, a, anew)
        age = jnp.where(anew, 0.0, state.age + dt)
        filtered = Regressors(*regression.value(a))
        # Filter times 1/a after a start until the filter has forgotten it to 0.3 %.
        settled = a * age > 8.0
        moved, flag, surprise = self._adapted(state.law, filtered)
        law = choose(settled & (flag == 0), moved, state.law)
        surprise = jnp.where(settled & (flag == 0), surprise, jnp.nan)
        flag = jnp.where(settled, flag, base.code(Flag.SETTLING))
        peak = jnp.maximum(self.forgetting * state.peak, settled * abs(filtered.u0))
        return PositionState(signals, regression, age, peak, law), flag, surprise

    def wait(self, state: PositionState, dt: Number, steps: Number) -> PositionState:
        return state._replace(law=self._forgotten(state.law, self.forgetting**steps))

    def open(self, state: PositionState) -> PositionState:
        law = self._forgotten(state.law, _KEPT)
        return state._replace(law=law, peak=jnp.zeros_like(state.peak))

    def force_and_slip(self, filtered: Filtered, v: Number) -> tuple[Number, Number]:
        """Force [N] of the front axle and tangent [-] of its slip angle, from the signals
        in the order ``offset``, heading - that of the road, ``road_heading``,
        ``yaw_rate``, ``steering``."""
        a = _BANDWIDTH
        value, rate = filtered.value(a), filtered.rate(a)
        offset, aside, road, yaw, steering = range(len(_SIGNALS))
        lateral = filtered.acceleration(a)[offset] + v * rate[road]
        force = self.l_r * self.mass * lateral + self.yaw_inertia * rate[yaw]
        across = rate[offset] - value[aside] * v + self.l_f * value[yaw]
        angle = value[steering] - jnp.arctan(across / v)
        return force / self.base, jnp.tan(angle)

    def _forgotten(self, law: LawState, share: Scalar) -> LawState:
        """The state with the weight of the past multiplied by this share."""
        products, weight = law.products * share, law.weight * share
        return law._replace(products=products, weight=weight)

    def _adapted(self, law: LawState, terms: Regressors) -> tuple[LawState, Int[Array, ""], Number]:
        """The law with one more sample, the flag of the reason to skip it, surprise."""
        side = jnp.where(terms.u0 < 0, -1.0, 1.0)
        y, *u = (side * term for term in terms)
        row = jnp.stack([*u, y])
        products = self.forgetting * law.products + jnp.outer(row, row)
        moved = LawState(law.x, products, self.forgetting * law.weight + 1)
        covariance, noise = self.uncertainty(law)
        slope = jax.jacfwd(coefficients)(law.x).T @ row[:3]
        error = y - coefficients(law.x) @ row[:3]
        surprise = error / jnp.sqrt(noise * noise + slope @ covariance @ slope)
        for _ in range(2):  # a step of Gauss and Newton on all samples and the prior
            noise_now = self._noise(moved)
            information, slopes, prior = self._information(moved, noise_now)
            left = moved.products[:3, 3] - moved.products[:3, :3] @ coefficients(moved.x)
            expected = (jnp.array(_EXPECTED) - moved.x) / prior**2
            change = jnp.linalg.solve(information, slopes.T @ left / noise_now**2 + expected)
            x = moved.x + jnp.clip(change, -_FARTHEST, _FARTHEST)
            # Smallest expected mu over mu: mu is limited to ten times that.
            moved = moved._replace(x=x.at[1].set(jnp.maximum(x[1], 0.1)))
        # Largest stiffness over the expected one by which sliding is detected.
        steepest = jnp.minimum(jnp.exp(law.x[0]), 2.0)
        flag = flag_of(
            (y < SLIDING * steepest * u[0] - 3 * noise, Flag.OUT_OF_RANGE),
            (u[0] < self.least_use, Flag.LITTLE_EXCITATION),
        )
        return moved, flag, surprise

    def _noise(self, law: LawState) -> Number:
        """Std [-] of the force over the load, from stated noise and observed errors."""
        theta = jnp.append(-coefficients(law.x), 1.0)
        seen = jnp.maximum(theta @ law.products @ theta, 0.0)
        stated = _SAMPLES_OF_NOISE * self.force_noise**2
        return jnp.sqrt((stated + seen) / (_SAMPLES_OF_NOISE + law.weight))

    def _information(
        self, law: LawState, noise: Number
    ) -> tuple[Float[Array, "2 2"], Float[Array, "3 2"], Float[Array, "2"]]:
        slope = jax.jacfwd(coefficients)(law.x)
        prior = base.floats(*_PRIOR)
        gathered = slope.T @ law.products[:3, :3] @ slope / noise**2
        return gathered + jnp.diag(1 / prior**2), slope, prior

    def uncertainty(self, law: LawState) -> tuple[Float[Array, "2 2"], Number]:
        """Covariance (2, 2) of x, and the noise [-]."""
        noise = self._noise(law)
        return jnp.linalg.inv(self._information(law, noise)[0]), noise

    def estimate(self, state: PositionState) -> Estimate:
        """mu and C_f.

        A constant error of the force bends the curve as a wrong friction does: u_0 is
        confused with :math:`u_0^2 / (3 \\mu)`. It affects the stiffness as far as that is
        correlated with the friction.
        """
        law = state.law
        stiffness = self.stiffness_f * self.loads[0] * jnp.exp(law.x[0])
        mu = self.mu / law.x[1]
        covariance, _ = self.uncertainty(law)
        of_noise = jnp.sqrt(jnp.diag(covariance))[::-1]
        of_noise = of_noise / jnp.stack([law.x[1], jnp.ones(())])
        bent = jnp.minimum(_MODEL_ERROR * 3 * mu / state.peak, _PRIOR[1])
        drawn = covariance[0, 1] / covariance[1, 1] * law.x[1] * bent
        lasting = jnp.stack([bent, jnp.hypot(_MODEL_ERROR, drawn)])
        relative = jnp.hypot(of_noise, lasting)
        value = jnp.stack([mu, stiffness])
        return Estimate(value, value * relative)
