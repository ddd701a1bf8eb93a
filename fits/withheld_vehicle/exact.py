"""Cars that the model of a diagnosis describes exactly, in plain NumPy: a single track on two
brushes, integrated in steps of 0.2 ms, logged at 50 Hz with white noise on v_x, v_y, yaw rate
and a_y. A diagnosis should name nothing.

    python -m fits.withheld_vehicle.exact --first 0 --cars 20 --out out/exact

``--out`` receives ``exact.jsonl``, a line per car and way of its tires: given, fitted to the
forces of ``derive``, or given with l_f and l_r exchanged.
"""

import argparse
import json
import tempfile
from pathlib import Path

import numpy as np

from fits.formulas import brush
from fits.withheld_vehicle.drives import G, trial

STEP, RATE, SECONDS = 2e-4, 50.0, 20.0  # s of a step, Hz of the log, s of a drive
WAYS = ("given", "derive", "swapped")
NAMES = ("l_f", "l_r", "mass", "inertia", "speed", "grip", "mu", "pace")


def driven(cars: list[dict]) -> list[np.ndarray]:
    """Time, v_x, v_y, yaw rate, a_y and wheel angle (rows, 6) of each car, without noise; all
    cars are integrated together."""
    l_f, l_r, mass, inertia, speed, grip, mu, pace = (
        np.array([car[name] for car in cars]) for name in NAMES
    )
    loads = np.array([car["loads"] for car in cars]).T
    stiffness, friction = (np.array([[t[k] for t in car["tires"]] for car in cars]).T
                           for k in (0, 1))  # fmt: skip
    phases = np.array([np.random.default_rng(car["seed"]).uniform(0, 6.3, 5) for car in cars]).T
    rate = pace * np.array([1.0 if car["small"] else 0.6 for car in cars])

    def inputs(t):
        v = speed * (1 + 0.08 * np.sin(0.3 * t + phases[3]) + 0.05 * np.sin(0.7 * t + phases[4]))
        turns = zip((1, 0.6, 0.35), (0.13, 0.41, 1.1), phases[:3], strict=True)
        wish = sum(a * np.sin(2 * np.pi * f * rate * t + p) for a, f, p in turns)
        wish = wish * grip * mu * G / 1.6
        return v, np.arctan((l_f + l_r) * wish / v**2) + 0.02 * wish / G

    def slope(t, state):
        (v_y, r), (v, delta) = state, inputs(t)
        slip = np.array([np.arctan2(v_y + l_f * r, v) - delta, np.arctan2(v_y - l_r * r, v)])
        forces = -np.sign(slip) * brush(np.abs(np.tan(slip)), loads, v, stiffness, friction)
        front = forces[0] * np.cos(delta)
        a_y = (front + forces[1]) / mass
        return np.array([a_y - v * r, (l_f * front - l_r * forces[1]) / inertia]), a_y

    state, rows = np.zeros((2, len(cars))), []
    every, count = round(1 / RATE / STEP), round(SECONDS / STEP)
    for k in range(count):
        t = k * STEP
        one, a_y = slope(t, state)
        if k % every == 0:
            v, delta = inputs(t)
            rows.append(np.array([np.full_like(v, t), v, *state, a_y, delta]))
        two = slope(t + STEP / 2, state + STEP / 2 * one)[0]
        three = slope(t + STEP / 2, state + STEP / 2 * two)[0]
        four = slope(t + STEP, state + STEP * three)[0]
        state = state + STEP / 6 * (one + 2 * two + 2 * three + four)
    return list(np.moveaxis(np.array(rows), 2, 0))


def written(number: int, car: dict, rows: np.ndarray, folder: Path, swapped: bool = False):
    """The log of a car with white noise, and its ``vehicle.toml``; ``swapped`` exchanges l_f
    and l_r there."""
    rng, scale = np.random.default_rng([number, 77]), 0.3 if car["small"] else 1.0
    noise = np.array([0.0, 0.02 * scale, 0.02 * scale, 0.004 / scale, 0.05, 0.0])
    rows = rows + noise * rng.standard_normal(rows.shape)
    folder.mkdir(parents=True, exist_ok=True)
    log, vehicle = folder / f"exact_{number}.csv", folder / "vehicle.toml"
    head = "t,v_x,v_y,yaw_rate,a_y,steer"
    np.savetxt(log, rows, "%.7g", ",", header=head, comments="")
    l_f, l_r = (car["l_r"], car["l_f"]) if swapped else (car["l_f"], car["l_r"])
    vehicle.write_text(
        f"mass = {car['mass']}\nl_f = {l_f}\nl_r = {l_r}\n"
        f"yaw_inertia = {car['inertia']}\ngravity = {G}\n"
        '[columns]\ntime = "t"\nv_x = "v_x"\nv_y = "v_y"\nyaw_rate = "yaw_rate"\n'
        'a_y = "a_y"\nsteering = "steer"\n'
        "[steering]\ncommand = [-1.0, 1.0]\nangle = [-1.0, 1.0]\n"
        f"[filter]\ncutoff = 8.0\nsample_rate = {RATE:g}\n"
    )
    return log, vehicle


def judged(number: int, car: dict, rows: np.ndarray, way: str) -> dict:
    """The verdict on a car."""
    import tirefit
    from tirefit.models import Brush

    with tempfile.TemporaryDirectory() as folder:
        log, vehicle = written(number, car, rows, Path(folder), way == "swapped")
        tires = ("brush", "brush")
        if way != "derive":
            tires = tuple(Brush(cpa2=c, mu=mu) for c, mu in car["tires"])
        about = {"number": number, "way": way}
        try:
            found = tirefit.diagnose_vehicle([log], vehicle, *tires)
        except tirefit.DataError as error:
            return about | {"status": "refused", "reason": str(error)}
    verdict = found.verdict
    return about | {
        "status": verdict.status.value,
        "effects": verdict.effects,
        "acts_like": verdict.acts_like,
        "each": {e: (one.probability, one.twins) for e, one in verdict.each.items()},
        "also_possible": verdict.also_possible,
        "ladder": [(s.effects, s.rms_left_out) for s in found.ladder.steps],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--cars", type=int, default=20)
    parser.add_argument("--ways", nargs="*", choices=WAYS, default=WAYS[:2])
    parser.add_argument("--out", type=Path, required=True)
    asked = parser.parse_args()
    import jax

    jax.config.update("jax_enable_x64", True)
    asked.out.mkdir(parents=True, exist_ok=True)
    numbers = range(asked.first, asked.first + asked.cars)
    cars = [trial(number, "none").car for number in numbers]
    drives = driven(cars)
    with (asked.out / "exact.jsonl").open("a") as file:
        for way in asked.ways:
            for number, car, rows in zip(numbers, cars, drives, strict=True):
                found = judged(number, car, rows, way)
                file.write(json.dumps(found) + "\n")
                file.flush()
                print(found, flush=True)


if __name__ == "__main__":
    main()
