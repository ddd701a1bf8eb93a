"""The Magic Formula of .tir files: other implementations and limiting cases."""

import csv
from functools import cache
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fits.bench.magic_formula_peer import Coefficients, magic_formula
from tirefit.data.tir.tir import read_tir
from tirefit.data.tir.tir_keys import COEFFICIENTS, NEUTRAL
from tirefit.models import TireForces, TireInputs, forces
from tirefit.models.mf import MAGIC_FORMULAS, Mirrored, curvatures, mf_tire
from tirefit.params import parameter_values, specs, with_values
from tirefit.slip import LOCKED

FOLDER = Path(__file__).parents[1] / "data" / "tir"
MF52, MF61 = (f"mfeval_julia/MagicFormula{number}_Parameters.tir" for number in (52, 61))


@cache
def tire_of(name, starred=False):
    tir = read_tir(FOLDER / name)
    return mf_tire(tir.version, tir.numbers, starred=starred)


def values_of(name):
    return parameter_values(tire_of(name))


def iso(tire, kappa=0.0, alpha=0.0, fz=None, gamma=0.0, v=16.6, pressure=0.0):
    """Forces and moments in ISO-W axes, where driving slip is positive."""
    fz = tire.nominal.FNOMIN if fz is None else fz
    kappa = np.asarray(kappa, float)
    given = (-kappa / (1 + kappa), alpha, fz, v, gamma, pressure)
    shape = np.broadcast_shapes(*(np.shape(part) for part in given))
    rows = np.zeros((6, 256))  # one size of batch: each is compiled
    for row, part in zip(rows, given, strict=True):
        row[: max(shape, default=1)] = part
    found = forces(tire, TireInputs(*rows))
    return TireForces(
        *(
            None if part is None else -np.asarray(part)[: max(shape, default=1)].reshape(shape)
            for part in found
        )
    )


def reference():
    with open(FOLDER / "reference.csv") as file:
        rows = list(csv.DictReader(file))
    cases = {}
    for row in rows:
        cases.setdefault((row["tir"], row["angles"]), []).append(row)
    return cases


REFERENCE = reference()


@pytest.mark.parametrize("case", REFERENCE, ids=" ".join)
def test_forces_agree_with_other_implementations(case):
    rows = REFERENCE[case]
    column = {
        key: np.array([float(row[key] or "nan") for row in rows])
        for key in ("kappa", "alpha", "gamma", "fz", "v", "p", "fx", "fy", "mz")
    }
    found = iso(
        tire_of(case[0], case[1] == "star"),
        column["kappa"],
        column["alpha"],
        column["fz"],
        column["gamma"],
        column["v"],
        np.nan_to_num(column["p"]),
    )
    compared = 0
    for name, share in (("fx", 2e-8), ("fy", 2e-8), ("mz", 2e-9)):
        given = np.isfinite(column[name])
        compared += given.sum()
        tolerance = 2e-6 * abs(column[name]) + share * column["fz"]
        error = abs(getattr(found, name) - column[name])
        assert (error[given] <= tolerance[given]).all(), (name, np.nanmax(error))
    assert compared >= 2 * len(rows)


def test_the_reference_covers_every_version_and_angle():
    assert sum(map(len, REFERENCE.values())) == 475
    assert {case[1] for case in REFERENCE} == {"raw", "star"}
    versions = {read_tir(FOLDER / case[0]).version for case in REFERENCE}
    assert versions == {"5.2", "6.1", "6.2"}


SHAPES = ("PCX1", "PCY1", "RCX1", "RCY1", "QCZ1", "RVY5", "PKY2", "PKY4")
SLOPES = {"PK": 4.0, "RB": 6.0, "QB": 5.0, "QD": 0.05, "RVY": 3.0, "QH": 0.05, "SS": 0.05}
"""Coefficients near one, and usual sizes of others by the beginning of their names; of the
rest it is 0.3."""


def busy_tire(version, seed=0):
    """A tire whose coefficients and scaling factors all act: its values by name."""
    generator, values = np.random.default_rng(seed), {}
    for key, spec in specs(MAGIC_FORMULAS[f"mf{version.replace('.', '')}"]).items():
        if spec.unit != "-":
            values[key] = spec.default
        elif key.startswith("L"):
            values[key] = generator.uniform(0.7, 1.3) if key != "LMUV" else 0.2
        else:
            size = 0.1 if key in SHAPES else 0.3
            size = next((s for k, s in SLOPES.items() if key.startswith(k)), size)
            sign = generator.choice([-1, 1])
            values[key] = spec.default + sign * size * generator.uniform(0.5, 1)
    return values | dict.fromkeys(("RCX1", "RCY1"), 1.1) | {"PKY2": 1.7, "PKY4": 1.8}


IN_61, IN_52 = {"PKY6", "PKY7", "PPY5"}, {"PHY3"}
"""Coefficients of the camber thrust of one version alone."""


@pytest.mark.parametrize("version", ["5.2", "6.1"])
def test_every_coefficient_and_factor_acts_as_in_the_book(version):
    """The reference files leave all factors at one and many coefficients at zero; here each
    of them, changed by 5 %, changes a force over the load, or the moment over it [m], by 1e-7."""
    values, generator = Coefficients(busy_tire(version)), np.random.default_rng(1)
    ends = ((-0.4, 0.4), (-0.3, 0.3), (-0.2, 0.2), (2e3, 7e3), (1.9e5, 2.7e5), (5.0, 30.0))
    at = [generator.uniform(*each, 200) for each in ends]

    def book(values):
        return np.stack(magic_formula(values, *at, version=version)) / at[3]

    kappa, alpha, gamma, fz, pressure, v = at
    tire = mf_tire(version, values)
    found = iso(tire, kappa, alpha, fz, gamma, v, pressure)
    expected = book(values)
    np.testing.assert_allclose(np.stack(found[:3]) / fz, expected, rtol=1e-9, atol=1e-11)
    assert tire.needs == ("v",) and tire_of(MF61).needs == ()
    idle = {"INFLPRES", *(IN_61 if version == "5.2" else IN_52)}
    for key in specs(tire):
        if key[:3] in ("QSX", "QSY") or key in ("LMX", "LVMX", "LMY", "PPMX1"):
            continue  # of M_x and M_y, see test_mf_moments.py
        moved = np.abs(book(Coefficients(values | {key: 1.05 * values[key]})) - expected).max()
        assert (moved > 1e-7) != (key in idle), key


# Coefficients that a mirrored tire has with the other sign: conicity, ply steer.
ODD = (
    "PHY1 PHY2 PVY1 PVY2 PEY3 RHX1 RBY3 RVY1 RVY2 QBZ4 QDZ3 QDZ6 QDZ7 QEZ4 QHZ1 QHZ2 SSZ1 QSX1"
).split()


@pytest.mark.parametrize(("name", "starred"), [(MF52, False), (MF61, True)])
def test_the_other_side_has_mirrored_coefficients(name, starred):
    tire = tire_of(name, starred)
    c = parameter_values(tire)
    other = with_values(tire, {key: -c[key] for key in ODD})
    generator = np.random.default_rng(5)
    point = {
        "kappa": generator.uniform(-0.4, 0.4, 200),
        "alpha": generator.uniform(-0.3, 0.3, 200),
        "gamma": generator.uniform(-0.1, 0.1, 200),
        "fz": generator.uniform(1000, 9000, 200),
        "pressure": generator.uniform(2e5, 3e5, 200),
    }
    sigma = -point["kappa"] / (1 + point["kappa"])
    mirrored = forces(
        Mirrored(tire),
        TireInputs(sigma, point["alpha"], point["fz"], 16.6, point["gamma"], point["pressure"]),
    )
    expected = iso(other, **point)
    for got, wanted in zip(mirrored, expected, strict=True):
        np.testing.assert_allclose(-got, wanted, rtol=1e-11, atol=1e-7)
    assert np.max(abs(iso(tire, **point).fy - expected.fy)) > 10


def test_the_pressure_of_a_sample_replaces_that_of_the_tire():
    tire, c = tire_of(MF61), values_of(MF61)
    nominal, high = c["NOMPRES"], 1.2 * c["NOMPRES"]
    slips = np.linspace(-0.3, 0.3, 7)
    inflated = with_values(tire, {"INFLPRES": high})
    for one, pressure in ((tire, nominal), (inflated, high)):
        own, given = iso(one, slips, 0.1), iso(tire, slips, 0.1, pressure=pressure)
        np.testing.assert_array_equal(np.stack(own), np.stack(given))


# Rest, hardly slipping, rolling on the edge of sliding, sideways, spinning, locked.
SLIPS = [
    (0.0, 0.0), (1e-12, -1e-12), (0.02, -0.02), (-0.3, 0.3), (0.0, np.pi / 2),
    (0.0, -np.pi / 2), (5.0, 1.4), (-0.9, -1.4), (LOCKED, 0.0), (LOCKED, -0.7),
]  # fmt: skip
GRID = np.array(
    [
        (*slip, fz, v, gamma, pressure, 0.0)
        for slip in SLIPS
        for fz in (-10.0, 0.0, 1e-6, 4000.0, 1e5)
        for v, gamma, pressure in ((0.0, 0.0, 0.0), (20.0, 0.05, 2.3e5), (9.0, -1.5, 0))
    ]
)


def on_grid(tires, dtype=jnp.float64):
    """Tires and inputs with one element for each point of the grid, one tire after another."""
    n = len(GRID)
    each = jax.tree.map(
        lambda *leaves: np.concatenate([np.full(n, leaf, dtype) for leaf in leaves]), *tires
    )
    return each, TireInputs(*np.tile(GRID.T, len(tires)).astype(dtype))


@jax.jit
def _pulled_back(tires, inputs, weights):
    value, pull_back = jax.vjp(lambda *pair: jnp.stack(pair[0](pair[1]), axis=-1), tires, inputs)
    return value, pull_back(weights)


def jacobian(*tires, dtype=jnp.float64):
    """Forces (n, 5), and the derivatives (n,) of their sum by every coefficient and input.

    By reverse mode, whose zeros times infinity are what must not be.
    """
    pair = on_grid(tires, dtype)
    value, slopes = _pulled_back(*pair, np.ones((len(pair[1].fz), 5), dtype))
    return np.asarray(value), [np.asarray(part) for part in jax.tree.leaves(slopes)]


# These are denominators.
ZERO = ("LMUX LMUY", "PCX1 PCY1", "PKY1", "PKY2 LKY")


@cache
def everywhere(name, starred, dtype):
    """The jacobian of a tire, and of it with coefficients that are zero."""
    tire = with_values(tire_of(name, starred), {"LMUV": 0.1})
    zero = [with_values(tire, dict.fromkeys(keys.split(), 0.0)) for keys in ZERO]
    return jacobian(tire, *zero, dtype=dtype)


@pytest.mark.parametrize(
    ("name", "starred", "dtype"),
    [(MF52, True, jnp.float32), (MF61, False, jnp.float32), (MF61, False, jnp.float64)],
)
def test_values_and_gradients_are_finite_everywhere(name, starred, dtype):
    value, slopes = everywhere(name, starred, dtype)
    value = value[: len(GRID)]
    assert value.dtype == dtype and np.isfinite(value).all()
    keys = [*specs(tire_of(name, starred)), *TireInputs._fields]
    for key, leaf in zip(keys, slopes, strict=True):
        bad = ~np.isfinite(leaf[: len(GRID)])
        assert not bad.any(), (key, GRID[bad][:3])
    unloaded = GRID[:, 2] <= 0
    np.testing.assert_array_equal(value[unloaded], 0.0)
    assert (value[GRID[:, 2] == 4000.0] != 0).all()


def test_float32_is_close():
    exact, near = (
        everywhere(MF61, False, dtype)[0][: len(GRID)] for dtype in (jnp.float64, jnp.float32)
    )
    # At alpha = pi/2 the trail is what the rounding of pi/2 makes of it.
    ordinary = (abs(GRID[:, 1]) < 1.5) & (abs(GRID[:, 4]) < 1) & (GRID[:, 2] < 1e5)
    error = abs(np.asarray(near, float) - exact)[ordinary]
    assert (error <= 1e-3 * abs(GRID[ordinary, 2:3])).all()


def test_gradient_agrees_with_finite_differences():
    base = np.array([0.05, -0.06, 4500.0, 15.0, 0.03, 2.4e5, 0.0])
    places = [0, 1, 2, 4, 5]
    steps = 1e-6 * np.maximum(abs(base), 0.1)[places]

    # One row for each output, then the moved ones; by the program of the other tests.
    tires, inputs = on_grid([tire_of(MF61)] * (1 + len(ZERO)))
    shifts = steps[:, None] * np.eye(7)[places]
    rows = np.array(inputs).T
    rows[:15] = np.concatenate([np.tile(base, (5, 1)), base + shifts, base - shifts])
    value, (_, slopes) = _pulled_back(tires, TireInputs(*rows.T), np.eye(len(rows), 5))
    ahead, behind = np.split(np.asarray(value)[5:15], 2)
    numeric = (ahead - behind) / (2 * steps[:, None])
    found = np.array([np.asarray(slopes[place])[:5] for place in places])
    np.testing.assert_allclose(found, numeric, rtol=1e-5, atol=1e-6)


def test_zero_friction_shape_or_stiffness_gives_finite_forces():
    value, slopes = everywhere(MF61, False, jnp.float64)
    assert len(value) == (1 + len(ZERO)) * len(GRID)
    for part in (*value.T, *slopes):
        bad = ~np.isfinite(part).reshape(1 + len(ZERO), -1)[1:]
        assert not bad.any(), dict(zip(ZERO, bad.sum(axis=1), strict=True))


def test_absent_coefficients_have_no_effect():
    known = specs(MAGIC_FORMULAS["mf61"])
    assert set(known) == set(COEFFICIENTS)
    essential = {"PCX1", "PDX1", "PKX1", "PCY1", "PDY1", "PKY1", "PKY2", "QBZ1", "QCZ1"}
    for key, spec in known.items():
        if key in essential or spec.unit != "-":
            continue
        neutral = NEUTRAL.get(key, 1.0 if key.startswith("L") else 0.0)
        assert spec.default == neutral, key
        assert spec.free != key.startswith("L")


def test_curvature_of_each_force_follows_its_coefficients():
    """(4.E14), (4.E24), (4.E56) and (4.E44) by hand."""
    values = {
        "FNOMIN": 4000.0, "PEX1": 0.5, "PEX2": 1.0, "PEX4": 0.2, "PEY1": -1.0,
        "PEY3": 1.5, "RBX1": 10.0, "RCX1": 1.0, "REX1": 3.0, "RHX1": 0.01, "QDZ1": 0.1,
        "QEZ1": 0.5, "QEZ2": 4.0,
    }  # fmt: skip
    tire = mf_tire("6.1", values)
    kappa, alpha = np.array([0.1, -0.1, 0.1, 0.0]), np.array([0.0, 0.0, 0.1, 0.1])
    fz = np.array([6000.0, 6000.0, 4000.0, 4000.0])
    found = curvatures(tire, TireInputs(-kappa / (1 + kappa), alpha, fz))
    # E_x = (0.5 + dfz) (1 -+ 0.2); the weight of F_x has E = 3 where alpha is not 0.
    np.testing.assert_allclose(found["fx"], [0.8, 1.2, 3.0, 3.0], rtol=1e-14)
    # At alpha = 0 E_y has no effect; -1 (1 - 1.5) = 0.5 at alpha > 0.
    np.testing.assert_allclose(found["fy"], [0.0, 0.0, 0.5, 0.5], rtol=1e-14)
    np.testing.assert_allclose(found["mz"], [2.5, 2.5, 0.5, 0.5], rtol=1e-14)


def test_the_limit_of_curvature_acts_exactly_where_reported():
    """Raising the coefficients of an E above one changes nothing, for any other E it
    does: so the limit is observable."""
    rng = np.random.default_rng(40)
    tire = with_values(tire_of(MF61), {"PEY1": 1.5, "PEY2": 1.2, "PEY3": 0.3})
    inputs = TireInputs(alpha=rng.uniform(-0.3, 0.3, 256), fz=rng.uniform(1500.0, 1e4, 256))
    limited = np.asarray(curvatures(tire, inputs)["fy"]) > 1
    more = with_values(tire, {"PEY1": 1.5 * 1.001, "PEY2": 1.2 * 1.001})
    same = np.asarray(forces(tire, inputs).fy) == np.asarray(forces(more, inputs).fy)
    np.testing.assert_array_equal(limited, same)
    assert 0.2 < limited.mean() < 0.9


def test_unknown_versions_are_refused():
    with pytest.raises(ValueError, match="7.0"):
        mf_tire("7.0", {})
