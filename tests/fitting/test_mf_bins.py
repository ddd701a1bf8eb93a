"""Settings of a rig test, found in rows whose load follows the slip."""

from dataclasses import replace

import numpy as np
import pytest

from tirefit.fitting.mf.bins import rig_settings
from tirefit.fitting.mf.rows import ForceRows, groups_of
from tirefit.models import TireInputs

LOADS = (220.0, 440.0, 670.0, 890.0, 1110.0)
DEG = np.pi / 180


def rows_of(force, parts, run=0):
    """Rows of (sigma_x, alpha, fz, gamma, pressure) pieces, in order."""
    cells = [np.broadcast_arrays(*part) for part in parts]
    sigma_x, alpha, fz, gamma, pressure = np.concatenate(cells, axis=1)
    n = len(fz)
    inputs = TireInputs(sigma_x, alpha, fz, 0 * fz, gamma, pressure, 0 * fz)
    run = np.broadcast_to(run, n)
    return ForceRows(force, inputs, 0 * fz, run, fz > 0, np.zeros(n, int))


def triangle(n=200):
    """One triangle from zero to both ends and back, from -1 to 1."""
    return np.interp(np.linspace(0, 4, n), [0, 1, 3, 4], [0, 1, -1, 0])


def swept(rng, load, wander):
    """Sweeps at one load, as pieces: of alpha alone, of kappa at 0 and at 4 deg."""
    way = triangle()
    noise = 1 + 0.01 * rng.standard_normal(len(way))
    fz, gamma = (load * noise * (1 + wander(way)), 2 * DEG + 1e-4 * rng.standard_normal(200))
    kappa = 0.2 * way
    yield 0.0, 0.2 * way, fz, gamma, 83e3
    yield kappa / (1 - kappa), 0.0, fz, gamma, 83e3
    yield kappa / (1 - kappa), 4 * DEG, fz, gamma, 83e3


@pytest.mark.parametrize("force", ["fx", "fy", "mz"])
@pytest.mark.parametrize(
    "wander",
    [
        lambda way: 0 * way,
        lambda way: 0.08 * way,
        # Saturates as the force does: half of the rows 8 % above, half below.
        lambda way: 0.08 * np.tanh(10 * way),
        lambda way: 0.08 * np.abs(way) - 0.04,
    ],
)
def test_settings_are_found_if_the_load_follows_the_slip(force, wander):
    rng = np.random.default_rng(1)
    parts, truth = [], []
    for load in LOADS:
        for kind, part in enumerate(swept(rng, load, wander)):
            parts.append(part)
            truth += 200 * [(load, kind)]
        # On its way to the next load: rows of no setting.
        parts.append((0.0, 0.0, np.linspace(load, load + 220, 6), 2 * DEG, 83e3))
        truth += 6 * [(0.0, 0)]
    settings, code = rig_settings(rows_of(force, parts))
    truth = np.array(truth)
    held = truth[:, 0] > 0
    assert len({s.fz for s in settings}) == len(LOADS)
    assert sorted({s.fz for s in settings}) == pytest.approx(LOADS, rel=0.06)
    found = np.array([(s.fz, s.swept == "sigma_x", s.held) for s in settings])[code]
    assert np.mean(np.abs(found[held, 0] / truth[held, 0] - 1) < 0.06) > 0.99
    # Rows at rest between two sweeps may belong to either.
    assert np.mean(found[held, 1] == (truth[held, 1] > 0)) > 0.95
    inclined = held & (truth[:, 1] == 2)
    assert np.mean(np.abs(found[inclined, 2] - 4 * DEG) < 1e-3) > 0.95
    assert len(set(settings)) == len(settings)


def test_in_a_grid_the_other_slip_is_a_setting():
    alpha = np.repeat(np.arange(-3, 4) * 3.0, 9) * DEG
    kappa = np.tile(np.linspace(-0.4, 0.4, 9), 7)
    part = (kappa / (1 - kappa), alpha, 1000.0, 0.0, 0.0)
    settings, code = rig_settings(rows_of("fx", [part]))
    held = np.array([s.held for s in settings])[code]
    assert {s.swept for s in settings} >= {"sigma_x"}
    turned = np.abs(alpha) > 0.01
    swept = np.array([s.swept for s in settings])[code]
    assert np.all(swept[turned & (np.abs(kappa) > 0.01)] == "sigma_x")
    at = turned & (swept == "sigma_x")
    np.testing.assert_allclose(held[at], alpha[at], atol=1e-9)


def test_a_swept_load_is_divided_into_thirds():
    rng = np.random.default_rng(2)
    part = (0.0, rng.uniform(-0.2, 0.2, 900), rng.uniform(1e3, 6e3, 900), 0.0, 2e5)
    settings, code = rig_settings(rows_of("fy", [part]))
    assert len(settings) == 3
    assert np.bincount(code).tolist() == [300, 300, 300]


def test_runs_are_separate_settings():
    part = (0.0, np.linspace(-0.2, 0.2, 60), 1000.0, 0.0, 2e5)
    settings, code = rig_settings(rows_of("fy", [part, part], np.repeat([4, 7], 60)))
    assert [s.run for s in settings] == [4, 7]
    assert np.array_equal(code, np.repeat([0, 1], 60))
    labels = [", ".join(map(setting.text, ("fz", "held"))) for setting in settings]
    assert labels == 2 * ["1000 N, rolling freely"]


def test_of_many_rows_some_are_taken_evenly_along_the_slip():
    rng = np.random.default_rng(3)
    alpha, setting = rng.uniform(-0.2, 0.2, 30_000), np.repeat([1, 0, 1], 10_000)
    rows = replace(rows_of("fy", [(0.0, alpha, 1000.0, 0.0, 2e5)]), setting=setting)
    rows = replace(rows, observed=1000.0 * np.sign(alpha), pure=np.abs(alpha) > 0.05)
    pure, combined = groups_of({"fy": rows})["fy"]
    assert pure.title == "fy in pure slip" and np.all(np.abs(pure.rows.column("alpha")) > 0.05)
    assert combined.part == "combined" and len(combined.rows.observed) < 8192
    taken = pure.rows
    assert len(taken.observed) == 8192 and np.all(np.diff(taken.setting) >= 0)
    assert np.mean(taken.setting) == pytest.approx(2 / 3, abs=0.01)
    within = taken.column("alpha")[taken.setting == 1]
    assert np.all(np.diff(within) > -0.006)  # a place of the slip is 0.005 rad wide
    np.testing.assert_allclose(np.mean(within > 0.1), 1 / 3, atol=0.02)
    assert np.all(pure.variance(taken.observed) == 50.0**2)
