"""``tirefit convert``: a refit of a Magic Formula."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import curve_fit

from tirefit.data.tir.tir import read_tir
from tirefit.models import TireInputs, forces
from tirefit.models.mf import mf_tire

FOLDER = Path(__file__).parents[1] / "data" / "tir"
MF52 = FOLDER / "mfeval_julia/MagicFormula52_Parameters.tir"
TRUCK = FOLDER / "chrono/335_65R22_5_G275MSA_60psi.tir"
SLIPS = 61


def brush(points, cpa2, mu):
    """S(12) written out, odd in the physical slip; points are (slip, load) (2, n)."""
    slip, fz = points
    x = np.minimum(cpa2 * abs(slip) / (1.5 * mu * fz), 1.0)
    return np.sign(slip) * mu * fz * (3 * x - 3 * x**2 + x**3)


def scipy_fit(slip, loads, force_of):
    """(cpa2, mu) and the RMSE at each load, by least squares on the grid.

    ``force_of`` takes physical slips and loads.
    """
    points = np.array([(s, fz) for fz in loads for s in slip]).T
    observed = force_of(*points)
    fz = points[1].mean()
    values, _ = curve_fit(brush, points, observed, p0=[10 * fz, 1.0], xtol=1e-12)
    missed = (observed - brush(points, *values)).reshape(len(loads), -1)
    return values, np.sqrt(np.mean(missed**2, axis=1))


def assert_converted(stdout, values, loads, rmse):
    content = json.loads(Path("out/fit.json").read_text())
    for name, value in zip(("cpa2", "mu"), values, strict=True):
        estimate = content["parameters"][name]
        np.testing.assert_allclose(estimate["value"], value, rtol=1e-4)
        low, high = estimate["ci95"]
        assert low < value < high
    # 61 neighbours on a smooth curve tell far less than 61 measurements.
    assert content["fit"]["n_effective"] < len(loads) * SLIPS / 4
    found = re.findall(r"F_z (\S+) N: RMSE (\S+) N, (\S+)% of F_z", stdout)
    expected = [(fz, miss, 100 * miss / fz) for fz, miss in zip(loads, rmse, strict=True)]
    np.testing.assert_allclose(np.array(found, float), expected, rtol=2e-3, atol=0.006)
    assert "errors are those of the systematic misfit" in " ".join(stdout.split())
    return content


@pytest.mark.long
def test_brush_of_a_tir_agrees_with_scipy(run):
    tir = read_tir(TRUCK)
    tire, fnomin = mf_tire(tir.version, tir.numbers), tir.numbers["FNOMIN"]
    loads = [0.5 * fnomin, fnomin, 1.5 * fnomin]

    alpha = np.linspace(-0.3, 0.3, SLIPS)

    def force(tan_alpha, fz):
        return np.asarray(forces(tire, TireInputs(0.0, np.arctan(tan_alpha), fz)).fy)

    values, rmse = scipy_fit(np.tan(alpha), loads, force)
    result = run("convert", TRUCK, "--force", "fy", "--out", "out")
    content = assert_converted(result.stdout, values, loads, rmse)
    assert content["forces"] == ["fy"]
    assert "alpha = -0.3 to 0.3" in " ".join(content["data"]["assumptions"])
    outside = np.sum((alpha < -0.19499) | (alpha > 0.19769))
    assert re.search(rf"{3 * outside} of 183 rows outside ALPMIN", result.stderr)
    assert {path.name for path in Path("out").iterdir()} >= {"fit.json", "fit.png"}


def test_brush_of_a_magic_formula_curve_agrees_with_scipy(run, no_figures):
    b, c, d, e = 12.0, 1.4, 0.9, -0.5

    def force(sigma, fz):
        x = b * sigma / (1 + sigma)  # the practical slip
        return d * fz * np.sin(c * np.arctan(x - e * (x - np.arctan(x))))

    loads = [2000.0, 4000.0, 6000.0]
    values, rmse = scipy_fit(np.linspace(-0.1, 0.25, SLIPS), loads, force)
    result = run(
        "convert", "--magic-formula", f"{b},{c},{d},{e}", "--loads", "2000,4000,6000",
        "--slip-min", "-0.1", "--slip-max", "0.25", "--out", "out",
    )  # fmt: skip
    content = assert_converted(result.stdout, values, loads, rmse)
    assert content["forces"] == ["fx"]
    said = " ".join(content["data"]["assumptions"])
    assert "B = 12, C = 1.4, D = 0.9, E = -0.5" in said
    assert "sigma_x = -0.1 to 0.25, F_z = 2000, 4000, 6000 N" in said


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ((), "no curve"),
        ((MF52, "--magic-formula", "1,2,1,0", "--loads", "1"), "FILE.tir and --magic"),
        (("--magic-formula", "1,2,1", "--loads", "1"), "give four numbers"),
        (("--magic-formula", "1,2,1,x", "--loads", "1"), "numbers between commas"),
        (("--magic-formula", "10,2,1,0"), "has no nominal load"),
        (("--magic-formula", "10,9,1,0", "--loads", "1"), "C = 9.0 is outside"),
        ((MF52, "--loads", "2000,-1"), "positive loads"),
        ((MF52, "--loads", "2000,2000"), "each once"),
        ((MF52, "--slip-max", "1"), "slips from -1 to 1"),
        ((MF52, "--slip-min", "0.3"), "slips from 0.3 to 0.3"),
        ((MF52, "--slip-max", "nan"), "slips from nan to nan"),
        ((MF52, "--model", "bruhs"), "did you mean brush"),
    ],
)
def test_bad_requests_are_refused_with_a_remedy(run, options, said):
    result = run("convert", *options, "--out", "out", exit_code=2)
    assert said in result.stderr
    assert not Path("out").exists()
