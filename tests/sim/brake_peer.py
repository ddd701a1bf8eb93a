"""The braked quarter car computed independently: SciPy, and rules in plain Python.

Nothing of tirefit is imported: the brush is the formula of S(31), written out, the
plant a right-hand side for ``solve_ivp`` that is stopped and restarted where the wheel
locks, the controller ifs on floats.
"""

from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

GRAVITY = 9.81


@dataclass
class QuarterCar:
    """Wheel and road; ``mu``: peak of the force over the load; ``m`` of S(31)."""

    fz: float
    radius: float
    inertia: float
    gain: float
    cpa2: float
    m: float
    mu: float
    slow: float = 0.3

    def force(self, v, omega):
        """Braking force [N] of a brush with sliding friction m times the static."""
        static = self.mu * (3 - 2 * self.m) ** 2 / (4 - 3 * self.m) * self.fz
        kappa = min((v - omega * self.radius) / max(v, self.slow), 0.99)
        sigma = kappa / (1 - kappa)
        demand = self.cpa2 * abs(sigma)
        xi = min(4 * demand / (3 * static) - 1, 1.0)
        share = (2 + 3 * xi - xi**3) / 4
        size = self.m * static * share + demand * (1 - xi) ** 2 / 2
        return np.sign(sigma) * size


@dataclass
class Valves:
    demand: float
    ramp: float
    rise: float
    fall: float
    lag: float

    def flow(self, t, p, valve):
        master = min(self.demand, self.ramp * t)
        change = min(master - p, 0.0) / self.lag
        change = max(change, -self.fall)
        if valve > 0:
            change += valve * min(max((master - p) / self.lag, 0.0), self.rise)
        if valve < 0:
            change += valve * min(max(p / self.lag, 0.0), self.fall)
        return change


def interval(car: QuarterCar, valves: Valves, state, valve, d, t, period):
    """State (distance, v, omega, p) after one sample; d: road forces at both ends."""
    mass = car.fz / GRAVITY

    def rate(locked):
        def inner(now, y):
            _, v, omega, p = y
            share = (now - t) / period
            felt = car.force(v, omega) + d[0] + share * (d[1] - d[0])
            spin = 0.0 if locked else (felt * car.radius - car.gain * p) / car.inertia
            return [v, -felt / mass, spin, valves.flow(now, p, valve)]

        return inner

    def stands(now, y):
        return y[2] - 1e-12

    stands.terminal, stands.direction = True, -1
    y = np.array(state, float)
    if y[2] <= 0 and rate(False)(t, y)[2] < 0:
        locked = True
    else:
        locked = False
    options = {"method": "LSODA", "rtol": 1e-10, "atol": [1e-10, 1e-10, 1e-9, 1e-3]}
    events = None if locked else stands
    done = solve_ivp(rate(locked), (t, t + period), y, events=events, **options)
    y = done.y[:, -1]
    if done.status == 1:
        y[2] = 0.0
        rest = (done.t[-1], t + period)
        y = solve_ivp(rate(True), rest, y, **options).y[:, -1]
    y[2] = max(y[2], 0.0)
    return y


class PlainABS:
    """The table of ``tirefit.online.braking.abs``, with ifs; ``k``: its settings by name."""

    def __init__(self, k, period, speed):
        self.k, self.period = k, period
        self.reference = self.wheel = speed
        self.acceleration = self.since = 0.0
        self.fast, self.phase, self.lock = False, "build", np.inf

    def step(self, wheel, pressure, deceleration):
        k = self.k
        rate = (wheel - self.wheel) / self.period
        share = self.period / (self.period + k["smoothing"])
        self.acceleration += share * (rate - self.acceleration)
        fall = max(deceleration, 0.0) + k["margin"]
        self.reference = max(wheel, self.reference - fall * self.period)
        self.wheel = wheel
        self.fast = self.fast or self.acceleration > k["speeding"]
        after = self.next_phase(1 - wheel / max(self.reference, 1e-3))
        if after != self.phase:
            if after in ("hold", "dump") and self.phase in ("build", "step"):
                self.lock = pressure
            self.phase, self.since = after, 0.0
        else:
            self.since += self.period
        if self.phase != "wait":
            self.fast = False
        return self.valve(pressure)

    def next_phase(self, slip):
        k, a = self.k, self.acceleration
        slows = a < -k["slowing"]
        slips, deep = slip > k["slip"], slip > k["most_slip"]
        if self.reference < k["off"]:
            return "build"
        if self.phase == "build":
            return "dump" if deep else "hold" if slows else "build"
        if self.phase == "hold":
            return "dump" if slips else "hold" if slows else "step"
        if self.phase == "dump":
            again = self.since < self.period and slips
            return "dump" if slows or again else "wait"
        if self.phase == "wait":
            idle = not self.fast and self.since >= k["patience"]
            been = self.fast and a < k["speeding"] and not deep
            if been or a > k["racing"] or (idle and not slips):
                return "step"
            return "dump" if slows or idle else "wait"
        if (slows and slips) or deep:
            return "dump"
        return "hold" if slows else "step"

    def valve(self, pressure):
        k = self.k
        if self.phase == "build":
            return 1.0
        if self.phase == "dump":
            return -k["dump_share"]
        if self.phase == "step":
            if pressure < k["quick"] * self.lock:
                return 1.0
            return min(max(k["step_share"] + k["step_growth"] * self.since, 0.0), 1.0)
        return 0.0


def stop(car, valves, controller, sensors, noise, speed, rate, samples, queue):
    """Rows (distance, v, omega, p, valve) until the car is slower than 0.1 m/s.

    ``sensors``: speed_std, deceleration_std, pressure_std; ``noise``: standard normal
    numbers speed, pressure, deceleration and road (d over the load), as drawn.
    """
    period, mass = 1 / rate, car.fz / GRAVITY
    state = np.array([0.0, speed, speed / car.radius, 0.0])
    waiting, rows = [0.0] * queue, []
    for k in range(samples):
        _, v, omega, p = state
        d = noise["road"][k : k + 2] * car.fz
        wheel = omega * car.radius
        wheel += sensors["speed_std"] * noise["speed"][k] * (wheel > 0)
        slowing = (car.force(v, omega) + d[0]) / mass
        slowing += sensors["deceleration_std"] * noise["deceleration"][k]
        seen = p + sensors["pressure_std"] * noise["pressure"][k]
        if k == 0:
            controller.reference = controller.wheel = max(wheel, 0.0)
        waiting.append(controller.step(max(wheel, 0.0), seen, slowing))
        valve = waiting.pop(0)
        rows.append([*state, valve])
        if v <= 0.1:
            break
        state = interval(car, valves, state, valve, d, k * period, period)
    return np.array(rows)
