"""Simulates drives of known tires, writes their logs, and fits them by both methods."""

import tempfile
import time
from pathlib import Path

import jax
import numpy as np

jax.config.update("jax_enable_x64", True)

import tirefit  # noqa: E402
from fits.formulas import brush  # noqa: E402
from tirefit.data.vehicle.derive import derive  # noqa: E402
from tirefit.data.vehicle.vehicle import Vehicle  # noqa: E402
from tirefit.sim.drive import Car, Drive, simulate_drive  # noqa: E402

RATES = (100, 50, 20)  # Hz
DURATION, FINE = 40.0, 200.0  # s, Hz of the simulated drive before logging
V_STD, YAW_STD, A_Y_STD = 0.03, 0.002, 0.05  # m/s, rad/s, m/s2
GRAVITY = 9.81  # m/s2
YAW_STEP, STEERING_STEP = 0.005, 0.002  # rad/s, rad
NAMES = ("front.cpa2", "front.mu", "rear.cpa2", "rear.mu", "steering_delay", "steering_offset")


def drive(seed: int, wheels: bool):
    """The columns of a drive at 200 Hz, its car and its truth by name."""
    random = np.random.default_rng([17, seed])
    car = Car(stiffness_f=random.uniform(9, 13), stiffness_r=random.uniform(12, 16))
    how = Drive(
        duration=DURATION,
        rate=FINE,
        speed=random.uniform(18, 26),
        bend=random.uniform(0.55, 0.7),
        bend_period=random.uniform(4, 6),
        friction=random.uniform(0.7, 1.0),
        seed=seed,
    )
    weight = car.mass * GRAVITY / (car.l_f + car.l_r)
    truth = {
        "front.cpa2": car.stiffness_f * weight * car.l_r / 2,
        "rear.cpa2": car.stiffness_r * weight * car.l_f / 2,
        "front.mu": how.friction,
        "rear.mu": how.friction,
        "steering_delay": random.uniform(0.03, 0.12),
        "steering_offset": random.uniform(-0.01, 0.01),
    }
    if wheels:
        log = simulate_drive(how, car)
        return log.truth | {"steering": log.columns["steering"]}, car, truth
    return single_track(car, how, truth, random), car, truth


def single_track(car: Car, how: Drive, truth, random) -> dict[str, np.ndarray]:
    """A single-track car on brushes, steered by two sines: Runge-Kutta in NumPy."""
    time = np.arange(round(how.duration * FINE)) / FINE
    base, step = car.l_f + car.l_r, 1 / FINE
    weight = car.mass * GRAVITY / base
    phases = random.uniform(0, 2 * np.pi, 3)
    fast = random.uniform(0.5, 1.0)  # Hz

    def v_x(t):
        return how.speed + 2 * np.sin(2 * np.pi * t / 15 + phases[0])

    softer = 1 / car.stiffness_f - 1 / car.stiffness_r
    full = 1.2 * how.bend * how.friction * GRAVITY
    full = full * (base / how.speed**2 + softer / GRAVITY)

    def delta(t):
        slow = np.sin(2 * np.pi * t / how.bend_period + phases[1])
        return full * (slow + 0.35 * np.sin(2 * np.pi * fast * t + phases[2]))

    def forces(t, v_y, turn):
        found = []
        for name, arm, load, turned in (
            ("front", car.l_f, weight * car.l_r, delta(t)),
            ("rear", -car.l_r, weight * car.l_f, 0.0),
        ):
            slip = np.arctan2(v_y + arm * turn, v_x(t)) - turned
            cpa2, mu = truth[f"{name}.cpa2"], truth[f"{name}.mu"]
            size = brush(np.tan(abs(slip)), load, how.speed, cpa2, mu)
            found.append(-np.sign(slip) * float(size))
        front = found[0] * np.cos(delta(t))
        lateral = (front + found[1]) / car.mass
        return lateral, (car.l_f * front - car.l_r * found[1]) / car.yaw_inertia

    def slope(t, state):
        lateral, yaw = forces(t, *state)
        return np.array([lateral - v_x(t) * state[1], yaw])

    states = [np.zeros(2)]
    for t in time[:-1]:
        now = states[-1]
        k1 = slope(t, now)
        k2 = slope(t + step / 2, now + step / 2 * k1)
        k3 = slope(t + step / 2, now + step / 2 * k2)
        k4 = slope(t + step, now + step * k3)
        states.append(now + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4))
    v_y, turn = np.array(states).T
    a_y = np.array([forces(*each)[0] for each in zip(time, v_y, turn, strict=True)])
    return {
        "time": time,
        "v": v_x(time),
        "v_y": v_y,
        "yaw_rate": turn,
        "a_y": a_y,
        "steering": delta(time),
    }


def log_of(log, truth, rate: int, seed: int, path: Path) -> None:
    """Write the log at this rate."""
    random = np.random.default_rng([23, seed, rate])
    time, late = log["time"], truth["steering_delay"]

    def noisy(name, std):
        return log[name] + std * random.standard_normal(len(time))

    rows = np.arange(0, len(time) - int(0.15 * FINE), round(FINE / rate))
    steering = np.interp(time + late, time, log["steering"])
    steering = steering - truth["steering_offset"]
    yaw = noisy("yaw_rate", YAW_STD)
    cells = {
        "t": time,
        "v_x": noisy("v", V_STD),
        "a_y": noisy("a_y", A_Y_STD),
        "v_y": noisy("v_y", V_STD),
        "r": YAW_STEP * np.round(yaw / YAW_STEP),
        "delta": STEERING_STEP * np.round(steering / STEERING_STEP),
    }
    table = np.stack([values[rows] for values in cells.values()], axis=1)
    np.savetxt(path, table, "%.6f", ",", header=",".join(cells), comments="")


def vehicle_of(car: Car, rate: int) -> Vehicle:
    return Vehicle.model_validate({
        "mass": car.mass, "l_f": car.l_f, "l_r": car.l_r, "gravity": GRAVITY,
        "yaw_inertia": car.yaw_inertia,
        "columns": {
            "time": "t", "v_x": "v_x", "v_y": "v_y", "yaw_rate": "r", "a_y": "a_y",
            "steering": "delta",
        },
        "filter": {"sample_rate": rate, "cutoff": min(5.0, rate / 5)},
        "steering": {"command": [-1.0, 1.0], "angle": [-1.0, 1.0]},
    })  # fmt: skip


def trial(seed: int, wheels: bool = False) -> list[dict]:
    """One drive: at each rate the truth and the estimates by both methods."""
    log, car, truth = drive(seed, wheels)
    found = []
    for rate in RATES:
        vehicle = vehicle_of(car, rate)
        one: dict = {"seed": seed, "rate": rate, "truth": truth}
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, "drive.csv")
            log_of(log, truth, rate, seed, path)
            begun = time.process_time()
            fit = tirefit.fit_trajectory([path], vehicle)
            one["seconds"] = time.process_time() - begun
            one["trajectory"] = {k: (e.value, *e.ci95) for k, e in fit.parameters.items()}
            one["converged"] = fit.converged
            begun = time.process_time()
            one["derived"] = {}
            for axle in ("front", "rear"):
                columns = derive(path, vehicle, axle, believe=True).columns
                rows = {k: columns[k] for k in ("alpha", "fy", "fz", "v", "time")}
                by_force = tirefit.fit(tirefit.read_frame(rows), "brush")
                for name in ("cpa2", "mu"):
                    e = by_force.parameters[name]
                    one["derived"][f"{axle}.{name}"] = (e.value, *e.ci95)
            one["seconds_derived"] = time.process_time() - begun
        found.append(one)
    return found


def table(trials: list[dict]) -> str:
    """Coverage, bias and spread of each parameter by rate and method, in Markdown."""
    lines = [
        "| rate | parameter | holds | bias | spread | derive + fit: holds | bias | spread |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for rate in RATES:
        own = [one for one in trials if one["rate"] == rate and one["converged"]]
        for name in NAMES:
            cells = [f"{rate} Hz", f"`{name}`"]
            for way in ("trajectory", "derived"):
                if name not in own[0][way]:
                    cells += ["-"] * 3
                    continue
                true = np.array([one["truth"][name] for one in own])
                value, low, high = np.array([one[way][name] for one in own], float).T
                share = np.mean((low <= true) & (true <= high))
                is_plain = name.startswith("steering")
                error = (value - true) / (1 if is_plain else true)
                error = error * (1e3 if is_plain else 100)
                unit = {"steering_delay": " ms", "steering_offset": " mrad"}
                unit = unit.get(name, " %")
                middle = 1.4826 * np.median(np.abs(error - np.median(error)))
                cells += [
                    f"{100 * share:.1f} %",
                    f"{np.median(error):+.2g}{unit}",
                    f"{middle:.2g}{unit}",
                ]
            lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"
