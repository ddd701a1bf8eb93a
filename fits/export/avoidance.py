"""Plans the shortest path around an obstacle with exported tires: ``shortest``.

A single-track car of constant forward speed steers around an obstacle. CasADi's IPOPT
finds the steering that needs the shortest distance, by 40 steps of Runge-Kutta; the
tires are modules written by ``tirefit export --to casadi``.
"""

from typing import NamedTuple

import casadi as ca
import numpy as np

MASS, INERTIA = 5.1, 0.12  # kg, kg m2
AHEAD = 0.165  # m, from the centre of gravity to each axle
LOAD = MASS * 9.81 / 2  # N, on each axle
STEPS = 40
MOST_STEERING, FASTEST = 0.4, 6.0  # rad at the wheel, rad/s


class Way(NamedTuple):
    """A path around an obstacle: time (n,) [s], steering angle (n,) [rad], position x, y
    (n,) [m], and the ``distance`` from the obstacle at which it begins [m]."""

    time: np.ndarray
    steering: np.ndarray
    x: np.ndarray
    y: np.ndarray
    distance: float


def slip_angles(speed: float, state):
    """Slip angles of front and rear axle [rad], positive if the axle slides to the left
    (ISO-W); the state is x, y, heading, v_y, yaw rate, steering angle."""
    sideways, turn, steering = state[3], state[4], state[5]
    front = ca.arctan2(sideways + AHEAD * turn, speed) - steering
    return front, ca.arctan2(sideways - AHEAD * turn, speed)


def motion(speed: float, state, rate, front, rear) -> list:
    """Derivative of the state; ``front`` and ``rear`` map slip angle to force to the left
    [N], ``rate`` is the steering rate [rad/s]."""
    heading, sideways, turn = state[2], state[3], state[4]
    angles = slip_angles(speed, state)
    forces = [force(a) for force, a in zip((front, rear), angles, strict=True)]
    return [
        speed * ca.cos(heading) - sideways * ca.sin(heading),
        speed * ca.sin(heading) + sideways * ca.cos(heading),
        turn,
        sum(forces) / MASS - speed * turn,
        AHEAD * (forces[0] - forces[1]) / INERTIA,
        rate,
    ]


def shortest(front, rear, speed: float = 4.0, aside: float = 0.5) -> Way:
    """The steering that moves the car ``aside`` [m] in the shortest distance.

    Args:
        front, rear: exported ``casadi.Function`` of the axles' tires.
        speed: forward [m/s].
    """
    tires = [lambda a, f=f: f(0.0, a, LOAD)[1] for f in (front, rear)]
    state, rate, span = ca.SX.sym("state", 6), ca.SX.sym("rate"), ca.SX.sym("span")

    def slope(at):
        return ca.vertcat(*motion(speed, ca.vertsplit(at), rate, *tires))

    k1 = slope(state)
    k2 = slope(state + span / 2 * k1)
    k3 = slope(state + span / 2 * k2)
    k4 = slope(state + span * k3)
    step = ca.Function(
        "step", [state, rate, span], [state + span / 6 * (k1 + 2 * k2 + 2 * k3 + k4)]
    )
    problem = ca.Opti()
    states = problem.variable(6, STEPS + 1)
    rates, whole = problem.variable(1, STEPS), problem.variable()
    problem.subject_to(states[:, 0] == 0)
    for k in range(STEPS):
        following = step(states[:, k], rates[k], whole / STEPS)
        problem.subject_to(states[:, k + 1] == following)
    problem.subject_to(problem.bounded(-FASTEST, rates, FASTEST))
    problem.subject_to(problem.bounded(-MOST_STEERING, states[5, :], MOST_STEERING))
    problem.subject_to(states[1, STEPS] == aside)
    problem.subject_to(problem.bounded(0.1, whole, 3.0))
    problem.minimize(states[0, STEPS])
    problem.set_initial(whole, 0.5)
    problem.set_initial(states[0, :], np.linspace(0, speed / 2, STEPS + 1))
    problem.solver("ipopt", {"print_time": False}, {"print_level": 0, "sb": "yes"})
    found = problem.solve()
    x, y, *_, steering = found.value(states)
    time = np.linspace(0, found.value(whole), STEPS + 1)
    return Way(time, steering, x, y, float(x[-1]))
