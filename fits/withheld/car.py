"""A four-wheeled car on a drive, with faults of the car or of its log.

This is the independent route for the effects of a vehicle: two wheels per axle, each
with its own load, slip angle and closed-form brush, integrated in time. No code is
shared with tirefit. Axes by ISO 8855; alpha and the force of an axle as in
``tirefit.slip``: alpha is positive if the axle slides to the left, and the force then
acts to the right.
"""

from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

__all__ = ["FAULTS", "Car", "drive"]

GRAVITY = 9.80665
MASS, INERTIA = 1400.0, 2300.0  # kg, kg m2
ARMS = {"front": 1.2, "rear": 1.4}  # m, of the axles about the centre of gravity
WHEELBASE, TRACK = 2.6, 1.5  # m
STIFFNESS, FRICTION = 4.5e4, 0.9  # c_p a^2 [N] and mu of an axle

_ROUNDS = 12
"""Iterations after which a_y and the load transfer have converged to 0.02 %."""


@dataclass(frozen=True)
class Car:
    """Faults that the model of an axle does not contain, and faults of the log.

    Attributes:
        height: of the centre of gravity [m]; 0: no load transfer.
        with_load: exponents of stiffness and friction over the load of a wheel.
        toe: toe-in of both rear wheels [rad].
        unlike: friction of the left tires over the mean, minus one.
        slope, downhill: of the floor, and the heading that points downhill [rad].
        logged_inertia: yaw inertia used to derive the forces, over the true one.
        ahead: distance of the point of the logged slip angle ahead of the axle [m].
        logged_steer: logged road wheel angle over the true one.
        logged_load: whether fz is logged with the longitudinal transfer.
    """

    height: float = 0.0
    with_load: tuple[float, float] = (0.0, 0.0)
    toe: float = 0.0
    unlike: float = 0.0
    slope: float = 0.0
    downhill: float = 0.6
    logged_inertia: float = 1.0
    ahead: float = 0.0
    logged_steer: float = 1.0
    logged_load: bool = True

    def load(self, axle: str, a_x):
        """Load of an axle [N]."""
        arm = ARMS["rear" if axle == "front" else "front"]
        moved = MASS * a_x * self.height / WHEELBASE
        static = MASS * GRAVITY * arm / WHEELBASE
        return static + (moved if axle == "rear" else -moved)

    def force(self, axle: str, alpha, a_x, a_y):
        """Force of both wheels [N]; a_y > 0 (left turn) moves load to the right wheel."""
        load, total = self.load(axle, a_x), 0.0
        for side in (-1.0, 1.0):  # left, right
            share = 0.5 + side * a_y * self.height / (GRAVITY * TRACK)
            relative = np.maximum(2 * share, 0.05)
            stiff, grip = (relative**power for power in self.with_load)
            mu = FRICTION * grip * (1 - side * self.unlike)
            angle = alpha - side * self.toe * (axle == "rear")
            limit = mu * load * relative / 2
            part = 2 * (STIFFNESS / 2) * stiff * np.abs(np.tan(angle)) / (3 * limit)
            held = 1 - (1 - np.minimum(part, 1.0)) ** 3
            total = total + np.sign(angle) * limit * held
        return total


def speed(time):
    """Forward speed [m/s]."""
    return 16.0 + 5.0 * np.sin(0.31 * time)


def speed_rate(time):
    return 5.0 * 0.31 * np.cos(0.31 * time)


def steer(time):
    """Road wheel angle [rad]: turns to both sides, more to one."""
    swing = np.sin(1.1 * time) + 0.7 * np.sin(2.3 * time + 1) + 0.4 * np.sin(5.1 * time)
    return 0.012 + 0.05 * (0.5 + 0.5 * np.sin(0.13 * time)) * swing


def _angles(time, v_y, yaw_rate):
    v_x = speed(time)
    return {
        "front": np.arctan2(v_y + ARMS["front"] * yaw_rate, v_x) - steer(time),
        "rear": np.arctan2(v_y - ARMS["rear"] * yaw_rate, v_x),
    }


def _accelerations(car: Car, time, yaw, v_y, yaw_rate):
    """(a_y, yaw acceleration, forces by axle), iterated: a_y changes the loads."""
    angles, a_x = _angles(time, v_y, yaw_rate), speed_rate(time) - v_y * yaw_rate
    pull = GRAVITY * car.slope * np.sin(car.downhill - yaw)
    a_y = v_y * 0.0
    # Without height there is no load transfer, and one iteration is enough.
    for _ in range(_ROUNDS if car.height else 1):
        forces = {axle: car.force(axle, angles[axle], a_x, a_y) for axle in angles}
        front = forces["front"] * np.cos(steer(time))
        followed = -(front + forces["rear"]) / MASS + pull
        a_y = 0.5 * (a_y + followed) if car.height else followed
    turn = (ARMS["rear"] * forces["rear"] - ARMS["front"] * front) / INERTIA
    return a_y, turn, forces


def drive(
    car: Car, axle: str = "rear", measured: bool = False, seed: int = 0, rows: int = 700
) -> dict[str, np.ndarray]:
    """The log of one axle, (n,) each, at 10 Hz.

    Args:
        measured: the force is measured in the hubs; otherwise derived from the motion.
        seed: of the noise: 0.5 mrad in the slip angle, 0.5 % of the load in the force.
    """
    generator, time = np.random.default_rng(seed), np.arange(rows) * 0.1

    def rates(t, state):
        yaw, v_y, yaw_rate = state
        a_y, turn, _ = _accelerations(car, t, yaw, v_y, yaw_rate)
        return [yaw_rate, a_y - speed(t) * yaw_rate, turn]

    found = solve_ivp(rates, (0, time[-1]), [0.0, 0.0, 0.0], t_eval=time, max_step=0.1, rtol=1e-7)
    yaw, v_y, yaw_rate = found.y
    a_y, turn, forces = _accelerations(car, time, yaw, v_y, yaw_rate)
    a_x = speed_rate(time) - v_y * yaw_rate
    arm = ARMS["front"] if axle == "front" else -ARMS["rear"]
    other = ARMS["rear" if axle == "front" else "front"]
    static = MASS * GRAVITY * other / WHEELBASE
    noisy = 0.005 * static * generator.standard_normal(rows)
    logged = car.logged_steer * steer(time)
    if measured:
        force = forces[axle] + noisy
    else:
        # Noise of the acceleration, equal to that of the force.
        a_y = a_y + noisy * WHEELBASE / (MASS * other)
        inertial = np.sign(arm) * car.logged_inertia * INERTIA * turn
        force = -(MASS * other * a_y + inertial) / WHEELBASE
        force = force / np.cos(logged) if axle == "front" else force
    sideways = v_y + (arm + car.ahead) * yaw_rate
    alpha = np.arctan2(sideways, speed(time)) - (axle == "front") * logged
    return {
        "time": time,
        "alpha": alpha + 5e-4 * generator.standard_normal(rows),
        "fy": force,
        "fz": car.load(axle, a_x) if car.logged_load else np.full(rows, static),
        "v": speed(time),
        "a_x": a_x,
        "a_y": a_y,
        "yaw_rate": yaw_rate,
        "yaw_acceleration": turn,
        "heading": yaw,
        "steering": logged,
    }


FAULTS = {
    "yaw_inertia": (Car(logged_inertia=1.5), "rear", False),
    "floor_slope": (Car(slope=0.02), "rear", False),
    "tracked_point": (Car(ahead=0.05), "rear", False),
    "toe": (Car(height=0.55, with_load=(1.0, 0.0), toe=0.006), "rear", True),
    "lateral_load_transfer": (Car(height=0.75, with_load=(0.6, -0.35)), "rear", True),
    "unlike_tires": (Car(height=0.55, with_load=(1.0, 0.0), unlike=0.12), "rear", True),
    "load_transfer": (Car(height=0.6, logged_load=False), "rear", True),
    "steering_gain": (Car(logged_steer=1.15), "front", True),
}
"""Effect -> a car with it, the axle that shows it, whether the force is measured."""
