"""Fit, predict and diagnose the cars: ``python -m fits.measured_cars --out DIR``.

Writes one JSON file for each car and step, and ``DIR/table.md`` of all that are there; a file
that is there is not computed again, so an interrupted run continues.
"""

import argparse
import json
import re
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np

import tirefit
from fits.measured_cars.by_hand import HORIZONS, by_hand
from fits.measured_cars.cars import CARS, Car
from fits.measured_changes.by_hand import rounded
from fits.replay.cars import write_logs
from tirefit.vehicle.trajectory import TrajectoryFit

THINNED = (6, 8, 10, 12, 15)
"""Every which row of an axle is diagnosed."""


def _rms(models: dict, name: str) -> dict:
    return {key: models[name].rms()[key] for key in ("yaw_rate", "lateral")}


def _estimates(fit: TrajectoryFit) -> dict:
    return {k: [one.value, one.std, one.identified] for k, one in fit.parameters.items()}


def fit_of(car: Car, folder: Path, model: str = "brush") -> dict:
    """The fit by trajectory with this model of both tires, and its errors on the logs left
    out, next to those of linear tires, of no slip, and the floor of the noise."""
    own, rest, toml = car.logs(folder)
    fit = tirefit.fit_trajectory(own, toml, model, model, unknowns=car.unknowns)
    result = tirefit.replay(rest, fit.vehicle, *fit.axles.values(), horizons=HORIZONS)
    return {
        "parameters": _estimates(fit),
        "status": str(fit.status),
        "starts": result.windows,
        "said": result.conclusions,
        **{name: _rms(result.models, name) for name in result.models},
    }


def rising_of(car: Car, folder: Path) -> dict:
    """The same with friction that changes with the logarithm of the sliding speed."""
    return fit_of(car, folder, "brush-ln")


def hand_of(car: Car, folder: Path) -> dict:
    """The same by hand."""
    own, rest, toml = car.logs(folder)
    return by_hand(own, rest, toml, "steering_ratio" in car.unknowns)


def diagnosis_of(car: Car, folder: Path) -> dict:
    """Effects that the car lacks as its ``vehicle.toml`` states it, on tires fitted to forces;
    errors on the logs left out as given and with these effects."""
    own, rest, toml = car.logs(folder)
    tires = []
    for axle in ("front", "rear"):
        out = folder / f"{axle}.csv"
        tirefit.derive_files(own, toml, out, axle, believe=True)
        tires.append(tirefit.fit(tirefit.read(out), "brush"))
    found = tirefit.diagnose_vehicle(own, toml, *tires, holdout=rest)
    result = tirefit.replay(rest, toml, *tires, horizons=HORIZONS, effects=found)
    verdict, held = found.verdict, found.gap.holdout
    return {
        "status": str(verdict.status),
        "named": list(verdict.effects),
        "acts_like": list(verdict.acts_like),
        "each": {k: [one.probability, list(one.twins)] for k, one in verdict.each.items()},
        "held_out": held and [held.rms, held.remaining_rms],
        "starts": result.windows,
        "said": result.conclusions,
        "summary": found.summary(),
        **{name: _rms(result.models, name) for name in result.models},
    }


def _part(path: Path, half: int, folder: Path) -> Path:
    """The first or second half of the rows of a log."""
    head, *rows = path.read_text().splitlines()
    middle = len(rows) // 2
    out = folder / f"{path.stem}_{half}.csv"
    out.write_text("\n".join([head, *(rows[middle:] if half else rows[:middle])]) + "\n")
    return out


def halves_of(car: Car, folder: Path) -> dict:
    """Parameters of fits to the first and to the second half of every log, and by parameter
    their difference over its standard error."""
    own, rest, toml = car.logs(folder)
    fits = []
    for half in (0, 1):
        logs = [_part(path, half, folder) for path in (*own, *rest)]
        fits.append(_estimates(tirefit.fit_trajectory(logs, toml, unknowns=car.unknowns)))
    apart = {
        name: abs(fits[0][name][0] - fits[1][name][0])
        / max(np.hypot(fits[0][name][1], fits[1][name][1]), 1e-12)
        for name in fits[0]
        if fits[0][name][2] and fits[1][name][2]
    }
    return {"halves": fits, "apart": apart}


def thinned(table: Path, every: int, out: Path) -> Path:
    """Every ``every``-th row of each run of a table of ``derive``."""
    first, head, *rows = table.read_text().splitlines()
    run, seen, kept = head.split(",").index("run"), dict[str, int](), []
    for row in rows:
        name = row.split(",")[run]
        if seen.setdefault(name, 0) % every == 0:
            kept.append(row)
        seen[name] += 1
    out.write_text("\n".join([first, head, *kept]) + "\n")
    return out


def thinning_of(car: Car, folder: Path, axle: str = "front") -> dict:
    """What ``diagnose`` names on every 6th to 15th row of an axle, and its sizes."""
    logs, toml = write_logs(car.source, folder)
    whole, found = folder / f"{axle}.csv", {}
    tirefit.derive_files(logs, toml, whole, axle, believe=True)
    for every in THINNED:
        one = tirefit.diagnose(tirefit.read(thinned(whole, every, folder / f"{every}.csv")))
        each = one.verdict.each
        sizes = {k.split(":")[0]: [a.value, a.std, a.unit] for k, a in one.amplitudes.items()}
        found[str(every)] = {
            "status": str(one.verdict.status),
            "each": {k: [e.probability, list(e.twins), sizes.get(k)] for k, e in each.items()},
            "rms": [step.rms_left_out for step in one.ladder.steps],
        }
    return found


STEPS: dict[str, Callable[[Car, Path], dict]] = {
    "fit": fit_of,
    "rising": rising_of,
    "hand": hand_of,
    "diagnosis": diagnosis_of,
    "halves": halves_of,
    "thinning": thinning_of,
}


def turned(car: Car) -> Car:
    """The car with the logs left out fitted instead."""
    return replace(car, name=f"{car.name}_turned", fitted=car.left_out, left_out=car.fitted)


def _cells(values: Sequence[float | None]) -> str:
    return ", ".join("-" if v is None else f"{v:.2f}" for v in values)


def table(out: Path) -> str:
    """The table of the steps that are done."""
    found = {path.stem: json.loads(path.read_text()) for path in sorted(out.glob("*.json"))}
    text = "| car | by | yaw rate [rad/s] | lateral [m] |\n|---|---|---|---|\n"
    names = [name for car in CARS for name in (car.name, turned(car).name)]
    for name in names:
        rows = {}
        if tool := found.get(f"{name}.fit"):
            rows |= {"tool": tool["tire"], "tool, linear": tool["linear tire"]}
            rows |= {"no slip": tool["no slip"]}
        if tool := found.get(f"{name}.rising"):
            rows |= {"tool, brush-ln": tool["tire"]}
        if hand := found.get(f"{name}.hand"):
            rows |= {f"hand, {kind}": hand[kind] for kind in ("brush", "rising", "linear")}
        if tool := found.get(f"{name}.diagnosis"):
            rows |= {"derive + fit": tool["tire"]}
            rows |= {"with the effects": tool["with the effects"]}
        for by, errors in rows.items():
            text += f"| {name} | {by} | {_cells(errors['yaw_rate'])} |"
            text += f" {_cells(errors['lateral'])} |\n"
    for name, one in found.items():
        if name.endswith(".halves"):
            text += f"\n{name}: " + ", ".join(f"{k} {v:.1f}" for k, v in one["apart"].items())
        if name.endswith(".diagnosis"):
            text += f"\n{name}: {one['named']} {one['each']}"
        for every, line in one.items() if name.endswith(".thinning") else ():
            each = ", ".join(f"{k} {v[0]:.2f} {v[1]} {v[2]}" for k, v in line["each"].items())
            text += f"\n{name}, every {every}th: {line['status']}; {each}"
    return text + "\n"


def main() -> None:
    """Compute the steps that are not there yet, and write the table after each."""
    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(prog="python -m fits.measured_cars")
    parser.add_argument("--car", action="append", choices=[car.name for car in CARS])
    parser.add_argument("--step", action="append", choices=STEPS)
    parser.add_argument("--turned", action="store_true", help="also with the logs exchanged")
    parser.add_argument("--out", type=Path, required=True)
    asked = parser.parse_args()
    asked.out.mkdir(parents=True, exist_ok=True)
    cars = [car for car in CARS if car.name in (asked.car or [car.name])]
    work = [(car, step) for step in asked.step or STEPS for car in cars]
    if asked.turned:
        work += [(turned(car), step) for step in ("fit", "hand") for car in cars]
    for number, (car, step) in enumerate(work, 1):
        at = asked.out / f"{car.name}.{step}.json"
        if not at.exists():
            began = time.perf_counter()
            with tempfile.TemporaryDirectory() as folder:
                found = rounded(STEPS[step](car, Path(folder)))
            at.write_text(json.dumps(found, indent=1) + "\n")
            seconds = time.perf_counter() - began
            print(f"{number}/{len(work)} {car.name} {step}: {seconds:.0f} s", flush=True)
            (asked.out / "table.md").write_text(table(asked.out))
    print(re.sub(r"\n+", "\n", table(asked.out)))
