"""Stops without noise of the sensors, and what holds for those of every vehicle."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tirefit.models import MODELS
from tirefit.online.braking.abs import ConventionalABS
from tirefit.params import with_values
from tirefit.sim.brake import Sensors, simulate_stop
from tirefit.sim.brake_request import Request, arrays, plant_of
from tirefit.sim.brake_vehicle import GRAVITY

VALUES = {"cpa2": 4e4, "m": 0.5}
SMOOTH = Sensors(0.0, 0.0, 0.0, 0.0, 0.0)
RATE = 200.0
SAMPLES = 2400
"""Of every stop, which all end sooner: one program serves all roads and speeds of a
vehicle, so each vehicle has a file of its own."""
OFF = ConventionalABS(off=1e3)
"""Open valves at all speeds, as without a controller, by the program of the others."""


def smooth(model="brush-m", values=None, **given):
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


def check_energy(vehicle):
    """The body and wheels lose what brakes, slip and the uneven road absorb."""
    rough = SMOOTH._replace(road_std=0.01)
    asked = smooth(vehicle=vehicle, road="mu=0.5", sensors=rough, speed=12.0)
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


def check_locked_distance(vehicle):
    """v^2 / (2 mu g) from the locking of the last wheel, without any chatter."""
    sliding = 0.8 * 0.4  # S(33) at m = 0.5
    plant, log = stopped(smooth(vehicle=vehicle, road="mu=0.4"))
    s = log.motion
    locked = int(np.flatnonzero(np.any(s.omega > 0, axis=1))[-1]) + 1
    assert np.all(s.omega[locked:] == 0.0) and s.v_x[locked] > 13.0
    fast = s.v_x > 0.5
    v, x = s.v_x[locked], s.distance[fast][-1] - s.distance[locked]
    way = (v**2 - s.v_x[fast][-1] ** 2) / (2 * sliding * GRAVITY)
    assert x == pytest.approx(way, rel=1e-5)
    whole = s.distance[-1] - s.distance[locked]
    assert whole == pytest.approx(v**2 / (2 * sliding * GRAVITY), rel=1e-3)
