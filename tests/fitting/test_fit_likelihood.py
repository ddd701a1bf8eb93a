"""The deviance of rows compared with NumPy and quadrature; robust losses."""

import jax.numpy as jnp
import numpy as np
import pytest
from recipes import STD, TRUTH, brush_force, curve, solved, table
from scipy.integrate import trapezoid

from tirefit.fitting.config import parse_config
from tirefit.fitting.likelihood import LOSSES, root_deviance, row_moments
from tirefit.fitting.problem import build
from tirefit.fitting.solve import with_scale

OFF = {"cpa2": 4.6e4, "mu": 0.97}
SLOPE = 1e5
TAU = 0.004


def small(n=11, loss="squares", tau=None):
    """Data with few rows, their problem, and the densities of its noisy slips."""
    noise = {"fx": STD, "loss": loss} | ({"sigma_x": tau} if tau else {})
    data = curve(n=n, seed=8, slip_std=tau or 0.0)
    task = build(data, "brush", parse_config({"noise": noise}))
    laid_out = with_scale(task.problem, task.slip_density, {}, SLOPE)
    return data, laid_out, task.slip_density


def blocks(problem, values=OFF):
    z = problem.layout.unconstrained(values)
    return {k: np.asarray(block) for k, block in root_deviance(problem, z).items()}


def whitened(data, values=OFF):
    return (data["fx"] - brush_force(data["sigma_x"], **values)) / STD


def test_without_slip_noise_the_block_is_the_whitened_residual():
    data, problem, _ = small()
    found = blocks(problem)
    assert list(found) == ["fx"] and found["fx"].shape == (12,)
    np.testing.assert_allclose(found["fx"][:11], whitened(data), rtol=1e-9)
    assert found["fx"][11] == 0  # padding


FORMULAS = {
    "squares": lambda r: r**2,
    "huber": lambda r: np.where(abs(r) <= 1.345, r**2, 2 * 1.345 * abs(r) - 1.345**2),
    "soft-l1": lambda r: 2 * (np.sqrt(1 + r**2) - 1),
    "cauchy": lambda r: 2.385**2 * np.log(1 + (r / 2.385) ** 2),
}


@pytest.mark.parametrize("loss", list(LOSSES))
def test_each_loss_follows_its_formula(loss):
    r = np.array([0.0, 1e-9, 0.3, -1.3, 1.4, -8.0, 1e3])
    found = np.asarray(LOSSES[loss](jnp.asarray(r**2)))
    np.testing.assert_allclose(found, FORMULAS[loss](r), rtol=1e-9, atol=1e-15)
    data, problem, _ = small(loss=loss)
    block = blocks(problem)["fx"][:11]
    residual = whitened(data)
    np.testing.assert_allclose(block**2, FORMULAS[loss](residual), rtol=1e-9)
    assert (np.sign(block) == np.sign(residual)).all()


def marginal_deviance(slip, force, tau, density):
    """-2 log of the likelihood of one row over that of a row without force noise."""
    knots, heights = density

    s = slip + tau * np.linspace(-8, 8, 40_001)
    inside = knots[(knots > s[0]) & (knots < s[-1])]
    s = np.union1d(s, inside)
    prior = np.exp(-0.5 * ((s - slip) / tau) ** 2)
    prior = prior * np.interp(s, knots, heights, left=0.0, right=0.0)
    both = prior * np.exp(-0.5 * ((force - brush_force(s, **OFF)) / STD) ** 2)
    return -2 * np.log(trapezoid(both, s) / trapezoid(prior, s))


def test_slip_noise_block_is_the_marginal_likelihood():
    data, problem, densities = small(tau=TAU)
    found = blocks(problem)
    assert list(found) == ["sigma_x"]
    density = densities["sigma_x"]
    checked = 0
    for i in range(11):
        slip, force = data["sigma_x"][i], data["fx"][i]
        exact = marginal_deviance(slip, force, TAU, density)
        if np.isfinite(exact) and exact < 15:  # beyond, the floor of the density rules
            value = found["sigma_x"][i] ** 2
            np.testing.assert_allclose(value, exact, rtol=5e-3, atol=0.01)
            checked += 1
    assert checked >= 7


def test_vanishing_slip_noise_is_no_slip_noise():
    data, problem, _ = small(tau=1e-7)
    found = blocks(problem)["sigma_x"][:11]
    np.testing.assert_allclose(found, np.abs(whitened(data)), rtol=1e-3, atol=2e-3)


def test_moments_of_a_row_average_over_its_latent_slips():
    data, problem, densities = small(tau=TAU)
    mean, variance = row_moments(problem, problem.layout.unconstrained(TRUTH))
    density = densities["sigma_x"]
    generator = np.random.default_rng(0)
    for i in range(3):
        draws = data["sigma_x"][i] + TAU * generator.standard_normal(400_000)
        weight = np.interp(draws, *density, left=0.0, right=0.0)
        force = brush_force(draws, **TRUTH)
        expected = np.average(force, weights=weight)
        spread = np.average((force - expected) ** 2, weights=weight)
        np.testing.assert_allclose(mean["fx"][i], expected, atol=3.0)
        np.testing.assert_allclose(variance["fx"][i], STD**2 + spread, rtol=0.03)


def outlying():
    """One row in ten is 20 standard deviations too low."""
    data = curve(seed=9)
    columns = dict(data.columns)
    columns["fx"] = columns["fx"] - 20 * STD * (np.arange(400) % 10 == 0)
    return table(columns)


@pytest.mark.parametrize("loss", ["squares", "huber", "cauchy"])
def test_outliers_bias_squares_but_not_robust_losses(loss):
    data = outlying()
    end = solved(data, {"noise": {"loss": loss}, "solver": "gauss-newton"})
    mu = float(end.problem.layout.natural(end.z)["mu"])
    scale = float(end.problem.rows.scale["fx"][0])
    # 0.0007 is the standard deviation of mu without outliers; 2 % the raw pull.
    if loss == "squares":
        assert mu < TRUTH["mu"] - 0.01 and scale > 4 * STD
    else:
        assert abs(mu - TRUTH["mu"]) < {"huber": 0.004, "cauchy": 0.0025}[loss]
        np.testing.assert_allclose(scale, STD, rtol=0.25)


def test_force_noise_of_rows_with_noisy_slip_is_estimated():
    # The residuals hold the slip's noise too (up to 2.7 times the force's).
    data = curve(seed=10, slip_std=0.001)
    end = solved(data, {"noise": {"sigma_x": 0.001}, "solver": "gauss-newton", "starts": 1})
    scale = float(end.problem.rows.scale["fx"][0])
    np.testing.assert_allclose(scale, STD, rtol=0.12)
    values = end.problem.layout.natural(end.z)
    np.testing.assert_allclose(values["mu"], TRUTH["mu"], atol=4 * 0.0008)
    np.testing.assert_allclose(values["cpa2"], TRUTH["cpa2"], rtol=4 * 0.0035)
