"""Fits of rows with both slips varying."""

import numpy as np
import pytest
from recipes import FZ, solved, table

from tirefit.fitting.estimate import fit
from tirefit.fitting.problem.build import build, slip_of_forces
from tirefit.fitting.problem.config import parse_config
from tirefit.fitting.problem.likelihood import moments, root_deviance
from tirefit.fitting.solve.multistart import with_densities
from tirefit.models import MODELS, TireInputs, forces
from tirefit.params import with_values
from tirefit.report.fit.curves import fit_curve
from tirefit.results import DataError

TRUTH = {"cpa2": 5e4, "mu": 0.9, "stiffness_ratio": 0.6}
NOISE = {"fx": 40.0, "fy": 25.0}
LOADS = (2500.0, FZ, 5500.0)


def combined_force(sigma_x, alpha, fz, cpa2, mu, stiffness_ratio):
    """F_x, F_y of O(12)-(20) in plain NumPy."""
    kappa_y = stiffness_ratio * np.tan(alpha) * (1 + sigma_x)
    kappa = np.hypot(sigma_x, kappa_y)
    xi = np.maximum(0, 1 - 2 * cpa2 * kappa / (3 * mu * fz))
    force = mu * fz * (1 - xi**3) / kappa
    return force * sigma_x, force * kappa_y


def rows(n=400, seed=1, slip_std=0.0, loads=LOADS):
    """Braking and driving with any side slip, with Gaussian noise."""
    generator = np.random.default_rng(seed)
    sigma_x = generator.uniform(-0.1, 0.2, n)
    alpha = generator.uniform(-0.2, 0.2, n)
    fz = generator.choice(loads, n)
    fx, fy = combined_force(sigma_x, alpha, fz, **TRUTH)
    return {
        "sigma_x": sigma_x + slip_std * generator.standard_normal(n),
        "alpha": alpha,
        "fz": fz,
        "fx": fx + NOISE["fx"] * generator.standard_normal(n),
        "fy": fy + NOISE["fy"] * generator.standard_normal(n),
    }


@pytest.fixture(scope="module")
def result():
    config = {"force": ["fx", "fy"], "solver": "gauss-newton"}
    return fit(table(rows()), "brush-anisotropic", config=config)


def test_both_forces_recover_the_truth(result):
    assert result.status == "ok"
    for name, value in TRUTH.items():
        found = result.parameters[name]
        assert abs(found.value - value) < 3 * found.std
        assert found.std < 0.01 * value
    # Each force has its own noise.
    for name, std in NOISE.items():
        np.testing.assert_allclose(result.noise[name]["median_std"], std, rtol=0.12)


def test_one_force_of_combined_rows_is_fitted_at_both_slips():
    config = {"force": "fx", "solver": "gauss-newton"}
    result = fit(table(rows(loads=(FZ,))), "brush-anisotropic", config=config)
    for name, value in TRUTH.items():
        found = result.parameters[name]
        assert found.identified and abs(found.value - value) < 3 * found.std
    # At one load, the curves belong to three lateral slips.
    curve = fit_curve(result)
    assert curve.note == "points moved along the fit to $F_z$ = 4000 N"
    for group, one in zip(curve.groups, curve.curves, strict=True):
        label, sign, angle = group.label.partition("≈")
        assert (label, sign) == (r"$\alpha$ ", "≈")
        alpha = np.radians(float(angle.rstrip("°")))
        expected = combined_force(one.slip, alpha, FZ, **TRUTH)[0]
        np.testing.assert_allclose(one.force, expected, atol=0.02 * FZ)
        residual = group.force - np.interp(group.slip, one.slip, one.force)
        np.testing.assert_allclose(residual.std(), NOISE["fx"], rtol=0.2)
    assert len(curve.groups) == 3


@pytest.mark.parametrize("channel", ["fx", "fy"])
def test_points_are_drawn_at_the_other_slip_of_their_curve(result, channel):
    """Pure slip: points scatter about the curve by the noise, not by the other slip."""
    curve = fit_curve(result, channel)
    assert len(curve.groups) == len(curve.curves) == 3
    other = {"fx": r"$\alpha$ = 0°", "fy": r"$\sigma_x$ = 0"}[channel]
    assert curve.note == f"points moved along the fit to {other}"
    for group, one, load in zip(curve.groups, curve.curves, LOADS, strict=True):
        slips = one.slip if channel == "fx" else np.radians(one.slip)
        pure = (slips, 0 * slips) if channel == "fx" else (0 * slips, slips)
        with np.errstate(invalid="ignore"):
            expected = combined_force(*pure, load, **TRUTH)[channel == "fy"]
        np.testing.assert_allclose(one.force, expected, atol=0.01 * load)
        residual = group.force - np.interp(group.slip, one.slip, one.force)
        np.testing.assert_allclose(residual.std(), NOISE[channel], rtol=0.2)
        assert np.mean(np.abs(residual) < 2 * NOISE[channel]) > 0.9


def noisy_task(model, noise, columns):
    config = parse_config({"force": ["fx", "fy"], "noise": NOISE | noise})
    return build(table(columns), model, config)


def test_all_forces_share_one_noisy_slip():
    """The block of a row is its marginal likelihood over the latent sigma_x."""
    tau, columns = 0.004, rows(n=40, seed=3, slip_std=0.004, loads=(FZ,))
    task = noisy_task("brush-anisotropic", {"sigma_x": tau}, columns)
    z = np.asarray(task.problem.layout.unconstrained(TRUTH))
    problem = with_densities(task.problem, {}, z)[0]
    assert {c.name: c.slip for c in problem.channels} == {"fx": "sigma_x", "fy": "sigma_x"}
    blocks = root_deviance(problem, z)
    assert list(blocks) == ["sigma_x"]
    nodes = problem.rows.nodes["sigma_x"]
    mean, _ = moments(problem, z)
    checked = 0
    for i in range(40):
        row = {name: column[i] for name, column in columns.items()}
        latent = row["sigma_x"] + tau * np.linspace(-4, 4, 20_001)
        weight = np.interp(latent, np.asarray(nodes.slip[i]), np.asarray(nodes.density[i]))
        weight = weight * np.exp(-0.5 * ((latent - row["sigma_x"]) / tau) ** 2)
        true = combined_force(latent, row["alpha"], row["fz"], **TRUTH)
        pairs = zip(NOISE, true, strict=True)
        square = sum(((row[k] - force) / NOISE[k]) ** 2 for k, force in pairs)
        share = np.sum(weight * np.exp(-square / 2)) / np.sum(weight)
        value = float(blocks["sigma_x"][i]) ** 2
        if value < 15:
            np.testing.assert_allclose(value, -2 * np.log(share), rtol=0.01, atol=0.02)
            checked += 1
        side = np.average(true[1], weights=weight)
        np.testing.assert_allclose(mean["fy"][i], side, atol=1.0)
    assert checked > 30


def test_two_noisy_slips_in_combined_slip_are_refused():
    noise = {"sigma_x": 0.004, "alpha": 0.004}
    with pytest.raises(DataError, match="noise of both sigma_x and alpha") as error:
        noisy_task("brush-anisotropic", noise, rows(n=40))
    (problem,) = error.value.problems
    assert "combined slip" in problem.reason and "pure slip" in problem.remedy
    # Also where only one force is fitted: it depends on both.
    config = parse_config({"force": "fx", "noise": noise})
    with pytest.raises(DataError, match="noise of both"):
        build(table(rows(n=40)), "brush", config)


def pure_rows():
    """A braking test, then a cornering test, each other slip almost zero."""
    columns, still = rows(n=200), 0.001 * np.random.default_rng(5).normal(size=200)
    first = np.arange(200) < 100
    columns["sigma_x"] = np.where(first, columns["sigma_x"], still)
    columns["alpha"] = np.where(first, still, columns["alpha"])
    return columns


def test_in_pure_slip_each_force_has_its_own_noisy_slip():
    noisy, own = ("sigma_x", "alpha"), {"fx": "sigma_x", "fy": "alpha"}
    brush, formula = MODELS["brush"], MODELS["magic-formula"]
    assert slip_of_forces(table(pure_rows()), brush, ("fx", "fy"), noisy) == own
    # The pure-slip Magic Formula does not know of the other slip.
    assert slip_of_forces(table(rows()), formula, ("fx", "fy"), noisy) == own
    shared = slip_of_forces(table(rows()), brush, ("fx", "fy"), ("alpha",))
    assert shared == {"fx": "alpha", "fy": "alpha"}


TRUTHS = {
    "magic-formula-combined": {
        "Bx": 14.0,
        "Cx": 1.6,
        "Dx": 1.1,
        "Ex": 0.4,
        "By": 9.0,
        "Cy": 1.4,
        "Dy": 1.0,
        "Ey": -0.5,
    },
    "liu-peng": {"cpa2": 5e4, "mu": 0.9, "k_ratio": 0.6},
}


@pytest.mark.parametrize("name", TRUTHS)
def test_other_combined_models_are_recovered(name):
    columns, generator = rows(), np.random.default_rng(7)
    columns["sigma_x"] = generator.uniform(-0.3, 0.6, 400)
    columns["alpha"] = generator.uniform(-0.35, 0.35, 400)
    tire = with_values(MODELS[name], TRUTHS[name])
    names = ("sigma_x", "alpha", "fz")
    found = forces(tire, TireInputs(*(columns[key] for key in names)))
    for force, std in NOISE.items():
        noise = std * generator.standard_normal(400)
        columns[force] = np.asarray(getattr(found, force)) + noise
    config = {"force": ["fx", "fy"], "noise": NOISE, "solver": "gauss-newton"}
    end = solved(table(columns), config, name)
    values = end.problem.layout.natural(end.z)
    z = np.asarray(end.problem.layout.unconstrained(TRUTHS[name]))
    distance = (end.z - z) @ np.linalg.solve(end.covariance, end.z - z)
    # Chi-square of 3 to 8 parameters: beyond 27 in one of a thousand.
    assert end.converged and distance < 27
    for key, value in TRUTHS[name].items():
        np.testing.assert_allclose(values[key], value, rtol=0.05, atol=0.1)


@pytest.mark.long
def test_slip_noise_of_combined_rows_causes_no_bias():
    tau = 0.003
    noise = NOISE | {"sigma_x": tau}
    config = {"force": ["fx", "fy"], "noise": noise, "solver": "gauss-newton"}
    data = table(rows(slip_std=tau, loads=(FZ,)))
    result = fit(data, "brush-anisotropic", config=config)
    for name, value in TRUTH.items():
        found = result.parameters[name]
        assert abs(found.value - value) < 3 * found.std
    # The band of F_y has the noise of sigma_x in it, by the slope of F_y over that.
    drawn = fit_curve(result, "fy")
    for group, one in zip(drawn.groups, drawn.curves, strict=True):
        sigma_x = float(group.label.partition("≈")[2])
        alpha, step = np.radians(one.slip), 1e-6
        high, low = (combined_force(sigma_x + s, alpha, FZ, **TRUTH)[1] for s in (step, -step))
        std = np.hypot(NOISE["fy"], (high - low) / (2 * step) * tau)
        band = one.noise_high - one.force
        np.testing.assert_allclose(band, 1.96 * std, rtol=0.1)
        assert std.max() > 1.3 * NOISE["fy"]
