"""A misfit that depends on a setting is not noise, but correlated noise is."""

from functools import cache

import numpy as np
import pytest
from recipes import brush_force, solved, table
from scipy.signal import lfilter

from tirefit.fitting.estimate import fit
from tirefit.fitting.solve.inference import deviance, minima

LOADS = (1500.0, 3000.0, 4500.0, 6000.0, 7500.0)
SLIP = np.linspace(-0.2, 0.2, 60)


def over_settings(column, values, force, noise=0.006):
    """One sweep at each value of a column; ``force`` of (alpha, value, load)."""
    generator, parts = np.random.default_rng(3), []
    for value in values:
        fz = value if column == "fz" else 4000.0
        fy = force(SLIP, value) + noise * fz * generator.standard_normal(len(SLIP))
        both = {"alpha": SLIP, "fy": fy, "fz": fz, column: value}
        parts.append(np.array([np.broadcast_to(v, SLIP.shape) for v in both.values()]))
    return table(dict(zip(both, np.concatenate(parts, axis=1), strict=True)))


def kinetic(alpha, mu, cpa2=6e4, fz=4000.0):
    slip = np.tan(alpha)
    return np.sign(slip) * np.abs(brush_force(slip, cpa2, mu, fz=fz))


CASES = {
    "load": (
        "fz",
        LOADS,
        lambda a, fz: kinetic(a, 1.3 - 4e-5 * fz, 15 * fz, fz),
        "use brush-load: ",
    ),
    "pressure": (
        "pressure",
        (1.6e5, 2.4e5),
        lambda a, p: kinetic(a, 1.35 - 1e-6 * p, 0.3 * p),
        "mf61",
    ),
    "speed": ("v", (6.0, 28.0), lambda a, v: kinetic(a, 1.25 - 0.01 * v), "use brush-ln: "),
    "camber": ("gamma", (0.0, 0.07), lambda a, g: kinetic(a + 0.3 * g, 1.1), "mf61"),
}
"""Input -> its column, its values, the force, and a model that depends on it."""


@cache
def fitted(name):
    data = over_settings(*CASES[name][:3])
    return data, fit(data, "brush")


@pytest.mark.parametrize("name", CASES)
def test_verdict_names_the_column_that_the_residuals_depend_on(name):
    _, result = fitted(name)
    sentences = result.warnings
    (said,) = [s for s in sentences if "how the force depends on" in s]
    assert f"depends on the {name}:" in said and CASES[name][3] in said
    assert "not identified" not in result.outcomes


def test_the_right_model_has_no_misfit():
    data = over_settings("fz", LOADS, lambda a, fz: kinetic(a, 1.1, fz=fz))
    assert fit(data, "brush").warnings == ()


TRUTH = {"cpa2": 6e4, "mu": 1.05}


def filtered(seed, loads=(2000.0, 4000.0, 6000.0), n=600, rho=0.97):
    """The right model at three consecutive loads, with noise correlated over 33 rows by
    a filter."""
    generator = np.random.default_rng(seed)
    time = np.arange(n) / 20
    alpha = 0.12 * np.sin(2 * np.pi * time / 9)
    fz = np.repeat(loads, n // len(loads))
    white = generator.standard_normal(n + 200)
    noise = lfilter([np.sqrt(1 - rho**2)], [1, -rho], white)[200:]
    fy = kinetic(alpha, TRUTH["mu"], TRUTH["cpa2"], fz) + 60 * noise
    return table({"time": time, "alpha": alpha, "fy": fy, "fz": fz})


def test_correlated_noise_stays_noise():
    """Of 60 filtered logs nearly none is taken for a misfit, and the intervals contain
    the truth as often as with the equivalent number of rows."""
    found, inside = 0, []
    for seed in range(60):
        end = solved(filtered(seed), {"starts": 1})
        found += bool(end.misfit.columns)
        z = np.asarray(end.problem.layout.unconstrained(TRUTH))
        held = minima(end.problem, np.tile(end.z, (2, 1)), np.arange(2), z)
        base = float(deviance(end.problem, end.z))
        inside.append(held.deviance - base < end.level)
        assert end.n_effective < 60
    assert found <= 6
    # A right interval holds it 52 times in 60 or more with 98 %.
    assert np.all(np.sum(inside, axis=0) >= 52)
