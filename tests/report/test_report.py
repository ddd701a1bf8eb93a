"""The report room: arrays checked independently, texts, files, fragments."""

import re
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.figure import Figure

from tirefit.data.table import Source, TireData
from tirefit.diagnosis.summary.compare import compare
from tirefit.fitting.estimate import fit
from tirefit.fitting.predict import predict_forces
from tirefit.fitting.problem.layout import FreeParameter, Layout
from tirefit.fitting.result import Estimate, PosteriorSummary, Verdict
from tirefit.models import MODELS, TireInputs, forces
from tirefit.params import Spec, with_values
from tirefit.report import canvas
from tirefit.report.fit.curves import fit_curve
from tirefit.report.fit.figures import figure_of, save_figures
from tirefit.report.fit.posterior import profiles_of
from tirefit.report.fit.report import fit_fragment, fit_report, verdict_line
from tirefit.report.fit.residuals import scatters_of
from tirefit.report.model_tables import models_table
from tirefit.report.numbers import format_estimate, format_interval, format_number
from tirefit.report.page import data_fragment
from tirefit.results import InputProblem, Outcome, UsageError

TRUTH = {"cpa2": 5e4, "mu": 1.0, "m": 0.85}
LOADS = (2000.0, 4000.0)
NAME = 'sweep <b>$1 & "x".csv'


def synthetic(n: int = 120, noise: float = 30.0) -> TireData:
    """Two loads, two runs, in time order, one masked row."""
    generator = np.random.default_rng(5)
    slip = generator.uniform(0, 0.2, n)
    load = np.asarray(LOADS)[np.arange(n) % 2]
    model = with_values(MODELS["brush-m"], TRUTH)
    force = forces(model, TireInputs(sigma_x=slip, fz=load, v=20.0)).fx
    columns = {
        "sigma_x": slip,
        "fx": np.array(force) + noise * generator.standard_normal(n),
        "fz": load,
        "v": np.full(n, 20.0),
        "time": np.arange(n) * 0.1,
    }
    used = np.ones(n, bool)
    used[3] = False
    source = Source(
        path=f"data/{NAME}",
        columns={"fx": "Fx <N>"},
        assumptions=("speed 20 m/s: constant, given",),
        masked=(InputProblem("load is not finite", row=5),),
    )
    return TireData("sweep", columns, used, np.arange(n) % 2, ("first", "second"), source)


@pytest.fixture(scope="module")
def plain():
    return fit(synthetic(), "brush-m")


def with_chains(result, draws: np.ndarray):
    """The fit as if its posterior had these draws (ensembles, draws, p)."""
    labels = result.labels
    each = dict.fromkeys(labels, 1.0)
    summary = PosteriorSummary(
        "emcee", 7, len(draws), 32, 800, 100, {k: 4321.0 for k in labels},
        {k: 1.0012 for k in labels}, {k: 9.5 for k in labels}, 0.36, Outcome.CONVERGED,
    )  # fmt: skip
    low, high = np.quantile(draws.reshape(-1, len(labels)), [0.025, 0.975], axis=0)
    ends = {k: (float(low[i]), float(high[i])) for i, k in enumerate(each)}
    intervals = {**result.intervals, "posterior": ends}
    return replace(result, chains=draws, posterior=summary, intervals=intervals)


def gaussian_draws(result, count: int = 400) -> np.ndarray:
    generator = np.random.default_rng(2)
    values = np.array([result.least_squares[k].value for k in result.labels])
    std = np.array([result.least_squares[k].std for k in result.labels])
    return values + std * generator.standard_normal((4, count, len(values)))


@pytest.fixture(scope="module")
def sampled(plain):
    return with_chains(plain, gaussian_draws(plain))


def vague(result, label: str = "m"):
    """The same fit with one parameter that the data do not identify."""
    free = Estimate(0.4, None, "-", (0.0, 1.0), identified=False)
    sentences = ["m is not identified by these data", "a second sentence"]
    return replace(
        result,
        parameters={**result.parameters, label: free},
        least_squares={**result.least_squares, label: free},
        verdict=Verdict((Outcome.NOT_IDENTIFIED,), (*sentences,)),
    )


def renamed(result, size: int):
    """The fit as if it had this many parameters p0, p1, ... (only for figures)."""
    labels = tuple(f"p{i}" for i in range(size))
    spec = Spec(1.0, 0.0, 2.0, "N", "", "", "p", True, "linear")
    layout = Layout(tuple(FreeParameter(label, spec) for label in labels))
    one = Estimate(1.0, 0.1, "N", (0.8, 1.2))
    return replace(
        result,
        labels=labels,
        least_squares=dict.fromkeys(labels, one),
        parameters=dict.fromkeys(labels, one),
        problem=replace(result.problem, layout=layout),
    )


# Arrays


def test_the_curve_is_the_model_at_the_estimate(plain):
    curve = fit_curve(plain)
    values = {k: plain.least_squares[k].value for k in plain.labels}
    model = with_values(MODELS["brush-m"], values)
    assert [g.label for g in curve.groups] == ["$F_z$ = 2000 N", "$F_z$ = 4000 N"]
    for one, load in zip(curve.curves, LOADS, strict=True):
        inputs = TireInputs(sigma_x=one.slip, fz=load, v=20.0)
        np.testing.assert_allclose(one.force, forces(model, inputs).fx, rtol=1e-9)
        assert one.slip[0] == 0
        assert one.slip[-1] > plain.table.usable("sigma_x").max()


def test_the_points_are_the_used_rows(plain):
    groups = fit_curve(plain).groups
    used = plain.table.usable("fz") == 4000.0
    np.testing.assert_allclose(groups[1].force, plain.table.usable("fx")[used])
    np.testing.assert_allclose(groups[1].slip, plain.table.usable("sigma_x")[used])
    assert sum(len(group.slip) for group in groups) == plain.statistics.n == 119


def test_the_band_agrees_with_automatic_derivatives(plain):
    one = fit_curve(plain).curves[1]
    size = len(one.slip)
    inputs = TireInputs(sigma_x=one.slip, fz=4000.0, v=20.0)
    inputs = jax.tree.map(lambda value: jnp.broadcast_to(value, size), inputs)
    problem = plain.problem
    _, variance = predict_forces(
        problem.model, problem.layout, plain.z, plain.covariance, inputs, np.zeros(size, int)
    )
    half = (one.high - one.low) / 2
    dof = plain.statistics.dof
    quantile = 1.96 * (1 + (1.96**2 + 1) / (4 * dof))
    expected = quantile * np.sqrt(variance["fx"])
    np.testing.assert_allclose(half, expected, rtol=2e-3, atol=1e-3)
    scale = plain.noise["fx"]["median_std"]
    noise_half = (one.noise_high - one.noise_low) / 2
    np.testing.assert_allclose(noise_half, np.hypot(half, quantile * scale), rtol=2e-3)


def test_the_band_of_chains_contains_95_percent_of_the_draws(sampled):
    one = fit_curve(sampled).curves[1]
    draws = sampled.chains.reshape(-1, len(sampled.labels))[::4]
    at = 120

    def named(values):
        return dict(zip(sampled.labels, values, strict=True))

    def force(values):
        model = with_values(MODELS["brush-m"], named(values))
        return model(TireInputs(one.slip[at], 0.0, 4000.0, 20.0)).fx

    values = np.asarray(jax.vmap(force)(jnp.asarray(draws)))
    inside = np.mean((values > one.low[at]) & (values < one.high[at]))
    assert inside == pytest.approx(0.95, abs=0.03)


def test_residuals_are_standardised_and_have_their_inputs(plain):
    scatters = scatters_of(plain, "fx")
    labels = [panel.label for panel in scatters]
    assert [label.split(" [")[0] for label in labels] == [r"slip $\sigma_x$", "load $F_z$", "time"]
    values = {k: plain.least_squares[k].value for k in plain.labels}
    rows = plain.table
    inputs = TireInputs(sigma_x=rows.usable("sigma_x"), fz=rows.usable("fz"), v=rows.usable("v"))
    fitted = forces(with_values(MODELS["brush-m"], values), inputs).fx
    scale = plain.noise["fx"]["median_std"]
    expected = (rows.usable("fx") - np.asarray(fitted)) / scale
    np.testing.assert_allclose(scatters[0].residual, expected, rtol=1e-6)
    load = scatters[1]
    np.testing.assert_allclose(load.means.center, LOADS)
    np.testing.assert_allclose(
        load.means.mean, [expected[rows.usable("fz") == one].mean() for one in LOADS]
    )


def test_profile_and_parabola_cross_the_level_at_the_intervals(plain):
    for panel, label in zip(profiles_of(plain)[0], plain.labels, strict=True):
        low, high = plain.intervals["profile"][label]
        at = np.interp([low, high], panel.value, panel.deviance)
        np.testing.assert_allclose(at, panel.level, rtol=0.02)
        low, high = plain.intervals["covariance"][label]
        inside = (panel.value > low) & (panel.value < high)
        assert np.all(panel.parabola[inside] <= panel.level)
        assert np.all(panel.parabola[~inside] >= panel.level)


# Numbers and text


@pytest.mark.parametrize(
    ("value", "std", "text"),
    [
        (50340.97, 373.8, "50340 ± 370"),
        (0.217808, 0.017452, "0.218 ± 0.017"),
        (1.0, 0.0996, "1.00 ± 0.10"),
        (0.99934, 0.000824, "0.99934 ± 0.00082"),
        (-12.3456, 1.0, "-12.3 ± 1.0"),
        (123456789.0, 1234567.0, "(1.235 ± 0.012)e+08"),
        (3.21e-6, 4.4e-8, "(3.210 ± 0.044)e-06"),
        (1.5, None, "1.5"),
        (1.5, 0.0, "1.5"),
        (float("nan"), None, "-"),
        (50000.000000000007, 4.1e-11, "50000 ± 4.1e-11"),
        (0.9690351325, 2e-10, "0.9690351 ± 2e-10"),
    ],
)
def test_the_number_of_digits_follows_the_std(value, std, text):
    assert format_estimate(value, std) == text


def test_intervals_with_open_ends_are_written():
    assert format_interval((None, None)) == "-"
    assert format_interval((1.0, None)) == "[1, ..]"
    assert format_interval((0.18409, 0.25278), 0.0174) == "[0.184, 0.253]"
    assert format_interval((49999.9999999997, 50000.0000000003)) == "[50000, 50000]"
    assert format_interval((0.96903513, 0.96903514), 2e-9) == "[0.9690351, 0.9690351]"
    assert format_number(1e9) == "1e+09"


def test_the_report_has_every_number_and_begins_with_the_verdict(sampled):
    text = fit_report(sampled, full=True)
    lines = text.splitlines()
    assert max(map(len, lines)) <= 88
    assert "\x1b" not in text
    for label in sampled.labels:
        e = sampled.parameters[label]
        assert re.search(rf"{label} +{re.escape(format_estimate(e.value, e.std))}", text)
    title, verdict, *_ = lines
    assert title.startswith("tirefit ") and verdict.startswith("VERDICT: ")


def test_derived_quantities_are_explained(plain):
    text = fit_report(plain)
    c_x = plain.derived["C_x"]
    value = re.escape(format_estimate(c_x.value, c_x.std))
    assert re.search(rf"  C_x +{value} +N .*slope at zero slip\n", text)
    assert re.search(r"  slip_at_peak .*sigma_x at peak\n", text)
    open_ended = replace(c_x, std=None, ci95=(9e4, None), identified=False)
    nowhere = replace(plain.derived["slip_at_peak"], value=np.nan, identified=False)
    lateral = {"C_alpha": open_ended, "slip_at_peak": nowhere}
    text = fit_report(replace(plain, forces=("fy",), derived=lateral))
    assert re.search(r"  C_alpha +not identified .*\[90000, \.\.\]", text)
    assert re.search(r"  slip_at_peak +not defined .*tan\(alpha\) at peak", text)


def test_the_report_shows_parameters_that_are_not_identified(plain):
    text = fit_report(vague(plain))
    row = next(line for line in text.splitlines() if line.startswith("  m "))
    assert "not identified" in row and "[0, 1]" in row and "±" not in row
    first = text[text.index("VERDICT: ") : text.index("\n  rows ")]
    assert first.startswith("VERDICT: not identified: m is not identified by these data")
    assert first.endswith("- a second sentence")
    assert verdict_line(vague(plain)).count("second") == 0


def test_report_names_strong_correlations_and_bounds(plain):
    strong = np.eye(3)
    strong[0, 1] = strong[1, 0] = -0.97
    statistics = replace(plain.statistics, at_bound=("m",))
    text = fit_report(replace(plain, correlation=strong, statistics=statistics))
    assert "cpa2 and mu: -0.970" in text and "at its bound" in text


def test_model_tables_name_every_model_and_parameter():
    text = models_table(MODELS)
    assert all(re.search(rf"(^|\s){re.escape(name)}(\s|$)", text) for name in MODELS)
    assert max(map(len, text.splitlines())) <= 88


# Figures


def test_figures_are_drawn_on_given_axes(plain):
    axes = Figure().subplots()
    assert plain.plot(ax=axes) is axes.figure
    assert axes.get_xlabel() == r"slip $\sigma_x$ [-]"
    assert len(axes.lines) >= 4


def test_a_subset_with_the_farthest_of_many_points_is_drawn(plain, monkeypatch):
    values = np.random.default_rng(0).standard_normal(1000)
    values[[17, 600]] = -40, 70
    np.testing.assert_array_equal(canvas.drawn(values), np.arange(1000))
    monkeypatch.setattr(canvas, "MOST_DRAWN", 100)
    some = canvas.drawn(values)
    assert {17, 600} < set(some) and len(some) <= 100 + canvas._FARTHEST
    assert abs(values[some].mean()) < 1 and np.all(np.diff(some) > 0)
    # A group of a panel gets its share.
    assert len(canvas.drawn(values, among=4000)) <= 25 + canvas._FARTHEST
    picture = figure_of(plain, "residuals")
    said = [text.get_text() for text in picture.texts]
    expected = f"{plain.statistics.n} rows, 100 of them drawn"
    assert any(expected in text for text in said)
    points = picture.axes[0].lines[1].get_xdata()
    assert len(points) <= 100 + canvas._FARTHEST


@pytest.mark.parametrize("name", ["fit", "residuals", "profile", "trace"])
def test_figures_are_legible_on_a_phone(sampled, name):
    """Labels of axes have letters of 9 pixels and more at a width of 400."""
    picture = figure_of(sampled, name)
    pixels = 400 / picture.get_figwidth() / 72
    labels = (label for axes in picture.axes for label in (axes.xaxis.label, axes.yaxis.label))
    assert min(label.get_fontsize() for label in labels if label.get_text()) * pixels > 9


def test_every_figure_is_complete(sampled, tmp_path):
    written = save_figures(sampled, tmp_path / "new")
    names = {path.name for path in written}
    figures = ("fit", "residuals", "profile", "corner", "trace")
    assert names == {f"{name}.png" for name in figures}
    assert {path.name for path in (tmp_path / "new").iterdir()} == names
    # The posterior of another fit would be mistaken for one of this fit.
    names = {path.name for path in save_figures(replace(sampled, chains=None), tmp_path / "new")}
    assert names == {"fit.png", "residuals.png", "profile.png"}
    assert {path.name for path in (tmp_path / "new").iterdir()} == names


@pytest.mark.parametrize("size", [1, 2, 4])
def test_corner_and_trace_accept_any_size_and_a_constant_column(plain, size):
    draws = np.random.default_rng(1).normal(1.0, 0.1, (4, 50, size))
    draws[..., -1] = 1.0
    result = with_chains(renamed(plain, size), draws)
    figure_of(result, "corner").draw_without_rendering()
    assert len(figure_of(result, "trace").axes) == size


def test_contours_of_a_pair_enclose_their_shares(plain):
    draws = np.random.default_rng(1).normal(1.0, 0.1, (4, 5000, 2))
    draws[..., 1] += 0.5 * draws[..., 0]
    axes = figure_of(with_chains(renamed(plain, 2), draws), "corner").axes
    (pair,) = [one for one in axes if one.collections and one.get_ylabel()]
    (filled,) = pair.collections
    points = draws.reshape(-1, 2)
    outer, inner = (path.contains_points(points).mean() for path in filled.get_paths())
    assert outer == pytest.approx(0.95, abs=0.03) and inner == pytest.approx(0.5, abs=0.03)


def test_a_rare_part_far_away_does_not_stretch_the_corner(plain):
    draws = np.random.default_rng(1).normal(40.0, 2.0, (4, 5000, 2))
    draws[0, :400, 0] = 1e7
    axes = figure_of(with_chains(renamed(plain, 2), draws), "corner").axes[0]
    # Four standard deviations of 2 from the median, whose own shift is small.
    np.testing.assert_allclose(axes.get_xlim(), [32, 48], atol=1)


def test_figures_mark_parameters_that_are_not_identified(plain, sampled):
    labels = [axes.get_xlabel() for axes in vague(plain).plot("profile").axes]
    assert any("not identified" in label for label in labels)
    titles = [axes.get_title() for axes in vague(sampled).plot("corner").axes]
    assert "not identified" in titles


def test_a_dollar_in_a_run_name_is_not_mathematics(plain):
    runs = ("$1 a", "b$")
    table = replace(plain.table, runs=runs)
    layout = replace(plain.problem.layout, runs=runs)
    problem = replace(plain.problem, layout=layout)
    result = replace(plain, table=table, problem=problem)
    result.plot("fit").draw_without_rendering()


def test_the_title_names_model_file_and_verdict(plain):
    texts = [text.get_text() for text in plain.plot("residuals").texts]
    assert texts[0] == "brush-m fitted to " + NAME.replace("$", r"\$")
    assert texts[1].startswith("ok: RMSE")
    assert "braking positive, SI · seed 0" in texts[2]


# Fragments


def test_fit_fragment_is_escaped_and_self_contained(plain):
    text = fit_fragment(plain)
    assert "<b>$1" not in text and "&lt;b&gt;$1 &amp;" in text
    assert not re.search(r"https?://|<script|<link", text)
    assert all(f">{label}</td>" in text for label in plain.labels)


def test_data_fragment_is_escaped_and_has_ranges():
    text = data_fragment(synthetic())
    assert "Fx &lt;N&gt;" in text and "<b>$1" not in text
    assert "119 rows" in text and "1 more masked" in text
    assert ">2000</td>" in text and ">4000</td>" in text


def test_compare_orders_models_of_the_same_rows(plain):
    simple = fit(synthetic(), "brush")
    table = compare([simple, plain])
    assert [one.model for one in table.models] == ["brush-m", "brush"]
    assert f"{plain.statistics.aicc:.1f}" in str(table)
    difference = simple.statistics.aicc - plain.statistics.aicc
    assert f" {difference:.1f} " in str(table)
    least = min(one.bic for one in table.models)
    for one in table.models:
        off = re.escape(f"{one.bic - least:.1f}")
        assert re.search(rf"^  {one.model} .* {off} +\d+ ", str(table), re.M)
    assert "<table" in table._repr_html_()
    with pytest.raises(UsageError, match="nothing to compare"):
        compare([])


def test_compare_tells_fits_of_one_model_apart(plain):
    """Each with its own numbers."""
    other = replace(
        plain,
        parameters=plain.parameters | {"mu": replace(plain.parameters["mu"], value=0.5)},
        statistics=replace(plain.statistics, minus_two_log_likelihood=0.0),
    )
    text = compare([plain, other], ["wet", "dry"]).summary()
    assert re.search(r"^  brush-m \(wet\) +\d", text, re.M)
    assert re.search(r"brush-m \(dry\): .*mu = 0\.50", text)
