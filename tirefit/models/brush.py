r"""The brush model: a pressure law composed with a friction law.

A bristle at :math:`\xi` demands :math:`c \sigma (1-\xi)`, with :math:`c = c_p a^2`; the
road gives up to :math:`\mu_s F_z p(\xi)`. It sticks from the leading edge to the
breakaway point :math:`\xi_s` and slides behind it:

.. math:: F = \mu_k F_z P(\xi_s) + \tfrac12 c \sigma (1-\xi_s)^2

S(12), (14), (29), (31)-(37) are all cases of this line, and the first moment of the
same integrand gives the aligning moment.
"""

import equinox as eqx
import jax.numpy as jnp

from tirefit.models.base import AbstractTire, TireForces, TireInputs
from tirefit.models.friction import Friction, Kinetic
from tirefit.models.pressure import AbstractPressure, Parabolic
from tirefit.params import par
from tirefit.slip import kappa_from_sigma

__all__ = ["Brush", "BrushAtPeak", "mu_from_peak", "needs_speed", "peak_from_mu"]


def _stiffness():
    return par(
        5e4, (1e-2, 1e9), "N", "bristle stiffness c_p a^2; C_x = 2 c_p a^2",
        "S(12)", r"c_p a^2", scale="log",
    )  # fmt: skip


def _half_length():
    return par(
        0.1, (1e-3, 1.0), "m", "half the contact length (aligning moment only)",
        "S(9)", "a", free=False, scale="log",
    )  # fmt: skip


class Brush(AbstractTire):
    """Brush model of pure slip with any pressure and friction law."""

    cpa2: float = _stiffness()
    mu: float = par(
        1.0, (0.01, 5.0), "-", "static friction coefficient mu_s", "S(12)", r"\mu"
    )
    half_length: float = _half_length()
    pressure: AbstractPressure = Parabolic()
    friction: Friction = Friction()

    def pure(self, slip, fz, v_s):
        """Force [N] and moment over half-length [N] of pure slip, any sign.

        Args:
            slip: physical slip sigma [-].
            fz: load [N]; no load, no force.
            v_s: sliding speed of the contact patch [m/s], >= 0.
        """
        loaded = fz > 0
        load = jnp.where(loaded, fz, 1.0)
        demand = self.cpa2 * jnp.abs(slip)
        # Friction that falls with speed may reach zero; the demand ratio must not.
        mu_s = jnp.maximum(self.friction.static(self.mu, v_s), 1e-6)
        mu_k = self.friction.kinetic(self.mu, v_s)
        u = self.pressure.breakaway(demand / (mu_s * load))
        sticking = 2 - u
        force = mu_k * load * self.pressure.cdf(u) + demand * sticking**2 / 2
        moment = mu_k * load * self.pressure.moment(u) + demand * (
            sticking**2 / 2 - sticking**3 / 3
        )
        # where(slip < 0), not sign(slip): its zero at rest would kill the slope there.
        direction = jnp.where(slip < 0, -1.0, 1.0) * loaded
        return direction * force, direction * moment

    def __call__(self, inputs: TireInputs) -> TireForces:
        tan_alpha = jnp.tan(inputs.alpha)
        v_sx = jnp.abs(inputs.v * kappa_from_sigma(inputs.sigma_x))
        v_sy = jnp.abs(inputs.v * tan_alpha)
        fx, _ = self.pure(inputs.sigma_x, inputs.fz, v_sx)
        fy, moment = self.pure(tan_alpha, inputs.fz, v_sy)
        return TireForces(fx, fy, self.half_length * moment)


def mu_from_peak(mu_peak, m):
    """Static friction of a brush-m whose largest force is mu_peak F_z, from S(33)."""
    return mu_peak * (3 - 2 * m) ** 2 / (4 - 3 * m)


def peak_from_mu(mu, m):
    """Peak force over load of a brush-m with static friction mu, S(33)."""
    return mu * (4 - 3 * m) / (3 - 2 * m) ** 2


class BrushAtPeak(AbstractTire):
    """``brush-m`` with the peak F_max / F_z as its parameter, S(34) corrected."""

    cpa2: float = _stiffness()
    mu_peak: float = par(
        1.0, (0.01, 5.0), "-", "peak friction mu' = F_max / F_z", "S(33)", r"\mu'"
    )
    half_length: float = _half_length()
    kinetic: Kinetic = Kinetic()

    def as_brush(self) -> Brush:
        """The same tire in terms of its static friction."""
        mu = mu_from_peak(self.mu_peak, self.kinetic.m)
        return Brush(
            self.cpa2, mu, self.half_length, Parabolic(), Friction((self.kinetic,))
        )

    def __call__(self, inputs: TireInputs) -> TireForces:
        return self.as_brush()(inputs)


def needs_speed(model: eqx.Module) -> bool:
    """Whether the model's force depends on the forward speed."""
    return isinstance(model, Brush) and model.friction.depends_on_speed
