"""The verdict of a fit, its noise, and unsuitable data."""

from dataclasses import replace

import numpy as np
import pytest
from recipes import (
    ESTIMATED,
    FULL_SLIDING,
    FZ,
    GIVEN,
    STD,
    TRUTH,
    brush_force,
    curve,
    solved,
    table,
)
from scipy import optimize

from tirefit.data.read import read_frame
from tirefit.fitting.estimate import fit
from tirefit.fitting.problem.build import build
from tirefit.fitting.problem.config import parse_config
from tirefit.fitting.verdict.judge import disagreements, judge, models_with
from tirefit.report.fit.report import fit_report
from tirefit.results import DataError, Outcome, UsageError


def test_noise_given_ten_times_too_small_is_a_poor_fit(given):
    result = fit(curve(), config=GIVEN | {"noise": {"fx": STD / 10}})
    assert result.status == "poor fit"
    assert Outcome.POOR_FIT in result.outcomes
    np.testing.assert_allclose(result.statistics.chi2_dof, 100, rtol=0.25)
    for label in ("cpa2", "mu"):
        # Widened to what the residuals show, not a tenth of it.
        ratio = result.least_squares[label].std / given.least_squares[label].std
        np.testing.assert_allclose(ratio, 1.0, rtol=0.1)


def test_a_good_fit_gives_no_warning(given, estimated):
    for result in (given, estimated):
        assert result.status == "ok" and result.warnings == ()
        assert result.verdict.disagreements == {}
        assert result.outcomes == ()
    assert 0.8 < given.statistics.chi2_dof < 1.2
    assert estimated.statistics.chi2_dof is None


@pytest.mark.parametrize("factor", [1.0, 1.5])
def test_a_slip_that_contradicts_the_speeds_is_the_verdict(factor):
    """However well the model fits: the slip of the file is not that of the wheel."""
    table = curve(seed=4)
    sigma, v = table["sigma_x"], np.full(len(table), 15.0)
    columns = dict(table.columns) | {"v": v, "omega": v / (1 + sigma) / 0.3}
    columns["sigma_x"] = factor * sigma
    columns["fx"] = table["fx"]
    data = read_frame(columns, convention="braking", rolling_radius=0.3)
    result = fit(data, "brush-d", config=GIVEN)
    report = " ".join(fit_report(result).split())
    if factor == 1:
        assert result.status == "ok" and "contradict" not in report
        assert result.to_dict()["data"]["slip_check"]["contradicts"] is False
        return
    assert result.status == "doubtful slip"
    assert result.to_dict()["outcomes"] == ["slip_contradicted"]
    assert "VERDICT: doubtful slip: the slip contradicts (v - omega R)" in report
    assert "it agrees if divided by 1.5" in report
    assert "doubtful slip" in result._repr_html_()


def test_estimate_at_its_bound_has_a_one_sided_interval():
    # No kinetic drop in the data: m sits at its upper bound 1.
    data = curve(seed=21)
    result = fit(data, "brush-m", config=GIVEN)
    m = result.least_squares["m"]
    assert result.statistics.at_bound == ("m",)
    assert m.std is None and m.identified
    assert m.ci95[1] == 1.0

    def least(held):
        """Smallest sum of squares over stiffness and friction, by brute force."""

        def squares(u):
            force = brush_force(data["sigma_x"], 5e4 * u[0], u[1], m=held)
            return np.sum((data["fx"] - force) ** 2) / STD**2

        return optimize.minimize(squares, [1.0, 1 / held], method="Nelder-Mead").fun

    # The lower end is where the sum of squares has risen by 3.84.
    np.testing.assert_allclose(least(m.ci95[0]) - least(1.0), 3.841, rtol=0.02)
    assert result.status == "at a bound"
    assert "the interval of m is one-sided" in " ".join(result.warnings)


def test_bounds_away_from_the_first_guess_do_not_trap_the_fit():
    # The largest force is 0.6 of mu F_z here, so the first guess of mu is below 0.95.
    data = curve(reach=0.5)
    end = solved(data, GIVEN | {"parameters": {"mu": {"lower": 0.95, "upper": 1.2}}})
    mu = float(end.problem.layout.natural(end.z)["mu"])
    free = solved(data, GIVEN)
    best = float(free.problem.layout.natural(free.z)["mu"])
    assert 0.96 < best < 1.1
    np.testing.assert_allclose(mu, best, rtol=1e-4)


def test_routes_that_differ_are_named(given):
    moved = {k: (lo, hi + 0.4 * (hi - lo)) for k, (lo, hi) in given.intervals["profile"].items()}
    result = replace(given, intervals=given.intervals | {"covariance": moved})
    assert set(disagreements(result)) == {"cpa2", "mu"}
    sentences = judge(result).warnings
    assert any("disagree for cpa2, mu" in s for s in sentences)
    assert judge(given).verdict.disagreements == {}


def test_a_wrong_model_is_found_in_the_residuals():
    slip = np.sort(curve()["sigma_x"])
    force = 3500 * np.sin(np.pi * slip / slip.max()) ** 2
    noise = STD * np.random.default_rng(1).standard_normal(400)
    data = table({"sigma_x": slip, "fx": force + noise, "fz": np.full(400, FZ)})
    result = fit(data, config=GIVEN)
    assert result.status == "poor fit"
    assert any("curve misses systematically" in s for s in result.warnings)


@pytest.mark.parametrize(
    ("config", "width"),
    [(ESTIMATED, "are at rounding level"), (GIVEN, "follow from the given noise")],
)
def test_data_without_noise_are_called_exact(config, width):
    result = fit(curve(noise=0.0), config=config)
    assert result.status == "ok" and result.outcomes == ()
    (said,) = result.warnings
    assert said.startswith("the data are exact for this model") and width in said
    assert result.statistics.rmse < 1e-9 * FZ and not result.solved.ambiguous
    for label, truth in TRUTH.items():
        assert result.least_squares[label].identified
        np.testing.assert_allclose(result.least_squares[label].value, truth, rtol=1e-9)
    slip = result.derived["slip_at_peak"]
    assert slip.identified
    np.testing.assert_allclose(slip.value, FULL_SLIDING, rtol=1e-7)


def test_a_relative_noise_of_a_millionth_is_estimated():
    result = fit(curve(noise=1e-6 * FZ), config=ESTIMATED)
    assert result.warnings == () and result.status == "ok"


def noisy(stds, seed=50):
    slip = curve(seed=seed)["sigma_x"]
    noise = stds * np.random.default_rng(seed).standard_normal(400)
    return {"sigma_x": slip, "fx": brush_force(slip, **TRUTH) + noise, "fz": np.full(400, FZ)}


def test_std_column_weights_the_rows():
    stds = np.where(np.arange(400) % 2, 4.0, 400.0)
    columns = noisy(stds)
    data = table(columns | {"fx_std": stds})
    weighted = solved(data, {"solver": "gauss-newton"})
    precise = {k: v[1::2] for k, v in columns.items()}
    alone = solved(table(precise), {"noise": {"fx": 4.0}, "solver": "gauss-newton"})
    np.testing.assert_allclose(weighted.z, alone.z, atol=1e-4)
    notes = build(data, "brush", parse_config({})).notes
    assert "noise of fx: column fx_std" in notes
    np.testing.assert_allclose(np.asarray(weighted.problem.rows.scale["fx"])[:400], stds)


def test_noise_proportional_to_load_is_fitted():
    generator = np.random.default_rng(60)
    load = generator.choice([1000.0, 4000.0, 8000.0], 400)
    slip = generator.uniform(0, 0.3, 400)
    force = brush_force(slip, **TRUTH, fz=load)
    force = force + 0.01 * load * generator.standard_normal(400)
    data = table({"sigma_x": slip, "fx": force, "fz": load})
    config = {"noise": {"proportional_to_load": True}, "solver": "gauss-newton"}
    end = solved(data, config)
    scale = np.asarray(end.problem.rows.scale["fx"])[:400]
    np.testing.assert_allclose(scale, 0.01 * load, rtol=4 / np.sqrt(800))
    given = solved(data, {"noise": {"fx_relative": 0.01}, "solver": "gauss-newton"})
    np.testing.assert_allclose(np.asarray(given.problem.rows.scale["fx"])[:400], 0.01 * load)
    np.testing.assert_allclose(end.z, given.z, atol=1e-6)


def test_as_many_unknowns_as_rows_are_refused():
    said = r"3 measured values for 3 unknowns \(cpa2, mu and the noise level\)"
    with pytest.raises(DataError, match=said):
        build(curve(n=3), "brush", parse_config({}))
    assert build(curve(n=4), "brush", parse_config({})).problem.unknowns == 3
    given = build(curve(n=3), "brush", parse_config({"noise": {"fx": 1.0}}))
    assert given.problem.unknowns == 2


@pytest.mark.parametrize(
    ("columns", "model", "config", "said"),
    [
        ({}, "brush-n", {}, "the model brush-n needs v (forward speed"),
        ({}, "brush", {"force": "fy"}, "a fit of fy needs alpha"),
        ({"sigma_x": np.full(400, 0.1)}, "brush", {}, "no force with a slip that varies"),
    ],
    ids=["speed", "force", "constant slip"],
)
def test_data_that_cannot_be_fitted_are_refused(columns, model, config, said):
    data = curve(extra=columns)
    with pytest.raises(DataError) as caught:
        build(data, model, parse_config(config))
    assert said in str(caught.value)
    assert "remedy: " in str(caught.value)


@pytest.mark.parametrize(
    ("model", "asked", "missing"),
    [("magic-formula", ["fy", "mz"], "no mz"), ("carcass-beam", ["fx", "fy"], "no fx")],
)
def test_a_force_that_the_model_lacks_is_refused(model, asked, missing):
    slip = curve()["sigma_x"]
    data = curve(extra={"alpha": slip, "mz": slip, "fy": slip})
    with pytest.raises(UsageError, match=missing):
        build(data, model, parse_config({"force": asked}))


@pytest.mark.parametrize("factor", [2.0, 1000.0])
@pytest.mark.parametrize("column", [False, True])
def test_a_stated_noise_far_above_the_scatter_is_the_verdict(factor, column):
    extra = {"fx_std": np.full(400, factor * STD)} if column else {}
    config = ESTIMATED if column else GIVEN | {"noise": {"fx": factor * STD}}
    result = fit(curve(extra=extra), config=config)
    assert result.status == "overstated noise"
    assert result.noise["fx"]["median_std"] == pytest.approx(factor * STD)
    assert f"({factor * STD:.3g} N" in result.warnings[0]
    # The residuals of 400 rows give their scatter within 3.5 standard errors.
    said = float(result.warnings[0].split(" times the stated noise")[0].split()[-1])
    assert said == pytest.approx(1 / factor, rel=3.5 / np.sqrt(800))


@pytest.mark.parametrize("factor", [0.8, 1.25])
def test_a_stated_noise_somewhat_off_is_reported_beside_the_verdict(factor):
    """400 residuals give their scatter to 3.5 %: 20 % is 5 standard errors, and no failure."""
    result = fit(curve(), config=GIVEN | {"noise": {"fx": factor * STD}})
    assert result.status == "ok"
    assert any("times the stated noise" in text for text in result.warnings)


def test_a_stated_noise_that_is_right_is_rarely_doubted():
    """The test has a level of 0.1 % to each side."""
    found = [fit(curve(seed=seed, n=60), config=GIVEN) for seed in range(20)]
    assert not any("stated noise" in text for result in found for text in result.warnings)


def test_only_a_bound_of_the_user_can_be_widened():
    """``parameters.mu.upper`` above 5 is refused, so nobody is told to widen it to that."""
    data = curve(reach=0.05, noise=4 * STD, seed=2)
    ours = fit(data, "brush", config={"parameters": {"mu": {"upper": 4.0}}})
    (said,) = [one for one in ours.warnings if one.startswith("mu is not identified")]
    assert said.endswith("stopped at the bound 4: widen the bound in parameters.mu")
    free = fit(data, "brush")
    (said,) = [one for one in free.warnings if one.startswith("mu is not identified")]
    assert said.endswith("stopped at the bound 5, that of the model")


@pytest.mark.parametrize(
    ("name", "column", "models"),
    [
        ("brush", "v", ["brush-n", "brush-ln"]),
        ("brush-d", "v", ["brush-dn"]),
        ("brush-h", "v", []),
        ("magic-formula", "v", []),
        ("brush", "fz", ["brush-load", "mf61"]),
        ("brush-load", "fz", ["mf61"]),
        ("brush", "gamma", ["mf61"]),
    ],
)
def test_the_models_with_an_effect_have_it_and_are_never_the_model(name, column, models):
    assert models_with(name, column) == models
