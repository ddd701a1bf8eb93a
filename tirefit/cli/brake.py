"""``tirefit brake``: a braking manoeuvre in closed loop, with any controller."""

from enum import StrEnum
from typing import Annotated

import typer

from tirefit.cli.options import (
    Folder,
    SetOption,
    SignsOption,
    complain,
    numbers,
    progress_bar,
    start_jax,
)
from tirefit.cli.output import check_results, claimed, write_result
from tirefit.results import InputProblem, UsageError

_FIGURES = {"stop.png": "stop", "slip.png": "slip"}
FILES = ("summary.json", "series.csv", "stops.csv", *_FIGURES)

Vehicle = StrEnum("Vehicle", "car quarter")


def brake(
    out: Folder,
    controller: Annotated[
        str, typer.Option(metavar="NAME[,NAME...]", help="controllers: xbs-servo, abs, slip, none")
    ] = "xbs-servo,abs",
    road: Annotated[
        str,
        typer.Option(
            metavar="ROAD",
            help="friction: mu=0.4; mu=0.3:0.8@20 (changes after 20 m); left=0.3,right=0.8 (split)",
        ),
    ] = "mu=0.3",
    speed: Annotated[float, typer.Option(help="initial speed [m/s]")] = 15.0,
    steer: Annotated[
        float, typer.Option(help="steering angle of the front wheels, left positive [rad]")
    ] = 0.0,
    tire: Annotated[
        str | None, typer.Option(metavar="MODEL|FIT.json|FILE.tir", help="tire (default: brush-m)")
    ] = None,
    signs: SignsOption = None,
    parameter: SetOption = None,
    tune: Annotated[
        list[str] | None,
        typer.Option(metavar="[CONTROLLER.]NAME=VALUE", help="setting of a controller"),
    ] = None,
    plant: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=VALUE",
            help="parameter of hydraulics, sensors, road: demand [Pa], delay [s], ...",
        ),
    ] = None,
    vehicle: Annotated[
        Vehicle, typer.Option(help="whole car, or one wheel with its mass")
    ] = Vehicle.car,
    time_limit: Annotated[
        float | None, typer.Option(help="end of the simulation [s] (default: by speed and road)")
    ] = None,
    stops: Annotated[
        int, typer.Option(min=1, max=100_000, help="number of stops, each with its own seed")
    ] = 1,
    seed: Annotated[int, typer.Option(min=0, max=2**31, help="seed of noise and road")] = 0,
) -> None:
    """Simulate braking with a controller: stopping distance, friction used, figures."""
    problems: list[InputProblem] = []
    values = numbers("--set", parameter, problems)
    settings = numbers("--tune", tune, problems)
    plant_values = numbers("--plant", plant, problems)
    UsageError.raise_for(problems)
    check_results([out / name for name in FILES])
    start_jax()
    from tirefit.sim.manoeuvre import brake as braked

    with claimed(out), progress_bar("braking") as progress:
        result = braked(
            tire, controller, road=road, speed=speed, steer=steer, values=values,
            vehicle=vehicle.value, signs=signs, tune=settings, plant=plant_values,
            time_limit=time_limit, stops=stops, seed=seed, progress=progress,
        )  # fmt: skip
        for text in result.notes:
            complain(f"warning: {text}")
        write_result(result, out, FILES, _FIGURES)
