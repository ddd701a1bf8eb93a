"""Road, hydraulics, sensors and the numbers of a stop, each by its known properties."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from tirefit.fitting.problem.layout import FreeParameter, Layout
from tirefit.fitting.store import StoredFit
from tirefit.models import MODELS
from tirefit.params import specs, with_values
from tirefit.results import UsageError
from tirefit.sim.brake import Sensors, draw_noise, wheel_speeds
from tirefit.sim.brake_request import Request, check, plant_of, with_numbers
from tirefit.sim.brake_result import interval
from tirefit.sim.brake_vehicle import (
    GRAVITY,
    ROADS,
    Hydraulics,
    four_wheels,
    on_road,
    quarter_car,
    road_of,
)


def test_roads_are_read_from_text():
    constant, jump, split = map(road_of, ROADS)
    assert constant.before.tolist() == [0.4, 0.4] and constant.jump == np.inf
    assert jump.after.tolist() == [0.8, 0.8] and jump.jump == 20.0
    assert split.before.tolist() == [0.3, 0.8] and split.split and not jump.split
    at = jnp.asarray([19.8, 20.0, 20.2, 25.0])
    y = jnp.asarray([1.0, -1.0, 1.0, -1.0])
    np.testing.assert_allclose(jump.mu(at, y), [0.3, 0.55, 0.8, 0.8])
    np.testing.assert_allclose(split.mu(at, y), [0.3, 0.8, 0.3, 0.8])


@pytest.mark.parametrize(
    "text", ["0.4", "mu=", "mu=0.3:0.8", "mu=-0.3", "left=0.3", "mu=0.01", "mu=nan"]
)
def test_an_invalid_road_is_refused_with_a_remedy(text):
    with pytest.raises(UsageError) as error:
        road_of(text)
    assert error.value.problems[0].remedy


def test_the_peak_of_a_curve_is_the_friction_of_the_road():
    """S(33): brush-m peaks where its force is mu' F_z; sigma at the peak by hand."""
    mu, m, cpa2, fz = 0.4, 0.5, 4e4, 4e3
    tire = with_values(MODELS["brush-m"], {"m": m, "cpa2": cpa2, "mu": 1.1})
    roads = jnp.asarray([0.3, mu, 0.8])
    made = on_road(tire, jnp.asarray(20.0), jnp.asarray(fz), roads)
    peaks = jax.jit(type(made).peaks)
    peak, at = map(np.asarray, peaks(made, *(np.array([x]) for x in (mu, 5.0, fz))))
    assert float(peak[0]) == pytest.approx(mu, rel=1e-12)
    static = mu * (3 - 2 * m) ** 2 / (4 - 3 * m) * fz
    sigma = np.linspace(1e-3, 0.2, 200_001)
    xi = np.minimum(4 * cpa2 * sigma / (3 * static) - 1, 1)
    force = m * static * (2 + 3 * xi - xi**3) / 4 + cpa2 * sigma * (1 - xi) ** 2 / 2
    best = sigma[np.argmax(force)]
    # The place is interpolated over the load.
    assert float(at[0] / (1 - at[0])) == pytest.approx(best, rel=5e-3)


def test_loads_of_a_braked_car_balance():
    """Moments about the axles and sides: statics by hand."""
    car = four_wheels()
    assert np.sum(car.fz) == pytest.approx(car.mass * GRAVITY)
    slowing, left = 5.0, 3.0
    fz = car.fz + slowing * car.pitch + left * car.roll
    assert np.sum(fz) == pytest.approx(car.mass * GRAVITY)
    height = 0.5
    # About a lateral axis on the ground below the centre of gravity, and a forward one.
    assert np.sum(fz * car.x) == pytest.approx(car.mass * slowing * height)
    assert np.sum(fz * car.y) == pytest.approx(-car.mass * left * height)
    one = quarter_car()
    assert one.fz[0] == pytest.approx(car.fz[0])
    assert one.mass * GRAVITY == pytest.approx(one.fz[0])


def test_the_pressure_stays_within_its_rates():
    brakes = Hydraulics()

    def flow(t, pressure, valve):
        given = jnp.asarray([pressure]), jnp.asarray([valve])
        return float(brakes.flow(t, *given)[0])

    assert flow(10.0, 2e6, 1.0) == pytest.approx(40e6)
    assert flow(10.0, 2e6, 0.25) == pytest.approx(10e6)
    assert flow(10.0, 5e6, -1.0) == pytest.approx(-80e6)
    assert flow(10.0, 1e5, -1.0) == pytest.approx(-1e5 / brakes.lag)
    assert flow(10.0, brakes.demand, 1.0) == flow(10.0, 5e6, 0.0) == 0.0
    assert flow(0.01, 3e6, 0.0) < 0  # more than the driver's, past the valve
    assert float(brakes.master(0.05)) == pytest.approx(3e6)
    assert (brakes.queue(200.0), brakes.queue(1000.0)) == (2, 10)


def test_the_uneven_road_has_the_stated_spectrum():
    """Standard deviation, and the correlation e^(-2 pi f dt k) of a first-order one."""
    sensors = Sensors(road_std=0.02, road_corner=1.0)
    drawn = jax.jit(draw_noise, static_argnums=(2, 3))
    noise = drawn(jax.random.key(0), sensors, 200_000, 1, 200.0)
    d = np.asarray(noise.road)[:, 0]
    assert len(d) == 200_001
    assert np.std(d) == pytest.approx(0.02, rel=0.05)
    for lag in (4, 20):
        kept = np.mean(d[lag:] * d[:-lag]) / np.var(d)
        assert kept == pytest.approx(np.exp(-2 * np.pi * lag / 200), abs=0.03)


def test_wheel_speeds_are_quantised_and_reach_zero():
    sensors = Sensors(speed_std=0.005, speed_step=0.01)
    turning = jnp.asarray([10.0, 10.0, 0.0, 0.002])
    told = wheel_speeds(sensors, turning, jnp.asarray([0.0, 1.2, 5.0, -3.0]))
    np.testing.assert_allclose(told, [10.0, 10.01, 0.0, 0.0], atol=1e-12)
    fine = wheel_speeds(sensors._replace(speed_step=0.0), turning, jnp.ones(4))
    np.testing.assert_allclose(fine[:2], 10.005)


def test_intervals_contain_the_mean_in_95_percent():
    random = np.random.default_rng(0)
    held = 0
    for _ in range(2000):
        found = interval(random.normal(3.0, 2.0, 10))
        held += found["low"] < 3.0 < found["high"]
    assert stats.binomtest(held, 2000, 0.95).pvalue > 1e-3
    known = interval(np.array([1.0, np.nan, 3.0]))
    assert known["mean"] == 2.0 and known["k"] == 2
    assert np.isnan(interval(np.array([1.0]))["low"]) and interval(np.array([]))["k"] == 0


@pytest.mark.parametrize(
    ("model", "given", "said"),
    [
        ("magic-formula", {"steer": 0.05}, "no combined slip"),
        ("magic-formula", {"road": "left=0.3,right=0.8"}, "no combined slip"),
        ("brush-relaxation", {}, "lags behind"),
        ("carcass-thread", {}, "no braking force"),
        ("brush-m", {"speed": -1.0}, "--speed -1 is out of range"),
        ("brush-m", {"steer": 2.0}, "--steer 2 is out of range"),
        ("brush-m", {"vehicle": "quarter", "steer": 0.1}, "cannot steer"),
        ("brush-m", {"vehicle": "bus"}, "no vehicle 'bus'"),
        ("brush-m", {"time_limit": 1e6}, "--time-limit"),
    ],
)
def test_an_impossible_manoeuvre_is_refused(model, given, said):
    with pytest.raises(UsageError) as error:
        check(Request(MODELS[model], model, **given))
    assert said in str(error.value) and all(p.remedy for p in error.value.problems)


def test_settings_of_the_plant_are_set_by_name():
    asked = Request(MODELS["brush"], "brush")
    other = with_numbers(asked, {"delay": 0.02, "speed_std": 0.0})
    assert other.hydraulics.delay == 0.02 and other.sensors.speed_std == 0.0
    with pytest.raises(UsageError, match="no --plant quantity 'dealy'"):
        with_numbers(asked, {"dealy": 0.02})
    with pytest.raises(UsageError, match="demand"):
        check(with_numbers(asked, {"demand": -1.0}))
    assert isinstance(plant_of(other).hydraulics.delay, jax.Array)


def test_a_fit_with_values_per_run_is_refused_as_a_tire():
    layout = Layout((FreeParameter("mu", specs(MODELS["brush"])["mu"], True),), ("a", "b"))
    rest = (np.zeros(2), np.eye(2), {}, {})
    with pytest.raises(UsageError, match="a mu for each run"):
        StoredFit("brush", MODELS["brush"], layout, *rest).at_estimate()
    shared = Layout((FreeParameter("mu", specs(MODELS["brush"])["mu"], False),), ())
    tire = StoredFit("brush", MODELS["brush"], shared, np.zeros(1), *rest[1:])
    assert tire.at_estimate().mu == pytest.approx(2.505)  # the middle of its bounds
