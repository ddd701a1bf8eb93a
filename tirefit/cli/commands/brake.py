"""``tirefit brake``: a braking manoeuvre in closed loop, with any controller."""

from enum import StrEnum
from typing import Annotated

from tirefit.cli.options import (
    Folder,
    Number,
    SetOption,
    SignsOption,
    Text,
    Texts,
    option,
    progress_bar,
    settings_of,
    start_jax,
    warn_of,
)
from tirefit.cli.output import check_results, claimed, write_result

_FIGURES = {"stop.png": "stop", "slip.png": "slip"}
FILES = ("summary.json", "series.csv", "stops.csv", *_FIGURES)

Vehicle = StrEnum("Vehicle", "car quarter")

_ROAD = "friction: mu=0.4; mu=0.3:0.8@20 (changes after 20 m); left=0.3,right=0.8 (split)"
_PLANT = "parameter of hydraulics, sensors, road: demand [Pa], delay [s], ..."


def brake(
    out: Folder,
    controller: Annotated[
        str, option("NAME[,NAME...]", "controllers: xbs-servo, abs, none")
    ] = "xbs-servo,abs",
    road: Annotated[str, option("ROAD", _ROAD)] = "mu=0.3",
    speed: Annotated[float, option("", "initial speed [m/s]")] = 15.0,
    steer: Annotated[
        float, option("", "steering angle of the front wheels, left positive [rad]")
    ] = 0.0,
    tire: Annotated[Text, option("MODEL|FIT.json|FILE.tir", "tire (default: brush-m)")] = None,
    signs: SignsOption = None,
    parameter: SetOption = None,
    tune: Annotated[Texts, option("[CONTROLLER.]NAME=VALUE", "setting of a controller")] = None,
    plant: Annotated[Texts, option("NAME=VALUE", _PLANT)] = None,
    vehicle: Annotated[Vehicle, option("", "whole car, or one wheel with its mass")] = Vehicle.car,
    time_limit: Annotated[
        Number, option("", "end of the simulation [s] (default: by speed and road)")
    ] = None,
    stops: Annotated[
        int, option("", "number of stops, each with its own seed", min=1, max=100_000)
    ] = 1,
    seed: Annotated[int, option("", "seed of noise and road", min=0, max=2**31)] = 0,
) -> None:
    """Simulate braking with a controller: stopping distance, friction used, figures."""
    values, settings, plant_values = settings_of(set=parameter, tune=tune, plant=plant)
    check_results([out / name for name in FILES])
    start_jax()
    from tirefit.sim.manoeuvre import brake as braked

    with claimed(out), progress_bar("braking") as progress:
        result = braked(
            tire, controller, road=road, speed=speed, steer=steer, values=values,
            vehicle=vehicle.value, signs=signs, tune=settings, plant=plant_values,
            time_limit=time_limit, stops=stops, seed=seed, progress=progress,
        )  # fmt: skip
        warn_of(result.notes)
        write_result(result, out, FILES, _FIGURES)
