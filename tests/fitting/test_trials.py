"""A model is advised only after it was fitted to the rows and predicts rows left out better."""

from pathlib import Path

import numpy as np
import pytest
from recipes import FZ, STD, TRUTH, brush_force, curve, table
from scipy.optimize import curve_fit

import tirefit
from tirefit.data.read import read
from tirefit.fitting.estimate import fit
from tirefit.fitting.problem.build import build
from tirefit.fitting.problem.config import parse_config
from tirefit.fitting.solve.multistart import solve_problem
from tirefit.fitting.verdict.trials import candidates, errors_left_out, tried

SAMPLE = Path(tirefit.__file__).parent / "samples" / "circles.csv"


def sliding(loss, seed=1, n=400):
    """Kinetic friction that falls by ``loss`` [s/m] times the sliding speed, at two speeds."""
    generator = np.random.default_rng(seed)
    v, slip = np.repeat([5.0, 25.0], n // 2), generator.uniform(0.002, 0.3, n)
    kinetic = 1 - loss * v * slip / (1 + slip)
    force = [brush_force(s, 5e4, 1.0, m=m)[0] for s, m in zip(slip[:, None], kinetic, strict=True)]
    fx = np.array(force) + STD * generator.normal(size=n)
    return table({"sigma_x": slip, "fx": fx, "fz": np.full(n, FZ), "v": v})


def test_a_better_model_is_advised_with_what_it_improves():
    result = fit(sliding(0.08), "brush")
    assert [trial.model for trial in result.trials] == ["brush-n", "brush-ln"]
    trial = result.trials[0]
    assert trial.better and trial.column == "v"
    before, after = trial.left_out
    (said,) = [one for one in result.warnings if "use " in one]
    assert f"use {trial.model}: fitted to these rows" in said
    assert f"from {before:.4g} to {after:.4g} N" in said
    # Who follows the advice has the noise as residual, and no further advice.
    followed = fit(sliding(0.08), trial.model)
    np.testing.assert_allclose([after, followed.statistics.rmse], STD, rtol=0.15)
    assert "not identified" not in followed.outcomes and not followed.trials


def test_friction_that_rises_with_ln_of_the_sliding_speed_is_advised_as_such():
    generator = np.random.default_rng(3)
    v, slip = np.repeat([0.5, 5.0], 200), generator.uniform(0.002, 0.6, 400)
    friction = 0.8 * (1 + 0.12 * np.log(v * slip / (1 + slip) + 0.02))
    force = [brush_force(s, 3e4, mu)[0] for s, mu in zip(slip[:, None], friction, strict=True)]
    fx = np.array(force) + STD * generator.normal(size=400)
    result = fit(table({"sigma_x": slip, "fx": fx, "fz": np.full(400, FZ), "v": v}), "brush")
    (said,) = [one for one in result.warnings if "use " in one]
    assert "use brush-ln: fitted to these rows" in said
    np.testing.assert_allclose(result.trials[-1].left_out[1], STD, rtol=0.15)


def test_errors_left_out_are_those_of_refits_by_scipy():
    data = curve(reach=1.2, n=160)
    config = parse_config({})
    task = build(data, "brush", config)
    errors = errors_left_out(solve_problem(task, config), task)["fx"]
    slip, force = np.asarray(data["sigma_x"]), np.asarray(data["fx"])
    for block in np.array_split(np.arange(160), 8):
        others = np.setdiff1d(np.arange(160), block)
        values, _ = curve_fit(
            lambda s, stiffness, mu: brush_force(s, 1e4 * stiffness, mu),
            slip[others],
            force[others],
            [4.0, 0.9],
        )
        expected = force[block] - brush_force(slip[block], 1e4 * values[0], values[1])
        np.testing.assert_allclose(errors[block], expected, atol=1e-2 * STD)


def test_a_model_that_only_follows_the_noise_is_not_advised():
    """Of 12 sets without the effect one in 20 is advised: 0 to 3 with probability 0.998."""
    config, advised = parse_config({"starts": 1}), 0
    for seed in range(12):
        data = sliding(0.0, seed=50 + seed, n=200)
        task = build(data, "brush", config)
        advised += any(
            one.better for one in tried(["v"], task, solve_problem(task, config), config)
        )
    assert advised <= 3


def test_the_sample_gets_no_advice_that_fails():
    """Friction over speed stops at its bound on these rows: brush-h was advised, and then
    advised itself."""
    result = fit(read(SAMPLE), "brush")
    said = " ".join(result.warnings)
    assert "how the force depends on the speed" in said and "use brush" not in said
    assert "brush-n was tried: n stops at its bound" in said
    followed = fit(read(SAMPLE), "brush-h")
    assert "h" in followed.statistics.at_bound and "use brush" not in " ".join(followed.warnings)


@pytest.mark.parametrize(
    ("name", "column", "models"),
    [
        ("brush", "v", ["brush-n", "brush-ln"]),
        ("brush-d", "v", ["brush-dn"]),
        ("brush-h", "v", []),
        ("brush-stribeck", "v", []),
        ("magic-formula", "v", []),
        ("brush", "fz", ["brush-load"]),
        ("brush-h", "fz", ["brush-load-h"]),
        ("brush-load", "fz", []),
        ("brush-load", "v", ["brush-load-n"]),
        ("brush", "gamma", []),
        ("brush-dns", "v_s", ["brush-dhs"]),
        ("brush-n", "v_s", ["brush-h"]),
    ],
)
def test_the_candidates_have_the_effect_and_are_never_the_model(name, column, models):
    assert candidates(name, column) == models


def test_only_a_bound_of_the_user_can_be_widened():
    """``parameters.mu.upper`` above 5 is refused, so nobody is told to widen it to that."""
    data = curve(reach=0.05, noise=4 * STD, seed=2)
    ours = fit(data, "brush", config={"parameters": {"mu": {"upper": 4.0}}})
    (said,) = [one for one in ours.warnings if one.startswith("mu is not identified")]
    assert said.endswith("stopped at the bound 4: widen the bound in parameters.mu")
    free = fit(data, "brush")
    (said,) = [one for one in free.warnings if one.startswith("mu is not identified")]
    assert said.endswith("stopped at the bound 5, that of the model")


def test_a_friction_law_without_friction_is_reported_with_the_law_that_was_tried():
    """n = 0.15 s/m at a sliding speed of 7 m/s takes more than the whole friction."""
    result = fit(sliding(0.19), "brush-n")
    (said,) = [one for one in result.warnings if "linear friction law" in one]
    (trial,) = [one for one in result.trials if one.column == "v_s"]
    assert trial.model == "brush-h"
    assert ("use brush-h" in said) == trial.better
    assert TRUTH["mu"] > 0
