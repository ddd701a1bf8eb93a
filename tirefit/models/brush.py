r"""The brush model: a pressure law composed with a friction law.

A bristle at :math:`\xi` demands :math:`c \sigma (1-\xi)`, with :math:`c = c_p a^2`; the
limit is :math:`\mu_s F_z p(\xi)`. Bristles stick from the leading edge to the breakaway
point :math:`\xi_s` and slide behind it:

.. math:: F = \mu_k F_z P(\xi_s) + \tfrac12 c \sigma (1-\xi_s)^2

S(12), (14), (29), (31)-(37) are all cases of this line, and the first moment of the
same integrand gives the aligning moment.

The contact half-length a grows with the load, S §2.1: it is proportional to :math:`F_z`
for a rectangular patch, to :math:`\sqrt{F_z}` for an elliptic one. So :math:`c_p a^2` is
proportional to :math:`F_z^2` or :math:`F_z`; measured tires have other powers.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array

from tirefit.arrays import Numbers, Scalar
from tirefit.models.base import AbstractTire, TireForces, TireInputs
from tirefit.models.friction import Friction, Kinetic
from tirefit.models.pressure import AbstractPressure, Parabolic
from tirefit.params import par, parameter_values, with_values
from tirefit.slip import kappa_from_sigma, lateral_slip


def bristle_stiffness(relation: str = "C_x = 2 c_p a^2", source: str = "S(12)") -> Any:
    """The field of c_p a^2, with its relation to the slip stiffness."""
    meaning = f"bristle stiffness c_p a^2; {relation}"
    return par(5e4, (1e-2, 1e9), "N", meaning, source, r"c_p a^2", scale="log")


friction_coefficient: Callable[[], Any] = partial(
    par, 1.0, (0.01, 5.0), "-", "static friction coefficient mu_s", "S(12)", r"\mu"
)
half_contact_length: Callable[[], Any] = partial(
    par, 0.1, (1e-3, 1.0), "m", "half the contact length (aligning moment only)", "S(9)", "a",
    free=False, scale="log",
)  # fmt: skip


class Brush(AbstractTire):
    """Brush model with any pressure and friction law, pure or combined slip.

    In combined slip every bristle deflects along the resultant physical slip (S §2.3,
    "Combined slip"): the force is the pure-slip force of its length, in its direction.
    The aligning moment is that of the lateral forces about the centre of a patch in the
    wheel plane (rigid carcass). The moment of the longitudinal force, which acts beside
    that plane because bristles are deflected sideways, is neglected.
    """

    cpa2: float = bristle_stiffness()
    mu: float = friction_coefficient()
    half_length: float = half_contact_length()
    pressure: AbstractPressure = Parabolic()
    friction: Friction = Friction()

    def pure(self, slip: Scalar, fz: Scalar, v_s: Scalar) -> tuple[Array, Array]:
        """Force [N] and moment over half-length [N] along the slip.

        Args:
            slip: physical slip sigma [-], >= 0.
            fz: load [N]; the force is zero at zero load.
            v_s: sliding speed of the contact patch [m/s], >= 0.
        """
        loaded = fz > 0
        load = jnp.where(loaded, fz, 1.0)
        demand = self.cpa2 * slip
        # Friction that falls with speed may reach zero, but the demand ratio must be finite.
        mu_s = jnp.maximum(self.friction.static(self.mu, v_s), 1e-6)
        mu_k = self.friction.kinetic(self.mu, v_s)
        rho = demand / (mu_s * load)
        pressure, u = self.pressure, self.pressure.breakaway(rho)
        sticking = 2 - u
        force = load * mu_k * pressure.cdf(u) + demand * sticking**2 / 2
        moment = load * mu_k * pressure.moment(u) + demand * (sticking**2 / 2 - sticking**3 / 3)
        return force * loaded, moment * loaded

    @property
    def needs(self) -> tuple[str, ...]:
        return ("v",) if self.friction.depends_on_speed else ()

    def __call__(self, inputs: TireInputs) -> TireForces:
        tan_alpha = jnp.tan(inputs.alpha)
        slip_x = inputs.sigma_x
        slip_y = self.stiffness_ratio * lateral_slip(tan_alpha, inputs.sigma_x)
        slip, along, across = polar(slip_x, slip_y)
        v_s = inputs.v * resultant(kappa_from_sigma(inputs.sigma_x), tan_alpha)
        force, moment = self.pure(slip, inputs.fz, v_s)
        return TireForces(along * force, across * force, self.half_length * across * moment)

    @property
    def stiffness_ratio(self) -> float:
        """Lateral over longitudinal bristle stiffness [-]: one, the isotropic brush."""
        return 1.0


class AnisotropicBrush(Brush):
    r"""Brush with different longitudinal and lateral bristle stiffness, O(12)-(20).

    .. math::
       \kappa_y = \frac{K_\beta}{K_s} \sigma_y, \quad
       \kappa = \sqrt{\sigma_x^2 + \kappa_y^2}, \quad
       F_x = F(\kappa) \frac{\sigma_x}{\kappa}, \quad
       F_y = F(\kappa) \frac{\kappa_y}{\kappa}

    The friction is isotropic. A sliding bristle keeps the direction of its deflection, as
    O assumes. In reality it turns towards its sliding velocity, so the force in full
    sliding is too close to the stiffer axis: by 18 degrees, a third of mu F_z, for a ratio
    of 1/2 and equal slips.
    """

    stiffness_ratio: float = par(
        0.7, (0.05, 20.0), "-", "lateral over longitudinal stiffness, K_beta / K_s", "O(13)",
        r"K_\beta / K_s", scale="log",
    )  # fmt: skip


def resultant(x: Numbers, y: Numbers) -> Array:
    """Length of (x, y), kept above zero so that its gradient is finite at rest."""
    return polar(jnp.asarray(x), jnp.asarray(y))[0]


@jax.custom_jvp
def polar(x: Numbers, y: Numbers) -> tuple[Array, Array, Array]:
    """Length of (x, y) as in :func:`resultant`, and the shares of x and y in it.

    The rule of differentiation divides at most by the square of the length; with its
    third power, second derivatives at rest would not be finite in 32 bit.
    """
    square = jnp.asarray(x**2 + y**2)
    length = jnp.sqrt(square + (1e-60 if square.dtype == jnp.float64 else 1e-36))
    return length, jnp.asarray(x / length), jnp.asarray(y / length)


@polar.defjvp
def _turned(
    at: tuple[Scalar, Scalar], change: tuple[Scalar, Scalar]
) -> tuple[tuple[Array, Array, Array], tuple[Array, Array, Array]]:
    length, along, across = polar(*at)
    steps = jnp.asarray(change[0]), jnp.asarray(change[1])
    longer = along * steps[0] + across * steps[1]
    sideway_x, sideway_y = (
        (step - share * longer) / length for share, step in zip((along, across), steps, strict=True)
    )
    return (length, along, across), (longer, sideway_x, sideway_y)


def mu_from_peak(mu_peak: float, m: float) -> float:
    """Static friction of a brush-m whose largest force is mu_peak F_z, from S(33)."""
    return mu_peak * (3 - 2 * m) ** 2 / (4 - 3 * m)


class BrushAtPeak(AbstractTire):
    """``brush-m`` with the peak F_max / F_z as its parameter, S(34) corrected."""

    cpa2: float = bristle_stiffness()
    mu_peak: float = par(1.0, (0.01, 5.0), "-", "peak friction mu' = F_max / F_z", "S(33)", r"\mu'")
    half_length: float = half_contact_length()
    kinetic: Kinetic = Kinetic()

    def __call__(self, inputs: TireInputs) -> TireForces:
        mu = mu_from_peak(self.mu_peak, self.kinetic.m)
        friction = Friction((self.kinetic,))
        return Brush(self.cpa2, mu, self.half_length, friction=friction)(inputs)


class LoadDependent(AbstractTire):
    r"""A brush whose stiffness, contact length and friction depend on the load.

    .. math::
       c_p a^2 = (c_p a^2)_0 \left(\frac{F_z}{F_{z0}}\right)^k, \quad
       a = a_0 \left(\frac{F_z}{F_{z0}}\right)^{k/2}, \quad
       \mu = \mu_0 + \mu_z \frac{F_z - F_{z0}}{F_{z0}}

    The parameters of the tire hold at the reference load :math:`F_{z0}`. A rectangular
    patch has k = 2, an elliptic one k = 1. The friction is that of the Magic Formula,
    :math:`p_{D1} + p_{D2}\,df_z`, limited to a hundredth of its value at the reference.
    """

    tire: AbstractTire = Brush()
    stiffness_power: float = par(
        1.0, (-1.0, 3.0), "-", "power of the load in c_p a^2: 2 rectangular, 1 elliptic patch",
        "S §2.1", "k",
    )  # fmt: skip
    mu_load: float = par(
        -0.1, (-1.0, 1.0), "-", "change of mu per relative change of the load", "S §2.1", r"\mu_z"
    )
    fz0: float = par(
        4000.0, (1e-3, 1e6), "N", "reference load of the load-dependent parameters", "S §2.1",
        "F_{z0}", free=False, scale="log",
    )  # fmt: skip

    def at(self, fz: Scalar) -> AbstractTire:
        """The tire with its parameters at load fz [N] > 0."""
        ratio = fz / self.fz0
        base = parameter_values(self.tire)
        mu = base["mu"] + self.mu_load * (ratio - 1)
        values = {
            "cpa2": base["cpa2"] * ratio**self.stiffness_power,
            "half_length": base["half_length"] * ratio ** (self.stiffness_power / 2),
            "mu": jnp.maximum(mu, 0.01 * base["mu"]),
        }
        return with_values(self.tire, values)

    def static_friction(self, fz: Scalar) -> Scalar | None:
        return self.at(fz).static_friction(fz)

    def __call__(self, inputs: TireInputs) -> TireForces:
        # At zero load the tire makes the force zero for any finite parameters.
        loaded = inputs.fz > 0
        return self.at(jnp.where(loaded, inputs.fz, self.fz0))(inputs)
