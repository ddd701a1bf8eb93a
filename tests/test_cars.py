"""The tires in ``fits/cars``, loaded by the software that they are for, give the forces of the
brush with the parameters in the README."""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml

from fits.formulas import brush
from tests.targets import gymkhana_tire_model as gymkhana
from tests.targets.support import commonroad
from tests.targets.test_parameters import pacejka, slipx_tyre, std_forces

CARS = Path(__file__).parents[1] / "fits" / "cars"
ROW = re.compile(r"\| (\w+) \| `([\w.]+)` \| (\S+) ± (\S+) \| (\S+) to (\S+) \|")
TABLE = {(car, name): [*map(float, more)] for car, name, *more in ROW.findall(
    (CARS / "README.md").read_text("utf-8"))}  # fmt: skip
"""Car, parameter -> value, standard error and ends of the interval."""
LOADS = {"f1tenth_a": 5.1 * 9.80665 / 2, "f1tenth_d": 5.1 * 9.80665 / 2, "dart": 0.733 * 9.80665}
BOTH = ("f1tenth_a", "f1tenth_d")
ALPHA = np.linspace(-0.16, 0.16, 65)
"""Slip angles that were measured on every axle."""
MOST = 0.014
"""Largest error over load of F_y that the files state, 1.3 %, and the digits of the README."""


def fy(car, axle):
    """F_y over the load (n,), positive to the left for a positive slip angle as here."""
    cpa2, mu = (TABLE[car, f"{axle}.{name}"][0] for name in ("cpa2", "mu"))
    force = brush(np.tan(np.abs(ALPHA)), LOADS[car], 0.0, cpa2, mu)
    return np.sign(ALPHA) * force / LOADS[car]


def agrees(got, car, axle):
    assert np.max(np.abs(got - fy(car, axle))) < MOST


@pytest.mark.parametrize("car", LOADS)
def test_commonroad_and_gymkhana(car, tmp_path):
    models = pytest.importorskip("vehiclemodels.utils.tire_model")
    zero = np.zeros_like(ALPHA)
    path = shutil.copy(CARS / car / "parameters_tire.yaml", tmp_path)
    given = {models: commonroad(Path(path)).tire}
    given[gymkhana] = yaml.safe_load((CARS / car / "gymkhana.yaml").read_text())
    for formulas, tire in given.items():
        # In ISO axes a positive slip angle gives a negative force.
        agrees(-std_forces(formulas, tire, zero, ALPHA, LOADS[car])[1], car, "rear")


@pytest.mark.parametrize("car", BOTH)
def test_four_coefficients(car):
    forzaeth, stp = (
        yaml.safe_load((CARS / car / f"{name}.yaml").read_text())
        for name in ("forzaeth", "gymkhana-stp")
    )
    for k, axle in zip("fr", ("front", "rear"), strict=True):
        agrees(pacejka(*forzaeth[f"C_P{k}"], ALPHA), car, axle)
        # Its force is to the left for a slip angle to the right.
        agrees(-pacejka(*(stp[f"{name}_{k}"] for name in "BCDE"), -ALPHA), car, axle)


@pytest.mark.parametrize("car", LOADS)
def test_slipx(car, tmp_path):
    for path in (CARS / car).glob("rubber_*.yaml"):
        (tmp_path / path.stem).mkdir()
        slipx, spec, tyre = slipx_tyre(path, tmp_path / path.stem)
        load = LOADS[car] / 2
        assert spec.nominal_load == pytest.approx(load, rel=1e-3)
        got = np.array([slipx.mf_lite_fy(tyre, a, load) for a in ALPHA]) / load
        agrees(-got, car, path.stem.removeprefix("rubber_"))


@pytest.mark.parametrize("car", BOTH)
def test_f1tenth_gym_has_the_slope_at_zero_slip_with_its_interval(car):
    text = (CARS / car / "f1tenth_gym.yaml").read_text()
    p = yaml.safe_load(text)
    assert set(p) < {"mu", "C_Sf", "C_Sr", "lf", "lr", "h", "m", "I", "s_min", "s_max"}
    for key, axle in (("C_Sf", "front"), ("C_Sr", "rear")):
        slope = 2 * TABLE[car, f"{axle}.cpa2"][0]
        assert p["mu"] * p[key] * LOADS[car] == pytest.approx(slope, rel=2e-3)
        low, high = map(float, re.search(rf"{key}.*: (\S+) to (\S+)$", text, re.M).groups())
        own, of_mu = (TABLE[car, f"{a}.{n}"] for a, n in ((axle, "cpa2"), ("rear", "mu")))
        wide = 2 * 1.96 * np.hypot(own[1] / own[0], of_mu[1] / of_mu[0])
        # Stiffness and friction of the rear are correlated.
        assert low < p[key] < high and (high - low) / p[key] == pytest.approx(wide, rel=0.25)


@pytest.mark.parametrize("car", BOTH)
def test_autoware(car):
    (p,) = yaml.safe_load((CARS / car / "autoware.param.yaml").read_text())["/**"].values()
    assert p["steer_time_delay"] == pytest.approx(TABLE[car, "steering_delay"][0], rel=1e-3)
    offset, error, *_ = TABLE[car, "steering_offset"]
    assert ("steer_bias" in p) == (error <= 0.005)  # only a bias that is known well enough
    assert p.get("steer_bias", -offset) == pytest.approx(-offset, rel=1e-3)
    assert p["wheel_base"] == 0.33 and "steer_time_constant" not in p


def test_every_file_states_the_estimates_of_the_table():
    ours = [path for path in CARS.glob("*/*.yaml") if "cpa2" in path.read_text()]
    assert len(ours) == 15
    line = re.compile(r"#   (cpa2|mu) = (\S+) \+- \S+(?: N)?, 95 %: (\S+) to (\S+)$", re.M)
    for path in ours:
        axles = ["rear"] if "front" not in path.name else ["front"]
        if path.stem in ("forzaeth", "gymkhana-stp"):
            axles = ["front", "rear"]
        told = line.findall(path.read_text())
        assert len(told) == 2 * len(axles), path
        for (name, *numbers), axle in zip(told, np.repeat(axles, 2), strict=True):
            value, _, *ends = TABLE[path.parent.name, f"{axle}.{name}"]
            np.testing.assert_allclose([float(x) for x in numbers], [value, *ends], rtol=1e-3)
