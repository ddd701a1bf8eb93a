"""Writes tables and figures of braking under four controllers, over seeds.

    python -m fits.braking --into fits/braking              # all, 60 seeds
    python -m fits.braking --only low,jump --stops 10 --into out

All controllers have the same road and noise at each seed, so their differences are
paired. See README.md.
"""

import argparse
import csv
import os
from pathlib import Path

SEEDS = 60
CONTROLLERS = ("xbs-servo", "abs", "slip", "none")
"""Those of `tirefit brake`, and ``SlipControl``."""
BRUSH = ("brush-m", {"cpa2": 4e4, "m": 0.5})
MAGIC = ("magic-formula-combined", {"Cx": 1.6, "Ex": 0.3})
LUGRE = ("lugre", {})
_DPI = 80
STEER, TURNED = 0.02, 2.0
"""Angle [rad] of the front wheels, and the time [s] over which O Figure 11 averages."""

CASES = {
    "low": [("mu=0.3", 15.0, BRUSH, 10.0)],
    "jump": [("mu=0.3:0.8@20", 15.0, BRUSH, 8.0)],
    "tires": [
        ("mu=0.15", 10.0, BRUSH, 10.0),
        ("mu=0.8", 25.0, BRUSH, 10.0),
        ("left=0.2,right=0.6", 15.0, BRUSH, 10.0),
        ("mu=0.3", 15.0, MAGIC, 10.0),
        ("mu=0.3", 15.0, LUGRE, 10.0),
    ],
}
"""Case -> manoeuvres: road, speed [m/s], tire, time limit [s]."""


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser("python -m fits.braking")
    parser.add_argument("--only", default="low,turn,jump,tires")
    parser.add_argument("--stops", type=int, default=SEEDS)
    parser.add_argument("--into", type=Path, default=Path("out/braking"))
    asked = parser.parse_args(argv)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    import jax

    jax.config.update("jax_enable_x64", True)
    asked.into.mkdir(parents=True, exist_ok=True)
    apart = {"turn": turn, "tires": tires}
    for case in asked.only.split(","):
        rows = apart[case](asked) if case in apart else stops(case, asked)
        write(asked.into / f"{case}.csv", rows)


def write(path: Path, rows: list[dict]) -> None:
    with open(path, "w", newline="") as file:
        table = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        table.writeheader()
        table.writerows(rows)
    for row in rows:
        print(" | ".join(str(value) for value in row.values()), flush=True)


def made(road: str, speed: float, tire, limit: float, steer: float = 0.0):
    """Request and controllers by name."""
    from fits.braking.slip_control import SlipControl
    from tirefit.models import MODELS
    from tirefit.online.braking.controllers import controller_of
    from tirefit.params import with_values
    from tirefit.sim.brake_request import Request, check, known_to_controllers

    name, values = tire
    request = Request(
        with_values(MODELS[name], values),
        name,
        road=road,
        speed=speed,
        steer=steer,
        time_limit=limit,
    )
    check(request)
    car = known_to_controllers(request)
    kinds = {name: SlipControl if name == "slip" else name for name in CONTROLLERS}
    return request, {name: controller_of(kind, car) for name, kind in kinds.items()}


def numbers(controller: str, key: str, values, against) -> dict:
    """Mean and interval over the seeds, and the same of the difference to ``abs``."""
    from tirefit.sim.brake_result import interval

    whole, apart = interval(values), interval(values - against)

    def shown(value):
        return f"{value:.4g}"

    return {
        "controller": controller,
        "number": key,
        "mean": shown(whole["mean"]),
        "low": shown(whole["low"]),
        "high": shown(whole["high"]),
        "seeds": whole["k"],
        "less_abs": shown(apart["mean"]),
        "less_abs_low": shown(apart["low"]),
        "less_abs_high": shown(apart["high"]),
    }


def stops(case: str, asked) -> list[dict]:
    """Numbers of ``tirefit brake`` by controller and road; writes the figures of seed 0."""
    from tirefit.report.braking import paths_figure, stop_figure
    from tirefit.report.canvas import save_picture
    from tirefit.sim.brake_result import Braking
    from tirefit.sim.manoeuvre import braked

    road, speed, tire, limit = CASES[case][0]
    request, controllers = made(road, speed, tire, limit)
    result = braked(request, controllers, stops=asked.stops)
    two = {name: result.stops[name] for name in ("xbs-servo", "abs")}
    shown = Braking(request, two, {}, result.seed, result.version)
    for draw in (stop_figure, paths_figure):
        name, picture = draw.__name__.removesuffix("_figure"), draw(shown)
        picture.set_dpi(_DPI)
        save_picture(picture, asked.into / f"{case}_{name}.png")
    return rows_of(road, tire[0], result.many)


def rows_of(road: str, tire: str, many) -> list[dict]:
    """Rows of one manoeuvre: ``many`` has the numbers (k,) by controller."""
    from tirefit.sim.brake_result import UNITS

    rows = []
    for name, all_ in many.items():
        ended = f"{int(all_.stopped.sum())} of {len(all_.stopped)}"
        for key in UNITS:
            values, against = (getattr(each, key) for each in (all_, many["abs"]))
            row = numbers(name, key, values, against)
            rows.append({"road": road, "tire": tire, **row, "stopped": ended})
    return rows


def tires(asked) -> list[dict]:
    """The servo and the conventional controller on other tires and roads."""
    import jax
    import jax.numpy as jnp
    import numpy as np

    from tirefit.sim.brake_request import arrays, plant_of
    from tirefit.sim.manoeuvre import many_stops

    rows = []
    keys = jax.vmap(jax.random.key)(jnp.arange(asked.stops))
    for road, speed, tire, limit in CASES["tires"]:
        request, controllers = made(road, speed, tire, limit)
        plants = jax.tree.map(
            lambda leaf: jnp.repeat(leaf[None], asked.stops, 0), plant_of(request)
        )
        many = {}
        for name in ("xbs-servo", "abs"):
            rate = controllers[name].rate
            numbers_of = many_stops(
                plants,
                controllers[name],
                arrays(request.sensors),
                jnp.asarray(speed),
                keys,
                request.samples(rate),
                request.hydraulics.queue(rate),
            )
            many[name] = jax.tree.map(np.asarray, numbers_of)
            print(road, tire[0], name, many[name].stopping_distance.mean(), flush=True)
        rows += rows_of(road, tire[0], many)
        write(asked.into / "tires.csv", rows)  # after each road, in case of an interruption
    return rows


def turn(asked) -> list[dict]:
    """O Figure 11: friction of the front wheels along and across, over two seconds."""
    import jax
    import jax.numpy as jnp
    import numpy as np

    from tirefit.sim.brake import simulate_stop
    from tirefit.sim.brake_request import arrays, plant_of

    request, controllers = made("mu=0.3", 15.0, BRUSH, 8.0, STEER)
    plant, sensors = plant_of(request), arrays(request.sensors)
    keys = jax.vmap(jax.random.key)(jnp.arange(asked.stops))
    points = {}
    for name, controller in controllers.items():
        samples = round(TURNED * controller.rate)
        queue = request.hydraulics.queue(controller.rate)

        def one(key, controller=controller, samples=samples, queue=queue):
            speed = jnp.asarray(request.speed)
            log = simulate_stop(plant, controller, sensors, speed, key, samples, queue)
            c = log.contacts
            along, across = (jnp.mean((f / c.fz)[:, :2]) for f in (c.fx, c.fy))
            return along, -across, log.motion.heading[-1]

        along, across, heading = jax.jit(jax.vmap(one))(keys)
        along, across = np.asarray(along), np.asarray(across)
        points[name] = {
            "mu_x": along,
            "mu_y": across,
            "mu": np.hypot(along, across),
            "heading": np.asarray(heading),
        }
    draw_turn(points, asked.into / "turn.png")
    return [
        numbers(name, key, values, points["abs"][key])
        for name, each in points.items()
        for key, values in each.items()
    ]


def draw_turn(points, path: Path) -> None:
    import numpy as np

    from tirefit.report.canvas import BLUE, DARK, GREEN, GREY, ORANGE, Picture, save_picture, tidy

    picture = Picture(figsize=(5.2, 5.0), layout="constrained")
    axes = picture.subplots()
    angle = np.linspace(0, np.pi / 2, 100)
    axes.plot(0.3 * np.cos(angle), 0.3 * np.sin(angle), color=GREY, linewidth=1)
    for color, (name, each) in zip((BLUE, ORANGE, GREEN, DARK), points.items(), strict=True):
        axes.plot(each["mu_y"], each["mu_x"], ".", color=color, markersize=5, label=name, alpha=0.6)
    axes.set_xlim(-0.02, 0.32)
    axes.set_ylim(0.0, 0.32)
    axes.set_aspect("equal")
    tidy(axes, "$\\mu_y$, mean of the front wheels [–]", "$\\mu_x$ [–]")
    axes.legend(fontsize=8, frameon=False, loc="lower left")
    axes.set_title("Braking in a turn: friction used in the first 2 s", loc="left", fontsize=9.5)
    picture.supxlabel("grey: available friction; a point: one seed", fontsize=7)
    save_picture(picture, path)


if __name__ == "__main__":
    main()
