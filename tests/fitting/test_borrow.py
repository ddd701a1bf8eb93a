"""A similar tire as the prior of forces that a test lacks."""

from functools import cache

import numpy as np
import pytest
from rig import MF52, MF61, Plan, sweeps, tire_of

from tirefit.data.read import read_frame
from tirefit.data.tir.tir import read_tir
from tirefit.fitting.mf.fit import fit_magic_formula
from tirefit.fitting.mf.priors import published_priors
from tirefit.fitting.mf.result import tir_of
from tirefit.models import TireInputs, forces
from tirefit.models.mf import mf_tire

# The longitudinal force of the tire is 0.8 in friction and 0.7 in stiffness of the
# other's, as its lateral one is; and of another nominal load and radius.
FRICTION, STIFFNESS = 0.8, 0.7


@cache
def other():
    numbers = read_tir(MF52).numbers
    scaled = {"PDX1": FRICTION, "PDX2": FRICTION, "PDY1": FRICTION, "PDY2": FRICTION}
    scaled |= dict.fromkeys(("PKX1", "PKX2", "PKY1"), STIFFNESS)
    scaled |= {"FNOMIN": 1.3, "UNLOADED_RADIUS": 1.1}
    new = {key: numbers[key] / size for key, size in scaled.items()}
    return read_tir(MF52).with_values(new)


@cache
def lateral_test():
    inputs, run = sweeps(Plan(MF52), 0, 24, 4)
    chosen = np.asarray(inputs.sigma_x) == 0
    inputs = TireInputs(*(np.asarray(column)[chosen] for column in inputs))
    fy = np.asarray(forces(tire_of(MF52), inputs).fy)
    noise = 0.01 * inputs.fz * np.random.default_rng(2).standard_normal(len(fy))
    return {
        "alpha": inputs.alpha,
        "gamma": inputs.gamma,
        "fz": inputs.fz,
        "fy": fy + noise,
        "run": run[chosen],
    }


def fitted(like, model="mf52", **more):
    given = {"FNOMIN": {"value": read_tir(MF52).numbers["FNOMIN"]}} | more
    config = {"parameters": given}
    return fit_magic_formula(
        read_frame(lateral_test()), model, config=config, like=like, leave_out="none"
    )


@cache
def borrowing():
    return fitted(other())


@pytest.mark.long
def test_an_unmeasured_force_is_scaled_from_the_other_tire():
    fit, true = borrowing(), tire_of(MF52)
    slip = np.array([-0.1, -0.05, -0.02, -0.005, 0.005, 0.02, 0.05, 0.1])
    at = TireInputs(slip, fz=np.full(8, read_tir(MF52).numbers["FNOMIN"]))
    found, expected = forces(fit.tire, at).fx, forces(true, at).fx
    # The two scales are read off lateral rows with noise, camber and shifts.
    np.testing.assert_allclose(found, expected, rtol=0.12)
    unlike = forces(mf_tire("5.2", other().numbers), at).fx
    assert np.min(np.abs(unlike / expected)) > 1.15


def test_borrowed_coefficients_are_reported_with_their_prior():
    fit = borrowing()
    for name, one in fit.coefficients.items():
        prior = published_priors()[name]
        if one.part != "fy" and one.origin == "borrowed" and not prior.log:
            assert one.value == one.prior_mean
            assert one.std == pytest.approx(0.25 * prior.spread)
    origins = {name: one.origin for name, one in fit.coefficients.items()}
    assert origins["PCX1"] == origins["QBZ1"] == origins["QSX3"] == "borrowed"
    assert origins["PDY1"] == origins["PCY1"] == "fitted"
    assert fit.tire.nominal.UNLOADED_RADIUS == other().numbers["UNLOADED_RADIUS"]
    text = " ".join(fit.summary(full=True).split())
    assert "borrowed, since not measured: longitudinal force in pure slip" in text
    assert "aligning moment" in text and "rolling resistance moment" in text
    written = tir_of(fit)
    assert "shape factor of F_x; borrowed +- " in written.text
    assert written.numbers["QSX3"] == other().numbers["QSX3"]


def test_measured_data_override_the_borrowed_tire():
    c, true = borrowing().coefficients, read_tir(MF52).numbers
    assert abs(c["PDY1"].value - true["PDY1"]) < 4 * c["PDY1"].std
    assert abs(c["PDY1"].value - other().numbers["PDY1"]) > 20 * c["PDY1"].std


def test_given_values_override_the_borrowed_tire():
    more = {
        "PCX1": {"value": 1.3},
        "PDX1": {"prior": {"mean": 0.5, "std": 0.1}},
        "UNLOADED_RADIUS": {"value": 0.4},
    }
    fit = fitted(other(), **more)
    assert fit.coefficients["PCX1"].value == 1.3
    assert fit.coefficients["PCX1"].origin == "given"
    assert fit.coefficients["PDX1"].prior_mean == 0.5
    assert fit.coefficients["PDX1"].origin == "held"
    assert fit.tire.nominal.UNLOADED_RADIUS == 0.4


def test_a_tire_of_another_version_lends_common_coefficients():
    fit = fitted(MF61)
    assert fit.coefficients["PCX1"].value == read_tir(MF61).numbers["PCX1"]
    assert any("not borrowed, as MF 5.2 lacks them: " in note for note in fit.notes)
    assert any("PKY6" in note for note in fit.notes)
