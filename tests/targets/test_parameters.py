"""Parameter files, evaluated by the simulators they are written for."""

import shutil
import sys
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml

import tirefit
from tests.targets import gymkhana_tire_model as gymkhana
from tests.targets.support import (
    LOAD,
    SLIPS,
    SMALL,
    commonroad,
    grids,
    held,
    largest,
    own,
    ran,
    stated,
)
from tests.targets.test_every_model import fit_of
from tirefit.models.mf import mf_tire
from tirefit.results import UsageError
from tirefit.targets.formulas import SLIPX
from tirefit.targets.tire import tire_of

# --- CommonRoad and Gym-Khana -------------------------------------------------------


def std_forces(formulas, p, kappa, alpha, load=LOAD):
    """Forces over load (2, n) as the single-track drift models compute them: their
    kappa is positive when braking."""
    found = []
    for s, angle in zip(-kappa, alpha, strict=True):
        along = formulas.formula_longitudinal(s, 0, load, p)
        across, mu = formulas.formula_lateral(angle, 0, load, p)
        found.append(
            (
                formulas.formula_longitudinal_comb(s, angle, along, p),
                formulas.formula_lateral_comb(s, angle, 0, mu, load, across, p),
            )
        )
    return np.array(found).T / load


@pytest.mark.parametrize(
    "source", ["brush", pytest.param("lugre", marks=pytest.mark.long), "magic-formula-combined"]
)
def test_commonroad_reproduces_the_forces_within_the_stated_error(source, tmp_path):
    pytest.importorskip("vehiclemodels")
    from vehiclemodels.utils import tire_model

    path = tmp_path / "parameters_tire.yaml"
    done = tirefit.export(source, "commonroad", path)
    tire = commonroad(path).tire
    misses = {}
    for kind, at in grids().items():
        misses[kind] = largest(std_forces(tire_model, tire, *at) - own(source, *at), kind)
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


def test_a_magic_formula_of_commonroad_is_recovered_exactly(tmp_path):
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
            at = [slip[::4] for slip in at]
            got = std_forces(tire_model, found, *at, load)
            assert np.max(np.abs(got - own(tire, *at, load))) < 1e-9


def test_gymkhana_has_the_forces_of_commonroad_with_other_keys(tmp_path):
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


def test_one_tire_serves_both_axles_but_one_axle_is_refused(tmp_path):
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


def test_slipx_reproduces_the_lateral_force_within_the_stated_error(tmp_path, vehicle):
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
    assert car.params_for_tier(slipx.Tier.L2_DoubleTrack).tyre_front.relax_length == 0.06


def test_the_friction_of_slipx_falls_by_a_power_of_the_load(tmp_path):
    """Both forces at another load by hand; and the power of a tire whose friction is 1 - 0.1
    dfz, which one load does not determine."""
    p = dict(nominal_load=9.0, c_alpha=130.0, mu_y0=0.8, C=1.5, E=-0.4, k_mu=0.2, c_kappa=90.0)
    alpha, load = 0.05, 15.0
    x = 130 / (1.5 * 0.8 * 9.0) * alpha
    curve = np.sin(1.5 * np.arctan(x + 0.4 * (x - np.arctan(x))))
    share = (load / 9.0) ** (1 - 0.2)
    fx, fy = SLIPX.canonical({**p, "mu_x0": 1.1}, 0.02, alpha, load)
    assert float(fx) == pytest.approx(90 * 0.02 * share, rel=1e-6)
    assert float(fy) == pytest.approx(0.8 * 9.0 * share * curve, rel=1e-6)
    given = {"PDY2": -0.1, "PKY1": -7.5e6, "PKY2": 1e6, "PCY1": 1.5, "FNOMIN": 9.0}
    path = tmp_path / "rubber_floor.yaml"
    tirefit.export(mf_tire("5.2", given), "slipx", path, force=True)
    friction = yaml.safe_load(path.read_text())["friction"]
    assert friction["k_mu"] == pytest.approx(0.1, abs=0.005)


@pytest.mark.long
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


def test_slipx_refuses_other_names(tmp_path):
    done = ran("brush", "--to", "slipx", "--out", tmp_path / "tire.yaml")
    assert done.exit_code == 2 and not list(tmp_path.iterdir())
    assert "sponge_SURFACE.yaml" in done.stderr


# --- Gazebo -------------------------------------------------------------------------


def test_gazebo_has_slope_and_peak(tmp_path, vehicle):
    path = tmp_path / "wheel.sdf"
    values = SMALL | {"stiffness_ratio": 0.7}
    done = tirefit.export("brush-anisotropic", "gazebo", path, values=values, vehicle=vehicle)
    root = ElementTree.fromstring(path.read_text())
    number = {
        one.tag: float(one.text)
        for one in root.iter()
        if one.text and one.text.strip() and one.tag != "fdir1"
    }
    load = number["wheel_normal_force"]
    assert load == pytest.approx(3.5 * 9.80665 / 4)
    assert number["wheel_radius"] == 0.05
    tire = tire_of("brush-anisotropic", values).model
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

    def __init__(self, name, nominal, min_value, max_value, frozen=False, modifier=None):
        self.name, self.bounds, self.modifier = name, (min_value, max_value), modifier
        self.value = np.atleast_1d(nominal)


def test_mujoco_has_the_forces_and_a_friction_for_sysid(tmp_path, monkeypatch):
    path = tmp_path / "tire.py"
    done = tirefit.export("brush", "mujoco", path, values={"mu": 0.7})
    sysid = SimpleNamespace(Parameter=Parameter, ParameterDict=Parameters)
    monkeypatch.setitem(sys.modules, "mujoco", SimpleNamespace(sysid=sysid))
    scope = {}
    exec(path.read_text(), scope)
    found = scope["tire"](np.array([0.02, 0.1]), np.array([0.01, -0.05]), LOAD)[:2]
    wanted = own(tire_of("brush", {"mu": 0.7}).model, *np.array([[0.02, 0.1], [0.01, -0.05]]))
    assert np.max(np.abs(np.stack(found) / LOAD - wanted)) < 1e-12
    geoms = {"left": SimpleNamespace(friction=[1.0, 0.005, 1e-4])}
    (parameter,) = scope["sysid_parameters"](["left"]).values()
    parameter.modifier(SimpleNamespace(geom=geoms.get), parameter)
    assert geoms["left"].friction == pytest.approx([0.7, 0.005, 1e-4])
    assert parameter.bounds == pytest.approx((0.56, 0.84)) and done.shape.sound
    # Three standard errors of a fitted friction.
    exec(tirefit.export(fit_of("brush"), "mujoco", path, name="tire").path.read_text(), scope)
    (parameter,) = scope["sysid_parameters"](["left"]).values()
    assert parameter.bounds == pytest.approx((0.97, 1.03))


class Parameters(dict):
    """The interface of ``mujoco.sysid.ParameterDict``."""

    def add(self, parameter):
        self[parameter.name] = parameter
