"""The vector z and the values it represents: inverses, runs, priors, volume."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from recipes import FZ, STD, brush_force, curve, table

from tirefit.fitting.problem.build import build
from tirefit.fitting.problem.config import parse_config
from tirefit.fitting.problem.layout import FreeParameter, Layout, Tie, choose_layout
from tirefit.fitting.problem.likelihood import root_deviance
from tirefit.fitting.solve.inference import linearise, minima, residuals
from tirefit.fitting.solve.least_squares import least_squares
from tirefit.fitting.solve.multistart import with_densities
from tirefit.models import MODELS
from tirefit.params import specs
from tirefit.results import UsageError

SPECS = specs(MODELS["brush-dm"])
LAYOUT = Layout(
    (
        FreeParameter("cpa2", SPECS["cpa2"]),
        FreeParameter("mu", SPECS["mu"], per_run=True, prior=(0.9, 0.05)),
        FreeParameter("d", SPECS["d"], prior=(0.1, 0.2)),
    ),
    ("dry", "wet", "ice"),
    (Tie("m", "mu", 0.5),),
)
VALUES = {"cpa2": 4e4, "mu[dry]": 1.1, "mu[wet]": 0.7, "mu[ice]": 0.1, "d": 0.3}


def test_natural_inverts_unconstrained():
    z = LAYOUT.unconstrained(VALUES)
    np.testing.assert_allclose(LAYOUT.vector(z), list(VALUES.values()), rtol=1e-12)
    named = LAYOUT.natural(z)
    np.testing.assert_allclose(named["mu"], [1.1, 0.7, 0.1], rtol=1e-12)
    np.testing.assert_allclose(named["d"], 0.3, rtol=1e-12)
    np.testing.assert_allclose(named["m"], [0.55, 0.35, 0.05], rtol=1e-12)
    assert named["cpa2"].shape == () and named["mu"].shape == (3,)


def test_one_value_by_name_serves_every_run():
    z = LAYOUT.unconstrained({"cpa2": 4e4, "mu": 0.8, "d": 0.0})
    np.testing.assert_allclose(LAYOUT.natural(z)["mu"], 0.8, rtol=1e-12)


def test_prior_residuals_are_deviations_in_prior_standard_deviations():
    pulls = LAYOUT.prior_residual(LAYOUT.unconstrained(VALUES))
    expected = [(v - 0.9) / 0.05 for v in (1.1, 0.7, 0.1)] + [(0.3 - 0.1) / 0.2]
    np.testing.assert_allclose(pulls, expected, rtol=1e-9)


def test_log_volume_is_the_jacobian_up_to_a_constant():
    @jax.jit
    @jax.vmap
    def both(z):
        return LAYOUT.log_volume(z), jnp.linalg.slogdet(jax.jacfwd(LAYOUT.vector)(z))[1]

    shifted = [shift + np.arange(5) / 3 for shift in (-3.0, 0.0, 2.0)]
    found, expected = both(np.stack([np.zeros(5), *shifted]))
    np.testing.assert_allclose(found - found[0], expected - expected[0], atol=1e-9)


def test_names_of_runs_do_not_cause_a_new_compilation():
    count = 0

    def traced(layout, z):
        nonlocal count
        count += 1
        return layout.vector(z)

    function = jax.jit(traced, static_argnums=0)
    for run in ("a.csv", "b.csv"):
        layout = Layout((FreeParameter("mu", SPECS["mu"]),), (run,))
        function(layout, jnp.zeros(1))
    assert count == 1
    wider = Layout((FreeParameter("mu", SPECS["mu"], per_run=True),), ("a", "b"))
    assert function(wider, jnp.zeros(2)).shape == (2,)
    longer = Layout(wider.free, ("a", "b", "c"))
    assert function(longer, jnp.zeros(3)).shape == (3,)


def chosen(model, parameters, forces=("fx",)):
    config = parse_config({"parameters": parameters})
    return choose_layout(MODELS[model], config, ("dry", "wet"), forces)


# model, parameters -> bounds of the free parameter, of the tied one, name of each
TIES = {
    "upper end": ("brush-m", {"m": {"tied": "mu", "factor": 0.8}}, ("mu", 0.01, 1.25)),
    "own bounds of the free one": (
        "brush-m",
        {"m": {"tied": "mu", "factor": 0.8}, "mu": {"lower": 0.5, "upper": 2}},
        ("mu", 0.5, 1.25),
    ),
    "negative factor": ("brush-d", {"d": {"tied": "mu", "factor": -0.2}}, ("mu", 0.01, 5 / 3)),
    "lower end, on many decades": (
        "brush",
        {"mu": {"tied": "cpa2", "factor": 1e-5}},
        ("cpa2", 1e3, 5e5),
    ),
    "two ties": (
        "brush-dm",
        {"m": {"tied": "mu", "factor": 0.8}, "d": {"tied": "mu", "factor": -0.3}},
        ("mu", 0.01, 1 / 0.9),
    ),
    "per run": ("brush-m", {"m": {"tied": "mu"}, "mu": {"per_run": True}}, ("mu", 0.01, 1.0)),
}


@pytest.mark.parametrize(("model", "parameters", "bounds"), TIES.values(), ids=TIES)
def test_a_tied_parameter_stays_within_its_bounds(model, parameters, bounds):
    name, lower, upper = bounds
    _, layout, notes = chosen(model, parameters)
    (free,) = (p for p in layout.free if p.name == name)
    np.testing.assert_allclose(free.spec.bounds, (lower, upper), rtol=1e-12)
    assert any(note.startswith(f"{name} held to [") for note in notes)
    for z in (-60.0, -1.0, 0.0, 1.0, 60.0):
        values = layout.natural(np.full(layout.size, z))
        for tie in layout.ties:
            own = specs(MODELS[model])[tie.name]
            assert np.all(values[tie.name] >= own.lower * (1 - 1e-12) - 1e-12)
            assert np.all(values[tie.name] <= own.upper * (1 + 1e-12) + 1e-12)


def test_a_tie_that_stays_within_the_bounds_narrows_nothing():
    _, layout, notes = chosen("brush-stribeck", {"mu_c": {"tied": "mu"}})
    assert {p.name: p.spec for p in layout.free}["mu"] == SPECS["mu"]
    assert layout.ties == (Tie("mu_c", "mu"),) and notes == []


def test_tie_outside_the_bounds_is_refused():
    parameters = {"m": {"tied": "mu", "factor": 3}, "mu": {"lower": 0.5}}
    with pytest.raises(UsageError) as caught:
        chosen("brush-m", parameters)
    (problem,) = caught.value.problems
    assert problem.reason == (
        "parameters.m: tied = 'mu' with factor = 3 is outside its bounds [0, 1] for"
        " every mu in [0.5, 5]"
    )
    assert "bounds of mu" in problem.remedy


def test_value_and_prior_are_checked_within_the_narrowed_bounds():
    prior = {"mean": 1.5, "std": 0.1}
    parameters = {"m": {"tied": "mu"}, "mu": {"value": 1.2, "prior": prior}}
    with pytest.raises(UsageError) as caught:
        chosen("brush-m", parameters)
    value, mean = caught.value.problems
    assert value.reason == "parameters.mu: value 1.2 outside its bounds [0.01, 1]"
    assert mean.reason == "parameters.mu: prior mean 1.5 outside its bounds [0.01, 1]"


def test_free_fixed_and_per_run_follow_the_configuration():
    parameters = {
        "cpa2": {"value": 3e4, "free": False},
        "mu": {"per_run": True, "prior": {"mean": 1, "std": 0.1}},
        "d": {"upper": 0.5},
    }
    model, layout, _ = chosen("brush-d", parameters)
    assert layout.labels == ("mu[dry]", "mu[wet]", "d")
    assert layout.free[0].prior == (1.0, 0.1)
    assert layout.free[1].spec == SPECS["d"]._replace(upper=0.5)
    assert model.cpa2 == 3e4
    _, layout, _ = chosen("brush", {}, ("fy", "mz"))
    assert layout.labels == ("cpa2", "mu", "half_length")


RUNS = ("dry", "wet", "ice")
PER_RUN = {
    "mu": {"per_run": True, "prior": {"mean": 0.8, "std": 0.3}},
    "cpa2": {"prior": {"mean": 5e4, "std": 5e3}},
}


@pytest.mark.parametrize("slip_noise", [{}, {"sigma_x": 0.002}])
def test_sparse_slopes_agree_with_dense_slopes(slip_noise):
    """Slopes of a row in the elements of its run, compared with one tangent per
    element: interleaved runs, a shared parameter, and priors."""
    slip = curve()["sigma_x"]
    run = np.arange(len(slip)) % 3
    force = brush_force(slip, 5e4, np.array([1.0, 0.7, 0.4])[run])
    noise = STD * np.random.default_rng(8).standard_normal(len(slip))
    columns = {"sigma_x": slip, "fx": force + noise, "fz": np.full(len(slip), FZ)}
    config = parse_config({"noise": {"fx": STD} | slip_noise, "parameters": PER_RUN})
    task = build(table(columns, run=run, runs=RUNS), "brush", config)
    truth = {"cpa2": 5e4, "mu[dry]": 1.0, "mu[wet]": 0.7, "mu[ice]": 0.4}
    z = jnp.asarray(task.problem.layout.unconstrained(truth))
    problem = with_densities(task.problem, {}, z + 0.01)[0]
    assert problem.layout.is_sparse and problem.layout.size == 4

    def whole(z):
        return {**root_deviance(problem, z), "prior": problem.layout.prior_residual(z)}

    slopes = jax.jit(jax.jacfwd(whole))(z)
    found = linearise(problem, z).slopes
    assert set(found) == set(slopes)
    for name, dense in slopes.items():
        np.testing.assert_allclose(found[name], dense, atol=1e-9)
    if slip_noise:
        return
    start = z + 0.3
    dense = least_squares(lambda z: residuals(problem, z), start)
    ends = minima(problem, np.array([start]))
    np.testing.assert_allclose(ends.z[0], dense.z, atol=1e-6)
    np.testing.assert_allclose(ends.cost[0], dense.cost, rtol=1e-9)
