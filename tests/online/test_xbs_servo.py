"""The servo's layers, one by one, and the condition on its gain."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tirefit.models import TireInputs
from tirefit.models.brush import AnisotropicBrush
from tirefit.online.braking.controller import Measurement, Truth
from tirefit.online.braking.controllers import controller_of
from tirefit.online.braking.xbs_servo import XbsServo
from tirefit.results import UsageError

RATE, SCALE = 200.0, 1.2 / 0.3**2


@pytest.mark.parametrize("pole", [-40.0, -10.0])
def test_the_condition_agrees_with_eigenvalues(pole):
    """O(8) and O(11): a wheel of pole p is stable above a = -p."""
    for gain, stable in ((-pole - 1.0, False), (-pole + 1.0, True), (-pole + 20.0, True)):
        # The wheel's speed and the torque, whose rate is the gain times that of the speed.
        matrix = np.array([[-pole, -1.0], [-pole * gain, -gain]])
        moving = max(np.linalg.eigvals(matrix).real, key=abs)
        assert (moving < 0) == stable
        settings = {"servo_gain": gain, "least_slope": pole * SCALE}
        if stable:
            XbsServo(**settings)
        else:
            with pytest.raises(UsageError, match=r"O\(11\)"):
                XbsServo(**settings)


def test_an_unstable_gain_is_refused_with_the_condition_and_its_numbers():
    with pytest.raises(UsageError) as error:
        XbsServo(servo_gain=15.0, least_slope=-250.0)
    text = str(error.value)
    for part in (
        "O(11)",
        "15 is not above 18.75 1/s",
        "k_min = -250 N s/m",
        "r = 0.3 m",
        "J = 1.2 kg m2",
    ):
        assert part in text
    with pytest.raises(UsageError, match="O\\(11\\)"):
        controller_of("xbs-servo", {}, {"servo_gain": -5.0})


def test_the_wheel_with_the_strictest_condition_decides():
    car = {"radius": np.array([0.3, 0.33]), "inertia": np.array([1.2, 0.8])}
    with pytest.raises(UsageError, match=r"r = 0.33 m, J = 0.8"):
        dataclasses.replace(XbsServo(), **car, servo_gain=10.0, least_slope=-100.0)


def measurement(speed, pressure, slowing=3.0, demand=12e6, time=0.0, **more):
    speed = np.atleast_1d(np.asarray(speed, float))
    nothing = np.full_like(speed, np.nan)
    given = {"steering": 0.0, "yaw_rate": 0.0} | more
    sensed = slowing, demand, given["steering"], given["yaw_rate"]
    rows = time, speed, np.full_like(speed, pressure), *sensed, Truth(*[nothing] * 5)
    return jax.tree.map(jnp.asarray, Measurement(*rows))


begun, stepped = eqx.filter_jit(XbsServo.init), eqx.filter_jit(XbsServo.step)


def ready(**settings):
    return jax.tree.map(lambda x: jnp.asarray(x, float), XbsServo(**settings))


def test_the_torque_is_the_inertia_times_the_gain_times_the_speed_error():
    """Second layer: T = (J a / r) (v_w - v_0), sample by sample."""
    servo = ready()
    state = begun(servo, measurement(15.0, 0.0))
    state = state._replace(
        target=jnp.array([2e6]), slowing=jnp.asarray(3.0), coming=0 * state.coming
    )
    state, _, info = stepped(servo, state, measurement(14.98, 2e6))
    pull = float(servo.start_pull)
    np.testing.assert_allclose(info["target_deceleration"], 3.0 + pull)
    error = (14.98 - 15.0) + (3.0 + pull) / RATE
    torque = 1.2 * 75.0 / 0.3 * error
    np.testing.assert_allclose(np.asarray(info["target_pressure"]) - 2e6, torque / 1.35e-4)


def test_the_pressure_reaches_its_target_after_the_delay():
    """Third layer, on a valve as specified: no steady error, and commands under way are
    accounted for."""
    servo = ready()
    pressure, coming, moves = 2e6, [0.0, 0.0], []
    expected = jnp.zeros((2, 1))
    for _ in range(6):
        present = pressure + float(expected.sum())
        error = jnp.array([2.3e6 - present])
        valve, moved = servo._valves(error, jnp.array([present]), jnp.asarray(12e6))
        expected = jnp.concatenate([expected, moved[None]])[1:]
        coming.append(float(valve[0]))
        share = coming.pop(0)
        pressure += share * min((12e6 - pressure) / 0.02, 40e6) / RATE
        moves.append(pressure)
    assert moves[1] == 2e6  # two samples of delay
    # 0.2 MPa is what an interval can do.
    np.testing.assert_allclose(moves[2:], [2.2e6, 2.3e6, 2.3e6, 2.3e6], rtol=1e-3)


@pytest.mark.parametrize(("steering", "slip"), [(0.0, 0.03), (0.08, 0.03)])
def test_the_reference_is_the_slope_of_the_brush_at_the_wanted_share(steering, slip):
    servo = ready(share=0.8, steered=1.0)
    vehicle, turning = 15.0, 15.0 / (1 + slip)
    now = measurement(turning, 2e6, steering=steering)
    wanted = float(eqx.filter_jit(XbsServo._wanted)(servo, now, jnp.asarray(vehicle))[0])
    # The same tire at that direction, with as much friction as makes 80 % of it.
    across = 0.7 * np.tan(steering) * (1 + slip)
    resultant = np.hypot(slip, across)
    sticking = (1 - 0.8) ** (1 / 3)
    mu = 6e4 * resultant / (3 * 4000 * (1 - sticking))
    tire = AnisotropicBrush(3e4, mu, stiffness_ratio=0.7)

    def fx(sigma):
        angle = jnp.arctan(across / 0.7 / (1 + sigma))
        return tire(TireInputs(sigma, angle, 4000.0)).fx

    np.testing.assert_allclose(wanted * turning, jax.jit(jax.grad(fx))(slip), rtol=1e-9)


def test_stiffness_above_the_target_applies_and_below_releases():
    servo, calm = ready(), measurement(14.0, 2e6)

    class Fixed(XbsServo):
        slope: float = 1.0  # over the wanted one

        def _slope(self, s, speed, use):
            wanted = self._wanted(calm, s.vehicle)
            return s.xbs, self.slope * wanted, 0 * wanted, jnp.zeros(1, int)

    @jax.jit
    def told(lone):
        return lone.step(lone.init(calm), calm)[2]["target_deceleration"][0]

    for slope, sign in ((2.0, 1), (0.5, -1), (-0.3, -1)):
        made = float(told(dataclasses.replace(Fixed(), slope=slope))) - 3.0 * (1 / 11)
        gain = float(servo.pull if sign > 0 else servo.release)
        np.testing.assert_allclose(made, gain * (slope - 1), rtol=1e-2)


def drive(n=160, wheels=4, seed=0):
    """Measurements (n, w) of wheels that vibrate and slow down."""
    random = np.random.default_rng(seed)
    time = np.arange(n) / RATE
    speed = 15 - 3 * time[:, None] + np.cumsum(0.01 * random.normal(size=(n, wheels)), 0)
    row = np.ones((n, wheels))
    sensed = np.full(n, 3.0), np.full(n, 12e6), np.zeros(n), np.zeros(n)
    return Measurement(time, speed, 2e6 * row, *sensed, Truth(*[np.nan * row] * 5))


def row_of(rows, i, wheels=slice(None)):
    def cut(part):
        return part[i][wheels] if part.ndim > 1 else part[i]

    return jax.tree.map(cut, rows)


def test_scan_equals_single_steps_and_wheels_are_independent():
    servo, rows = ready(), drive()

    def step(state, now):
        state, command, info = servo.step(state, now)
        return state, (command, info["target_pressure"])

    first = jax.tree.map(jnp.asarray, row_of(rows, 0))
    scan = jax.jit(lambda now, rows: jax.lax.scan(step, servo.init(now), rows)[1])
    valve, target = map(np.asarray, scan(first, rows))
    state = begun(servo, row_of(rows, 0, slice(2, 3)))
    # Of one wheel: the speed of the vehicle at the start is that of the fastest.
    for i in range(160):
        state, command, info = stepped(servo, state, row_of(rows, i, slice(2, 3)))
        np.testing.assert_allclose(command[0], valve[i, 2], rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(info["target_pressure"][0], target[i, 2], rtol=1e-9, atol=1e-3)
    assert set(info) >= {"xbs", "xbs_std", "xbs_wanted", "target_pressure"}


def test_a_slow_car_leaves_the_pressures_unchanged():
    servo = ready()
    state = begun(servo, measurement(1.5, 2e6))
    state = state._replace(target=jnp.array([2e6]))
    for speed in (1.49, 1.3, 1.0):
        state, command, info = stepped(servo, state, measurement(speed, 2e6))
        np.testing.assert_allclose(info["target_pressure"], 2e6)
        np.testing.assert_allclose(command, 0.0, atol=1e-12)
