"""Least squares: every solver compared with SciPy and certified values."""

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
from recipes import STD, TRUTH, brush_force, curve, magic_force, solved
from scipy import optimize

from tirefit import fit
from tirefit.fitting.problem.config import FitConfig
from tirefit.fitting.solve.least_squares import (
    SOLVERS,
    Normal,
    NormalEquations,
    least_squares,
    on_host,
)
from tirefit.params import constrain
from tirefit.results import UsageError

CASES = {
    "brush": (brush_force, TRUTH, 1.6),
    "brush-d": (brush_force, TRUTH | {"d": 0.2}, 1.6),
    "magic-formula": (magic_force, {"B": 12.0, "C": 1.6, "D": 1.0, "E": -0.5}, 5.0),
}
_SCIPY = {}


def scipy_answer(model):
    """Estimate and covariance in natural values, from SciPy and the second formulas."""
    if model not in _SCIPY:
        force, truth, reach = CASES[model]
        data = curve(truth, force=force, reach=reach, seed=3)
        slip, observed = data["sigma_x"], data["fx"]
        start = np.array(list(truth.values()))
        scale = np.abs(start)

        def residual(u):
            values = dict(zip(truth, u * scale, strict=True))
            return (observed - force(slip, **values)) / STD

        end = optimize.least_squares(
            residual, start / scale, jac="3-point", xtol=1e-15, ftol=1e-15, gtol=1e-12
        )
        cov = np.linalg.inv(end.jac.T @ end.jac) * np.outer(scale, scale)
        _SCIPY[model] = data, list(truth), end.x * scale, cov
    return _SCIPY[model]


@pytest.mark.parametrize(
    ("model", "solver"),
    [
        *((model, "gauss-newton") for model in CASES),
        ("brush", "jaxopt"),
        ("magic-formula", "optimistix"),
    ],
)
def test_solver_agrees_with_scipy(model, solver):
    data, names, values, cov = scipy_answer(model)
    noise = {"fx": STD, "effective_samples": "all"}
    end = solved(data, {"noise": noise, "solver": solver}, model)
    layout = end.problem.layout
    assert list(layout.labels) == names
    # From afar the Magic Formula has other minima; a brush has none.
    assert end.converged and end.starts == 8
    assert end.agreeing >= (2 if model == "magic-formula" else 8)
    assert not end.ambiguous
    found = np.asarray(layout.vector(jnp.asarray(end.z)))
    std = np.sqrt(np.diag(cov))
    # 1e-6, or so little of the standard deviation that it means nothing.
    share = 1e-3 if solver == "gauss-newton" else 1e-4
    np.testing.assert_array_less(
        np.abs(found - values), np.maximum(1e-6 * np.abs(values), share * std)
    )
    slope = np.array(
        [
            (constrain(z + 1e-5, p.spec) - constrain(z - 1e-5, p.spec)) / 2e-5
            for z, (_, p) in zip(end.z, layout.elements, strict=True)
        ]
    )
    np.testing.assert_allclose(np.diag(end.covariance), (std / slope) ** 2, rtol=0.01)
    mine = slope * end.covariance * slope[:, None]
    limit = 0.01 * np.outer(std, std)
    np.testing.assert_array_less(np.abs(mine - cov), limit)


@pytest.mark.parametrize("solver", list(SOLVERS))
def test_a_trial_step_outside_the_domain_does_not_stall(solver):
    # jaxopt's own Levenberg-Marquardt returns 5 here, with NaN and no flag.
    def residual(p):
        return jnp.log(p) - jnp.log(0.01), jnp.ones(1)

    found = least_squares(residual, jnp.array([5.0]), solver)
    np.testing.assert_allclose(found.z[0], 0.01, rtol=1e-6)
    assert bool(found.converged)


# NIST StRD MGH09 (Kowalik and Osborne), higher level of difficulty, second start.
MGH09_Y = [0.1957, 0.1947, 0.1735, 0.16, 0.0844, 0.0627, 0.0456, 0.0342, 0.0323, 0.0235, 0.0246]
MGH09_X = [4.0, 2.0, 1.0, 0.5, 0.25, 0.167, 0.125, 0.1, 0.0833, 0.0714, 0.0625]
MGH09 = [0.19280693458, 0.19128232873, 0.12305650693, 0.13606233068]


@pytest.mark.parametrize(
    "solver", [pytest.param(s, marks=pytest.mark.long) if s == "jaxopt" else s for s in SOLVERS]
)
def test_certified_values_of_a_hard_problem_are_found(solver):
    x, y = jnp.array(MGH09_X), jnp.array(MGH09_Y)

    def residual(b):
        # Scaled so that the tolerances, made for whitened residuals, mean something.
        y_fit = b[0] * (x**2 + x * b[1]) / (x**2 + x * b[2] + b[3])
        return 1e3 * (y - y_fit), jnp.ones(11)

    found = least_squares(residual, jnp.array([0.25, 0.39, 0.415, 0.39]), solver)
    np.testing.assert_allclose(found.cost / 1e6, 3.0750560385e-4, rtol=1e-8)
    np.testing.assert_allclose(found.z, MGH09, rtol=5e-4)
    # jaxopt's gradient tolerance is out of reach at this scale: it may not claim it.
    assert bool(found.converged) or solver == "jaxopt"


def test_a_step_limit_is_reported():
    def residual(p):
        return jnp.stack([10 * (p[1] - p[0] ** 2), 1 - p[0]]), None

    start = jnp.array([-1.2, 1.0])
    assert not bool(least_squares(residual, start, max_steps=3).converged)
    whole = least_squares(residual, start)
    assert bool(whole.converged)
    np.testing.assert_allclose(whole.z, 1.0, rtol=1e-6)


@pytest.mark.parametrize("start", [(0.0, 0.0), (3.0, -2.0), (-5.0, 6.0), (1.0, 11.9)])
def test_with_a_parameter_at_its_bound_the_others_converge(start):
    """b = 1 / (1 + e^-z) would be 1.5 without bounds; a follows at its bound of 1."""
    x = np.linspace(0.1, 1.0, 40)
    y = 2.0 * x + 1.5 * x**2 + 0.01 * np.sin(40 * x)
    a = x @ (y - x**2) / (x @ x)  # by the normal equation with b = 1

    def residual(z):
        return 100 * (z[0] * x + x**2 / (1 + jnp.exp(-z[1])) - y), jnp.ones(40)

    end = least_squares(residual, jnp.array(start), lower=-12.0, upper=12.0)
    assert bool(end.converged) and end.steps < 40
    assert end.z[1] > 7
    np.testing.assert_allclose(end.z[0], a, atol=2e-3)
    np.testing.assert_allclose(end.cost, 1e4 * np.sum((a * x + x**2 - y) ** 2), rtol=1e-3)


def logistic(z):
    """Residuals of a saturating curve whose limit is beyond the bound of z."""
    x = np.linspace(-2.0, 3.0, 60)
    y = 3.0 / (1 + np.exp(-1.3 * x)) + 0.05 * np.cos(9 * x)
    return z[0] / (1 + jnp.exp(-z[1] * (x - z[2]))) - y


@pytest.mark.parametrize("upper", [np.inf, 2.8])
def test_all_drivers_agree_with_scipy_within_bounds(upper):
    """Compiled, through ``least_squares``, and on the host."""
    start, high = np.array([1.0, 0.5, 0.3]), np.array([upper, np.inf, np.inf])
    peer = optimize.least_squares(
        logistic, start, "3-point", bounds=(-np.inf, high), xtol=1e-15, ftol=1e-15, gtol=1e-12
    )
    slopes = jax.jit(jax.jacfwd(logistic))

    def normal(z):
        values, slope = np.asarray(logistic(z)), np.asarray(slopes(z))
        return Normal(values @ values, slope.T @ slope, slope.T @ values)

    exact = NormalEquations(rtol=1e-14)
    compiled = least_squares(lambda z: (logistic(z), None), jnp.array(start), exact, upper=high)
    hosted = on_host(normal, start, exact, upper=high)
    assert bool(compiled.converged) and hosted.converged
    for z in (compiled.z, hosted.z):
        # SciPy stays 1e-10 or so inside a bound.
        np.testing.assert_allclose(z, peer.x, rtol=1e-6, atol=1e-7)
        np.testing.assert_allclose(logistic(z) @ logistic(z), 2 * peer.cost, rtol=1e-8)
    np.testing.assert_allclose(hosted.normal, peer.jac.T @ peer.jac, rtol=1e-4, atol=1e-4)
    # Rounding decides the last steps.
    assert abs(int(compiled.steps) - hosted.steps) < 3


def test_a_start_without_a_finite_cost_is_reported():
    assert not on_host(lambda z: Normal(np.nan, np.eye(1), np.zeros(1)), np.zeros(1)).converged
    end = least_squares(lambda z: (jnp.log(z), None), jnp.array([-1.0]))
    assert not bool(end.converged)


@pytest.mark.parametrize(
    "solver",
    [
        optx.LevenbergMarquardt(rtol=1e-10, atol=1e-10),
        optx.Dogleg(rtol=1e-10, atol=1e-10),
        # Holds an array, so that it cannot be hashed.
        optx.IndirectLevenbergMarquardt(rtol=1e-10, atol=1e-10, lambda_0=jnp.array(1.0)),
    ],
    ids=lambda solver: type(solver).__name__,
)
def test_a_solver_of_optimistix_finds_the_same_minimum(solver):
    data = curve(seed=5)
    ours, other = fit(data, "brush"), fit(data, "brush", solver=solver)
    assert other.solver == type(solver).__name__ and ours.solver == "gauss-newton"
    np.testing.assert_allclose(other.z, ours.z, rtol=1e-8)
    np.testing.assert_allclose(other.statistics.rmse, ours.statistics.rmse, rtol=1e-8)
    np.testing.assert_allclose(
        [one.ci95 for one in other.parameters.values() if not one.fixed],
        [one.ci95 for one in ours.parameters.values() if not one.fixed],
        rtol=1e-6,
    )


@pytest.mark.parametrize("solver", [optx.LevenbergMarquardt, optx.BFGS(1e-8, 1e-8), 3])
def test_what_is_no_solver_is_refused_with_the_choices(solver):
    # The type checks of the tests would refuse it as an argument of fit.
    config = FitConfig().model_copy(update={"solver": solver})
    with pytest.raises(UsageError, match=r"optx.LevenbergMarquardt\(") as refused:
        fit(curve(), "brush", config=config)
    for name in SOLVERS:
        assert name in str(refused.value)
