"""Absurd rows are excluded and named, and no others; clean fits are unchanged."""

import json
from dataclasses import replace

import numpy as np
import pytest
from recipes import ESTIMATED, STD, TRUTH, brush_force, curve, table
from scipy.stats import binom

from tirefit.fitting.estimate import fit
from tirefit.fitting.problem.build import build
from tirefit.fitting.problem.config import parse_config
from tirefit.fitting.solve.far_rows import _judge, _scale, settle
from tirefit.fitting.solve.inference import half_width_95
from tirefit.fitting.solve.multistart import solve_problem
from tirefit.params import constrain
from tirefit.report.fit.report import fit_report

ROWS = [11, 120, 121, 240, 313, 399]
"""Of 400: three in two hundred."""

ABSURD = {
    "force 4e5 N": ("fx", lambda x: 0 * x + 4e5),
    "force without sign": ("fx", lambda x: -x),
    "force zero": ("fx", lambda x: 0 * x),
    "force in kN": ("fx", lambda x: x / 1000),
    "load 9e9 N": ("fz", lambda x: 0 * x + 9e9),
    "load in lb": ("fz", lambda x: x * 4.448),
    "load in kN": ("fz", lambda x: x / 1000),
    "slip of a locked wheel": ("sigma_x", lambda x: 0 * x + 3.0),
    "slip in percent": ("sigma_x", lambda x: x / 100),
    "slip without sign": ("sigma_x", lambda x: -x),
}


def spoilt(data, column, change, rows=ROWS):
    values = data[column].copy()
    values[rows] = change(values[rows])
    return replace(data, columns={**data.columns, column: values})


def settled(data, config=ESTIMATED, model="brush"):
    return settle(data, model, parse_config(config))


def squares(config=ESTIMATED):
    return config | {"noise": config.get("noise", {}) | {"loss": "squares"}}


def shift(one, other):
    """Distance of two estimates in standard deviations of the second, (p,)."""
    std = np.sqrt(np.diag(other.solved.covariance))
    return np.abs(one.solved.z - other.solved.z) / std


@pytest.fixture(scope="module")
def clean():
    return settled(curve(), squares())


@pytest.mark.parametrize("what", list(ABSURD))
def test_outliers_move_no_parameter_by_a_standard_error(clean, what):
    end = settled(spoilt(curve(), *ABSURD[what]))
    assert np.all(shift(end, clean) < 1)
    aside = {far.row for far in end.outliers if far.set_aside}
    assert aside <= set(ROWS)
    # The rows that are there still say as much as they did.
    width = np.sqrt(np.diag(end.solved.covariance) / np.diag(clean.solved.covariance))
    assert np.all(width < 1.05)
    assert end.solved.problem.n == end.task.data.n == 400 - len(aside)


def test_a_far_load_is_excluded_though_its_force_agrees():
    """At the smallest slip the force of a brush does not depend on the load."""
    data = curve()
    row = int(np.argmin(data["sigma_x"]))
    end = settled(spoilt(data, *ABSURD["load 9e9 N"], [row]))
    assert [far.row for far in end.outliers if far.set_aside] == [row]


def test_with_squares_an_outlier_moves_the_fit(clean):
    column, change = ABSURD["load 9e9 N"]
    end = settled(spoilt(curve(), column, change, [11]), squares())
    assert np.max(shift(end, clean)) > 50
    (far,) = end.outliers
    assert (far.row, far.column, far.set_aside) == (11, "fz", False)


@pytest.mark.parametrize("seed", range(5))
def test_clean_data_give_the_same_bits_as_plain_squares(seed):
    data = curve(seed=seed)
    end, all_squares = settled(data), settled(data, squares())
    assert end.outliers == ()
    np.testing.assert_array_equal(end.solved.z, all_squares.solved.z)
    np.testing.assert_array_equal(end.solved.covariance, all_squares.solved.covariance)


def test_intervals_cover_despite_outliers():
    inside, sets = np.zeros(2), 30
    for seed in range(sets):
        data = curve(n=120, seed=seed)
        for (column, change), row in zip(ABSURD.values(), (3, 50, 88), strict=False):
            data = spoilt(data, column, change, [row])
        solved = settled(data).solved
        elements = solved.problem.layout.elements
        dof = solved.n_effective - len(elements)
        half = half_width_95(True, dof) * np.sqrt(np.diag(solved.covariance))
        low, high = (
            [float(constrain(end, p.spec)) for end, (_, p) in zip(z, elements, strict=True)]
            for z in (solved.z - half, solved.z + half)
        )
        truth = np.array([TRUTH[name] for name, _ in elements])
        inside += (low <= truth) & (truth <= high)
    least, most = binom.ppf([0.0005, 0.9995], sets, 0.95)
    assert np.all((least <= inside) & (inside <= most))


def test_consecutive_rows_off_the_curve_are_kept():
    # From 0.9 of full sliding on a quarter of the friction is lost: 30 of 400 rows.
    data = curve(reach=1.0, noise=10.0)
    beyond = np.argsort(data["sigma_x"])[-30:]
    end = settled(spoilt(data, "fx", lambda x: 0.75 * x, beyond))
    assert not any(far.set_aside for far in end.outliers)


def test_a_run_on_another_floor_is_kept():
    data = curve(n=400)
    run = (np.arange(400) >= 375).astype(int)
    wet = replace(data, run=run, runs=("dry", "wet"))
    assert not settled(spoilt(wet, "fx", lambda x: 0.5 * x, run == 1)).outliers


def test_load_dependent_noise_and_heavy_tails_are_kept():
    generator = np.random.default_rng(3)
    slip, load = generator.uniform(0, 0.2, 400), np.repeat([1e3, 2e3, 4e3, 8e3], 100)
    force = brush_force(slip, TRUTH["cpa2"], TRUTH["mu"], fz=load)
    noise = 0.02 * load * generator.standard_normal(400)
    assert not settled(table({"sigma_x": slip, "fx": force + noise, "fz": load})).outliers
    exact = table({"sigma_x": slip, "fx": np.round(force, 1), "fz": load})
    assert not settled(exact).outliers


def test_a_row_that_alone_determines_a_parameter_is_kept():
    # One locked wheel among small slips: the friction is known from it alone.
    data = curve(reach=0.2, n=400)
    data = spoilt(data, "sigma_x", lambda x: 0 * x + 3.0, [7])
    end = settled(spoilt(data, "fx", lambda x: 0 * x + 4000.0, [7]))
    assert end.solved.problem.n == 400
    (far,) = end.outliers
    assert (far.row, far.set_aside) == (7, False)
    assert far.remedy == "check the row"


def test_a_row_is_compared_with_what_the_others_predict():
    """Each row left out in turn; its distance counts the error of what the others predict."""
    data, std = curve(n=12, reach=0.8, seed=2), 1.5 * STD
    config = parse_config({"noise": {"fx": std, "effective_samples": "all"}, "starts": 1})
    whole = build(data, "brush", config)
    every = _judge(whole, whole, solve_problem(whole, config), np.ones(12, bool), 5.0)
    shares = []
    for i, distance in enumerate(every.distance[0]):
        others = build(data.where(np.arange(12) != i), "brush", config)
        end = solve_problem(others, config)

        def force(z, i=i, layout=others.problem.layout):
            return brush_force(data["sigma_x"][[i]], **layout.natural(z))[0]

        steps = 1e-4 * np.eye(2)
        slope = [(force(end.z + step) - force(end.z - step)) / 2e-4 for step in steps]
        shares.append(slope @ end.covariance @ slope / std**2)
        off = abs(data["fx"][i] - force(end.z)) / std / np.sqrt(1 + shares[-1])
        assert distance == pytest.approx(off, rel=0.05, abs=0.02)
    assert max(shares) > 0.5


def test_scale_is_that_of_normal_noise_whatever_a_tenth_of_the_rows_says():
    off = np.abs(np.random.default_rng(0).standard_normal(100_000))
    assert _scale(off) == pytest.approx(1.0, rel=0.01)
    assert _scale(np.where(off > np.quantile(off, 0.9), 1e6, off)) == pytest.approx(_scale(off))


def test_too_many_outliers_are_kept_and_reported():
    generator = np.random.default_rng(0)
    noise = STD * generator.standard_normal(400)
    noise[::8] *= 60
    data = curve(noise=0.0)
    end = settled(replace(data, columns=data.columns | {"fx": data["fx"] + noise}))
    assert end.solved.problem.n == 400
    assert "too many to exclude" in end.note


def test_noisy_slips_and_given_noise_exclude_the_same_rows():
    # As many rows as the data sets of test_coverage have, which share the program.
    data = curve(n=120, slip_std=0.001)
    for row, what in ((11, "force without sign"), (60, "load 9e9 N")):
        data = spoilt(data, *ABSURD[what], [row])
    for noise in ({"sigma_x": 0.001, "fx": STD}, {"fx": 60.0}):
        end = settled(data, ESTIMATED | {"noise": noise})
        assert [far.row for far in end.outliers if far.set_aside] == [11, 60]


def test_outliers_are_named_in_every_output():
    data = curve()
    data = spoilt(spoilt(data, *ABSURD["force 4e5 N"], [11]), "fx", np.negative, [240])
    result = fit(data, config=ESTIMATED)
    assert [far.row for far in result.far_rows] == [11, 240]
    content = json.loads(result.to_json())
    assert content["data"]["used"] == 398 and content["data"]["set_aside"] == 2
    first = content["far_rows"][0]
    assert (first["row"], first["column"], first["value"]) == (11, "fx", 4e5)
    assert abs(first["predicted"]) < 4200 and first["distance"] > 1000
    assert "far from all other rows" in first["reason"]
    assert "noise.loss = 'squares'" in first["remedy"]
    (said,) = (text for text in result.warnings if "as outliers" in text)
    assert "2 of 400 rows" in said and "row 11, row 240" in said
    text = " ".join(fit_report(result, full=True).split())
    assert "398 used of 400 (2 excluded as outliers)" in text
    assert "excluded: r, row 11, column 'fx': 400000 N is far from" in text
    assert "normal; rows further than 5.2 standard deviations" in text
