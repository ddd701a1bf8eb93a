"""Parameter files, evaluated by the simulators that they are for."""

import re
import shutil
import sys
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

import jax.numpy as jnp
import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

import tirefit
from tests.targets import gymkhana_tire_model as gymkhana
from tirefit.cli.commands import app
from tirefit.models import (
    AbstractTire,
    MagicFormula,
    TireForces,
    TireInputs,
    forces,
)
from tirefit.models.mf import mf_tire
from tirefit.results import UsageError
from tirefit.slip import sigma_from_kappa
from tirefit.targets.formulas import PACEJKA
from tirefit.targets.refit import ranges_of, refit
from tirefit.targets.tire import tire_of

LOAD = 4000.0
MISS = re.compile(
    r"(F_x of pure|F_y of pure|combined) slip [^;]*largest miss ([\d.]+) %"
)
KINDS = {"F_x of pure": "fx", "F_y of pure": "fy", "combined": "both"}
SLIPS = np.linspace(-0.2, 0.2, 401)


def grids():
    """ISO-W kappa, alpha (n,) by kind of slip, finer than those of the export."""
    zero, some = np.zeros_like(SLIPS), np.linspace(-0.2, 0.2, 61)
    both = [one.ravel() for one in np.meshgrid(some, some)]
    return {"fx": (SLIPS, zero), "fy": (zero, SLIPS), "both": both}


def own(source, kappa, alpha, load=LOAD):
    """Our forces over load (2, n), in the signs of ISO-W."""
    given = TireInputs(sigma_from_kappa(-kappa), alpha, np.full_like(alpha, load), 10.0)
    model = tire_of(source).model
    return -np.stack([forces(model, given).fx, forces(model, given).fy]) / load


def largest(miss, kind):
    """Largest length of a miss (2, n) of the forces that a kind of slip compares."""
    rows = {"fx": [0], "fy": [1], "both": [0, 1]}[kind]
    return np.max(np.linalg.norm(miss[rows], axis=0))


def stated(notes):
    """The misses over load that an export states, by kind of slip."""
    text = "; ".join(notes)
    return {KINDS[kind]: float(miss) / 100 for kind, miss in MISS.findall(text)}


def held(misses, notes, exact=()):
    """Asserts that the true misses are those that are stated, rounded up to two digits;
    a finer grid may find a little more."""
    told = stated(notes)
    assert set(told) == set(misses) - set(exact)
    for kind, miss in misses.items():
        if kind in exact:
            assert miss < 1e-9
        else:
            assert miss < 1.02 * told[kind] and told[kind] < 1.2 * miss


# --- CommonRoad and Gym-Khana -------------------------------------------------------


def std_forces(formulas, p, kappa, alpha, load=LOAD):
    """Forces over load (2, n) as the single-track drift models compute them: their
    kappa is positive when braking."""
    found = []
    for s, angle in zip(-kappa, alpha, strict=True):
        along = formulas.formula_longitudinal(s, 0, load, p)
        across, mu = formulas.formula_lateral(angle, 0, load, p)
        found.append((
            formulas.formula_longitudinal_comb(s, angle, along, p),
            formulas.formula_lateral_comb(s, angle, 0, mu, load, across, p),
        ))  # fmt: skip
    return np.array(found).T / load


def commonroad(path):
    """CommonRoad's reader on our file beside its own first vehicle."""
    models = pytest.importorskip("vehiclemodels.vehicle_parameters")
    own_files = Path(models.__file__).parent / "parameters"
    shutil.copy(own_files / "parameters_vehicle1.yaml", path.parent)
    return models.setup_vehicle_parameters(vehicle_id=1, dir_params=path.parent)


@pytest.mark.parametrize("source", ["brush", "lugre", "magic-formula-combined"])
def test_commonroad_gives_our_forces_within_the_stated_miss(source, tmp_path):
    pytest.importorskip("vehiclemodels")
    from vehiclemodels.utils import tire_model

    path = tmp_path / "parameters_tire.yaml"
    done = tirefit.export(source, "commonroad", path)
    tire = commonroad(path).tire
    misses = {}
    for kind, at in grids().items():
        misses[kind] = largest(
            std_forces(tire_model, tire, *at) - own(source, *at), kind
        )
    exact = ("fx", "fy") if source.startswith("magic") else ()
    held(misses, done.notes, exact)
    assert done.shape.sound


ADAMS = "cx1 dx1 ex1 kx1 hx1", "cy1 dy1 ey1", "bx1 bx2 cx1 ex1 hx1 by1 by2 by3 cy1 ey1"


def adams_tire():
    """CommonRoad's own tire as a Magic Formula 5.2 without shifts of F_y: PKY2 is so
    large that the cornering stiffness is proportional to load."""
    models = pytest.importorskip("vehiclemodels.vehicle_parameters")
    p = models.setup_vehicle_parameters(vehicle_id=1).tire
    given = {f"P{n.upper()}": getattr(p, f"p_{n}") for n in " ".join(ADAMS[:2]).split()}
    names = f"{ADAMS[2]} vy1 vy4 vy5".split()
    given |= {f"R{n.upper()}": getattr(p, f"r_{n}") for n in names}
    given |= {"RHY1": -p.r_hy1, "RVY6": -p.r_vy6}
    given |= {"PKY1": p.p_ky1 * 5e6, "PKY2": 1e7, "FNOMIN": LOAD}
    return p, mf_tire("5.2", given)


def test_a_magic_formula_of_commonroad_comes_back_exactly(tmp_path):
    pytest.importorskip("vehiclemodels")
    from vehiclemodels.utils import tire_model

    truth, tire = adams_tire()
    path = tmp_path / "parameters_tire.yaml"
    over = {"fz": (2000.0, 6000.0)}
    done = tirefit.export(tire, "commonroad", path, over=over)
    assert not stated(done.notes) and "exactly" in done.notes[0]
    found = commonroad(path).tire
    for name in " ".join(ADAMS[:2]).split():
        assert getattr(found, f"p_{name}") == pytest.approx(getattr(truth, f"p_{name}"))
    for name in ("hy1", "vy1", "vy6", "by3"):
        assert getattr(found, f"r_{name}") == pytest.approx(getattr(truth, f"r_{name}"))
    for load in (2500.0, 6000.0):
        for at in grids().values():
            got = std_forces(tire_model, found, *at, load)
            assert np.max(np.abs(got - own(tire, *at, load))) < 1e-9


def test_gymkhana_has_the_forces_of_commonroad_under_its_own_keys(tmp_path):
    path = tmp_path / "tire.yaml"
    done = tirefit.export("brush", "gymkhana", path)
    p = yaml.safe_load(path.read_text())
    misses = {}
    for kind, at in grids().items():
        misses[kind] = largest(std_forces(gymkhana, p, *at) - own("brush", *at), kind)
    held(misses, done.notes)


# --- four coefficients --------------------------------------------------------------


def pacejka(b, c, d, e, alpha):
    return d * np.sin(c * np.arctan(b * alpha - e * (b * alpha - np.arctan(b * alpha))))


CAR = "mass = 3.5\nl_f = 0.16\nl_r = 0.17\nyaw_inertia = 0.05\n"
WHOLE = CAR + "h_cg = 0.07\nwheel_radius = 0.05\n"
SMALL = {"cpa2": 130.0}
"""A brush for the load of a car of 1:10."""


@pytest.fixture
def vehicle(tmp_path):
    path = tmp_path / "vehicle.toml"
    path.write_text(WHOLE)
    return path


@pytest.mark.parametrize("target", ["forzaeth", "gymkhana-stp"])
def test_four_coefficients_of_both_axles(target, tmp_path, vehicle):
    path, rear = tmp_path / "car.yaml", tire_of("magic-formula").model
    front = tire_of("brush", {"cpa2": 70.0}).model
    done = tirefit.export(None, target, path, front=front, rear=rear, vehicle=vehicle)
    car = yaml.safe_load(path.read_text())
    if target == "forzaeth":
        # Its alpha is minus that of ISO-W, its F_y positive to the left.
        coefficients, lengths, sign = (car["C_Pf"], car["C_Pr"]), ("l_f", "l_r"), -1
        assert car["l_wb"] == pytest.approx(0.33) and car["h_cg"] == 0.07
    else:
        coefficients = [[car[f"{k}_{axle}"] for k in "BCDE"] for axle in "fr"]
        lengths, sign = ("lf", "lr"), 1
        assert car["h_s"] == 0.07
    assert [car[name] for name in lengths] == [0.16, 0.17]
    assert (car["m"], car["I_z"], car["mu"]) == (3.5, 0.05, 1.0)
    zero = np.zeros_like(SLIPS)
    static = 3.5 * 9.80665 * np.array([0.17, 0.16]) / 0.33 / 2
    for k, (source, exact) in enumerate(((front, ()), (rear, ("fy",)))):
        got = -sign * pacejka(*coefficients[k], sign * SLIPS)
        miss = np.max(np.abs(got - own(source, zero, SLIPS, static[k])[1]))
        held({"fy": miss}, [done.notes[0]] if k == 0 else [], exact)


def test_one_tire_is_both_axles_and_one_axle_is_no_car(tmp_path):
    path = tmp_path / "car.yaml"
    done = tirefit.export("magic-formula", "forzaeth", path)
    car = yaml.safe_load(path.read_text())
    assert car["C_Pf"] == car["C_Pr"] == [10.0, 1.5, 1.0, 0.0]
    assert any("front and rear are alike" in note for note in done.notes)
    with pytest.raises(UsageError, match="give --rear as well"):
        tirefit.export(None, "forzaeth", path, front="magic-formula")
    with pytest.raises(UsageError, match="one tire for all wheels"):
        tirefit.export(None, "gymkhana", path, front="brush", rear="lugre")


# --- SlipX --------------------------------------------------------------------------


def slipx_tyre(path, folder):
    """SlipX's reader on its reference car with our tyre file, and the core's tyre."""
    slipx = pytest.importorskip("slipx")
    car = folder / "car"
    shutil.copytree(slipx.reference_car_path(), car)
    shutil.copy(path, car / "tyres")
    compound, surface = path.stem.split("_")
    text = (car / "dynamics.yaml").read_text().replace("sponge", compound)
    (car / "dynamics.yaml").write_text(text.replace("carpet", surface))
    spec = slipx.load_car(car).spec.tyre_front
    given = slipx.TyreCoefficients()
    given.mu_y0, given.mu_x0, given.k_mu = spec.mu_y0, spec.mu_x0, spec.k_mu
    given.shape_c, given.curvature_e = spec.mf_lite["C"], spec.mf_lite["E"]
    return slipx, spec, slipx.make_mf_lite(given, spec.c_alpha, spec.nominal_load)


def test_slipx_gives_our_lateral_force_within_the_stated_miss(tmp_path, vehicle):
    path = tmp_path / "rubber_floor.yaml"
    values = {"cpa2": 70.0}
    done = tirefit.export("brush", "slipx", path, values=values, vehicle=vehicle)
    slipx, spec, tyre = slipx_tyre(path, tmp_path)
    load = 3.5 * 9.80665 / 4
    assert spec.nominal_load == pytest.approx(load)
    got = np.array([slipx.mf_lite_fy(tyre, a, load) for a in SLIPS]) / load
    tire = tire_of("brush", values).model
    miss = np.max(np.abs(got - own(tire, np.zeros_like(SLIPS), SLIPS, load)[1]))
    held({"fy": miss}, done.notes)
    # By definition: slope at zero slip, and peak, of F_x at the nominal load.
    at = own(tire, np.array([-1e-4, 1e-4]), np.zeros(2), load)[0]
    assert spec.c_kappa == pytest.approx((at[1] - at[0]) / 2e-4 * load, rel=1e-3)
    assert slipx.peak_longitudinal_force(tyre, load) == pytest.approx(load, rel=1e-3)


def test_slipx_has_the_relaxation_length(tmp_path, vehicle):
    path = tmp_path / "rubber_floor.yaml"
    values = {"relaxation_length": 0.06}
    model = "magic-formula-relaxation"
    tirefit.export(model, "slipx", path, values=values, vehicle=vehicle)
    slipx, spec, _ = slipx_tyre(path, tmp_path)
    assert spec.sigma == 0.06
    car = slipx.load_car(tmp_path / "car")
    assert (
        car.params_for_tier(slipx.Tier.L2_DoubleTrack).tyre_front.relax_length == 0.06
    )


def test_slipx_falls_with_load_as_the_tire_does(tmp_path):
    # The cornering stiffness is -15 F_z.
    given = {"PDY1": 1.0, "PDY2": -0.1, "PKY1": -7.5e6, "PKY2": 1e6, "PCY1": 1.5}
    tire = mf_tire("5.2", given | {"FNOMIN": 9.0})
    path = tmp_path / "rubber_floor.yaml"
    over = {"fz": (6.0, 12.0)}
    done = tirefit.export(tire, "slipx", path, over=over, force=True)
    slipx, spec, tyre = slipx_tyre(path, tmp_path)
    # The friction falls by load to the power of 0.1, the stiffness over load does not.
    assert 0.05 < spec.k_mu < 0.1
    zero, worst = np.zeros_like(SLIPS), 0.0
    for load in np.linspace(6.0, 12.0, 13):
        got = np.array([slipx.mf_lite_fy(tyre, a, load) for a in SLIPS]) / load
        worst = max(worst, np.max(np.abs(got - own(tire, zero, SLIPS, load)[1])))
    held({"fy": worst}, done.notes)


def test_slipx_takes_no_car_of_full_size_and_no_other_name(tmp_path):
    done = ran("brush", "--to", "slipx", "--out", tmp_path / "tire.yaml")
    assert done.exit_code == 2 and not list(tmp_path.iterdir())
    for part in ("sponge_SURFACE.yaml", "up to 200", "1:10"):
        assert part in done.stderr


# --- Gazebo -------------------------------------------------------------------------


def test_gazebo_has_slope_and_peak(tmp_path, vehicle):
    path = tmp_path / "wheel.sdf"
    done = tirefit.export("brush", "gazebo", path, values=SMALL, vehicle=vehicle)
    root = ElementTree.fromstring(path.read_text())
    number = {
        one.tag: float(one.text) for one in root.iter()
        if one.text and one.text.strip() and one.tag != "fdir1"
    }  # fmt: skip
    load = number["wheel_normal_force"]
    assert load == pytest.approx(3.5 * 9.80665 / 4)
    assert number["wheel_radius"] == 0.05
    tire = tire_of("brush", SMALL).model
    step, zero = np.array([-1e-4, 1e-4]), np.zeros(2)
    for k, (name, mu) in enumerate((("longitudinal", "mu2"), ("lateral", "mu"))):
        at = own(tire, *((step, zero) if k == 0 else (zero, step)), load)[k]
        slope = abs(at[1] - at[0]) / 2e-4
        assert 1 / number[f"slip_compliance_{name}"] == pytest.approx(slope, rel=1e-3)
        assert number[mu] == pytest.approx(1.0, rel=1e-3)
    # A friction pyramid is square: the check of the shape is that of the formula.
    assert not done.shape.sound and "NOT within" in done.shape.sentences[4]
    clipped = np.clip(-SLIPS / number["slip_compliance_lateral"], -1, 1)
    miss = np.max(np.abs(clipped - own(tire, np.zeros_like(SLIPS), SLIPS, load)[1]))
    # The formula takes tan(alpha), which is 1.3 % more than alpha at 0.2 rad.
    assert stated(done.notes)["fy"] == pytest.approx(miss, rel=0.1)


# --- MuJoCo -------------------------------------------------------------------------


class Parameter:
    """The interface of ``mujoco.sysid.Parameter`` of mujoco 4.0.0."""

    def __init__(
        self, name, nominal, min_value, max_value, frozen=False, modifier=None
    ):
        self.name, self.bounds, self.modifier = name, (min_value, max_value), modifier
        self.value = np.atleast_1d(nominal)


def test_mujoco_has_our_forces_and_a_friction_for_sysid(tmp_path, monkeypatch):
    path = tmp_path / "tire.py"
    done = tirefit.export("brush", "mujoco", path, values={"mu": 0.7})
    sysid = SimpleNamespace(Parameter=Parameter, ParameterDict=Parameters)
    monkeypatch.setitem(sys.modules, "mujoco", SimpleNamespace(sysid=sysid))
    scope = {}
    exec(path.read_text(), scope)
    found = scope["tire"](np.array([0.02, 0.1]), np.array([0.01, -0.05]), LOAD)[:2]
    wanted = own(
        tire_of("brush", {"mu": 0.7}).model, *np.array([[0.02, 0.1], [0.01, -0.05]])
    )
    assert np.max(np.abs(np.stack(found) / LOAD - wanted)) < 1e-12
    geoms = {"left": SimpleNamespace(friction=[1.0, 0.005, 1e-4])}
    (parameter,) = scope["sysid_parameters"](["left"]).values()
    parameter.modifier(SimpleNamespace(geom=geoms.get), parameter)
    assert geoms["left"].friction == pytest.approx([0.7, 0.005, 1e-4])
    assert parameter.bounds == pytest.approx((0.56, 0.84)) and done.shape.sound


class Parameters(dict):
    """The interface of ``mujoco.sysid.ParameterDict``."""

    def add(self, parameter):
        self[parameter.name] = parameter


# --- the refit and its reports ------------------------------------------------------


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


def test_a_tire_without_the_force_or_with_none_in_the_range_is_refused(tmp_path):
    path = tmp_path / "car.yaml"
    tire = mf_tire("5.2", {"FNOMIN": LOAD}, lacks=["fy"])
    with pytest.raises(UsageError, match="no fy to be written"):
        tirefit.export(tire, "forzaeth", path)
    with pytest.raises(UsageError, match="not finite within the range"):
        tirefit.export(Broken(), "forzaeth", path)
    assert not list(tmp_path.iterdir())
    done = tirefit.export(
        Broken(), "commonroad", path, over={"alpha": (-0.1, 0.1)}, force=True
    )
    assert any("no fx: that of the other axis" in note for note in done.notes)


def test_the_file_states_range_miss_errors_and_loss_first(tmp_path):
    angle = np.linspace(-0.15, 0.15, 60)
    force = np.asarray(
        forces(tire_of("brush").model, TireInputs(0.0, angle, 3000.0)).fy
    )
    force = force + 20 * np.random.default_rng(1).standard_normal(60)
    data = {"alpha": angle, "fz": np.full(60, 3000.0), "fy": force}
    fit = tirefit.fit(data, "brush")
    path = tmp_path / "parameters_tire.yaml"
    tirefit.export(fit, "commonroad", path)
    text = path.read_text()
    head = text[: text.index("tire:\n  p_cx1")].splitlines()
    assert all(line.startswith("#") for line in head)
    assert "alpha -0.15 to 0.15 rad, fz 3000 N" in head[1] and "largest miss" in head[1]
    assert "at 0.75 and 1.25 times this load" in head[2]
    line = next(one for one in head if "cpa2 = " in one)
    std = fit.least_squares["cpa2"].std
    assert float(line.split("+-")[1].split()[0]) == pytest.approx(std, rel=0.06)
    for part in (
        "mz of the tire has no place",
        "fx was not fitted",
        "positive when braking",
    ):
        assert any(part in line for line in head)


def test_a_large_miss_needs_force(tmp_path):
    path = tmp_path / "parameters_tire.yaml"
    given = ["brush", "--to", "commonroad", "--out", path, "--over", "fz=2000:6000"]
    done = ran(*given)
    assert done.exit_code == 2 and not path.exists()
    assert "above 5 %" in done.stderr and "--over" in done.stderr
    done = ran(*given, "--force")
    assert done.exit_code == 0 and "warning: commonroad misses" in done.stderr
    assert "fz 2000 to 6000 N" in path.read_text()


def test_missing_data_of_the_vehicle_are_named(tmp_path, vehicle):
    vehicle.write_text(CAR)
    path = tmp_path / "parameters_tire.yaml"
    done = ran("brush", "--to", "commonroad", "--vehicle", vehicle, "--out", path)
    assert done.exit_code == 2 and not path.exists()
    for part in ("vehicle.toml", "'h_cg'", "'wheel_radius'", "add h_cg"):
        assert part in done.stderr
    vehicle.write_text(WHOLE)
    done = ran(
        "magic-formula", "--to", "commonroad", "--vehicle", vehicle, "--out", path
    )
    assert done.exit_code == 0
    p = commonroad(path)
    found = (p.m, p.a, p.b, p.I_z, p.h_s, p.R_w)
    assert found == pytest.approx((3.5, 0.16, 0.17, 0.05, 0.07, 0.05))
    assert p.I_y_w == 1.7  # what vehicle.toml does not have stays CommonRoad's


def test_a_fit_of_an_axle_becomes_one_of_a_tire(tmp_path, vehicle):
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


def test_what_does_not_belong_together_is_refused(tmp_path):
    path = tmp_path / "x.yaml"
    done = ran("brush", "--to", "comonroad", "--out", path)
    assert done.exit_code == 2 and "did you mean 'commonroad'" in done.stderr
    done = ran("brush", "--to", "commonroad", "--convention", "sae", "--out", path)
    assert done.exit_code == 2 and "leave --convention out" in done.stderr
    done = ran("brush", "--to", "commonroad", "--front", "lugre", "--out", path)
    assert done.exit_code == 2 and "give one tire" in done.stderr
    done = ran("brush", "--to", "commonroad", "--over", "fz=9:1", "--out", path)
    assert done.exit_code == 2 and "NAME=LOW:HIGH" in done.stderr
    done = ran("brush", "--to", "c", "--over", "fz=1:9", "--out", tmp_path / "x.h")
    assert done.exit_code == 2 and "leave them out" in done.stderr
    assert not list(tmp_path.iterdir())


def ran(*arguments):
    return CliRunner().invoke(app, ["export", *map(str, arguments)])
