r"""Stiffness and friction that change with the load, S §2.1.

The contact half-length a grows with the load: in proportion to :math:`F_z` for a
rectangular patch, to :math:`\sqrt{F_z}` for an elliptic one. So :math:`c_p a^2` grows
as :math:`F_z^2` or as :math:`F_z`; measured tires have other powers.
"""

import jax.numpy as jnp

from tirefit.models.base import AbstractTire, TireForces, TireInputs
from tirefit.models.brush import Brush
from tirefit.models.pressure import reference_load
from tirefit.params import par, parameter_values, with_values


class LoadDependent(AbstractTire):
    r"""A brush whose stiffness, contact length and friction follow the load.

    .. math::
       c_p a^2 = (c_p a^2)_0 \left(\frac{F_z}{F_{z0}}\right)^k, \quad
       a = a_0 \left(\frac{F_z}{F_{z0}}\right)^{k/2}, \quad
       \mu = \mu_0 + \mu_z \frac{F_z - F_{z0}}{F_{z0}}

    The parameters of the tire hold at the reference load :math:`F_{z0}`. A rectangular
    patch has k = 2, an elliptic one k = 1. The friction is that of the Magic Formula,
    :math:`p_{D1} + p_{D2}\,df_z`, held above a hundredth of its value at the reference.
    """

    tire: AbstractTire = Brush()
    stiffness_power: float = par(
        1.0, (-1.0, 3.0), "-",
        "power of the load in c_p a^2: 2 rectangular, 1 elliptic patch", "S §2.1", "k",
    )  # fmt: skip
    mu_load: float = par(
        -0.1, (-1.0, 1.0), "-", "change of mu per relative change of the load",
        "S §2.1", r"\mu_z",
    )  # fmt: skip
    fz0: float = reference_load()

    def at(self, fz) -> AbstractTire:
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

    @property
    def needs(self) -> tuple[str, ...]:
        return self.tire.needs

    def static_friction(self, fz):
        return self.at(fz).static_friction(fz)

    def __call__(self, inputs: TireInputs) -> TireForces:
        # No load, no force: the tire sees to that, at any finite parameters.
        loaded = inputs.fz > 0
        return self.at(jnp.where(loaded, inputs.fz, self.fz0))(inputs)
