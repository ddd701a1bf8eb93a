"""Stiffness, contact length and friction that depend on the load."""

import numpy as np
import pytest

from tirefit.models import MODELS, LoadDependent, TireInputs, forces
from tirefit.params import with_values

NAMES = sorted(name for name, model in MODELS.items() if type(model) is LoadDependent)
TRUTH = {"cpa2": 6e4, "mu": 0.9, "half_length": 0.08, "fz0": 4000.0}
SLIPS = np.array([-0.1, -0.02, 0.0, 0.01, 0.05, 0.4])


@pytest.mark.parametrize("name", NAMES)
def test_at_the_reference_load_it_is_the_plain_brush(name):
    tire = with_values(MODELS[name], TRUTH)
    plain = with_values(
        MODELS[name.replace("-load", "")],
        {key: value for key, value in TRUTH.items() if key != "fz0"},
    )
    inputs = TireInputs(SLIPS, 0.03, TRUTH["fz0"], 20.0)
    for mine, same in zip(forces(tire, inputs)[:3], forces(plain, inputs)[:3], strict=True):
        np.testing.assert_allclose(mine, same, rtol=1e-13)
    assert tire.needs == plain.needs


@pytest.mark.parametrize("power", [0.0, 1.0, 2.0])
@pytest.mark.parametrize("fz", [1500.0, 9000.0])
def test_parameters_depend_on_the_load(power, fz):
    """S §2.1: a proportional to F_z for a rectangular patch (k = 2), to its root for an
    elliptic one (k = 1), and c_p a^2 accordingly."""
    values = TRUTH | {"stiffness_power": power, "mu_load": -0.15}
    tire = with_values(MODELS["brush-load"], values)
    length = TRUTH["half_length"] * (fz / 4000) ** (power / 2)
    c_p = TRUTH["cpa2"] / TRUTH["half_length"] ** 2
    mu = 0.9 - 0.15 * (fz - 4000) / 4000
    at_load = {"cpa2": c_p * length**2, "mu": mu, "half_length": length}
    plain = with_values(MODELS["brush"], at_load)
    inputs = TireInputs(SLIPS, 0.02, fz)
    for mine, same in zip(forces(tire, inputs)[:3], forces(plain, inputs)[:3], strict=True):
        np.testing.assert_allclose(mine, same, rtol=1e-12)
    np.testing.assert_allclose(tire.static_friction(fz), mu, rtol=1e-13)


def test_friction_stays_positive_and_zero_load_gives_no_force():
    tire = with_values(MODELS["brush-load"], TRUTH | {"mu_load": -0.5})
    np.testing.assert_allclose(tire.static_friction(4e4), 0.009, rtol=1e-12)
    result = forces(tire, TireInputs(0.5, 0.1, np.array([0.0, -100.0, 4e4])))
    np.testing.assert_array_equal(np.stack(result[:3])[:, :2], 0.0)
    np.testing.assert_allclose(np.hypot(result.fx, result.fy)[2], 360.0, rtol=1e-12)
