"""Fits with parameters per run: names, tables and figures of twenty parameters."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from pages import drawn_texts, overlapping

from tirefit.data.merged import merged
from tirefit.data.run_names import run_names
from tirefit.data.table import Source, TireData
from tirefit.fitting.estimate import fit
from tirefit.fitting.result import PosteriorSummary
from tirefit.fitting.store import record_of_fit
from tirefit.models import MODELS, TireInputs, forces
from tirefit.params import with_values
from tirefit.report.fit.figures import figure_of, run_points
from tirefit.report.fit.report import fit_fragment, fit_report
from tirefit.report.fit.tables import chain_rows, run_rows
from tirefit.report.many_files import summary_table
from tirefit.results import Outcome, UsageError

RUNS = tuple(f"drum_2026-03-12_cold_asphalt_run{i:02d}_brake" for i in range(1, 15))
ROWS = 25


def fourteen() -> TireData:
    """Fourteen files of one session, each with another friction."""
    generator = np.random.default_rng(4)
    run = np.repeat(np.arange(len(RUNS)), ROWS)
    slip = generator.uniform(0, 0.2, len(run))
    parts = [
        forces(
            with_values(MODELS["brush"], {"cpa2": 5e4, "mu": 0.7 + 0.02 * code}),
            TireInputs(sigma_x=slip[run == code], fz=4000.0, v=20.0),
        ).fx
        for code in range(len(RUNS))
    ]
    force = np.concatenate(parts) + 30 * generator.standard_normal(len(run))
    columns = {
        "sigma_x": slip,
        "fx": force,
        "fz": np.full(len(run), 4000.0),
        "v": np.full(len(run), 20.0),
    }
    said = {name: ["column 'fx' read as fx in N"] for name in RUNS}
    said[RUNS[2]].append("speed 20 m/s: constant, given")
    short = run_names(RUNS).short
    source = Source(
        path=", ".join(f"data/{name}.csv" for name in RUNS),
        assumptions=tuple(merged(zip(short, said.values(), strict=True))),
    )
    return TireData("joint", columns, np.ones(len(run), bool), run, RUNS, source)


@pytest.fixture(scope="module")
def by_run():
    """As if sampled: 28 parameters, each with draws about its estimate."""
    each = {"per_run": True}
    config = {"noise": {"fx": 30.0}, "parameters": {"mu": each, "cpa2": each}}
    result = fit(fourteen(), "brush", config=config)
    labels = result.labels
    values = np.array([result.least_squares[k].value for k in labels])
    std = np.array([result.least_squares[k].std for k in labels])
    generator = np.random.default_rng(2)
    draws = values + std * generator.standard_normal((4, 200, len(labels)))
    rhat = {k: 1.001 + 0.001 * i for i, k in enumerate(labels)}
    summary = PosteriorSummary(
        "emcee", 7, 4, 32, 800, 100, dict.fromkeys(labels, 900.0), rhat,
        dict.fromkeys(labels, 9.5), 0.36, Outcome.CONVERGED,
    )  # fmt: skip
    ends = result.intervals["covariance"]
    return replace(
        result, chains=draws, posterior=summary, intervals=result.intervals | {"posterior": ends}
    )


def test_misfit_and_bias_of_every_run_are_right(by_run):
    table, rows = by_run.table, run_rows(by_run)[1:]
    for code, (_, count, rmse, bias) in enumerate(rows):
        values = {name: by_run.parameters[f"{name}[{RUNS[code]}]"].value for name in ("cpa2", "mu")}
        here = table.run == code
        inputs = TireInputs(sigma_x=table["sigma_x"][here], fz=4000.0, v=20.0)
        off = table["fx"][here] - forces(with_values(MODELS["brush"], values), inputs).fx
        assert int(count) == len(off) == ROWS
        np.testing.assert_allclose(float(rmse), np.sqrt(np.mean(off**2)), rtol=0.005)
        np.testing.assert_allclose(float(bias), off.mean(), rtol=0.06)
    assert chain_rows(by_run)[4] == ["cpa2[run04]", "900", "1.0040", "9.5"]


@pytest.mark.long
def test_every_run_is_distinguished_in_the_report(by_run):
    text = fit_report(by_run, full=True)
    assert max(map(len, text.splitlines())) <= 88
    assert "fitted to fx of 14 files," in text
    assert "run01 ... run14 of drum_2026-03-12_cold_asphalt_*_brake" in text
    parameters = text.split("PARAMETERS")[1].split("INTERVALS")[0]
    names = re.findall(r"^  (mu\[.*?\])", parameters, re.M)
    assert names == [f"mu[run{i:02d}]" for i in range(1, 15)]
    assert text.count(f"  {names[3]} ") == 3  # values, routes, chains
    assert "run03: speed 20 m/s: constant, given" in text
    assert text.count("fx [N]") == 1
    assert "mu[run14]" in fit_fragment(by_run)
    # The record keeps the whole names, by which `predict` knows the runs.
    record = json.loads(by_run.to_json())
    assert f"mu[{RUNS[3]}]" in record["parameters"]
    assert f"F_max[{RUNS[3]}]" in record["derived"]


def test_a_summary_has_every_column_of_every_fit(by_run):
    content = by_run.to_dict()
    text = summary_table([record_of_fit(content, f"all/{run}") for run in RUNS[:3]])
    lines = text.splitlines()
    assert lines[1] == "SUMMARY of all/drum_2026-03-12_cold_asphalt_*_brake"
    assert max(map(len, lines)) <= 88
    rows = [line for line in lines if line.startswith("  run02 ")]
    assert sum(line.count("±") for line in rows) == 28
    assert rows[-1].split()[-1] == "ok"
    assert all(line.startswith(("  run0", "  file ", "  ---")) for line in lines[2:] if line)


def texts_of(picture):
    """Labels of the lowest axes, and titles."""
    return [axes.get_xlabel() for axes in picture.axes], [t.get_text() for t in picture.texts]


def test_a_corner_of_many_parameters_shows_ten_of_them(by_run):
    picture = figure_of(by_run, "corner")
    labels, titles = texts_of(picture)
    assert len(set(filter(None, labels))) == 10 and len(picture.axes) == 55
    assert any("10 of 28 parameters" in text for text in titles)
    width, height = picture.get_size_inches() * picture.dpi
    for text, box in drawn_texts(picture):
        assert box.x0 > 0 and box.y0 > 0 and box.x1 < width and box.y1 < height, text


def test_corner_and_trace_draw_the_requested_parameters(by_run):
    corner = by_run.plot("corner", parameters=["mu[run02]", f"mu[{RUNS[2]}]"])
    assert list(filter(None, texts_of(corner)[0])) == [r"$\mu$ (run02) [-]", r"$\mu$ (run03) [-]"]
    trace = by_run.plot("trace", parameters=["mu"])
    assert len(trace.axes) == 14
    # A line for each ensemble, in order.
    drawn = [line.get_ydata() for line in trace.axes[0].lines]
    np.testing.assert_array_equal(drawn, by_run.chains[..., 14])
    with pytest.raises(UsageError, match=r"no free parameter d, mu\[x\]") as caught:
        by_run.plot("corner", parameters=["mu", "d", "mu[x]"])
    assert "it has cpa2[run01]" in str(caught.value)


def test_runs_are_drawn_side_by_side(by_run):
    panels = run_points(by_run)
    assert [p.label for p in panels] == ["cpa2 [N]", "mu"]
    mu = panels[1]
    assert mu.names == [f"run{i:02d}" for i in range(1, 15)]
    expected = [by_run.parameters[f"mu[{run}]"] for run in RUNS]
    np.testing.assert_array_equal(mu.value, [one.value for one in expected])
    np.testing.assert_array_equal(np.stack([mu.low, mu.high], 1), [one.ci95 for one in expected])
    assert overlapping(drawn_texts(by_run.plot("runs"))) == []


def test_an_undetermined_run_does_not_set_the_scale(by_run):
    label = f"mu[{RUNS[5]}]"
    free = replace(
        by_run.parameters[label], value=2.9, std=None, ci95=(0.1, None), identified=False
    )
    result = replace(by_run, parameters=by_run.parameters | {label: free})
    axes = result.plot("runs").axes[1]
    assert axes.get_ylim()[1] < 1.2
    assert any("grey: not identified" in text.get_text() for text in axes.texts)


def test_one_run_has_no_comparison_figure(by_run):
    with pytest.raises(UsageError, match="no parameter for each run"):
        replace(by_run, labels=("cpa2", "mu")).plot("runs")
