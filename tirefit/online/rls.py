r"""Recursive least squares on the brush, S(50)-(51), and the MIT rule, S(52).

S(50) subtracts the cubic term, with the previous estimate, from the output, which gives a linear
regression: :math:`y' = y - \theta_2 u_2` with :math:`\theta_2 = \theta_1^2 / \theta_0`. As printed,
the errors of the first, poor estimates stay in the memory. Here y and :math:`u_2` are regressed
separately, with one gain; with their coefficients :math:`\varphi` and :math:`\psi` the estimate
:math:`\theta = \varphi - \theta_2 \psi` uses the newest :math:`\theta_2` for all samples.

The covariance is :math:`s^2 M^{-1} P M^{-T}` with :math:`M = I + \psi \nabla\theta_2^T`
and :math:`s^2` the weighted mean square of the errors of prediction. With forgetting, it
allows for a change; for a constant tire its errors are too wide by about sqrt(2).
"""

from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from tirefit.arrays import Number, Scalar
from tirefit.online import base
from tirefit.online.regression import AbstractRegression, corrected, limited
from tirefit.params import par


class RlsState(NamedTuple):
    """theta [-] with the coefficients of y and of u_2 from which it follows, P over the
    variance of the noise, and the weighted squares of the errors."""

    theta: Float[Array, "2"]
    of_y: Float[Array, "2"]
    of_u2: Float[Array, "2"]
    p: Float[Array, "2 2"]
    squares: Number
    weight: Number


class Rls(AbstractRegression):
    """Recursive least squares of stiffness and friction.

    P0 = diag(2, 10) 1e-10 of the source (for regressors in newtons) states theta to 0.017 and
    0.038 at the start, although its error is 0.2. Here it is P0 = prior^2 / noise^2.
    """

    method: ClassVar[base.Method] = base.Method(
        "rls",
        "recursive least squares with forgetting on the brush",
        ("sigma_x", "fx", "fz"),
        ("mu", "cpa2"),
        "35 to 90 % of the friction; below, mu is flagged",
        "S(50)-(51)",
    )

    forgetting: float = par(0.999, (0.5, 1.0), "-", "forgetting factor per sample")

    def init(self) -> RlsState:
        theta = base.floats(self.start0, self.start1)
        # Weight, in samples, of the stated noise relative to the observed errors.
        errors = 20.0 * base.floats(self.force_noise**2, 1.0)
        return RlsState(theta, theta, jnp.zeros(2), self._first(), *errors)

    def update(self, state: RlsState, sample: base.Sample) -> base.Updated:
        s, x, count = state, self.regressors(sample), sample["count"]
        forget = self.forgetting**count
        k = s.p @ x.u
        spread = x.u @ k
        # The mean of several samples has the weight of all of them.
        scale = count / (forget + count * spread)
        gain = scale * k
        theta2 = s.theta[1] ** 2 / s.theta[0]
        error = x.y - s.theta @ x.u - theta2 * x.u2
        of_y = s.of_y + gain * (x.y - s.of_y @ x.u)
        of_u2 = s.of_u2 + gain * (x.u2 - s.of_u2 @ x.u)
        updated = RlsState(
            limited(of_y - theta2 * of_u2),
            of_y,
            of_u2,
            # Exactly symmetric: forgetting would multiply a difference by e in 1000 samples.
            self._forgotten(s.p - scale * jnp.outer(k, k), 1 / forget),
            forget * s.squares + count * error**2 / (1 + count * spread),
            forget * s.weight + 1,
        )
        unused, flag = self.beyond(x, s.theta[0], count)
        surprise = error / jnp.sqrt(s.squares / s.weight * (1 / count + spread))
        return base.choose(unused, state, updated), flag, jnp.where(unused, jnp.nan, surprise)

    def wait(self, state: RlsState, dt: Number, steps: Number) -> RlsState:
        # A branch, as nearly every row comes without lost samples.
        p = jax.lax.cond(
            steps > 0,
            lambda: self._forgotten(state.p, self.forgetting ** (-steps)),
            lambda: state.p,
        )
        return state._replace(p=p)

    def open(self, state: RlsState) -> RlsState:
        p = base.widest(state.p, self._first())
        return state._replace(of_y=state.theta, of_u2=jnp.zeros(2), p=p)

    def _first(self) -> Float[Array, "2 2"]:
        """P of the first theta."""
        return self.prior() / self.force_noise**2

    def _forgotten(self, p: Float[Array, "2 2"], growth: Scalar) -> Float[Array, "2 2"]:
        """P increased, at most to its initial value, to prevent wind-up."""
        room = jnp.min(jnp.diag(self._first()) / jnp.diag(p))
        return p * jnp.clip(room, 1.0, growth)

    def estimate(self, state: RlsState) -> base.Estimate:
        s = state
        ratio = s.theta[1] / s.theta[0]
        slope = jnp.stack([-(ratio**2), 2 * ratio])  # of theta_2 over theta
        # M^-1 = I - gain slope^T, by Sherman and Morrison.
        gain = s.of_u2 / (1 + jnp.sum(slope * s.of_u2))
        covariance = s.squares / s.weight * corrected(s.p, gain, slope, 0.0)
        return self.of_theta(s.theta, covariance)


class MitState(NamedTuple):
    """theta [-], its covariance by noise and start, and its derivative by a constant error of
    the force over the load."""

    theta: Float[Array, "2"]
    covariance: Float[Array, "2 2"]
    by_offset: Float[Array, "2"]


class Mit(AbstractRegression):
    r"""The MIT rule on the brush, S(52): a step down the slope of the squared error.

    The rule gives no uncertainty. As it is linear in the error, the covariance follows from that of
    the noise and of the start: :math:`P \leftarrow (I - k g^T) P (I - k g^T)^T + k k^T s^2`, with g
    the slope of the prediction and :math:`k = \Gamma g`.

    That noise averages out; what the model misses does not. A constant error b of the force over
    the load moves theta by :math:`m b`, :math:`m \leftarrow (I - k g^T) m + k`, with which the
    error of mu goes on five measured logs. The stated covariance is :math:`P + s_b^2 m m^T`.

    The gains (0.5, 3) 1e-10 of the source are for regressors in newtons; times F_z^2 they
    are (0.0364, 0.219) at its 27 kN. These are dimensionless and apply to every load.
    """

    method: ClassVar[base.Method] = base.Method(
        "mit",
        "gradient (MIT) rule on the brush",
        ("sigma_x", "fx", "fz"),
        ("mu", "cpa2"),
        "35 to 90 % of the friction for minutes; below, mu is flagged",
        "S(52)",
    )

    gain0: float = par(0.0364, (0.0, 1.0), "-", "gain of theta_0 a sample")
    gain1: float = par(0.219, (0.0, 1.0), "-", "gain of theta_1 a sample")
    # Chosen on the rear axle of the f1tenth car on tires a, see fits/friction_benchmark.
    offset: float = par(0.06, (0.0, 1.0), "-", "std of a constant force error over the load")

    def init(self) -> MitState:
        return MitState(base.floats(self.start0, self.start1), self.prior(), jnp.zeros(2))

    def update(self, state: MitState, sample: base.Sample) -> base.Updated:
        s, x, count = state, self.regressors(sample), sample["count"]
        ratio = s.theta[1] / s.theta[0]
        error = x.y - s.theta @ x.u - s.theta[1] * ratio * x.u2
        # The slope of the prediction S(49).
        g = x.u + x.u2 * jnp.stack([-(ratio**2), 2 * ratio])
        noise = self.force_noise**2 / count
        spread = g @ s.covariance @ g + noise
        # The mean of several samples moves the estimate as far as all of them.
        k = count * base.floats(self.gain0, self.gain1) * g
        covariance = corrected(s.covariance, k, g, noise)
        by_offset = s.by_offset + k * (1 - g @ s.by_offset)
        updated = MitState(limited(s.theta + k * error), covariance, by_offset)
        unused, flag = self.beyond(x, s.theta[0], count)
        surprise = jnp.where(unused, jnp.nan, error / jnp.sqrt(spread))
        return base.choose(unused, state, updated), flag, surprise

    def estimate(self, state: MitState) -> base.Estimate:
        missed = self.offset**2 * jnp.outer(state.by_offset, state.by_offset)
        return self.of_theta(state.theta, state.covariance + missed)

    def open(self, state: MitState) -> MitState:
        """The gains are kept; only the stated uncertainty is restored."""
        return state._replace(covariance=base.widest(state.covariance, self.prior()))
