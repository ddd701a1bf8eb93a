r"""The MIT rule on the brush, S(52): a step down the slope of the squared error.

The rule gives no uncertainty; it is linear in the error, so that its covariance follows
from that of the noise and of the start:
:math:`P \leftarrow (I - k g^T) P (I - k g^T)^T + k k^T s^2`, with g the slope of the
prediction and :math:`k = \Gamma g`.
"""

from typing import ClassVar, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from tirefit.online.base import Estimate, Method, Sample, choose
from tirefit.online.regression import AbstractRegression
from tirefit.params import par

_LEAST_THETA = 1e-3


class MitState(NamedTuple):
    """theta [-] and its covariance."""

    theta0: Float[Array, ""]
    theta1: Float[Array, ""]
    v00: Float[Array, ""]
    v01: Float[Array, ""]
    v11: Float[Array, ""]


class Mit(AbstractRegression):
    """The MIT rule for stiffness and friction.

    The source's gains (0.5, 3) 1e-10 go with regressors in newtons; times F_z^2 they
    are (0.0364, 0.219) at its 27 kN. Being dimensionless now, they suit every load.
    """

    method: ClassVar[Method] = Method(
        "mit", "gradient (MIT) rule on the brush",
        ("sigma_x", "fx", "fz"), ("mu", "cpa2"),
        "35 to 90 % of the friction, minutes of it; below, mu is flagged", "S(52)",
    )  # fmt: skip

    gain0: float = par(
        0.0364, (0.0, 1.0), "-", "gain of theta_0 a sample", "S §5.3", r"\gamma_0"
    )
    gain1: float = par(
        0.219, (0.0, 1.0), "-", "gain of theta_1 a sample", "S §5.3", r"\gamma_1"
    )

    def init(self) -> MitState:
        values = (self.start0, self.start1, self.prior0**2, 0.0, self.prior1**2)
        return MitState(*(jnp.asarray(value, float) for value in values))

    def step(self, state: MitState, sample: Sample) -> tuple[MitState, Estimate]:
        s, x, count = state, self.regressors(sample), sample["count"]
        ratio = s.theta1 / s.theta0
        error = x.y - s.theta0 * x.u0 - s.theta1 * x.u1 - s.theta1 * ratio * x.u2
        # The slope of the prediction S(49).
        g0, g1 = x.u0 - ratio * ratio * x.u2, x.u1 + 2 * ratio * x.u2
        noise = self.force_noise * self.force_noise / count
        h0, h1 = s.v00 * g0 + s.v01 * g1, s.v01 * g0 + s.v11 * g1
        spread = g0 * h0 + g1 * h1 + noise
        # A mean of so many samples moves as far as they all.
        k0, k1 = count * self.gain0 * g0, count * self.gain1 * g1
        updated = MitState(
            jnp.maximum(s.theta0 + k0 * error, _LEAST_THETA),
            s.theta1 + k1 * error,
            s.v00 - 2 * k0 * h0 + k0 * k0 * spread,
            s.v01 - k0 * h1 - k1 * h0 + k0 * k1 * spread,
            s.v11 - 2 * k1 * h1 + k1 * k1 * spread,
        )
        idle, slides = self.beyond(x, s.theta0, count)
        after: MitState = choose(idle | slides, state, updated)
        surprise = jnp.where(idle | slides, jnp.nan, error / jnp.sqrt(spread))
        return after, self.estimate(*after, idle, slides, surprise)

    def hold(self, state: MitState, dt, steps) -> tuple[MitState, Estimate]:
        """Nothing moves: the rule has no notion of what changes in the meantime."""
        return state, self.estimate(*state, False, False, jnp.nan)

    def open(self, state: MitState) -> MitState:
        """The gains stay; only what is claimed of the accuracy goes back."""
        return state._replace(
            v00=jnp.maximum(state.v00, self.prior0**2),
            v01=jnp.zeros_like(state.v01),
            v11=jnp.maximum(state.v11, self.prior1**2),
        )
