r"""Recursive least squares on the brush, S(50)-(51), and the MIT rule, S(52).

The cubic term goes to the output with the estimate before, S(50), which leaves a linear
regression: :math:`y' = y - \theta_2 u_2` with :math:`\theta_2 = \theta_1^2 / \theta_0`.
Done once for each sample, as printed, the terms that were moved with the first, poor
estimates stay in its memory. Here y and :math:`u_2` are regressed apart, with one gain:
of coefficients :math:`\varphi` and :math:`\psi` the estimate is
:math:`\theta = \varphi - \theta_2 \psi`, all samples moved with the newest
:math:`\theta_2`. Where :math:`\theta_2` stands still, both are the same.

The covariance is :math:`s^2 M^{-1} P M^{-T}` with :math:`M = I + \psi \nabla\theta_2^T`
and :math:`s^2` the weighted mean square of the errors of prediction; of a tire that
does not change it is some sqrt(2) too wide with forgetting, as it allows for a change.
"""

from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from tirefit.online.base import Estimate, Method, Sample, choose
from tirefit.online.regression import AbstractRegression
from tirefit.params import par

_SAMPLES_OF_NOISE = 20.0
"""Samples for which the stated noise counts beside the errors that are seen."""
_LEAST_THETA = 1e-3


class RlsState(NamedTuple):
    """theta [-] and the coefficients of y and u_2 that it is of, P over the variance of
    the noise, and the errors' weighted squares."""

    theta0: Float[Array, ""]
    theta1: Float[Array, ""]
    phi0: Float[Array, ""]
    phi1: Float[Array, ""]
    psi0: Float[Array, ""]
    psi1: Float[Array, ""]
    p00: Float[Array, ""]
    p01: Float[Array, ""]
    p11: Float[Array, ""]
    squares: Float[Array, ""]
    weight: Float[Array, ""]


class Rls(AbstractRegression):
    """Recursive least squares of stiffness and friction.

    The source's P0 = diag(2, 10) 1e-10 goes with regressors in newtons; times F_z^2 it
    is diag(0.146, 0.729) at its 27 kN, which with the source's noise means that theta
    is known to 0.017 and 0.038 beforehand, though it starts 0.2 off. The priors here
    are honest ones instead: P0 = prior^2 / noise^2.
    """

    method: ClassVar[Method] = Method(
        "rls",
        "recursive least squares with forgetting on the brush",
        ("sigma_x", "fx", "fz"),
        ("mu", "cpa2"),
        "35 to 90 % of the friction; below, mu is flagged",
        "S(50)-(51)",
    )

    forgetting: float = par(
        0.999, (0.5, 1.0), "-", "forgetting factor per sample", "S §5.3", r"\lambda"
    )

    def init(self) -> RlsState:
        p00, p11 = self._prior()
        noise = self.force_noise * self.force_noise
        values = (
            self.start0, self.start1, self.start0, self.start1, 0.0, 0.0,
            p00, 0.0, p11, _SAMPLES_OF_NOISE * noise, _SAMPLES_OF_NOISE,
        )  # fmt: skip
        return RlsState(*(jnp.asarray(value, float) for value in values))

    def step(self, state: RlsState, sample: Sample) -> tuple[RlsState, Estimate]:
        x = self.regressors(sample)
        s, count = state, sample["count"]
        forget = self.forgetting**count
        k0 = s.p00 * x.u0 + s.p01 * x.u1
        k1 = s.p01 * x.u0 + s.p11 * x.u1
        spread = x.u0 * k0 + x.u1 * k1
        # A mean of so many samples counts as them all.
        gain = count / (forget + count * spread)
        theta2 = s.theta1 * s.theta1 / s.theta0
        error = x.y - s.theta0 * x.u0 - s.theta1 * x.u1 - theta2 * x.u2
        square = count * error * error / (1 + count * spread)
        of_y = gain * (x.y - s.phi0 * x.u0 - s.phi1 * x.u1)
        of_u2 = gain * (x.u2 - s.psi0 * x.u0 - s.psi1 * x.u1)
        phi0, phi1 = s.phi0 + k0 * of_y, s.phi1 + k1 * of_y
        psi0, psi1 = s.psi0 + k0 * of_u2, s.psi1 + k1 * of_u2
        updated = RlsState(
            # S(50) divides by it; no tire is a thousand times softer than expected.
            jnp.maximum(phi0 - theta2 * psi0, _LEAST_THETA),
            phi1 - theta2 * psi1,
            phi0,
            phi1,
            psi0,
            psi1,
            *self._forgotten(
                s.p00 - gain * k0 * k0, s.p01 - gain * k0 * k1, s.p11 - gain * k1 * k1, 1 / forget
            ),
            forget * s.squares + square,
            forget * s.weight + 1,
        )
        idle, slides = self.beyond(x, s.theta0, count)
        unused = idle | slides
        surprise = error / jnp.sqrt(s.squares / s.weight * (1 / count + spread))
        after = choose(unused, state, updated)
        surprise = jnp.where(unused, jnp.nan, surprise)
        return after, self._estimate(after, idle, slides, surprise)

    def hold(self, state: RlsState, dt, steps) -> tuple[RlsState, Estimate]:
        p = (state.p00, state.p01, state.p11)
        p = jax.lax.cond(
            steps > 0, lambda: self._forgotten(*p, self.forgetting ** (-steps)), lambda: p
        )
        held = state._replace(p00=p[0], p01=p[1], p11=p[2])
        return held, self._estimate(held, False, False, jnp.nan)

    def open(self, state: RlsState) -> RlsState:
        p00, p11 = self._prior()
        nothing = jnp.zeros_like(state.psi0)
        return state._replace(
            phi0=state.theta0,
            phi1=state.theta1,
            psi0=nothing,
            psi1=nothing,
            p00=jnp.maximum(p00, state.p00),
            p01=nothing,
            p11=jnp.maximum(p11, state.p11),
        )

    def _prior(self):
        noise = self.force_noise * self.force_noise
        return self.prior0 * self.prior0 / noise, self.prior1 * self.prior1 / noise

    def _forgotten(self, p00, p01, p11, growth) -> tuple[Array, Array, Array]:
        """P grown, but not beyond what was known at first: no wind-up."""
        first0, first1 = self._prior()
        room = jnp.minimum(first0 / p00, first1 / p11)
        growth = jnp.clip(room, 1.0, growth)
        return p00 * growth, p01 * growth, p11 * growth

    def _estimate(self, s: RlsState, idle, slides, surprise) -> Estimate:
        variance = s.squares / s.weight
        ratio = s.theta1 / s.theta0
        to0, to1 = -ratio * ratio, 2 * ratio
        m00, m01 = 1 + s.psi0 * to0, s.psi0 * to1
        m10, m11 = s.psi1 * to0, 1 + s.psi1 * to1
        scale = variance / (m00 * m11 - m01 * m10) ** 2

        def spread(a0, a1, b0, b1):
            """Covariance of two rows of M^-1 times its determinant."""
            return scale * (a0 * b0 * s.p00 + (a0 * b1 + a1 * b0) * s.p01 + a1 * b1 * s.p11)

        one, two = (m11, -m01), (-m10, m00)
        return self.estimate(
            s.theta0,
            s.theta1,
            spread(*one, *one),
            spread(*one, *two),
            spread(*two, *two),
            idle,
            slides,
            surprise,
        )


class MitState(NamedTuple):
    """theta [-] and its covariance."""

    theta0: Float[Array, ""]
    theta1: Float[Array, ""]
    v00: Float[Array, ""]
    v01: Float[Array, ""]
    v11: Float[Array, ""]


class Mit(AbstractRegression):
    r"""The MIT rule on the brush, S(52): a step down the slope of the squared error.

    The rule gives no uncertainty; it is linear in the error, so that its covariance
    follows from that of the noise and of the start:
    :math:`P \leftarrow (I - k g^T) P (I - k g^T)^T + k k^T s^2`, with g the slope of
    the prediction and :math:`k = \Gamma g`.

    The source's gains (0.5, 3) 1e-10 go with regressors in newtons; times F_z^2 they
    are (0.0364, 0.219) at its 27 kN. Being dimensionless now, they suit every load.
    """

    method: ClassVar[Method] = Method(
        "mit",
        "gradient (MIT) rule on the brush",
        ("sigma_x", "fx", "fz"),
        ("mu", "cpa2"),
        "35 to 90 % of the friction, minutes of it; below, mu is flagged",
        "S(52)",
    )

    gain0: float = par(0.0364, (0.0, 1.0), "-", "gain of theta_0 a sample", "S §5.3", r"\gamma_0")
    gain1: float = par(0.219, (0.0, 1.0), "-", "gain of theta_1 a sample", "S §5.3", r"\gamma_1")

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
