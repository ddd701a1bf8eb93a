"""A whole Magic Formula from rows: parts, priors, search, and truth."""

import csv
import importlib.util
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from rig import MF52, MF61, measured
from scipy.optimize import least_squares

from tirefit.data.read import read_frame
from tirefit.data.tir.tir_keys import COEFFICIENTS, ONLY_IN
from tirefit.fitting.mf.fit import fit_magic_formula
from tirefit.fitting.mf.parts import NEVER_FITTED, PARTS, coefficients_of, influences
from tirefit.fitting.mf.priors import normal_form, published_priors
from tirefit.fitting.mf.solve import Problem, blocks_of, minimise, row_gradients
from tirefit.fitting.problem.noise import NoiseLaw, noise_law
from tirefit.models import TireInputs, forces
from tirefit.models.mf import MAGIC_FORMULAS
from tirefit.params import with_values
from tirefit.results import DataError, UsageError

SCRIPT = Path(__file__).parents[2] / "fits/magic_formula_priors/make_priors.py"


@cache
def priors_script():
    spec = importlib.util.spec_from_file_location("make_priors", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@cache
def columns(path, forces_, least=1e-9):
    """A test's rows of pure slip for these forces, as columns."""
    table = measured(path, n=28, loads=4)
    other = "alpha" if forces_ == ("fx",) else "sigma_x"
    rows = np.abs(table[other]) < least
    drop = {"fx", "fy", "mz", other} - set(forces_)
    return {k: v[rows] for k, v in table.items() if k not in drop}


@pytest.mark.parametrize("version", ["5.2", "6.1"])
def test_every_coefficient_belongs_to_one_part_and_has_a_prior(version):
    """The coefficients of files are those of the stages, except the scaling factors."""
    of_files = {
        key
        for key, section in COEFFICIENTS.items()
        if section not in ("VERTICAL", "DIMENSION", "MODEL", "OPERATING_CONDITIONS")
        and not section.startswith("SCALING")
        and ONLY_IN.get(key, version[0]) == version[0]
    } - {*NEVER_FITTED}
    own = coefficients_of(version)
    assert set(own) == of_files
    assert set(own.values()) == set(PARTS)
    moments = {n for n, part in own.items() if part in ("mx", "my")}
    assert set(influences(version, "mz")) == set(own) - moments
    assert all(own[n] == "mx" or n in influences(version, "fy") for n in influences(version, "mx"))
    assert not {n for n in influences(version, "fx") if own[n] in ("fy", "mz")}
    assert all(published_priors()[name].spread > 0 for name in own)


def test_the_shipped_priors_agree_with_the_published_tires(tmp_path):
    priors_script().main(tmp_path / "priors.csv")
    shipped = Path("tirefit/fitting/mf/priors.csv")
    shipped = Path(__file__).parents[2] / shipped
    assert (tmp_path / "priors.csv").read_text() == shipped.read_text()
    with open(shipped, newline="") as file:
        for row in csv.DictReader(file):
            for value in map(float, row["published"].split()):
                away = value - float(row["centre"])
                if row["scale"] == "log":
                    away = np.log(value / float(row["centre"]))
                said = f"{row['coefficient']} = {value} is no weak prior's"
                assert abs(away) < float(row["spread"]), said


def test_equivalent_signs_give_the_same_forces():
    values = {"PDY1": -0.9, "PDY2": 0.1, "PKY1": -20.0, "RVY1": 0.02, "RVY3": 0.3}
    values |= {"RVY4": -5.0, "RVY5": -1.9, "RVY6": 12.0, "RBX2": -8.0, "RBX1": 9.0}
    values |= {"RCX1": 1.0, "RCY1": 1.0, "RBY1": 11.0}
    generator = np.random.default_rng(0)
    fz = generator.uniform(1e3, 7e3, 50)
    slip, alpha, gamma = generator.uniform(-0.2, 0.2, (3, 50))
    inputs = TireInputs(slip, alpha, fz, gamma=gamma)
    empty = MAGIC_FORMULAS["mf61"]
    one, other = (forces(with_values(empty, v), inputs) for v in (values, normal_form(values)))
    np.testing.assert_allclose(one.fx, other.fx, rtol=1e-12)
    np.testing.assert_allclose(one.fy, other.fy, rtol=1e-12, atol=1e-9)
    assert normal_form(values)["PDY1"] == 0.9 and normal_form(values)["RVY5"] == 1.9


def small_problem(rows=300):
    """F_y of MF 6.1 in pure slip, without noise, from the centres of the priors."""
    table = columns(MF61, ("fy",))
    chosen = np.linspace(0, len(table["fy"]) - 1, rows).astype(int)
    table = {k: v[chosen] for k, v in table.items()}
    names = tuple(coefficients_of("6.1"))
    priors = [published_priors()[name] for name in names]
    free = np.array([coefficients_of("6.1")[name] == "fy" for name in names])
    given = {k: v for k, v in table.items() if k in TireInputs._fields}
    inputs = TireInputs(*np.broadcast_arrays(*TireInputs(**given)))
    blocks = blocks_of("fy", inputs, table["fy"], 0.01 * table["fz"])
    nominal = {"FNOMIN": 6752.0, "NOMPRES": 2.6e5, "INFLPRES": 2.6e5}
    centre = np.array([p.centre for p in priors])
    spread = np.array([p.spread for p in priors])
    tire = with_values(MAGIC_FORMULAS["mf61"], nominal)
    log = np.array([p.log for p in priors])
    return Problem(tire, names, centre, spread, log, free, blocks)


def test_slopes_agree_with_finite_differences():
    problem = small_problem(40)
    generator = np.random.default_rng(1)
    u = 0.1 * generator.standard_normal(len(problem.names))
    residual, slope = row_gradients(problem, u)
    assert residual.shape == (40,)
    for i in np.flatnonzero(problem.free)[::4]:
        step = np.zeros(len(u))
        step[i] = 1e-6
        ahead, behind = (row_gradients(problem, u + s * step)[0] for s in (1, -1))
        np.testing.assert_allclose(slope[:, i], (ahead - behind) / 2e-6, rtol=1e-5, atol=1e-5)


def test_the_optimum_is_at_least_as_good_as_scipys():
    """From the centres of the priors, and from the end of the other search."""
    problem = small_problem()
    start = np.zeros(len(problem.names))
    end = minimise(problem, start)
    assert end.converged
    free = np.flatnonzero(problem.free)

    def whole(x):
        u = start.copy()
        u[free] = x
        return u

    def residual(x):
        return np.concatenate([row_gradients(problem, whole(x))[0], x])

    def jacobian(x):
        slope = row_gradients(problem, whole(x))[1][:, free]
        return np.concatenate([slope, np.eye(len(free))])

    ours = residual(end.z[free])
    np.testing.assert_allclose(ours @ ours, end.cost, rtol=1e-12)
    for first in (start[free], end.z[free], end.z[free] + 0.05):
        peer = least_squares(residual, first, jacobian, xtol=1e-12, ftol=1e-12)
        assert ours @ ours <= 2 * peer.cost * (1 + 1e-6)


def test_constant_and_growing_noise_are_distinguished():
    generator = np.random.default_rng(3)
    fz = generator.choice([1e3, 2e3, 4e3, 8e3], 20_000)
    force = fz * generator.uniform(-1.2, 1.2, len(fz))
    laws = [(30.0, 0.0, 0.0), (0.0, 0.01, 0.0), (20.0, 0.01, 0.0), (10.0, 0.0, 0.03)]
    for law in (NoiseLaw(*parts) for parts in laws):
        std = law.std(fz, force)
        known = generator.uniform(0.0, 50.0, len(fz)) ** 2
        missed = np.sqrt(std**2 + known) * generator.standard_normal(len(fz))
        found = noise_law(missed, fz, force, known)
        np.testing.assert_allclose(found.std(fz, force), std, rtol=0.12, atol=3.0)


def test_pure_lateral_rows_recover_their_coefficients():
    """Compared with the file that made them, in standard errors."""
    from tirefit.data.tir.tir import read_tir

    table = columns(MF61, ("fy",))
    nominal = {"FNOMIN": {"value": 6752.0}, "NOMPRES": {"value": 2.6e5}}
    result = fit_magic_formula(
        read_frame(table), "mf61", part="fy", config={"parameters": nominal}, leave_out="none"
    )
    assert result.parts == ("fy",) and result.forces == ("fy",)
    true = normal_form(read_tir(MF61).numbers)
    away = [
        (one.value - true[name]) / one.std
        for name, one in result.coefficients.items()
        if one.part == "fy"
    ]
    assert np.max(np.abs(away)) < 4.0 and 0.5 < np.std(away) < 1.7
    held = [one for one in result.coefficients.values() if one.part != "fy"]
    assert all(one.origin == "held" and one.value == one.prior_mean for one in held)
    assert result.noise["fy"].std(6e3, 3e3) == pytest.approx(60.0, rel=0.05)


def test_coefficients_without_variation_are_fixed_and_reported():
    """At zero camber and one pressure, the terms of both are undetermined."""
    table = columns(MF61, ("fy",))
    upright = (table["gamma"] == 0) & (table["pressure"] == 2.6e5)
    table = {k: v[upright] for k, v in table.items() if k not in ("gamma", "pressure")}
    result = fit_magic_formula(read_frame(table), "mf62", part="fy", leave_out="none")
    held = {k for k, one in result.coefficients.items() if one.origin == "held"}
    assert {"PKY3", "PKY5", "PKY6", "PVY3", "PPY1", "PPY5", "PDY3", "PEY4"} <= held
    assert not {"PDY1", "PDY2", "PCY1", "PKY1", "PHY1", "PVY1"} & held
    assert result.coefficients["PKY6"].std == result.coefficients["PKY6"].prior_std
    assert result.status == "not identified"


def test_given_coefficients_and_priors_are_used():
    table = dict(columns(MF52, ("fx",)))
    asked = {"PEX4": {"value": 0.0, "free": False}, "PCX1": {"prior": {"mean": 1.2, "std": 0.001}}}
    config = {"parameters": asked, "noise": {"fx": 20.0, "sigma_x": 1e-3}}
    table["fx"] = table["fx"] + 0.5 * table["fz"] * (np.arange(len(table["fz"])) == 100)
    result = fit_magic_formula(
        read_frame(table), "mf52", part="fx", config=config, leave_out="none"
    )
    assert any(
        "standard deviations in 1 of" in note and "rows of fx" in note for note in result.notes
    )
    assert any(note.startswith("noise.fx, noise.sigma_x: not used, a") for note in result.notes)
    assert result.coefficients["PEX4"].origin == "given"
    assert result.coefficients["PEX4"].value == 0 == result.coefficients["PEX4"].std
    assert abs(result.coefficients["PCX1"].value - 1.2) < 0.02
    assert "PKY4" not in result.coefficients  # of MF 6


@pytest.mark.parametrize(
    ("model", "part", "config", "said"),
    [
        ("mf53", "all", {}, "mf52"),
        ("mf61", "fz", {}, "known: fx, fy, mz, all"),
        ("mf61", "fy", {"parameters": {"PDY1": {"lower": 0.1}}}, "PDY1: lower"),
        ("mf61", "fy", {"parameters": {"PDY1": {"tied": "PDX1"}}}, "PDY1: tied"),
        ("mf61", "fy", {"noise": {"loss": "huber"}}, "noise.loss"),
        ("mf61", "fy", {"parameters": {"PDZ1": {"value": 1.0}}}, "PDZ1"),
        ("mf61", "fy", {"parameters": {"PHY3": {"free": False}}}, "PHY3"),
        ("mf61", "fy", {"force": ["fx"], "starts": 2}, "force, starts in a Magic"),
    ],
)
def test_wrong_settings_are_refused(model, part, config, said):
    data = read_frame(columns(MF61, ("fy",)))
    with pytest.raises(UsageError, match=said):
        fit_magic_formula(data, model, part=part, config=config)


def test_data_without_the_force_or_with_few_rows_are_refused():
    table = columns(MF61, ("fy",))
    with pytest.raises(DataError, match="no fx with its slip"):
        fit_magic_formula(read_frame(table), "mf61", part="fx")
    few = {k: v[:20] for k, v in table.items()}
    with pytest.raises(DataError, match="20 rows of fy"):
        fit_magic_formula(read_frame(few), "mf61")
    held = table | {"sigma_x": np.full(len(table["fz"]), 0.1)}
    with pytest.raises(DataError, match="too few rows of fy in pure slip"):
        fit_magic_formula(read_frame(held), "mf61", part="fy")
    in_bar = table | {"pressure": np.full(len(table["fz"]), 2.2)}
    with pytest.raises(DataError, match=r"2\.2 Pa(.|\n)*units=.*bar"):
        fit_magic_formula(read_frame(in_bar), "mf61")
