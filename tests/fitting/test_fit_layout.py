"""The vector z and the values it names: inverses, runs, ties, priors, volume."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tirefit.fitting.layout import FreeParameter, Layout, Tie
from tirefit.models import MODELS
from tirefit.params import specs

SPECS = specs(MODELS["brush-dm"])
LAYOUT = Layout(
    (
        FreeParameter("cpa2", SPECS["cpa2"]),
        FreeParameter("mu", SPECS["mu"], per_run=True, prior=(0.9, 0.05)),
        FreeParameter("d", SPECS["d"], prior=(0.1, 0.2)),
    ),
    (Tie("m", "mu", 0.5),),
    ("dry", "wet", "ice"),
)
VALUES = {"cpa2": 4e4, "mu[dry]": 1.1, "mu[wet]": 0.7, "mu[ice]": 0.1, "d": 0.3}


def test_labels_are_in_the_order_of_z():
    assert LAYOUT.labels == ("cpa2", "mu[dry]", "mu[wet]", "mu[ice]", "d")
    assert LAYOUT.size == 5


def test_natural_inverts_unconstrained():
    z = LAYOUT.unconstrained(VALUES)
    np.testing.assert_allclose(LAYOUT.vector(z), list(VALUES.values()), rtol=1e-12)
    named = LAYOUT.natural(z)
    np.testing.assert_allclose(named["mu"], [1.1, 0.7, 0.1], rtol=1e-12)
    np.testing.assert_allclose(named["d"], 0.3, rtol=1e-12)
    assert named["cpa2"].shape == () and named["mu"].shape == (3,)


def test_unconstrained_inverts_vector():
    z = jnp.linspace(-4, 4, 5)
    values = dict(zip(LAYOUT.labels, LAYOUT.vector(z), strict=True))
    np.testing.assert_allclose(LAYOUT.unconstrained(values), z, atol=1e-10)


def test_one_value_by_name_serves_every_run():
    z = LAYOUT.unconstrained({"cpa2": 4e4, "mu": 0.8, "d": 0.0})
    np.testing.assert_allclose(LAYOUT.natural(z)["mu"], 0.8, rtol=1e-12)


def test_tie_follows_its_parameter_in_every_run():
    named = LAYOUT.natural(LAYOUT.unconstrained(VALUES))
    np.testing.assert_allclose(named["m"], [0.55, 0.35, 0.05], rtol=1e-12)


def test_prior_residuals_are_pulls_in_natural_units():
    pulls = LAYOUT.prior_residual(LAYOUT.unconstrained(VALUES))
    expected = [(v - 0.9) / 0.05 for v in (1.1, 0.7, 0.1)] + [(0.3 - 0.1) / 0.2]
    np.testing.assert_allclose(pulls, expected, rtol=1e-9)


def test_without_priors_there_are_no_pseudo_measurements():
    plain = Layout((FreeParameter("mu", SPECS["mu"]),))
    assert plain.prior_residual(jnp.zeros(1)).shape == (0,)


@pytest.mark.parametrize("shift", [-3.0, 0.0, 2.0])
def test_log_volume_is_the_jacobian_up_to_a_constant(shift):
    def by_autodiff(z):
        return jnp.linalg.slogdet(jax.jacfwd(LAYOUT.vector)(z))[1]

    z, origin = shift + jnp.arange(5) / 3, jnp.zeros(5)
    found = LAYOUT.log_volume(z) - LAYOUT.log_volume(origin)
    np.testing.assert_allclose(found, by_autodiff(z) - by_autodiff(origin), atol=1e-9)


def test_names_of_runs_do_not_cause_a_new_compilation():
    count = 0

    def traced(layout, z):
        nonlocal count
        count += 1
        return layout.vector(z)

    function = jax.jit(traced, static_argnums=0)
    for run in ("a.csv", "b.csv"):
        layout = Layout((FreeParameter("mu", SPECS["mu"]),), (), (run,))
        function(layout, jnp.zeros(1))
    assert count == 1
    wider = Layout((FreeParameter("mu", SPECS["mu"], per_run=True),), (), ("a", "b"))
    assert function(wider, jnp.zeros(2)).shape == (2,)
    longer = Layout(wider.free, (), ("a", "b", "c"))
    assert function(longer, jnp.zeros(3)).shape == (3,)
