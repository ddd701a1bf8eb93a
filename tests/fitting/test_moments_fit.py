"""M_x and M_y of a whole Magic Formula, fitted with the forces."""

from functools import cache

import numpy as np
import pytest
from rig import MF52, Plan, sweeps, tire_of

from tirefit.data.read import read_frame
from tirefit.data.tir.tir import read_tir
from tirefit.fitting.mf.fit import fit_magic_formula
from tirefit.fitting.mf.result import tir_of
from tirefit.fitting.predict import predict
from tirefit.fitting.store import load_fit
from tirefit.models import TireInputs, forces
from tirefit.models.mf import mf_tire

NOISE = {"mx": 2.0, "my": 0.3}
NOMINAL = ("FNOMIN", "UNLOADED_RADIUS", "LONGVL")


@cache
def columns():
    """A test of the tire of MF 5.2 in pure slip at several speeds, with noise, and what is
    true."""
    inputs, run = sweeps(Plan(MF52), 0, 24, 4)
    pure = (np.asarray(inputs.sigma_x) == 0) | (np.asarray(inputs.alpha) == 0)
    inputs = TireInputs(*(np.asarray(column)[pure] for column in inputs))
    run = run[pure]
    draw = np.random.default_rng(4)
    inputs = inputs._replace(v=draw.uniform(5, 40, len(run)))
    true = {k: np.asarray(v) for k, v in forces(tire_of(MF52), inputs)._asdict().items()}
    fz = np.asarray(inputs.fz)
    std = {"fx": 0.01 * fz, "fy": 0.01 * fz, "mx": 2.0 + 0 * fz, "my": 0.3 + 0 * fz}
    noisy = {k: true[k] + s * draw.standard_normal(len(fz)) for k, s in std.items()}
    kept = ("sigma_x", "alpha", "fz", "v", "gamma")
    given = {k: np.asarray(getattr(inputs, k)) for k in kept}
    return given | noisy | {"run": run}, true


def fitted(without=(), **more):
    table, _ = columns()
    numbers = read_tir(MF52).numbers
    given = {name: {"value": numbers[name]} for name in NOMINAL} | more
    table = {k: v for k, v in table.items() if k not in without}
    return fit_magic_formula(
        read_frame(table), "mf52", config={"parameters": given}, leave_out="none"
    )


@cache
def whole():
    return fitted()


def test_the_moments_are_recovered_within_standard_errors():
    fit, numbers = whole(), read_tir(MF52).numbers
    assert fit.forces == ("fx", "fy", "mx", "my") and "not converged" not in fit.outcomes
    assert fit.parts == ("fx", "fy", "combined", "mx", "my")
    for name, one in fit.coefficients.items():
        if one.part in ("mx", "my"):
            assert one.origin == "fitted"
            assert abs(one.value - numbers[name]) < 4 * one.std, name
    for force, std in NOISE.items():
        assert fit.fitted[force][0] == pytest.approx(std, rel=0.05)
        assert fit.noise[force].std(4e3, 0.0) == pytest.approx(std, rel=0.2)


def test_the_moments_do_not_move_the_forces():
    """Even if they come from another tire."""
    alone = fitted(without=("mx", "my"))
    assert not {"mx", "my"} & set(alone.forces)
    assert not any(name.startswith(("QSX", "QSY")) for name in alone.coefficients)
    assert not {"QSX1", "QSY1"} & set(tir_of(alone).numbers)
    # Another number of coefficients is another compiled program, with other rounding.
    for name, one in alone.coefficients.items():
        both = (whole().coefficients[name], one)
        assert both[0].value == pytest.approx(both[1].value, rel=1e-9, abs=1e-12)
        assert both[0].std == pytest.approx(both[1].std, rel=1e-6)
    names = list(alone.coefficients)
    at = [list(whole().coefficients).index(name) for name in names]
    covariance = whole().covariance[np.ix_(at, at)]
    np.testing.assert_allclose(covariance, alone.covariance, rtol=1e-6, atol=1e-12)


def test_the_files_reproduce_the_moments(tmp_path):
    fit, (_, true) = whole(), columns()
    fit.save(tmp_path)
    inputs = {k: columns()[0][k] for k in ("sigma_x", "alpha", "fz", "v", "gamma")}
    stored = predict(load_fit(tmp_path / "fit.json"), inputs)
    tir = read_tir(tmp_path / "fit.tir")
    of_file = predict(mf_tire(tir.version, tir.numbers), inputs)
    for force, noise in NOISE.items():
        np.testing.assert_allclose(of_file[force], stored[force], rtol=1e-9, atol=1e-9)
        error = stored[force] - true[force]
        assert np.sqrt(np.mean(error**2)) < 0.2 * noise
        own = np.sqrt(np.maximum(stored[f"{force}_std"] ** 2 - noise**2, 0.0))
        assert np.max(own) < noise


def test_an_overturning_moment_needs_a_lateral_force():
    """A given coefficient of it is written to the file all the same."""
    fit = fitted(without=("fy",), QSX3={"value": 0.02})
    assert fit.coefficients["QSX3"].origin == "given" and tir_of(fit).numbers["QSX3"] == 0.02
    assert "mx" not in fit.forces and "my" in fit.forces
    assert any("mx is not fitted: the data have no fy" in note for note in fit.notes)
