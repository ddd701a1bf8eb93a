"""Cells of similar rows compared with the rows, and posteriors by both."""

import dataclasses

import numpy as np
import pytest
from recipes import ESTIMATED, GIVEN, STD, curve, table
from recipes import solved as least_squares

from tirefit.fitting.solve import condense
from tirefit.fitting.solve.condense import cells_of, condensed
from tirefit.fitting.solve.inference import deviance
from tirefit.fitting.uncertainty import posterior
from tirefit.fitting.uncertainty.posterior import sample
from tirefit.models import MODELS

MOST = 512
"""Rows that 400 are padded to: cells of as many need no program of their own."""


def around(solved, count=24, reach=1.5, seed=3):
    """z (count, p) scattered about the estimate by its covariance, and wider."""
    generator = np.random.default_rng(seed)
    root = np.linalg.cholesky(solved.covariance)
    return solved.z + reach * generator.normal(size=(count, len(solved.z))) @ root.T


def rises(problem, solved, points):
    base = deviance(problem, solved.z)
    return np.array([deviance(problem, z) - base for z in points])


def correlated(n=400):
    """Noise correlated over about fifteen rows, with an oscillating slip."""
    generator, noise = np.random.default_rng(5), np.zeros(n)
    for i in range(1, n):
        noise[i] = 0.93 * noise[i - 1] + 0.37 * generator.standard_normal()
    data, time = curve(noise=0.0, n=n), np.arange(n) / 100
    order = np.argsort(data["sigma_x"])
    order = np.concatenate([order[::2], order[1::2][::-1]])
    columns = {name: values[order] for name, values in data.columns.items()}
    return table(columns | {"fx": columns["fx"] + STD * noise, "time": time})


def two_runs():
    data = curve()
    return table(dict(data.columns), run=np.arange(400) % 2, runs=("dry", "wet"))


CASES = {
    "noise given": (curve, GIVEN),
    "noise in a column": (
        lambda: curve(extra={"fx_std": STD * np.linspace(0.5, 2, 400)}),
        ESTIMATED,
    ),
    "correlated noise": (correlated, ESTIMATED),
    "a parameter for each run": (two_runs, GIVEN | {"parameters": {"mu": {"per_run": True}}}),
    "a robust loss": (curve, {"noise": {"fx": STD, "loss": "huber"}}),
    "noisy slip": (lambda: curve(slip_std=2e-3), {"noise": {"fx": STD, "sigma_x": 2e-3}}),
}


@pytest.mark.parametrize("case", CASES)
def test_cells_follow_the_slope_of_their_rows(case):
    make, config = CASES[case]
    solved = least_squares(make(), config)
    ends = around(solved, 6, 2.5)
    cells = cells_of(solved, ends, MOST, 1e-3)
    points = around(solved)
    expected = rises(solved.problem, solved, points)
    assert expected.max() > 5
    error = rises(cells, solved, points) - expected
    assert np.std(error) / 2 < posterior._ALIKE
    assert np.all(np.abs(error) < 0.02 * np.maximum(expected, 2))
    # At the estimate both are the same number.
    assert deviance(cells, solved.z) == pytest.approx(
        float(deviance(solved.problem, solved.z)), abs=1e-6
    )
    squares = case not in ("a robust loss", "noisy slip")
    assert cells.n < (200 if squares else 400)


def test_cells_of_repeated_rows_lose_nothing():
    data = curve()
    slip = np.round(data["sigma_x"], 2)
    repeated = table(dict(data.columns) | {"sigma_x": slip})
    solved = least_squares(repeated, GIVEN)
    cells = cells_of(solved, around(solved, 12, 6), MOST, 0.0)
    # Those beyond full sliding have one force, whatever their slip.
    assert cells.n <= len(np.unique(slip)) < 40
    points = around(solved, reach=3)
    expected = rises(solved.problem, solved, points)
    np.testing.assert_allclose(rises(cells, solved, points), expected, rtol=1e-6)


def test_no_cell_contains_rows_of_two_runs():
    make, config = CASES["a parameter for each run"]
    solved = least_squares(make(), config)
    cells = cells_of(solved, around(solved, 6), MOST, 0.2)
    weight = np.asarray(cells.rows.weight) ** 2
    run = np.asarray(cells.rows.run)
    assert [weight[run == code].sum() for code in (0, 1)] == pytest.approx([200, 200])


@pytest.fixture
def small_files_too(monkeypatch):
    monkeypatch.setattr(condense, "FEWEST", 100)
    monkeypatch.setattr(condense, "_TRIES", ((MOST, 1e-3),))


@pytest.mark.long
def test_the_posterior_by_cells_agrees_with_the_rows(given, sampled, small_files_too):
    cells = sample(given, sampler="importance", effective_samples=4000)
    assert "400 rows as" in cells.posterior.note
    assert "cells of like rows" in cells.posterior.note
    ess = min(sampled.posterior.ess.values())
    rows, draws = (r.walkers.reshape(-1, 2) for r in (sampled, cells))
    std = np.std(rows, axis=0)
    apart = np.abs(rows.mean(axis=0) - draws.mean(axis=0)) / std
    assert np.all(apart < 4 * np.sqrt(1 / ess))
    for share in (0.025, 0.975):
        one, other = (np.quantile(d, share, axis=0) for d in (rows, draws))
        # The end of a 95 % interval is known to 2.7 / sqrt(ess) standard deviations.
        assert np.all(np.abs(one - other) / std < 4 * 2.7 / np.sqrt(ess))


def test_inaccurate_cells_are_replaced_by_the_rows(given, chunk, monkeypatch):
    problem = given.solved.problem
    observed = {"fx": np.asarray(problem.rows.observed["fx"]) * 1.01}
    wrong = problem.with_rows(observed=observed).with_rules(problem.rules)
    # Of the cells importance sampling is refused, and a short chain drawn.
    settings = {"sampler": "importance", "effective_samples": 500, "max_steps": chunk}
    by_rows = sample(given, **settings, walkers=16)
    monkeypatch.setattr(posterior, "condensed", lambda *_: wrong)
    result = sample(given, **settings, walkers=16)
    assert "cells" not in result.posterior.note
    np.testing.assert_array_equal(result.walkers, by_rows.walkers)


def test_few_rows_and_time_series_are_not_condensed(given, small_files_too, monkeypatch):
    solved, root = given.solved, np.eye(2)
    transient = next(model for model in MODELS.values() if model.transient)
    series = dataclasses.replace(solved.problem, model=transient)
    assert condensed(solved._replace(problem=series), root) is None
    monkeypatch.setattr(condense, "FEWEST", 401)
    assert condensed(solved, root) is None
