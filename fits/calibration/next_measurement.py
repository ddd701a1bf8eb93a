"""Does a proposed measurement move the probability of a cause as forecast?

    python -m fits.calibration.next_measurement --seed 547 --wanted 20 --out out/next

A trial of the independent simulator is diagnosed. If the report proposes a measurement that
decides whether an effect is the cause, the same world is measured under these conditions as well,
and both halves are diagnosed together. The forecast is right if the probability rises for an
effect that is there, and falls for one that is not.
"""

import argparse
import json
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path

import numpy as np

from fits.withheld.effects import EFFECTS
from fits.withheld.generate import rig_text, write_csv
from fits.withheld.patch import World
from fits.withheld.procedural import procedural
from fits.withheld.trials import DEVELOPMENT, Draw, trial

PAUSE = 2.0  # s between the measurements
TURNS = np.array([0.5, 2.0])


def _in_turn(world: World, name: str) -> dict:
    return {name: getattr(world, name) * np.resize(TURNS, len(world.slip))}


CHANGES: dict[str, Callable[[World], dict]] = {
    "sign": lambda world: {"slip": -world.slip},
    "loads": lambda world: _in_turn(world, "fz"),
    "speeds": lambda world: _in_turn(world, "v"),
    "small slips": lambda world: {"slip": 0.1 * world.slip},
}
"""Word of a proposed measurement -> its conditions."""
ARRAYS = ("time", "run", "slip", "fz", "v", "cross", "gamma", "temperature", "inflation", "across")


def both(world: World, change: Callable[[World], dict]) -> World:
    """A plain world whose first half is measured as given, the second under other conditions."""
    later = {name: getattr(world, name) for name in ARRAYS} | change(world)
    later["time"] = world.time + world.time.max() - world.time.min() + PAUSE
    later["run"] = world.run + world.run.max() + 1
    joined = {name: np.concatenate([getattr(world, name), later[name]]) for name in ARRAYS}
    kept = {f.name: getattr(world, f.name) for f in fields(world) if f.name in ("force", "c", "mu")}
    return World(**joined, **kept, moment=world.moment)


def drawn(generator, kind: str, change: Callable):
    """A trial of both measurements: "listed", "beside" or "alone"."""
    draw = Draw(generator, list(DEVELOPMENT), ["rig", "seed"], [200, 400], sealed=False)
    effects = [draw.effect()] if kind != "alone" else []
    world = both(draw.tire(), change)
    draw.n = len(world.slip)
    for effect in effects:
        EFFECTS[effect].forms[draw.form(effect)](world, draw.amplitude(effect), generator)
    what = procedural(world, generator.uniform(0.4, 1.6), generator) if kind != "listed" else ""
    label = {"set": "singles" if kind == "listed" else "beside"}
    return trial(draw, world, "iid", effects, kind=what, **label)


def diagnosed(made, rows: slice, out: Path, name: str):
    """The diagnosis of some rows of a trial."""
    import tirefit

    at = out / f"{name}.csv"
    write_csv(at, {key: values[rows] for key, values in made.columns.items()})
    (out / "rig.toml").write_text(rig_text(made))
    return tirefit.diagnose(tirefit.read(str(at)), model="brush", rig=out / "rig.toml")


def main(arguments: list[str] | None = None) -> None:
    import jax

    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--wanted", type=int, default=10, help="number of forecasts")
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args(arguments)
    given.out.mkdir(parents=True, exist_ok=True)
    found: list[dict] = []
    streams = np.random.SeedSequence(given.seed).spawn(20 * given.wanted)
    for number, stream in enumerate(streams):
        word = list(CHANGES)[number % len(CHANGES)]
        kind = ("listed", "beside", "alone")[number // len(CHANGES) % 3]
        made = drawn(np.random.default_rng(stream), kind, CHANGES[word])
        n = len(made.columns["time"]) // 2
        before = diagnosed(made, slice(0, n), given.out, "before")
        for step in before.next_measurement:
            effect, other = step.separates
            if other != "unknown" or word not in step.add:
                continue
            after = diagnosed(made, slice(None), given.out, "both").verdict.each
            there = effect in made.label["effects"]
            p = before.verdict.each[effect].probability
            now = after[effect].probability if effect in after else 0.0
            right = now > p if there else now < p
            found.append({"kind": kind, "effect": effect, "add": step.add, "there": there,
                          "before": p, "after": now, "forecast": step.p_after,
                          "right": bool(right)})  # fmt: skip
            print(found[-1], flush=True)
        (given.out / "next.json").write_text(json.dumps(found, indent=1) + "\n")
        if len(found) >= given.wanted:
            break
    print(f"as forecast: {sum(one['right'] for one in found)} of {len(found)}")


if __name__ == "__main__":
    main()
