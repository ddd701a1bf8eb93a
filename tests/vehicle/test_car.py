"""The single-track car compared with SciPy, with steady cornering, and with derive."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from fits.formulas import brush
from tirefit.models import Brush
from tirefit.vehicle.car import (
    Axle,
    Car,
    Changes,
    LinearTire,
    State,
    accelerations,
    axle_loads,
    predicted,
    stiffest,
)

MASS, INERTIA, L_F, L_R, GRAVITY = 5.1, 0.12, 0.17, 0.16, 9.81
TIRES = {"front": (40.0, 0.9), "rear": (120.0, 0.75)}
STEP, COUNT = 0.01, 101


def car():
    tires = (Brush(cpa2=cpa2, mu=mu) for cpa2, mu in TIRES.values())
    return Car(*tires, MASS, INERTIA, L_F, L_R, GRAVITY)


def slopes(time, state, speed, angle):
    """Newton and Euler, forces by S(12) in NumPy, to the left."""
    v_y, turn, heading, _, _ = state
    v_x, delta = speed(time), angle(time)
    wheelbase = L_F + L_R
    forces = []
    for (c, mu), arm, steer, other in (
        (TIRES["front"], L_F, delta, L_R),
        (TIRES["rear"], -L_R, 0.0, L_F),
    ):
        slip = np.arctan2(v_y + arm * turn, v_x) - steer
        fz = MASS * GRAVITY * other / wheelbase
        size = brush(np.tan(abs(slip)), fz, v_x, c, mu)
        forces.append(-np.sign(slip) * size)
    front, rear = forces[0] * np.cos(delta), forces[1]
    return [
        (front + rear) / MASS - v_x * turn,
        (L_F * front - L_R * rear) / INERTIA,
        turn,
        v_x * np.cos(heading) - v_y * np.sin(heading),
        v_x * np.sin(heading) + v_y * np.cos(heading),
    ]


def test_a_predicted_second_agrees_with_scipy():
    time = STEP * np.arange(COUNT)
    v_x, steering = 3.0 + 0.5 * time, 0.5 * np.sin(4 * time)
    start = (-0.9, 1.0, 0.4, 1.0, 2.0)
    found = jax.jit(predicted, static_argnums=5)(
        car(), State(*start), jnp.asarray(v_x), jnp.asarray(steering), STEP, 4
    )
    true = solve_ivp(
        slopes,
        (0, time[-1]),
        start,
        t_eval=time,
        rtol=1e-10,
        atol=1e-10,
        max_step=STEP / 4,
        args=[lambda t: 3.0 + 0.5 * t, lambda t: 0.5 * np.sin(4 * t)],
    )
    # At first the rear slides.
    full = 1.5 * TIRES["rear"][1] * MASS * GRAVITY * L_F / (L_F + L_R) / TIRES["rear"][0]
    assert abs(start[0] - L_R * start[1]) / v_x[0] > full
    np.testing.assert_allclose(np.stack(found.states), true.y, atol=2e-5)


def test_steady_cornering_of_linear_tires_is_the_understeer_gradient():
    front, rear = 5.0, 7.0  # 1/rad
    linear = Car(LinearTire(front), LinearTire(rear), MASS, INERTIA, L_F, L_R, GRAVITY)
    speed, angle = 3.0, 1e-4
    given = jnp.full(500, speed), jnp.full(500, angle)
    end = predicted(linear, State(0, 0, 0, 0, 0), *given, 0.01, 4).states
    gradient = (1 / front - 1 / rear) / GRAVITY
    steady = speed / (L_F + L_R + gradient * speed**2)
    assert float(end.yaw_rate[-1]) / angle == pytest.approx(steady, rel=1e-6)


def test_the_fastest_rate_agrees_with_the_linear_car():
    front, rear, speed = 5.0, 7.0, 1.5
    linear = Car(LinearTire(front), LinearTire(rear), MASS, INERTIA, L_F, L_R, GRAVITY)
    ahead, behind = (load * s for load, s in zip(axle_loads(linear), (front, rear), strict=True))
    matrix = -np.array(
        [
            [(ahead + behind) / MASS, (L_F * ahead - L_R * behind) / MASS],
            [(L_F * ahead - L_R * behind) / INERTIA, (L_F**2 * ahead + L_R**2 * behind) / INERTIA],
        ]
    ) / speed - np.array([[0, speed], [0, 0]])
    assert stiffest(linear, speed) == pytest.approx(np.abs(np.linalg.eigvals(matrix)).max())


def test_changes_of_the_car_enter_newton_and_euler():
    """Every change at once; stiffness and friction are those of another brush."""
    front = Axle(1.3, 0.8, load=1.1, slip=0.01, fall=0.2, sliding=0.3, force=2.0)
    rear = Axle(0.9, 1.2, load=0.95, slip=-0.02, fall=0.1, sliding=0.2, force=-1.5)
    changes = Changes(front, rear, inertia=1.4, l_f=-0.02, l_r=0.02, force=3.0, moment=-0.5)
    v_x, steering, v_y, turn, late = 3.0, 0.1, -0.25, 1.2, (0.015, -0.01)
    found = accelerations(car(), v_x, steering, v_y, turn, changes, late)
    forces, arms = [], (L_F - 0.02, -L_R - 0.02)
    for axle, (c, mu), arm, other, wheel, more in zip(
        (front, rear), TIRES.values(), arms, arms[::-1], (steering, 0.0), late, strict=True
    ):
        angle = np.arctan2(v_y + arm * turn, v_x) - wheel + more + axle.slip
        fz = MASS * GRAVITY * abs(other) / (L_F + L_R) * axle.load
        size = brush(np.tan(abs(angle)), fz, v_x, c * axle.stiffness, mu * axle.friction)
        far = (np.tan(angle) * axle.stiffness / axle.friction / axle.sliding) ** 2
        lost = axle.fall * far / (1 + far)
        forces.append(np.sign(angle) * size * (1 - lost) + axle.force)
    ahead, behind = forces[0] * np.cos(steering), forces[1]
    lateral = (3.0 - ahead - behind) / MASS
    yaw = (-0.5 - arms[0] * ahead - arms[1] * behind) / (1.4 * INERTIA)
    np.testing.assert_allclose(found, (lateral, yaw), rtol=1e-9)
