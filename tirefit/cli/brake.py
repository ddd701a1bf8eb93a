"""``tirefit brake``: a braking manoeuvre in closed loop, with any controller."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from tirefit.cli.options import (
    Folder,
    SetOption,
    SignsOption,
    complain,
    errors_to_exit,
    numbers,
    progress_bar,
    say,
    start_jax,
)
from tirefit.cli.output import check_directories, claimed, staged
from tirefit.results import InputProblem, UsageError

SUMMARY, SERIES, STOPS = "summary.json", "series.csv", "stops.csv"
FIGURES = ("stop.png", "compare.png", "slip.png")
ANIMATION = "stop.gif"
FILES = (SUMMARY, SERIES, STOPS, *FIGURES, ANIMATION)

DEFAULT_TIRE = "brush-m"
DEFAULT_VALUES = {"cpa2": 4e4, "m": 0.5}
"""A tire with a peak: sliding, it has four fifths of it, S(33)."""


class Vehicle(StrEnum):
    car = "car"
    quarter = "quarter"


def brake(
    out: Folder,
    controller: Annotated[
        str, typer.Option(metavar="NAME[,NAME...]", help="xbs-servo, abs, slip, none")
    ] = "xbs-servo,abs",
    road: Annotated[
        str,
        typer.Option(
            metavar="ROAD",
            help="mu=0.4; mu=0.3:0.8@20 changes after 20 m; left=0.3,right=0.8",
        ),
    ] = "mu=0.3",
    speed: Annotated[float, typer.Option(help="at which braking begins [m/s]")] = 15.0,
    steer: Annotated[
        float, typer.Option(help="angle of the front wheels, to the left [rad]")
    ] = 0.0,
    tire: Annotated[
        str | None,
        typer.Option(metavar="MODEL|FIT.json|FILE.tir", help="brush-m if not given"),
    ] = None,
    signs: SignsOption = None,
    parameter: SetOption = None,
    tune: Annotated[
        list[str] | None,
        typer.Option(
            metavar="[CONTROLLER.]NAME=VALUE", help="setting of the controllers"
        ),
    ] = None,
    plant: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=VALUE",
            help="number of hydraulics, sensors, road: demand [Pa], delay [s], ...",
        ),
    ] = None,
    vehicle: Annotated[
        Vehicle, typer.Option(help="four wheels, or one with its mass")
    ] = Vehicle.car,
    time_limit: Annotated[
        float | None, typer.Option(help="[s]; by speed and road if not given")
    ] = None,
    stops: Annotated[
        int, typer.Option(min=1, max=100_000, help="seeds to brake with")
    ] = 1,
    animate: Annotated[
        bool, typer.Option("--animate", help="write stop.gif too")
    ] = False,
    seed: Annotated[int, typer.Option(min=0, max=2**31, help="of noise and road")] = 0,
) -> None:
    """Brake a car with a controller: stopping distance, friction used, figures."""
    with errors_to_exit():
        problems: list[InputProblem] = []
        values = numbers("--set", parameter, problems)
        settings = numbers("--tune", tune, problems)
        plant_values = numbers("--plant", plant, problems)
        UsageError.raise_for(problems)
        check_directories([out])
        start_jax()
        from tirefit.online.controllers import CONTROLLERS
        from tirefit.params import by_owner, check_names
        from tirefit.sim.brake_request import Request, check, doubts, with_numbers

        names = check_names("controller", controller, CONTROLLERS)
        chosen = by_owner(settings, {name: CONTROLLERS[name]() for name in names})
        named, made = _tire(tire, values, signs)
        request = Request(
            made, named, road=road, speed=speed, vehicle=vehicle.value, steer=steer,
            time_limit=time_limit,
        )  # fmt: skip
        request = with_numbers(request, plant_values)
        check(request)
        for text in doubts(request):
            complain(f"warning: {text}")
        with claimed(out):
            _run(request, chosen, seed, stops, animate, out)


def _tire(source: str | None, values: dict[str, float], signs: str | None):
    """Name and record of the tire of a model, a fit or a ``.tir`` file."""
    from tirefit.fitting.source import given_tire
    from tirefit.fitting.tir import remarks

    if source is None:
        source, values = DEFAULT_TIRE, DEFAULT_VALUES | values
    given = given_tire(source, values, signs)
    for text in remarks(given.tir, given.tire) if given.tir else ():
        complain(f"warning: {source}: {text}")
    return source, given.tire


def _run(request, chosen, seed: int, stops: int, animate: bool, out: Path) -> None:
    from tirefit.data.write import write_csv
    from tirefit.files import json_text, write_text_atomic
    from tirefit.online.controllers import controller_of
    from tirefit.report.braking import compare_figure, paths_figure, stop_figure
    from tirefit.report.canvas import save_picture
    from tirefit.sim.brake_request import known_to_controllers
    from tirefit.sim.brake_result import brake as simulate

    car = known_to_controllers(request)
    controllers = {n: controller_of(n, car, own) for n, own in chosen.items()}
    with progress_bar("braking") as progress:
        result = simulate(
            request, controllers, seed=seed, stops=stops, progress=progress
        )
    written = [SUMMARY, SERIES, FIGURES[0], FIGURES[2]]
    with staged(out, FILES, result) as folder:
        write_text_atomic(folder / SUMMARY, json_text(result.to_dict()))
        write_csv(folder / SERIES, result.columns())
        save_picture(stop_figure(result), folder / FIGURES[0])
        save_picture(paths_figure(result), folder / FIGURES[2])
        if len(chosen) > 1:
            save_picture(compare_figure(result), folder / FIGURES[1])
            written.append(FIGURES[1])
        if stops > 1:
            write_csv(folder / STOPS, result.stops_columns())
            written.append(STOPS)
        if animate:
            from tirefit.report.brake_animation import save_animation

            save_animation(result, folder / ANIMATION)
            written.append(ANIMATION)
    say(str(result))
    say("wrote " + ", ".join(str(out / name) for name in written))
