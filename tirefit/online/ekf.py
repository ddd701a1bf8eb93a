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

from tirefit.arrays import Number, Scalar
from tirefit.models import Asymmetric, Brush
from tirefit.online import base
from tirefit.online.base import AbstractEstimator, Estimate, Flag, Method, Sample, choose, flag_of
from tirefit.params import par

_MEMORY = 0.98  # weight of the previous mean square of surprises: a memory of about 50 steps
_FARTHEST = 1.0  # largest step of a logarithm per sample, where the slope is valid


class EkfState(NamedTuple):
    """Logarithms of c_p a^2 [N] and mu, their covariance, mean square surprise."""

    x: Float[Array, "2"]
    covariance: Float[Array, "2 2"]
    misfit: Number


class Ekf(AbstractEstimator):
    """Extended Kalman filter of stiffness and friction through the brush."""

    method: ClassVar[Method] = Method(
        "ekf", "extended Kalman filter through the brush model", ("sigma_x", "fx", "fz"),
        ("mu", "cpa2"), "35 to 100 % of the friction, sliding included; below, mu is flagged",
        "S(29), Kalman filter",
    )  # fmt: skip

    cpa2: float = base.nominal_stiffness()
    mu: float = base.nominal_friction()
    d: float = par(0.0, (-0.33, 0.99), "-", "asymmetry of the pressure", "S(29)", "d")
    prior_cpa2: float = par(
        0.4, (1e-4, 3.0), "-", "relative std of the expected c_p a^2", "", r"\sigma_c"
    )
    prior_mu: float = par(
        0.5, (1e-4, 3.0), "-", "relative std of the expected mu", "", r"\sigma_\mu"
    )
    drift_cpa2: float = par(
        0.005, (0.0, 1.0), "1/sqrt(s)", "relative random walk of c_p a^2", "", "q_c"
    )
    drift_mu: float = par(0.02, (0.0, 1.0), "1/sqrt(s)", "relative random walk of mu", "", r"q_\mu")
    force_noise: float = base.force_noise()
    slip_noise: float = base.slip_noise()
    least_use: float = base.excitation()

    def init(self) -> EkfState:
        return EkfState(jnp.log(base.floats(self.cpa2, self.mu)), self._prior(), jnp.ones(()))

    def force(self, x: Float[Array, "2"], sigma: Number, fz: Number) -> Number:
        """Force [N] of the brush at a state (2,) of logarithms, S(29)."""
        cpa2, mu = cast(tuple[float, float], (jnp.exp(x[0]), jnp.exp(x[1])))
        tire = Brush(cpa2, mu, pressure=Asymmetric(self.d))
        return tire.pure(sigma, fz, 0.0)[0]

    def step(self, state: EkfState, sample: Sample) -> tuple[EkfState, Estimate]:
        (sigma, fx), fz, count = base.braking(sample), sample["fz"], sample["count"]
        predicted = self.force(state.x, sigma, fz)
        by_state, by_slip = jax.jacfwd(self.force, argnums=(0, 1))(state.x, sigma, fz)
        noise = ((self.force_noise * fz) ** 2 + (self.slip_noise * by_slip) ** 2) / count
        error = fx - predicted
        lever = state.covariance @ by_state
        spread = by_state @ lever + noise
        surprise = error / jnp.sqrt(spread)
        change = jnp.clip(lever * error / spread, -_FARTHEST, _FARTHEST)
        updated = EkfState(
            state.x + change,
            state.covariance - jnp.outer(lever, lever) / spread,
            _MEMORY * state.misfit + (1 - _MEMORY) * surprise * surprise,
        )
        idle = 2 * self.cpa2 * sigma < self.least_use * fz
        after = choose(idle, state, updated)
        return after, self._estimate(after, idle, jnp.where(idle, jnp.nan, surprise))

    def hold(self, state: EkfState, dt: Number, steps: Number) -> tuple[EkfState, Estimate]:
        grown = jnp.diag(base.floats(self.drift_cpa2, self.drift_mu) ** 2) * dt
        held = state._replace(covariance=state.covariance + grown)
        return held, self._estimate(held, False, jnp.nan)

    def open(self, state: EkfState) -> EkfState:
        """The initial uncertainty of both is restored, without their correlation."""
        return state._replace(covariance=base.widest(state.covariance, self._prior()))

    def _prior(self) -> Float[Array, "2 2"]:
        return jnp.diag(base.floats(self.prior_cpa2, self.prior_mu) ** 2)

    def _estimate(self, state: EkfState, idle: base.Condition, surprise: Scalar) -> Estimate:
        widened = jnp.sqrt(jnp.maximum(state.misfit, 1.0))
        relative = (widened * jnp.sqrt(jnp.diag(state.covariance)))[::-1]
        value = jnp.exp(state.x)[::-1]
        flag = flag_of((idle, Flag.LITTLE_EXCITATION))
        return Estimate(value, value * relative, flag, jnp.asarray(surprise))
