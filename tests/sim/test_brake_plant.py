"""The braked car and its tires checked by energy, textbook and finite differences."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from stops import RATE, VALUES, check_energy, check_locked_distance, smooth, stopped

from tirefit.models import MODELS, TireInputs, forces
from tirefit.online.braking.abs import ConventionalABS
from tirefit.params import with_values
from tirefit.sim.brake import contacts, rolling, xbs_true
from tirefit.sim.brake_request import plant_of
from tirefit.sim.brake_result import summarise
from tirefit.sim.brake_vehicle import GRAVITY, Slips

touched = eqx.filter_jit(contacts)
slope_of = eqx.filter_jit(xbs_true)


@jax.jit
def pulled(tire, mu, slips, fz):
    """Peaks of four wheels, and forces at slips (n,) under the load of the first."""
    n = len(slips.kappa)
    peaks = tire.peaks(jnp.full(4, mu), slips.speed[:4], fz)
    return peaks, tire.forces(jnp.full(n, mu), slips, jnp.full(n, fz[0]))


def test_energy_is_conserved():
    check_energy("car")


def test_the_distance_with_locked_wheels_agrees_with_the_textbook():
    check_locked_distance("car")


@pytest.mark.parametrize(
    ("model", "values"),
    [
        ("lugre", {}),
        ("magic-formula", {"B": 10.0, "C": 1.6}),
        pytest.param("magic-formula-combined", {}, marks=pytest.mark.long),
        pytest.param("brush-h", {"h": 0.6}, marks=pytest.mark.long),
        pytest.param("liu-peng", {}, marks=pytest.mark.long),
    ],
)
def test_other_tires_have_the_friction_of_the_road(model, values):
    plant = plant_of(smooth(model, values, vehicle="car", road="mu=0.5", speed=12.0))
    fz, n = plant.vehicle.fz, 400
    slips = Slips(np.linspace(0.0, 0.99, n), np.zeros(n), np.full(n, 12.0))
    found = pulled(plant.tire, 0.5, slips, fz)
    (peak, at), (fx, fy), fz = jax.tree.map(np.asarray, (*found, fz))
    # Load and sliding speed move a peak a bit; no force exceeds it.
    assert peak[0] == pytest.approx(0.5, rel=0.05)
    used = fx / (peak[0] * fz[0])
    assert 0.97 < np.max(used) < 1 + 1e-3 and not np.any(fy)
    assert np.interp(at[0], slips.kappa, used) == pytest.approx(np.max(used), abs=1e-3)


@pytest.mark.long
def test_a_tire_whose_peak_depends_on_speed_stops_according_to_its_friction():
    plant, log = stopped(smooth("lugre", {}, road="mu=0.5", speed=12.0), ConventionalABS())
    used = log.contacts.fx / (log.reading.truth.mu * log.contacts.fz)
    assert 0.97 < np.max(used) < 1 + 1e-3 and np.mean(used[40:]) > 0.6


def test_a_road_changes_only_the_friction_of_a_brush():
    """Similarity on a brush is exactly another mu; on LuGre another g."""
    plant = plant_of(smooth(values={"mu": 1.3, "m": 1.0}, road="mu=0.4"))
    other = with_values(MODELS["brush"], {"mu": 0.4})
    moved = rolling(plant, jnp.asarray(15.0))
    for share in (0.999, 0.97, 0.9, 0.3, 0.0):
        s = moved._replace(omega=share * moved.omega)
        c = jax.tree.map(np.asarray, touched(plant, s))
        sigma = c.slips.kappa / (1 - c.slips.kappa)
        force = forces(other, TireInputs(sigma[0], 0.0, c.fz[0])).fx
        assert float(c.fx[0]) == pytest.approx(float(force), rel=1e-9)
    values = {"sigma1": 0.0, "sigma2": 0.0, "mu_s": 0.9, "mu_c": 0.5}
    plant = plant_of(smooth("lugre", values, road="mu=0.4"))
    factor = 0.4 / float(plant.tire.usual)
    scaled = values | {"mu_s": 0.9 * factor, "mu_c": 0.5 * factor}
    other = with_values(MODELS["lugre"], scaled)
    c = touched(plant, moved._replace(omega=0.8 * moved.omega))
    sigma = c.slips.kappa[0] / (1 - c.slips.kappa[0])
    force = forces(other, TireInputs(sigma, 0.0, c.fz[0], 15.0)).fx
    assert float(c.fx[0]) == pytest.approx(float(force), rel=1e-9)


def test_the_true_stiffness_is_the_slope_of_the_force():
    plant = plant_of(smooth(vehicle="car", road="mu=0.4"))
    s = rolling(plant, jnp.asarray(10.0))
    share = np.array([1.0, 0.98, 0.96, 0.8])
    s = s._replace(omega=np.asarray(s.omega) * share)
    step = 1e-4
    ahead, behind = (
        np.asarray(touched(plant, s._replace(omega=s.omega + h)).fx) for h in (step, -step)
    )
    slope = -(ahead - behind) / (2 * step * np.asarray(plant.vehicle.radius))
    found = slope_of(plant, s)
    np.testing.assert_allclose(found, slope, rtol=1e-5, atol=1.0)
    # At rest it is C_x / v; in full sliding of a brush nothing.
    assert float(slope[0]) == pytest.approx(2 * VALUES["cpa2"] / 10.0, rel=1e-4)
    assert float(found[3]) == pytest.approx(0.0, abs=1e-6)


def test_a_turning_car_agrees_with_the_single_track_model():
    """Yaw rate of steady cornering: v delta / (L + K v^2), K of the four loads."""
    steer, v = 0.002, 15.0
    # A brush, as brush-m is at m = 1.
    brush = {"cpa2": 5e4, "m": 1.0}
    asked = smooth(values=brush, vehicle="car", road="mu=1", steer=steer, speed=v)
    plant, log = stopped(asked)
    car = jax.tree.map(np.asarray, plant.vehicle)
    base, stiffness = car.x[0] - car.x[2], 4 * 5e4  # two tires, C = 2 c_p a^2
    under = float(car.mass) / base * (-car.x[2] - car.x[0]) / stiffness
    expected = v * steer / (base + under * v**2)
    assert log.motion.yaw_rate[0] == pytest.approx(expected, rel=5e-3)
    fz = log.contacts.fz[0]
    assert np.sum(fz) == pytest.approx(float(car.mass) * GRAVITY)
    # Turning left, the right wheels carry more.
    assert fz[1] > fz[0] and fz[3] > fz[2]
    assert log.contacts.fz[100][0] > log.contacts.fz[100][2]  # braking, the front


def test_a_split_road_turns_the_car_towards_high_friction():
    asked = smooth(vehicle="car", road="left=0.2,right=0.8", speed=10.0)
    _, log = stopped(asked, ConventionalABS())
    assert log.motion.heading[60] < -1e-3  # grip on the right: it turns right
    left = log.contacts.fx[60:160, 0].mean()
    assert log.contacts.fx[60:160, 1].mean() > 2 * left


def test_a_car_that_spins_is_reported_as_spun():
    asked = smooth(road="left=0.1,right=0.9", speed=25.0, vehicle="car")
    plant, log = stopped(asked)
    summary = jax.jit(summarise, static_argnums=2)(plant, log, 1 / RATE)
    assert summary.reason.startswith("spun")


def test_the_front_wheels_reach_a_new_road_first():
    asked = smooth(vehicle="car", road="mu=0.3:0.8@5", speed=10.0)
    _, log = stopped(asked, ConventionalABS())
    mu = log.contacts.mu
    changed = [int(np.argmax(mu[:, k] > 0.55)) for k in (0, 2)]
    base = log.motion.distance[changed[1]] - log.motion.distance[changed[0]]
    assert base == pytest.approx(2.6, abs=0.06)
    assert log.motion.distance[changed[0]] == pytest.approx(5.0, abs=0.06)
    assert mu[0, 0] == pytest.approx(0.3) and mu[-1, 2] == pytest.approx(0.8)
