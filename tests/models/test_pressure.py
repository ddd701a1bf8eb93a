"""Pressure laws compared with direct integration."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

from tirefit.models import Asymmetric, Brush, Friction, Kinetic, Parabolic, Quartic, Uniform

LAWS = {
    "parabolic": (Parabolic(), lambda xi: 1 - xi**2),
    "uniform": (Uniform(), lambda xi: 3.0),
    "quartic": (Quartic(), lambda xi: 1 - xi**4),
    **{
        f"d = {d:.2g}": (Asymmetric(d), lambda xi, d=d: 7 * (1 - xi**2) * (1 + d * xi))
        for d in (-1 / 3, -0.2, 0.4, 1.0)
    },
}
EACH = pytest.mark.parametrize(("law", "density"), LAWS.values(), ids=LAWS)


# Closed forms


@jax.jit
def integrals(law, u):
    return law.density(u), law.cdf(u), law.moment(u)


@jax.jit
def closed_forms(law, rho):
    """Force and moment over friction (n, 2) and their slopes over rho; breakaway points (n,)
    and their slopes, forward and backward."""

    def both(rho):
        tire = Brush(1.0, 1.0, pressure=law, friction=Friction((Kinetic(0.6),)))
        return jnp.stack(tire.pure(rho, 1.0, 0.0))

    points = law.breakaway, jax.jacfwd(law.breakaway), jax.grad(law.breakaway)
    return *(jax.vmap(f)(rho) for f in (both, jax.jacfwd(both), *points)), law


def integrated(density, rho):
    """Force and moment over friction, and the breakaway point, by a root and quadrature."""
    total = quad(density, -1, 1)[0]

    def excess(xi):
        return density(xi) / total - rho * (1 - xi)

    # Below one: the density and the demand are both zero at the leading edge.
    low, high = -1.0, 1 - 1e-9
    xi = -1.0 if excess(low) >= 0 else 1.0
    if excess(low) < 0 < excess(high):
        xi = brentq(excess, low, high, xtol=1e-15)
    load, lever = (quad(lambda x, k=k: x**k * density(x) / total, -1, xi)[0] for k in (0, 1))
    sticks = rho * (1 - xi) ** 2 / 2, rho * (1 / 6 - xi**2 / 2 + xi**3 / 3)
    return 0.6 * load + sticks[0], 0.6 * lever + sticks[1], 1 + xi


@EACH
def test_closed_forms_agree_with_direct_integration(law, density):
    law = jax.tree.map(jnp.asarray, law)  # all asymmetries by one program
    rho = np.array([1e-5, 0.01, 0.1, 0.24, 0.26, 0.6, 0.95, 1.1, 1.45, 1.9, 2.4, 2.6, 4.0])
    value, slope, u, forward, backward, _ = closed_forms(law, rho)
    h = 1e-6 * rho[:, None] * np.array([0.0, 1.0, -1.0])
    expected = np.array([[integrated(density, x) for x in xs] for xs in rho[:, None] + h])
    np.testing.assert_allclose(np.c_[value, u], expected[:, 0], atol=1e-8)
    differences = (expected[:, 1] - expected[:, 2]) / (2e-6 * rho[:, None])
    np.testing.assert_allclose(np.c_[slope, forward], differences, rtol=1e-3, atol=1e-4)
    np.testing.assert_allclose(backward, forward, rtol=1e-12)
    at = np.linspace(0.0, 2.0, 9)
    total = quad(density, -1, 1)[0]
    shares = [
        [quad(lambda x, k=k: x**k * density(x) / total, -1, end - 1)[0] for end in at]
        for k in (0, 1)
    ]
    pressures = [density(end - 1) / total for end in at]
    np.testing.assert_allclose(integrals(law, at), [pressures, *shares], atol=1e-8)
