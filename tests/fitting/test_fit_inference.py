"""Profiles, thresholds and the deviance, against scipy and closed forms."""

import numpy as np
import pytest
from recipes import FZ, GIVEN, STD, TRUTH, VAGUE_NOISE, brush_force, curve, solved, table
from scipy import optimize, stats

from tirefit.fitting.estimate import fit
from tirefit.fitting.problem.likelihood import Rule
from tirefit.fitting.solve.inference import _of_squares, deviance, threshold
from tirefit.fitting.uncertainty.identified import limited
from tirefit.models import MODELS
from tirefit.params import specs


def test_threshold_of_given_noise_is_chi_squared():
    np.testing.assert_allclose(threshold(False, 10, 2), stats.chi2.ppf(0.95, 1))


@pytest.mark.parametrize(("n", "p"), [(10, 2), (400, 3), (4, 3)])
def test_threshold_of_estimated_noise_is_students_t(n, p):
    # In a linear model S(theta)/S_min = 1 + t^2/dof at t standard errors.
    t = stats.t.ppf(0.975, n - p)
    np.testing.assert_allclose(threshold(True, n, p), n * np.log(1 + t**2 / (n - p)))
    assert threshold(True, n, p) > threshold(False, n, p)
    assert 10 < threshold(True, p, p) < 1e3  # as many parameters as rows


def test_a_block_without_squares_has_a_deviance_only_if_its_noise_is_given():
    """On the host, where a logarithm of zero warns, which is an error in tests."""
    assert _of_squares(Rule(inflation=2.0), 0.0, np) == 0.0
    with pytest.warns(RuntimeWarning, match="divide by zero"):
        _of_squares(Rule(smallest=1.0), 0.0, np)


@pytest.mark.parametrize(
    ("name", "low", "high", "unknown"),
    [
        ("cpa2", 1e4, 0.99e5, False),
        ("cpa2", 1e4, 1.01e5, True),  # a factor of ten
        ("mu", 0.5, 1.49, False),
        ("mu", 0.5, 1.51, True),  # a factor of three
        ("d", 0.0, 0.79, False),
        ("d", -0.3, 0.79, True),  # 0.8 of the range of 1.33
        ("d", 0.35, 1.0, False),  # open at the bound
        ("d", 0.3, 1.0, True),  # half of the range
    ],
)
def test_wide_intervals_do_not_identify_a_parameter(name, low, high, unknown):
    assert limited(specs(MODELS["brush-d"])[name], low, high) != unknown


def squares(data, cpa2, mu, std=STD):
    force = brush_force(data["sigma_x"], cpa2, mu)
    return float(np.sum((data["fx"] - force) ** 2)) / std**2


def deviance_at(result, values):
    problem = result.solved.problem
    return float(deviance(problem, problem.layout.unconstrained(values)))


OFF = {"cpa2": 4.98e4, "mu": 1.001}


def best(result):
    return {label: result.least_squares[label].value for label in ("cpa2", "mu")}


def test_deviance_of_given_noise_is_the_sum_of_squares(given):
    found = deviance_at(given, OFF) - deviance_at(given, best(given))
    data = given.table
    exact = squares(data, **OFF) - squares(data, **best(given))
    assert given.statistics.n_effective == 400
    np.testing.assert_allclose(found, exact, rtol=1e-6)


def test_deviance_of_estimated_noise_is_the_log_of_the_sum(estimated):
    found = deviance_at(estimated, OFF) - deviance_at(estimated, best(estimated))
    data = estimated.table
    ratio = squares(data, **OFF) / squares(data, **best(estimated))
    np.testing.assert_allclose(found, 400 * np.log(ratio), rtol=1e-6)


def constrained(data, label, value):
    """Smallest sum of squares with one of the two parameters held."""
    other = "mu" if label == "cpa2" else "cpa2"
    scale = TRUTH[other]

    def objective(u):
        return squares(data, **{label: value, other: u * scale})

    return optimize.minimize_scalar(
        objective, bounds=(0.5, 2), method="bounded", options={"xatol": 1e-9}
    ).fun


@pytest.mark.parametrize("label", ["cpa2", "mu"])
@pytest.mark.parametrize("end", [0, 1])
def test_profile_ends_agree_with_brute_force(given, estimated, label, end):
    for result, level in ((given, 3.841), (estimated, threshold(True, 400, 2))):
        value = result.intervals["profile"][label][end]
        least = squares(result.table, **best(result))
        held = constrained(result.table, label, value)
        if result is given:
            found = held - least
        else:
            found = 400 * np.log(held / least)
        np.testing.assert_allclose(found, level, rtol=0.015)


def test_an_undetermined_friction_has_an_open_interval(vague):
    mu, stiffness = vague.least_squares["mu"], vague.least_squares["cpa2"]
    assert not mu.identified and mu.std is None
    assert mu.ci95[1] == 5.0  # the bound: nothing in the data limits it
    assert mu.ci95[0] < TRUTH["mu"]
    assert stiffness.identified
    low, high = stiffness.ci95
    assert low < TRUTH["cpa2"] < high
    # The lower end is real: there the sum of squares has risen by 3.84.
    least = squares(vague.table, **best(vague))
    at = (constrained(vague.table, "mu", mu.ci95[0]) - least) / VAGUE_NOISE**2
    np.testing.assert_allclose(at, 3.841, rtol=0.05)


def test_autocorrelated_noise_widens_every_interval():
    generator = np.random.default_rng(2)
    n, rho = 400, 0.9
    noise = np.empty(n)
    noise[0] = generator.standard_normal()
    for i in range(1, n):
        noise[i] = rho * noise[i - 1] + np.sqrt(1 - rho**2) * generator.standard_normal()
    slip = np.linspace(0, 0.19, n)
    columns = {
        "sigma_x": slip,
        "fx": brush_force(slip, **TRUTH) + STD * noise,
        "fz": np.full(n, FZ),
        "time": np.arange(n) / 100,
    }
    data = table(columns)
    wide = fit(data, config=GIVEN)
    narrow = fit(data, config=GIVEN | {"noise": {"fx": STD, "effective_samples": "all"}})
    assert wide.statistics.n_effective < 100
    assert narrow.statistics.n_effective == 400
    factor = np.sqrt(400 / wide.statistics.n_effective)
    for label in ("cpa2", "mu"):
        ratio = wide.least_squares[label].std / narrow.least_squares[label].std
        np.testing.assert_allclose(ratio, factor, rtol=1e-3)
        low, high = wide.least_squares[label].ci95
        assert low < TRUTH[label] < high
    assert any("are correlated" in s for s in wide.warnings)


def test_covariance_of_a_prior_combines_with_the_data():
    # The prior alone informs mu here, so its standard deviation is the prior's.
    config = GIVEN | {"parameters": {"mu": {"prior": {"mean": 1.0, "std": 0.01}}}}
    data = curve(reach=0.1)
    end = solved(data, config)
    mu = float(end.problem.layout.natural(end.z)["mu"])
    slope = (mu - 0.01) * (5.0 - mu) / 4.99
    np.testing.assert_allclose(mu, 1.0, atol=0.002)
    np.testing.assert_allclose(slope * np.sqrt(end.covariance[1, 1]), 0.01, rtol=0.02)
