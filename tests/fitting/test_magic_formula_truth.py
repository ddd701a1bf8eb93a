"""Tests of known tires: recovered forces within and beyond their rows.

The priors of each tire are made without its own family, so that no truth stands in
them.
"""

import importlib.util
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from rig import MF61, NOISE, TIRES, Plan, family_of, measured, points, sweeps, tire_of

from tirefit.data.read import read_frame
from tirefit.data.tir.tir import read_tir
from tirefit.fitting.mf import fit as fit_module
from tirefit.fitting.mf.fit import fit_magic_formula
from tirefit.fitting.mf.result import tir_of
from tirefit.fitting.predict import predict
from tirefit.fitting.store import load_fit
from tirefit.models import forces
from tirefit.models.mf import mf_tire

SCRIPT = Path(__file__).parents[2] / "fits/magic_formula_priors/make_priors.py"
MODEL = {"5.2": "mf52", "6.1": "mf61", "6.2": "mf62"}
FORCES = ("fx", "fy", "mz")


@cache
def priors_without(family):
    spec = importlib.util.spec_from_file_location("make_priors", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.priors_without(family)


def fit_of(path, monkeypatch, seed=0, **size):
    """The fit of a test of this tire."""
    table = measured(path, seed, **size)
    priors = priors_without(family_of(path))
    monkeypatch.setattr(fit_module, "published_priors", lambda: priors)
    numbers = read_tir(path).numbers
    nominal = ("FNOMIN", "UNLOADED_RADIUS", "NOMPRES")
    given = {name: {"value": numbers[name]} for name in nominal if name in numbers}
    model = MODEL[read_tir(path).version]
    return fit_magic_formula(read_frame(table), model, config={"parameters": given})


def arm_of(path) -> float:
    """Longest arm of M_z in the test [m], to which its errors are referred."""
    inputs, _ = sweeps(Plan(path), 0)
    return float(np.max(np.abs(forces(tire_of(path), inputs).mz) / inputs.fz))


def judged(path, fit, at, seed):
    """Force -> (RMS error over the load, share of true values within the band of the
    force, share of new measurements within that of a measurement), at inputs ``at``."""
    columns = {
        name: np.asarray(column)
        for name, column in at._asdict().items()
        if name in ("sigma_x", "alpha", "fz", "gamma") or np.any(column)
    }
    given = predict(fit, columns)
    true = forces(tire_of(path), at)
    generator = np.random.default_rng([seed, 3])
    shares = {}
    for force in FORCES:
        size = np.asarray(at.fz) * (arm_of(path) if force == "mz" else 1.0)
        error = given[force] - np.asarray(getattr(true, force))
        std = given[f"{force}_std"]
        noise = fit.noise[force].variance(at.fz, given[force])
        own = np.sqrt(np.maximum(std**2 - noise, 0.0))
        new = error - NOISE * size * generator.standard_normal(len(error))
        shares[force] = (
            float(np.sqrt(np.mean((error / size) ** 2))),
            float(np.mean(np.abs(error) < 1.96 * own)),
            float(np.mean(np.abs(new) < 1.96 * std)),
        )
    return shares


@pytest.mark.long
def test_forces_are_recovered_within_and_beyond_the_loads(monkeypatch, tmp_path):
    """MF 6.1 in pure and combined slip; the file and the record say the same."""
    fit = fit_of(MF61, monkeypatch, n=30, loads=4)
    assert "not converged" not in fit.outcomes and fit.forces == FORCES
    assert fit.parts == ("fx", "fy", "mz", "combined")
    plan = Plan(MF61)
    for over, most in ((1.0, 0.005), (1.3, 0.03)):
        at, _ = points(plan, 0, over)
        for error, _, new in judged(MF61, fit, at, 0).values():
            assert error < most
            # The formula describes this tire beyond the loads as well as within.
            assert 0.90 < new < (0.99 if over == 1 else 1.001)
    assert all(guard.holds for guard in fit.guards)
    fit.save(tmp_path)
    written = read_tir(tmp_path / "fit.tir")
    assert written.text == tir_of(fit).text
    at, _ = points(plan, 0)
    columns = {k: np.asarray(v) for k, v in at._asdict().items() if k != "time"}
    stored = predict(load_fit(tmp_path / "fit.json"), columns)
    own = predict(fit, columns)
    of_file = predict(mf_tire(written.version, written.numbers), columns)
    for force in FORCES:
        np.testing.assert_allclose(of_file[force], own[force], rtol=1e-9, atol=1e-6)
        for name in (force, f"{force}_std"):
            np.testing.assert_allclose(stored[name], own[name], rtol=1e-9, atol=1e-6)


@pytest.mark.statistics
@pytest.mark.parametrize("path", TIRES, ids=lambda path: path.stem[-24:])
def test_every_published_tire_is_recovered(path, monkeypatch):
    """0.5 % of the load inside and 3 % at 1.3 times the loads; of 95 % bands 90 to 99 %
    of new measurements are within, and of true forces in the mean over the seeds.

    M_z, over the load and its longest arm, to 1 % inside, and 75 % of its true values
    within: the residual moment of the 6.1 tire is a peak of half a degree. Beyond the
    loads its band may hold fewer new ones, 78 % in the worst of 28 tests: the linear
    propagation of a trail cubic in the load.
    """
    true_within: dict[str, list] = {force: [] for force in FORCES}
    for seed in range(4):
        fit = fit_of(path, monkeypatch, seed)
        assert "not converged" not in fit.outcomes
        for over, most in ((1.0, 0.005), (1.3, 0.03)):
            at, _ = points(Plan(path), seed, over)
            for force, (error, true, new) in judged(path, fit, at, seed).items():
                moment = force == "mz"
                assert error < max(most, 0.01 * moment), (force, over, seed)
                least = 0.75 if moment and over > 1 else 0.90
                assert least <= new <= 1.0, (force, over, seed, new)
                if over == 1:
                    true_within[force].append(true)
    # True forces along a curve are wrong together: what holds is their mean.
    for force, shares in true_within.items():
        assert (0.75 if force == "mz" else 0.88) < np.mean(shares), force
