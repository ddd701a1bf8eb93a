"""Pressure laws compared with direct integration, and laws that vary."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numeric_patch import integrate_patch
from scipy.integrate import quad
from scipy.optimize import brentq

from tirefit.models import (
    MODELS,
    Asymmetric,
    Brush,
    Elliptic,
    ForceAsymmetric,
    Friction,
    Kinetic,
    LoadAsymmetric,
    Parabolic,
    Quartic,
    TireInputs,
    Uniform,
    forces,
)
from tirefit.params import with_values

C, MU, FZ = 5e4, 0.9, 4000.0

LAWS = {
    "parabolic": (Parabolic(), lambda xi: 1 - xi**2),
    "uniform": (Uniform(), lambda xi: 3.0),
    "quartic": (Quartic(), lambda xi: 1 - xi**4),
    "elliptic": (Elliptic(), lambda xi: np.sqrt(1 - xi**2)),
    **{
        f"d = {d:.2g}": (Asymmetric(d), lambda xi, d=d: 7 * (1 - xi**2) * (1 + d * xi))
        for d in (-1 / 3, -0.2, 0.4, 1.0)
    },
}
EACH = pytest.mark.parametrize(("law", "density"), LAWS.values(), ids=LAWS)


# Elliptic


@jax.jit
def pure(tire, slip):
    return tire.pure(slip, FZ, 0.0)


def test_elliptic_is_accurate_at_both_ends():
    law = Elliptic()
    u = jnp.asarray([0.0, 1e-12, 1e-4, 1.0, 2 - 1e-9, 2.0])
    # To leading order P = 4 sqrt(2) / (3 pi) u^(3/2).
    leading = 4 * np.sqrt(2) / (3 * np.pi) * 1e-18
    np.testing.assert_allclose(integrals(law, u)[1][1], leading, rtol=1e-11)
    slopes = jax.jit(jax.vmap(jax.jacfwd(lambda u: jnp.stack(integrals(law, u)))))(u).T
    assert np.isfinite(slopes).all()
    np.testing.assert_allclose(slopes[1], integrals(law, u)[0], rtol=1e-12)
    huge = jnp.asarray([1e18, 1e30], jnp.float32)
    points, slopes = jax.jit(jax.vmap(jax.value_and_grad(law.breakaway)))(huge)
    assert (points == 2).all() and (slopes == 0).all()


# An asymmetry that moves


def patch_force(d, slip):
    """Braking force over static friction of the numeric patch, mu_k = mu_s."""
    return integrate_patch("brush", d, C, MU, MU, FZ, slip).force / (MU * FZ)


@jax.jit
def moved_d(law, rho, braking):
    return law.under(rho, braking, FZ).d


@pytest.mark.parametrize("braking", [1.0, -1.0, 0.6, 0.0])
@pytest.mark.parametrize(("d", "d_force"), [(0.1, -0.4), (0.5, 0.9), (0.0, -1.0)])
def test_asymmetry_depends_on_the_brake_force(d, d_force, braking):
    """d is where the line d + d_F F_x / (mu F_z) meets the force of the patch."""
    law = ForceAsymmetric(d, d_force)
    for slip in (1e-3, 0.02, 0.05, 0.09, 0.3):

        def miss(at, slip=slip):
            line = d + d_force * braking * patch_force(at, slip)
            return at - np.clip(line, -1 / 3, 1)

        expected = brentq(miss, -1 / 3, 1.0, xtol=1e-14)
        found = moved_d(law, C * slip / (MU * FZ), braking)
        np.testing.assert_allclose(found, expected, atol=1e-11)
        assert -1 / 3 <= found <= 1


def test_the_brake_force_changes_the_force_of_the_tire():
    truth = {"cpa2": C, "mu": MU, "d": 0.2, "d_force": -0.4}
    tire = with_values(MODELS["brush-d-force"], truth)
    slip = np.array([0.03, 0.05, 0.08])
    both = forces(tire, TireInputs(np.concatenate([slip, -slip]), 0.0, FZ))
    braked, driven = np.split(np.abs(both.fx), 2)
    still = forces(with_values(tire, {"d_force": 0.0}), TireInputs(slip, 0.0, FZ)).fx
    # Pressure that moves back lets fewer bristles slide, one that moves on more.
    assert (braked > still + 20).all() and (driven < still - 20).all()
    for s, found in zip(slip, braked, strict=True):
        at = brentq(lambda d, s=s: d - 0.2 + 0.4 * patch_force(d, s), -1 / 3, 1)
        np.testing.assert_allclose(found, MU * FZ * patch_force(at, s), rtol=1e-11)
    # A lateral force does not move it.
    sideways = forces(tire, TireInputs(0.0, np.arctan(slip), FZ)).fy
    plain = with_values(MODELS["brush-d"], {"cpa2": C, "mu": MU, "d": 0.2})
    same = forces(plain, TireInputs(0.0, np.arctan(slip), FZ)).fy
    np.testing.assert_allclose(sideways, same, rtol=1e-12)


def test_slope_of_the_variable_asymmetry_agrees_with_the_difference():
    @jax.jit
    def moved(values):
        rho, d, d_force = values
        return ForceAsymmetric(d, d_force).under(rho, 0.8, FZ).d

    at = np.array([0.7, 0.2, -0.5])
    slope = np.asarray(jax.jit(jax.grad(moved))(at))
    steps = 1e-5 * np.eye(3)
    difference = [(moved(at + step) - moved(at - step)) / 2e-5 for step in steps]
    np.testing.assert_allclose(slope, difference, rtol=1e-8)
    along = jax.jit(lambda at: jax.jvp(moved, (at,), (at,))[1])(at)
    np.testing.assert_allclose(along, slope @ at, rtol=1e-12)


def test_asymmetry_depends_on_the_load():
    law = LoadAsymmetric(0.1, 0.5, 4000.0)
    for fz, d in ((4000.0, 0.1), (5000.0, 0.225), (40.0, -1 / 3), (40000.0, 1.0)):
        np.testing.assert_allclose(law.under(0.3, 1.0, fz).d, d, rtol=1e-12)
    values = {"cpa2": C, "mu": MU, "d": 0.1, "d_load": 0.5, "fz0": 4000.0}
    tire = with_values(MODELS["brush-d-load"], values)
    plain = with_values(MODELS["brush-d"], {"cpa2": C, "mu": MU, "d": 0.225})
    inputs = TireInputs(np.array([-0.05, 0.02, 0.2]), 0.03, 5000.0)
    for mine, same in zip(forces(tire, inputs)[:3], forces(plain, inputs)[:3], strict=True):
        np.testing.assert_allclose(mine, same, rtol=1e-12)


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
