r"""Recursive least squares on the brush, S(50)-(51), and the MIT rule, S(52).

S(50) subtracts the cubic term, with the previous estimate, from the output, which gives a linear
regression: :math:`y' = y - \theta_2 u_2` with :math:`\theta_2 = \theta_1^2 / \theta_0`. As printed,
this is done once for each sample, so the errors of the first, poor estimates stay in the memory.
Here y and :math:`u_2` are regressed separately, with the same gain; with their coefficients
:math:`\varphi` and :math:`\psi` the estimate is :math:`\theta = \varphi - \theta_2 \psi`, which
uses the newest :math:`\theta_2` for all samples. For a constant :math:`\theta_2` both agree.

The covariance is :math:`s^2 M^{-1} P M^{-T}` with :math:`M = I + \psi \nabla\theta_2^T`
and :math:`s^2` the weighted mean square of the errors of prediction. With forgetting, it
allows for a change; for a constant tire its errors are too wide by about sqrt(2).
"""

from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from tirefit.online.base import Estimate, Method, Sample, choose
from tirefit.online.regression import AbstractRegression
from tirefit.params import par

_SAMPLES_OF_NOISE = 20.0
"""Weight, in samples, of the stated noise relative to the observed errors."""
_LEAST_THETA = 1e-3


class RlsState(NamedTuple):
    """theta [-] with the coefficients of y and u_2 from which it follows, P over the
    variance of the noise, and the weighted squares of the errors."""

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

    P0 = diag(2, 10) 1e-10 of the source is for regressors in newtons; times F_z^2 it is
    diag(0.146, 0.729) at its 27 kN. With the noise of the source, theta would be known to
    0.017 and 0.038 at the start, although its error is 0.2. Here the priors are realistic:
    P0 = prior^2 / noise^2.
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
        # The mean of several samples has the weight of all of them.
        gain = count / (forget + count * spread)
        theta2 = s.theta1 * s.theta1 / s.theta0
        error = x.y - s.theta0 * x.u0 - s.theta1 * x.u1 - theta2 * x.u2
        square = count * error * error / (1 + count * spread)
        of_y = gain * (x.y - s.phi0 * x.u0 - s.phi1 * x.u1)
        of_u2 = gain * (x.u2 - s.psi0 * x.u0 - s.psi1 * x.u1)
        phi0, phi1 = s.phi0 + k0 * of_y, s.phi1 + k1 * of_y
        psi0, psi1 = s.psi0 + k0 * of_u2, s.psi1 + k1 * of_u2
        updated = RlsState(
            # S(50) divides by theta_0: limit it to a thousandth of the expected value.
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
        """P increased, at most to its initial value, to prevent wind-up."""
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

    The rule gives no uncertainty. As it is linear in the error, the covariance follows from that of
    the noise and of the start: :math:`P \leftarrow (I - k g^T) P (I - k g^T)^T + k k^T s^2`, with g
    the slope of the prediction and :math:`k = \Gamma g`.

    The gains (0.5, 3) 1e-10 of the source are for regressors in newtons; times F_z^2 they
    are (0.0364, 0.219) at its 27 kN. These are dimensionless and apply to every load.
    """

    method: ClassVar[Method] = Method(
        "mit",
        "gradient (MIT) rule on the brush",
        ("sigma_x", "fx", "fz"),
        ("mu", "cpa2"),
        "35 to 90 % of the friction for minutes; below, mu is flagged",
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
        # The mean of several samples moves the estimate as far as all of them.
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
        """The state is not changed, as the rule has no model of change over time."""
        return state, self.estimate(*state, False, False, jnp.nan)

    def open(self, state: MitState) -> MitState:
        """The gains are kept; only the stated uncertainty is restored."""
        return state._replace(
            v00=jnp.maximum(state.v00, self.prior0**2),
            v01=jnp.zeros_like(state.v01),
            v11=jnp.maximum(state.v11, self.prior1**2),
        )
