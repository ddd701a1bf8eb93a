"""``tirefit brake``: a braking manoeuvre in closed loop, with any controller."""

from enum import StrEnum
from typing import Annotated

from tirefit.cli import options as cli
from tirefit.cli.output import check_results, write_result

_FIGURES = {"stop.png": "stop", "slip.png": "slip"}
FILES = ("summary.json", "series.csv", "stops.csv", *_FIGURES)

Vehicle = StrEnum("Vehicle", "car quarter")

_ROAD = "friction: mu=0.4; mu=0.3:0.8@20 (changes after 20 m); left=0.3,right=0.8 (split)"
_MEANT = "parameter of hydraulics, sensors, road: demand [Pa], delay [s], ..."
_PLANT = cli.option("NAME=VALUE", _MEANT, parser=cli.number)
_TUNE = cli.option("[CONTROLLER.]NAME=VALUE", "setting of a controller", parser=cli.number)


def brake(
    out: cli.Folder,
    controller: Annotated[
        str, cli.option("NAME[,NAME...]", "controllers: xbs-servo, abs, none")
    ] = "xbs-servo,abs",
    road: Annotated[str, cli.option("ROAD", _ROAD)] = "mu=0.3",
    speed: Annotated[float, cli.option("", "initial speed [m/s]")] = 15.0,
    steer: Annotated[
        float, cli.option("", "steering angle of the front wheels, left positive [rad]")
    ] = 0.0,
    tire: Annotated[
        cli.Text, cli.option("MODEL|FIT.json|FILE.tir", "tire (default: brush-m)")
    ] = None,
    signs: cli.SignsOption = None,
    parameter: cli.SetOption = None,
    tune: Annotated[cli.Pairs, _TUNE] = None,
    plant: Annotated[cli.Pairs, _PLANT] = None,
    vehicle: Annotated[
        Vehicle, cli.option("", "whole car, or one wheel with its mass")
    ] = Vehicle.car,
    time_limit: Annotated[
        cli.Number, cli.option("", "end of the simulation [s] (default: by speed and road)")
    ] = None,
    stops: Annotated[
        int, cli.option("", "number of stops, each with its own seed", min=1, max=100_000)
    ] = 1,
    seed: Annotated[int, cli.option("", "seed of noise and road", min=0, max=2**31)] = 0,
) -> None:
    """Simulate braking with a controller: stopping distance, friction used, figures."""
    check_results([out / name for name in FILES])
    cli.start_jax()
    from tirefit.sim.manoeuvre import brake as braked

    with cli.progress_bar("braking") as progress:
        result = braked(
            tire, controller, road=road, speed=speed, steer=steer, values=cli.by_name(parameter),
            vehicle=vehicle.value, signs=signs, tune=cli.by_name(tune), plant=cli.by_name(plant),
            time_limit=time_limit, stops=stops, seed=seed, progress=progress,
        )  # fmt: skip
        cli.warn_of(result.notes)
        write_result(result, out, FILES, _FIGURES)
