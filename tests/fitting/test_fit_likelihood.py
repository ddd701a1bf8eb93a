"""The deviance of rows compared with NumPy and quadrature; Huber's loss with SciPy."""

import numpy as np
import pytest
from recipes import STD, TRUTH, brush_force, curve, solved, table
from scipy.integrate import trapezoid
from scipy.optimize import least_squares
from scipy.special import erfcx, ndtr

from tirefit.fitting.problem.build import build
from tirefit.fitting.problem.config import parse_config
from tirefit.fitting.problem.latent_slip import _erfcx, _normal_part
from tirefit.fitting.problem.likelihood import moments, root_deviance
from tirefit.fitting.solve.multistart import with_densities

OFF = {"cpa2": 4.6e4, "mu": 0.97}
TAU = 0.004


def small(n=11, loss="squares", tau=None, values=OFF, force_std=STD):
    """Data with few rows, and their problem; a noisy slip is laid out for ``values``."""
    noise = {"fx": force_std, "loss": loss} | ({"sigma_x": tau} if tau else {})
    data = curve(n=n, seed=8, slip_std=tau or 0.0)
    task = build(data, "brush", parse_config({"noise": noise}))
    z = np.asarray(task.problem.layout.unconstrained(values))
    return data, with_densities(task.problem, {}, z)[0]


def blocks(problem, values=OFF):
    z = problem.layout.unconstrained(values)
    return {k: np.asarray(block) for k, block in root_deviance(problem, z).items()}


def whitened(data, values=OFF):
    return (data["fx"] - brush_force(data["sigma_x"], **values)) / STD


def test_without_slip_noise_the_block_is_the_whitened_residual():
    data, problem = small()
    found = blocks(problem)
    assert list(found) == ["fx"] and found["fx"].shape == (12,)
    np.testing.assert_allclose(found["fx"][:11], whitened(data), rtol=1e-9)
    assert found["fx"][11] == 0  # padding


def marginal_deviance(slip, force, tau, noise, nodes, density):
    """-2 log of the likelihood of one row over that of a row without force noise."""
    s = np.linspace(nodes[0], nodes[-1], 400_001)
    prior = np.exp(-0.5 * ((s - slip) / tau) ** 2) * np.interp(s, nodes, density)
    both = prior * np.exp(-0.5 * ((force - brush_force(s, **OFF)) / noise) ** 2)
    return -2 * np.log(trapezoid(both, s) / trapezoid(prior, s))


@pytest.mark.parametrize("noise", [STD / 2, STD, 10 * STD])
def test_slip_noise_block_is_the_marginal_likelihood(noise):
    """By brute force; the slope of the curve times the slip noise is up to 20, 10 and 1
    standard deviations of the force, and two nodes are up to half of these apart."""
    data, problem = small(tau=TAU)
    scale = {"fx": problem.rows.scale["fx"] * noise / STD}
    nodes = problem.rows.nodes["sigma_x"]
    problem = problem.with_rows(scale=scale)
    found = blocks(problem)
    assert list(found) == ["sigma_x"]
    for i in range(11):
        row = data["sigma_x"][i], data["fx"][i], TAU, noise
        exact = marginal_deviance(*row, np.asarray(nodes.slip[i]), np.asarray(nodes.density[i]))
        # Forces at half a slip standard deviation are known to 1 N between the nodes.
        np.testing.assert_allclose(found["sigma_x"][i] ** 2, exact, rtol=0.02, atol=0.05)


def test_vanishing_slip_noise_is_no_slip_noise():
    data, problem = small(tau=1e-7)
    found = blocks(problem)["sigma_x"][:11]
    np.testing.assert_allclose(found, np.abs(whitened(data)), rtol=1e-3, atol=2e-3)


def test_steep_forces_judge_the_measured_slip():
    """The likelihood of the measured slip for the force, by brute force: one standard
    deviation of the slip changes the force by up to 37 of its own. A force above the largest
    one of the curve misses it by their distance, here by up to 12 standard deviations, less 3."""
    noise = 10.0
    data, problem = small(tau=TAU, force_std=noise)
    nodes, found = problem.rows.nodes["sigma_x"], blocks(problem)["sigma_x"]
    assert nodes.of_force is not None
    for i in range(11):
        at, density = np.asarray(nodes.slip[i]), np.asarray(nodes.density[i])
        s = np.linspace(at[0], at[-1], 400_001)
        off = (data["fx"][i] - brush_force(s, **OFF)) / noise
        missed = np.min(off**2)
        alone = np.exp(-0.5 * (off**2 - missed)) * np.interp(s, at, density)
        both = alone * np.exp(-0.5 * ((data["sigma_x"][i] - s) / TAU) ** 2)
        exact = max(np.sqrt(missed) - 3, 0) ** 2 - 2 * np.log(
            trapezoid(both, s) / trapezoid(alone, s)
        )
        np.testing.assert_allclose(found[i] ** 2, exact, rtol=0.03, atol=0.03)


def test_moments_of_a_row_average_over_its_latent_slips():
    data, problem = small(tau=TAU, values=TRUTH)
    mean, variance = moments(problem, problem.layout.unconstrained(TRUTH))
    nodes = problem.rows.nodes["sigma_x"]
    generator = np.random.default_rng(0)
    for i in range(3):
        draws = data["sigma_x"][i] + TAU * generator.standard_normal(400_000)
        weight = np.interp(draws, np.asarray(nodes.slip[i]), np.asarray(nodes.density[i]))
        force = brush_force(draws, **TRUTH)
        expected = np.average(force, weights=weight)
        spread = np.average((force - expected) ** 2, weights=weight)
        np.testing.assert_allclose(mean["fx"][i], expected, atol=3.0)
        np.testing.assert_allclose(variance["fx"][i], STD**2 + spread, rtol=0.03)


@pytest.mark.parametrize("noise", [{"fx": STD}, {}], ids=["given", "estimated"])
def test_huber_is_that_of_scipy_and_resists_outliers(noise):
    """One row in ten is 20 standard deviations too low, which lowers mu by 2 % in squares."""
    data = curve(seed=9)
    slip, force = data["sigma_x"], data["fx"] - 20 * STD * (np.arange(400) % 10 == 0)
    config = {"noise": noise | {"loss": "huber"}, "solver": "gauss-newton"}
    end = solved(table(dict(data.columns) | {"fx": force}), config)
    found = end.problem.layout.natural(end.z)
    scale = float(end.problem.rows.scale["fx"][0])
    np.testing.assert_allclose(scale, STD, rtol=0.25 if not noise else 1e-12)

    def residual(x):
        return (brush_force(slip, 1e4 * x[0], x[1]) - force) / scale

    scipy = least_squares(residual, [4.0, 0.9], loss="huber", f_scale=1.345, xtol=1e-12)
    np.testing.assert_allclose([found["cpa2"] / 1e4, found["mu"]], scipy.x, rtol=1e-4)
    assert abs(found["mu"] - TRUTH["mu"]) < 0.004


def test_force_noise_of_rows_with_noisy_slip_is_estimated():
    # The residuals hold the slip's noise too (up to 2.7 times the force's).
    data = curve(seed=10, slip_std=0.001)
    end = solved(data, {"noise": {"sigma_x": 0.001}, "solver": "gauss-newton", "starts": 1})
    scale = float(end.problem.rows.scale["fx"][0])
    np.testing.assert_allclose(scale, STD, rtol=0.12)
    values = end.problem.layout.natural(end.z)
    np.testing.assert_allclose(values["mu"], TRUTH["mu"], atol=4 * 0.0008)
    np.testing.assert_allclose(values["cpa2"], TRUTH["cpa2"], rtol=4 * 0.0035)


def test_normal_integrals_agree_with_scipy():
    """The polynomial has a relative error of 6e-9; a difference of two values of it, 1e-7."""
    x = np.concatenate([np.linspace(0, 10, 1001), np.geomspace(10, 1e6, 200)])
    np.testing.assert_allclose(_erfcx(x), erfcx(x), rtol=1e-8)
    low = np.linspace(-6, 6, 241)
    mass, first, log = (np.asarray(v) for v in _normal_part(low, low + 0.5))
    expected = np.sqrt(2 * np.pi) * (ndtr(low + 0.5) - ndtr(low))
    np.testing.assert_allclose(mass * np.exp(log), expected, rtol=1e-6)
    expected = np.exp(-(low**2) / 2) - np.exp(-((low + 0.5) ** 2) / 2)
    np.testing.assert_allclose(first * np.exp(log), expected, rtol=1e-9, atol=1e-16)
