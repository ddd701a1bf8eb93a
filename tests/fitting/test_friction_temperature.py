"""Friction that depends on temperature, as a covariate of a whole Magic Formula."""

import json
from functools import cache

import jax
import numpy as np
import pytest
from rig import MF52, Plan, sweeps, tire_of

from tirefit.data.read import read_frame
from tirefit.data.tir.tir import read_tir
from tirefit.fitting.estimate import fit
from tirefit.fitting.mf.fit import fit_magic_formula
from tirefit.fitting.mf.result import tir_of
from tirefit.fitting.problem.config import parse_config
from tirefit.models import TireInputs
from tirefit.params import with_values
from tirefit.results import DataError, UsageError

PER_KELVIN = -0.004
NOMINAL = {"FNOMIN": {"value": read_tir(MF52).numbers["FNOMIN"]}}


@cache
def warming_test(per_kelvin=PER_KELVIN):
    """A tire that warms up over the loads of a test of pure slip and within each sweep."""
    inputs, run = sweeps(Plan(MF52), 0, 24, 4)
    pure = (np.asarray(inputs.sigma_x) == 0) | (np.asarray(inputs.alpha) == 0)
    inputs = TireInputs(*(np.asarray(column)[pure] for column in inputs))
    run = run[pure]
    row = np.arange(len(run))
    warm = 50 + 25 * (1 - np.exp(-2 * row / len(row))) + 6 * np.abs(np.sin(row / 8))
    tire, reference = tire_of(MF52), np.round(np.median(warm))

    def one(sample, change):
        return with_values(tire, {"LMUX": 1 + change, "LMUY": 1 + change})(sample)

    true = jax.vmap(one)(inputs, per_kelvin * (warm - reference))
    noise = 0.01 * inputs.fz * np.random.default_rng(5).standard_normal((2, len(run)))
    columns = {k: getattr(inputs, k) for k in ("sigma_x", "alpha", "fz", "gamma")}
    forces = {"fx": true.fx + noise[0], "fy": true.fy + noise[1]}
    forces = {name: np.asarray(column) for name, column in forces.items()}
    return columns | forces | {"temperature": warm, "run": run}, reference


@cache
def fitted(friction_temperature, part="all"):
    config = {"model": {"friction_temperature": friction_temperature}}
    data = read_frame(warming_test()[0])
    config |= {"parameters": NOMINAL}
    return fit_magic_formula(data, "mf52", part=part, config=config, leave_out="none")


@pytest.mark.long
def test_friction_and_its_temperature_dependence_are_recovered():
    found, true = fitted(True), read_tir(MF52).numbers
    b, std, reference = found.warmth
    assert reference == warming_test()[1]
    assert abs(b - PER_KELVIN) < 3 * std < 0.4 * abs(PER_KELVIN)
    plain = fitted(False)
    assert plain.warmth is None
    for name in ("PDX1", "PDX2"):
        one = found.coefficients[name]
        assert abs(one.value - true[name]) < 4 * one.std
    # Without it the warmth of the heavy loads looks like an effect of load.
    assert abs(plain.coefficients["PDX2"].value - true["PDX2"]) > 0.02
    assert found.fitted["fx"][0] < plain.fitted["fx"][0]


@pytest.mark.long
def test_standard_errors_include_that_of_the_temperature_dependence():
    """Of the load dependence of friction, which warmth over the loads looks like: as in a
    fit with known temperature dependence, and one with it wrong by its standard error."""

    def along(per_kelvin, friction_temperature):
        table = warming_test(per_kelvin)[0]
        pure = table["alpha"] == 0
        table = {name: values[pure] for name, values in table.items() if name != "fy"}
        config = {"parameters": NOMINAL, "model": {"friction_temperature": friction_temperature}}
        found = fit_magic_formula(read_frame(table), "mf52", config=config, leave_out="none")
        return found.coefficients["PDX2"], found.warmth

    found, (_, std, _) = along(PER_KELVIN, True)
    known, wrong = along(0.0, False)[0], along(std, False)[0]
    expected = np.hypot(known.std, wrong.value - known.value)
    assert abs(found.std / expected - 1) < 0.1 and expected > 1.5 * known.std
    assert abs(found.value - read_tir(MF52).numbers["PDX2"]) < 2 * found.std


def test_temperature_dependence_is_reported_in_percent_and_written():
    found = fitted(True, "fx")
    said = "% per 10 K of the column temperature; coefficients and figures are at"
    assert said in " ".join(str(found).split())
    assert said in tir_of(found).text
    content = json.loads(found.to_json())["temperature"]
    assert content["reference"] == warming_test()[1] and content["std"] > 0


def test_unsuitable_models_and_data_are_refused():
    table, _ = warming_test()
    table = {k: v for k, v in table.items() if k != "temperature"}
    config = {"model": {"friction_temperature": True}, "parameters": NOMINAL}
    with pytest.raises(DataError, match="friction_temperature needs temperature"):
        fit_magic_formula(read_frame(table), "mf52", config=config)
    still = table | {"temperature": np.full(len(table["fz"]), 60.0)}
    with pytest.raises(DataError, match="varies by less than 1 K"):
        fit_magic_formula(read_frame(still), "mf52", config=config)
    with pytest.raises(UsageError, match="friction_temperature with the model brush"):
        fit(read_frame(still), model="brush", config={"model": config["model"]})
    with pytest.raises(UsageError, match="friction_temp"):
        parse_config({"model": {"friction_temp": True}})
    assert parse_config({"model": {"name": "mf61"}}).model == "mf61"
