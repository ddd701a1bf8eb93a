"""The braked plant checked by SciPy, energy, textbook and finite differences."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brake_peer import PlainABS, QuarterCar, Valves, stop

from tirefit.models import MODELS, TireInputs, forces
from tirefit.online.abs import ConventionalABS
from tirefit.params import parameter_values, with_values
from tirefit.sim.brake import simulate_stop, xbs_true
from tirefit.sim.brake_plant import contacts, rolling
from tirefit.sim.brake_request import Request, arrays, plant_of
from tirefit.sim.brake_summary import reason_of, summarise
from tirefit.sim.brake_tire import Slips
from tirefit.sim.brake_vehicle import GRAVITY, Hydraulics, Sensors, draw_noise

VALUES = {"cpa2": 4e4, "m": 0.5}
SMOOTH = Sensors(0.0, 0.0, 0.0, 0.0, 0.0)
RATE = 200.0
SAMPLES = 2400
"""Of every stop, which all end sooner: one program serves all roads and speeds."""
OFF = ConventionalABS(off=1e3)
"""Open valves at all speeds, as without a controller, by the program of the others."""
touched = eqx.filter_jit(contacts)
slope_of = eqx.filter_jit(xbs_true)


@jax.jit
def pulled(tire, mu, slips, fz):
    """Peaks of four wheels, and forces at slips (n,) under the load of the first."""
    n = len(slips.kappa)
    peaks = tire.peaks(jnp.full(4, mu), slips.speed[:4], fz)
    return peaks, tire.forces(jnp.full(n, mu), slips, jnp.full(n, fz[0]))


def request(model="brush-m", values=None, **given):
    given = {"vehicle": "quarter", "sensors": SMOOTH} | given
    values = VALUES if values is None else values
    return Request(with_values(MODELS[model], values), model, **given)


def stopped(asked, controller=OFF, seed=0):
    """Plant and log (NumPy) of a stop, up to its end."""
    plant = plant_of(asked)
    log = simulate_stop(
        plant,
        arrays(controller),
        arrays(asked.sensors),
        jnp.asarray(asked.speed, float),
        jax.random.key(seed),
        SAMPLES,
        asked.hydraulics.queue(RATE),
    )
    end = int(np.sum(log.moving)) + 1
    assert end <= len(log.moving), "it did not stop"
    assert np.all(log.fine == 1)
    return plant, jax.tree.map(lambda leaf: np.asarray(leaf)[:end], log)


@pytest.mark.parametrize("mu", [0.15, 0.8])
def test_the_closed_loop_agrees_with_scipy(mu):
    """Plant by solve_ivp, rules in plain Python, the same noise: the same stop."""
    noisy = Sensors(0.005, 0.0, 0.1, 2e4, 0.01)
    asked = request(road=f"mu={mu}", speed=8.0, sensors=noisy)
    controller = ConventionalABS()
    plant, log = stopped(asked, controller, seed=1)
    car = plant.vehicle
    drawn = draw_noise(jax.random.key(1), arrays(noisy), SAMPLES, 1, RATE)
    noise = {
        "speed": np.asarray(drawn.speed)[:, 0],
        "road": np.asarray(drawn.road)[:, 0],
        "pressure": np.asarray(drawn.pressure)[:, 0],
        "deceleration": np.asarray(drawn.deceleration),
    }
    numbers = [float(x[0]) for x in (car.fz, car.radius, car.inertia, car.brake_gain)]
    hydraulics = {k: v for k, v in Hydraulics()._asdict().items() if k != "delay"}
    rows = stop(
        QuarterCar(*numbers, VALUES["cpa2"], VALUES["m"], mu),
        Valves(**hydraulics),
        PlainABS(parameter_values(controller), 1 / RATE, 8.0),
        noisy._asdict(),
        noise,
        8.0,
        RATE,
        SAMPLES,
        2,
    )
    assert len(rows) == len(log.moving)
    np.testing.assert_allclose(log.valve[:, 0], rows[:, 4], atol=1e-9)
    s = log.motion
    for ours, theirs, scale in (
        (s.distance, rows[:, 0], 1.0),
        (s.v_x, rows[:, 1], 1.0),
        (s.omega[:, 0], rows[:, 2], 30.0),
        (s.pressure[:, 0], rows[:, 3], 1e6),
    ):
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=3e-4 * scale)
    # The stop has what makes it hard: a wheel that dives, and that stands at the end.
    assert rows[:, 2].min() == 0.0 and log.contacts.slips.kappa.max() > 0.2


@pytest.mark.parametrize("vehicle", ["quarter", "car"])
def test_energy_is_conserved(vehicle):
    """The body and wheels lose what brakes, slip and the uneven road absorb."""
    rough = SMOOTH._replace(road_std=0.01)
    asked = request(vehicle=vehicle, road="mu=0.5", sensors=rough, speed=12.0)
    plant, log = stopped(asked, ConventionalABS(), seed=1)
    car, s, c = jax.tree.map(np.asarray, plant.vehicle), log.motion, log.contacts
    kinetic = 0.5 * car.mass * (s.v_x**2 + s.v_y**2)
    kinetic += 0.5 * car.yaw_inertia * s.yaw_rate**2
    kinetic += 0.5 * np.sum(car.inertia * s.omega**2, axis=1)
    turning = s.omega * car.radius
    braked = np.sum(car.brake_gain * s.pressure * s.omega, axis=1)
    slid = np.sum((c.fx + log.d) * (c.v_x - turning), axis=1)
    aside = np.sum(c.fy * c.slips.speed * np.tan(c.slips.alpha), axis=1)
    power, time = braked + slid + aside, log.reading.time
    lost = np.sum((power[1:] + power[:-1]) / 2 * np.diff(time))
    # A trapezoid over 5 ms, in which a wheel may dive from rolling to standing.
    assert lost == pytest.approx(kinetic[0] - kinetic[-1], rel=4e-3)
    assert np.sum(braked) > 0.5 * np.sum(power)  # most of it is brakes' work


def test_its_program_can_be_cached_between_processes():
    """A program that calls Python cannot, and a stop takes seconds to compile."""
    asked = request()
    program = simulate_stop.lower(
        plant_of(asked),
        arrays(OFF),
        arrays(asked.sensors),
        jnp.asarray(asked.speed, float),
        jax.random.key(0),
        SAMPLES,
        2,
    )
    assert "while" in program.as_text() and "callback" not in program.as_text()


def test_energy_is_conserved_to_the_order_of_the_trapezoid():
    """A stop without locking wheels: 30 times closer."""
    gentle = Hydraulics(demand=2e6, ramp=4e6)
    asked = request(road="mu=0.5", hydraulics=gentle, speed=12.0)
    plant, log = stopped(asked)
    s, c = log.motion, log.contacts
    fast = s.v_x > 1.0
    car = jax.tree.map(np.asarray, plant.vehicle)
    kinetic = 0.5 * (car.mass * s.v_x**2 + car.inertia[0] * s.omega[:, 0] ** 2)
    power = car.brake_gain[0] * s.pressure[:, 0] * s.omega[:, 0]
    power = power + c.fx[:, 0] * (s.v_x - s.omega[:, 0] * car.radius[0])
    last = np.flatnonzero(fast)[-1]
    lost = np.trapezoid(power[: last + 1], log.reading.time[: last + 1])
    assert lost == pytest.approx(kinetic[0] - kinetic[last], rel=1e-4)


@pytest.mark.parametrize("vehicle", ["quarter", "car"])
def test_the_distance_with_locked_wheels_agrees_with_the_textbook(vehicle):
    """v^2 / (2 mu g) from the locking of the last wheel, without any chatter."""
    sliding = 0.8 * 0.4  # S(33) at m = 0.5
    plant, log = stopped(request(vehicle=vehicle, road="mu=0.4"))
    s = log.motion
    locked = int(np.flatnonzero(np.any(s.omega > 0, axis=1))[-1]) + 1
    assert np.all(s.omega[locked:] == 0.0) and s.v_x[locked] > 13.0
    fast = s.v_x > 0.5
    v, x = s.v_x[locked], s.distance[fast][-1] - s.distance[locked]
    way = (v**2 - s.v_x[fast][-1] ** 2) / (2 * sliding * GRAVITY)
    assert x == pytest.approx(way, rel=1e-5)
    whole = s.distance[-1] - s.distance[locked]
    assert whole == pytest.approx(v**2 / (2 * sliding * GRAVITY), rel=1e-3)


def test_a_locked_wheel_turns_again_after_release():
    """Locked on ice, released by ABS, it returns to the speed of the car."""
    _, log = stopped(request(road="mu=0.06", speed=4.0), ConventionalABS(slowing=150.0))
    turning = log.motion.omega[:, 0] * 0.3
    stood = np.flatnonzero(turning == 0.0)
    assert len(stood) and log.motion.v_x[stood[0]] > 2.0
    again = turning[stood[0] :] / np.maximum(log.motion.v_x[stood[0] :], 0.1)
    assert np.max(again) > 0.97


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
    plant = plant_of(request(model, values, vehicle="car", road="mu=0.5", speed=12.0))
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
    plant, log = stopped(request("lugre", {}, road="mu=0.5", speed=12.0), ConventionalABS())
    used = log.contacts.fx / (log.reading.truth.mu * log.contacts.fz)
    assert 0.97 < np.max(used) < 1 + 1e-3 and np.mean(used[40:]) > 0.6


def test_a_road_changes_only_the_friction_of_a_brush():
    """Similarity on a brush is exactly another mu; on LuGre another g."""
    plant = plant_of(request(values={"mu": 1.3, "m": 1.0}, road="mu=0.4"))
    other = with_values(MODELS["brush"], {"mu": 0.4})
    moved = rolling(plant, jnp.asarray(15.0))
    for share in (0.999, 0.97, 0.9, 0.3, 0.0):
        s = moved._replace(omega=share * moved.omega)
        c = jax.tree.map(np.asarray, touched(plant, s))
        sigma = c.slips.kappa / (1 - c.slips.kappa)
        force = forces(other, TireInputs(sigma[0], 0.0, c.fz[0])).fx
        assert float(c.fx[0]) == pytest.approx(float(force), rel=1e-9)
    values = {"sigma1": 0.0, "sigma2": 0.0, "mu_s": 0.9, "mu_c": 0.5}
    plant = plant_of(request("lugre", values, road="mu=0.4"))
    factor = 0.4 / float(plant.tire.usual)
    scaled = values | {"mu_s": 0.9 * factor, "mu_c": 0.5 * factor}
    other = with_values(MODELS["lugre"], scaled)
    c = touched(plant, moved._replace(omega=0.8 * moved.omega))
    sigma = c.slips.kappa[0] / (1 - c.slips.kappa[0])
    force = forces(other, TireInputs(sigma, 0.0, c.fz[0], 15.0)).fx
    assert float(c.fx[0]) == pytest.approx(float(force), rel=1e-9)


def test_the_true_stiffness_is_the_slope_of_the_force():
    plant = plant_of(request(vehicle="car", road="mu=0.4"))
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
    asked = request(values=brush, vehicle="car", road="mu=1", steer=steer, speed=v)
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
    asked = request(vehicle="car", road="left=0.2,right=0.8", speed=10.0)
    _, log = stopped(asked, ConventionalABS())
    assert log.motion.heading[60] < -1e-3  # grip on the right: it turns right
    left = log.contacts.fx[60:160, 0].mean()
    assert log.contacts.fx[60:160, 1].mean() > 2 * left


def test_a_car_that_spins_is_reported_as_spun():
    asked = request(road="left=0.1,right=0.9", speed=25.0, vehicle="car")
    plant, log = stopped(asked)
    summary = jax.jit(summarise, static_argnums=2)(plant, log, 1 / RATE)
    assert reason_of(summary).startswith("spun")


def test_the_front_wheels_reach_a_new_road_first():
    asked = request(vehicle="car", road="mu=0.3:0.8@5", speed=10.0)
    _, log = stopped(asked, ConventionalABS())
    mu = log.contacts.mu
    changed = [int(np.argmax(mu[:, k] > 0.55)) for k in (0, 2)]
    base = log.motion.distance[changed[1]] - log.motion.distance[changed[0]]
    assert base == pytest.approx(2.6, abs=0.06)
    assert log.motion.distance[changed[0]] == pytest.approx(5.0, abs=0.06)
    assert mu[0, 0] == pytest.approx(0.3) and mu[-1, 2] == pytest.approx(0.8)
