"""Cars and simulators of them with one fault drawn at random, both in plain NumPy: does
`tirefit diagnose --vehicle --sim-log` name the fault, and its size?

    python -m fits.withheld_vehicle.simulators --first 200 --trials 40 --out out/simulators

``--out`` receives ``trials.jsonl``, a line per trial; trials that it has are not run again.
"""

import argparse
import json
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np

from fits.withheld_vehicle.drives import STEP, Trial, drive, trial, written

FAULTS = (
    "centre_of_gravity", "mass", "yaw_inertia", "steering_delay", "steering_ratio", "linear",
    "stiffness", "friction", "lateral_load_transfer", "tracked_point", "units", "none",
)  # fmt: skip
SHARED = "steering_offset", "relaxation_length", "bank", "friction_speed"
"""Effects that a third of the cars have, and their simulators as well."""
UNITS = {
    "v_y reversed": ("v_y", -1.0, "sign"),
    "yaw_rate reversed": ("yaw_rate", -1.0, "sign"),
    "yaw_rate in degrees": ("yaw_rate", np.rad2deg(1.0), "deg"),
    "v_y in km/h": ("v_y", 3.6, "km/h"),
}
"""Fault of a unit -> column, factor, and the word that names it."""
RANGES = {
    "centre_of_gravity": (0.04, 0.1), "mass": (0.2, 0.4), "yaw_inertia": (0.25, 0.6),
    "steering_delay": (0.04, 0.12), "steering_ratio": (0.08, 0.25), "stiffness": (0.2, 0.5),
    "friction": (0.15, 0.4), "lateral_load_transfer": (0.3, 0.6), "tracked_point": (0.1, 0.4),
}  # fmt: skip
SIGNED = "centre_of_gravity", "mass", "yaw_inertia", "steering_ratio", "stiffness", "friction"
SECONDS, LEFT_OUT = 30.0, 12.0  # of the drive, and of the one that is left out
OTHER = 77  # added to the seed for the latter


def _size(fault: str, rng) -> float:
    low, high = RANGES.get(fault, (0.0, 0.0))
    sign = rng.choice([-1.0, 1.0]) if fault in SIGNED else 1.0
    return float(sign * rng.uniform(low, high))


def pair(number: int) -> tuple[Trial, Trial, dict]:
    """The car, its simulator, and what is true: fault, size, differing quantities."""
    rng = np.random.default_rng([number, 777])
    fault = FAULTS[int(rng.integers(len(FAULTS)))]
    size, car = _size(fault, rng), replace(trial(number, "none"), seconds=SECONDS)
    if rng.random() < 1 / 3:
        shared = SHARED[int(rng.integers(len(SHARED)))]
        amount = {"steering_offset": 0.02, "relaxation_length": 0.3, "bank": 0.03}
        car.also[shared] = amount.get(shared, 0.3)
    simulator = replace(car, car=dict(car.car), also=dict(car.also))
    axles = ((1, 1), (1, 0), (0, 1))[int(rng.integers(3))]
    unit = [*UNITS][int(rng.integers(len(UNITS)))]
    told = bool(rng.random() < 0.5)  # vehicle.toml has the fault of the simulator
    factor, its = float(np.exp(size)), simulator.car
    if fault == "mass":
        its["mass"] *= factor
    elif fault == "linear":
        its["linear"] = True
    elif fault in ("stiffness", "friction"):
        k = ("stiffness", "friction").index(fault)
        its["tires"] = [
            tuple(x * (factor if j == k and on else 1.0) for j, x in enumerate(tire))
            for tire, on in zip(its["tires"], axles, strict=True)
        ]
    elif fault not in ("units", "none"):
        simulator.also[fault] = size
    truth = {"fault": fault, "size": size, "also": [*car.also], "told": told, "unit": unit}
    return car, simulator, truth | {"axles": axles}


def stated(car: Trial, fault: str, size: float) -> Trial:
    """The car with the numbers of a simulator's vehicle.toml."""
    its, moved = dict(car.car), size * (car.car["l_f"] + car.car["l_r"])
    if fault == "mass":
        its["mass"] *= np.exp(size)
    elif fault == "yaw_inertia":
        its["inertia"] *= np.exp(size)
    elif fault == "centre_of_gravity":
        its |= {"l_f": its["l_f"] - moved, "l_r": its["l_r"] + moved}
    return replace(car, car=its)


def differences(car: Trial, simulator: Trial, given: Trial, truth: dict, start) -> dict:
    """What differs, as ``tirefit`` names it -> the car less the simulator; None: unlimited."""
    fault, size = truth["fault"], truth["size"]
    its, wheelbase = car.car, car.car["l_f"] + car.car["l_r"]
    scale = given.car["mass"] / its["mass"]
    inertia, factor = its["inertia"] * scale, float(np.exp(size))
    if fault == "centre_of_gravity":
        return {"centre_of_gravity: l_f": size * wheelbase}
    if fault == "yaw_inertia":
        return {"yaw_inertia: yaw_inertia": inertia * (1 - factor)}
    if fault == "mass":  # the same motion as of a smaller inertia on softer tires
        found = {"yaw_inertia: yaw_inertia": inertia * (1 - 1 / factor)}
        for axle, (cpa2, _), (of, _) in zip(("front", "rear"), its["tires"], start, strict=True):
            found[f"{axle}.stiffness"] = cpa2 * scale / of * (1 - 1 / factor)
        return found
    if fault == "linear":
        return {"front.friction": None, "rear.friction": None}
    if fault in ("stiffness", "friction"):
        k = ("stiffness", "friction").index(fault)
        rows = zip(("front", "rear"), truth["axles"], its["tires"], start, strict=True)
        return {
            f"{axle}.{fault}": tire[k] / of[k] * (1 - factor) for axle, on, tire, of in rows if on
        }
    if fault == "steering_delay":
        return {"steering_delay: steering.delay": -size}
    return {} if fault in ("units", "none") else {f"{fault}: amplitude": -size}


def corrected(simulator: Trial, found, start) -> Trial:
    """The simulator, changed as told."""
    its, also = dict(simulator.car), dict(simulator.also)
    wheelbase = its["l_f"] + its["l_r"]
    tires = [list(tire) for tire in its["tires"]]
    for one in found.numbers:
        axle, _, what = one.name.partition(".")
        j, k = ("front", "rear").index(axle), ("stiffness", "friction").index(what)
        if one.differs or its.get("linear"):
            theirs, true = one.values["simulator"].value, one.values["car"].value
            tires[j][k] = start[j][k] * true if its.get("linear") else tires[j][k] * true / theirs
    its |= {"tires": tires, "linear": False}
    for one in found.effects:
        name, _, quantity = one.name.partition(": ")
        if one.differs:
            by = one.difference
            if quantity == "l_f":
                by = -by / wheelbase
            elif quantity == "yaw_inertia":
                by = float(np.log(one.values["car"].value / one.values["simulator"].value))
            also[name] = also.get(name, 0.0) + by
    return replace(simulator, car=its, also=also)


def noise_of(one: Trial) -> tuple[float, float]:
    scale = 0.3 if one.car["small"] else 1.0
    return 0.02 * scale, 0.004 / scale


def left_out(car: Trial, others: list[Trial]) -> list[float]:
    """Rms over the noise of v_y and yaw rate on a further drive: of the car, then of others."""
    seeded = [
        replace(x, car=x.car | {"seed": car.car["seed"] + OTHER}, seconds=LEFT_OUT)
        for x in (car, *others)
    ]
    true, *predicted = (np.stack(drive(one)[2:4]) for one in seeded)
    std = np.array(noise_of(car))[:, None]
    rng = np.random.default_rng(car.number)
    log = true + std * rng.standard_normal(true.shape)
    return [float(np.sqrt(np.mean(((x - log) / std) ** 2))) for x in (true, *predicted)]


def simulated(one: Trial, truth: dict, path: Path) -> Path:
    """The states that a simulator predicts, without noise."""
    t, _, v_y, yaw_rate, *_ = drive(one)
    columns = {"v_y": v_y, "yaw_rate": yaw_rate}
    if truth["fault"] == "units":
        name, factor, _ = UNITS[truth["unit"]]
        columns[name] = factor * columns[name]
    table = np.stack([t, *columns.values()], axis=1)[:: round(1 / one.rate / STEP)]
    np.savetxt(path, table, "%.9g", ",", header="t,v_y,yaw_rate", comments="")
    return path


def judged(number: int, folder: Path) -> dict:
    """The trial and the answer."""
    import tirefit
    from tirefit.models import Brush

    began = time.process_time()
    car, simulator, truth = pair(number)
    log, vehicle = written(car, folder / f"{number}")
    given = stated(car, truth["fault"], truth["size"]) if truth["told"] else car
    if given is not car:
        text = vehicle.read_text().splitlines()
        its = given.car
        new = f"mass = {its['mass']}\nl_f = {its['l_f']}\nl_r = {its['l_r']}\n"
        new += f"yaw_inertia = {its['inertia']}\n"
        vehicle.write_text(new + "\n".join(text[4:]) + "\n")
    sim = simulated(simulator, truth, folder / f"{number}" / "sim.csv")
    rng = np.random.default_rng(number)
    start = [
        (c * np.exp(rng.normal(0, 0.15)), m * np.exp(rng.normal(0, 0.1)))
        for c, m in car.car["tires"]
    ]
    line = {"number": number, **truth}
    try:
        tires = [Brush(cpa2=c, mu=m) for c, m in start]
        found = tirefit.compare_with_simulator([log], [sim], vehicle, *tires)
    except tirefit.DataError as error:
        text = str(error)
        return line | {"outcome": _said(truth, text), "refused": text}
    (folder / f"{number}" / "answer.txt").write_text(str(found))
    each = {one.name: one for one in (*found.numbers, *found.effects)}
    wanted = differences(car, simulator, given, truth, start)
    differs = {name: (x.difference, x.std) for name, x in each.items() if x.differs}
    pulls = {
        name: (each[name].difference - size) / each[name].std
        for name, size in wanted.items()
        if size is not None and name in differs
    }
    outcome = "right" if all(name in differs for name in wanted) else "missed"
    if truth["fault"] == "units":
        outcome = _said(truth, str(found))
    best, raw, changed = left_out(car, [simulator, corrected(simulator, found, start)])
    return line | {
        "outcome": outcome,
        "pulls": {k: round(v, 2) for k, v in pulls.items()},
        "absent": sorted(set(differs) - set(wanted)),
        "differs": {k: [float(f"{x:.4g}") for x in v] for k, v in differs.items()},
        "wanted": wanted,
        "left_out": [round(x, 3) for x in (best, raw, changed)],
        "standing": {one.name: dict(one.standing) for one in found.sources},
        "seconds": round(time.process_time() - began),
    }


def _said(truth: dict, text: str) -> str:
    column, _, word = UNITS[truth["unit"]]
    named = truth["fault"] == "units" and column in text and word in text
    return "said" if named else "missed"


def main() -> None:
    """Runs the trials that the folder lacks, and prints the counts of all asked."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--first", type=int, default=200)
    parser.add_argument("--trials", type=int, default=40)
    parser.add_argument("--out", type=Path, required=True)
    asked = parser.parse_args()
    import jax

    jax.config.update("jax_enable_x64", True)
    asked.out.mkdir(parents=True, exist_ok=True)
    path = asked.out / "trials.jsonl"
    lines = path.read_text().splitlines() if path.exists() else []
    done = {one["number"]: one for one in map(json.loads, lines)}
    numbers = range(asked.first, asked.first + asked.trials)
    for number in numbers:
        if number not in done:
            done[number] = judged(number, asked.out)
            with path.open("a") as file:
                file.write(json.dumps(done[number]) + "\n")
        one = done[number]
        print(number, one["fault"], one["outcome"], one.get("absent", ""), flush=True)
    print(summary([done[number] for number in numbers]))


def summary(lines: list[dict]) -> str:
    """The counts of the table."""
    real = [one for one in lines if one["fault"] != "none"]
    pulls = [p for one in lines for p in one.get("pulls", {}).values()]
    answered = [one for one in lines if "absent" in one]
    told = [one for one in answered if one["fault"] != "units"]
    ratios = [one["left_out"][2] / one["left_out"][0] for one in told]
    faults = Counter(f"{one['fault']} {one['outcome']}" for one in lines)
    return "\n".join(
        (
            f"named or said {sum(x['outcome'] in ('right', 'said') for x in real)} of {len(real)}",
            f"size within two errors {sum(abs(p) < 2 for p in pulls)} of {len(pulls)}",
            f"an absent cause {sum(bool(x['absent']) for x in answered)} of {len(answered)}",
            f"left out at most 1.1 times the best {sum(r <= 1.1 for r in ratios)} of {len(ratios)}",
            *(f"{name}: {count}" for name, count in sorted(faults.items())),
        )
    )


if __name__ == "__main__":
    main()
