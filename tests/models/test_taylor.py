"""Taylor forms S(38), S(39), S(41) compared with differentiation and the brush."""

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


@jax.jit
def by_differentiation(tire, v=0.0):
    """Coefficients (5,) of the braking force at rest, by nested forward derivatives."""

    def force(sigma):
        return tire.pure(sigma, FZ, v * sigma / (1 + sigma))[0]

    found, function, factorial = [], force, 1.0
    for k in range(1, 6):
        function = jax.jacfwd(function)
        factorial *= k
        found.append(function(0.0) / factorial)
    return jnp.stack(found)


def scaled(terms):
    """In units of C (C / M)^k, to be near one."""
    return np.asarray(terms) / (C * (C / M) ** np.arange(len(terms)))


@pytest.mark.parametrize("d", [-1 / 3, -0.2, 0.0, 0.1, 0.5])
def test_s38_agrees_with_the_derivative_of_the_brush(d):
    tire = asymmetric(d)
    ours = coefficients(tire, FZ)
    expected = by_differentiation(tire)
    np.testing.assert_allclose(scaled(ours), scaled(expected), rtol=1e-10, atol=1e-11)
    np.testing.assert_array_equal(coefficients(tire, FZ, order=2), ours[:2])


@pytest.mark.parametrize("static_too", [True, False])
@pytest.mark.parametrize("n", [0.0, 0.01, -0.02])
def test_s39_agrees_with_the_derivative_of_the_brush(n, static_too):
    tire = falling(n, static_too)
    ours = coefficients(tire, FZ, V)
    expected = by_differentiation(tire, V)
    np.testing.assert_allclose(scaled(ours), scaled(expected), rtol=1e-10, atol=1e-11)


def test_s39_with_only_kinetic_friction_falling_differs_from_the_fourth_term():
    both, kinetic = (coefficients(falling(0.02, s), FZ, V) for s in (True, False))
    np.testing.assert_array_equal(both[:3], kinetic[:3])
    loss = 0.02 * V / MU
    np.testing.assert_allclose(kinetic[3] - both[3], 4 * C**2 / (3 * M) * loss**2)
    assert abs(kinetic[4] - both[4]) > 0.1 * abs(both[4])


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
    sigma = jnp.linspace(0, full, 21)
    force = jax.vmap(lambda s: tire.pure(s, FZ, 0.0)[0])(sigma)
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
    force = jax.vmap(lambda s: tire.pure(s, FZ, v * s / (1 + s))[0])(sigma)
    ours = truncated_force(coefficients(tire, FZ, v, order), sigma)
    error = np.abs(ours / force - 1)
    np.testing.assert_allclose(error[-1], 0.01, rtol=1e-6)
    assert (error[:-1] < 0.01).all()
    if order == 1:
        # There the second term decides: 1 % of the first, and a little more.
        first, second = coefficients(tire, FZ, v, 2)
        np.testing.assert_allclose(found, -0.01 * first / second, rtol=0.05)


def test_the_radius_grows_with_order_and_shrinks_with_asymmetry():
    """S §4.3: below d = 0.1 four terms suffice; higher values are more critical."""
    reach = {
        d: [radius(asymmetric(d), FZ, order=k) * C / M for k in (2, 3, 4, 5)]
        for d in (-0.2, 0.1, 0.5)
    }
    for values in reach.values():
        assert values == sorted(values)
    assert reach[-0.2][2] > 0.8 > reach[0.1][2] > 0.4 > reach[0.5][2]
    np.testing.assert_allclose(
        radius(asymmetric(0.1), 2 * FZ, order=4), 2 * reach[0.1][2] * M / C, rtol=1e-9
    )
    assert radius(asymmetric(0.1), FZ, order=4, share=1e-3) < reach[0.1][2] * M / C


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
