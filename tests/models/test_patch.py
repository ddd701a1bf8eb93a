"""Every brush model compared with the numeric patch of ``numeric_patch``."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numeric_patch import holding_ratio, reference_tire
from visits import visiting

from tirefit.models import (
    MODELS,
    Asymmetric,
    Brush,
    BrushAtPeak,
    Parabolic,
    Quartic,
    TireInputs,
    Uniform,
)
from tirefit.params import parameter_values, with_values

NAMES = sorted(name for name, model in MODELS.items() if type(model) in (Brush, BrushAtPeak))
BRUSHES = visiting(NAMES)

ASYMMETRIES = [-1 / 3, -0.3, -1e-8, -1e-12, 0.0, 1e-12, 1e-8, 0.4, 0.9, 1.0]
KINETIC = [0.0, 0.35, 0.8, 1.0]
# Demand ratio over that of full sliding (over 1 for the uniform law, where sliding
# begins at 1/4): sticking, hardly sliding, partly, almost and entirely sliding.
INPUTS = ("sigma_x", "alpha", "fz", "v")
DEMAND = [1e-7, 1e-3, 0.05, 0.2, 0.249, 0.251, 0.5, 0.8, 0.97, 0.999, 1.001, 1.3, 30.0]


def full_sliding(name, d):
    """Demand ratio above which every bristle slides."""
    family = name.partition("-")[0]
    if family == "uniform":
        return np.ones_like(d)
    return holding_ratio(family, d, 1.0)


def draw(name, seed, d, m, demand):
    """Parameter values and inputs, (n,) each: given shape and demand, others random."""
    rng = np.random.default_rng(seed)
    n = len(d)

    def between(low, high):
        return rng.uniform(low, high, n)

    ranges = {
        "cpa2": (1e5, 3e5),
        "mu": (0.7, 1.3),
        "mu_peak": (0.7, 1.3),
        "half_length": (0.05, 0.15),
        "n": (-0.003, 0.006),
        "h": (0.2, 1.0),
        "v_st": (3.0, 40.0),
        "exponent": (0.3, 2.5),
        "mu_c": (0.3, 0.7),
        "g": (-0.1, 0.2),
    }
    values = {}
    for key in parameter_values(MODELS[name]):
        values[key] = {"d": d, "m": m}[key] if key in "dm" else between(*ranges[key])
    fz, v = between(1e3, 8e3), between(0.0, 25.0)
    mu = values.get("mu", 1.0)
    slip = demand * full_sliding(name, d * ("d" in values)) * mu * fz / values["cpa2"]
    sign_x = np.where(rng.random(n) < 0.5, -1.0, 1.0)
    sigma_x = slip * np.where(slip < 0.8, sign_x, 1.0)
    alpha = np.arctan(slip) * np.where(rng.random(n) < 0.5, -1.0, 1.0)
    return values, np.stack([sigma_x, alpha, fz, v])


ROWS = 2000
"""Of every batch: all share the programs of single operations."""


def evaluate(name, values, inputs):
    """Forces of pure slip, fx of sigma_x and fy, mz of alpha, one sample per value."""
    n = len(inputs[0])
    if n < ROWS:
        values, inputs = jax.tree.map(lambda part: np.resize(part, ROWS), (values, list(inputs)))
    model = with_values(MODELS[name], {key: jnp.asarray(val) for key, val in values.items()})
    still = jnp.zeros(ROWS)
    samples = TireInputs(*map(jnp.asarray, inputs), still, still, still)
    with jax.disable_jit():  # operation by operation: 43 compilations less
        along, across = (
            jax.vmap(lambda tire, sample: tire(sample))(model, pure)
            for pure in (samples._replace(alpha=still), samples._replace(sigma_x=still))
        )
    found = across._replace(fx=along.fx)
    return found if n == ROWS else jax.tree.map(lambda part: np.asarray(part)[:n], found)


def worst_errors(name, values, inputs):
    """Largest relative error of fx, fy, mz, and the breakaway points of the patches."""
    result = evaluate(name, values, inputs)
    rows = []  # the 1e-9 N is for m = 0 and full sliding, where nothing is left
    for i, sample in enumerate(inputs.T):
        at = {key: float(value[i]) for key, value in values.items()}
        along, across = reference_tire(name, at, *sample)
        side, ahead = np.sign(sample[1]), np.sign(sample[0])
        rows.append(
            [
                (result.fx[i] - ahead * along.force) / (along.force_scale + 1e-9),
                (result.fy[i] - side * across.force) / (across.force_scale + 1e-9),
                (result.mz[i] - side * across.moment) / (across.moment_scale + 1e-9),
                along.breakaway,
            ]
        )
    rows = np.array(rows)
    return np.abs(rows[:, :3]).max(axis=0), rows[:, 3]


@BRUSHES
def test_force_and_moment_of_the_patch_agree_with_integrals(name):
    asymmetries = ASYMMETRIES[::3] if "brush-d" in name else [0.0]
    demand, d, m = (axis.ravel() for axis in np.meshgrid(DEMAND, asymmetries, KINETIC))
    values, inputs = draw(name, NAMES.index(name), d, m, demand)
    worst, breakaway = worst_errors(name, values, inputs)
    assert (worst < 1e-9).all(), worst
    partly = np.abs(breakaway) < 1 - 1e-9
    assert partly.mean() > 0.4  # the grid reaches every regime
    if name.startswith("uniform"):
        assert (breakaway == -1).mean() > 0.2
    else:
        assert (breakaway == 1).mean() > 0.15


@pytest.mark.parametrize("name", ["brush-d", "brush-dm", "brush-dmns"])
def test_all_asymmetries_agree_with_integrals(name):
    demand, d, m = (axis.ravel() for axis in np.meshgrid(DEMAND, ASYMMETRIES, KINETIC[1::2]))
    values, inputs = draw(name, 7, d, m, demand)
    worst, _ = worst_errors(name, values, inputs)
    assert (worst < 1e-9).all(), worst


LAWS = {
    "brush": Parabolic(),
    "uniform": Uniform(),
    "quartic": Quartic(),
    **{f"d = {d:.3g}": Asymmetric(d) for d in (-1 / 3, -1e-9, 0.0, 0.4, 0.95)},
}


DEMANDS = np.array([1e-14, 1e-9, 1e-6, 1e-3, 0.1, 0.24, 0.26, 0.5, 0.9])
PLACES = np.linspace(0.0, 2.0, 33)


@jax.jit
def of_law(law):
    """Breakaway points and the density there; density, load and moment of the places,
    the last two with their slopes."""
    points = law.breakaway(jnp.asarray(DEMANDS))
    places = jnp.asarray(PLACES)
    sums = (jax.vmap(jax.value_and_grad(part))(places) for part in (law.cdf, law.moment))
    return points, law.density(points), law.density(places), *sums


@cache
def numbers_of(name):
    return jax.tree.map(np.asarray, of_law(jax.tree.map(jnp.asarray, LAWS[name])))


@pytest.mark.parametrize("law", LAWS)
def test_breakaway_is_accurate_at_small_demand(law):
    """Demand equals limit at the breakaway point, relative to either."""
    u, density, *_ = numbers_of(law)
    partly = (u > 0) & (u < 2)
    assert partly.sum() == (3 if law == "uniform" else 9)
    expected = DEMANDS[partly] * (2 - u[partly])
    np.testing.assert_allclose(density[partly], expected, rtol=1e-13)


@pytest.mark.parametrize("law", LAWS)
def test_pressure_integrals_agree_with_the_density(law):
    *_, density, (load, of_load), (moment, of_moment) = numbers_of(law)
    np.testing.assert_allclose(of_load, density, atol=1e-14)
    np.testing.assert_allclose(of_moment, (PLACES - 1) * density, atol=1e-14)
    assert load[0] == moment[0] == 0.0
    np.testing.assert_allclose(load[-1], 1.0, rtol=1e-15)
    assert float(density.min()) >= 0.0


def smooth_samples(name, seed, n=400):
    """Random samples away from the kinks: breakaway, full sliding, zero slip."""
    rng = np.random.default_rng(seed)
    demand = rng.choice([rng.uniform(0.1, 0.23, n), rng.uniform(0.27, 0.8, n)])
    demand = np.where(rng.random(n) < 0.2, rng.uniform(1.6, 3.0, n), demand)
    values, inputs = draw(name, seed, rng.uniform(-0.3, 0.95, n), rng.random(n), demand)
    inputs[3] += 2.0
    return values, inputs


@BRUSHES
def test_gradient_agrees_with_the_central_difference(name):
    """One parameter or input per sample, in turn, with a five-point stencil."""
    values, inputs = smooth_samples(name, 11)
    columns = {**values, **dict(zip(INPUTS, inputs, strict=True))}
    n = len(inputs[0])  # of five copies: four moved ones and the point itself
    which = np.arange(n) % len(columns)
    direction = {key: 1.0 * (which == i) for i, key in enumerate(columns)}
    step = {key: 1e-3 * np.maximum(np.abs(x), 1e-3) for key, x in columns.items()}

    def outputs(columns):
        inputs = [columns[key] for key in INPUTS]
        result = evaluate(name, {key: columns[key] for key in values}, inputs)
        return jnp.stack(result[:3], axis=-1)

    shifts = (-2, -1, 1, 2, 0)
    moved = {
        key: np.concatenate([x + k * step[key] * direction[key] for k in shifts])
        for key, x in columns.items()
    }
    turned = {key: np.concatenate([0 * x] * 4 + [x]) for key, x in direction.items()}
    found = jax.jvp(outputs, *((jax.tree.map(jnp.asarray, part),) for part in (moved, turned)))
    (far_back, back, ahead, far, _), tangent = (np.asarray(x).reshape(5, n, 3) for x in found)
    tangent = tangent[-1]
    size = sum(step[key] * direction[key] for key in columns)[:, None]
    difference = (8 * (ahead - back) - (far - far_back)) / (12 * size)
    # Elasticity: the change for a change of the parameter by its own size.
    load = inputs[2] * np.array([[1.0], [1.0], [0.1]])
    error = np.abs(tangent - difference) * (1e3 * size) / load.T
    worst = {key: error[which == i].max() for i, key in enumerate(columns)}
    assert max(worst.values()) < 1e-7, worst
    moves = np.abs(difference) * (1e3 * size) / load.T
    idle = [key for i, key in enumerate(columns) if moves[which == i].max() < 1e-5]
    assert idle == ([] if needs_v(name) else ["v"])


def needs_v(name):
    return "n" in name[5:] or "h" in name[5:] or "stribeck" in name
