"""The contract of every registered model, checked by name."""

import contextlib
import functools
import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from visits import FRICTIONS, PRESSURES, REPEATS, spelled, visiting

from fits.flexible_carcass.patch import slopes_at_rest as carcass_at_rest
from tirefit.models import MODELS, TireForces, TireInputs, forces, modelled
from tirefit.models.carcass import AbstractCarcass
from tirefit.params import parameter_values, specs, with_values
from tirefit.slip import LOCKED

DECLARED = visiting(later=())
EVERY = visiting()
TURNING = visiting(k for k in MODELS if "mz" in modelled(MODELS[k]))
"""Models with an aligning moment."""

# One of every formula.
FORMULAS = ["brush", "brush-dmns", "uniform-mh", "quartic-hs", "brush-m-peak"]
FORMULAS += ["brush-stribeck-s", "brush-ln", "magic-formula"]
TRANSIENT = [name for name in MODELS if MODELS[name].transient]
EVERY_FORMULA = pytest.mark.parametrize("name", FORMULAS)
EVERY_CALL = pytest.mark.parametrize("name", ["brush", "magic-formula", *TRANSIENT])
"""Of what `forces` does with any model, and with one that depends on earlier slips."""

# Pairs of (sigma_x, alpha): rest, hardly moving, partly sliding, full sliding, locked.
SLIPS = [
    (0.0, 0.0),
    (1e-12, 1e-12),
    (-1e-12, -1e-12),
    (0.02, 0.02),
    (-0.02, -0.02),
    (0.3, 0.3),
    (-0.3, -0.3),
    (5.0, 1.4),
    (-0.9, -1.4),
    (LOCKED, -0.7),
]
MIRRORED = [(sigma, -alpha) for sigma, alpha in SLIPS]
STRAIGHT = [(sign * size, 0.0) for sign in (1, -1) for size in (1e-12, 0.02, 0.3, 0.9)]
"""Braked, then driven."""
LOADS = [0.0, 1e-6, 4000.0]
SPEEDS = [0.0, 20.0]
ASYMMETRIES = [-1 / 3, 0.0, 1e-9, 0.5, 1.0]
KINETIC = [0.0, 1.0]
GRID = np.array(
    [
        (*slip, fz, v, d, m)
        for slip, fz, v, d, m in itertools.product(
            [*SLIPS, *MIRRORED, *STRAIGHT, (0.0, 0.0)], LOADS, SPEEDS, ASYMMETRIES, KINETIC
        )
    ]
)
AHEAD, ASIDE, BRAKED, DRIVEN, STILL = np.split(
    np.arange(len(GRID)),
    np.cumsum([len(SLIPS), len(MIRRORED), len(STRAIGHT) // 2, len(STRAIGHT) // 2]) * 60,
)
"""Rows of the grid, in the same order of what else varies."""
RESTS = [AHEAD[:60], ASIDE[:60], STILL]
"""Rows at rest, where each output is differentiated alone."""
INPUTS = TireInputs(*GRID.T[:4], *np.zeros((3, len(GRID))))


def on_grid(name):
    """The model with one set of parameter values per point of the grid."""
    model = MODELS[name]
    values = {key: np.full(len(GRID), val) for key, val in _values(model).items()}
    values.update({key: GRID.T[4 + i] for i, key in enumerate("dm") if key in values})
    return with_values(model, {key: jnp.asarray(val) for key, val in values.items()})


def _values(model):
    return {key: float(value) for key, value in parameter_values(model).items()}


def briefly(model):
    """Compiles nothing, unless a model bisects in a loop, which takes ten times as long
    uncompiled as compiled."""
    looping = isinstance(model, AbstractCarcass)
    return contextlib.nullcontext() if looping else jax.disable_jit()


@jax.jit
@jax.vmap
def of_each(tire, sample):
    return tire(sample)


def evaluate(model, inputs):
    """Forces, one set of values per sample."""
    arrays = jax.tree.map(jnp.asarray, (model, inputs))
    with briefly(model):
        return of_each(*arrays)


def peak(name):
    """Largest force over load at the default values."""
    values = _values(MODELS[name])
    known = ("mu", "mu_peak", "D", "mu_s")
    return next((values[key] for key in known if key in values), None) or max(
        values["Dx"], values["Dy"]
    )


def slopes_at_rest(name, fz=4000.0, v=0.0):
    """d(fx)/d(sigma_x) and d(fy)/d(alpha) at rest, in closed form; None if
    discontinuous.

    A force that is not modelled has no slope: None, too.
    """
    at = _values(MODELS[name])
    if name == "lugre-lumped":
        return None
    if name.startswith("carcass-"):
        return None, 2 * at["cpa2"] * on_carcass(name)[0]
    if name == "lugre":
        slope = fz * (at["sigma0"] * at["length"] / 2 + (at["sigma1"] + at["sigma2"]) * v)
        return slope, slope
    if "Bx" in at:
        return tuple(at["B" + i] * at["C" + i] * at["D" + i] * fz for i in "xy")
    if "B" in at:
        return (at["B"] * at["C"] * at["D"] * fz,) * 2
    ratio = at.get("stiffness_ratio", 1.0)
    return 2 * at["cpa2"], 2 * at["cpa2"] * ratio


@functools.cache
def on_carcass(name):
    """Slopes of force and moment at rest relative to those of bristles alone, 2 c_p a^2
    and 2 c_p a^3."""
    kind = name.removeprefix("carcass-")
    return carcass_at_rest(kind, _values(MODELS[name])["flexibility"])


def stacked(result: TireForces):
    """Modelled outputs as columns; a Magic Formula has no moment."""
    return jnp.stack([part for part in result if part is not None], axis=-1)


def weights(count):
    """Of the outputs in what is differentiated, (n, outputs): all of them, the moment as
    much as a force; at rest one by one."""
    each = np.ones((len(GRID), count))
    each[:, 2:] = 10.0
    for rows, alone in zip(RESTS, np.eye(count), strict=False):
        each[rows] = alone
    return each


def differentiated(model, inputs):
    """Forces, and d(weighted outputs)/d(parameters, inputs), leaves (n,), by reverse mode."""

    def outputs(pair):
        result = evaluate(*pair)
        return stacked(result), result

    arrays = jax.tree.map(jnp.asarray, (model, inputs))
    columns, pull_back, result = jax.vjp(outputs, arrays, has_aux=True)
    return result, pull_back(jnp.asarray(weights(columns.shape[1]), columns.dtype))[0]


@functools.cache
def on_grid_with_slopes(name):
    return jax.tree.map(np.asarray, differentiated(on_grid(name), INPUTS))


def grid_forces(name):
    return on_grid_with_slopes(name)[0]


def grid_gradients(name):
    return on_grid_with_slopes(name)[1]


@EVERY
def test_value_and_gradient_are_finite(name):
    for part in jax.tree.leaves(grid_forces(name)):
        assert np.isfinite(part).all()
    gradient = grid_gradients(name)
    assert len(jax.tree.leaves(gradient)) == len(specs(MODELS[name])) + len(INPUTS)
    for leaf in jax.tree.leaves(gradient):
        bad = ~np.isfinite(leaf)
        assert not bad.any(), GRID[bad][:3]


@EVERY_FORMULA
def test_forward_and_reverse_gradient_agree(name):
    arrays = jax.tree.map(jnp.asarray, (on_grid(name), INPUTS))
    tangent = jax.tree.map(lambda leaf: 0.1 + jnp.abs(leaf), arrays)

    def along(pair, direction):
        _, out = jax.jvp(lambda pair: stacked(pair[0](pair[1])), (pair,), (direction,))
        return out

    with briefly(MODELS[name]):
        forward = np.asarray(jax.vmap(along)(arrays, tangent))
    forward = np.sum(forward * weights(forward.shape[1]), axis=1)
    parts = jax.tree.map(lambda leaf, step: leaf * np.asarray(step), grid_gradients(name), tangent)
    reverse = sum(jax.tree.leaves(parts))
    scale = sum(np.abs(leaf) for leaf in jax.tree.leaves(parts))
    assert np.max(np.abs(forward - reverse) / (scale + 1e-9)) < 1e-12


@EVERY
def test_forces_are_odd_in_slip(name):
    found = grid_forces(name)
    ahead, mirrored, braked, driven = (
        jax.tree.map(lambda part, rows=rows: part[rows], found)
        for rows in (AHEAD, ASIDE, BRAKED, DRIVEN)
    )
    np.testing.assert_array_equal(ahead.fy, -mirrored.fy)
    if ahead.fx is not None:
        np.testing.assert_array_equal(ahead.fx, mirrored.fx)
    if ahead.mz is not None:
        np.testing.assert_array_equal(ahead.mz, -mirrored.mz)
    # The Magic Formula is odd in kappa; falling friction sees kappa through v_s.
    even = name.startswith("magic-formula")
    if not even and "v" not in MODELS[name].needs and ahead.fx is not None:
        np.testing.assert_array_equal(braked.fx, -driven.fx)


@EVERY
def test_speed_matters_only_if_the_model_declares_it(name):
    model = MODELS[name]
    if model.transient:
        slip, time = np.array([0.02, 0.02, 0.3, 0.3]), np.array([0.0, 0.0, 0.02, 0.02])
        inputs = TireInputs(slip, slip, 4000.0, 0.0, time=time)
        with briefly(model):
            slow, fast = (forces(model, inputs._replace(v=v + 0 * slip)) for v in (5.0, 25.0))
    else:
        at_rest = INPUTS.v == 0
        slow, fast = (
            jax.tree.map(lambda part, rows=rows: part[rows], grid_forces(name))
            for rows in (at_rest, ~at_rest)
        )
    changed = [
        bool((x != y).any()) for x, y in zip(slow[:2], fast[:2], strict=True) if x is not None
    ]
    assert changed
    assert set(changed) == {"v" in model.needs}


@EVERY
def test_no_slip_or_load_gives_no_force(name):
    result = grid_forces(name)
    silent = ((INPUTS.sigma_x == 0) & (INPUTS.alpha == 0)) | (INPUTS.fz == 0)
    assert silent.sum() > 100
    for part in jax.tree.leaves(result):
        np.testing.assert_array_equal(part[silent], 0.0)
        slipping = (INPUTS.sigma_x == 0.02) & (INPUTS.alpha != 0)
        assert (part[slipping & (INPUTS.fz == 4000.0)] != 0).all()


@EVERY
def test_slope_at_zero_slip_is_the_declared_stiffness(name):
    gradient = grid_gradients(name)[1]
    for v in SPEEDS:
        expected = slopes_at_rest(name, v=v)
        if expected is None:
            continue
        for force, slope in zip(("fx", "fy"), expected, strict=True):
            if slope is None:
                assert force not in modelled(MODELS[name])
                continue
            rows = RESTS[modelled(MODELS[name]).index(force)]
            at = rows[(INPUTS.fz[rows] == 4000.0) & (INPUTS.v[rows] == v)]
            assert len(at) == 10
            along = gradient.sigma_x[at], gradient.alpha[at]
            own, other = along if force == "fx" else along[::-1]
            np.testing.assert_allclose(own, slope, rtol=1e-12)
            np.testing.assert_array_equal(other, 0.0)


@TURNING
def test_moment_slope_at_zero_slip_is_right(name):
    values = _values(MODELS[name])
    gradient = grid_gradients(name)[1]
    rows = RESTS[modelled(MODELS[name]).index("mz")]
    loaded = rows[INPUTS.fz[rows] == 4000.0]
    ratio = values.get("stiffness_ratio", 1.0)
    arm = on_carcass(name)[1] if name.startswith("carcass-") else -1 / 3
    expected = 2 * arm * values["half_length"] * values["cpa2"] * ratio
    np.testing.assert_allclose(gradient.alpha[loaded], expected, rtol=1e-12)


@EVERY
def test_force_is_bounded_by_friction(name):
    result = grid_forces(name)
    limit = peak(name) * INPUTS.fz * (1 + 1e-12)
    values = _values(MODELS[name])
    if "mu_load" in values:  # friction falls with the load: more of it below fz0
        limit = limit * (1 + abs(values["mu_load"]))
    if "g" in values:  # mu is that at 1 m/s of sliding
        v_s = INPUTS.v * np.hypot(INPUTS.sigma_x / (1 + INPUTS.sigma_x), np.tan(INPUTS.alpha))
        limit = limit * np.maximum(1 + values["g"] * np.log(v_s + 0.02), 1.0)
    if "sigma2" in values:
        v_s = np.hypot(INPUTS.sigma_x / (1 + INPUTS.sigma_x), np.tan(INPUTS.alpha))
        viscous = values["sigma2"] + values.get("sigma1", 0.0)
        limit = limit + viscous * v_s * INPUTS.v * INPUTS.fz
    if "Bx" in values:  # each axis has a limit of its own
        limit = np.sqrt(2) * limit
    for force in (result.fx, result.fy):
        assert force is None or (np.abs(force) <= limit).all()
    if result.mz is not None:
        arm = _values(MODELS[name])["half_length"]
        assert (np.abs(result.mz) <= arm * limit).all()


@DECLARED
def test_pytree_round_trip_keeps_the_model(name):
    model = MODELS[name]
    leaves, structure = jax.tree.flatten(model)
    assert leaves == list(parameter_values(model).values())
    assert eqx.tree_equal(jax.tree.unflatten(structure, leaves), model)
    doubled = jax.tree.map(lambda leaf: 2 * leaf, model)
    assert _values(doubled) == {key: 2 * val for key, val in _values(model).items()}


@DECLARED
def test_every_parameter_has_a_specification(name):
    model = MODELS[name]
    found = specs(model)
    assert list(found) == list(parameter_values(model))
    assert len(found) == len(jax.tree.leaves(model))
    for key, spec in found.items():
        assert parameter_values(model)[key] == spec.default
        assert spec.lower <= spec.default <= spec.upper
        assert spec.unit in {"-", "N", "m", "m/s", "s/m", "1/m"}
        assert spec.source.startswith(("S(", "S §", "O(", "first-order lag", "Grosch 1963"))
        assert spec.symbol and len(spec.meaning) > 8
        assert spec.scale == "linear" or (spec.scale == "log" and spec.lower > 0)
    assert any(spec.free for spec in found.values())


SAMPLES = [(0.05, -0.1, 3000.0, 20.0), (4.0, 0.02, 5000.0, 9.0)]


@EVERY_CALL
def test_a_batch_agrees_with_single_samples(name):
    with briefly(MODELS[name]):
        batch = forces(MODELS[name], TireInputs(*np.array(SAMPLES).T))
        single = [forces(MODELS[name], TireInputs(*sample)) for sample in SAMPLES]
    for part, parts in zip(batch, zip(*single, strict=True), strict=True):
        if part is None:
            assert parts == (None, None)
            continue
        assert part.shape == (2,)
        assert all(one.shape == () for one in parts)
        np.testing.assert_allclose(part, np.stack(parts), rtol=1e-13, atol=1e-9)


def test_scalars_broadcast_against_arrays():
    slip = np.linspace(-0.1, 0.1, 3)
    mixed = forces(MODELS["brush"], TireInputs(slip, 0.05, 4000.0))
    full = forces(
        MODELS["brush"], TireInputs(slip, np.full(3, 0.05), np.full(3, 4000.0), np.zeros(3))
    )
    assert eqx.tree_equal(mixed, full)
    assert mixed.fy.shape == (3,)


@pytest.mark.parametrize(
    ("inputs", "message"),
    [
        (TireInputs(np.zeros((2, 3)), 0.0, 1.0), "one-dimensional"),
        (TireInputs(np.zeros(2), np.zeros(3), 1.0), "[Ii]ncompatible shapes"),
    ],
)
def test_wrong_shapes_raise(inputs, message):
    with pytest.raises(ValueError, match=message):
        forces(MODELS["brush"], inputs)


def in_float32(name):
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), (on_grid(name), INPUTS))


def assert_close_in_float32(name, found):
    for part, good in zip(jax.tree.leaves(found), jax.tree.leaves(grid_forces(name)), strict=True):
        assert part.dtype == jnp.float32
        error = np.abs(np.asarray(part, float) - good)
        assert (error <= 1e-4 * peak(name) * INPUTS.fz).all()


@EVERY
def test_float32_stays_float32_beside_float64(name):
    for part in jax.tree.leaves(jax.eval_shape(of_each, *in_float32(name))):
        assert part.dtype == jnp.float32


@pytest.mark.parametrize("name", ["brush", "carcass-beam", "carcass-thread"])
def test_float32_is_close_beside_float64(name):
    assert_close_in_float32(name, evaluate(*in_float32(name)))


@visiting(later={*REPEATS, "carcass-beam", "carcass-thread"})
def test_float32_with_its_gradient_is_finite_and_close(name):
    """Also with 32-bit floats only, including zero slip, zero load and full sliding.

    Where two large terms cancel (full sliding), float32 keeps 1e-7 of them: the error
    is measured against the largest derivative of an output over the grid.
    """
    good = grid_gradients(name)
    with jax.enable_x64(False):
        found, rounded = differentiated(*in_float32(name))
    assert_close_in_float32(name, found)
    for leaf, exact in zip(jax.tree.leaves(rounded), jax.tree.leaves(good), strict=True):
        assert leaf.dtype == jnp.float32
        bad = ~np.isfinite(leaf)
        assert not bad.any(), GRID[bad][:3]
        error = np.abs(np.asarray(leaf, float) - exact)
        assert (error <= 4e-3 * np.abs(exact).max(axis=0)).all()


# In float32, where a square of 1e-20 is zero, and later in float64.
@pytest.mark.parametrize("dtype", [jnp.float32, pytest.param(jnp.float64, marks=pytest.mark.long)])
@pytest.mark.parametrize(
    "name",
    ["brush", "brush-dmns", "quartic-hs", "brush-anisotropic"]
    + ["magic-formula-combined", "lugre-lumped", "carcass-parabola"],
)
def test_second_derivatives_at_rest_are_finite(name, dtype):
    """Of the forces over both slips, at zero slip and near it."""

    def second(tire, at):
        def out(slips):
            result = tire(TireInputs(*slips, *jnp.asarray([4000.0, 10.0], at.dtype)))
            return [part for part in result[:3] if part is not None]

        return jax.vmap(jax.jacfwd(jax.jacfwd(out)))(at)

    points = np.array([(0, 0), (1e-7, 0), (0, 1e-7), (1e-20, 1e-20), (0.003, 0.002)])
    cast = functools.partial(jnp.asarray, dtype=dtype)
    found = jax.jit(second)(jax.tree.map(cast, MODELS[name]), cast(points))
    assert all(part.dtype == dtype for part in found)
    assert all(np.isfinite(part).all() for part in found)


def test_the_registry_accepts_all_spellings():
    brushes = {spelled(*laws) for laws in itertools.product(PRESSURES, FRICTIONS)}
    assert brushes < set(MODELS)
