"""Refits of simulators' formulas; reports and refusals of an export."""

import re

import jax.numpy as jnp
import numpy as np
import pytest
import yaml

import tirefit
from tests.targets.support import CAR, LOAD, SMALL, WHOLE, commonroad, ran
from tirefit.models import AbstractTire, MagicFormula, TireForces, TireInputs, forces
from tirefit.models.mf import mf_tire
from tirefit.results import UsageError
from tirefit.targets.formulas import PACEJKA
from tirefit.targets.refit import ranges_of, refit
from tirefit.targets.tire import tire_of


class Unknown(AbstractTire):
    """A Magic Formula that the conversion by formula does not recognise."""

    inner: MagicFormula = MagicFormula(12.0, 1.7, 0.9, -0.4)

    def __call__(self, inputs):
        return self.inner(inputs)


def test_least_squares_finds_the_coefficients_of_a_magic_formula():
    tire = tire_of(Unknown())
    found = refit(tire, PACEJKA, ranges_of(tire, {}))
    assert found.refitted == ("fy",) and found.largest < 1e-6
    wanted = {"B": 12.0, "C": 1.7, "D": 0.9, "E": -0.4}
    assert found.values == pytest.approx(wanted, rel=1e-3)


class Broken(AbstractTire):
    """A lateral force that ends at a slip angle of 0.15 rad."""

    def __call__(self, inputs):
        fy = inputs.fz * jnp.sqrt(0.15**2 - inputs.alpha**2) * inputs.alpha
        return TireForces(None, fy, None)


def test_a_tire_without_force_in_the_range_is_refused(tmp_path):
    path = tmp_path / "car.yaml"
    tire = mf_tire("5.2", {"FNOMIN": LOAD}, lacks=["fy"])
    with pytest.raises(UsageError, match="no fy to be written"):
        tirefit.export(tire, "forzaeth", path)
    with pytest.raises(UsageError, match="not finite within the range"):
        tirefit.export(Broken(), "forzaeth", path)
    assert not list(tmp_path.iterdir())
    done = tirefit.export(Broken(), "commonroad", path, over={"alpha": (-0.1, 0.1)}, force=True)
    assert any("no fx: that of the other axis" in note for note in done.notes)


def test_the_file_begins_with_range_errors_and_losses(tmp_path):
    angle = np.linspace(-0.15, 0.15, 60)
    force = np.asarray(forces(tire_of("brush").model, TireInputs(0.0, angle, 3000.0)).fy)
    force = force + 20 * np.random.default_rng(1).standard_normal(60)
    data = {"alpha": angle, "fz": np.full(60, 3000.0), "fy": force}
    fit = tirefit.fit(data, "brush")
    path = tmp_path / "parameters_tire.yaml"
    tirefit.export(fit, "commonroad", path)
    text = path.read_text()
    head = text[: text.index("tire:\n  p_cx1")].splitlines()
    assert all(line.startswith("#") for line in head)
    assert "alpha -0.15 to 0.15 rad, fz 3000 N" in head[1] and "largest error" in head[1]
    line = next(one for one in head if "cpa2 = " in one)
    std = fit.least_squares["cpa2"].std
    assert float(line.split("+-")[1].split()[0]) == pytest.approx(std, rel=0.06)
    for part in ("mz of the tire is not included", "fx was not fitted", "positive when braking"):
        assert any(part in line for line in head)
    assert not any("mz was not fitted" in line for line in head)


def test_a_large_error_is_refused_without_force(tmp_path):
    path = tmp_path / "parameters_tire.yaml"
    given = ["brush", "--to", "commonroad", "--out", path, "--over", "fz=2000:6000"]
    done = ran(*given)
    assert done.exit_code == 2 and not path.exists()
    assert "above 5 %" in done.stderr and "--over" in done.stderr
    done = ran(*given, "--force")
    assert done.exit_code == 0 and "warning: commonroad differs" in done.stderr
    assert "fz 2000 to 6000 N" in path.read_text()


def test_missing_data_of_the_vehicle_are_named(tmp_path, vehicle):
    vehicle.write_text(CAR)
    path = tmp_path / "parameters_tire.yaml"
    done = ran("brush", "--to", "commonroad", "--vehicle", vehicle, "--out", path)
    assert done.exit_code == 2 and not path.exists()
    for part in ("vehicle.toml", "'h_cg'", "'wheel_radius'", "add h_cg"):
        assert part in done.stderr
    vehicle.write_text(WHOLE)
    done = ran("magic-formula", "--to", "commonroad", "--vehicle", vehicle, "--out", path)
    assert done.exit_code == 0
    p = commonroad(path)
    found = (p.m, p.a, p.b, p.I_z, p.h_s, p.R_w)
    assert found == pytest.approx((3.5, 0.16, 0.17, 0.05, 0.07, 0.05))
    assert p.I_y_w == 1.7  # what vehicle.toml does not have stays CommonRoad's
    from vehiclemodels.vehicle_dynamics_std import vehicle_dynamics_std

    # At 8 m/s, wheels that roll and steer by 0.02 rad to the left turn the car left.
    rolling = 8.0 / p.R_w
    state = [0.0, 0.0, 0.02, 8.0, 0.0, 0.0, 0.0, rolling, rolling]
    rates = vehicle_dynamics_std(state, [0.0, 0.0], p)
    force = 3.5 * 9.81 * 0.17 / 0.33 * np.sin(1.5 * np.arctan(10.0 * 0.02))
    assert rates[5] == pytest.approx(force * 0.16 / 0.05, rel=0.01)


def test_a_fit_of_an_axle_is_converted_to_one_tire(tmp_path, vehicle):
    angle = np.linspace(-0.2, 0.2, 60)
    model = tire_of("brush", SMALL).model
    axle = 3.5 * 9.80665 * 0.17 / 0.33
    given = TireInputs(0.0, angle, axle)
    data = {"alpha": angle, "fz": np.full(60, axle), "fy": forces(model, given).fy}
    fit = tirefit.fit(data, "brush")
    path = tmp_path / "rubber_floor.yaml"
    done = tirefit.export(None, "slipx", path, front=fit, vehicle=vehicle)
    assert any("an axle of two tires" in note for note in done.notes)
    content = yaml.safe_load(path.read_text())
    assert content["nominal_load"] == pytest.approx(axle / 2)
    assert content["linear"]["c_kappa"] == pytest.approx(130.0, rel=1e-3)
    tirefit.export(None, "gazebo", tmp_path / "wheel.sdf", front=fit, vehicle=vehicle)
    text = (tmp_path / "wheel.sdf").read_text()
    (load,) = re.findall("<wheel_normal_force>(.*)</wheel_normal_force>", text)
    assert float(load) == pytest.approx(axle / 2)


def test_contradicting_options_are_refused(tmp_path):
    path = tmp_path / "x.yaml"
    done = ran("brush", "--to", "comonroad", "--out", path)
    assert done.exit_code == 2 and "did you mean 'commonroad'" in done.stderr
    done = ran("brush", "--to", "commonroad", "--convention", "sae", "--out", path)
    assert done.exit_code == 2 and "leave it out" in done.stderr
    done = ran("brush", "--to", "commonroad", "--front", "lugre", "--out", path)
    assert done.exit_code == 2 and "give one tire" in done.stderr
    done = ran("brush", "--to", "commonroad", "--over", "fz=9:1", "--out", path)
    assert done.exit_code == 2 and "NAME=LOW:HIGH" in done.stderr
    done = ran("brush", "--to", "c", "--over", "fz=1:9", "--out", tmp_path / "x.h")
    assert done.exit_code == 2 and "leave it out" in done.stderr
    assert not list(tmp_path.iterdir())
