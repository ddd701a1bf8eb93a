"""Derived quantities compared with closed forms, their intervals with brute force."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from recipes import FZ, GIVEN, STD, TRUTH, brush_force, curve, table
from scipy.optimize import brentq, least_squares, minimize_scalar
from scipy.stats import norm

from tirefit.fitting.estimate import fit, with_fixed
from tirefit.fitting.problem.build import build
from tirefit.fitting.problem.config import parse_config
from tirefit.fitting.problem.layout import FreeParameter, Layout
from tirefit.fitting.result import Estimate
from tirefit.fitting.solve.inference import deviance
from tirefit.fitting.solve.multistart import Solved
from tirefit.fitting.uncertainty import extremes
from tirefit.fitting.uncertainty.derived import derived_values, quantities
from tirefit.fitting.uncertainty.extremes import _bowl
from tirefit.fitting.uncertainty.posterior import sample
from tirefit.models import MODELS
from tirefit.params import specs


def derived(model, values, channel="fx"):
    template = MODELS[model]
    free = tuple(FreeParameter(k, s) for k, s in specs(template).items() if k in values)
    layout = Layout(free)
    z = np.asarray(layout.unconstrained(values))[None]
    found = derived_values(template, layout, z, channel, FZ, 20.0)
    return {name: float(value[0]) for name, value in found.items()}


# Demand ratio of full sliding: S(11), S(30), and S(11) for S(25), p = 5/8 (1 - xi^4).
@pytest.mark.parametrize(
    ("channel", "model", "extra", "rho"),
    [
        ("fx", "brush", {}, 1.5),
        ("fx", "brush-d", {"d": 0.3}, 1.5 * 1.3),
        ("fy", "brush-d", {"d": -0.2}, 1.5 * 0.8),
        ("fx", "quartic", {}, 2.5),
    ],
)
def test_the_plateau_begins_at_full_sliding(model, extra, rho, channel):
    found = derived(model, TRUTH | extra, channel)
    slip = rho * TRUTH["mu"] * FZ / TRUTH["cpa2"]
    np.testing.assert_allclose(found["slip_at_peak"], slip, rtol=1e-7)
    np.testing.assert_allclose(found["F_max"], TRUTH["mu"] * FZ, rtol=1e-12)
    np.testing.assert_allclose(found["mu_fz"], TRUTH["mu"] * FZ, rtol=1e-12)
    slope = {"fx": "C_x", "fy": "C_alpha"}[channel]
    np.testing.assert_allclose(found[slope], 2 * TRUTH["cpa2"], rtol=1e-12)
    assert set(found) == set(quantities(channel))


@pytest.mark.parametrize("m", [0.7, 0.85])
def test_the_peak_is_found_with_kinetic_friction(m):
    found = derived("brush-m", TRUTH | {"m": m})
    mu, c = TRUTH["mu"], TRUTH["cpa2"]
    # F(u)/(mu F_z) with rho = 3 u/4 is 3u(1 - u/2)^2/2 + m u^2 (3 - u)/4; its slope is
    # zero at u = 2/(3 - 2m) (S(32)), where it is (4 - 3m)/(3 - 2m)^2 (S(33)).
    np.testing.assert_allclose(found["slip_at_peak"], 1.5 * mu * FZ / c / (3 - 2 * m), rtol=1e-12)
    peak = (4 - 3 * m) / (3 - 2 * m) ** 2
    np.testing.assert_allclose(found["F_max"], mu * FZ * peak, rtol=1e-12)
    np.testing.assert_allclose(found["F_max_over_fz"], mu * peak, rtol=1e-12)


def test_magic_formula_has_no_static_friction():
    found = derived("magic-formula", {"B": 10.0, "C": 1.6, "D": 0.9, "E": 0.0})
    np.testing.assert_allclose(found["C_x"], 10 * 1.6 * 0.9 * FZ, rtol=1e-12)
    np.testing.assert_allclose(found["F_max"], 0.9 * FZ, rtol=1e-12)
    kappa = np.tan(np.pi / 2 / 1.6) / 10
    np.testing.assert_allclose(found["slip_at_peak"], kappa / (1 - kappa), rtol=1e-10)
    assert "mu_fz" not in found


# Intervals


@pytest.mark.parametrize("name", ["given", "estimated", "vague"])
def test_a_quantity_of_one_parameter_has_its_interval(name, request):
    result = request.getfixturevalue(name)
    for quantity, label, factor in (
        ("C_x", "cpa2", 2.0),
        ("mu_fz", "mu", FZ),
        ("F_max", "mu", FZ),
        ("F_max_over_fz", "mu", 1.0),
    ):
        found, parameter = result.derived[quantity], result.least_squares[label]
        np.testing.assert_allclose(found.value, factor * parameter.value, rtol=1e-9)
        np.testing.assert_allclose(found.ci95, factor * np.array(parameter.ci95), rtol=1e-9)
        assert found.identified == parameter.identified
        if parameter.std is None:
            assert found.std is None
        else:
            np.testing.assert_allclose(found.std, factor * parameter.std, rtol=1e-3)


def brute_force(data, of, start, bounds, reach):
    """95 % ends of a quantity t by SciPy: the others are refitted at every t.

    ``of(t, x)`` gives the brush's parameters from t and the others, x.
    """

    def misfit(t):
        def residual(x):
            force = brush_force(data["sigma_x"], **of(t, x))
            return (data["fx"] - force) / STD

        end = least_squares(residual, start, bounds=bounds, x_scale=start)
        return 2 * end.cost

    best = minimize_scalar(misfit, bounds=reach, options={"xatol": 1e-6 * reach[1]})
    return [
        brentq(lambda t: misfit(t) - best.fun - 3.841459, end, best.x, rtol=1e-5) for end in reach
    ]


def share(d, m):
    """Peak force over static friction times load: a parabola through a fine grid."""
    force = brush_force(np.linspace(0.5, 3.0, 1001), 1.0, 1.0, d, m, fz=1.0)
    at = np.clip(np.argmax(force), 1, 999)
    before, peak, after = force[at - 1 : at + 2]
    return peak + (after - before) ** 2 / 8 / (2 * peak - before - after)


def test_peak_of_three_parameters_agrees_with_brute_force():
    data = curve(TRUTH | {"d": 0.2, "m": 0.8}, reach=2.5, seed=3)
    found = fit(data, "brush-dm", config=GIVEN).derived["F_max"]

    def of(t, x):
        c, d, m = x
        return {"cpa2": c, "mu": t / FZ / share(d, m), "d": d, "m": m}

    ends = brute_force(
        data,
        of,
        [5e4, 0.2, 0.8],
        ([1e3, -0.33, 0.0], [1e6, 1.0, 1.0]),
        (0.98 * found.value, 1.02 * found.value),
    )
    np.testing.assert_allclose(found.ci95, ends, atol=0.01 * np.ptp(ends))
    # Nearly a parabola here: twice 1.96 standard deviations.
    np.testing.assert_allclose(np.ptp(ends), 3.92 * found.std, rtol=0.03)


def test_the_peak_is_right_with_a_parameter_at_its_bound():
    # No kinetic drop in the data: m sits at its upper bound 1, and may be lower.
    data = curve(seed=21)
    result = fit(data, "brush-m", config=GIVEN)
    found = result.derived["F_max"]

    def of(t, x):
        c, m = x
        return {"cpa2": c, "mu": t / FZ * (3 - 2 * m) ** 2 / (4 - 3 * m), "m": m}

    ends = brute_force(
        data, of, [5e4, 0.99], ([1e3, 0.0], [1e6, 1.0]), (0.97 * found.value, 1.03 * found.value)
    )
    np.testing.assert_allclose(found.ci95, ends, atol=0.02 * np.ptp(ends))
    assert result.least_squares["m"].std is None
    np.testing.assert_allclose(found.std, np.ptp(found.ci95) / 3.92, rtol=1e-3)


@pytest.mark.long
def test_slope_of_a_redundant_form_agrees_with_brute_force():
    """A Magic Formula below its peak: one parameter is undetermined, but the slope is
    known to 2 %."""
    slip, generator = np.linspace(0.002, 0.06, 80), np.random.default_rng(3)

    def magic(b, c, d, e):
        x = b * slip / (1 + slip)  # of kappa
        return FZ * d * np.sin(c * np.arctan(x - e * (x - np.arctan(x))))

    force = magic(12.0, 1.5, 0.9, 0.3) + STD * generator.standard_normal(80)
    data = {"sigma_x": slip, "fx": force, "fz": np.full(80, FZ)}
    result = fit(table(data), "magic-formula", config=GIVEN)
    unknown = [one for one in result.least_squares.values() if one.std is None]
    assert unknown
    found = result.derived["C_x"]
    assert found.identified and found.std < 0.02 * found.value

    known = specs(MODELS["magic-formula"])
    low, high = np.array([known[name].bounds for name in "CDE"]).T

    def misfit(t):
        def residual(x):
            c, d, e = x
            return (force - magic(t / (FZ * c * d), c, d, e)) / STD

        starts = ([1.5, 0.9, 0.3], [0.7, 1.5, -1.0], [2.0, 0.8, 0.5])
        return min(
            2 * least_squares(residual, x, bounds=(low, high), xtol=1e-12).cost for x in starts
        )

    best = min(misfit(found.value + u * found.std) for u in (-0.2, 0.0, 0.2))
    for end, sign in zip(found.ci95, (-1, 1), strict=True):
        # At the end the deviance is that of 95 %; a little beyond it is more.
        assert misfit(end) - best == pytest.approx(3.841, abs=0.1)
        assert misfit(end + 0.1 * sign * found.std) - best > 3.841


@pytest.mark.parametrize("name", ["estimated", "given", "prior"])
def test_slope_of_the_deviance_agrees_with_differences(name, request):
    end = request.getfixturevalue("given" if name == "prior" else name).solved
    problem = end.problem
    if name == "prior":
        stiffness, friction = problem.layout.free
        pulled = (stiffness, replace(friction, prior=(0.9, 0.05)))
        problem = replace(problem, layout=replace(problem.layout, free=pulled))
    end = end._replace(problem=problem)

    def total(z):
        return deviance(problem, z)

    z = end.z + np.sqrt(np.diag(end.covariance)) * [0.7, -1.1]
    value, slope, _ = _bowl(end, z)
    np.testing.assert_allclose(value, float(total(z)), rtol=1e-12)
    np.testing.assert_allclose(2 * slope, jax.grad(total)(z), rtol=1e-9)


def test_curvature_of_the_deviance_agrees_with_the_covariance(given):
    end = given.solved
    _, _, curvature = _bowl(end, end.z)
    np.testing.assert_allclose(curvature @ end.covariance, np.eye(2), atol=1e-9)


def test_posterior_quantities_use_the_posterior_draws(given, chunk):
    sampled = sample(given, max_steps=chunk, walkers=16)
    cpa2, mu = sampled.chains.reshape(-1, 2).T
    for name, draws in (
        ("C_x", 2 * cpa2),
        ("F_max", mu * FZ),
        ("slip_at_peak", 1.5 * mu * FZ / cpa2),
    ):
        found = sampled.derived[name]
        low, median, high = np.quantile(draws, [0.025, 0.5, 0.975])
        np.testing.assert_allclose(found.value, median, rtol=1e-7)
        np.testing.assert_allclose(found.ci95, (low, high), rtol=1e-7)
        ends = np.quantile(draws, norm.cdf([-1, 1]))
        np.testing.assert_allclose(found.std, np.ptp(ends) / 2, rtol=1e-6)
    assert sampled.parameters["mu"].value == np.median(mu)
    assert sampled.source == "posterior median and central 95 %"
    assert sampled.to_dict()["source"] == sampled.source


def test_a_parameter_tied_to_one_per_run_has_an_estimate_per_run():
    tied = {"tied": "mu", "factor": -0.2}
    config = {"parameters": {"d": tied, "mu": {"per_run": True}}}
    data = curve(n=40)
    runs = table(data.columns, run=np.repeat([0, 1], 20), runs=("dry", "wet"))
    problem = build(runs, "brush-d", parse_config(config)).problem
    estimates = {
        "cpa2": Estimate(5e4, 1.0, "N", (1.0, 2.0)),
        "mu[dry]": Estimate(1.0, 0.25, "-", (0.5, 1.5)),
        "mu[wet]": Estimate(0.5, None, "-", (0.25, 1.0), False),
    }
    assert set(estimates) == set(problem.layout.labels)
    found = with_fixed(estimates, problem)
    assert set(found) == {*estimates, "d[dry]", "d[wet]"}
    assert found["d[dry]"] == Estimate(-0.2, 0.05, "-", (-1.5 * 0.2, -0.1))
    assert found["d[wet]"] == Estimate(-0.1, None, "-", (-0.2, -0.05), False)


@pytest.fixture(scope="module")
def by_run():
    """Two tires on two roads in one fit, and each of them alone; noise given."""
    truths = {"dry": TRUTH, "wet road": {"cpa2": 4e4, "mu": 0.7}}
    alone = {k: curve(t, n=150, seed=i) for i, (k, t) in enumerate(truths.items())}
    columns = {
        name: np.concatenate([one[name] for one in alone.values()])
        for name in ("sigma_x", "fx", "fz")
    }
    each = {"per_run": True}
    config = GIVEN | {"parameters": {"cpa2": each, "mu": each}}
    runs = table(columns, run=np.repeat([0, 1], 150), runs=tuple(truths))
    together = fit(runs, config=config)
    return together, {k: fit(data, config=GIVEN) for k, data in alone.items()}


def test_quantities_per_run_agree_with_separate_fits(by_run):
    together, alone = by_run
    assert together.reference["fz"] == FZ
    assert list(together.derived) == [
        f"{name}[{run}]" for name in quantities("fx") for run in alone
    ]
    for run, result in alone.items():
        for name, expected in result.derived.items():
            found = together.derived[f"{name}[{run}]"]
            assert (found.unit, found.identified) == (expected.unit, True)
            np.testing.assert_allclose(found.value, expected.value, rtol=1e-6)
            np.testing.assert_allclose(found.std, expected.std, rtol=1e-3)
            # Both levels are for one parameter: the other run has no influence.
            np.testing.assert_allclose(found.ci95, expected.ci95, rtol=1e-4)


@pytest.mark.parametrize("step", [0.0, 1e-6])
def test_quantities_of_a_run_that_shows_nothing_are_not_identified(step):
    """At (almost) zero slip, any friction of the second run fits as well: the slip at
    its peak, mu times a known number, spans the bounds of mu."""
    road = curve(n=150)
    slip = step * np.arange(10)
    noise = STD * np.random.default_rng(2).standard_normal(10)
    columns = {
        "sigma_x": np.append(road["sigma_x"], slip),
        "fx": np.append(road["fx"], brush_force(slip, **TRUTH) + noise),
        "fz": np.full(160, FZ),
    }
    runs = table(columns, run=np.repeat([0, 1], [150, 10]), runs=("a", "b"))
    result = fit(runs, config=GIVEN | {"parameters": {"mu": {"per_run": True}}})
    for name in ("F_max", "F_max_over_fz", "mu_fz", "slip_at_peak"):
        assert result.derived[f"{name}[a]"].identified
        found = result.derived[f"{name}[b]"]
        assert not found.identified and found.std is None
    low, high = result.derived["slip_at_peak[b]"].ci95
    factor = 1.5 * FZ / result.parameters["cpa2"].value
    # The stiffness adds its own error, below a percent.
    np.testing.assert_allclose(
        [low, high], factor * np.array(specs(MODELS["brush"])["mu"].bounds), rtol=0.03
    )
    assert result.derived["C_x"].identified


def test_undefined_quantities_have_no_number():
    slip = fit(curve(), "uniform", config=GIVEN).derived["slip_at_peak"]
    assert not slip.identified and np.isnan(slip.value)
    assert slip.std is None and slip.ci95 == (None, None)


def test_a_lateral_fit_accepts_a_known_friction():
    data = curve()
    columns = {"alpha": np.arctan(data["sigma_x"]), "fy": data["fx"], "fz": data["fz"]}
    config = GIVEN | {"noise": {"fy": STD}, "parameters": {"mu": {"value": 1.0, "free": False}}}
    result = fit(table(columns), config=config)
    found, stiffness = result.derived, result.least_squares["cpa2"]
    assert list(found) == list(quantities("fy")) and "C_x" not in found
    assert found["C_alpha"].unit == "N/rad"
    np.testing.assert_allclose(found["C_alpha"].value, 2 * stiffness.value, rtol=1e-9)
    # A quantity of fixed parameters is fixed; one of a free one falls as it rises.
    assert found["F_max"].fixed and found["F_max"].ci95 == (None, None)
    ends = 1.5 * FZ / np.array(stiffness.ci95)
    np.testing.assert_allclose(found["slip_at_peak"].ci95, ends[::-1], rtol=1e-6)


def bins(loads):
    """Sweeps at these loads, each a run, of one tire whose friction falls with load."""
    parts = [
        curve(
            {"cpa2": 5e4, "mu": (1.1 - 4e-5 * load) * load / FZ},
            n=120,
            seed=seed,
            extra={"fz": load * (1 + 0.02 * np.sin(np.arange(120)))},
            reach=3.0,
        )
        for seed, load in enumerate(loads)
    ]
    columns = {k: np.concatenate([one[k] for one in parts]) for k in parts[0].columns}
    names = tuple(f"{load:g} N" for load in loads)
    run = np.repeat(np.arange(len(loads)), 120)
    each = {"per_run": True}
    config = GIVEN | {"parameters": {"mu": each, "cpa2": each}}
    return fit(table(columns, run=run, runs=names), config=config), names


def test_quantities_of_a_bin_are_at_its_load():
    loads = (1500.0, 3000.0, 6000.0)
    result, names = bins(loads)
    middle = result.reference["fz"]
    assert middle == pytest.approx(3000, rel=3e-3)
    for name, load in zip(names, loads, strict=True):
        at = result.reference.get(f"fz[{name}]", middle)
        assert at == pytest.approx(load, rel=3e-3)
        friction = result.derived[f"F_max_over_fz[{name}]"].value
        assert friction == pytest.approx(1.1 - 4e-5 * load, rel=0.02)
        peak = result.derived[f"F_max[{name}]"].value
        assert peak == pytest.approx(friction * at, rel=1e-9)


def test_runs_of_the_same_loads_are_compared_at_one_load():
    result, _ = bins((3000.0, 3000.0 + 10, 3000.0 + 20))
    assert set(result.reference) == {"fz", "v"}


def test_a_search_at_a_jump_of_the_deviance_ends(monkeypatch):
    """The deviance is (value - 1)^2 up to 2 and 9 beyond; the level is 4."""
    searched = []

    def settled(solved, quantity, z, target, spread):
        searched.append(target)
        return z, target, (target - 1) ** 2 if target < 2 else 9.0

    fields = dict.fromkeys(Solved._fields) | {
        "z": np.ones(1),
        "covariance": np.eye(1),
        "level": 4.0,
    }
    monkeypatch.setattr(extremes, "_settled", settled)
    monkeypatch.setattr(extremes, "_bowl", lambda solved, z: (0.0, z, z))
    end = extremes.extreme(Solved(**fields), lambda z: (1.0, np.ones(1)), 1)
    assert 2 - 1e-3 < end < 2 and len(searched) < 25
