"""Variable pressure laws, and laws from a function or a table."""

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
    Tabulated,
    TireInputs,
    Uniform,
    forces,
)
from tirefit.params import with_values
from tirefit.results import UsageError

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
RHO = np.concatenate([np.geomspace(1e-9, 0.1, 20), np.linspace(0.1, 4, 67)])


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


# Functions and tables


def both(law, rho):
    """Force and moment over friction (2,)."""
    tire = Brush(1.0, 1.0, pressure=law, friction=Friction((Kinetic(0.6),)))
    return jnp.stack(tire.pure(rho, 1.0, 0.0))


@jax.jit
def outputs(law, rho):
    """Forces and moments over friction, (n, 2)."""
    return jax.vmap(both, (None, 0))(law, rho)


@jax.jit
def integrals(law, u):
    return law.density(u), law.cdf(u), law.moment(u)


@jax.jit
def all_of(law, rho, u):
    """Outputs with their slopes over rho; breakaway points with theirs, forward and
    backward, each (n,); integrals."""
    points = jax.jacfwd(law.breakaway), jax.grad(law.breakaway)
    return (
        (outputs(law, rho), jax.vmap(jax.jacfwd(both, 1), (None, 0))(law, rho)),
        (law.breakaway(rho), *(jax.vmap(slope)(rho) for slope in points)),
        integrals(law, u),
    )


@EACH
def test_function_agrees_with_the_closed_form(law, density):
    """To the sagitta of 4,000 chords, some 1e-7 of the largest pressure; their slopes, which
    move the breakaway point, by the length of a chord (8e-4), more where rho hardly rises."""
    at = np.linspace(0.0, 2.0, 41)
    law = jax.tree.map(jnp.asarray, law)  # all asymmetries by one program
    made, expected = all_of(Tabulated.from_function(density), RHO, at), all_of(law, RHO, at)
    made, expected = jax.tree.map(np.asarray, (made, expected))
    (value, slope), (exact, exact_slope) = made[0], expected[0]
    np.testing.assert_allclose(value, exact, atol=1e-6)
    np.testing.assert_allclose(slope, exact_slope, atol=3e-3)
    (u, forward, backward), (exact, _, _) = made[1], expected[1]
    np.testing.assert_allclose(u, exact, atol=1e-5)
    np.testing.assert_allclose(backward, forward, rtol=1e-12)
    for mine, part in zip(made[2], expected[2], strict=True):
        np.testing.assert_allclose(mine, part, atol=1e-6)


def trapezoid(xi):
    """The static patch of S Fig. 1: constant, then falling over the last fifth."""
    return np.minimum(1.0, 5 * (1 - np.abs(xi)))


KNOTS = np.array([-1.0, -0.8, 0.8, 1.0])


def test_table_and_function_with_kinks_agree_with_quadrature():
    table = Tabulated.from_table(KNOTS, trapezoid(KNOTS))
    given = Tabulated.from_function(trapezoid, kinks=KNOTS)
    found = Tabulated.from_function(trapezoid)
    demand = np.array([0.02, 0.2, 0.5, 1.2, 2.6, 2.8])
    expected = []
    for rho in demand:
        # p / (1 - xi) rises to 5 / 1.8 on the leading ramp, where it is level.
        if rho >= 5 / 1.8:
            xi = 1.0
        else:
            xi = brentq(lambda x, r=rho: trapezoid(x) / 1.8 - r * (1 - x), -1, 0.8 + 1e-12)
        load, lever = (
            quad(lambda x, k=k: x**k * trapezoid(x), -1, xi, points=KNOTS[1:-1])[0] for k in (0, 1)
        )
        sticks = rho * (1 - xi) ** 2 / 2, rho * (1 / 6 - xi**2 / 2 + xi**3 / 3)
        expected.append((0.6 * load / 1.8 + sticks[0], 0.6 * lever / 1.8 + sticks[1]))
    for law, within in ((table, 1e-12), (given, 1e-8), (found, 1e-6)):
        np.testing.assert_allclose(outputs(law, demand), expected, rtol=0, atol=within)


def test_a_kink_beyond_the_patch_is_refused():
    for xi in (-1.5, 1.5):
        with pytest.raises(UsageError, match="not go from -1 to 1"):
            Tabulated.from_function(trapezoid, kinks=[xi])


def test_a_tabulated_law_satisfies_the_model_contract():
    """Batched, compiled, in combined slip, and finite at the ends."""
    xi = np.linspace(-1, 1, 9)
    tire = Brush(C, MU, pressure=Tabulated.from_table(xi, 1 - xi**4))
    slips = np.array([0.0, 1e-12, 0.05, 0.3, 1e6])
    inputs = TireInputs(slips, 0.05, np.array([0.0, 4e3, 4e3, 4e3, 4e3]))

    def total(inputs):
        result = forces(tire, inputs)
        return sum(jnp.sum(part) for part in result[:3]), result

    arrays = jax.tree.map(jnp.asarray, inputs)
    slopes, result = jax.jit(jax.grad(total, has_aux=True))(arrays)
    assert np.isfinite(np.stack(result[:3])).all()
    np.testing.assert_allclose(np.hypot(result.fx, result.fy)[-1], MU * FZ, rtol=1e-9)
    for leaf in slopes:
        assert np.isfinite(leaf).all()
    with jax.enable_x64(False):
        single = forces(tire, TireInputs(np.float32(slips), 0.05, np.float32(4e3)))
    assert single.fx.dtype == np.float32
    np.testing.assert_allclose(single.fx[1:], result.fx[1:], rtol=1e-4)


@pytest.mark.parametrize(
    ("density", "message"),
    [
        (lambda xi: xi, "negative at xi = -1"),
        (lambda xi: np.where(xi > 0.5, np.nan, 1.0), "not a finite number at xi = 0.5"),
        (lambda xi: 0.0, "nowhere positive"),
        (lambda xi: (1 - xi**2) * (1 - 0.5 * xi), r"over \(1 - xi\) falls at xi = 0"),
        (lambda xi: (1 - xi**2) ** 2, r"over \(1 - xi\) falls at xi = 0.3"),
        (lambda xi: 1 + np.sin(1e9 * xi), "jumps or bends"),
    ],
)
def test_a_density_that_is_no_pressure_is_refused(density, message):
    with pytest.raises(UsageError, match=message) as error:
        Tabulated.from_function(density)
    assert error.value.problems[0].remedy


@pytest.mark.parametrize(
    ("xi", "density", "problems"),
    [
        ([-1, 0, 1], [0, 1, np.nan], [("point 2", "not a finite number")]),
        (
            [-1, 0, 0],
            [0, -1, 1],
            [("point 1", "negative"), ("point 2", "not increase"), ("point 2", "not go from -1")],
        ),
        ([-1], [0], [("", "not two columns")]),
        ([-1, 0.5, 0.8, 1], [0, 1, 0.1, 0.1], [("", "falls at xi")]),
    ],
)
def test_a_wrong_table_is_refused_with_its_point(xi, density, problems):
    with pytest.raises(UsageError) as error:
        Tabulated.from_table(xi, density)
    for found, (point, reason) in zip(error.value.problems, problems, strict=True):
        assert point in found.reason and reason in found.reason and found.remedy
