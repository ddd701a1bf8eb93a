r"""An extended Kalman filter for stiffness and friction of the brush model.

The state is :math:`x = (\ln c_p a^2, \ln \mu)`, a random walk, so that both stay
positive. The measurement is the force of the brush S(29), including full sliding,
linearised by automatic differentiation. Noise of the slip is converted to force noise by
the local slope. The reported standard deviations are widened if errors of prediction
exceed their stated standard deviation.
"""

from typing import ClassVar, NamedTuple, cast

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from tirefit.arrays import Number
from tirefit.models import Asymmetric, Brush
from tirefit.online import base
from tirefit.params import par

_PRIOR = 0.4, 0.5  # relative std of the expected c_p a^2 and mu
_DRIFT = 0.005, 0.02  # relative random walk of c_p a^2 and mu [1/sqrt(s)]


class EkfState(NamedTuple):
    """Logarithms of c_p a^2 [N] and mu, their covariance, mean square surprise."""

    x: Float[Array, "2"]
    covariance: Float[Array, "2 2"]
    misfit: Number


class Ekf(base.AbstractEstimator):
    """Extended Kalman filter of stiffness and friction through the brush."""

    method: ClassVar[base.Method] = base.Method(
        "ekf", "extended Kalman filter through the brush model", ("sigma_x", "fx", "fz"),
        ("mu", "cpa2"), "35 to 100 % of the friction, sliding included; below, mu is flagged",
        "S(29), Kalman filter",
    )  # fmt: skip

    cpa2: float = base.nominal_stiffness()
    mu: float = base.nominal_friction(0.98)
    d: float = par(0.0, (-0.33, 0.99), "-", "asymmetry of the pressure")
    force_noise: float = base.force_noise(0.0447)
    slip_noise: float = base.slip_noise()
    least_use: float = base.excitation()

    def init(self) -> EkfState:
        x = jnp.log(base.floats(self.cpa2, self.mu))
        return EkfState(x, jnp.diag(base.floats(*_PRIOR) ** 2), jnp.ones(()))

    def force(self, x: Float[Array, "2"], sigma: Number, fz: Number) -> Number:
        """Force [N] of the brush at a state (2,) of logarithms, S(29)."""
        cpa2, mu = cast(tuple[float, float], (jnp.exp(x[0]), jnp.exp(x[1])))
        tire = Brush(cpa2, mu, pressure=Asymmetric(self.d))
        return tire.pure(sigma, fz, 0.0)[0]

    def update(self, state: EkfState, sample: base.Sample) -> base.Updated:
        (sigma, fx), fz, count = base.braking(sample), sample["fz"], sample["count"]
        by_state, by_slip = jax.jacfwd(self.force, argnums=(0, 1))(state.x, sigma, fz)
        noise = ((self.force_noise * fz) ** 2 + (self.slip_noise * by_slip) ** 2) / count
        error = fx - self.force(state.x, sigma, fz)
        given = state.covariance, by_state[None], error[None], noise[None, None]
        x, covariance, spread = base.kalman_update(state.x, *given)
        surprise = error / jnp.sqrt(spread[0, 0])
        # The largest step of a logarithm per sample for which the slope is valid.
        x = state.x + jnp.clip(x - state.x, -1.0, 1.0)
        # A memory of about 50 steps.
        misfit = 0.98 * state.misfit + 0.02 * surprise * surprise
        idle = 2 * self.cpa2 * sigma < self.least_use * fz
        after = base.choose(idle, state, EkfState(x, covariance, misfit))
        flag = base.flag_of((idle, base.Flag.LITTLE_EXCITATION))
        return after, flag, jnp.where(idle, jnp.nan, surprise)

    def wait(self, state: EkfState, dt: Number, steps: Number) -> EkfState:
        grown = jnp.diag(base.floats(*_DRIFT) ** 2) * dt
        return state._replace(covariance=state.covariance + grown)

    def open(self, state: EkfState) -> EkfState:
        """The initial uncertainty of both is restored, without their correlation."""
        return state._replace(covariance=base.widest(state.covariance, self.init().covariance))

    def estimate(self, state: EkfState) -> base.Estimate:
        widened = jnp.sqrt(jnp.maximum(state.misfit, 1.0))
        relative = (widened * jnp.sqrt(jnp.diag(state.covariance)))[::-1]
        value = jnp.exp(state.x)[::-1]
        return base.Estimate(value, value * relative)
