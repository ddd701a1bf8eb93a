"""fit.json and predictions: round trips, spreads, runs."""

import json
from dataclasses import replace

import numpy as np
import pytest
from recipes import FZ, STD, TRUTH, brush_force, curve, table

from tirefit.door import sealed
from tirefit.fitting.estimate import fit
from tirefit.fitting.predict import predict
from tirefit.fitting.store import load_fit
from tirefit.fitting.uncertainty.derived import derived_from_draws, quantities
from tirefit.params import constrain
from tirefit.results import DataError, UsageError

NEW = table({"sigma_x": np.linspace(-0.15, 0.2, 36), "fz": np.full(36, 3500.0)}, "new")


def no_constant(text):
    raise AssertionError(f"{text} is not JSON")


def test_the_json_file_satisfies_the_schema(sampled, tmp_path):
    written = sampled.save(tmp_path / "out")
    assert sorted(p.name for p in written) == ["fit.json", "posterior.nc"]
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["fit.json", "posterior.nc"]
    text = (tmp_path / "out" / "fit.json").read_text()
    content = json.loads(text, parse_constant=no_constant)
    assert content["schema"] == "tirefit.fit/1"
    assert content["model"] == "brush" and content["seed"] == 0
    for name in ("cpa2", "mu"):
        entry = content["parameters"][name]
        assert {"value", "std", "unit", "ci95"} <= set(entry)
        assert entry["ci95"][0] < entry["value"] < entry["ci95"][1]
    assert {"rmse", "chi2_dof", "aicc", "bic", "n", "n_effective", "converged", "at_bound"} <= set(
        content["fit"]
    )
    assert content["verdict"]["status"] == "ok"
    assert content["data"]["convention"] == "braking" and "sha256" in content["data"]
    assert {"jax", "numpy", "emcee", "python"} <= set(content["versions"])


def test_not_a_number_becomes_null(given):
    broken = replace(given.statistics, aicc=float("nan"), bic=float("inf"))
    text = replace(given, statistics=broken).to_json()
    content = json.loads(text, parse_constant=no_constant)
    assert content["fit"]["aicc"] is None and content["fit"]["bic"] is None


def test_information_criteria_agree_with_hand_calculation(given, estimated):
    for result, count in ((given, 2), (estimated, 3)):
        values = {k: result.least_squares[k].value for k in ("cpa2", "mu")}
        residual = result.table["fx"] - brush_force(result.table["sigma_x"], **values)
        # The scale is that of the unbiased variance, as reported.
        std = STD if result is given else np.sqrt(residual @ residual / 398)
        minus_two_log = np.sum(np.log(2 * np.pi * std**2) + (residual / std) ** 2)
        statistics = result.statistics
        np.testing.assert_allclose(statistics.bic, minus_two_log + count * np.log(400), rtol=1e-6)
        correction = 2 * count * (count + 1) / (400 - count - 1)
        np.testing.assert_allclose(
            statistics.aicc, minus_two_log + 2 * count + correction, rtol=1e-6
        )
        np.testing.assert_allclose(statistics.rmse, np.sqrt(np.mean(residual**2)), rtol=1e-6)


def test_a_stored_fit_predicts_like_the_original(given, tmp_path):
    given.save(tmp_path)
    assert not (tmp_path / "posterior.nc").exists()
    stored, live = predict(load_fit(tmp_path / "fit.json"), NEW), predict(given, NEW)
    assert set(stored) == set(live) == {"fx", "fx_std"}
    for name in live:
        np.testing.assert_allclose(stored[name], live[name], rtol=1e-12)
    values = {k: given.least_squares[k].value for k in ("cpa2", "mu")}
    expected = brush_force(NEW["sigma_x"], **values, fz=3500.0)
    np.testing.assert_allclose(live["fx"], expected, rtol=1e-9, atol=1e-6)


def test_predictive_spread_agrees_with_monte_carlo(given, sampled):
    found = predict(given, NEW)["fx_std"]
    draws = sampled.walkers.reshape(-1, 2)
    chosen = draws[np.random.default_rng(0).choice(len(draws), 4000)]
    forces = [brush_force(NEW["sigma_x"], *row, fz=3500.0) for row in chosen]
    spread = np.std(forces, axis=0)
    np.testing.assert_allclose(np.sqrt(found**2 - STD**2), spread, rtol=0.1, atol=0.05)
    assert (found >= STD).all()


def test_masked_rows_are_not_predicted(given):
    used = np.arange(36) % 2 == 0
    found = predict(given, replace(NEW, used=used))
    assert (np.isnan(found["fx"]) == ~used).all()
    assert (np.isnan(found["fx_std"]) == ~used).all()


@pytest.mark.parametrize(
    ("name", "values", "said"),
    [
        ("brsh", {}, "unknown model 'brsh'"),
        ("brush", {"nu": 1.0}, "brush has no parameter 'nu'"),
        ("brush", {"mu": 9.0}, "mu = 9.0 is outside its bounds [0.01, 5]"),
    ],
)
def test_wrong_model_is_refused(name, values, said):
    with pytest.raises(UsageError) as caught:
        predict(name, NEW, values)
    assert said in str(caught.value)


def test_missing_inputs_are_named():
    with pytest.raises(DataError) as caught:
        predict("brush-n", replace(NEW, columns={"sigma_x": NEW["sigma_x"]}))
    first, second = map(str, caught.value.problems)
    assert "the model brush-n needs fz (load)" in first
    assert "needs v (forward speed" in second and "--constant v=" in second


@pytest.mark.parametrize(
    ("text", "said"),
    [(None, "cannot read it"), ("1,", "not JSON"), ("[]", "schema"), ("{}", "schema")],
)
def test_files_that_are_no_fit_are_refused(tmp_path, text, said):
    path = tmp_path / "fit.json"
    if text is not None:
        path.write_text(text)
    with pytest.raises(DataError, match=said):
        load_fit(path)


FRICTION = {"dry": 1.0, "wet": 0.7}


@pytest.fixture(scope="module")
def two_runs():
    """One tire on two surfaces, 200 rows each, the friction per run."""
    parts = [
        curve(TRUTH | {"mu": mu}, n=200, seed=30 + i) for i, mu in enumerate(FRICTION.values())
    ]
    columns = {k: np.concatenate([p[k] for p in parts]) for k in parts[0].columns}
    return table(columns, "joint", np.repeat([0, 1], 200), tuple(FRICTION))


@pytest.fixture(scope="module")
def joint(two_runs):
    config = {
        "noise": {"fx": STD},
        "solver": "gauss-newton",
        "parameters": {"mu": {"per_run": True}},
    }
    return fit(two_runs, config=config)


def test_only_run_dependent_quantities_are_per_run(joint):
    runs = joint.table.runs
    peaks = {f"{q}[{run}]" for q in quantities("fx") if q != "C_x" for run in runs}
    assert set(joint.derived) == {"C_x", *peaks}
    stiffness = joint.least_squares["cpa2"].value
    np.testing.assert_allclose(joint.derived["C_x"].value, 2 * stiffness, rtol=1e-9)
    z = np.random.default_rng(0).multivariate_normal(joint.z, joint.covariance, 5000)
    of_draws = derived_from_draws(joint.problem, z, joint.derived)
    assert list(of_draws) == list(joint.derived)
    layout = joint.problem.layout
    for run in runs:
        mu = layout.labels.index(f"mu[{run}]")
        draws = constrain(z[:, mu], layout.elements[mu][1].spec)
        np.testing.assert_allclose(
            of_draws[f"F_max[{run}]"].ci95, FZ * np.quantile(draws, [0.025, 0.975]), rtol=1e-9
        )


def test_a_fit_per_run_survives_storing(joint, two_runs, tmp_path):
    joint.save(tmp_path)
    stored = load_fit(tmp_path / "fit.json")
    found, live = predict(stored, two_runs), predict(joint, two_runs)
    np.testing.assert_allclose(found["fx"], live["fx"], rtol=1e-12)
    wet = table({"sigma_x": np.array([0.3]), "fz": np.array([FZ])}, "x", runs=("wet",))
    expected = joint.least_squares["mu[wet]"].value * FZ
    np.testing.assert_allclose(predict(stored, wet)["fx"], expected, rtol=1e-9)


def test_unknown_run_is_refused(joint):
    with pytest.raises(DataError, match="no parameters for the runs new") as caught:
        predict(joint, NEW)
    assert "it knows dry, wet" in str(caught.value)


def test_a_tied_fit_with_other_bounds_survives_storing(tmp_path):
    """A tire whose ratio of kinetic to static friction depends on its friction."""
    parameters = {"m": {"tied": "mu", "factor": 0.8}, "cpa2": {"upper": 1e6}}
    data = curve(TRUTH | {"m": 0.8}, seed=40)
    tied = fit(data, "brush-m", config={"noise": {"fx": STD}, "parameters": parameters})
    tied.save(tmp_path)
    stored = predict(load_fit(tmp_path / "fit.json"), NEW)
    for name, values in predict(tied, NEW).items():
        np.testing.assert_allclose(stored[name], values, rtol=1e-12)


@pytest.mark.parametrize("ends", [("m", "mv"), ("z", "mu"), ("m", "m")])
def test_a_tie_to_what_is_not_free_is_refused(given, tmp_path, ends):
    given.save(tmp_path)
    path = tmp_path / "fit.json"
    content = json.loads(path.read_text())
    name, other = ends
    content["prediction"]["layout"]["ties"] = [{"name": name, "other": other, "factor": 0.8}]
    path.write_text(json.dumps(sealed(content)))
    with pytest.raises(DataError, match=f"{name} is tied to {other}: not a free parameter"):
        load_fit(path)
