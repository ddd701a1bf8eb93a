"""Taylor forms S(38), S(39), S(41) compared with differentiation and the brush."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fits.source_figures.taylor import (
    asymmetric_coefficients,
    coefficients,
    radius,
    speed_coefficients,
    truncated_force,
)
from tirefit.models import Asymmetric, Brush, Friction, Kinetic, LinearInSpeed, Quartic

C, MU, FZ, V = 5e4, 0.9, 4000.0, 25.0
M = MU * FZ


def asymmetric(d):
    return Brush(C, MU, pressure=Asymmetric(d))


def falling(n, static_too):
    law = LinearInSpeed(n, static_too=static_too)
    return Brush(C, MU, friction=Friction((law,)))


def all_orders(function, order):
    """A function, and its derivatives up to an order, by forward mode."""

    def terms(s):
        return (function(s),)

    for _ in range(order):

        def terms(s, lower=terms):
            (value, *_), slopes = jax.jvp(lower, (s,), (jnp.ones_like(s),))
            return value, *slopes

    return terms


@jax.jit
@jax.vmap
def by_differentiation(tire, v):
    """Coefficients (5,) of the braking force at rest, each tire at its speed."""

    def force(sigma):
        return tire.pure(sigma, FZ, v * sigma / (1 + sigma))[0]

    return jnp.stack(all_orders(force, 5)(jnp.zeros(()))[1:]) / jnp.array([1, 2, 6, 24, 120.0])


LEANS = np.array([-1 / 3, -0.2, 0.0, 0.1, 0.5])
FALLS = np.array([0.0, 0.01, -0.02, 0.0, 0.01, 0.03, 0.03])
SPEEDS = np.array([V, V, V, 20.0, 20.0, 25.0, 40.0])


@cache
def at_rest(kind):
    """Coefficients (n, 5) of the brush, for each lean, or each fall at its speed."""
    if kind == "asymmetric":
        tires, v = [asymmetric(d) for d in LEANS], 0 * LEANS
    else:
        tires, v = [falling(n, kind == "static too") for n in FALLS], SPEEDS
    stacked = jax.tree.map(lambda *leaves: np.array(leaves, float), *tires)
    return np.asarray(by_differentiation(stacked, v))


def scaled(terms):
    """In units of C (C / M)^k, to be near one."""
    return np.asarray(terms) / (C * (C / M) ** np.arange(np.shape(terms)[-1]))


@jax.jit
def braking(tire, sigma, v):
    """Braking forces (n,) at slips (n,)."""
    return jax.vmap(lambda s: tire.pure(s, FZ, v * s / (1 + s))[0])(sigma)


def test_s38_agrees_with_the_derivative_of_the_brush():
    for d, expected in zip(LEANS, at_rest("asymmetric"), strict=True):
        ours = coefficients(asymmetric(d), FZ)
        np.testing.assert_allclose(scaled(ours), scaled(expected), rtol=1e-10, atol=1e-11)
        np.testing.assert_array_equal(coefficients(asymmetric(d), FZ, order=2), ours[:2])


def test_s38_as_printed_holds_to_fifth_order():
    d = LEANS
    printed = np.array(
        [
            2 * C * np.ones_like(d),
            4 / 3 * C**2 / ((d - 1) * M),
            -8 / 27 * (3 * d + 1) * C**3 / ((d - 1) ** 3 * M**2),
            16 / 27 * (3 * d + 1) * C**4 * d / ((d - 1) ** 5 * M**3),
            -128 / 81 * (3 * d + 1) * C**5 * d**2 / ((d - 1) ** 7 * M**4),
        ]
    )
    ours = at_rest("asymmetric")
    np.testing.assert_allclose(scaled(ours), scaled(printed.T), rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("kind", ["static too", "kinetic"])
def test_s39_agrees_with_the_derivative_of_the_brush(kind):
    for n, v, expected in zip(FALLS, SPEEDS, at_rest(kind), strict=True):
        ours = coefficients(falling(n, kind == "static too"), FZ, v)
        np.testing.assert_allclose(scaled(ours), scaled(expected), rtol=1e-10, atol=1e-11)


def s39(n, v, *, falling_static):
    """S(39) as printed; its last term belongs to a static friction that also falls."""
    lead = 4 * C**2 / (3 * FZ * MU)
    square = n * v / MU**2 if falling_static else 0.0
    return np.array(
        [
            2 * C * np.ones_like(n),
            -lead * np.ones_like(n),
            lead * (2 * C / (9 * FZ * MU) - n * v / MU),
            lead * n * v * (4 * C / (9 * FZ * MU**2) + 1 / MU - square),
        ]
    )


def test_s39_as_printed_holds_for_both_frictions_falling():
    n, v = FALLS, SPEEDS
    both, only_kinetic = (at_rest(kind).T[:4] for kind in ("static too", "kinetic"))
    np.testing.assert_allclose(both, s39(n, v, falling_static=True), rtol=1e-10)
    # With only mu_k falling, sigma^3 stays and sigma^4 loses its -(n v / mu_0)^2.
    right = s39(n, v, falling_static=False)
    np.testing.assert_allclose(only_kinetic, right, rtol=1e-10)
    np.testing.assert_allclose(only_kinetic[:3], both[:3], rtol=1e-10)
    expected = 4 * C**2 / (3 * FZ * MU) * (n * v / MU) ** 2
    apart = only_kinetic[3] - both[3]
    np.testing.assert_allclose(apart, expected, rtol=1e-8, atol=1e-3)
    assert apart[-1] > 0.2 * both[3, -1]


def test_s41_equals_s38_in_terms_of_the_stiffness():
    """S(41) with C_x = 2 c_p a^2, and the regressors of S(45), S(46) corrected."""
    d, stiffness = 0.1, 2 * C
    s41 = (
        stiffness,
        stiffness**2 / (3 * (d - 1) * M),
        -(3 * d + 1) * stiffness**3 / (27 * M**2 * (d - 1) ** 3),
    )
    ours = asymmetric_coefficients(C, M, d, order=3)
    np.testing.assert_allclose(ours, s41, rtol=1e-14)
    sigma = 0.01
    u0, u1, u2 = ours * sigma ** np.arange(1, 4) / FZ
    np.testing.assert_allclose(u2, u1**2 * (1 + 3 * d) / (3 * u0 * (1 - d)), rtol=1e-13)


@pytest.mark.parametrize(("d", "order"), [(0.0, 3), (-1 / 3, 2)])
def test_the_truncated_force_is_exact_up_to_full_sliding(d, order):
    """S §4.3: d = 0 needs three terms, d = -1/3 two."""
    terms = scaled(asymmetric_coefficients(C, M, d))
    np.testing.assert_allclose(terms[order:], 0.0, atol=1e-14)
    assert abs(terms[order - 1]) > 0.2
    tire = asymmetric(d)
    full = 1.5 * (1 + d) * M / C
    sigma = np.linspace(0, full, 100)
    force = braking(tire, sigma, 0.0)
    ours = truncated_force(coefficients(tire, FZ, order=order), sigma)
    np.testing.assert_allclose(ours, force, rtol=1e-12)
    assert radius(tire, FZ, order=order) > full


@pytest.mark.parametrize("order", [1, 3, 5])
@pytest.mark.parametrize(
    ("tire", "v"),
    [(asymmetric(-0.2), 0.0), (asymmetric(0.1), 0.0), (asymmetric(0.5), 0.0)]
    + [(falling(0.02, True), V), (falling(0.02, False), V)],
    ids=["d = -0.2", "d = 0.1", "d = 0.5", "n, static too", "n"],
)
def test_the_radius_is_where_the_error_reaches_its_limit(tire, v, order):
    found = radius(tire, FZ, v, order)
    sigma = found * np.linspace(0.01, 1.0, 100)
    force = np.asarray(braking(tire, sigma, v))
    ours = truncated_force(coefficients(tire, FZ, v, order), sigma)
    error = np.abs(ours / force - 1)
    np.testing.assert_allclose(error[-1], 0.01, rtol=1e-6)
    assert (error[:-1] < 0.01).all()
    if order == 1:
        # There the second term decides: 1 % of the first, and a little more.
        first, second = coefficients(tire, FZ, v, 2)
        np.testing.assert_allclose(found, -0.01 * first / second, rtol=0.05)


@pytest.mark.parametrize(
    "tire",
    [
        Brush(pressure=Quartic()),
        Brush(friction=Friction((Kinetic(),))),
        Brush(pressure=Asymmetric(), friction=Friction((LinearInSpeed(),))),
    ],
)
def test_other_brushes_are_refused(tire):
    with pytest.raises(ValueError, match=r"no Taylor form.*S\(38\).*S\(39\)"):
        coefficients(tire, FZ)


@pytest.mark.parametrize("order", [0, 6])
def test_a_wrong_order_is_refused(order):
    with pytest.raises(ValueError, match="from 1 to 5"):
        asymmetric_coefficients(C, M, order=order)
    with pytest.raises(ValueError, match="from 1 to 5"):
        speed_coefficients(C, M, order=order)
