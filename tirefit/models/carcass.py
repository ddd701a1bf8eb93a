r"""Brush on a laterally flexible carcass: thread, beam, assumed shape; S(15) corrected.

Bristle and carcass are in series. With :math:`s = 1 - \xi` the distance from the
leading edge in half-lengths, the deflection of the carcass :math:`\delta_c = a w`, and
the force on a half-length :math:`q = a p_y`, a bristle that sticks carries

.. math:: q = c_p a^2 (\sigma_y s - w), \qquad |q| \le \mu F_z p,

and the carcass, fixed at the rim at both ends of the patch, deflects by

.. math::
   S\, w'' = -q, \qquad \frac{EI}{a^2} w'''' = q, \qquad
   w = \frac{F_y}{a K_c} s (2 - s)

(thread; beam, with :math:`w'' = 0` at its ends; a parabola of height :math:`F_y/K_c`). Forces
below are over :math:`\mu F_z`, so that one demand ratio :math:`\rho = c_p a^2 \sigma_y / (\mu F_z)`
and one flexibility :math:`\lambda = c_p a^2/S`, :math:`c_p a^4/EI` or :math:`c_p a/K_c` remain;
:math:`\lambda = 0` is the rigid brush.

**One breakaway point.** If every bristle is bent towards its slip, bristles slide behind one point
and stick before it, as q is convex in s and the pressure concave: for the thread of any
flexibility, for the beam up to 7.82, for the parabola up to 3/8. Above, the carcass bends the first
bristles the other way, without effect until they slide: above 73 (beam) and 2.7 (parabola) for the
pressure that rises slowest there, S(24) with d = -1/3. The bounds of ``flexibility`` are below.
"""

import abc
import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from tirefit.arrays import Scalar
from tirefit.models.base import AbstractTire, TireForces, TireInputs
from tirefit.models.brush import bristle_stiffness, friction_coefficient, half_contact_length, polar
from tirefit.models.pressure import AbstractPressure, Parabolic
from tirefit.params import par
from tirefit.slip import lateral_slip


class Patch(NamedTuple):
    """A patch that slides behind u, over mu F_z."""

    stress: jax.Array  # of the first bristle that sticks [-]
    force: jax.Array  # [-]
    moment: jax.Array  # about the centre in half-lengths [-]


def _flexibility(default: float, largest: float, meaning: str, symbol: str) -> Any:
    return par(default, (0.0, largest), "-", meaning, "S(15)", symbol)


class AbstractCarcass(AbstractTire):
    """Lateral brush on a flexible carcass; no longitudinal force.

    The slip is assumed to be purely lateral and the friction constant, as kinetic friction
    below the static one can cause several breakaway points.
    """

    cpa2: float = bristle_stiffness("with the carcass in series C_alpha < 2 c_p a^2", "S(15)")
    mu: float = friction_coefficient()
    half_length: float = half_contact_length()
    pressure: AbstractPressure = Parabolic()

    @abc.abstractmethod
    def patch(self, u: Array, rho: Array, pressure: AbstractPressure) -> Patch:
        """The patch that slides over [0, u] and sticks before it, at demand rho.

        Args:
            u: distance of the breakaway point from the trailing edge [-], in [0, 2].
            rho: demand ratio [-], >= 0.
            pressure: how the load is spread.
        """

    def _ends(self, rho: Array, pressure: AbstractPressure) -> tuple[Array, Array]:
        """u in [0, 2] on either side of the breakaway point, 3e-8 apart, without
        slopes: the bristle there needs just what the road gives."""
        tire, rho, pressure = jax.lax.stop_gradient((self, rho, pressure))

        def halve(_: Array | int, ends: tuple[Array, Array]) -> tuple[Array, Array]:
            low, high = ends
            middle = (low + high) / 2
            stress = tire.patch(middle, rho, pressure).stress
            slides = stress > pressure.density(middle)
            return jnp.where(slides, middle, low), jnp.where(slides, high, middle)

        rest = jnp.zeros_like(rho)
        return jax.lax.fori_loop(0, 26, halve, (rest, rest + 2))

    def settled(self, rho: Array, pressure: AbstractPressure) -> Patch:
        """The patch that slides behind its breakaway point, at demand rho."""
        low, high = self._ends(rho, pressure)
        end = jnp.where(low > 0, 2.0, 0.0)

        def excess_and_patch(u: Array) -> tuple[Array, Patch]:
            patch = self.patch(u, rho, pressure)
            return patch.stress - pressure.density(u), patch

        def newton(_: Array | int, state: tuple[Array, Patch]) -> tuple[Array, Patch]:
            # The slope is that of the implicit function.
            u = state[0]
            value, slope, patch = jax.jvp(excess_and_patch, (u,), (jnp.ones_like(u),), has_aux=True)
            slope = jax.lax.stop_gradient(slope)
            partly = (low > 0) & (high < 2) & (slope < 0)
            u = u - value / jnp.where(partly, slope, 1.0)
            return jnp.where(partly, u, end), patch

        # One step, then the patch that it leads to. As a loop, because the compile time
        # grows with the number of copies of the patch.
        nothing = Patch(*(jnp.zeros_like(low) for _ in Patch._fields))
        return jax.lax.fori_loop(0, 2, newton, ((low + high) / 2, nothing))[1]

    def __call__(self, inputs: TireInputs) -> TireForces:
        slip_y = lateral_slip(jnp.tan(inputs.alpha), inputs.sigma_x)
        slip, _, across = polar(jnp.zeros_like(slip_y), slip_y)
        loaded = inputs.fz > 0
        limit = self.mu * jnp.where(loaded, inputs.fz, 1.0)
        rho = self.cpa2 * slip / limit
        patch = self.settled(rho, self.pressure)
        scale = limit * loaded * across
        return TireForces(None, scale * patch.force, self.half_length * scale * patch.moment)


class _Solutions:
    """y_n of y^(order) = sign lambda y: 1, s, s^2/2, ... for lambda = 0, each the integral
    of the previous one from the leading edge.

    They are power series in x = lambda s^order, which are smooth at lambda = 0 (rigid
    carcass), where the closed forms in sinh and cos divide by zero.

    Args:
        order, sign: of the differential equation.
        count: how many of them are wanted.
        terms: of the series.
        largest: of x, to which the powers are scaled.
    """

    def __init__(self, order: int, sign: int, count: int, terms: int, largest: float) -> None:
        self.order, self.terms, self.largest = order, terms, largest
        self.coefficients = np.array(
            [
                [(sign * largest) ** j / math.factorial(order * j + n) for n in range(count)]
                for j in reversed(range(terms))
            ]
        )

    def __call__(self, flexibility: Scalar, s: Array) -> list[Array]:
        """[y_0, y_1, ...] at the distance s from the leading edge."""
        power = flexibility * s**self.order / self.largest
        values = jnp.polyval(jnp.asarray(self.coefficients, power.dtype), power, unroll=1)
        return [value * s**n for n, value in enumerate(values)]


_LARGEST_THREAD, _LARGEST_BEAM, _LARGEST_PARABOLA = 25.0, 50.0, 2.5
_THREAD = _Solutions(2, 1, 4, 28, _LARGEST_THREAD * 2**2)
_BEAM = _Solutions(4, -1, 6, 13, _LARGEST_BEAM * 2**4)


class ThreadCarcass(AbstractCarcass):
    r"""Carcass as a thread under tension, S(15): :math:`S \delta_c'' = -p_y`.

    :math:`C_\alpha = 2 c_p a^2 \tanh(k) / k`, :math:`k^2 = \lambda`; full sliding above
    :math:`\rho = (3 + \lambda)/2` with the parabolic pressure.
    """

    flexibility: float = _flexibility(
        1.0, _LARGEST_THREAD, "bristle stiffness over thread tension, c_p a^2 / S", "c_p a^2 / S"
    )

    def patch(self, u: Array, rho: Array, pressure: AbstractPressure) -> Patch:
        s, flexibility = 2 - u, self.flexibility
        y = _THREAD(flexibility, s)
        share, moment = pressure.cdf(u), pressure.moment(u)
        # q = slope y_1 from the leading edge; w = 0 at the trailing edge.
        slope = (2 * rho - flexibility * (share + moment)) / (y[1] + u * y[0])
        stuck, lever = slope * y[2], slope * (s * y[2] - y[3])
        return Patch(slope * y[1], stuck + share, stuck + moment - lever)


_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(6)


def _third_moment(pressure: AbstractPressure, u: Array) -> Array:
    """Integral of t^3 p(t) over [0, u]; exact for polynomials up to degree eight."""
    t = u * jnp.asarray((1 + _NODES) / 2, u.dtype)
    return u / 2 * jnp.sum(jnp.asarray(_WEIGHTS, u.dtype) * t**3 * pressure.density(t))


class BeamCarcass(AbstractCarcass):
    r"""Carcass as a beam with pinned ends, S §2.3: :math:`EI\, \delta_c'''' = p_y`.

    Full sliding above :math:`\rho = 3/2 + \lambda/5` with the parabolic pressure.
    """

    flexibility: float = _flexibility(
        3.0, _LARGEST_BEAM, "bristle stiffness over beam stiffness, c_p a^4 / EI", "c_p a^4 / EI"
    )

    def patch(self, u: Array, rho: Array, pressure: AbstractPressure) -> Patch:
        s, flexibility = 2 - u, self.flexibility
        y = _BEAM(flexibility, s)
        share, moment = pressure.cdf(u), pressure.moment(u)
        # q = A y_1 + B y_3 from the leading edge; at the trailing edge w'' = 0 gives
        # A bend_1 + B bend_3 = load_1, and w = 0 gives A sink_1 + B sink_3 = load_3.
        bend_1 = -flexibility * (y[3] + u * y[2])
        bend_3 = y[1] + u * y[0]
        sink_1 = bend_3 - flexibility * (u**2 / 2 * y[3] + u**3 / 6 * y[2])
        sink_3 = y[3] + u * y[2] + u**2 / 2 * y[1] + u**3 / 6 * y[0]
        load_1 = flexibility * (share + moment)
        load_3 = 2 * rho + flexibility / 6 * _third_moment(pressure, u)
        determinant = bend_1 * sink_3 - bend_3 * sink_1
        first = (sink_3 * load_1 - bend_3 * load_3) / determinant
        third = (bend_1 * load_3 - sink_1 * load_1) / determinant
        stuck = first * y[2] + third * y[4]
        lever = s * stuck - first * y[3] - third * y[5]
        stress = first * y[1] + third * y[3]
        return Patch(stress, stuck + share, stuck + moment - lever)


class ParabolicCarcass(AbstractCarcass):
    r"""Carcass bent to a parabola whose height follows the force, S §2.3 (Fiala).

    :math:`\delta_c = (F_y/K_c)(1 - \xi^2)`; :math:`C_\alpha = 2 c_p a^2 /
    (1 + \tfrac43 \lambda)`; full sliding above :math:`\rho = \tfrac32 + 2\lambda` with
    the parabolic pressure, at the slip of a rigid brush of the same :math:`C_\alpha`.
    """

    flexibility: float = _flexibility(
        0.3,
        _LARGEST_PARABOLA,
        "bristle stiffness over carcass stiffness, c_p a / K_c",
        "c_p a / K_c",
    )

    def patch(self, u: Array, rho: Array, pressure: AbstractPressure) -> Patch:
        s, share = 2 - u, pressure.cdf(u)
        lag = self.flexibility * s**2 * (1 - s / 3)
        force = (rho * s**2 / 2 + share) / (1 + lag)
        height = self.flexibility * force
        stuck = rho * s**2 / 2 - height * s**2 * (1 - s / 3)
        lever = rho * s**3 / 3 - height * s**3 * (2 / 3 - s / 4)
        stress = s * (rho - height * u)
        return Patch(stress, force, stuck + pressure.moment(u) - lever)
