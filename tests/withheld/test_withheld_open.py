"""The ideal observer of the open mix."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

from fits.withheld import library, observer, patch, trials
from fits.withheld.designs import DESIGNS, make_world
from fits.withheld.open_observer import (
    Observed,
    Replay,
    Shape,
    _null,
    _rounded,
    observed,
    rows,
    with_known_range,
)
from fits.withheld.procedural import procedural, varying

C, MU = 5e4, 0.9
KEPT = ("load_friction", "force_offset", "slip_offset")


def setting(n, seed=11):
    """A plain tire in a design with three loads and speeds, and what its file tells."""
    g = np.random.default_rng(seed)
    world = make_world(DESIGNS["F"], n, C, MU, g)
    x = library.Inputs(
        world.time, world.run, world.slip, world.fz, world.v, "fx",
        (0.001, 0.01 * world.fz, 0.001 * world.fz),
    )  # fmt: skip
    return g, world, x.without([e for e in trials.EFFECTS if e not in KEPT])


def wave(world):
    """An unlisted effect: five waves of the force over the record, 4 % of the friction."""
    u = (world.time - world.time.min()) / np.ptp(world.time)
    change = 0.04 * np.sin(2 * np.pi * (5.3 * u + 0.2))
    world.after.append(lambda w, force: force + w.mu * w.fz * change)


@pytest.mark.parametrize(
    "effect, more", [(False, False), (True, False), (False, True), (True, True)]
)
def test_the_observer_tells_the_four_worlds_apart(effect, more):
    g, _, x = setting(100)
    parts = [("load_friction", "friction_log_square", -0.2, 0.5)] if effect else []
    truth = library.predict_together(x, parts, C, MU, wave if more else None)
    force = truth + library.spread(x, C, MU) * g.normal(size=100)
    found = observed(x, force)
    assert sum(found.sets.values()) == pytest.approx(1)
    assert found.sets[("load_friction",) if effect else (), more] > 0.5
    assert found.holding(["load_friction"]) == found.each.get("load_friction", 0.0)
    assert (found.holding(["load_friction"]) > 0.5) == effect
    assert (found.unlisted > 0.5) == more


def test_noise_of_another_law_is_no_effect():
    """A noise of 1.5 times the stated one, and one with outliers, but not of three times."""
    g, _, x = setting(100)
    truth = library.predict_together(x, [], C, MU)
    white = library.spread(x, C, MU) * g.normal(size=100)
    rare = np.where(g.uniform(size=100) < 0.05, 8, 1)
    for noise in (1.5 * white, rare * white):
        assert observed(x, truth + noise).sets[(), False] > 0.9
    seen = [observer.screened(x, truth + factor * white) for factor in (1.5, 3.0)]
    over = [_null(x, truth, one) + 0.5 * one.misses @ one.misses for one in seen]
    assert 0 < over[0] < over[1]


def test_the_evidence_of_no_effect_is_the_density_of_the_noise():
    """By scipy's densities of the six laws, over that of the stated one."""
    _, _, x = setting(60)
    truth = library.predict_together(x, [], C, MU)
    force = truth + library.spread(x, C, MU) * np.random.default_rng(3).normal(size=60)
    seen = observer.screened(x, force)
    own, clean = 0.01 * x.fz, seen.std
    slip, rest = np.sqrt(clean**2 - own**2), seen.misses * seen.std
    lag = np.abs(np.subtract.outer(np.arange(60), np.arange(60)))
    by_law = [
        norm.pdf(rest, scale=np.hypot(slip, own * factor)).prod()
        for factor in (1, 1, 1.5, 0.4 + 1.6 * np.abs(force) / np.abs(force).max())
    ]
    covariance = np.diag(slip**2) + np.outer(own, own) * 0.5**lag
    by_law.append(multivariate_normal(cov=covariance).pdf(rest))
    rare = norm.pdf(rest, scale=np.hypot(slip, 8 * own))
    by_law.append(np.prod(0.95 * norm.pdf(rest, scale=clean) + 0.05 * rare))
    stated = norm.pdf(rest, scale=clean)
    ratio = np.mean(by_law) / stated.prod() * np.exp(-0.5 * np.sum((rest / seen.std) ** 2))
    assert _null(x, force, seen) == pytest.approx(np.log(ratio), abs=1e-6)


def test_slips_near_the_ends_of_the_range_are_expected_inside():
    """By sums over a grid of true slips, evenly probable from 0 to 0.05."""
    _, _, x = setting(60)
    slips, std = np.linspace(-0.008, 0.058, 60), 0.004
    x = replace(x, slip=slips, stds=(std, *x.stds[1:]))
    found = with_known_range(x, DESIGNS["A"])
    true = np.linspace(0, 0.05, 20_001)
    for k in (0, 10, 30, 59):
        weight = norm.pdf(slips[k], true, std)
        mean = weight @ true / weight.sum()
        assert found.slip[k] == pytest.approx(mean, abs=2e-6)
        width = np.sqrt(weight @ (true - mean) ** 2 / weight.sum())
        assert found.stds[0][k] == pytest.approx(width, rel=1e-3)
    assert with_known_range(x, DESIGNS["G"]) is x


def test_rounded_slips_are_recognised():
    g, world, x = setting(100)
    rounded = replace(x, slip=0.02 * np.round(world.slip / 0.02) + 0.001 * g.normal(size=100))
    for inputs, sign in ((rounded, 1), (x, -1)):
        force = library.predict_together(x, [], C, MU) + 0.01 * x.fz * g.normal(size=100)
        seen = observer.screened(inputs, force)
        assert sign * (_rounded(inputs, seen) + 0.5 * seen.misses @ seen.misses) > 10


def test_numbers_replace_the_generator():
    """The choices that the numbers make, their prior, and a change in proportion to size."""
    _, world, _ = setting(80)
    varies = varying(world)
    place = varies.index("time")
    # time, the force, the third shape (periodic) of three; 7.5 waves; not gated.
    numbers = np.array([(place + 0.5) / len(varies), 0.6, 0.5, 0.5, 0.1, 0.9, *[0.0] * 10])
    draws, about = Shape("procedural", numbers).change(world, 1.0, varies)
    assert about == "force by periodic of time"
    assert draws.free == [3, 4]
    assert draws.gate == 5
    assert draws.log_prior == pytest.approx(np.log(0.7 / len(varies) / 4 / 3))
    u = (world.time - world.time.min()) / np.ptp(world.time)
    change = np.sin(2 * np.pi * 7.5 * u + 0.6)
    change -= np.median(change)
    expected = 0.05 * MU * world.fz * change / np.abs(change).max()
    np.testing.assert_allclose(world.after[0](world, 0.0), expected, rtol=1e-9)
    # The prior of the choices is that of the generator: of many draws, a share is gated.
    g = np.random.default_rng(5)
    gated = [
        "gated" in procedural(make_world(DESIGNS["F"], 40, C, MU, g), 1.0, g) for _ in range(200)
    ]
    assert np.mean(gated) == pytest.approx(0.3, abs=0.1)
    assert Replay(np.array([0.29])).uniform() < 0.3 <= Replay(np.array([0.31])).uniform()
    assert patch.forces(world)["fx"].shape == (80,)


def test_the_table_agrees_with_hand_calculation():
    def label(kind, *effects):
        return {
            "effects": [*effects], "families": [], "set": kind, "kind": "", "leave_out": None,
            "forms": [], "amplitudes": [],
        }  # fmt: skip

    def answer(status, each, unlisted, also=()):
        effects = [e for e, (p, _) in each.items() if p > 0.5]
        verdict = {
            "status": status, "effects": effects, "probability": 0.6, "also_possible": [*also],
            "left": {"unlisted": unlisted},
            "each": {e: {"probability": p, "twins": twins} for e, (p, twins) in each.items()},
        }  # fmt: skip
        return {"verdict": verdict, "candidates": []}

    labels = {
        "a": label("pairs", "conicity", "slip_offset"),
        "b": label("beside", "conicity"),
        "c": label("null"),
    }
    both, one = ("conicity", "slip_offset"), ("conicity",)
    found = {
        "a": Observed({(both, False): 0.3, (one, False): 0.6, (one, True): 0.1}),
        "b": Observed({(one, True): 0.8, ((), True): 0.15, ((), False): 0.05}),
        "c": Observed({((), False): 0.9, (one, False): 0.1}),
    }
    answers = {
        "a": answer("named", {"conicity": (0.9, []), "slip_offset": (0.8, [])}, 0.2),
        "b": answer("named", {"force_offset": (0.7, ["conicity"])}, 0.4),
        "c": answer("none", {}, 0.3),
    }
    table = rows(labels, found, answers)
    values = {name: [cell.split()[0] for cell in cells] for name, *cells in table[:10:2]}
    assert values["mean probability on the true verdict"] == [
        "0.300",
        "0.800",
        "-",
        "0.900",
        "0.300",
    ]
    assert values["verdict right"] == ["0.000", "1.000", "-", "1.000", "0.000"]
    assert values["all listed effects named"][:2] == ["0.000", "1.000"]
    assert values["exactly the listed effects named"][4] == "0.000"
    assert values["the same, or all likely"][4] == "1.000"
    answered = [[cell.split()[0] for cell in cells] for _, *cells in table[1:10:2]]
    assert answered[0][:2] == [f"{0.9 * 0.8 * 0.8:.3f}", "0.000"]
    assert answered[3][4] == "1.000"
    own, same, theirs = ([cell.split()[0] for cell in cells] for _, *cells in table[10:])
    # a: the best set is conicity (1.0); b: conicity (0.8).
    assert own[:2] == ["0.000", "0.040"]
    # a: conicity 1.0 and slip offset 0.3, both there; b: one of twins, 0.8.
    assert same[:2] == [f"{0.7**2 / 2:.3f}", "0.040"]
    assert theirs[:2] == [f"{(0.1**2 + 0.2**2) / 2:.3f}", f"{0.3**2:.3f}"]
