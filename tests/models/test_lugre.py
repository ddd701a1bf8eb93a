"""The steady LuGre tires compared with S(18) as printed and the bristle profile."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad_vec
from scipy.optimize import brentq

from tirefit.models import LuGre, LuGreLumped, TireInputs, forces
from tirefit.models.lugre import patch_means

TIRE = LuGre(sigma0=150.0, sigma1=0.08, sigma2=0.002, length=0.25, exponent=0.7)
LUMPED = LuGreLumped(sigma2=0.002, exponent=0.7)
LOAD, SPEED = 4000.0, 20.0


def level(v_s, tire=TIRE):
    """S(17c)."""
    decay = np.exp(-((v_s / tire.v_st) ** tire.exponent))
    return tire.mu_c + (tire.mu_s - tire.mu_c) * decay


def printed(sigma, v=SPEED, tire=TIRE):
    """S(18) over F_z, as printed; sigma > 0."""
    v_s = v * sigma / (1 + sigma)
    g = level(v_s, tire)
    demand = tire.sigma0 * tire.length * sigma / g
    bracket = 1 + (1 - tire.sigma1 * v_s / g) / demand * (np.exp(-demand) - 1)
    return g * bracket + tire.sigma2 * v_s


def by_profile(sliding, rolling):
    """Force over F_z (2,) by quadrature of S(17) over the steady patch."""
    speed = np.hypot(*sliding)
    yields = TIRE.sigma0 * speed / level(speed)

    def per_length(place):
        z = sliding / yields * -np.expm1(-yields * place / rolling)
        return TIRE.sigma0 * z + TIRE.sigma1 * (sliding - yields * z) + TIRE.sigma2 * sliding

    total, _ = quad_vec(per_length, 0, TIRE.length, epsabs=0, epsrel=1e-13)
    return total / TIRE.length


SLIPS = [1e-6, 1e-3, 0.02, 0.1, 0.6, 5.0, 100.0]


@pytest.mark.parametrize("v", [0.3, 20.0, 60.0])
def test_agrees_with_s18_as_printed(v):
    sigma = np.array(SLIPS[2:])
    found = forces(TIRE, TireInputs(sigma, 0.0, LOAD, v))
    np.testing.assert_allclose(found.fx, LOAD * printed(sigma, v), rtol=1e-12)
    np.testing.assert_array_equal(found.fy, 0.0)


@pytest.mark.parametrize("slip_x", SLIPS + [-0.01, -0.5])
@pytest.mark.parametrize("alpha", [0.0, 0.002, -0.3])
def test_agrees_with_the_integral_over_the_profile(slip_x, alpha):
    found = forces(TIRE, TireInputs(slip_x, alpha, LOAD, SPEED))
    rolling = SPEED / (1 + slip_x)
    expected = by_profile(np.array([SPEED - rolling, SPEED * np.tan(alpha)]), rolling)
    force = np.array([found.fx, found.fy]) / LOAD
    # v_x - Omega R_e has lost digits at the smallest slip.
    np.testing.assert_allclose(force, expected, rtol=1e-9, atol=0)


@jax.jit
@partial(jax.value_and_grad, argnums=(0, 1))
def share(tire, slip):
    return tire(TireInputs(slip, 0.0, 1.0, SPEED)).fx


@pytest.mark.parametrize("slip", [1e-12, 1e-9, 1e-6, 1e-5])
def test_small_slip_is_computed_exactly(slip):
    """The first terms of S(18) at zero slip; as printed all digits are lost."""
    still = LuGre(sigma0=150.0, sigma1=0.0, sigma2=0.0, mu_c=0.9, mu_s=0.9)

    stiffness = 150.0 * 0.2
    demand = stiffness * slip / 0.9
    expected = stiffness * slip * (1 / 2 - demand / 6 + demand**2 / 24)
    expected -= stiffness * slip * demand**3 / 120
    slope = stiffness * (1 / 2 - demand / 3 + demand**2 / 8 - demand**3 / 30)
    softer = stiffness * slip * (1 / 6 - demand / 12 + demand**2 / 40) * demand / 0.9
    tire = jax.tree.map(jnp.asarray, still)
    found, (by_tire, by_slip) = share(tire, slip)
    np.testing.assert_allclose(found, expected, rtol=1e-12)
    np.testing.assert_allclose(by_slip, slope, rtol=1e-12)
    np.testing.assert_allclose(by_tire.mu_s + by_tire.mu_c, softer, rtol=1e-10)
    if slip == 1e-12:
        assert abs(printed(slip, SPEED, still) / expected - 1) > 1e-3


def test_patch_means_are_continuous_at_the_end_of_the_series():
    x = np.array([0.0, 1e-9, 0.3, np.nextafter(1, 0), 1.0, 1.1, 40.0, 1e8])
    nodes, weights = np.polynomial.legendre.leggauss(60)
    place, share = (nodes + 1) / 2, weights / 2
    fine = x[:-1, None]
    first = np.exp(-fine * place) @ share
    second = (np.exp(-fine * place) * (1 - place)) @ share
    slope = -(np.exp(-fine * place) * (1 - place) * place) @ share
    found, slopes = jax.jit(
        lambda x: (patch_means(x), jax.vmap(jax.grad(lambda x: patch_means(x)[1]))(x))
    )(x)
    np.testing.assert_allclose(found[0][:-1], first, rtol=1e-13)
    np.testing.assert_allclose(found[1][:-1], second, rtol=1e-13)
    np.testing.assert_allclose([found[0][-1], found[1][-1]], 1e-8, rtol=2e-8)
    np.testing.assert_allclose(slopes[:-1], slope, rtol=1e-12)


def test_lumped_is_the_steady_state_of_its_equation():
    """The z at which S(17a) is steady, in S(17b)."""
    slip_x, alpha = 0.3, -0.2
    rolling = SPEED / (1 + slip_x)
    sliding = np.array([SPEED - rolling, SPEED * np.tan(alpha)])
    speed = np.hypot(*sliding)
    held = brentq(lambda z: speed - TIRE.sigma0 * speed / level(speed) * z, 0, 1, xtol=1e-15)
    force = LOAD * (TIRE.sigma0 * held + TIRE.sigma2 * speed) * sliding / speed
    found = forces(LUMPED, TireInputs(slip_x, alpha, LOAD, SPEED))
    np.testing.assert_allclose([found.fx, found.fy], force, rtol=1e-12)


def test_lumped_is_discontinuous_at_zero_slip():
    found = forces(LUMPED, TireInputs(np.array([-1e-9, 0.0, 1e-9]), 0.0, LOAD, 1))
    jump = LOAD * TIRE.mu_s
    np.testing.assert_allclose(found.fx, [-jump, 0.0, jump], rtol=1e-5)
