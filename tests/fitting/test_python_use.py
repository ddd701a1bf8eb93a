"""Results as people use them in Python: names, completion, data frames, samples, copies."""

import copy
import pickle

import numpy as np
import pytest

import tirefit
from tirefit.results import UsageError


@pytest.fixture(scope="module")
def swept():
    return tirefit.simulate("rig", values={"mu": 0.9}, seed=1)


@pytest.fixture(scope="module")
def fit(swept):
    return tirefit.fit(swept.columns, "brush")


@pytest.fixture(scope="module")
def sampled(fit):
    return tirefit.sample(fit)


def test_an_unknown_parameter_suggests_a_known_one(fit):
    with pytest.raises(KeyError, match=r"mue: did you mean 'mu'\? known: cpa2, mu"):
        fit.parameters["mue"]
    assert "mue" not in fit.parameters and fit.parameters.get("mue") is None


def test_completion_offers_results_and_no_internals(fit):
    offered = {name for name in dir(fit) if not name.startswith("_")}
    assert {"parameters", "predict", "samples", "to_frame", "plot", "save"} <= offered
    internal = "problem solved asked internal text_by page_by files limits"
    assert not offered & set(internal.split())


def test_predict_of_a_fit_is_the_function(fit):
    rows = {"sigma_x": np.array([0.02, 0.4]), "fz": np.array([3000.0, 5000.0])}
    own, other = fit.predict(rows), tirefit.predict(fit, rows)
    assert own.keys() == other.keys() == {"fx", "fx_std"}
    # At full sliding the force of a brush is mu F_z.
    assert own["fx"][1] == pytest.approx(fit.parameters["mu"].value * 5000.0, rel=1e-12)


def test_samples_have_the_posterior_of_the_fit(fit, sampled):
    with pytest.raises(UsageError, match="not sampled"):
        fit.samples  # noqa: B018
    draws = sampled.samples
    for name, one in sampled.parameters.items():
        values = np.asarray(draws[name]).ravel()
        assert np.median(values) == pytest.approx(one.value, abs=0.1 * one.std)
        assert draws[name].attrs["unit"] == one.unit


def test_any_arviz_summarises_the_samples(arviz, sampled):
    # A Dataset is the type that versions 0.2 and 1 take.
    table = arviz.summary(sampled.samples)
    assert float(table.loc["mu", "mean"]) == pytest.approx(0.9, abs=0.01)
    assert list(table.index) == ["cpa2", "mu"]


def test_data_frames_hold_the_estimates(fit):
    frame = fit.to_frame().set_index("name")
    one = fit.parameters["cpa2"]
    row = frame.loc["cpa2"]
    assert (row["value"], row["std"], row["low"], row["high"]) == (one.value, one.std, *one.ci95)
    assert row["unit"] == "N" and row["kind"] == "parameter"
    assert frame.loc["n", "value"] == fit.statistics.n


@pytest.mark.parametrize("again", [copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one))])
def test_results_can_be_copied_and_pickled(sampled, again):
    other = again(sampled)
    assert other.to_dict() == sampled.to_dict()
    with pytest.raises(KeyError, match="did you mean"):
        other.parameters["mue"]


def test_a_diagnosis_gives_a_data_frame():
    from tirefit.diagnosis.effects import EFFECTS

    slip = np.tile(np.linspace(-0.2, 0.2, 32), 3)
    load = np.repeat([2000.0, 4000.0, 6000.0], 32)
    force = tirefit.predict("brush", {"sigma_x": slip + 0.006, "fz": load}, {"mu": 0.9})["fx"]
    force = force + np.random.default_rng(1).normal(0, 20, len(slip))
    few = [e for e in EFFECTS if e.id in ("slip_offset", "load_friction")]
    rows = {"sigma_x": slip, "fz": load, "fx": force}
    found = tirefit.diagnose(rows, rig=tirefit.Rig(noise={"fx": 20.0}), effects=few)
    frame = found.to_frame().set_index(["kind", "name"])
    (name, size), *_ = found.amplitudes.items()
    assert frame.loc[("effect", name), "value"] == size.value == pytest.approx(0.006, abs=0.001)
    assert frame.loc[("gap", "rms"), "value"] == found.gap.rms
    assert "frame" not in dir(found) and "to_frame" in dir(found)
    for again in (copy.copy, copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one))):
        other = again(found)
        assert other.to_dict() == found.to_dict() and other.library == found.library
    with pytest.raises(KeyError, match="did you mean"):
        found.amplitudes["slip_ofset: sigma_x"]


def test_every_effect_is_copied_and_pickled_as_itself():
    from tirefit.diagnosis.effects import EFFECTS
    from tirefit.vehicle.effects import CAR_EFFECTS

    effects = EFFECTS + CAR_EFFECTS
    assert pickle.loads(pickle.dumps(effects)) == copy.deepcopy(effects) == effects
