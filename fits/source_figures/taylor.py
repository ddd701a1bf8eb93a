r"""Taylor forms of the brush force at small slip, S(38), S(39) and S(41).

A polynomial in the slip, :math:`F \approx \sum_k a_k \sigma^k`, is linear in its
coefficients, as linear least squares needs (S §4.3, §5). It is valid up to a slip given
by :func:`radius`, which with an asymmetric pressure may be far below full sliding.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.optimize import brentq

from tirefit.models.brush import Brush
from tirefit.models.friction import LinearInSpeed
from tirefit.models.pressure import Asymmetric, Parabolic

_HIGHEST = 5


def _check_order(order: int) -> None:
    if not 1 <= order <= _HIGHEST:
        raise ValueError(f"order {order}: the Taylor forms go from 1 to {_HIGHEST}")


def asymmetric_coefficients(cpa2, mu_fz, d=0.0, order: int = 5) -> Float[np.ndarray, "k ..."]:
    """Coefficients of sigma, sigma^2, ... for the asymmetric pressure, S(38).

    With ``order`` 3 and C_x = 2 c_p a^2 that is S(41).

    Args:
        cpa2: bristle stiffness c_p a^2 [N].
        mu_fz: friction times load [N].
        d: asymmetry of the pressure, in [-1/3, 1); shapes broadcast.
        order: number of terms, 1 to 5.

    Raises:
        ValueError: the order is not one of them.
    """
    _check_order(order)
    q, lean = 1 / (1 - np.asarray(d, float)), 1 + 3 * np.asarray(d, float)
    terms = (
        2.0,
        -4 / 3 * q,
        8 / 27 * lean * q**3,
        -16 / 27 * lean * d * q**5,
        128 / 81 * lean * d**2 * q**7,
    )
    ratio = cpa2 / mu_fz
    return np.stack(
        np.broadcast_arrays(*(term * cpa2 * ratio**k for k, term in enumerate(terms[:order])))
    )


def speed_coefficients(
    cpa2, mu_fz, loss=0.0, order: int = 5, *, static_too: bool = True
) -> Float[np.ndarray, "k ..."]:
    """Coefficients of sigma, sigma^2, ... for friction falling with speed, S(39).

    S(39) to order 4 is the case ``static_too``; the fifth term is derived in the same way.

    Args:
        cpa2: bristle stiffness c_p a^2 [N].
        mu_fz: friction at rest times load [N].
        loss: n v / mu_0 [-], the share of the friction lost at a locked wheel.
        order: number of terms, 1 to 5.
        static_too: whether the static friction falls with the kinetic one.

    Raises:
        ValueError: the order is not one of them.
    """
    _check_order(order)
    ratio, w = cpa2 / mu_fz, np.asarray(loss, float)
    square = 4 / 3 * cpa2 * ratio
    cube = 8 / 27 * cpa2 * ratio**2
    if static_too:
        fourth = square * w * (1 - w) + 2 * cube * w
        fifth = -square * w * (1 - w) ** 2 + cube * w * (3 * w - 2)
    else:
        fourth = w * (square + 2 * cube)
        fifth = -fourth
    terms = (2.0 * cpa2, -square, cube - square * w, fourth, fifth)
    return np.stack(np.broadcast_arrays(*terms[:order]))


def coefficients(tire: Brush, fz, v=0.0, order: int = 5) -> Float[np.ndarray, "k ..."]:
    """Coefficients of sigma, sigma^2, ... of the braking force of a brush.

    Args:
        tire: a brush with the pressure and friction laws of S(38) or S(39).
        fz: load [N].
        v: forward speed [m/s].
        order: number of terms, 1 to 5.

    Raises:
        ValueError: the source has no Taylor form of this brush; or the order.
    """
    laws, mu_fz = tire.friction.laws, tire.mu * fz
    if not laws and type(tire.pressure) in (Parabolic, Asymmetric):
        d = getattr(tire.pressure, "d", 0.0)
        return asymmetric_coefficients(tire.cpa2, mu_fz, d, order)
    law = laws[0] if len(laws) == 1 else None
    if isinstance(law, LinearInSpeed) and type(tire.pressure) is Parabolic:
        loss = law.n * v / tire.mu
        return speed_coefficients(tire.cpa2, mu_fz, loss, order, static_too=law.static_too)
    raise ValueError(
        "no Taylor form of this brush: S(38) has constant friction and the asymmetric"
        " pressure, S(39) the parabolic one and friction falling linearly with speed"
    )


def truncated_force(coefficients, sigma):
    """Polynomial of the coefficients, (k, ...), at physical slip sigma >= 0 [N]."""
    total = 0.0
    for coefficient in coefficients[::-1]:
        total = (total + coefficient) * sigma
    return total


_GRID = np.geomspace(1e-6, 1e3, 4001)
"""Demand ratios c sigma / (mu F_z) in the search for a radius."""


@jax.jit
def _excess(tire, terms, fz, v, share, sigma):
    """Truncation error beyond ``share`` of the force [N]."""
    force, _ = tire.pure(sigma, fz, v * sigma / (1 + sigma))
    return jnp.abs(truncated_force(terms, sigma) - force) - share * jnp.abs(force)


def radius(tire: Brush, fz: float, v: float = 0.0, order: int = 5, share=0.01) -> float:
    """Physical slip up to which the truncation error is below ``share`` of the force.

    Args:
        tire: as for :func:`coefficients`, braking.
        fz: load [N] > 0.
        v: forward speed [m/s].
        order: number of terms kept, 1 to 5.
        share: error allowed, relative to the force.

    Returns:
        the smallest slip at which the error reaches ``share``; a slip beyond full sliding
        if the polynomial is exact up to full sliding.

    Raises:
        ValueError: no Taylor form of this brush; or the order.
    """
    excess = functools.partial(_excess, tire, coefficients(tire, fz, v, order), fz, v, share)
    grid = _GRID * float(tire.mu * fz / tire.cpa2)
    over = np.asarray(excess(grid)) > 0
    first = int(np.argmax(over))
    return float(brentq(lambda s: float(excess(s)), grid[first - 1], grid[first]))
