"""Figures of a Magic Formula fit: their numbers, and the files."""

from dataclasses import replace

import numpy as np
import pytest
from pages import Page, without_pictures

from tirefit.data.read import read_frame
from tirefit.fitting.mf.fit import fit_magic_formula
from tirefit.models import TireInputs, forces
from tirefit.models.mf import mf_tire
from tirefit.report.fit.magic_formula import magic_formula_page
from tirefit.report.fit.mf_figures import (
    ellipse_curves,
    force_curves,
    residual_curve,
    save_magic_formula,
)
from tirefit.results import UsageError

LOADS = (2000.0, 4000.0, 6000.0)
ANGLES = np.radians([0.0, 3.0, 6.0])
ODD = 4000.0, ANGLES[1], 150.0
"""Load, slip angle, and the newtons by which F_x of that setting is wrong."""


def columns():
    """Brake sweeps of both forces at three loads and slip angles, with noise."""
    kappa = np.concatenate([np.linspace(-0.2, 0.2, 60), np.linspace(0.2, -0.2, 60)])
    fz, alpha = (a.repeat(len(kappa)) for a in map(np.ravel, np.meshgrid(LOADS, ANGLES)))
    kappa = np.tile(kappa, len(LOADS) * len(ANGLES))
    fz = fz * (1 + 0.2 * kappa)
    values = {"FNOMIN": 4000.0, "PKX1": 25.0, "RBX1": 10.0, "RCX1": 1.0}
    values |= {"RBY1": 8.0, "RCY1": 1.0, "PKY1": -20.0, "PKY2": 2.0}
    inputs = TireInputs(kappa / (1 - kappa), alpha, fz)
    true = forces(mf_tire("6.1", values), inputs)
    rng = np.random.default_rng(3)
    table = {"sigma_x": inputs.sigma_x, "alpha": alpha, "fz": fz}
    for name in ("fx", "fy"):
        noise = 10.0 * rng.standard_normal(len(fz))
        table[name] = np.asarray(getattr(true, name)) + noise
    odd = (np.abs(fz / ODD[0] - 1) < 0.1) & (alpha == ODD[1])
    table["fx"][odd] += ODD[2]
    return table


@pytest.fixture(scope="module")
def table():
    return columns()


@pytest.fixture(scope="module")
def fit(table):
    return fit_magic_formula(read_frame(table), "mf61", leave_out="none")


def test_points_are_medians_of_rows_and_curves_show_the_tire(fit, table):
    panel = next(p for p in force_curves(fit, "fx") if "load" in p.title)
    assert [group.label for group in panel.groups] == ["2000 N", "4000 N", "6000 N"]
    for load, group, curve in zip(LOADS, panel.groups, panel.curves, strict=True):
        kappa = table["sigma_x"] / (1 + table["sigma_x"])
        rows = (np.abs(table["fz"] / load - 1) < 0.1) & (table["alpha"] == 0)
        for x, force, low, high in zip(group.slip, group.force, group.low, group.high, strict=True):
            near = rows & (np.abs(kappa - x / 100) < 0.4 / 64)
            assert low <= force <= high
            # The load of the rows follows the slip: the points are moved to that of the curve.
            expected = np.median(table["fx"][near] * load / table["fz"][near])
            assert force == pytest.approx(expected, abs=0.03 * load)
        slip = curve.slip / 100
        at = TireInputs(slip / (1 - slip), 0.0, load)
        np.testing.assert_allclose(curve.force, forces(fit.tire, at).fx, atol=0.01 * load)
        assert np.all(curve.noise_low < curve.force) and np.all(curve.force < curve.noise_high)


def test_a_wrong_setting_is_named(fit):
    panel = residual_curve(fit, "fx")
    assert "4000 N" in panel.note and "slip angle 3 deg" in panel.note
    assert [text for _, text in panel.ticks] == ["2000 N", "4000 N", "6000 N"]
    of_odd = next(g for g in panel.groups if g.label == "slip angle 3 deg")
    assert np.max(of_odd.force) > 0.5 * ODD[2]


def test_the_ellipse_shows_both_forces_of_similar_rows(fit, table):
    (panel,) = ellipse_curves(fit)
    assert panel.note == "6000 N, camber 0 deg"
    assert [g.label for g in panel.groups] == ["straight", "slip angle 3 deg", "slip angle 6 deg"]
    rows = (np.abs(table["fz"] / 6000 - 1) < 0.1) & (table["alpha"] == ANGLES[2])
    ratio = table["fy"][rows] / table["fz"][rows]
    assert np.max(panel.groups[2].force) == pytest.approx(ratio.max(), rel=0.03)
    for points, curve in zip(panel.groups, panel.curves, strict=True):
        ends = [[f(of) for f in (np.min, np.max)] for of in (points.slip, points.force)]
        reached = [[f(of) for f in (np.min, np.max)] for of in (curve.slip, curve.force)]
        np.testing.assert_allclose(reached, ends, atol=0.05)


def test_figures_and_page_are_written_completely(fit, tmp_path):
    names = {path.name for path in save_magic_formula(fit, tmp_path)}
    assert names == {f"{name}.png" for name in ("fit", "fx", "residuals", "ellipse")}
    page = without_pictures(lambda: magic_formula_page(fit))
    links = Page(page).links
    assert len(links) == 6 and all(x.startswith("data:image/png") for x in links)


def test_plot_fit_draws_a_fit_in_memory(fit):
    figure = fit.plot()
    assert len(figure.axes) == 2
    axes = figure.axes[0]
    assert fit.plot(ax=axes) is axes.figure
    with pytest.raises(UsageError, match="fit again"):
        replace(fit, binned={}).plot()
