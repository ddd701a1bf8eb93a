"""A model is advised only after it was fitted to the rows and has a lower AICc."""

from pathlib import Path

import numpy as np
import pytest
from recipes import FZ, STD, brush_force, table
from scipy.optimize import minimize

import tirefit
from tirefit.data.read import read
from tirefit.fitting.estimate import fit

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
    data = sliding(0.08)
    result = fit(data, "brush", config={"noise": {"effective_samples": "all"}})
    assert [trial.model for trial in result.trials] == ["brush-n", "brush-ln"]
    best = min(result.trials, key=lambda trial: trial.aicc[1])
    assert best.better and best.column == "v"
    before, after = best.aicc
    (said,) = [one for one in result.warnings if "use " in one]
    assert f"use {best.model}: fitted to these rows, it lowers AICc by {before - after:.3g}" in said
    assert result.to_dict()["trials"][0]["model"] == "brush-n"

    # The plain brush, all rows independent: AICc of its best fit by brute force.
    def squares(x):
        return np.sum((data["fx"] - brush_force(data["sigma_x"], 1e4 * x[0], x[1])) ** 2)

    least = minimize(squares, [4.0, 0.9], method="Nelder-Mead", tol=1e-9).fun
    deviance = 400 * np.log(2 * np.pi * least / 398) + 398
    assert before == pytest.approx(deviance + 6 + 24 / 396, abs=0.1)
    # Who follows the advice has the noise as residual, and no further advice.
    followed = fit(data, best.model)
    np.testing.assert_allclose(followed.statistics.rmse, STD, rtol=0.15)
    assert not followed.trials


def test_a_model_at_its_bound_or_hardly_better_is_not_advised():
    """The friction of the sample depends on the speed by more than brush-n allows, and its few
    independent rows do not tell a logarithmic law from none."""
    result = fit(read(SAMPLE), "brush")
    linear, logarithmic = result.trials
    assert linear.model == "brush-n" and linear.against == "n stops at its bound"
    before, after = logarithmic.aicc
    assert 0 < before - after < 6 and not logarithmic.better
    said = f"brush-ln was tried: it lowers AICc by only {before - after:.3g}, too little to tell"
    assert said in " ".join(result.warnings) and "use brush-ln" not in " ".join(result.warnings)
