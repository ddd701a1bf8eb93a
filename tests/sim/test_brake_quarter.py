"""The braked quarter car: its plant by SciPy and energy; results of stops, batches."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brake_peer import PlainABS, QuarterCar, Valves, stop
from stops import OFF, RATE, SAMPLES, VALUES, check_energy, check_locked_distance, smooth, stopped

from tirefit.models import MODELS
from tirefit.online.braking.abs import ConventionalABS
from tirefit.params import parameter_values, with_values
from tirefit.sim.brake import Sensors, draw_noise, simulate_stop
from tirefit.sim.brake_request import Request, arrays, plant_of
from tirefit.sim.brake_result import UNITS, summarise
from tirefit.sim.brake_vehicle import Hydraulics
from tirefit.sim.manoeuvre import braked, many_stops

TIRE = with_values(MODELS["brush-m"], {"cpa2": 4e4, "m": 0.5})
STOPS = 4
"""Stops in every batch."""


def request(**given):
    given = {"speed": 8.0, "road": "mu=0.5", "vehicle": "quarter"} | given
    return Request(TIRE, "brush-m", **{"time_limit": SAMPLES / 200} | given)


@pytest.fixture(scope="module")
def result():
    controllers = {"abs": arrays(ConventionalABS()), "none": arrays(OFF)}
    return braked(request(), controllers, seed=3, stops=STOPS)


@pytest.mark.long
def test_a_batch_agrees_with_single_stops(result):
    """The vmapped run of four seeds gives, for each, the stop of that seed alone."""
    asked = request()
    controller = arrays(ConventionalABS())
    for k in (0, 3):
        alone = braked(asked, {"abs": controller}, seed=3 + k)
        for name in UNITS:
            one = getattr(alone.stops["abs"].summary, name)
            np.testing.assert_allclose(
                getattr(result.many["abs"], name)[k], one, rtol=1e-6, atol=1e-9
            )
    assert len(set(result.many["abs"].stopping_distance.tolist())) == 4


def test_tires_roads_and_seeds_are_simulated_in_one_batch():
    roads = ("mu=0.5", "mu=0.7", "mu=0.4", "mu=0.6")
    plants = [plant_of(request(road=road)) for road in roads]
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *plants)
    keys = jax.vmap(jax.random.key)(jnp.arange(5, 5 + STOPS))
    asked, controller = request(), arrays(ConventionalABS())
    rest = (arrays(asked.sensors), jnp.asarray(8.0, float))
    each = many_stops(stacked, controller, *rest, keys, SAMPLES, 2)
    log = simulate_stop(plants[1], controller, *rest, keys[1], SAMPLES, 2)
    alone = jax.jit(summarise, static_argnums=2)(plants[1], log, 1 / 200)
    for name in UNITS:
        one, other = getattr(each, name)[1], getattr(alone, name)
        np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-9)
    assert np.argsort(each.stopping_distance).tolist() == [1, 3, 0, 2]


def test_numbers_follow_from_the_series(result):
    stop = result.stops["abs"]
    table, numbers = stop.columns(), stop.to_dict()
    assert numbers["stopped"] and numbers["reason"].startswith("stopped")
    assert numbers["stopping_distance"] == table["distance"][-1]
    assert numbers["stopping_time"] == pytest.approx(table["time"][-1])
    moving = table["v"] > 0.1
    used = table["fx"] / (table["mu_peak"] * table["fz"])
    assert numbers["mean_friction_used"] == pytest.approx(np.mean(used[moving]))
    fast = table["v"] > 0.3
    by_hand = np.minimum(1 - 0.3 * table["omega"] / np.maximum(table["v"], 0.3), 0.99)
    np.testing.assert_allclose(table["slip"][fast], by_hand[fast], atol=1e-12)
    for name in ("time", "v", "omega", "slip", "fx", "fz", "mu", "pressure", "xbs", "xbs_true"):
        assert len(table[name]) == len(table["time"])


def test_a_stop_with_locked_wheels_is_reported(result):
    stop = result.stops["none"]
    v = stop.columns()["v"]
    slip = stop.columns()["slip"]
    counted = np.sum((slip >= 0.9) & (v > 2.0)) / 200
    assert stop.to_dict()["locked_time"] == pytest.approx(counted)
    assert counted > 0.5
    # Once built up, the driver's pressure does not move.
    assert stop.to_dict()["pressure_rms_fluctuation"] < 1e4
    assert result.stops["abs"].to_dict()["pressure_rms_fluctuation"] > 1e5


def test_recovery_begins_with_all_wheels_on_the_new_road():
    """A made-up log: 0.5 of the friction until 0.3 s after the jump, then all of it."""
    asked = request(road="mu=0.3:0.8@4")
    plant = plant_of(asked)
    log = simulate_stop(
        plant,
        arrays(OFF),
        arrays(asked.sensors),
        jnp.asarray(8.0, float),
        jax.random.key(0),
        SAMPLES,
        2,
    )
    time = np.asarray(log.reading.time)
    crossed = float(time[np.argmax(np.asarray(log.motion.distance) >= 4.0)])
    there = log.reading.truth.mu * log.contacts.fz
    share = np.where(time < crossed + 0.3 - 1e-9, 0.5, 1.0)[:, None]
    made = log._replace(contacts=log.contacts._replace(fx=there * share))
    summed = jax.jit(summarise, static_argnums=2)
    took = float(summed(plant, made, 1 / 200).recovery_time)
    # Of the mean over 0.1 s, 0.8 is reached after 0.06 s of it.
    assert took == pytest.approx(0.36, abs=0.006)
    never = log._replace(contacts=log.contacts._replace(fx=0.5 * there))
    assert np.isnan(summed(plant, never, 1 / 200).recovery_time)


def test_a_car_that_does_not_stop_is_reported_with_the_reason(result):
    weak = request(hydraulics=Hydraulics(demand=2e5))
    stop = braked(weak, {"none": arrays(OFF)}).stops["none"]
    numbers = stop.to_dict()
    assert not numbers["stopped"] and np.isnan(numbers["stopping_distance"])
    assert "did not stop: still" in stop.summary.reason and "--time-limit" in stop.summary.reason


def test_the_summary_has_all_controllers_and_seeds(result):
    whole = result.to_dict()
    assert whole["schema"] == "tirefit.brake/1" and whole["controller"] == "abs"
    assert whole["stopping_distance"] == whole["controllers"]["abs"]["stopping_distance"]
    seeds = whole["seeds"]["abs"]
    each = result.many["abs"].mean_friction_used
    assert seeds["mean_friction_used"]["mean"] == pytest.approx(np.mean(each))
    assert seeds["stops"] == seeds["stopped"] == 4
    rows = result.stops_columns()
    assert rows["controller"] == ["abs"] * 4 + ["none"] * 4
    assert rows["seed"][:4] == [3, 4, 5, 6]
    silent = result.stops["none"]
    silent = replace(silent, log=silent.log._replace(info={}))
    columns = replace(result, stops={**result.stops, "none": silent}).columns()
    first = len(result.stops["abs"].log.moving)
    assert columns["controller"][first - 1 : first + 1] == ["abs", "none"]
    assert np.isnan(columns["reference_speed"][-1])


@pytest.mark.parametrize("mu", [0.15, 0.8])
def test_the_closed_loop_agrees_with_scipy(mu):
    """Plant by solve_ivp, rules in plain Python, the same noise: the same stop."""
    noisy = Sensors(0.005, 0.0, 0.1, 2e4, 0.01)
    asked = smooth(road=f"mu={mu}", speed=8.0, sensors=noisy)
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


def test_energy_is_conserved():
    check_energy("quarter")


def test_its_program_can_be_cached_between_processes():
    """A program that calls Python cannot, and a stop takes seconds to compile."""
    asked = smooth()
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
    asked = smooth(road="mu=0.5", hydraulics=gentle, speed=12.0)
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


def test_the_distance_with_locked_wheels_agrees_with_the_textbook():
    check_locked_distance("quarter")


def test_a_locked_wheel_turns_again_after_release():
    """Locked on ice, released by ABS, it returns to the speed of the car."""
    _, log = stopped(smooth(road="mu=0.06", speed=4.0), ConventionalABS(slowing=150.0))
    turning = log.motion.omega[:, 0] * 0.3
    stood = np.flatnonzero(turning == 0.0)
    assert len(stood) and log.motion.v_x[stood[0]] > 2.0
    again = turning[stood[0] :] / np.maximum(log.motion.v_x[stood[0] :], 0.1)
    assert np.max(again) > 0.97
